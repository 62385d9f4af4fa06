"""Files of a folder that are not taken are counted and named, never passed over."""

import io
import logging
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.description import describe_dataset

PICTURE = np.arange(12 * 16 * 3, dtype=np.uint8).reshape(12, 16, 3)
HEIC = b"\0\0\0\x18ftypheic" + bytes(200)


def write(path: Path, kind: str, picture: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> None:
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, kind)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(buffer.getvalue())


def phone_photos(folder: Path, heic: int = 3) -> None:
    """Three photos each of JPEG, TIFF and WebP, and some HEIC."""
    folder.mkdir()
    for number, (suffix, kind) in enumerate(
        3 * [(".JPG", "JPEG"), (".tif", "TIFF"), (".webp", "WEBP")]
    ):
        write(folder / f"IMG_{number}{suffix}", kind, PICTURE)
    for number in range(heic):
        (folder / f"IMG_{20 + number}.HEIC").write_bytes(HEIC)


def test_all_photos_are_read_or_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    phone_photos(tmp_path / "photos")
    with caplog.at_level(logging.WARNING):
        found = describe_dataset(tmp_path / "photos")
    assert len(found.dataset) == 9
    for index in range(9):
        assert found.dataset.read_image(index).shape == (12, 16, 3)
    assert found.dataset.left_out == {"HEIC": 3}
    assert ("not taken", "3 HEIC (convert them to JPEG)") in found.table()
    assert found.to_dict()["not_taken"] == {"HEIC": 3}
    assert "9 images are taken, not 3 HEIC (convert them to JPEG)" in caplog.text


def test_a_folder_without_any_other_file_says_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    phone_photos(tmp_path / "photos", heic=0)
    with caplog.at_level(logging.WARNING):
        found = describe_dataset(tmp_path / "photos")
    assert not found.dataset.left_out
    assert "not taken" not in [row[0] for row in found.table()]
    assert not caplog.text


def test_each_reason_is_counted(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    phone_photos(photos)
    (photos / "._IMG_0.JPG").write_bytes(b"\0\5\x16\7")
    (photos / ".DS_Store").write_bytes(b"data")
    (photos / "DSC_1.NEF").write_bytes(b"data")
    (photos / "MVI_1.MOV").write_bytes(b"data")
    (photos / "notes.txt").write_text("a note")
    (photos / "gone.jpg").symlink_to("nowhere.jpg")
    write(photos / "more" / "IMG_90.JPG", "JPEG", PICTURE)
    (photos / "more" / "IMG_91.heic").write_bytes(HEIC)
    dataset = load_dataset(photos)
    assert len(dataset) == 9
    expected = {
        "HEIC": 3,
        "raw": 1,
        "not a file": 1,
        "hidden": 1,
        "in sub-folders": 2,
        "video": 1,
        "of other kinds": 1,
    }
    assert dict(dataset.left_out) == expected
    assert list(dataset.left_out) == list(expected)


def test_photos_in_the_one_sub_folder_and_what_lies_beside_them(tmp_path: Path) -> None:
    phone_photos(tmp_path / "photos")
    (tmp_path / "IMG_99.HEIC").write_bytes(HEIC)
    dataset = load_dataset(tmp_path)
    assert len(dataset) == 9
    assert dict(dataset.left_out) == {"HEIC": 4}


def test_a_folder_of_nothing_else_names_what_is_there(tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / f"IMG_{number}.HEIC").write_bytes(HEIC)
    with pytest.raises(InputError, match=r"no images .*not read: 3 HEIC \(convert them to JPEG\)"):
        load_dataset(tmp_path)


def test_a_sub_folder_of_nothing_else_is_looked_at_too(tmp_path: Path) -> None:
    (tmp_path / "DCIM").mkdir()
    (tmp_path / "DCIM" / "IMG_0.HEIC").write_bytes(HEIC)
    (tmp_path / "DSC_1.NEF").write_bytes(b"data")
    with pytest.raises(InputError, match=r"no images .*not read: 1 raw, 1 HEIC"):
        load_dataset(tmp_path)


def test_a_listed_heic_is_named(tmp_path: Path) -> None:
    # Whatever its suffix: phones' exports call them .JPG too.
    (tmp_path / "a.JPG").write_bytes(HEIC)
    (tmp_path / "rgb.txt").write_text("0.0 a.JPG\n")
    with pytest.raises(InputError, match=r"a\.JPG: is a HEIC image.*convert it to JPEG"):
        load_dataset(tmp_path)


def test_a_list_says_what_is_taken(tmp_path: Path) -> None:
    phone_photos(tmp_path / "photos")
    (tmp_path / "rgb.txt").write_text("0.0 photos/IMG_0.JPG\n")
    dataset = load_dataset(tmp_path)
    assert len(dataset) == 1
    assert not dataset.left_out
