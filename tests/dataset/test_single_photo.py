"""A photo by itself: upright pixels, and the camera that took it."""

from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageOps

from pipelines.artifacts.errors import InputError
from pipelines.dataset.camera_file import CameraFile, format_camera_file
from pipelines.dataset.images import decode_image, image_header
from pipelines.dataset.single_photo import read_photo
from pipelines.geometry.camera import Camera

WIDTH, HEIGHT = 60, 40
MAP_CAMERA = Camera("SIMPLE_PINHOLE", WIDTH, HEIGHT, (50.0, 29.5, 19.5))


def written(
    path: Path, *, orientation: int | None = None, film_focal: object = None, kind: str = "JPEG"
) -> Path:
    """A photo with a bright corner, and what its EXIF data say."""
    pixels = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    pixels[:10, :20] = (250, 120, 30)
    exif = Image.Exif()
    if orientation is not None:
        exif[ExifTags.Base.Orientation] = orientation
    if film_focal is not None:
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = film_focal
    Image.fromarray(pixels).save(
        path, kind, exif=exif, **({"lossless": True} if kind == "WEBP" else {})
    )
    return path


@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_it_is_turned_upright_as_pillow_does(tmp_path: Path, orientation: int, kind: str) -> None:
    path = written(tmp_path / "p", orientation=orientation, film_focal=28, kind=kind)
    portrait = Camera("SIMPLE_PINHOLE", HEIGHT, WIDTH, (50.0, 19.5, 29.5))
    found = read_photo(path, None, [MAP_CAMERA, portrait])
    with Image.open(path) as stored:
        upright = ImageOps.exif_transpose(stored)
    np.testing.assert_array_equal(found.image, np.asarray(upright))
    assert (found.camera.width, found.camera.height) == upright.size
    np.testing.assert_array_equal(decode_image(found.encoded, "it"), found.image)
    assert image_header(found.encoded, "it").format == "PNG"


def test_what_is_upright_is_kept_as_stored(tmp_path: Path) -> None:
    path = written(tmp_path / "p.jpg", orientation=1, film_focal=28)
    assert read_photo(path, None, []).encoded == path.read_bytes()


def test_the_focal_length_is_that_of_the_same_diagonal_on_film(tmp_path: Path) -> None:
    found = read_photo(written(tmp_path / "p.jpg", film_focal=28), None, [])
    half_angle = np.arctan(np.hypot(36.0, 24.0) / 2.0 / 28.0)
    half_diagonal = np.hypot(WIDTH, HEIGHT) / 2.0
    assert found.camera.intrinsics.fx == pytest.approx(half_diagonal / np.tan(half_angle))
    assert found.camera.params[1:] == (29.5, 19.5)
    assert found.is_rough


def test_a_photo_of_the_maps_size_has_the_maps_camera(tmp_path: Path) -> None:
    found = read_photo(written(tmp_path / "p.jpg"), None, [MAP_CAMERA, MAP_CAMERA])
    assert found.camera == MAP_CAMERA
    assert not found.is_rough


def test_unless_its_own_focal_length_is_another(tmp_path: Path) -> None:
    other = read_photo(written(tmp_path / "a.jpg", film_focal=50), None, [MAP_CAMERA])
    assert other.camera.intrinsics.fx == pytest.approx(83.3, abs=0.1)
    assert other.is_rough
    same = read_photo(written(tmp_path / "b.jpg", film_focal=29), None, [MAP_CAMERA])
    assert same.camera == MAP_CAMERA


def test_two_cameras_of_its_size_are_no_answer(tmp_path: Path) -> None:
    other = Camera("SIMPLE_PINHOLE", WIDTH, HEIGHT, (70.0, 29.5, 19.5))
    with pytest.raises(InputError, match=r"does not say its focal length.*--camera"):
        read_photo(written(tmp_path / "p.jpg"), None, [MAP_CAMERA, other])


def test_a_camera_file_wins_and_must_fit(tmp_path: Path) -> None:
    path = written(tmp_path / "p.jpg", orientation=6, film_focal=28)
    upright = Camera("SIMPLE_PINHOLE", HEIGHT, WIDTH, (55.0, 19.5, 29.5))
    for camera, fits in ((upright, True), (MAP_CAMERA, False)):
        file = tmp_path / "c.toml"
        file.write_text(format_camera_file(CameraFile(camera, None, None)))
        if fits:
            assert read_photo(path, file, [MAP_CAMERA]).camera == camera
            continue
        with pytest.raises(InputError, match=r"60x40 pixels, and p\.jpg has 40x60"):
            read_photo(path, file, [MAP_CAMERA])


@pytest.mark.parametrize("focal", [0, 1, 65535])
def test_focal_lengths_that_no_lens_has_are_none(tmp_path: Path, focal: int) -> None:
    with pytest.raises(InputError, match="does not say its focal length"):
        read_photo(written(tmp_path / "p.jpg", film_focal=focal), None, [])


def test_damaged_exif_data_are_none(tmp_path: Path) -> None:
    path = written(tmp_path / "p.jpg", orientation=6, film_focal=28)
    data = bytearray(path.read_bytes())
    start = data.index(b"Exif\0\0") + 6
    data[start + 8 : start + 24] = bytes(range(200, 216))
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match="does not say its focal length"):
        read_photo(path, None, [])
    assert read_photo(path, None, [MAP_CAMERA]).image.shape == (HEIGHT, WIDTH, 3)
