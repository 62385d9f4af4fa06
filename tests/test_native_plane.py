"""Rendering over a plane in C++ against compiled Python, and what it refuses."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pipelines import native
from pipelines.artifacts.array_types import Float32Array, FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.blending import (
    MOST_RANKED,
    Blending,
    outlook_positions,
    tile_borders,
)
from pipelines.lightfield.comparison import EVIDENCE_BINS, EVIDENCE_ROWS, Cost, PixelEvidence
from pipelines.lightfield.net import MESH_LIMITS
from pipelines.lightfield.reference import frustum_positions
from pipelines.lightfield.renderer import Renderer
from tests.lightfield_samples import looking, noise_views, pinhole, tilted_wall
from tests.test_renderers_agree import at_wall, somewhere

SIZES = [pinhole(24, 18, 20.0), pinhole(41, 29, 50.0), pinhole(1, 1, 1.0), pinhole(3, 2, 3.0)]


def light_field(
    count: int, seed: int, blending: Blending = Blending.UNSTRUCTURED
) -> tuple[Renderer, FloatArray]:
    """A renderer of so many photos of a wall, and poses that look at it or past it."""
    generator = np.random.default_rng(seed)
    recorded = [
        looking(somewhere(generator, 2.0, 4.0), at_wall(generator), float(roll))
        for roll in generator.uniform(-0.3, 0.3, count)
    ]
    views, plane = noise_views(recorded, generator), tilted_wall(generator)
    renderer = Renderer(views, plane, blending, threads=1)
    poses = [
        looking(somewhere(generator, 1.0, 5.0), at_wall(generator) * [3.0, 1.0, 2.0])
        for _ in range(40)
    ]
    return renderer, np.array(poses)


def camera_image(camera: Intrinsics, seed: int, share: float) -> Float32Array:
    generator = np.random.default_rng(seed)
    image = generator.uniform(0.0, 255.0, (camera.height, camera.width, 3)).astype(np.float32)
    image[generator.random(image.shape[:2]) > share] = np.nan
    return image


def evidence() -> PixelEvidence:
    generator = np.random.default_rng(3)
    # So little from bin to bin that rounding at a border of two changes nothing.
    table = 1e-4 * generator.standard_normal((EVIDENCE_ROWS, EVIDENCE_BINS)).astype(np.float32)
    edges = np.linspace(60.0, 300.0, EVIDENCE_ROWS - 1, dtype=np.float32)
    rows = 0.5 * np.arange(1, EVIDENCE_ROWS + 1, dtype=np.float32)
    return PixelEvidence(edges, table + rows[:, None], np.zeros(EVIDENCE_ROWS, np.float32))


@pytest.mark.parametrize("count", [1, 12, MOST_RANKED + 30])
@pytest.mark.parametrize("camera", SIZES, ids=lambda camera: f"{camera.width}x{camera.height}")
@pytest.mark.parametrize("cost", Cost)
@pytest.mark.parametrize("blending", Blending)
def test_costs_are_those_of_compiled_python(
    blending: Blending, cost: Cost, camera: Intrinsics, count: int
) -> None:
    renderer, poses = light_field(count, count, blending)
    table = evidence() if cost is Cost.EVIDENCE else None
    for share in (1.0, 0.3):
        query = camera_image(camera, 5, share)
        for fit_gain in (False, True):
            arguments = (poses, camera, query, cost, fit_gain, table)
            found = renderer.costs(*arguments)
            kept, renderer._native = renderer._native, None
            expected = renderer.costs(*arguments)
            renderer._native = kept
            assert kept is not None
            np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-4)


@pytest.mark.parametrize("blending", Blending)
def test_threads_and_batches_change_nothing(blending: Blending) -> None:
    renderer, poses = light_field(30, 7, blending)
    camera = SIZES[1]
    query = camera_image(camera, 8, 0.5)
    expected = renderer.costs(poses, camera, query, Cost.ROBUST, True)
    several = Renderer(renderer.views, renderer.plane, blending, threads=3)
    np.testing.assert_array_equal(several.costs(poses, camera, query, Cost.ROBUST, True), expected)
    single = [renderer.costs(pose[None], camera, query, Cost.ROBUST, True)[0] for pose in poses]
    np.testing.assert_array_equal(single, expected)


@pytest.mark.parametrize("blending", Blending)
def test_which_pixels_are_compared_does_not_change_what_they_show(blending: Blending) -> None:
    renderer, poses = light_field(12, 9, blending)
    assert renderer._native is not None
    camera = SIZES[1]
    every = np.arange(camera.width * camera.height, dtype=np.int32)
    whole, depths = renderer._native.draw(poses, camera, every)
    some = every[3::7].copy()
    images, inverse_depths = renderer._native.draw(poses, camera, some)
    np.testing.assert_array_equal(images, whole[:, some])
    np.testing.assert_array_equal(inverse_depths, depths[:, some])


@pytest.mark.parametrize("blending", Blending)
def test_poses_that_are_no_numbers_show_nothing(blending: Blending) -> None:
    renderer, poses = light_field(MOST_RANKED + 6, 10, blending)
    assert renderer._native is not None
    for value in (np.nan, np.inf, 1e300):
        images, _ = renderer._native.draw(
            np.full_like(poses, value), SIZES[0], np.arange(9, dtype=np.int32)
        )
        assert np.isfinite(images).all()
        assert not images.any()


# --- arguments ---------------------------------------------------------------------------------


def scene_arguments() -> dict[str, Any]:
    renderer, _ = light_field(5, seed=11)
    views, index = renderer._field.views, renderer._field.view_index
    names = ("texels", "level_start", "level_size", "projection", "centres", "focal")
    more = ("origin", "order", "numbers", "members", "blocks", "groups")
    return {
        **{name: getattr(views, name) for name in names},
        "usable": renderer._field.usable,
        **{name: getattr(index, name) for name in more},
        "plane": renderer.plane.coefficients(),
        "penalties": np.array([0.05, 0.03, 1e-6, 1e-4]),
        "most_ranked": 64,
        "smallest_weight": 1e-6,
        "has_mesh": True,
        "mesh": MESH_LIMITS,
    }


SCENES: list[tuple[str, Callable[[Any], object]]] = [
    ("texels", lambda a: a[: len(a) // 2]),
    ("texels", lambda a: a[:, :3].copy()),
    ("level_start", lambda a: a + 10**6),
    ("level_start", lambda a: a - 2**62),
    ("level_size", lambda a: a * 0),
    ("level_size", lambda a: a + 10**4),
    ("level_size", lambda a: a + 2**60),
    ("projection", lambda a: a[1:]),
    ("centres", lambda a: a[:, :2].copy()),
    ("focal", lambda a: a.astype(np.float32)),
    ("usable", lambda a: a[:4]),
    ("order", lambda a: a + 1),
    ("order", lambda a: a - 1),
    ("numbers", lambda a: a[:-1]),
    ("members", lambda a: a + 100),
    ("members", lambda a: a - 2),
    ("blocks", lambda a: a[:-1]),
    ("groups", lambda a: a[:-1]),
    ("plane", lambda a: a[:3]),
    ("penalties", lambda a: a[:3]),
    ("most_ranked", lambda a: 0),
    ("smallest_weight", lambda a: -1.0),
    ("mesh", lambda a: a[:3]),
]


@pytest.mark.parametrize(("name", "spoil"), SCENES)
def test_a_wrong_array_of_a_scene_is_named(name: str, spoil: Callable[[Any], object]) -> None:
    given = scene_arguments()
    native.PlaneScene(**given)
    # Where a level ends is a matter of three arrays.
    named = "level_start|level_size" if name in {"texels", "level_size"} else name
    with pytest.raises((TypeError, ValueError), match=rf"^({name}|{named}): [^\n]+$"):
        native.PlaneScene(**given | {name: spoil(given[name])})


def comparison_arguments() -> dict[str, Any]:
    camera = SIZES[0]
    _, poses = light_field(1, seed=12)
    return {
        "poses": poses,
        "intrinsics": camera.vector(),
        "across": tile_borders(camera.width),
        "down": tile_borders(camera.height),
        "outlook_across": outlook_positions(camera.width),
        "outlook_down": outlook_positions(camera.height),
        "frustum_across": frustum_positions(camera.width),
        "frustum_down": frustum_positions(camera.height),
        "pixels": np.arange(7, dtype=np.int32),
        "width": camera.width,
        "height": camera.height,
        "query": np.ones((1, 7, 4), np.float32),
        "cost": int(Cost.EVIDENCE),
        "fit_gain": False,
        "limits": np.array([64.0, 32.0, 1.5]),
        "uncovered": np.array([0.06, 0.8, 0.5, 0.5]),
        "table": np.zeros((9, 24), np.float32),
        "evidence_bin": 10.0,
    }


COMPARISONS: list[tuple[str, Callable[[Any], object]]] = [
    ("poses", lambda a: a[0]),
    ("poses", lambda a: a.astype(np.float32)),
    ("intrinsics", lambda a: a[:3]),
    ("across", lambda a: a + 1),
    ("across", lambda a: a[::-1].copy()),
    ("down", lambda a: a - 1),
    ("down", lambda a: a[:1]),
    ("outlook_across", lambda a: a + 1),
    ("outlook_down", lambda a: a[:3]),
    ("frustum_across", lambda a: a + 1),
    ("frustum_down", lambda a: -a),
    ("pixels", lambda a: a + 24 * 18 - 6),
    ("pixels", lambda a: a - 1),
    ("width", lambda a: 0),
    ("height", lambda a: 2**16),
    ("query", lambda a: a[:, :6].copy()),
    ("query", lambda a: 9.0 * a),
    ("query", lambda a: np.nan * a),
    ("query", lambda a: -a),
    ("cost", lambda a: 5),
    ("limits", lambda a: a[:2]),
    ("uncovered", lambda a: a[:3]),
    ("table", lambda a: a[0]),
    ("evidence_bin", lambda a: 0.0),
]


@pytest.mark.parametrize(("name", "spoil"), COMPARISONS)
def test_a_wrong_argument_of_a_comparison_is_named(
    name: str, spoil: Callable[[Any], object]
) -> None:
    scene = native.PlaneScene(**scene_arguments())
    given = comparison_arguments()
    assert scene.costs(**given).shape == (40,)
    with pytest.raises((TypeError, ValueError), match=rf"^{name}: [^\n]+$"):
        scene.costs(**given | {name: spoil(given[name])})
