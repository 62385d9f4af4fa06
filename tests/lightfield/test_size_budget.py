"""The size budget against the file and against the arrays that are really made."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipelines.dataset.images import encode_png
from pipelines.geometry.camera import Camera
from pipelines.geometry.plane import plane_from_coefficients
from pipelines.lightfield.depth_storage import as_stored
from pipelines.lightfield.description import describe_scene
from pipelines.lightfield.scene import PlaneEstimate, Scene
from pipelines.lightfield.scene_file import identifier_of, load_scene, save_scene
from pipelines.lightfield.size_budget import LOCALIZE_SIDE, RESOLUTIONS, SizeBudget, size_budget
from pipelines.lightfield.views import views_of_scene
from tests.lightfield_samples import looking


def scene_of_two(with_depth: bool) -> Scene:
    """A photo larger than localization needs it, of odd sizes, and one smaller; noise."""
    generator = np.random.default_rng(3)
    cameras = (
        Camera("PINHOLE", 331, 223, (300.0, 300.0, 165.0, 111.0)),
        Camera("PINHOLE", 40, 57, (50.0, 50.0, 19.5, 28.0)),
    )
    sizes = [(camera.height, camera.width) for camera in cameras]
    photos = tuple(
        encode_png(generator.integers(0, 256, (*size, 3)).astype(np.uint8)) for size in sizes
    )
    depth = tuple(
        as_stored(generator.uniform(0.2, 0.5, size).astype(np.float32), np.ones(size, dtype=bool))
        for size in ((201, 299), (30, 21))
    )
    scene = Scene(
        image_names=("large.png", "small.png"),
        encoded_images=photos,
        timestamps=np.arange(2.0),
        cameras=cameras,
        camera_index=np.arange(2),
        world_from_camera=np.array([looking([x, -2.0, 1.0], [x, 0.0, 1.0]) for x in (0.0, 0.5)]),
        surface=PlaneEstimate(plane_from_coefficients([0.0, -1.0, 0.0, 0.0]), 0, 0, "given", 1.0),
        base_from_camera=None,
        bounds=np.array([-2.0, 2.0, -3.0, 0.5]),
        scale_source="odometry",
        identifier="",
        depth=depth if with_depth else (),
    )
    identifier = identifier_of(
        photos, cameras, scene.camera_index, scene.world_from_camera, scene.surface, None,
        scene.depth,
    )  # fmt: skip
    return replace(scene, identifier=identifier)


def budget_of(folder: Path, with_depth: bool) -> tuple[Scene, SizeBudget]:
    path = folder / "scene.h5"
    save_scene(path, scene_of_two(with_depth), overwrite=False)
    scene = load_scene(path)
    return scene, size_budget(path, scene)


@pytest.mark.parametrize("with_depth", [True, False])
def test_the_parts_of_the_file_are_the_file(tmp_path: Path, with_depth: bool) -> None:
    scene, budget = budget_of(tmp_path, with_depth)
    assert sum(budget.file.values()) == (tmp_path / "scene.h5").stat().st_size
    photos = sum(map(len, scene.encoded_images))
    # Photos are stored as they are, with four bytes of checksum a chunk.
    assert photos < budget.file["photos"] < 1.001 * photos + 8
    raw = sum(2 * depth.inverse_depth.size for depth in scene.depth)
    # 16 bits of noise hardly get smaller.
    assert (0.7 * raw <= budget.file["depth_maps"] <= 1.05 * raw) if with_depth else raw == 0
    assert budget.file["rest"] > 0


@pytest.mark.parametrize("with_depth", [True, False])
@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_memory_is_that_of_the_arrays(tmp_path: Path, resolution: str, with_depth: bool) -> None:
    scene, budget = budget_of(tmp_path, with_depth)
    arrays = views_of_scene(scene, RESOLUTIONS[resolution]).arrays
    photos = arrays.texels.nbytes + sum(map(len, scene.encoded_images))
    depth = arrays.inverse_depth.nbytes + sum(
        of_view.inverse_depth.nbytes + of_view.confident.nbytes for of_view in scene.depth
    )
    parts = budget.memory[resolution]
    assert (parts["photos"], parts["depth_maps"]) == (photos, depth)


def test_the_resolution_of_localization_is_its_default() -> None:
    from pipelines.localize.measurement_model import VIEW_RESOLUTION_FACTOR
    from pipelines.localize.settings import LocalizerSettings

    assert VIEW_RESOLUTION_FACTOR * LocalizerSettings().fine_width == LOCALIZE_SIDE


def test_info_says_totals_shares_and_what_a_view_takes(tmp_path: Path) -> None:
    _, budget = budget_of(tmp_path, True)
    summary = describe_scene(tmp_path / "scene.h5")
    facts = json.loads(json.dumps(summary.to_dict()))["size"]
    for parts in (facts["file_bytes"], *facts["memory_bytes"].values()):
        named = [parts[name] for name in ("photos", "depth_maps", "rest")]
        assert parts["total"] == sum(named)
        assert parts["per_view"]["total"] == pytest.approx(parts["total"] / 2, abs=1)
        assert parts["share"]["photos"] == named[0] / sum(named)
    rows = {row[0]: row[1] for row in summary.table()}
    total = sum(budget.file.values())
    assert f"photos {budget.file['photos'] / total:.0%}" in rows["file"]
    assert f"{total / 1e6:.1f} MB" in rows["file"]
    assert "in memory, 320 px" in rows
