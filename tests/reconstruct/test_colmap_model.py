"""COLMAP's binary files: as COLMAP itself reads them, and safe against what strangers send."""

import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipelines.artifacts.errors import InputError
from pipelines.geometry.pose import inverse
from pipelines.reconstruct.colmap_model import colmap_params, read_model, write_model
from pipelines.reconstruct.reconstruction import MODEL_FILES, save_reconstruction
from tests.reconstruct_samples import small_reconstruction


@pytest.fixture(scope="module")
def model_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    save_reconstruction(folder / "r", small_reconstruction(folder), {}, overwrite=False)
    return folder / "r" / "sparse"


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in MODEL_FILES}


def write_contents(folder: Path, files: dict[str, bytes]) -> None:
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)


def test_colmap_itself_reads_the_same_model_and_its_pixels_are_half_a_pixel_further(
    model_folder: Path,
) -> None:
    # In a process of its own, so that a crash fails this test alone.
    script = (
        "import pycolmap, sys, json\n"
        "r = pycolmap.Reconstruction(sys.argv[1])\n"
        "im = r.images[2]\n"
        "print(json.dumps([r.num_points3D(), im.name, im.camera.params.tolist(),\n"
        " im.cam_from_world().matrix().tolist(), im.points2D[0].xy.tolist(),\n"
        " r.points3D[im.points2D[0].point3D_id].xyz.tolist(), im.camera.model.name]))\n"
        "r.write(sys.argv[2])\n"
    )
    again = model_folder.parent.parent / "again"
    again.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", script, str(model_folder), str(again)],
        capture_output=True,
        text=True,
        check=True,
    )
    count, name, params, matrix, pixel, point, kind = json.loads(done.stdout)
    expected = small_reconstruction(model_folder)
    first = int(np.flatnonzero(expected.observations[:, 1] == 1)[0])
    assert (count, name, kind) == (30, "rgb/1 ä.jpg", "PINHOLE")
    np.testing.assert_allclose(params, [250.0, 251.0, 160.75, 119.5])
    np.testing.assert_allclose(matrix, inverse(expected.world_from_camera)[1, :3], atol=1e-12)
    np.testing.assert_allclose(pixel, expected.observed_pixels[first] + 0.5)
    np.testing.assert_allclose(point, expected.points[expected.observations[first, 0]])
    # What COLMAP writes comes back without a shift.
    ours, theirs = read_model(model_folder), read_model(again)
    assert ours.cameras == theirs.cameras
    for one, other in zip(ours.images, theirs.images, strict=True):
        np.testing.assert_array_equal(one.keypoints, other.keypoints)
        np.testing.assert_allclose(one.camera_from_world, other.camera_from_world, atol=1e-12)


def test_the_centre_of_a_symmetric_camera_is_half_its_size_for_colmap() -> None:
    camera = small_reconstruction(Path()).cameras[0]
    assert colmap_params(camera) == (500.0, 320.0, 240.0, 0.01)


def test_writing_what_was_read_gives_the_same_bytes(model_folder: Path, tmp_path: Path) -> None:
    write_model(tmp_path, read_model(model_folder))
    read_back, original = contents(tmp_path), contents(model_folder)
    assert read_back["cameras.bin"] == original["cameras.bin"]
    assert read_back["points3D.bin"] == original["points3D.bin"]
    # Quaternions pass through matrices and may change in the last bit.
    assert len(read_back["images.bin"]) == len(original["images.bin"])


@pytest.mark.parametrize("name", MODEL_FILES)
def test_a_file_cut_anywhere_is_refused_by_name(
    model_folder: Path, tmp_path: Path, name: str
) -> None:
    files = contents(model_folder)
    whole = files[name]
    for length in [*range(40), *range(40, len(whole), 37), len(whole) - 1]:
        write_contents(tmp_path, {**files, name: whole[:length]})
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            read_model(tmp_path)


@pytest.mark.parametrize("name", MODEL_FILES)
def test_bytes_after_the_end_are_refused(model_folder: Path, tmp_path: Path, name: str) -> None:
    files = contents(model_folder)
    write_contents(tmp_path, {**files, name: files[name] + b"\0"})
    with pytest.raises(InputError, match=r"bytes after the last entry"):
        read_model(tmp_path)


@pytest.mark.parametrize("name", MODEL_FILES)
@pytest.mark.parametrize("count", [2**63, 2**64 - 1, 10**9])
def test_a_huge_count_is_refused_before_anything_is_allocated(
    model_folder: Path, tmp_path: Path, name: str, count: int
) -> None:
    files = contents(model_folder)
    write_contents(tmp_path, {**files, name: struct.pack("<Q", count) + files[name][8:]})
    with pytest.raises(InputError, match=f"{count} entries declared"):
        read_model(tmp_path)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_flipped_bytes_give_a_model_or_an_input_error(
    model_folder: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    files = contents(model_folder)
    name = data.draw(st.sampled_from(MODEL_FILES))
    damaged = bytearray(files[name])
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    folder = tmp_path_factory.mktemp("flipped")
    write_contents(folder, {**files, name: bytes(damaged)})
    try:
        model = read_model(folder)
    except InputError:
        return  # anything else is a failure
    assert np.all(np.isfinite(model.points.positions))


def test_a_track_that_names_a_missing_keypoint_is_refused(
    model_folder: Path, tmp_path: Path
) -> None:
    files = contents(model_folder)
    damaged = bytearray(files["points3D.bin"])
    damaged[-4:] = struct.pack("<I", 10_000)  # the last entry of the last track
    write_contents(tmp_path, {**files, "points3D.bin": bytes(damaged)})
    with pytest.raises(InputError, match=r"points3D\.bin: a track names a keypoint"):
        read_model(tmp_path)


def test_a_device_instead_of_a_file_is_refused(model_folder: Path, tmp_path: Path) -> None:
    files = contents(model_folder)
    del files["images.bin"]
    write_contents(tmp_path, files)
    (tmp_path / "images.bin").symlink_to("/dev/zero")
    with pytest.raises(InputError, match=r"images\.bin: is not a file"):
        read_model(tmp_path)
    (tmp_path / "images.bin").unlink()
    with pytest.raises(InputError, match=r"images\.bin: does not exist"):
        read_model(tmp_path)
