"""Direct image alignment: its derivative, its kernel, and where it ends, against the true pose."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import inverse, world_from_base_planar
from pipelines.localize.alignment import FLAT, Alignment, _inverse, align
from pipelines.localize.observation import Observation, Observer
from pipelines.localize.state_space import PLANAR, SPATIAL, StateSpace
from pipelines.native import normal_equations, robust_error
from pipelines.render.comparison import prepared
from pipelines.render.renderer import Renderer, RenderingWithSurface
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo, smooth, wall_scene

# Between two recordings, nearer than they are, and turned: no view shows exactly this.
FLOOR_TRUTH = facing_wall(-0.4, 1.7, 0.15)
TRUTH = {
    "planar": FLOOR_TRUTH,
    "spatial": SPATIAL.states(world_from_base_planar(FLOOR_TRUTH)),
}
# Derivatives are compared with differences, which takes a picture without edges.
IMAGE = photo(FLOOR_TRUTH, paint=smooth)
OBSERVER = Observer(CAMERA, [24, 48])
# A millimetre at this distance is so many pixels of the camera.
PIXELS_A_METRE = 24.0 / 1.7
both = pytest.mark.parametrize("space", [PLANAR, SPATIAL], ids=lambda space: space.name)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer.of_scene(wall_scene(smooth), threads=1)


def observations(image: ImageArray) -> list[Observation]:
    seen = OBSERVER(image).by_width
    return [seen[24], seen[48]]


def starts(space: StateSpace, count: int, seed: int) -> list[FloatArray]:
    """States 10 cm and 3 degrees from the truth."""
    offsets = np.random.default_rng(seed).standard_normal((count, space.dimension))
    positions, angles = offsets[:, : space.positions], offsets[:, space.positions :]
    positions *= 0.1 / np.linalg.norm(positions, axis=1, keepdims=True)
    angles *= np.radians(3.0) / np.linalg.norm(angles, axis=1, keepdims=True)
    return list(space.moved(TRUTH[space.name], offsets))


def errors(space: StateSpace, refined: Alignment) -> tuple[float, float]:
    """Metres and radians from the truth."""
    offset = space.difference(refined.state, TRUTH[space.name])
    positions = space.positions
    return float(np.linalg.norm(offset[:positions])), float(np.linalg.norm(offset[positions:]))


# --- the derivative ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Look:
    """A view rendered at a state; ``camera`` is its world_from_camera."""

    view: RenderingWithSurface
    camera: FloatArray
    lever: FloatArray
    intrinsics: Intrinsics


def look_at(
    renderer: Renderer,
    space: StateSpace,
    state: FloatArray,
    intrinsics: Intrinsics = CAMERA.intrinsics,
) -> Look:
    body = space.poses(state)
    camera = body @ MOUNT
    view = renderer.render_with_surface(camera, intrinsics)
    return Look(view, camera, camera[:3, 3] - body[:3, 3], intrinsics)


def projected(camera: FloatArray, points: FloatArray, intrinsics: Intrinsics) -> FloatArray:
    own = (points - camera[:3, 3]) @ camera[:3, :3]
    scale = np.array([intrinsics.fx, intrinsics.fy])
    centre = np.array([intrinsics.cx, intrinsics.cy])
    return np.asarray(own[..., :2] / own[..., 2:] * scale + centre)


def pixel_motions(space: StateSpace, state: FloatArray, look: Look) -> FloatArray:
    """``(H, W, D, 2)`` how far each surface point moves in the image, a unit of the state.

    By projecting it with the camera before and after a small motion of the body.
    """
    pinhole = look.intrinsics
    rows, columns = np.mgrid[0 : pinhole.height, 0 : pinhole.width]
    rays = np.stack(
        [
            (columns - pinhole.cx) / pinhole.fx,
            (rows - pinhole.cy) / pinhole.fy,
            np.ones(rows.shape),
        ],
        axis=-1,
    )
    depth = 1.0 / look.view.inverse_depth[..., None]
    points = look.camera[:3, 3] + (rays * depth) @ look.camera[:3, :3].T
    motions = np.empty((*rows.shape, space.dimension, 2))
    step = 1e-5
    for k, unit in enumerate(np.eye(space.dimension)):
        there, back = (
            projected(space.poses(space.moved(state, sign * step * unit)) @ MOUNT, points, pinhole)
            for sign in (1.0, -1.0)
        )
        motions[..., k, :] = (there - back) / (2.0 * step)
    return motions


def derivative(space: StateSpace, state: FloatArray, look: Look) -> FloatArray:
    """``(H - 2, W - 2, 3, D)`` of the image's inner pixels, colours moving with their points."""
    image = look.view.image.astype(np.float64)
    slope_x = (image[1:-1, 2:] - image[1:-1, :-2]) / 2.0
    slope_y = (image[2:, 1:-1] - image[:-2, 1:-1]) / 2.0
    slopes = np.stack([slope_x, slope_y], axis=-1)
    motions = pixel_motions(space, state, look)[1:-1, 1:-1]
    return np.asarray(-np.einsum("yxci,yxdi->yxcd", slopes, motions))


