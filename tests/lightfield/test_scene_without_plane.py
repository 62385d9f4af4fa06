"""Photos that look in all directions: depth maps without a plane, from the photos to the pose."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.dock.clearance import Clearance
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene, save_scene
from pipelines.lightfield.stereo_neighbours import UsualDepths, choose_neighbours, depth_range
from pipelines.lightfield.usual_depths import depths_of_maps, depths_of_photos, depths_of_points
from pipelines.localize.localizer import region_of
from pipelines.localize.settings import LocalizerSettings
from pipelines.reconstruct.reconstruction import load_reconstruction
from pipelines.render.choices import Quality
from pipelines.render.renderer import Renderer
from tests.chain_samples import lfnav, succeed
from tests.room_samples import (
    CAMERA,
    CAMERA_HEIGHT,
    exact_depth,
    poses_all_around,
    seen,
    write_dataset,
)


@pytest.fixture(scope="module")
def reconstruction(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room")
    data = write_dataset(folder / "map", poses_all_around())
    poses = data / "groundtruth.txt"
    succeed("reconstruct", data, "-o", folder / "r", "--method", "poses", "--poses", poses)
    return folder / "r"


@pytest.fixture(scope="module")
def scene_path(reconstruction: Path) -> Path:
    path = reconstruction.parent / "scene.h5"
    succeed("model", reconstruction, "-o", path, "--geometry", "depth", "--depth", "given")
    return path


@pytest.fixture(scope="module")
def scene(scene_path: Path) -> Scene:
    return load_scene(scene_path)


def test_depth_is_computed_where_no_plane_is(reconstruction: Path, tmp_path: Path) -> None:
    path = tmp_path / "computed.h5"
    succeed("model", reconstruction, "-o", path, "--geometry", "depth")
    found = load_scene(path)
    assert found.surface is None
    errors = []
    for view, pose in zip(found.depth, found.world_from_camera, strict=True):
        errors.append(np.abs(view.inverse_depth * seen(pose)[1] - 1.0)[view.confident])
    assert np.median(np.concatenate(errors)) < 0.03
    assert np.mean([view.confident.mean() for view in found.depth]) > 0.5


def test_one_plane_for_photos_in_all_directions_is_refused_as_before(
    reconstruction: Path, tmp_path: Path
) -> None:
    refused = lfnav("model", reconstruction, "-o", tmp_path / "s.h5", "--geometry", "plane")
    assert refused.code == 1
    assert "all directions" in refused.err
    assert refused.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_photos_are_selected_without_a_plane(reconstruction: Path, tmp_path: Path) -> None:
    path = tmp_path / "few.h5"
    options = ["--geometry", "depth", "--depth", "given", "--max-views", "20"]
    succeed("model", reconstruction, "-o", path, *options)
    few = load_scene(path)
    assert len(few) == 20
    # They look everywhere, not at one wall.
    assert np.linalg.norm(few.world_from_camera[:, :3, 2].mean(axis=0)) < 0.35


def test_info_says_that_there_is_no_plane(scene_path: Path, scene: Scene) -> None:
    text = succeed("info", scene_path)
    assert "none: depth maps alone show the surface" in text
    assert scene.ground is not None
    assert f"{scene.ground.area:.1f} m" in text
    facts = json.loads(succeed("info", scene_path, "--json"))
    assert facts["plane"] is None
    assert facts["free_ground_m2"] == pytest.approx(scene.ground.area)


def test_held_out_views_are_rendered_and_there_is_no_plane_to_compare_with(
    scene_path: Path, tmp_path: Path
) -> None:
    test = write_dataset(tmp_path / "test", poses_all_around(0.8, 3))
    found = json.loads(succeed("evaluate", scene_path, "--dataset", test, "--json"))
    assert set(found["baselines"]) == {"nearest_photo"}
    assert found["psnr_db"]["mean"] > found["baselines"]["nearest_photo"]["psnr_db"]["mean"] + 3.0
    assert "one plane" not in succeed("evaluate", scene_path, "--dataset", test)
    refused = lfnav("evaluate", scene_path, "--dataset", test, "--quality", "plane")
    assert refused.code == 1
    assert "the scene has none" in refused.err
    assert refused.err.count("\n") == 1


def test_a_plane_that_is_asked_for_is_named_as_missing(scene: Scene) -> None:
    with pytest.raises(StageError, match="no plane"):
        _ = scene.plane
    with pytest.raises(OptionError, match="the scene has none"):
        Renderer.of_scene(scene, quality=Quality.PLANE)


def test_distances_from_the_surface_do_without_a_plane(scene: Scene) -> None:
    clearance = Clearance(scene, CAMERA_HEIGHT)
    assert clearance.distance(np.array([1.5, 1.0, 0.0])) == pytest.approx(1.0, abs=0.15)
    assert clearance.is_inside(np.array([-0.5, 1.0, 0.0]))


def test_the_file_is_schema_2_and_reads_back_the_same(
    scene_path: Path, scene: Scene, tmp_path: Path
) -> None:
    copy = tmp_path / "copy.h5"
    save_scene(copy, scene)
    again = load_scene(copy)
    assert again.surface is None
    assert again.ground is not None
    assert scene.ground is not None
    np.testing.assert_array_equal(again.ground.cells, scene.ground.cells)
    np.testing.assert_array_equal(again.ground.corner, scene.ground.corner)
    assert again.ground.cell == scene.ground.cell
    with h5py.File(scene_path) as file:
        # Programs that know schema 1 alone refuse it in one line (``check_schema``).
        assert file.attrs["schema_version"] == 2


def test_a_scene_with_a_plane_is_written_as_older_programs_read_it(
    reconstruction: Path, tmp_path: Path
) -> None:
    path = tmp_path / "plane.h5"
    succeed("model", reconstruction, "-o", path, "--plane", "0,0,1,0")
    with h5py.File(path) as file:
        assert file.attrs["schema_version"] == 1
        assert "ground" not in file
    with_plane = load_scene(path)
    assert with_plane.ground is None
    assert region_of(with_plane, LocalizerSettings()).ground is None


def test_neither_plane_nor_depth_is_refused(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    save_scene(path, replace(scene, depth=()))
    with pytest.raises(InputError, match="neither a plane nor depth maps"):
        load_scene(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ground/cells", np.zeros((3, 3), dtype=np.bool_)),
        ("ground/cells", np.ones(9, dtype=np.bool_)),
        ("ground/cells", np.ones((3, 3))),
        ("ground/cell", np.float64(-0.1)),
        ("ground/cell", np.float64("nan")),
        ("ground/corner", np.array([np.inf, 0.0])),
        ("ground/corner", np.zeros(3)),
        ("ground/corner", None),
    ],
)
def test_ground_that_makes_no_sense(
    scene_path: Path, tmp_path: Path, name: str, value: np.ndarray | None
) -> None:
    path = tmp_path / "s.h5"
    path.write_bytes(scene_path.read_bytes())
    with h5py.File(path, "r+") as file:
        del file[name]
        if value is not None:
            file.create_dataset(name, data=value, fletcher32=np.ndim(value) > 0 or None)
    with pytest.raises(InputError) as caught:
        load_scene(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_usual_depths_from_the_photos_are_those_of_the_room() -> None:
    poses = poses_all_around()
    true = np.concatenate([seen(pose)[1].ravel() for pose in poses])
    found = depths_of_photos([seen(pose)[0] for pose in poses], [CAMERA] * len(poses), poses)
    assert found.typical == pytest.approx(float(np.median(true)), rel=0.15)
    assert found.near < np.percentile(true, 2.0)
    assert found.far > np.percentile(true, 98.0)


def test_usual_depths_are_found_from_a_guess_that_is_far_off() -> None:
    """Photos 3 cm apart: what they show is 70 times as far away as the nearest other photo."""
    poses = np.repeat(poses_all_around(1.0), 2, axis=0)
    poses[1::2, :3, 3] += 0.03 * poses[1::2, :3, 0]
    true = np.concatenate([seen(pose)[1].ravel() for pose in poses])
    found = depths_of_photos([seen(pose)[0] for pose in poses], [CAMERA] * len(poses), poses)
    assert found.typical == pytest.approx(float(np.median(true)), rel=0.25)


def test_photos_that_tell_no_depth() -> None:
    poses = poses_all_around()
    photos = [seen(pose)[0] for pose in poses[:2]]
    with pytest.raises(StageError, match="two photos"):
        depths_of_photos(photos[:1], [CAMERA], poses[:1])
    with pytest.raises(StageError, match="one place"):
        depths_of_photos(photos, [CAMERA] * 2, poses[[0, 0]])
    # Back to back: neither shows what the other does, however far away it is.
    apart = np.stack([poses[0], poses[4]])
    apart[1, :3, 3] += 0.5 * apart[1, :3, 2]
    with pytest.raises(StageError, match="how far away"):
        depths_of_photos([seen(pose)[0] for pose in apart], [CAMERA] * 2, apart)


def test_usual_depths_from_maps_and_points(reconstruction: Path) -> None:
    poses = poses_all_around()
    true = np.concatenate([seen(pose)[1].ravel() for pose in poses])
    of_maps = depths_of_maps(exact_depth(poses))
    assert of_maps is not None
    assert of_maps.typical == pytest.approx(float(np.median(true)), rel=0.02)
    assert depths_of_maps(()) is None
    source = load_reconstruction(reconstruction)
    assert depths_of_points(source) is None
    # A point a photo, 2 m before it.
    points = source.world_from_camera[:, :3, 3] + 2.0 * source.world_from_camera[:, :3, 2]
    numbers = np.arange(len(points))
    observed = replace(
        source,
        points=points,
        observations=np.stack([numbers, numbers], axis=1),
        observed_pixels=np.zeros((len(points), 2)),
    )
    of_points = depths_of_points(observed)
    assert of_points is not None
    assert of_points.typical == pytest.approx(2.0)


def test_neighbours_and_range_without_a_plane() -> None:
    poses = poses_all_around()
    usual = UsualDepths(0.5, 1.8, 7.0)
    nothing, unobserved = np.empty((0, 3)), np.empty((0, 2), dtype=np.int64)
    assert depth_range(3, poses, CAMERA, usual, nothing, unobserved) == (0.5, 7.0)
    chosen = choose_neighbours(poses, [CAMERA] * len(poses), usual, nothing, unobserved, 4)
    for view, neighbours in enumerate(chosen):
        assert len(neighbours) == 4
        # They look the same way, from elsewhere.
        assert (poses[neighbours, :3, 2] @ poses[view, :3, 2] > 0.6).all()
        assert (np.linalg.norm((poses[neighbours] - poses[view])[:, :2, 3], axis=1) > 0.1).all()
