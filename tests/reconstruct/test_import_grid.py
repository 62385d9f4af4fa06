"""Camera grids: where the cameras stand, which files they are, and what is missing."""

from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.importers.camera_grid import grid_files, read_camera_grid
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.reconstruct.import_stage import import_source
from pipelines.reconstruct.reconstruction import load_reconstruction
from tests.import_samples import SHARED, project, refusal, write_picture

POINT = np.array([0.13, 2.0, -0.07])  # in front of the grid, which looks along +y
GRID = ["--spacing", "0.1", "--focal", "40"]


def write_grid(folder: Path, rows: list[int], columns: list[int]) -> None:
    for row in rows:
        for column in columns:
            write_picture(folder / f"r{row:02d}_c{column:02d}.png", 100 * row + column)


def test_a_known_point_lands_where_the_geometry_of_two_planes_says(tmp_path: Path) -> None:
    write_grid(tmp_path / "source", [0, 1], [0, 1, 2])
    settings = ImportSettings(spacing=(0.1, 0.2), focal=40.0)
    summary = import_source(
        tmp_path / "source", tmp_path / "out", settings, overwrite=False, progress=no_progress
    )
    content = load_reconstruction(tmp_path / "out" / "reconstruction")
    assert content.scale_source == "given poses"
    assert content.image_root == tmp_path / "out"
    assert content.image_names[:4] == tuple(
        f"rgb/r0{r}_c0{c}.png" for r, c in ("00", "01", "02", "10")
    )
    for row in (0, 1):
        for column in (0, 1, 2):
            pose = content.world_from_camera[3 * row + column]
            expected = (
                15.5 + 40.0 * (POINT[0] - 0.1 * column) / 2.0,
                11.5 + 40.0 * (-POINT[2] - 0.2 * row) / 2.0,
            )
            np.testing.assert_allclose(project(content.cameras[0], pose, POINT), expected)
    # Upright, in the data set as well, and the images are the source's, byte by byte.
    np.testing.assert_allclose(content.world_from_camera[:, :3, 1], [[0.0, 0.0, -1.0]] * 6)
    data = load_dataset(tmp_path / "out")
    assert data.camera == content.cameras[0]
    assert data.groundtruth is not None
    np.testing.assert_allclose(data.groundtruth.poses, content.world_from_camera, atol=1e-8)
    source = tmp_path / "source" / "r01_c02.png"
    assert data.read_image_bytes(5) == source.read_bytes()
    assert summary.next_command() == f"lfnav model {tmp_path}/out/reconstruction -o scene.h5"


def test_the_position_is_the_index_times_the_spacing_also_on_every_second_place(
    tmp_path: Path,
) -> None:
    write_grid(tmp_path / "below", [2, 4], [0, 6, 2, 4])
    recording = read_camera_grid(tmp_path, ImportSettings(spacing=(0.5, 0.5), fov=90.0))
    assert recording.world_from_camera is not None
    centres = recording.world_from_camera[:, :3, 3]
    np.testing.assert_allclose(centres[0], [0.0, 0.0, -1.0])
    np.testing.assert_allclose(centres[-1], [3.0, 0.0, -2.0])
    assert recording.cameras[0].intrinsics.fx == pytest.approx(16.0)  # 32 pixels in 90 degrees


def test_the_plane_in_focus_lies_still_in_all_images(tmp_path: Path) -> None:
    write_grid(tmp_path, [0, 1, 2], [0, 1])
    settings = ImportSettings(spacing=(0.1, 0.1), focal=40.0, focus=2.0)
    recording = read_camera_grid(tmp_path, settings)
    assert recording.world_from_camera is not None
    pixels = [
        project(recording.cameras[frame.camera], pose, POINT)
        for frame, pose in zip(recording.frames, recording.world_from_camera, strict=True)
    ]
    np.testing.assert_allclose(pixels, [pixels[0]] * 6, atol=1e-9)
    # Seen from the middle of the grid the principal point is the image centre.
    expected = (15.5 + 40.0 * (POINT[0] - 0.05) / 2.0, 11.5 + 40.0 * (-POINT[2] - 0.1) / 2.0)
    np.testing.assert_allclose(pixels[0], expected)
    # What is nearer moves against the camera.
    near = POINT * [1.0, 0.5, 1.0]
    first, second = (
        project(recording.cameras[index], recording.world_from_camera[index], near)
        for index in (0, 1)
    )
    assert second[0] - first[0] == pytest.approx(40.0 * 0.1 * (1.0 / 2.0 - 1.0 / 1.0))