@both
def test_the_derivative_is_that_of_the_rendered_image(
    space: StateSpace, renderer: Renderer
) -> None:
    state = TRUTH[space.name]
    look = look_at(renderer, space, state)
    assert look.view.covered.all()
    expected = derivative(space, state, look)
    for k, unit in enumerate(np.eye(space.dimension)):
        step = 0.01 * unit
        there = look_at(renderer, space, space.moved(state, step)).view
        back = look_at(renderer, space, space.moved(state, -step)).view
        changed = (there.image.astype(np.float64) - back.image) / 0.02
        seen = (there.covered & back.covered)[1:-1, 1:-1]
        found = changed[1:-1, 1:-1][seen].reshape(-1)
        assert seen.mean() > 0.9
        own = expected[..., k][seen].reshape(-1)
        assert np.corrcoef(found, own)[0, 1] > 0.98
        assert found @ own / (own @ own) == pytest.approx(1.0, abs=0.05)


def kernel_sums(
    space: StateSpace, look: Look, target: Float32Array, gain: float, offset: float, limit: float
) -> tuple[FloatArray, FloatArray]:
    axes = np.eye(3) if space.angles == 3 else np.eye(3)[2:]
    unknowns = np.concatenate([np.eye(3)[: space.positions], axes])
    turns = np.arange(space.dimension) >= space.positions
    return normal_equations(
        image=look.view.rgba,
        inverse_depth=look.view.inverse_depth,
        target=prepared(target),
        gain=gain,
        offset=offset,
        limit=limit,
        flat=FLAT,
        intrinsics=look.intrinsics.vector()[:4],
        rotation=np.ascontiguousarray(look.camera[:3, :3]),
        lever=look.lever,
        axes=unknowns,
        is_rotation=turns,
        tiles_across=4,
    )


