"""Light field against view-independent texture: geometry, colours, and a mirror of known optics."""

import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import InputError, StageError
from pipelines.artifacts.stages import no_progress
from pipelines.experiments.flat_parts import FlatPart, parts_inverse_depth, read_flat_parts
from pipelines.experiments.texture import texture_colours
from pipelines.experiments.view_dependence import ViewDependence, measure, with_true_depth
from pipelines.experiments.view_dependence_stage import FIGURE, TABLE, study_view_dependence
from pipelines.geometry.plane import Plane, plane_from_coefficients, plane_inverse_depth
from pipelines.lightfield.views import Views, build_views
from pipelines.render.held_out import HeldOut
from tests.chain_samples import succeed
from tests.depth_samples import BOARD_LEFT, BOARD_RIGHT, BOARD_Y, MAP_PLACES, write_dataset
from tests.lightfield_samples import (
    WALL,
    looking,
    photo,
    pinhole,
    pinhole_rays,
    pixels_of,
    surface_points,
    waves,
)

CAMERA = pinhole(80, 60, 70.0)
PART = FlatPart(np.array([-0.6, 0.0, 0.4]), np.array([1.2, 0, 0]), np.array([0, 0, 1.1]), 0.0)
TILTED = FlatPart(np.array([-0.5, 0.1, 0.3]), np.array([1.0, 0.3, 0]), np.array([0, 0, 1.4]), 0.2)
# The mirror image lies as far behind the mirror as what is mirrored stands before it.
MIRRORED_Y = 1.5


def expected_inverse_depth(part: FlatPart, pose: FloatArray, column: int, row: int) -> float:
    """Of one pixel: its ray cut with the rectangle and with the niche's opening, by elimination."""
    ray = pose[:3, :3] @ np.linalg.inv(CAMERA.matrix()) @ [column, row, 1.0]
    outward = np.cross(part.right, part.up)
    outward /= np.linalg.norm(outward)
    depth = 0.0
    for corner in (part.corner + part.recess * outward, part.corner):
        matrix = np.stack([part.right, part.up, -ray], axis=1)
        u, v, depth = np.linalg.solve(matrix, pose[:3, 3] - corner)
        if not (0.0 <= u <= 1.0 and 0.0 <= v <= 1.0 and depth > 0.0):
            return 0.0
    return float(1.0 / depth)


@pytest.mark.parametrize("part", [PART, TILTED], ids=["flush", "niche"])
def test_pixels_that_look_at_a_part(part: FlatPart) -> None:
    poses = [
        looking([0.2, -2.5, 1.0], [0.0, 0.0, 0.9], 0.2),
        looking([1.6, -1.2, 1.3], [0.2, 0.0, 0.8]),
        looking([-1.0, -1.0, 0.6], [0.0, 0.0, 1.2]),
    ]
    for pose in poses:
        found = part.inverse_depth(pose, CAMERA)
        expected = [
            [expected_inverse_depth(part, pose, x, y) for x in range(0, CAMERA.width, 3)]
            for y in range(0, CAMERA.height, 3)
        ]
        assert 0.02 < np.mean(found > 0.0) < 0.9
        np.testing.assert_allclose(found[::3, ::3], expected, atol=1e-9)
    behind = looking([0.2, 2.5, 1.0], [0.0, 0.0, 0.9])
    assert not part.inverse_depth(behind, CAMERA).any()
    # Of two in one direction the nearer one.
    farther = FlatPart(part.corner + np.array([0.0, 1.0, 0.0]), part.right, part.up, 0.0)
    both = parts_inverse_depth([farther, part], poses[0], CAMERA)
    alone = part.inverse_depth(poses[0], CAMERA)
    np.testing.assert_array_equal(both[alone > 0.0], alone[alone > 0.0])


