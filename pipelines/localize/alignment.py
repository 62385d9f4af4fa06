"""Direct image alignment: a state moved until its rendered view fits the camera image best.

Gauss-Newton on the photometric error, damped after Levenberg and Marquardt, from coarse images to
fine ones (Baker and Matthews 2004, "Lucas-Kanade 20 years on"; the depth of each pixel comes from
the light field as in direct visual odometry, Kerl, Sturm, Cremers 2013, "Robust odometry estimation
for RGB-D cameras"). In every step the view is rendered anew at the present state, so that what is
minimised is the true difference; only the derivative takes colours to stay with their surface
points. Gain and offset of the camera image are estimated along, and pixels that show something else
than the model are weighted down (Tukey's biweight).

The covariance is the sandwich estimate H^-1 B H^-1 with B summed over tiles of the image (clustered
errors, Liang and Zeger 1986): errors of neighbouring pixels are far from independent, and taking
them as independent would claim a precision that is not there.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.localize.observation import Observation
from pipelines.localize.state_space import StateSpace
from pipelines.native import fitted_brightness, normal_equations, robust_error
from pipelines.render.comparison import LARGEST_GAIN, prepared
from pipelines.render.renderer import RenderingWithSurface

# Beyond so many standard deviations an error is taken for something else (95 % efficiency).
TUKEY = 4.685
# Levels of the channels: rounding leaves about this, in a rendered view and in the image.
SMALLEST_SCALE = 3.0
# A pixel whose neighbours differ by less than so many levels says nothing about the pose.
FLAT = 10.0
# Fewer comparable pixels than this share of the image say nothing about the pose.
SMALLEST_SHARE = 0.15
LARGEST_STEP_METRES, LARGEST_STEP_RADIANS = 0.3, math.radians(8.0)
# A step that moves the picture by less than this, in pixels, ends a level.
STEP_PIXELS = 0.1
TILES_ACROSS = 8
# Gain and offset are told apart while the determinant of their equations is more than this share of
# what it can be.
SMALLEST_DETERMINANT = 1e-12
FIRST_DAMPING, DAMPING_FACTOR, LARGEST_DAMPING = 1e-3, 8.0, 10.0


class SurfaceRenderer(Protocol):
    """Renders views with their surface: ``lightfield.renderer.Renderer``, or one on top of it."""

    def render_with_surface(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> RenderingWithSurface:
        """See ``Renderer.render_with_surface``."""


@dataclass(frozen=True)
class Refined:
    """Where an alignment ended.

    Attributes:
        state: ``(D,)``.
        covariance: ``(D, D)`` of its error, metres and radians.
        curvature: ``(D, D)`` half the second derivative of the mean squared difference, grey levels
            squared a metre and radian squared.
        error: robust photometric error at the end, in squared grey levels; uncovered pixels count
            as the worst.
        converged: whether the last level ended by itself with enough comparable pixels.
    """

    state: FloatArray
    covariance: FloatArray
    curvature: FloatArray
    error: float
    converged: bool


@dataclass(frozen=True)
class Prior:
    """What is known of a state before the image is aligned.

    Attributes:
        state: ``(D,)``.
        information: ``(D, D)`` inverse covariance of its error.
        doubt: factor on the variances that the image's own tiles tell: errors of the model reach
            farther than a tile.
    """

    state: FloatArray
    information: FloatArray
    doubt: float


@dataclass(frozen=True)
class _Look:
    """The view rendered at a state, with the brightness that fits the camera image.

    Attributes:
        view: the rendering.
        gain: factor on it.
        offset: added to it, grey levels.
        scale: standard deviation of the differences that remain, outliers apart, grey levels.
    """

    view: RenderingWithSurface
    gain: float
    offset: float
    scale: float


@dataclass(frozen=True)
class _Level:
    """One image size of an alignment, and what does not change on it."""

    renderer: SurfaceRenderer
    space: StateSpace
    body_from_camera: FloatArray
    intrinsics: Intrinsics
    target: Float32Array

    @property
    def stride(self) -> int:
        """Every so many-th pixel of every so many-th row tells as much as all, of brightness."""
        return max(1, self.intrinsics.width // 40)

    def look(self, state: FloatArray) -> _Look | None:
        """Renders and compares; None where too little of the scene is seen."""
        pose = self.space.poses(state) @ self.body_from_camera
        view = self.renderer.render_with_surface(pose, self.intrinsics)
        covered = view.covered
        if np.count_nonzero(covered) < SMALLEST_SHARE * covered.size:
            return None
        gain, offset, scale = fitted_brightness(
            view.rgba, self.target, self.stride, TUKEY, SMALLEST_SCALE, LARGEST_GAIN
        )
        return _Look(view, gain, offset, scale)

    def error(self, look: _Look, scale: float) -> float:
        """Robust error of a look, squared grey levels."""
        view = look.view
        return robust_error(view.rgba, self.target, look.gain, look.offset, TUKEY * scale)

    def normal_equations(
        self, state: FloatArray, look: _Look
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Hessian ``(D, D)``, gradient ``(D,)`` and the tiles' gradients ``(T, D)``.

        Gain and offset are eliminated, so that what they could explain does not move the state.
        """
        view, pinhole = look.view, self.intrinsics
        body = self.space.poses(state)
        camera = body @ self.body_from_camera
        axes, turns = _unknowns(self.space)
        hessian, clusters = normal_equations(
            image=view.rgba,
            inverse_depth=view.inverse_depth,
            target=self.target,
            gain=look.gain,
            offset=look.offset,
            limit=TUKEY * look.scale,
            flat=FLAT,
            intrinsics=pinhole.vector()[:4],
            rotation=np.ascontiguousarray(camera[:3, :3]),
            lever=camera[:3, 3] - body[:3, 3],
            axes=axes,
            is_rotation=turns,
            tiles_across=TILES_ACROSS,
        )
        d = self.space.dimension
        elimination = hessian[:d, d:] @ _inverse(hessian[d:, d:])
        reduced = hessian[:d, :d] - elimination @ hessian[d:, :d]
        own = clusters[:, :d] - clusters[:, d:] @ elimination.T
        return reduced, own.sum(axis=0), own


