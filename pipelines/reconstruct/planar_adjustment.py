"""Planar bundle adjustment: structure from motion for a robot on a floor, with odometry.

Free structure from motion bends a long wall and lets the camera rise and pitch within what a pixel
leaves open. A robot does neither. Here poses and points are adjusted once more (bundle adjustment,
Triggs et al. 2000, "Bundle adjustment: a modern synthesis") with poses of three degrees of freedom,
and the motion between images is constrained by odometry. The position and heading of the whole in
the world stay as they were.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.pose import inverse, planar_state_of, world_from_base_planar, wrap_angle
from pipelines.reconstruct.reconstruction import Reconstruction

# Pixels: reprojection errors beyond this count linearly (Huber).
HUBER = 1.0
# Standard deviations of odometry between two images: metres plus a share of the distance, radians
# plus a share of the rotation.
STEP_POSITION, POSITION_SHARE = 0.003, 0.02
STEP_HEADING, HEADING_SHARE = math.radians(0.1), 0.02
# The most evaluations, and the relative change of the cost that ends the adjustment.
MOST_EVALUATIONS, SMALLEST_CHANGE = 60, 1e-6
# Largest reprojection error: a camera in a plane explains its images about as well as a free one.
LARGEST_ERROR = 2.0


@dataclass(frozen=True)
class PlanarAdjustment:
    """An adjusted reconstruction.

    Attributes:
        reconstruction: with adjusted poses and points.
        rms: root mean square reprojection error, pixels.
        moved: root mean square distance of the cameras from where they were, metres.
    """

    reconstruction: Reconstruction
    rms: float
    moved: float


@dataclass(frozen=True)
class _Problem:
    """The constants of the adjustment.

    Attributes:
        rays: ``(M, 2)`` observations as x / z and y / z.
        focal: ``(M, 2)`` pixels.
        image, point: ``(M,)`` indices of each observation's image and point.
        base_from_camera: ``(4, 4)``.
        increments: ``(N - 1, 3)`` by odometry, in the frame of the earlier image.
        sigmas: ``(N - 1, 3)`` standard deviations of the increments.
    """

    rays: FloatArray
    focal: FloatArray
    image: IntArray
    point: IntArray
    base_from_camera: FloatArray
    increments: FloatArray
    sigmas: FloatArray

    @property
    def images(self) -> int:
        return len(self.increments) + 1

    def split(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """States ``(N, 3)`` and points ``(P, 3)``."""
        count = 3 * self.images
        return unknowns[:count].reshape(-1, 3), unknowns[count:].reshape(-1, 3)

    def pixel_errors(self, unknowns: FloatArray) -> FloatArray:
        """Reprojection errors ``(M, 2)``, pixels."""
        states, points = self.split(unknowns)
        state, apart = states[self.image], points[self.point]
        cosine, sine = np.cos(state[:, 2]), np.sin(state[:, 2])
        x, y = apart[:, 0] - state[:, 0], apart[:, 1] - state[:, 1]
        base = np.stack([cosine * x + sine * y, cosine * y - sine * x, apart[:, 2]], axis=1)
        camera = (base - self.base_from_camera[:3, 3]) @ self.base_from_camera[:3, :3]
        return np.asarray(self.focal * (camera[:, :2] / camera[:, 2:] - self.rays))

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """``(2 M + 3 (N - 1),)`` without unit."""
        errors = self.pixel_errors(unknowns)
        length = np.linalg.norm(errors, axis=1, keepdims=True)
        # The residual whose square is Huber's loss.
        safe = np.maximum(length, HUBER)
        errors = errors * np.sqrt(2.0 * HUBER * safe - HUBER**2) / safe
        states, _ = self.split(unknowns)
        left = (_increments(states) - self.increments) / self.sigmas
        return np.concatenate([errors.ravel(), left.ravel()])

    def sparsity(self, unknowns: int) -> scipy.sparse.coo_matrix:
        """Which residual depends on which unknown."""
        seen, steps = np.arange(len(self.image)), np.arange(self.images - 1)
        first = 3 * self.images
        blocks = [
            _blocks(2 * seen, 2, 3 * self.image),
            _blocks(2 * seen, 2, first + 3 * self.point),
            _blocks(2 * len(seen) + 3 * steps, 3, 3 * steps),
            _blocks(2 * len(seen) + 3 * steps, 3, 3 * steps + 3),
        ]
        rows, columns = np.concatenate(blocks, axis=1)
        shape = (2 * len(seen) + 3 * len(steps), unknowns)
        return scipy.sparse.coo_matrix(
            (np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=shape
        )


def adjust_in_plane(
    reconstruction: Reconstruction, odometry_states: FloatArray
) -> PlanarAdjustment:
    """Adjusts poses and points of a reconstruction whose camera was carried by a robot.

    Args:
        reconstruction: metric, z up, by structure from motion; with the camera's mount.
        odometry_states: ``(N, 3)`` x, y, heading of the base at its images, by odometry.

    Raises:
        StageError: no mount, or the images contradict a movement in a plane.
    """
    mount, pixels = reconstruction.base_from_camera, reconstruction.observed_pixels
    if mount is None:
        raise StageError("--planar needs the camera's [mount] on the robot in camera.toml")
    before = planar_state_of(reconstruction.world_from_camera @ inverse(mount))
    point, image = reconstruction.observations.T
    cameras = reconstruction.camera_index[image]
    rays, focal = np.empty((len(pixels), 2)), np.empty((len(pixels), 2))
    for index, camera in enumerate(reconstruction.cameras):
        own = cameras == index
        rays[own] = camera.rays(pixels[own])[:, :2]
        focal[own] = camera.intrinsics.fx, camera.intrinsics.fy
    increments = _increments(odometry_states)
    problem = _Problem(rays, focal, image, point, mount, increments, _sigmas(increments))
    start = np.concatenate([before.ravel(), reconstruction.points.ravel()])
    found = scipy.optimize.least_squares(
        problem.residuals,
        start,
        jac_sparsity=problem.sparsity(len(start)),
        x_scale="jac",
        ftol=SMALLEST_CHANGE,
        max_nfev=MOST_EVALUATIONS,
    )
    rms = math.sqrt(float(np.mean(np.sum(problem.pixel_errors(found.x) ** 2, axis=1))))
    if not rms <= LARGEST_ERROR:
        raise StageError(
            f"the images do not fit a camera that moves in a plane ({rms:.1f} px); is the [mount] "
            "in camera.toml right? Without --planar the camera is free"
        )
    states, points = _put_back(*problem.split(found.x), before)
    moved = math.sqrt(float(np.mean(np.sum((states - before)[:, :2] ** 2, axis=1))))
    adjusted = replace(
        reconstruction,
        world_from_camera=world_from_base_planar(states) @ mount,
        points=points,
        statistics={**reconstruction.statistics, "planar_rms_px": rms, "planar_moved_m": moved},
    )
    return PlanarAdjustment(adjusted, rms, moved)


def _blocks(rows: IntArray, height: int, columns: IntArray) -> IntArray:
    """Row and column numbers ``(2, K)`` of dense blocks, three columns wide."""
    row, column = np.mgrid[0:height, 0:3]
    return np.stack(
        [
            (rows[:, None] + row.ravel()).ravel(),
            (columns[:, None] + column.ravel()).ravel(),
        ]
    )


def _increments(states: FloatArray) -> FloatArray:
    """Motions ``(N - 1, 3)`` from each state to the next, in the frame of the earlier one."""
    x, y, rotation = np.diff(states, axis=0).T
    cosine, sine = np.cos(states[:-1, 2]), np.sin(states[:-1, 2])
    return np.stack(
        [cosine * x + sine * y, cosine * y - sine * x, np.asarray(wrap_angle(rotation))], axis=1
    )


def _sigmas(increments: FloatArray) -> FloatArray:
    position = STEP_POSITION + POSITION_SHARE * np.hypot(increments[:, 0], increments[:, 1])
    heading = STEP_HEADING + HEADING_SHARE * np.abs(increments[:, 2])
    return np.stack([position, position, heading], axis=1)


def _put_back(
    states: FloatArray, points: FloatArray, before: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """States and points, rotated and shifted as a whole so that the states' mean is as before."""
    angles = before[:, 2] - states[:, 2]
    angle = math.atan2(float(np.sin(angles).mean()), float(np.cos(angles).mean()))
    cosine, sine = math.cos(angle), math.sin(angle)
    rotation = np.array([[cosine, -sine], [sine, cosine]])
    shift = before[:, :2].mean(axis=0) - rotation @ states[:, :2].mean(axis=0)
    moved = np.column_stack([states[:, :2] @ rotation.T + shift, wrap_angle(states[:, 2] + angle)])
    return moved, np.column_stack([points[:, :2] @ rotation.T + shift, points[:, 2]])
