"""transforms.json: OpenGL poses, pixel centres at .5, and files that should not be believed."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.importers.nerfstudio import read_nerfstudio
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.reconstruct.import_stage import import_source
from pipelines.reconstruct.reconstruction import load_reconstruction
from tests.import_samples import project, refusal, write_picture

# A camera at (1, 2, 3) that looks along the world's x axis, upright: right is -y, back is -x.
LOOKS_ALONG_X = [
    [0.0, 0.0, -1.0, 1.0],
    [-1.0, 0.0, 0.0, 2.0],
    [0.0, 1.0, 0.0, 3.0],
    [0.0, 0.0, 0.0, 1.0],
]


def sample(folder: Path, **changes: Any) -> dict[str, Any]:
    """A valid file of two frames; the second has another position."""
    content: dict[str, Any] = {
        "fl_x": 40.0,
        "fl_y": 42.0,
        "cx": 16.5,
        "cy": 12.25,
        "w": 32,
        "h": 24,
        "aabb_scale": 16,
        "frames": [],
    }
    for number in (10, 2):
        write_picture(folder / "images" / f"f{number}.png", number)
        matrix = [list(row) for row in LOOKS_ALONG_X]
        matrix[1][3] = 2.0 + 0.1 * number
        name = f"./images/f{number}" + (".png" if number == 2 else "")
        content["frames"].append({"file_path": name, "transform_matrix": matrix})
    content.update(changes)
    return content


def write(folder: Path, content: Any) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def test_times_of_the_frames_are_taken_over(tmp_path: Path) -> None:
    content = sample(tmp_path / "source")
    # In the order of time, which is not that of the names; in nanoseconds.
    for frame, seconds in zip(content["frames"], (1403636579.5, 1403636580.25), strict=True):
        frame["timestamp"] = round(seconds * 1e9)
    write(tmp_path / "source", content)
    import_source(
        tmp_path / "source",
        tmp_path / "out",
        ImportSettings(),
        overwrite=False,
        progress=no_progress,
    )
    found = load_reconstruction(tmp_path / "out" / "reconstruction")
    assert found.image_names == ("rgb/f10.png", "rgb/f2.png")
    np.testing.assert_allclose(found.timestamps, [1403636579.5, 1403636580.25], atol=1e-6)
    np.testing.assert_allclose(found.world_from_camera[:, 1, 3], [3.0, 2.2])
    assert load_dataset(tmp_path / "out").timestamps.tolist() == found.timestamps.tolist()


@pytest.mark.parametrize(
    ("times", "note"),
    [
        ((1.0, None), "timestamp is missing for 1 frames: times are not taken"),
        ((1.0, 1.0), "frames have the same timestamp: times are not taken"),
    ],
)
def test_times_that_cannot_be_taken_over(
    tmp_path: Path, times: tuple[float | None, ...], note: str
) -> None:
    content = sample(tmp_path / "source")
    for frame, time in zip(content["frames"], times, strict=True):
        frame["timestamp"] = time
    recording = read_nerfstudio(write(tmp_path / "source", content))
    assert [frame.timestamp for frame in recording.frames] == [0.0, 1.0]
    assert recording.notes == (note,)


def test_a_known_point_lands_on_the_pixel_that_opengl_says(tmp_path: Path) -> None:
    source = write(tmp_path / "source", sample(tmp_path / "source"))
    recording = read_nerfstudio(source)
    assert [frame.name for frame in recording.frames] == ["rgb/f2.png", "rgb/f10.png"]
    assert recording.world_from_camera is not None
    # 4 in front, 0.5 to the right (-y), 0.25 up of the camera at y = 2.2.
    point = np.array([1.0 + 4.0, 2.2 - 0.5, 3.0 + 0.25])
    pixel_half = np.array([16.5 + 40.0 * 0.5 / 4.0, 12.25 - 42.0 * 0.25 / 4.0])
    found = project(recording.cameras[0], recording.world_from_camera[0], point)
    np.testing.assert_allclose(found, pixel_half - 0.5)


def test_a_data_set_and_a_reconstruction_come_out(tmp_path: Path) -> None:
    source = write(tmp_path / "source", sample(tmp_path / "source"))
    output = tmp_path / "out"
    import_source(
        source / "transforms.json", output, ImportSettings(), overwrite=False, progress=no_progress
    )
    content = load_reconstruction(output / "reconstruction")
    assert content.scale_source == "arbitrary"
    data = load_dataset(output)
    assert data.image_names == content.image_names
    assert data.read_image_bytes(1) == (source / "images" / "f10.png").read_bytes()
    # With a scale the world grows, the rays stay.
    settings = ImportSettings(scale=2.0)
    import_source(source, tmp_path / "big", settings, overwrite=False, progress=no_progress)
    big = load_reconstruction(tmp_path / "big" / "reconstruction")
    assert big.scale_source == "--scale"
    np.testing.assert_allclose(
        big.world_from_camera[:, :3, 3], 2.0 * content.world_from_camera[:, :3, 3], atol=1e-12
    )
    np.testing.assert_allclose(
        big.world_from_camera[:, :3, :3], content.world_from_camera[:, :3, :3], atol=1e-12
    )


def test_the_reconstruction_moves_with_its_data_set(tmp_path: Path) -> None:
    source = write(tmp_path / "source", sample(tmp_path / "source"))
    import_source(source, tmp_path / "out", ImportSettings(), overwrite=False, progress=no_progress)
    assert ".partial" not in (tmp_path / "out/reconstruction/reconstruction.json").read_text()
    (tmp_path / "out").rename(tmp_path / "elsewhere")
    content = load_reconstruction(tmp_path / "elsewhere" / "reconstruction")
    assert content.image_root == tmp_path / "elsewhere"


def test_intrinsics_of_a_frame_override_and_an_angle_is_a_focal_length(tmp_path: Path) -> None:
    content = sample(tmp_path)
    for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        del content[key]
    content["camera_angle_x"] = np.pi / 2.0
    content["frames"][0]["fl_x"] = 20.0
    content["frames"][0]["k1"] = 0.01
    recording = read_nerfstudio(write(tmp_path, content))
    first, second = (recording.cameras[frame.camera] for frame in recording.frames)
    # f2 is the second of the file: 32 pixels in 90 degrees, the principal point in the middle.
    assert first.model == "PINHOLE"
    assert first.params == pytest.approx((16.0, 16.0, 15.5, 11.5))
    assert second.model == "OPENCV"
    assert second.params == pytest.approx((20.0, 20.0, 15.5, 11.5, 0.01, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("changes", "model", "tail"),
    [
        ({"k1": 0.1, "p2": 0.2}, "OPENCV", (0.1, 0.0, 0.0, 0.2)),
        ({"k3": 0.3}, "FULL_OPENCV", (0.0, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0)),
        ({"camera_model": "OPENCV_FISHEYE", "k4": 0.4}, "OPENCV_FISHEYE", (0.0, 0.0, 0.0, 0.4)),
        ({"is_fisheye": True, "k1": 0.1}, "OPENCV_FISHEYE", (0.1, 0.0, 0.0, 0.0)),
        ({"camera_model": "RADIAL_FISHEYE", "k2": 0.2}, "OPENCV_FISHEYE", (0.0, 0.2, 0.0, 0.0)),
    ],
)
def test_distortion(
    tmp_path: Path, changes: dict[str, Any], model: str, tail: tuple[float, ...]
) -> None:
    camera = read_nerfstudio(write(tmp_path, sample(tmp_path, **changes))).cameras[0]
    assert camera.model == model
    assert camera.params[4:] == tail


def test_a_three_row_matrix_and_rounded_digits_are_poses(tmp_path: Path) -> None:
    content = sample(tmp_path)
    matrix = np.array(LOOKS_ALONG_X)[:3] + 3e-5
    content["frames"][0]["transform_matrix"] = matrix.tolist()
    poses = read_nerfstudio(write(tmp_path, content)).world_from_camera
    assert poses is not None
    rotation = poses[1, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


def set_matrix(matrix: Any) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        content["frames"][1]["transform_matrix"] = matrix

    return change


def set_value(key: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda content: content.update({key: value})


def set_file(name: Any) -> Callable[[dict[str, Any]], None]:
    return lambda content: content["frames"][1].update({"file_path": name})


SINGULAR = [[1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0], [0, 0, 0, 1]]
SCALED = [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]
MIRROR = [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (set_matrix(SINGULAR), r"frames\[1\].transform_matrix is singular"),
        (set_matrix(np.zeros((4, 4)).tolist()), "last row"),
        (set_matrix(SCALED), "not rigid"),
        (set_matrix(MIRROR), "mirrors"),
        (set_matrix([[1, 2], [3, 4]]), "shape"),
        (set_matrix([[1, 2], [3]]), "no matrix"),
        (set_matrix("x"), "is a str, expected list"),
        (set_matrix([["a"] * 4] * 4), "no matrix of numbers"),
        (set_matrix([[1e300] * 4] * 4), "huge"),
        (set_file("images/gone.png"), "images/gone.png: is not there"),
        (set_file("../outside.png"), "leads out of the folder"),
        (set_file("images/../../outside.png"), "leads out of the folder"),
        (set_file("/etc/passwd"), "leads out of the folder"),
        (set_file("a\0b"), "leads out of the folder"),
        (set_file("x" * 5000), "is not there"),
        (set_file(7), "expected str"),
        (set_file("images/f10.png"), "names images/f10.png twice"),
        (set_value("frames", []), "names no frames"),
        (set_value("frames", 3), "is a int, expected list"),
        (set_value("frames", [7]), "not a JSON object"),
        (set_value("fl_x", -1.0), "not positive"),
        (set_value("fl_x", "wide"), "fl_x is not a number"),
        (set_value("w", 64), "is 32x24 pixels, transforms.json says w = 64"),
        (set_value("camera_model", "EQUIRECTANGULAR"), "not supported"),
        (set_value("k4", 0.1), "k4 = 0.1"),
    ],
)
def test_what_is_wrong_is_one_line(
    tmp_path: Path,
    change: Callable[[dict[str, Any]], None],
    reason: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    source = tmp_path / "source"
    content = sample(source)
    write_picture(tmp_path / "outside.png", 1)
    change(content)
    write(source, content)
    error = refusal([str(source)], tmp_path / "out", capfd)
    assert re.search(reason, error), error


@pytest.mark.parametrize("text", ["", "{", "[]", '{"frames": NaN}', "[" * 100_000])
def test_what_is_no_json_object(tmp_path: Path, text: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(InputError, match="JSON"):
        read_nerfstudio(tmp_path)


def frames_of(folder: Path, count: int, root: str) -> dict[str, Any]:
    """So many frames whose names begin with ``root``; the photos lie in ``images/``."""
    content = sample(folder, frames=[])
    for number in range(count):
        write_picture(folder / "images" / f"{number:04d}.png", number)
        matrix = [list(row) for row in LOOKS_ALONG_X]
        matrix[1][3] = float(number)
        separator = "\\" if "\\" in root else "/"
        name = f"{root}{separator}{number:04d}.png"
        content["frames"].append({"file_path": name, "transform_matrix": matrix})
    return content


@pytest.mark.parametrize(
    "root",
    [
        "images",
        ".\\images",
        "C:\\Users\\me\\capture\\images",
        "D:/capture/images",
        "/home/somebody/capture/images",
        "{here}/images",
        "../source/images",
    ],
)
def test_names_of_another_machine_are_found_and_the_gone_are_counted(
    tmp_path: Path, root: str
) -> None:
    source = tmp_path / "source"
    write(source, frames_of(source, 11, root.replace("{here}", str(source))))
    assert len(read_nerfstudio(source).frames) == 11
    (source / "images" / "0007.png").unlink()
    recording = read_nerfstudio(source)
    assert [frame.file.name for frame in recording.frames] == [
        f"{number:04d}.png" for number in range(11) if number != 7
    ]
    assert recording.world_from_camera is not None
    np.testing.assert_allclose(
        recording.world_from_camera[:, 1, 3], [n for n in range(11) if n != 7]
    )
    (note,) = (note for note in recording.notes if "left out" in note)
    assert note.startswith("1 of 11 photos are not there")
    assert "0007.png" in note
    (source / "images" / "0008.png").unlink()
    with pytest.raises(InputError, match=r"2 of 11 photos are missing.*--allow-missing"):
        read_nerfstudio(source)
    assert len(read_nerfstudio(source, 0.5).frames) == 9


def test_no_focal_length_is_no_camera(tmp_path: Path) -> None:
    content = sample(tmp_path)
    del content["fl_x"], content["fl_y"]
    with pytest.raises(InputError, match=r"frames\[1\].fl_x is missing"):
        read_nerfstudio(write(tmp_path, content))