def plain_sums(
    space: StateSpace,
    state: FloatArray,
    look: Look,
    target: Float32Array,
    gain: float,
    offset: float,
    limit: float,
) -> tuple[FloatArray, FloatArray]:
    """The same with arrays over all pixels."""
    image = look.view.image.astype(np.float64)
    error = (gain * image + offset - target)[1:-1, 1:-1]
    weight = np.clip(1.0 - (error / limit) ** 2, 0.0, None) ** 2
    usable = inner(look.view.covered)
    # Twice the slopes, as differences of the neighbours.
    across = np.abs(image[1:-1, 2:] - image[1:-1, :-2]).max(axis=2)
    along = np.abs(image[2:, 1:-1] - image[:-2, 1:-1]).max(axis=2)
    usable &= np.maximum(across, along) >= FLAT
    weight *= usable[..., None]
    rows = np.concatenate(
        [
            gain * derivative(space, state, look),
            image[1:-1, 1:-1, :, None],
            np.ones((*error.shape, 1)),
        ],
        axis=-1,
    )
    hessian = np.einsum("yxc,yxci,yxcj->ij", weight, rows, rows)
    gradients = np.einsum("yxc,yxc,yxci->yxi", weight, error, rows)
    clusters = np.zeros((16, space.dimension + 2))
    height, width = look.view.covered.shape
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            clusters[(y * 4 // height) * 4 + x * 4 // width] += gradients[y - 1, x - 1]
    return hessian, clusters


def inner(covered: BoolArray) -> BoolArray:
    """Inner pixels that are covered and whose four neighbours are."""
    return np.asarray(
        covered[1:-1, 1:-1]
        & covered[:-2, 1:-1]
        & covered[2:, 1:-1]
        & covered[1:-1, :-2]
        & covered[1:-1, 2:]
    )


@both
@pytest.mark.parametrize("width", [CAMERA.width, 66, 139])
@pytest.mark.parametrize("x", [-0.4, 2.3], ids=["all covered", "past the map's end"])
def test_the_kernel_adds_up_what_plain_arrays_do(
    space: StateSpace, x: float, width: int, renderer: Renderer
) -> None:
    place = facing_wall(x, 1.7, 0.15)
    state = place if space is PLANAR else SPATIAL.states(world_from_base_planar(place))
    look = look_at(renderer, space, state, CAMERA.intrinsics.resized(width, 36))
    assert look.view.covered.all() == (x < 0.0)
    noise = np.random.default_rng(1).normal(0.0, 20.0, look.view.image.shape)
    target = (0.9 * look.view.image + 7.0 + noise).astype(np.float32)
    arguments = (target, 0.95, 3.0, 40.0)
    hessian, clusters = kernel_sums(space, look, *arguments)
    expected, tiles = plain_sums(space, state, look, *arguments)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(hessian / scale, expected / scale, atol=1e-5)
    largest = np.abs(tiles).max(axis=0)
    np.testing.assert_allclose(clusters / largest, tiles / largest, atol=1e-5)


@pytest.mark.parametrize("contrast", [0.0, 1e-9, 0.5, 60.0])
@pytest.mark.parametrize("pixels", [0.0, 1.0, 1e6])
def test_gain_and_offset_are_eliminated_as_by_the_pseudo_inverse(
    contrast: float, pixels: float
) -> None:
    # Of values with mean 128: without contrast gain and offset cannot be told apart.
    squares = 128.0**2 + contrast**2
    matrix = pixels * np.array([[squares, 128.0], [128.0, 1.0]])
    expected = np.linalg.pinv(matrix, hermitian=True)
    np.testing.assert_allclose(_inverse(matrix), expected, rtol=1e-6)


def test_the_robust_error_is_tukeys_loss(renderer: Renderer) -> None:
    look = look_at(renderer, PLANAR, facing_wall(2.3, 1.7, 0.0))
    image, covered = look.view.image, look.view.covered
    target = (image + np.random.default_rng(2).normal(0.0, 25.0, image.shape)).astype(np.float32)
    ratio = (1.1 * image.astype(np.float64) - 4.0 - target) / 30.0
    loss = np.where(np.abs(ratio) < 1.0, 1.0 - (1.0 - ratio**2) ** 3, 1.0)
    loss[~covered] = 1.0
    expected = 30.0**2 / 6.0 * loss.mean()
    found = robust_error(look.view.rgba, prepared(target), 1.1, -4.0, 30.0)
    assert 0.0 < covered.mean() < 1.0
    assert found == pytest.approx(expected, rel=1e-5)


# --- where it ends -----------------------------------------------------------------------------


@both
def test_alignment_ends_at_the_truth_to_a_fraction_of_a_pixel(
    space: StateSpace, renderer: Renderer
) -> None:
    for start in starts(space, 8, seed=3):
        refined = align(renderer, space, start, MOUNT, observations(IMAGE))
        metres, radians = errors(space, refined)
        assert refined.converged
        assert metres * PIXELS_A_METRE < 0.1
        assert radians * 24.0 < 0.1
        assert refined.error < 1.0


@both
def test_brightness_and_contrast_do_not_move_the_state(
    space: StateSpace, renderer: Renderer
) -> None:
    start = starts(space, 1, seed=4)[0]
    plain = align(renderer, space, start, MOUNT, observations(IMAGE))
    for gain, offset in ((0.75, 12.0), (1.15, -10.0)):
        changed = np.clip(np.rint(gain * IMAGE + offset), 0.0, 255.0).astype(np.uint8)
        refined = align(renderer, space, start, MOUNT, observations(changed))
        apart = space.difference(refined.state, plain.state)
        assert np.linalg.norm(apart[: space.positions]) * PIXELS_A_METRE < 0.1
        assert np.linalg.norm(apart[space.positions :]) * 24.0 < 0.1


@both
def test_a_box_before_a_quarter_of_the_image_hardly_moves_the_state(
    space: StateSpace, renderer: Renderer
) -> None:
    hidden = IMAGE.copy()
    hidden[10:28, 16:40] = (200, 30, 30)
    assert np.any(hidden != IMAGE, axis=2).mean() == pytest.approx(0.25)
    for start in starts(space, 4, seed=5):
        refined = align(renderer, space, start, MOUNT, observations(hidden))
        metres, radians = errors(space, refined)
        assert metres < 0.03
        assert radians < np.radians(0.5)


def test_a_view_of_nothing_has_no_finite_error(renderer: Renderer) -> None:
    away = facing_wall(0.0, 1.7, np.pi)
    refined = align(renderer, PLANAR, away, MOUNT, observations(IMAGE))
    assert not np.isfinite(refined.error)
    assert not refined.converged
    np.testing.assert_array_equal(refined.state, away)
    assert np.all(np.isinf(refined.covariance))


def test_a_wrong_place_costs_more_than_the_right_one(renderer: Renderer) -> None:
    wrong = align(renderer, PLANAR, facing_wall(1.3, 1.7, -0.3), MOUNT, observations(IMAGE))
    right = align(renderer, PLANAR, FLOOR_TRUTH, MOUNT, observations(IMAGE))
    assert right.error < 0.01 * wrong.error


def test_the_covariance_covers_the_errors_of_noisy_images(renderer: Renderer) -> None:
    rng = np.random.default_rng(6)
    squares = []
    for start in starts(PLANAR, 30, seed=6):
        # Coarse blotches: neighbouring pixels err alike, as they do where a model is wrong.
        blotches = np.kron(rng.normal(0.0, 12.0, (6, 8, 3)), np.ones((6, 6, 1)))
        noisy = np.clip(IMAGE + blotches, 0.0, 255.0).astype(np.uint8)
        refined = align(renderer, PLANAR, start, MOUNT, observations(noisy))
        offset = PLANAR.difference(refined.state, FLOOR_TRUTH)
        squares.append(offset @ np.linalg.solve(refined.covariance, offset))
        np.testing.assert_array_equal(refined.covariance, refined.covariance.T)
    # 3 where it is right. As if pixels were independent it would be about 36 times as much.
    assert 0.5 < np.median(squares) < 12.0


def test_the_curvature_is_that_of_the_mean_squared_difference(renderer: Renderer) -> None:
    seen = observations(IMAGE)[1]
    refined = align(renderer, PLANAR, FLOOR_TRUTH, MOUNT, [seen])

    def squared(offset: FloatArray) -> float:
        pose = PLANAR.poses(PLANAR.moved(refined.state, offset)) @ MOUNT
        view = renderer.render_with_surface(pose, seen.intrinsics)
        values, wanted = view.image.reshape(-1).astype(np.float64), seen.image.reshape(-1)
        # Gain and offset are fitted there, and here by least squares.
        basis = np.stack([values, np.ones(len(values))], axis=1)
        residual = wanted - basis @ np.linalg.lstsq(basis, wanted.astype(np.float64))[0]
        return float(np.mean(residual**2))

    for direction in (np.eye(3)[0], np.eye(3)[1], 0.5 * np.eye(3)[2], np.array([0.5, 0.5, -0.3])):
        step = 0.02 * direction
        second = (squared(step) - 2.0 * squared(np.zeros(3)) + squared(-step)) / 0.02**2
        found = 2.0 * direction @ refined.curvature @ direction
        assert found == pytest.approx(second, rel=0.25)


def test_the_start_is_not_changed_in_place_and_the_result_is_repeatable(
    renderer: Renderer,
) -> None:
    start = starts(PLANAR, 1, seed=7)[0]
    before = start.copy()
    first = align(renderer, PLANAR, start, MOUNT, observations(IMAGE))
    again = align(renderer, PLANAR, start, MOUNT, observations(IMAGE))
    np.testing.assert_array_equal(start, before)
    assert first.state.tobytes() == again.state.tobytes()
    assert first.covariance.tobytes() == again.covariance.tobytes()


def test_inverse_depths_are_those_of_the_wall(renderer: Renderer) -> None:
    look = look_at(renderer, PLANAR, FLOOR_TRUTH)
    pinhole = CAMERA.intrinsics
    # The optical axis meets the wall y = 0 at 1.7 m / cos of the turn; depth is along the axis.
    column = np.array([(10 - pinhole.cx) / pinhole.fx, 0.0, 1.0])
    direction = Rotation.from_matrix(look.camera[:3, :3]).apply(column)
    expected = direction[1] / 1.7
    assert look.view.inverse_depth[17, 10] == pytest.approx(expected, rel=1e-6)
    assert inverse(look.camera)[:3, :3] == pytest.approx(look.camera[:3, :3].T)
