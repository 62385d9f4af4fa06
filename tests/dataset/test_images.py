"""Images: decoded exactly, and never before their header was checked."""

import contextlib
import io
import os
import struct
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageOps

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.images import (
    MAX_PIXELS,
    ImageHeader,
    decode_depth,
    decode_image,
    encode_jpeg,
    encode_png,
    image_header,
    read_image_bytes,
    read_image_header,
)


def picture(height: int = 48, width: int = 64) -> ImageArray:
    """A smooth picture with three different channels."""
    rows, columns = np.mgrid[0:height, 0:width]
    channels = (rows * 4, columns * 3, (rows + columns) * 2)
    return np.stack(channels, axis=2).clip(0, 255).astype(np.uint8)


def encoded(image: Image.Image, kind: str = "PNG") -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind)
    return buffer.getvalue()


def png_chunk(name: bytes, content: bytes) -> bytes:
    body = name + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))


def png_that_claims(width: int, height: int) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + png_chunk(b"IHDR", header)
        + png_chunk(b"IDAT", zlib.compress(bytes(1_000_000)))
        + png_chunk(b"IEND", b"")
    )


def test_png_is_lossless_and_rgb() -> None:
    image = picture()
    data = encode_png(image)
    np.testing.assert_array_equal(decode_image(data, "a.png"), image)
    # OpenCV, which is independent of Pillow, sees the same with the channels reversed.
    by_opencv = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert by_opencv is not None
    np.testing.assert_array_equal(by_opencv[:, :, ::-1], image)


def test_jpeg_is_nearly_the_same_and_rgb() -> None:
    image = picture()
    decoded = decode_image(encode_jpeg(image), "a.jpg")
    assert decoded.shape == image.shape
    assert decoded.dtype == np.uint8
    assert np.abs(decoded.astype(int) - image).mean() < 2.0


def test_headers() -> None:
    image = picture(48, 64)
    assert image_header(encode_png(image), "a") == ImageHeader("PNG", 64, 48)
    assert image_header(encode_jpeg(image), "a") == ImageHeader("JPEG", 64, 48)