def _inverse(matrix: FloatArray) -> FloatArray:
    """The inverse ``(2, 2)`` of a symmetric matrix, or the pseudo-inverse where there is none."""
    (a, b), (_, c) = matrix.tolist()
    determinant = a * c - b * b
    if determinant <= SMALLEST_DETERMINANT * a * c:
        return np.asarray(np.linalg.pinv(matrix, hermitian=True), dtype=np.float64)
    # Written out: the general way takes a fifth of the time of an alignment's normal equations.
    return np.asarray(np.array([[c, -b], [-b, a]]) / determinant, dtype=np.float64)


def _unknowns(space: StateSpace) -> tuple[FloatArray, BoolArray]:
    """World axis ``(D, 3)`` of each unknown, and ``(D,)`` whether it is a turn about it."""
    axes = np.eye(3)
    # The one angle of a robot on the floor is about the vertical.
    turning = axes[3 - space.angles :]
    turns = np.arange(space.dimension) >= space.positions
    return np.concatenate([axes[: space.positions], turning]), turns


def refine(
    renderer: SurfaceRenderer,
    space: StateSpace,
    state: FloatArray,
    body_from_camera: FloatArray,
    observations: Sequence[Observation],
    iterations: int = 8,
    prior: Prior | None = None,
) -> Refined:
    """Aligns a state with a camera image.

    With a prior the result is the most probable state by both (an iterated extended Kalman filter,
    Bell and Cathey 1993), and its covariance that of the posterior. The image's information is its
    Hessian, divided by how much larger errors are than independent pixels would have them.

    Args:
        renderer: of the scene.
        space: what a state is.
        state: ``(D,)`` where to begin.
        body_from_camera: ``(4, 4)`` the camera's mount.
        observations: the camera image from coarse to fine.
        iterations: at most, on each level.
        prior: None: the image alone.
    """
    result = _failed(space, np.array(state, dtype=np.float64))
    for observation in observations:
        target = prepared(observation.image)
        level = _Level(renderer, space, body_from_camera, observation.intrinsics, target)
        result = _refine_level(level, result.state, iterations, prior)
        if not math.isfinite(result.error):
            break
    return result


