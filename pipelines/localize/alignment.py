"""Direct image alignment: a state moved until its rendered view fits the camera image best.

Gauss-Newton on the photometric error, damped after Levenberg and Marquardt, from coarse images to
fine ones (Baker and Matthews 2004, "Lucas-Kanade 20 years on"; the depth of each pixel comes from
the light field as in direct visual odometry, Kerl, Sturm, Cremers 2013, "Robust odometry estimation
for RGB-D cameras"). In every step the view is rendered at the present state, so that what is
minimised is the true difference; only the derivative takes colours to stay with their surface
points. Gain and offset of the camera image are estimated too, and pixels that show something else
than the model are weighted down (Tukey's biweight).

The covariance is the sandwich estimate H^-1 B H^-1 with B summed over tiles of the image (clustered
errors, Liang and Zeger 1986): errors of neighbouring pixels are far from independent, and a
covariance that takes them as independent is much too small.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.localize.observation import Observation
from pipelines.localize.state_space import StateSpace, magnitudes
from pipelines.native import fitted_brightness, normal_equations, robust_error
from pipelines.render.comparison import LARGEST_GAIN, prepared
from pipelines.render.renderer import RenderingWithSurface

# Errors beyond so many standard deviations are outliers (95 % efficiency on normal errors).
TUKEY = 4.685
# Least standard deviation of errors, levels of the channels: about what rounding leaves.
SMALLEST_SCALE = 3.0
# A pixel whose neighbours differ by less than so many levels says nothing about the pose.
FLAT = 10.0
# Fewer comparable pixels than this share of the image say nothing about the pose.
SMALLEST_SHARE = 0.15
LARGEST_STEP_METRES, LARGEST_STEP_RADIANS = 0.3, math.radians(8.0)
# A step that moves the image by less than this, in pixels, ends a pyramid level.
STEP_PIXELS = 0.1
TILES_ACROSS = 8
# Gain and offset are told apart while the determinant of their equations is more than this share of
# what it can be.
SMALLEST_DETERMINANT = 1e-12
FIRST_DAMPING, DAMPING_FACTOR, LARGEST_DAMPING = 1e-3, 8.0, 10.0


class SurfaceRenderer(Protocol):
    """Renders views with their surface: ``render.renderer.Renderer``, or one on top of it."""

    def render_with_surface(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> RenderingWithSurface:
        """Renders one virtual view together with its surface.

        Args:
            world_from_camera: ``(4, 4)``.
            intrinsics: of the virtual camera.
        """


@dataclass(frozen=True)
class Alignment:
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
        inflation: factor on the covariance that the image's own tiles give: errors of the model
            reach farther than a tile.
    """

    state: FloatArray
    information: FloatArray
    inflation: float


@dataclass(frozen=True)
class _Residuals:
    """The view rendered at a state, and the brightness that fits it to the camera image.

    Attributes:
        view: the rendering.
        gain: factor on the rendering.
        offset: added to it, grey levels.
        scale: robust standard deviation of the differences that remain, grey levels.
    """

    view: RenderingWithSurface
    gain: float
    offset: float
    scale: float


