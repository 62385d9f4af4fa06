"""Plain lossy WebP only, checked before a decoder sees it."""

import contextlib
import io
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, features

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.errors import InputError, StageError
from pipelines.dataset.images import (
    ImageHeader,
    decode_image,
    encode_jpeg,
    encode_png,
    image_header,
)
from pipelines.dataset.webp import decode_webp, encode_webp, webp_header

READERS = (webp_header, decode_webp)


def picture(height: int = 48, width: int = 64) -> ImageArray:
    rows, columns = np.mgrid[:height, :width]
    channels = (3 * columns, 2 * rows + columns, 255 - 2 * columns)
    return np.stack([np.clip(c, 0, 255) for c in channels], axis=2).astype(np.uint8)


def saved(image: Image.Image, **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", **options)
    return buffer.getvalue()


def in_container(kind: bytes, content: bytes) -> bytes:
    """A WebP file of one chunk."""
    chunk = kind + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)
    return b"RIFF" + struct.pack("<I", 4 + len(chunk)) + b"WEBP" + chunk


def frame_of(data: bytes) -> bytes:
    return data[20 : 20 + struct.unpack_from("<I", data, 16)[0]]


def refusal(data: bytes) -> str:
    """What both readers say of it."""
    texts = []
    for read in READERS:
        with pytest.raises(InputError, match=r"^a\.webp: (is|has) ") as caught:
            read(data, "a.webp")
        texts.append(str(caught.value))
    assert texts[0] == texts[1]
    assert "\n" not in texts[0]
    return texts[0]


@pytest.mark.parametrize("size", [(48, 64), (47, 63), (1, 1), (16, 500)])
def test_what_is_written_is_read(size: tuple[int, int]) -> None:
    image = picture(*size)
    data = encode_webp(image, 90)
    assert webp_header(data, "a.webp") == ImageHeader("WEBP", size[1], size[0])
    decoded = decode_webp(data, "a.webp")
    assert decoded.shape == image.shape
    assert np.abs(decoded.astype(int) - image).mean() < 6.0
    assert encode_webp(image, 90) == data


def test_a_lower_quality_takes_less_and_differs_more() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    files = [encode_webp(noise, quality) for quality in (20, 90)]
    errors = [np.abs(decode_webp(f, "a.webp").astype(int) - noise).mean() for f in files]
    assert len(files[0]) < len(files[1])
    assert errors[0] > errors[1]


def test_other_kinds_of_webp_are_refused() -> None:
    image = Image.fromarray(picture())
    clear = image.convert("RGBA")
    clear.putalpha(100)
    others = {
        "lossless": saved(image, lossless=True),
        "transparent": saved(clear),
        "animated": saved(image, save_all=True, append_images=[image.rotate(90)]),
        "metadata": saved(image, exif=b"Exif\0\0MM\0*\0\0\0\x08\0\0\0\0\0\0"),
    }
    for name, data in others.items():
        assert data[12:16] != b"VP8 ", name
        assert "another kind" in refusal(data)


@pytest.mark.parametrize("encode", [encode_jpeg, encode_png])
def test_other_formats_are_refused(encode: object) -> None:
    assert "no WebP" in refusal(encode(picture()))  # type: ignore[operator]


@pytest.mark.parametrize("kind", ["lossy", "lossless", "with transparency"])
def test_a_photo_is_refused_by_its_claim_before_a_decoder_sees_it(kind: str) -> None:
    image = Image.fromarray(picture())
    if kind == "with transparency":
        image.putalpha(128)
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", lossless=kind == "lossless")
    data = bytearray(buffer.getvalue())
    header = image_header(bytes(data), "a.webp")
    assert (header.format, header.width, header.height) == ("WEBP", *image.size)
    if kind == "lossy":
        data[26:30] = struct.pack("<HH", 16383, 16383)
    elif kind == "lossless":
        data[21:25] = struct.pack("<I", 16383 | 16383 << 14)
    else:
        data[24:30] = struct.pack("<I", 16383)[:3] * 2
    tracemalloc.start()
    for read in (image_header, decode_image):
        with pytest.raises(InputError, match="is a WebP of more than"):
            read(bytes(data), "a.webp")
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


def test_other_codecs_inside_are_refused() -> None:
    for content in (encode_jpeg(picture()), encode_png(picture()), b"", b"\0" * 10):
        assert "no frame" in refusal(in_container(b"VP8 ", content))
    lossless = saved(Image.fromarray(picture()), lossless=True)
    assert "no frame" in refusal(in_container(b"VP8 ", frame_of(lossless)))


@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 0.6, 0.95])
def test_a_truncated_file_is_refused(share: float) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (60, 80, 3)).astype(np.uint8)
    data = encode_webp(noise, 80)
    refusal(data[: int(len(data) * share)])
    refusal(data[:-2])
    refusal(data + b"\0\0")
    # Truncated within a container whose sizes fit.
    short = in_container(b"VP8 ", frame_of(data)[: int((len(data) - 20) * share)])
    with pytest.raises(InputError, match=r"^a\.webp: is a damaged"):
        decode_webp(short, "a.webp")


@pytest.mark.parametrize("size", [(16383, 16383), (10001, 10000), (0, 10), (10, 0)])
def test_sizes_are_checked_before_anything_is_decoded(size: tuple[int, int]) -> None:
    frame = bytearray(frame_of(encode_webp(picture(), 80)))
    struct.pack_into("<HH", frame, 6, *size)
    tracemalloc.start()
    assert f"{size[0]}x{size[1]} pixels" in refusal(in_container(b"VP8 ", bytes(frame)))
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_a_frame_of_less_data_than_it_claims_is_refused() -> None:
    frame = bytearray(frame_of(encode_webp(picture(), 80)))
    struct.pack_into("<HH", frame, 6, 3000, 3000)
    data = in_container(b"VP8 ", bytes(frame))
    assert webp_header(data, "a.webp").width == 3000
    with pytest.raises(InputError, match="damaged"):
        decode_webp(data, "a.webp")


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_a_damaged_file_is_refused_or_decoded(draw: st.DataObject) -> None:
    data = bytearray(encode_webp(picture(16, 16), 80))
    for _ in range(draw.draw(st.integers(1, 4))):
        data[draw.draw(st.integers(0, len(data) - 1))] = draw.draw(st.integers(0, 255))
    with contextlib.suppress(InputError):
        header = webp_header(bytes(data), "a.webp")
        if header.width * header.height < 1_000_000:
            assert decode_webp(bytes(data), "a.webp").shape == (header.height, header.width, 3)


def test_a_pillow_without_webp_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    data = encode_webp(picture(), 80)
    monkeypatch.setattr(features, "check", lambda name: name != "webp")
    for call in (lambda: decode_webp(data, "a.webp"), lambda: encode_webp(picture(), 80)):
        with pytest.raises(StageError, match="pip install") as caught:
            call()
        assert "\n" not in str(caught.value)