def test_the_header_is_enough_for_the_header(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(encode_jpeg(picture(300, 400))[:1000])
    assert read_image_header(path) == ImageHeader("JPEG", 400, 300)


def test_other_modes_become_rgb() -> None:
    grey = picture()[:, :, 0]
    as_rgb = np.repeat(grey[:, :, None], 3, axis=2)
    rgb = Image.fromarray(picture())
    cases = {
        "grey": (encoded(Image.fromarray(grey)), as_rgb),
        "grey with alpha": (encoded(Image.fromarray(grey).convert("LA")), as_rgb),
        "alpha": (encoded(rgb.convert("RGBA")), picture()),
        "palette": (encoded(Image.fromarray(grey).convert("P")), as_rgb),
        "16 bit": (encoded(Image.fromarray(grey.astype(np.uint16) * 257)), as_rgb),
        "1 bit": (
            encoded(Image.fromarray(grey > 100)),
            np.repeat(((grey > 100) * 255).astype(np.uint8)[:, :, None], 3, axis=2),
        ),
    }
    for name, (data, expected) in cases.items():
        np.testing.assert_array_equal(decode_image(data, name), expected, err_msg=name)


def test_cmyk_becomes_rgb() -> None:
    white = encoded(Image.new("CMYK", (16, 16), (0, 0, 0, 0)), "JPEG")
    assert decode_image(white, "a.jpg").min() > 250


@pytest.mark.parametrize("error", [ValueError, KeyError, OverflowError, SystemError])
def test_whatever_the_decoder_raises_is_damage(
    error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    def convert(*_: object) -> None:
        raise error("palette index out of range")

    data = encode_png(np.zeros((4, 4), dtype=np.uint8))
    monkeypatch.setattr(Image.Image, "convert", convert)
    with pytest.raises(InputError, match=r"p\.png: is a damaged .*palette index out of range"):
        decode_image(data, "p.png")


def turned(orientation: int, kind: str) -> bytes:
    exif = Image.Exif()
    exif[0x0112] = orientation
    buffer = io.BytesIO()
    Image.fromarray(picture(48, 64)).save(buffer, kind, exif=exif)
    return buffer.getvalue()


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_orientation_turns_no_pixel_but_tells_what_is_up(orientation: int, kind: str) -> None:
    data = turned(orientation, kind)
    assert decode_image(data, "a").shape == (48, 64, 3)
    header = image_header(data, "a")
    assert (header.width, header.height) == (64, 48)
    # Where the top rows of the upright image, by Pillow, lie in the stored one.
    rows = np.broadcast_to(np.arange(48)[:, None], (48, 64))
    columns = np.broadcast_to(np.arange(64)[None], (48, 64))
    upright = []
    for values in (columns, rows):
        image = Image.fromarray(values.astype(np.uint8))
        image.getexif()[0x0112] = orientation
        upright.append(np.asarray(ImageOps.exif_transpose(image), dtype=np.int64))
    top, bottom = (np.array([np.mean(values[row]) for values in upright]) for row in (0, -1))
    assert header.up == tuple(np.sign(top - bottom))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_tiff_is_turned_as_it_says(orientation: int) -> None:
    data = turned(orientation, "TIFF")
    image = Image.fromarray(picture(48, 64))
    image.getexif()[0x0112] = orientation
    expected = np.asarray(ImageOps.exif_transpose(image))
    np.testing.assert_array_equal(decode_image(data, "a"), expected)
    height, width = expected.shape[:2]
    assert image_header(data, "a") == ImageHeader("TIFF", width, height)


@pytest.mark.filterwarnings("ignore:Corrupt EXIF data")
@pytest.mark.parametrize(
    "exif", [b"", b"Exif", b"II*\0\xff\xff\xff\xff", b"MM\0*\0\0\0\x08\xff\xff"]
)
def test_damaged_exif_data_says_nothing_of_up(exif: bytes) -> None:
    buffer = io.BytesIO()
    Image.fromarray(picture()).save(buffer, "JPEG", exif=b"Exif\0\0" + exif)
    assert image_header(buffer.getvalue(), "a.jpg").up == (0, -1)


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("kind", ["png", "tiff"])
def test_few_bits_in_16_are_stretched(bits: int, kind: str) -> None:
    generator = np.random.default_rng(bits)
    for shape in ((48, 64), (48, 64, 3)):
        stored = generator.integers(0, 1 << bits, shape).astype(np.uint16)
        stored[0, 0] = (1 << bits) - 1
        expected = (stored >> (bits - 8)).astype(np.uint8)
        # OpenCV writes blue first.
        good, data = cv2.imencode(f".{kind}", stored if stored.ndim == 2 else stored[:, :, ::-1])
        assert good
        if expected.ndim == 2:
            expected = np.repeat(expected[:, :, None], 3, axis=2)
        np.testing.assert_array_equal(decode_image(data.tobytes(), "a"), expected)
        header = image_header(data.tobytes(), "a")
        assert (header.bits, header.is_plain) == (16, False)


def test_a_dark_image_of_12_bits_stays_darker_than_a_bright_one() -> None:
    dark, bright = (np.full((12, 16), value, dtype=np.uint16) for value in (1100, 4000))
    found = [decode_image(encoded(Image.fromarray(image)), "a").max() for image in (dark, bright)]
    assert found == [1100 >> 4, 4000 >> 4]


def test_fractions_are_refused() -> None:
    image = Image.fromarray(np.linspace(0.0, 1.0, 192, dtype=np.float32).reshape(12, 16))
    with pytest.raises(InputError, match="fractions"):
        decode_image(encoded(image, "TIFF"), "a.tif")


def test_a_jpeg_with_more_pictures_behind_it_is_a_jpeg() -> None:
    buffer = io.BytesIO()
    first = Image.fromarray(picture())
    first.save(buffer, "MPO", save_all=True, append_images=[first])
    data = buffer.getvalue()
    assert image_header(data, "a.jpg") == ImageHeader("JPEG", 64, 48)
    assert decode_image(data, "a.jpg").shape == (48, 64, 3)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_truncated_image_is_refused(share: float) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (60, 80, 3)).astype(np.uint8)
    files = {"a.jpg": encode_jpeg(noise), "a.png": encode_png(noise)}
    for suffix, kind in (("tif", "TIFF"), ("webp", "WEBP")):
        files[f"a.{suffix}"] = encoded(Image.fromarray(noise), kind)
    for name, data in files.items():
        with pytest.raises(InputError, match=rf"^{name}: is a damaged") as caught:
            decode_image(data[: int(len(data) * share)], name)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("data", [b"", b"# a text\n", b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"])
def test_what_is_no_image_is_refused(data: bytes) -> None:
    with pytest.raises(InputError, match=r"^a\.jpg: is "):
        image_header(data, "a.jpg")
    with pytest.raises(InputError, match=r"^a\.jpg: is "):
        decode_image(data, "a.jpg")


@pytest.mark.parametrize("kind", ["GIF", "BMP"])
def test_other_formats_are_refused(kind: str) -> None:
    with pytest.raises(InputError, match="neither a JPEG, PNG, TIFF nor WebP"):
        decode_image(encoded(Image.fromarray(picture()), kind), "a.png")


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("size", [(10_001, 10_000), (60_000, 60_000), (2**31 - 1, 2**31 - 1)])
def test_a_png_that_claims_to_be_huge_is_refused_before_it_is_decoded(
    size: tuple[int, int],
) -> None:
    assert size[0] * size[1] > MAX_PIXELS
    data = png_that_claims(*size)
    tracemalloc.start()
    for read in (image_header, decode_image, decode_depth):
        with pytest.raises(InputError, match=r"bomb\.png: (has|is)"):
            read(data, "bomb.png")
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


def test_a_png_of_less_data_than_it_claims_is_refused() -> None:
    with pytest.raises(InputError, match="damaged"):
        decode_image(png_that_claims(3000, 3000), "a.png")


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_a_flipped_bit_in_a_png_is_detected_or_without_effect(draw: st.DataObject) -> None:
    image = picture(12, 16)
    data = bytearray(encode_png(image))
    position = draw.draw(st.integers(0, len(data) - 1))
    data[position] ^= 1 << draw.draw(st.integers(0, 7))
    try:
        decoded = decode_image(bytes(data), "a.png")
    except InputError:
        return
    np.testing.assert_array_equal(decoded, image)


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_a_damaged_jpeg_is_refused_or_decoded(draw: st.DataObject) -> None:
    # A JPEG has no checksum: other colours are all that one can ask for, but nothing else.
    data = bytearray(encode_jpeg(picture(16, 16)))
    for _ in range(draw.draw(st.integers(1, 4))):
        data[draw.draw(st.integers(0, len(data) - 1))] = draw.draw(st.integers(0, 255))
    with contextlib.suppress(InputError):
        assert decode_image(bytes(data), "a.jpg").shape[2] == 3


def test_depth_keeps_16_bits() -> None:
    depth = np.arange(12 * 16, dtype=np.uint16).reshape(12, 16) * 300
    read = decode_depth(encoded(Image.fromarray(depth)), "depth.png")
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, depth)
    with pytest.raises(InputError, match="instead of 16-bit grey"):
        decode_depth(encode_png(picture()), "depth.png")


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "folder.png").mkdir()
    os.mkfifo(tmp_path / "pipe.png")
    with (tmp_path / "large.png").open("wb") as file:
        file.truncate(300 * 1024**2)
    cases = {
        "missing": "no such file",
        "empty": "is empty",
        "folder": "is not a file",
        "pipe": "is not a file",
        "large": "is larger than 256 MiB",
    }
    for name, reason in cases.items():
        for read in (read_image_bytes, read_image_header):
            with pytest.raises(InputError, match=rf"(?i){name}\.png: .*{reason}"):
                read(tmp_path / f"{name}.png")


def test_bytes_are_read_as_they_are(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"anything")
    assert read_image_bytes(tmp_path / "a.png") == b"anything"
