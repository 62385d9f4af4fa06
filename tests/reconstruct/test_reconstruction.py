"""The reconstruction folder: nothing is lost on the way, nothing false is believed."""

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.provenance import sha256_of_file
from pipelines.reconstruct.description import describe_reconstruction
from pipelines.reconstruct.reconstruction import (
    MODEL_FILES,
    load_reconstruction,
    save_reconstruction,
)
from tests.reconstruct_samples import small_reconstruction


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_reconstruction(tmp_path / "r", small_reconstruction(tmp_path), {}, overwrite=False)
    return tmp_path / "r"


def change(folder: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    path = folder / "reconstruction.json"
    description = json.loads(path.read_text(encoding="utf-8"))
    edit(description)
    path.write_text(json.dumps(description), encoding="utf-8")


def rehash(folder: Path) -> None:
    files = {f"sparse/{name}": sha256_of_file(folder / "sparse" / name) for name in MODEL_FILES}
    change(folder, lambda description: description.update(files=files))


def test_everything_comes_back(folder: Path) -> None:
    expected, found = small_reconstruction(folder.parent), load_reconstruction(folder)
    for field in dataclasses.fields(expected):
        one, other = getattr(expected, field.name), getattr(found, field.name)
        if isinstance(one, np.ndarray):
            np.testing.assert_allclose(other, one, atol=1e-14, err_msg=field.name)
        else:
            assert other == one, field.name


def test_the_same_reconstruction_gives_the_same_bytes(folder: Path) -> None:
    before = {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
    save_reconstruction(folder, small_reconstruction(folder.parent), {}, overwrite=True)
    assert before == {
        path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


def test_without_points_it_is_still_a_model(tmp_path: Path) -> None:
    full = small_reconstruction(tmp_path)
    bare = dataclasses.replace(
        full,
        points=np.empty((0, 3)),
        observations=np.empty((0, 2), dtype=np.int64),
        observed_pixels=np.empty((0, 2)),
        point_colors=np.empty((0, 3), dtype=np.uint8),
        point_errors=np.empty(0),
    )
    save_reconstruction(tmp_path / "r", bare, {}, overwrite=False)
    found = load_reconstruction(tmp_path / "r")
    assert found.points.shape == (0, 3)
    assert found.observations.shape == (0, 2)
    np.testing.assert_allclose(found.world_from_camera, full.world_from_camera, atol=1e-14)


def test_images_are_found_when_both_move_or_the_reconstruction_alone(tmp_path: Path) -> None:
    pictures = tmp_path / "a" / "pictures"
    content = small_reconstruction(pictures)
    (pictures / "rgb").mkdir(parents=True)
    (pictures / content.image_names[0]).write_bytes(b"")
    save_reconstruction(tmp_path / "a" / "r", content, {}, overwrite=False)
    shutil.copytree(tmp_path / "a" / "r", tmp_path / "elsewhere" / "deep" / "r")
    assert load_reconstruction(tmp_path / "elsewhere" / "deep" / "r").image_root == pictures
    (tmp_path / "a").rename(tmp_path / "b")
    assert load_reconstruction(tmp_path / "b" / "r").image_root == tmp_path / "b" / "pictures"


def test_a_folder_that_exists_is_kept(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="exists already"):
        save_reconstruction(folder, small_reconstruction(tmp_path), {}, overwrite=False)
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("x", encoding="utf-8")
    with pytest.raises(InputError, match="lfnav did not make it"):
        save_reconstruction(foreign, small_reconstruction(tmp_path), {}, overwrite=True)
    assert (foreign / "thesis.tex").exists()


def test_a_reconstruction_without_views_cannot_be_made_or_read(folder: Path) -> None:
    empty = small_reconstruction(folder)
    with pytest.raises(OptionError, match="at least one image"):
        dataclasses.replace(empty, image_names=())
    nothing = (0).to_bytes(8, "little")
    (folder / "sparse" / "images.bin").write_bytes(nothing)
    (folder / "sparse" / "points3D.bin").write_bytes(nothing)
    rehash(folder)
    change(folder, lambda description: description.update(images=[]))
    with pytest.raises(InputError, match=r"reconstruction\.json: .* holds no image with a pose"):
        load_reconstruction(folder)


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("method", 3, "method is a int, expected str"),
        ("method", "magic", "method 'magic' is unknown"),
        ("scale_source", None, "scale_source is a NoneType"),
        ("images", {}, "images is a dict, expected list"),
        ("images", ["a"], r"images\[0\] is not a JSON object"),
        ("images", [{"name": "a.jpg"}], "its images are not those of"),
        ("dropped", [], "dropped is a list"),
        ("dropped", {"a": 1}, "dropped does not map names to reasons"),
        ("statistics", "none", "statistics is a str"),
        ("base_from_camera", [[1, 2], [3]], "not a rigid 4x4 transform"),
        ("base_from_camera", "identity", "not a rigid 4x4 transform"),
        ("base_from_camera", [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]], "rigid"),
        ("image_root", 5, "image_root is a int"),
        ("files", None, "files is a NoneType"),
        ("schema_version", 99, "written by a newer lfnav"),
        ("schema_version", True, "schema_version is a bool"),
        ("schema_version", 0, "schema_version 0 does not exist"),
        ("format", "something", "is not the description of a reconstruction"),
    ],
)
def test_wrong_types_and_values_are_named(folder: Path, key: str, value: object, text: str) -> None:
    change(folder, lambda description: description.update({key: value}))
    with pytest.raises(InputError, match=text) as caught:
        load_reconstruction(folder)
    assert "\n" not in str(caught.value)
    assert caught.value.path.name == "reconstruction.json"