GOOD = "corner = [0, 1, 2]\nright = [1, 0, 0]\nup = [0, 0, 1]\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[[part]]\ncorner = [", "cannot be read as TOML"),
        ("", r"names no \[\[part\]\]"),
        ("part = 3", r"names no \[\[part\]\]"),
        ("part = [3]", "part 1: corner is not three numbers"),
        (f"[[part]]\n{GOOD}[[part]]\ncorner = [0, 1]", "part 2: corner is not three"),
        ("[[part]]\n" + GOOD.replace("[1, 0, 0]", "[nan, 0, 0]"), "right is not three numbers"),
        ("[[part]]\n" + GOOD.replace("[1, 0, 0]", '["a", 0, 0]'), "right is not three numbers"),
        ("[[part]]\n" + GOOD.replace("[1, 0, 0]", "[1, 0, 1]"), "not the sides of a rectangle"),
        ("[[part]]\n" + GOOD.replace("[1, 0, 0]", "[0, 0, 0]"), "not the sides of a rectangle"),
        (f"[[part]]\n{GOOD}recess = -1", "recess is no depth"),
        (f"[[part]]\n{GOOD}recess = 'a'", "recess is no depth"),
    ],
)
def test_files_of_parts_that_are_wrong(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "parts.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=reason) as caught:
        read_flat_parts(path)
    assert str(path) in str(caught.value)
    with pytest.raises(InputError, match="cannot be read"):
        read_flat_parts(tmp_path / "gone.toml")


def test_texture_is_mean_and_median_over_the_views_that_see_a_point() -> None:
    """Photos of one colour each; the right half of one's surface is hidden by something nearer."""
    places = [[-0.4, -3.0, 1.0], [0.0, -2.5, 1.0], [0.3, -3.2, 1.0], [0.1, -2.0, 1.0]]
    poses = np.array([looking(place, [place[0], 0.0, 1.0]) for place in places])
    colours = (10, 20, 60, 200)
    images = [np.full((60, 80, 3), colour, dtype=np.uint8) for colour in colours]
    depths = [plane_inverse_depth(WALL, pose, CAMERA).astype(np.float32) for pose in poses]
    depths[2][:, 40:] *= 2.0  # its place is x = 0.3: beyond that it sees something nearer
    views = build_views(images, [CAMERA] * 4, poses, depths)
    pose = looking([0.0, -2.8, 1.0], [0.0, 0.0, 1.0])
    pixels = np.array([[30.0, 30.0], [52.0, 30.0], [30.0, 31.0]])
    inverse_depth = np.array([1 / 2.8, 1 / 2.8, 0.0])
    usable = np.array([True, True, True, False])
    found = texture_colours(views, usable, pixels, inverse_depth, pose, CAMERA)
    assert found.seen_by.tolist() == [3, 2, 0]
    np.testing.assert_allclose(found.mean, [[30.0] * 3, [15.0] * 3, [0.0] * 3])
    np.testing.assert_allclose(found.median, [[20.0] * 3, [15.0] * 3, [0.0] * 3])


def mirror_photo(pose: FloatArray) -> ImageArray:
    """A wall with a perfect mirror: in the part, what a plane at y = MIRRORED_Y would show."""
    direct = photo(pose, CAMERA)
    rays = pinhole_rays(CAMERA, pixels_of(CAMERA))
    points, _ = surface_points(pose, rays, behind_the_mirror())
    image = np.where(
        PART.inverse_depth(pose, CAMERA)[..., None] > 0.0, waves(3.0 * points + 2.0), direct
    )
    return np.asarray(np.rint(image), dtype=np.uint8)


def behind_the_mirror() -> Plane:
    return plane_from_coefficients([0.0, -1.0, 0.0, MIRRORED_Y])


def mirror_depth(pose: FloatArray) -> FloatArray:
    """Photo-consistent depth: of the mirror image in the mirror, of the wall beside it."""
    image = plane_inverse_depth(behind_the_mirror(), pose, CAMERA)
    wall = plane_inverse_depth(WALL, pose, CAMERA)
    return np.where(PART.inverse_depth(pose, CAMERA) > 0.0, image, wall)


def mirror_study() -> ViewDependence:
    poses = np.array(
        [
            looking([x, y, 1.0], [0.5 * x, 0.0, 1.0])
            for x in np.linspace(-0.9, 0.9, 5)
            for y in (-3, -2.4)
        ]
    )
    held = [looking([x, -2.7, 1.05], [0.3 * x, 0.0, 1.0]) for x in (-0.5, 0.15, 0.6)]
    depths = [mirror_depth(pose).astype(np.float32) for pose in poses]
    views = build_views(
        [mirror_photo(pose) for pose in poses], [CAMERA] * len(poses), poses, depths
    )
    true = with_true_depth(views, poses, [PART])

    def photos(of: Views) -> Iterator[HeldOut]:
        # The last one looks away from the part.
        for pose in [*held, looking([0.0, -2.5, 1.0], [-4.0, -2.0, 1.0])]:
            yield HeldOut(mirror_photo(pose), CAMERA, pose, of)

    return measure("mirror", photos(views), photos(true), 4, WALL, [PART], no_progress)


def test_a_mirror_looks_right_at_the_depth_of_its_image_and_no_texture_shows_it() -> None:
    found = mirror_study()
    assert found.photos == (0, 1, 2)
    own, true = found.mean("own", "light_field"), found.mean("true", "light_field")
    # Over the image's own depth all photos agree.
    assert own > 30.0
    # On the mirror's surface the light field blurs between views, a texture averages all of them.
    assert own > true + 5.0
    assert found.photos_better_over_own_depth() == 3
    assert found.advantage("true") > 2.0
    assert found.advantage("plane") == pytest.approx(found.advantage("true"), abs=1.0)


def test_true_depth_leaves_what_stands_before_a_part() -> None:
    pose = looking([0.0, -3.0, 1.0], [0.0, 0.0, 1.0])
    depth = mirror_depth(pose).astype(np.float32)
    depth[:, :35] = 1.0
    views = build_views([mirror_photo(pose)], [CAMERA], pose[None], [depth])
    changed = with_true_depth(views, pose[None], [PART]).depth_map(0)
    part = PART.inverse_depth(pose, CAMERA)
    expected = np.where((part > 0.0) & (np.arange(80) >= 35), part, depth)
    assert np.count_nonzero(expected != depth) > 300
    np.testing.assert_allclose(changed, expected, rtol=1e-6)


def test_no_photo_of_the_parts_is_an_error() -> None:
    away = FlatPart(np.array([50.0, 0, 0]), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), 0.0)
    pose = looking([0.0, -3.0, 1.0], [0.0, 0.0, 1.0])
    views = build_views(
        [photo(pose, CAMERA)], [CAMERA], pose[None], [np.ones((60, 80), np.float32)]
    )
    held = HeldOut(photo(pose, CAMERA), CAMERA, pose, views)
    with pytest.raises(StageError, match="no photo of test shows the parts"):
        measure("test", iter([held]), iter([held]), 1, WALL, [away], no_progress)


