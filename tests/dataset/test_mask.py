"""Masks: what is right is read, what is wrong is one line that names the file and the reason."""

import io
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipelines.artifacts.arrays import BoolArray, ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.provenance import sha256_of_file
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.description import describe_dataset
from pipelines.dataset.images import encode_depth, encode_jpeg, encode_png
from pipelines.experiments.sweep_inputs import dataset_hash
from tests.dataset.test_images import png_that_claims

HEIGHT, WIDTH = 12, 16
CAMERA = f"""
model = "PINHOLE"
width = {WIDTH}
height = {HEIGHT}
params = [20.0, 21.0, 7.5, 5.5]
"""
# The lower quarter is the robot's bumper; used pixels need not be 255.
GREY = np.full((HEIGHT, WIDTH), 255, dtype=np.uint8)
GREY[9:] = 0
GREY[0, 0] = 1


def encoded(image: Image.Image, **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG", **options)
    return buffer.getvalue()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data set of two images with a mask."""
    root = tmp_path / "set"
    (root / "rgb").mkdir(parents=True)
    for number in range(2):
        picture = np.full((HEIGHT, WIDTH, 3), 90 * number, dtype=np.uint8)
        (root / "rgb" / f"{number}.png").write_bytes(encode_png(picture))
    (root / "rgb.txt").write_text("0.5 rgb/0.png\n1.0 rgb/1.png\n")
    (root / "camera.toml").write_text(CAMERA)
    (root / "mask.png").write_bytes(encode_png(GREY))
    return root


def used(root: Path, mask: Path | None = None) -> BoolArray:
    found = load_dataset(root, mask=mask).mask
    assert found is not None
    return found.used


# --- what is right -----------------------------------------------------------------------------


def test_zero_is_left_out_and_anything_else_is_used(folder: Path) -> None:
    mask = load_dataset(folder).mask
    assert mask is not None
    np.testing.assert_array_equal(mask.used[:9], True)
    np.testing.assert_array_equal(mask.used[9:], False)
    assert mask.left_out == pytest.approx(0.25)
    assert mask.path == folder / "mask.png"
    assert mask.sha256 == sha256_of_file(folder / "mask.png")


def test_without_the_file_there_is_no_mask(folder: Path) -> None:
    (folder / "mask.png").unlink()
    assert load_dataset(folder).mask is None


def test_another_mask_can_be_given_and_the_own_one_is_not_looked_at(
    folder: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.png"
    other.write_bytes(encode_png(255 - GREY * (GREY == 255)))
    (folder / "mask.png").write_bytes(b"nonsense")
    expected = GREY != 255
    np.testing.assert_array_equal(used(folder, other), expected)


def test_without_a_camera_a_mask_has_the_size_of_the_images(folder: Path) -> None:
    (folder / "camera.toml").unlink()
    np.testing.assert_array_equal(used(folder), GREY != 0)
    (folder / "mask.png").write_bytes(encode_png(GREY[:-1]))
    with pytest.raises(InputError, match=r"is 16x11 pixels, rgb/0\.png is 16x12"):
        load_dataset(folder)


def test_in_a_plain_folder_the_mask_is_no_image(folder: Path) -> None:
    (folder / "rgb.txt").unlink()
    # The images lie in the one sub-folder, or beside the mask.
    assert load_dataset(folder).image_names == ("rgb/0.png", "rgb/1.png")
    for number in range(2):
        shutil.move(folder / "rgb" / f"{number}.png", folder / f"{number}.png")
    assert load_dataset(folder).image_names == ("0.png", "1.png")
    np.testing.assert_array_equal(used(folder), GREY != 0)


def test_the_encoded_mask_is_zero_or_full(folder: Path) -> None:
    mask = load_dataset(folder).mask
    assert mask is not None
    image = Image.open(io.BytesIO(mask.encoded()))
    assert image.mode == "L"
    np.testing.assert_array_equal(np.asarray(image), 255 * (GREY != 0))


def test_the_description_says_how_much_is_left_out(folder: Path) -> None:
    description = describe_dataset(folder)
    assert ("mask", "25 % of the image left out") in description.table()
    as_json = json.loads(json.dumps(description.to_dict()))
    assert as_json["mask_left_out"] == pytest.approx(0.25)
    (folder / "mask.png").unlink()
    description = describe_dataset(folder)
    assert ("mask", "none") in description.table()
    assert description.to_dict()["mask_left_out"] is None


def test_a_sweep_notices_another_mask(folder: Path) -> None:
    before = dataset_hash(load_dataset(folder))
    (folder / "mask.png").write_bytes(encode_png(np.where(GREY == 1, 0, GREY).astype(np.uint8)))
    assert dataset_hash(load_dataset(folder)) != before


# --- what is wrong -----------------------------------------------------------------------------


def ones(height: int = HEIGHT, width: int = WIDTH) -> ImageArray:
    return np.full((height, width), 255, dtype=np.uint8)


def almost_all_masked() -> bytes:
    grey = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    grey[0, :9] = 255
    return encode_png(grey)


COLOURS = np.full((HEIGHT, WIDTH, 3), 255, dtype=np.uint8)
SIXTEEN = np.full((HEIGHT, WIDTH), 65535, dtype=np.uint16)
PNG = encode_png(GREY)
SPOILT: dict[str, tuple[Callable[[], bytes], str]] = {
    "another size": (lambda: encode_png(ones(HEIGHT, 8)), r"is 8x12 pixels, camera\.toml says 16x"),
    "turned": (lambda: encode_png(ones(WIDTH, HEIGHT)), "is 12x16 pixels"),
    "all masked": (lambda: encode_png(0 * ones()), "leaves no pixel .*0 means not to be used"),
    "almost all masked": (almost_all_masked, r"leaves 4\.7% of the pixels .*less than 5%"),
    "in colour": (lambda: encode_png(COLOURS), "in colour, not 8-bit grey; save it as"),
    "with alpha": (lambda: encoded(Image.fromarray(COLOURS).convert("RGBA")), "transparency"),
    "grey with alpha": (lambda: encoded(Image.fromarray(GREY).convert("LA")), "transparency"),
    "a colour is clear": (lambda: encoded(Image.fromarray(GREY), transparency=3), "transparency"),
    "palette": (lambda: encoded(Image.fromarray(GREY).convert("P")), "palette"),
    "1 bit": (lambda: encoded(Image.fromarray(GREY > 0)), "1-bit"),
    "16 bit": (lambda: encode_depth(SIXTEEN), "16-bit grey, not 8-bit grey"),
    "JPEG": (lambda: encode_jpeg(GREY), "is a JPEG, not a PNG"),
    "text": (lambda: b"left third of the picture", "neither a JPEG, PNG, TIFF nor WebP"),
    "empty": (lambda: b"", "is empty"),
    "truncated": (lambda: PNG[: len(PNG) - 20], "damaged or truncated"),
    "a flipped bit": (lambda: PNG[:50] + bytes([PNG[50] ^ 4]) + PNG[51:], "damaged"),
    "claims to be huge": (lambda: png_that_claims(60_000, 60_000), "pixels"),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_a_bad_mask_is_refused_in_one_line(folder: Path, tmp_path: Path, kind: str) -> None:
    make, reason = SPOILT[kind]
    (folder / "mask.png").write_bytes(make())
    given = tmp_path / "given.png"
    given.write_bytes(make())
    for path, mask in ((folder / "mask.png", None), (given, given)):
        with pytest.raises(InputError, match=reason) as caught:
            load_dataset(folder, mask=mask)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)


def test_a_mask_that_is_named_and_not_there_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.png: cannot be read"):
        load_dataset(folder, mask=tmp_path / "nowhere.png")
    (folder / "mask.png").unlink()
    (folder / "mask.png").symlink_to(tmp_path / "nowhere.png")
    with pytest.raises(InputError, match=r"mask\.png: cannot be read"):
        load_dataset(folder)


def test_a_mask_that_is_no_file_is_refused(folder: Path) -> None:
    (folder / "mask.png").unlink()
    (folder / "mask.png").mkdir()
    with pytest.raises(InputError, match=r"mask\.png: is not a file"):
        load_dataset(folder)
    (folder / "mask.png").rmdir()
    # Reading it would wait for ever.
    os.mkfifo(folder / "mask.png")
    with pytest.raises(InputError, match=r"mask\.png: is not a file"):
        load_dataset(folder)
