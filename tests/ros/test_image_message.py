"""Images of messages; ``rosbags-image`` is the independent reader where it agrees with ROS."""

from array import array
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.images import decode_image, encode_jpeg, encode_png
from pipelines.ros.image_message import (
    ENCODINGS,
    image_of_message,
    is_depth_image,
    message_size,
    stored_image,
)

WIDTH, HEIGHT = 16, 12
BAYER = {"rggb": (0, 1, 1, 2), "bggr": (2, 1, 1, 0), "gbrg": (1, 2, 0, 1), "grbg": (1, 0, 2, 1)}


def noise(*shape: int, bits: int = 8) -> Any:
    dtype = np.uint8 if bits == 8 else np.uint16
    return np.random.default_rng(3).integers(0, 1 << bits, shape).astype(dtype)


def image(encoding: str, samples: Any, **fields: Any) -> Any:
    rows = np.ascontiguousarray(samples).reshape(len(samples), -1)
    values = {
        "width": samples.shape[1],
        "height": samples.shape[0],
        "encoding": encoding,
        "is_bigendian": 0,
        "step": rows.view(np.uint8).shape[1],
        "data": rows.view(np.uint8).ravel(),
    }
    return SimpleNamespace(**(values | fields))


def compressed(data: bytes, text: str = "jpeg") -> Any:
    return SimpleNamespace(format=text, data=np.frombuffer(data, np.uint8))


@pytest.mark.parametrize(
    ("encoding", "samples", "rgb"),
    [
        ("rgb8", noise(HEIGHT, WIDTH, 3), lambda s: s),
        ("bgr8", noise(HEIGHT, WIDTH, 3), lambda s: s[:, :, ::-1]),
        ("8UC3", noise(HEIGHT, WIDTH, 3), lambda s: s[:, :, ::-1]),
        ("rgba8", noise(HEIGHT, WIDTH, 4), lambda s: s[:, :, :3]),
        ("bgra8", noise(HEIGHT, WIDTH, 4), lambda s: s[:, :, 2::-1]),
        ("mono8", noise(HEIGHT, WIDTH), lambda s: np.stack([s] * 3, axis=2)),
        ("8UC1", noise(HEIGHT, WIDTH), lambda s: np.stack([s] * 3, axis=2)),
        ("mono16", noise(HEIGHT, WIDTH, bits=16), lambda s: np.stack([s >> 8] * 3, axis=2)),
        ("rgb16", noise(HEIGHT, WIDTH, 3, bits=16), lambda s: s >> 8),
        ("bgr16", noise(HEIGHT, WIDTH, 3, bits=16), lambda s: s[:, :, ::-1] >> 8),
        ("bgra16", noise(HEIGHT, WIDTH, 4, bits=16), lambda s: s[:, :, 2::-1] >> 8),
    ],
)
def test_raw_images_are_kept_exactly(encoding: str, samples: Any, rgb: Any) -> None:
    message = image(encoding, samples)
    expected = rgb(samples).astype(np.uint8)
    np.testing.assert_array_equal(image_of_message(message, "bag"), expected)
    stored = stored_image(message, "bag")
    assert (stored.suffix, message_size(message, "bag")) == (".png", (WIDTH, HEIGHT))
    np.testing.assert_array_equal(decode_image(stored.data, "bag"), expected)


@pytest.mark.parametrize("encoding", ["rgb8", "mono16"])
def test_rows_may_have_a_padding_and_bytes_another_order(encoding: str) -> None:
    samples = noise(HEIGHT, WIDTH, 3) if encoding == "rgb8" else noise(HEIGHT, WIDTH, bits=16)
    plain = image(encoding, samples)
    rows = plain.data.reshape(HEIGHT, -1)
    padded = np.pad(rows, ((0, 0), (0, 7)), constant_values=255).ravel()[:-7]
    message = image(encoding, samples, step=plain.step + 7, data=padded)
    expected = image_of_message(plain, "bag")
    np.testing.assert_array_equal(image_of_message(message, "bag"), expected)
    swapped = image(encoding, samples.byteswap(), is_bigendian=1)
    np.testing.assert_array_equal(image_of_message(swapped, "bag"), expected)
    # rclpy hands over an array of the standard library.
    listed = image(encoding, samples, data=array("B", plain.data.tobytes()))
    np.testing.assert_array_equal(image_of_message(listed, "bag"), expected)


# rosbags-image does not see the rows of chrominance of NV12 and NV21, and names 8UC otherwise.
@pytest.mark.parametrize(
    "encoding", sorted(set(ENCODINGS) - {"8UC1", "8UC3", "8UC4", "nv12", "nv21"})
)
def test_all_encodings_agree_with_rosbags_image(encoding: str) -> None:
    reader = pytest.importorskip("rosbags.image")
    bits = 16 if encoding.endswith("16") else 8
    channels = ENCODINGS[encoding].channels
    shape = (HEIGHT, WIDTH, channels) if channels > 1 else (HEIGHT, WIDTH)
    message = image(encoding, noise(*shape, bits=bits))
    theirs = reader.message_to_cvimage(message, "rgb8").astype(int)
    ours = image_of_message(message, "bag").astype(int)
    # They scale 16 bits by 255 / 65535 where the data set's own PNG keep the upper 8.
    assert np.abs(ours - theirs).max() <= (1 if bits == 16 else 0)