def test_many_cameras_make_a_reconstruction_without_camera_toml(tmp_path: Path) -> None:
    write_grid(tmp_path / "source", [0, 1], [0, 1])
    settings = ImportSettings(spacing=(0.1, 0.1), focal=40.0, focus=2.0)
    import_source(
        tmp_path / "source", tmp_path / "out", settings, overwrite=False, progress=no_progress
    )
    content = load_reconstruction(tmp_path / "out" / "reconstruction")
    assert len(content.cameras) == 4
    assert content.camera_index.tolist() == [0, 1, 2, 3]
    assert load_dataset(tmp_path / "out").camera is None


def test_other_names_by_a_pattern(tmp_path: Path) -> None:
    for row, column in ((0, 0), (0, 1)):
        write_picture(tmp_path / f"out_{row}_{column}_-3.25_.png", column)
    files = grid_files(tmp_path, "out_{row}_{col}_*.png")
    assert sorted(files) == [(0, 0), (0, 1)]
    for pattern in ("{row}.png", "{row}{row}{col}", "a/{row}_{col}"):
        with pytest.raises(OptionError, match="once each"):
            grid_files(tmp_path, pattern)


@pytest.mark.parametrize(
    ("missing", "place"),
    [(["r01_c01.png"], "row 1, column 1"), (["r01_c00.png", "r01_c01.png"], "row 1, column 0")],
)
def test_empty_places_are_named_or_accepted(
    tmp_path: Path, missing: list[str], place: str, capfd: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "source"
    write_grid(source, [0, 1, 2, 3], [0, 1])
    for name in missing:
        (source / name).unlink()
    error = refusal([str(source), *GRID], tmp_path / "out", capfd)
    assert f"no image for {place}" in error
    assert "--allow-missing" in error
    settings = ImportSettings(spacing=(0.1, 0.1), focal=40.0, allow_missing=True)
    recording = read_camera_grid(source, settings)
    assert len(recording.frames) == 8 - len(missing)
    assert "empty" in recording.notes[0]


def test_indices_that_span_a_trillion_places_are_refused_at_once(tmp_path: Path) -> None:
    for name in ("r0_c0.png", "r999999_c999999.png", "r1_c1.png"):
        write_picture(tmp_path / name, 0)
    with pytest.raises(InputError, match="999999999997 of 1000000000000"):
        read_camera_grid(tmp_path, ImportSettings(spacing=(1.0, 1.0), focal=10.0))


def test_grids_that_contradict_themselves(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "source"
    write_grid(source, [0], [0, 1])
    assert "needs --spacing" in refusal([str(source)], tmp_path / "out", capfd)
    arguments = [str(source), "--spacing", "0.1"]
    assert "--focal PX or --fov DEG" in refusal(arguments, tmp_path / "out", capfd)
    assert "exclude" in refusal([*arguments, "--focal", "9", "--fov", "9"], tmp_path / "o", capfd)
    assert "not be zero" in refusal([*GRID, str(source), "--spacing", "0"], tmp_path / "o", capfd)
    assert "METRES or X,Y" in refusal(
        [*GRID, str(source), "--spacing", "a"], tmp_path / "o", capfd, 2
    )
    write_picture(source / "r0_c1.png", 0)
    assert "same place" in refusal(["--from", "grid", str(source), *GRID], tmp_path / "out", capfd)
    (source / "r0_c1.png").unlink()
    write_picture(source / "r00_c01.png", 0, width=30)
    assert "r00_c01.png: is 30x24" in refusal([str(source), *GRID], tmp_path / "out", capfd)
    (source / "r00_c01.png").write_bytes((source / "r00_c00.png").read_bytes()[:-60])
    assert "damaged" in refusal([str(source), *GRID], tmp_path / "out", capfd)


@pytest.mark.skipif(not (SHARED / "cards").is_dir(), reason="needs the cards light field")
def test_the_cards_light_field_is_complete() -> None:
    settings = ImportSettings(spacing=(0.005, 0.005), fov=40.0, focus=1.0)
    recording = read_camera_grid(SHARED / "cards", settings)
    assert len(recording.frames) == len(recording.cameras) == 81
    assert recording.notes == ()
    assert recording.world_from_camera is not None
    np.testing.assert_allclose(recording.world_from_camera[-1, :3, 3], [0.08, 0.0, -0.08])