def test_from_files_to_table_and_figure(tmp_path: Path) -> None:
    """A matte board: one colour a point is the truth, so that a texture does as well."""
    data = write_dataset(tmp_path / "map", MAP_PLACES)
    test = write_dataset(tmp_path / "test", [[0.1, -3.8, 1.0]])
    poses = data / "groundtruth.txt"
    succeed("reconstruct", data, "-o", tmp_path / "r", "--method", "poses", "--poses", poses)
    scene = tmp_path / "scene.h5"
    options = ["--geometry", "depth", "--depth", "given", "--plane", "0,1,0,0"]
    succeed("model", tmp_path / "r", "-o", scene, *options)
    parts = tmp_path / "parts.toml"
    parts.write_text(
        f"[[part]]\ncorner = [{BOARD_LEFT}, {BOARD_Y}, 0.6]\n"
        f"right = [{BOARD_RIGHT - BOARD_LEFT}, 0, 0]\nup = [0, 0, 0.8]\n"
    )
    output = tmp_path / "study"

    def study() -> tuple[ViewDependence, ...]:
        return study_view_dependence(
            scene, parts, test, output, overwrite=False, progress=no_progress
        )

    on_test, left_out = study()
    assert (len(on_test.photos), len(left_out.photos)) == (1, len(MAP_PLACES))
    for result in (on_test, left_out):
        # Depth was exact already.
        assert result.mean("own", "light_field") > 30.0
        assert result.mean("true", "mean") == pytest.approx(result.mean("own", "mean"), abs=1.0)
        assert result.advantage("own") < 0.0
        assert result.mean("plane", "light_field") < result.mean("own", "light_field") - 5.0
    lines = (output / TABLE).read_text().splitlines()
    assert len(lines) == 2 + 2 * 3 + 3
    assert re.fullmatch(r"\| test \(1\) \| depth from the photos( \| -?\d+\.\d){4} \|", lines[2])
    figure = cv2.imread(str(output / FIGURE))
    assert figure is not None
    assert figure.shape[1] > 1000
    with pytest.raises(InputError, match="exists already"):
        study()
    flat = tmp_path / "flat.h5"
    succeed("model", tmp_path / "r", "-o", flat, "--plane", "0,1,0,0")
    with pytest.raises(StageError, match="has no depth maps"):
        study_view_dependence(
            flat, parts, test, tmp_path / "other", overwrite=False, progress=no_progress
        )
    assert not (tmp_path / "other").exists()