@pytest.mark.parametrize("encoding", ["nv12", "nv21"])
def test_planes_of_chrominance(encoding: str) -> None:
    samples = np.full((HEIGHT * 3 // 2, WIDTH), 128, dtype=np.uint8)
    pair = (90, 240) if encoding == "nv12" else (240, 90)
    samples[HEIGHT:, ::2], samples[HEIGHT:, 1::2] = pair
    red, green, blue = image_of_message(image(encoding, samples, height=HEIGHT), "bag")[5, 5]
    # ITU-R BT.601, limited range, of Y 128, Cb 90, Cr 240.
    wanted = (
        1.164 * 112 + 1.596 * 112,
        1.164 * 112 - 0.813 * 112 + 0.391 * 38,
        1.164 * 112 - 2.018 * 38,
    )
    np.testing.assert_allclose(
        (red, green, blue), [min(max(value, 0), 255) for value in wanted], atol=2
    )


@pytest.mark.parametrize("pattern", sorted(BAYER))
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_patterns_give_back_a_plain_colour(pattern: str, bits: int) -> None:
    colour = np.array([200, 120, 40], dtype=np.uint16) << (bits - 8)
    first, second, third, fourth = BAYER[pattern]
    samples = np.zeros((HEIGHT, WIDTH), np.uint8 if bits == 8 else np.uint16)
    samples[::2, ::2], samples[::2, 1::2] = colour[first], colour[second]
    samples[1::2, ::2], samples[1::2, 1::2] = colour[third], colour[fourth]
    rgb = image_of_message(image(f"bayer_{pattern}{bits}", samples), "bag")
    assert rgb.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(rgb.astype(int) - [200, 120, 40]).max() <= 1


def picture() -> ImageArray:
    samples: ImageArray = noise(HEIGHT, WIDTH, 3)
    return samples


@pytest.mark.parametrize(
    ("data", "suffix"), [(encode_jpeg(picture()), ".jpg"), (encode_png(picture()), ".png")]
)
@pytest.mark.parametrize("text", ["jpeg", "png", "rgb8; jpeg compressed bgr8", "", "anything"])
def test_compressed_images_are_kept_to_the_byte(data: bytes, suffix: str, text: str) -> None:
    # The content counts: drivers write all kinds of formats.
    stored = stored_image(compressed(data, text), "bag")
    assert (stored.data, stored.suffix) == (data, suffix)
    assert message_size(compressed(data), "bag") == (WIDTH, HEIGHT)
    expected = decode_image(data, "bag")
    np.testing.assert_array_equal(image_of_message(compressed(data, text), "bag"), expected)


def test_a_compressed_bayer_pattern_is_demosaiced() -> None:
    samples = noise(HEIGHT, WIDTH)
    expected = image_of_message(image("bayer_rggb8", samples), "bag")
    message = compressed(encode_png(samples), "bayer_rggb8; png compressed bayer_rggb8")
    stored = stored_image(message, "bag")
    np.testing.assert_array_equal(decode_image(stored.data, "bag"), expected)
    before = compressed(encode_png(expected), "bayer_rggb8; png compressed bgr8")
    assert stored_image(before, "bag").data == encode_png(expected)


def test_depth_images_are_known() -> None:
    assert is_depth_image(image("16UC1", noise(HEIGHT, WIDTH, bits=16)))
    assert is_depth_image(compressed(b"", "16UC1; compressedDepth png"))
    assert not is_depth_image(image("mono16", noise(HEIGHT, WIDTH, bits=16)))
    assert not is_depth_image(compressed(b"", "rgb8; jpeg compressed bgr8"))


RGB = noise(HEIGHT, WIDTH, 3)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (image("rgb9\x1b[2J", RGB), r"encoding 'rgb9\x1b[2J' is not known"),
        (image("32FC1", RGB), "that of depth"),
        (image("rgb8", RGB, step=WIDTH), "rows of 16 bytes, too short"),
        (image("rgb8", RGB, data=RGB.ravel()[:-1]), "575 bytes, too few"),
        (image("rgb8", RGB, height=2**31, width=2**31), "from 1 to"),
        (image("rgb8", RGB, height=0), "from 1 to"),
        (image("yuyv", noise(HEIGHT, 5, 2)), "takes them in pairs"),
        (image("nv12", noise(HEIGHT, 6), height=7), "even numbers"),
        (image("bayer_rggb8", noise(2, 2)), "too few for a Bayer pattern"),
        (compressed(b"GIF89a" + b"\0" * 50), "neither a JPEG, PNG"),
        (compressed(encode_jpeg(picture())[:-200]), "damaged or truncated"),
        (compressed(b"", "16UC1; compressedDepth png"), "is a depth image"),
    ],
)
def test_what_is_no_image_is_refused(message: Any, reason: str) -> None:
    with pytest.raises(InputError) as caught:
        stored_image(message, "drive.bag")
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)