@pytest.mark.parametrize("name", ["/etc/passwd", "../x.jpg", "a/../../x.jpg", "", "a\0b"])
def test_a_name_that_leads_out_of_the_folder_is_refused(folder: Path, name: str) -> None:
    def edit(description: dict[str, Any]) -> None:
        description["images"][0]["name"] = name

    change(folder, edit)
    with pytest.raises(InputError, match="leads out of the folder"):
        load_reconstruction(folder)


@pytest.mark.parametrize("time", ["now", None, 1e309, True, -1e18])
def test_a_time_that_is_none_is_refused(folder: Path, time: object) -> None:
    def edit(description: dict[str, Any]) -> None:
        description["images"][1]["timestamp"] = time

    change(folder, edit)
    with pytest.raises(InputError, match=r"timestamp|JSON"):
        load_reconstruction(folder)


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", b"[" * 100_000, b'{"a": NaN}'])
def test_a_description_that_is_no_json_object_is_refused(folder: Path, content: bytes) -> None:
    (folder / "reconstruction.json").write_bytes(content)
    with pytest.raises(InputError, match=r"reconstruction\.json: "):
        load_reconstruction(folder)


def test_missing_folders_and_files_are_named(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere: does not exist"):
        load_reconstruction(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty: is not a reconstruction"):
        load_reconstruction(tmp_path / "empty")
    (folder / "sparse" / "cameras.bin").unlink()
    with pytest.raises(InputError, match=r"cameras\.bin: does not exist"):
        load_reconstruction(folder)


def test_one_flipped_bit_is_noticed(folder: Path) -> None:
    path = folder / "sparse" / "points3D.bin"
    content = bytearray(path.read_bytes())
    content[30] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"points3D\.bin: is damaged"):
        load_reconstruction(folder)


def test_a_description_is_complete_and_plain_json(folder: Path) -> None:
    summary = describe_reconstruction(folder)
    values = json.loads(json.dumps(summary.to_dict(), allow_nan=False))
    assert values["images"] == 4
    assert values["images_total"] == 5
    assert values["dropped"] == {"rgb/9.jpg": "no pose"}
    assert ("images with a pose", "4 of 5") in summary.table()