def _refine_level(
    level: _Level, state: FloatArray, iterations: int, prior: Prior | None
) -> Refined:
    """``refine`` on one image size."""
    look = level.look(state)
    if look is None:
        return _failed(level.space, state)
    damping, converged = FIRST_DAMPING, False
    error = level.error(look, look.scale)
    hessian, gradient, clusters = level.normal_equations(state, look)
    pull = _Pull(level, prior, hessian, clusters)
    for _ in range(iterations):
        step = _step(level.space, hessian + pull.hessian, gradient + pull.gradient(state), damping)
        converged = _in_pixels(level, look, step) < STEP_PIXELS
        if converged:
            break
        proposed = level.space.moved(state, step)
        then = level.look(proposed)
        if then is not None and level.error(then, look.scale) + pull.error(
            proposed
        ) < error + pull.error(state):
            state, look = proposed, then
            error = level.error(look, look.scale)
            hessian, gradient, clusters = level.normal_equations(state, look)
            damping = max(damping / DAMPING_FACTOR, FIRST_DAMPING)
        elif damping >= LARGEST_DAMPING:
            converged = True
            break
        else:
            damping *= DAMPING_FACTOR
    if prior is None:
        inverse = np.linalg.pinv(hessian, hermitian=True)
        covariance = inverse @ (clusters.T @ clusters) @ inverse
    else:
        covariance = np.linalg.inv(hessian / pull.dispersion + prior.information)
    curvature = hessian / (3.0 * look.view.inverse_depth.size)
    return Refined(state, 0.5 * (covariance + covariance.T), curvature, error, converged)


class _Pull:
    """The prior's part of an alignment, in the units of the image's.

    Args:
        level: of the alignment.
        prior: None: there is none.
        hessian: ``(D, D)`` of the image where the level begins.
        clusters: ``(T, D)`` gradients of its tiles there.
    """

    def __init__(
        self, level: _Level, prior: Prior | None, hessian: FloatArray, clusters: FloatArray
    ) -> None:
        self._level, self._prior = level, prior
        self.dispersion = 1.0
        self.hessian = np.zeros_like(hessian)
        if prior is not None:
            # Errors' mean square over what independent ones of the Hessian's own scale would have.
            spread = np.trace(np.linalg.pinv(hessian, hermitian=True) @ (clusters.T @ clusters))
            self.dispersion = prior.doubt * max(float(spread) / len(hessian), 1e-9)
            self.hessian = self.dispersion * prior.information

    def gradient(self, state: FloatArray) -> FloatArray:
        """Of the prior ``(D,)``."""
        if self._prior is None:
            return np.zeros(len(self.hessian))
        return self.hessian @ self._level.space.difference(state, self._prior.state)

    def error(self, state: FloatArray) -> float:
        """The prior's share of the mean error, squared grey levels."""
        if self._prior is None:
            return 0.0
        offset = self._level.space.difference(state, self._prior.state)
        return float(offset @ self.hessian @ offset) / (6.0 * self._level.target[..., 0].size)


def _failed(space: StateSpace, state: FloatArray) -> Refined:
    unknown = np.full((space.dimension, space.dimension), np.inf)
    return Refined(state, unknown, np.zeros_like(unknown), math.inf, False)


def _step(
    space: StateSpace, hessian: FloatArray, gradient: FloatArray, damping: float
) -> FloatArray:
    """The damped step ``(D,)``, no longer than the linearisation can be trusted."""
    diagonal = np.diag(hessian)
    # A direction in which the image does not change at all must not make the system singular.
    damped = hessian + np.diag(damping * diagonal + 1e-9 * float(diagonal.max()) + 1e-12)
    step = -np.linalg.solve(damped, gradient)
    metres = float(np.linalg.norm(step[: space.positions])) / LARGEST_STEP_METRES
    radians = float(np.linalg.norm(step[space.positions :])) / LARGEST_STEP_RADIANS
    return np.asarray(step / max(1.0, metres, radians))


def _in_pixels(level: _Level, look: _Look, step: FloatArray) -> float:
    """About how far a step moves the picture, pixels."""
    some = np.s_[:: level.stride, :: level.stride]
    seen = look.view.inverse_depth[some][look.view.rgba[some][..., 3] > 0.0]
    nearness = float(np.median(seen)) if len(seen) else math.inf
    positions = level.space.positions
    metres, radians = np.linalg.norm(step[:positions]), np.linalg.norm(step[positions:])
    return float(level.intrinsics.fx * (metres * nearness + radians))