@dataclass(frozen=True)
class _Level:
    """One pyramid level of an alignment, and what does not change on it."""

    renderer: SurfaceRenderer
    space: StateSpace
    body_from_camera: FloatArray
    intrinsics: Intrinsics
    target: Float32Array

    @property
    def stride(self) -> int:
        """Brightness is fitted to every so many-th pixel of every so many-th row."""
        return max(1, self.intrinsics.width // 40)

    def residuals(self, state: FloatArray) -> _Residuals | None:
        """Renders and compares; None where too little of the scene is seen."""
        pose = self.space.poses(state) @ self.body_from_camera
        view = self.renderer.render_with_surface(pose, self.intrinsics)
        covered = view.covered
        if np.count_nonzero(covered) < SMALLEST_SHARE * covered.size:
            return None
        gain, offset, scale = fitted_brightness(
            view.rgba, self.target, self.stride, TUKEY, SMALLEST_SCALE, LARGEST_GAIN
        )
        return _Residuals(view, gain, offset, scale)

    def error(self, residuals: _Residuals, scale: float) -> float:
        """Robust error, squared grey levels, with outliers beyond ``TUKEY`` times a scale."""
        rgba, limit = residuals.view.rgba, TUKEY * scale
        return robust_error(rgba, self.target, residuals.gain, residuals.offset, limit)

    def normal_equations(
        self, state: FloatArray, residuals: _Residuals
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Hessian ``(D, D)``, gradient ``(D,)`` and the tiles' gradients ``(T, D)``.

        Gain and offset are eliminated, so that what they could explain does not move the state.
        """
        view, pinhole = residuals.view, self.intrinsics
        body = self.space.poses(state)
        camera = body @ self.body_from_camera
        axes, is_rotation = _unknowns(self.space)
        hessian, clusters = normal_equations(
            image=view.rgba,
            inverse_depth=view.inverse_depth,
            target=self.target,
            gain=residuals.gain,
            offset=residuals.offset,
            limit=TUKEY * residuals.scale,
            flat=FLAT,
            intrinsics=pinhole.vector()[:4],
            rotation=np.ascontiguousarray(camera[:3, :3]),
            lever=camera[:3, 3] - body[:3, 3],
            axes=axes,
            is_rotation=is_rotation,
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
    """World axis ``(D, 3)`` of each unknown, and ``(D,)`` whether it is a rotation about it."""
    axes = np.eye(3)
    # The one angle of a robot on the floor is about the vertical.
    rotation_axes = axes[3 - space.angles :]
    is_rotation = np.arange(space.dimension) >= space.positions
    return np.concatenate([axes[: space.positions], rotation_axes]), is_rotation


def align(
    renderer: SurfaceRenderer,
    space: StateSpace,
    state: FloatArray,
    body_from_camera: FloatArray,
    observations: Sequence[Observation],
    iterations: int = 8,
    prior: Prior | None = None,
) -> Alignment:
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
        iterations: at most, on each pyramid level.
        prior: what is known of the state before; None: the image alone decides.
    """
    result = _failed(space, np.array(state, dtype=np.float64))
    for observation in observations:
        target = prepared(observation.image)
        level = _Level(renderer, space, body_from_camera, observation.intrinsics, target)
        result = _align_level(level, result.state, iterations, prior)
        if not math.isfinite(result.error):
            break
    return result


def _align_level(
    level: _Level, state: FloatArray, iterations: int, prior: Prior | None
) -> Alignment:
    """``align`` on one pyramid level."""
    residuals = level.residuals(state)
    if residuals is None:
        return _failed(level.space, state)
    damping, converged = FIRST_DAMPING, False
    error = level.error(residuals, residuals.scale)
    hessian, gradient, clusters = level.normal_equations(state, residuals)
    prior_term = _PriorTerm(level, prior, hessian, clusters)
    for _ in range(iterations):
        step = _step(
            level.space,
            hessian + prior_term.hessian,
            gradient + prior_term.gradient(state),
            damping,
        )
        converged = _in_pixels(level, residuals, step) < STEP_PIXELS
        if converged:
            break
        proposed = level.space.moved(state, step)
        then = level.residuals(proposed)
        if then is not None and level.error(then, residuals.scale) + prior_term.error(
            proposed
        ) < error + prior_term.error(state):
            state, residuals = proposed, then
            error = level.error(residuals, residuals.scale)
            hessian, gradient, clusters = level.normal_equations(state, residuals)
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
        covariance = np.linalg.inv(hessian / prior_term.dispersion + prior.information)
    curvature = hessian / (3.0 * residuals.view.inverse_depth.size)
    return Alignment(state, 0.5 * (covariance + covariance.T), curvature, error, converged)


class _PriorTerm:
    """The prior's part of what is minimised, in the units of the image's.

    Args:
        level: the pyramid level.
        prior: None: there is none, and all parts are zero.
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
            # Mean square of the tiles' gradients over that of independent pixels.
            spread = np.trace(np.linalg.pinv(hessian, hermitian=True) @ (clusters.T @ clusters))
            self.dispersion = prior.inflation * max(float(spread) / len(hessian), 1e-9)
            self.hessian = self.dispersion * prior.information

    def gradient(self, state: FloatArray) -> FloatArray:
        """The prior's part of the gradient, ``(D,)``."""
        if self._prior is None:
            return np.zeros(len(self.hessian))
        return self.hessian @ self._level.space.difference(state, self._prior.state)

    def error(self, state: FloatArray) -> float:
        """The prior's part of the mean error, squared grey levels."""
        if self._prior is None:
            return 0.0
        offset = self._level.space.difference(state, self._prior.state)
        return float(offset @ self.hessian @ offset) / (6.0 * self._level.target[..., 0].size)


def _failed(space: StateSpace, state: FloatArray) -> Alignment:
    unknown = np.full((space.dimension, space.dimension), np.inf)
    return Alignment(state, unknown, np.zeros_like(unknown), math.inf, False)


def _step(
    space: StateSpace, hessian: FloatArray, gradient: FloatArray, damping: float
) -> FloatArray:
    """The damped step ``(D,)``, no longer than the linearisation can be trusted."""
    diagonal = np.diag(hessian)
    # A direction in which the image does not change at all must not make the system singular.
    damped = hessian + np.diag(damping * diagonal + 1e-9 * float(diagonal.max()) + 1e-12)
    step: FloatArray = -np.asarray(np.linalg.solve(damped, gradient), dtype=np.float64)
    metres, radians = magnitudes(space, step)
    return np.asarray(step / max(1.0, metres / LARGEST_STEP_METRES, radians / LARGEST_STEP_RADIANS))


def _in_pixels(level: _Level, residuals: _Residuals, step: FloatArray) -> float:
    """About how far a step moves the image, pixels."""
    view, some = residuals.view, np.s_[:: level.stride, :: level.stride]
    seen = view.inverse_depth[some][view.rgba[some][..., 3] > 0.0]
    inverse_depth = float(np.median(seen)) if len(seen) else math.inf
    metres, radians = magnitudes(level.space, step)
    return level.intrinsics.fx * (metres * inverse_depth + radians)
