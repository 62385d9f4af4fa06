"""What a state is: a robot's place on a floor, or a pose with six degrees of freedom.

Everything else in the filter is the same for both. A state is a vector of D numbers; differences
between states are vectors of D numbers too, metres first and then radians, in a frame whose axes
are the world's. So means, covariances, Gaussians and noise are written once:

``planar``: x, y, heading; the robot stands on z = 0 and its camera sits on a mount.
``spatial``: x, y, z and the rotation vector of world_from_body. A difference of rotations is the
rotation vector, in world axes, of the rotation from one to the other (the tangent space of
SO(3); Sola, Deray, Atchuthan 2018, "A micro Lie theory for state estimation in robotics").
"""

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np
import scipy

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray, checked_array
from pipelines.artifacts.errors import OptionError, quoted
from pipelines.geometry.pose import (
    checked_poses,
    inverse,
    planar_state_of,
    pose_from_rotation,
    world_from_base_planar,
    wrap_angle,
)

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# A mean direction is meaningless where the directions cancel to less than this share.
CANCELLED = 1e-9
# A uniform angle has no standard deviation; this is that of the uniform distribution.
LARGEST_ANGLE_SPREAD = math.pi / math.sqrt(3.0)


class StateSpace(Protocol):
    """What a state is, and the operations on states that the filter needs.

    A state is a vector of D numbers, metres first and then radians, of a body in the world.
    """

    @property
    def name(self) -> str:
        """``planar`` or ``spatial``."""

    @property
    def positions(self) -> int:
        """How many of a state's numbers are metres; they come first."""

    @property
    def angles(self) -> int:
        """How many are radians."""

    @property
    def dimension(self) -> int:
        """How many there are."""

    def poses(self, states: FloatArray) -> FloatArray:
        """Poses of states.

        Args:
            states: ``(..., D)``.

        Returns:
            ``(..., 4, 4)`` world_from_body.

        Raises:
            OptionError: no array of this shape.
        """

    def states(self, poses: FloatArray) -> FloatArray:
        """States of poses.

        Args:
            poses: ``(..., 4, 4)`` world_from_body.

        Returns:
            ``(..., D)``.

        Raises:
            OptionError: no array of this shape.
        """

    def moved(self, states: FloatArray, offsets: FloatArray) -> FloatArray:
        """States plus differences.

        Args:
            states: ``(..., D)``.
            offsets: ``(..., D)`` metres along the world's axes and radians about them.

        Returns:
            ``(..., D)``.
        """

    def difference(self, states: FloatArray, centre: FloatArray) -> FloatArray:
        """What leads from one state to others; angles by the shortest way.

        Args:
            states: ``(..., D)`` to where.
            centre: ``(..., D)`` from where.

        Returns:
            ``(..., D)`` metres along the world's axes and radians about them.
        """

    def composed(self, states: FloatArray, increments: FloatArray) -> FloatArray:
        """States after motions that are given in each state's own frame.

        Args:
            states: ``(..., D)`` before the motion.
            increments: ``(..., D)`` metres along the body's axes and radians about them.

        Returns:
            ``(..., D)``.
        """

    def increment(self, before: FloatArray, after: FloatArray) -> FloatArray:
        """The motion between two poses, as ``Localizer.step`` takes it.

        Args:
            before: ``(4, 4)`` world_from_body before the motion, in any world: odometry's will do.
            after: ``(4, 4)`` world_from_body after it, in the same world.

        Returns:
            ``(D,)`` metres along the body's axes before the motion and radians about them.

        Raises:
            OptionError: no arrays of these shapes.
        """

    def mean(self, states: FloatArray, weights: FloatArray) -> FloatArray:
        """The weighted mean; where the headings cancel out, the heaviest state's is taken.

        Args:
            states: ``(M, D)``.
            weights: ``(M,)``, not negative.

        Returns:
            ``(D,)``.
        """

    def spread(self, states: FloatArray) -> FloatArray:
        """How far states lie apart.

        Args:
            states: ``(M, D)``.

        Returns:
            ``(D,)`` standard deviations about their mean, metres and radians.
        """

    def uniform(
        self, low: FloatArray, high: FloatArray, count: int, rng: np.random.Generator
    ) -> FloatArray:
        """States with positions between two corners, in any orientation.

        Args:
            low: one corner, metres.
            high: the other corner, metres, nowhere below ``low``.
            count: how many.
            rng: the only source of randomness.

        Returns:
            ``(count, D)``.
        """

    def pair_angles(self, states: FloatArray, others: FloatArray) -> FloatArray:
        """Angles between the orientations of states and others.

        Args:
            states: ``(A, D)``.
            others: ``(B, D)``.

        Returns:
            ``(A, B)`` radians, in [0, pi].
        """

    def orientation_volume(self) -> float:
        """The integral over all orientations, in the measure of differences."""


class Planar:
    """States ``(M, 3)``: x and y in metres, heading in radians, in (-pi, pi]."""

    name = "planar"
    positions = 2
    angles = 1
    dimension = 3

    def poses(self, states: FloatArray) -> FloatArray:
        """``world_from_body`` ``(..., 4, 4)`` on the plane z = 0."""
        return world_from_base_planar(states)

    def states(self, poses: FloatArray) -> FloatArray:
        """The position seen from above and the heading of the body's x axis, ``(..., 3)``."""
        return planar_state_of(poses)

    def moved(self, states: FloatArray, offsets: FloatArray) -> FloatArray:
        """States plus differences ``(..., 3)``, headings wrapped."""
        moved = np.asarray(states + offsets, dtype=np.float64)
        moved[..., 2] = wrap_angle(moved[..., 2])
        return moved

    def difference(self, states: FloatArray, centre: FloatArray) -> FloatArray:
        """States less a centre, ``(..., 3)``, headings wrapped."""
        offsets = np.asarray(states - centre, dtype=np.float64)
        offsets[..., 2] = wrap_angle(offsets[..., 2])
        return offsets

    def composed(self, states: FloatArray, increments: FloatArray) -> FloatArray:
        """States after motions ``(..., 3)`` forward, left and counter-clockwise."""
        cosine, sine = np.cos(states[..., 2]), np.sin(states[..., 2])
        moved = np.empty(np.broadcast_shapes(states.shape, increments.shape))
        moved[..., 0] = states[..., 0] + cosine * increments[..., 0] - sine * increments[..., 1]
        moved[..., 1] = states[..., 1] + sine * increments[..., 0] + cosine * increments[..., 1]
        moved[..., 2] = wrap_angle(states[..., 2] + increments[..., 2])
        return moved

    def increment(self, before: FloatArray, after: FloatArray) -> FloatArray:
        """The motion ``(3,)`` between two poses that are projected to the plane."""
        before, after = _checked_poses(before), _checked_poses(after)
        return planar_state_of(inverse(world_from_base_planar(planar_state_of(before))) @ after)

    def mean(self, states: FloatArray, weights: FloatArray) -> FloatArray:
        """Weighted mean ``(3,)``; the heading is the circular mean."""
        total = float(np.sum(weights))
        x, y = weights @ states[:, :2] / total
        sine = weights @ np.sin(states[:, 2]) / total
        cosine = weights @ np.cos(states[:, 2]) / total
        if np.hypot(sine, cosine) < CANCELLED:
            heading = states[int(np.argmax(weights)), 2]
        else:
            heading = np.arctan2(sine, cosine)
        return np.array([x, y, float(wrap_angle(heading))])

    def spread(self, states: FloatArray) -> FloatArray:
        """Standard deviation ``(3,)``, circular for the heading; at most a uniform angle's."""
        resultant = float(np.hypot(np.cos(states[:, 2]).mean(), np.sin(states[:, 2]).mean()))
        heading = math.sqrt(-2.0 * math.log(max(min(resultant, 1.0), 1e-12)))
        return np.array(
            [states[:, 0].std(), states[:, 1].std(), min(heading, LARGEST_ANGLE_SPREAD)]
        )

    def uniform(
        self, low: FloatArray, high: FloatArray, count: int, rng: np.random.Generator
    ) -> FloatArray:
        """``(count, 3)`` states uniform over a rectangle and all headings."""
        lowest, highest = np.append(low, -np.pi), np.append(high, np.pi)
        states = np.asarray(lowest + (highest - lowest) * rng.random((count, 3)))
        states[:, 2] = wrap_angle(states[:, 2])
        return states

    def pair_angles(self, states: FloatArray, others: FloatArray) -> FloatArray:
        """Absolute differences ``(A, B)`` of headings, in [0, pi]."""
        return np.abs(wrap_angle(states[:, None, 2] - others[None, :, 2]))

    def orientation_volume(self) -> float:
        """The length of the circle of headings."""
        return 2.0 * math.pi


class Spatial:
    """States ``(M, 6)``: x, y, z in metres and the rotation vector of world_from_body, radians."""

    name = "spatial"
    positions = 3
    angles = 3
    dimension = 6

    def poses(self, states: FloatArray) -> FloatArray:
        """``world_from_body`` ``(..., 4, 4)`` of positions and rotation vectors."""
        states = checked_array(states, "states", (..., self.dimension), finite=False)
        rotation = scipy.spatial.transform.Rotation.from_rotvec(
            states[..., 3:].reshape(-1, 3)
        ).as_matrix()
        return pose_from_rotation(rotation.reshape(*states.shape[:-1], 3, 3), states[..., :3])

    def states(self, poses: FloatArray) -> FloatArray:
        """Positions and rotation vectors ``(..., 6)`` of poses."""
        poses = checked_poses(poses, "poses", (..., 4, 4))
        rotation = scipy.spatial.transform.Rotation.from_matrix(
            poses[..., :3, :3].reshape(-1, 3, 3)
        ).as_rotvec()
        vectors = rotation.reshape(*poses.shape[:-2], 3)
        return np.concatenate([poses[..., :3, 3], vectors], axis=-1)

    def moved(self, states: FloatArray, offsets: FloatArray) -> FloatArray:
        """States plus differences ``(..., 6)``; rotations are applied in world axes."""
        states, offsets = np.broadcast_arrays(states, offsets)
        rotations = _rotations(offsets) * _rotations(states)
        return _joined(states[..., :3] + offsets[..., :3], rotations)

    def difference(self, states: FloatArray, centre: FloatArray) -> FloatArray:
        """From a centre to states, ``(..., 6)``; rotation vectors in world axes."""
        states, centre = np.broadcast_arrays(states, centre)
        rotations = _rotations(states) * _rotations(centre).inv()
        return _joined(states[..., :3] - centre[..., :3], rotations)

    def composed(self, states: FloatArray, increments: FloatArray) -> FloatArray:
        """States after motions ``(..., 6)`` in the body's own axes."""
        states, increments = np.broadcast_arrays(states, increments)
        rotations = _rotations(states)
        steps = rotations.apply(np.array(increments[..., :3]).reshape(-1, 3))
        positions = states[..., :3] + steps.reshape(*states.shape[:-1], 3)
        return _joined(positions, rotations * _rotations(increments))

    def increment(self, before: FloatArray, after: FloatArray) -> FloatArray:
        """The motion ``(6,)`` between two poses, in the axes of the first."""
        before, after = _checked_poses(before), _checked_poses(after)
        return self.states(inverse(before) @ after)

    def mean(self, states: FloatArray, weights: FloatArray) -> FloatArray:
        """Weighted mean ``(6,)``; the rotation is the mean of quaternions."""
        position = weights @ states[:, :3] / float(np.sum(weights))
        rotation = (
            scipy.spatial.transform.Rotation.from_rotvec(states[:, 3:])
            .mean(weights=weights)
            .as_rotvec()
        )
        return np.concatenate([position, rotation])

    def spread(self, states: FloatArray) -> FloatArray:
        """Standard deviation ``(6,)``, of angles at most that of a uniform angle."""
        offsets = self.difference(states, self.mean(states, np.ones(len(states))))
        return np.asarray(
            np.minimum(offsets.std(axis=0), [np.inf] * 3 + [LARGEST_ANGLE_SPREAD] * 3)
        )

    def uniform(
        self, low: FloatArray, high: FloatArray, count: int, rng: np.random.Generator
    ) -> FloatArray:
        """``(count, 6)`` states uniform over a box and all rotations."""
        if count == 0:
            # Earlier versions of SciPy know no empty list of rotations.
            return np.empty((0, self.dimension))
        # Four normal numbers point in all directions alike, so that no rotation is preferred.
        rotation = scipy.spatial.transform.Rotation.from_quat(
            rng.standard_normal((count, 4))
        ).as_rotvec()
        return np.concatenate([rng.uniform(low, high, (count, 3)), rotation], axis=1)

    def pair_angles(self, states: FloatArray, others: FloatArray) -> FloatArray:
        """Angles ``(A, B)`` of the rotations between states and others, in [0, pi]."""
        first, second = _rotations(states).as_quat(), _rotations(others).as_quat()
        return np.asarray(2.0 * np.arccos(np.minimum(np.abs(first @ second.T), 1.0)))

    def orientation_volume(self) -> float:
        """The volume of SO(3) in rotation vectors of the tangent space."""
        return 8.0 * math.pi**2


PLANAR: StateSpace = Planar()
SPATIAL: StateSpace = Spatial()


def sigmas_of(space: StateSpace, position: float, angle: float) -> FloatArray:
    """``(D,)``: one number for every position, metres, and one for every angle, radians."""
    return np.array([position] * space.positions + [angle] * space.angles)


def magnitudes(space: StateSpace, difference: FloatArray) -> tuple[float, float]:
    """How far a difference ``(D,)`` leads: metres and radians."""
    metres = np.linalg.norm(difference[: space.positions])
    radians = np.linalg.norm(difference[space.positions :])
    return float(metres), float(radians)


def state_space_named(name: str) -> StateSpace:
    """The state space of a name.

    Raises:
        OptionError: unknown name.
    """
    for space in (PLANAR, SPATIAL):
        if space.name == name:
            return space
    raise OptionError(f"state space {quoted(name)} is none of {PLANAR.name}, {SPATIAL.name}")


def state_space_of_dimension(dimension: int) -> StateSpace:
    """The state space whose states have so many numbers.

    Raises:
        OptionError: neither 3 nor 6.
    """
    for space in (PLANAR, SPATIAL):
        if space.dimension == dimension:
            return space
    raise OptionError(f"states have {dimension} numbers instead of 3 (planar) or 6 (spatial)")


def grid_cells(
    space: StateSpace, states: FloatArray, position_size: float, angle_size: float
) -> IntArray:
    """Grid cells ``(M, D)`` in which states lie, for counting how far a belief is spread.

    Args:
        space: what a state is.
        states: ``(M, D)``.
        position_size: side of a cell along each position, metres.
        angle_size: side of a cell along each angle, radians.
    """
    sizes = sigmas_of(space, position_size, angle_size)
    # Moved by nothing, so that angles are wrapped: a whole revolution is no other cell.
    canonical = space.moved(states, np.zeros(space.dimension))
    return np.asarray(np.floor(canonical / sizes), dtype=np.int64)


def _checked_poses(value: FloatArray) -> FloatArray:
    """A pose ``(4, 4)``; whether it is rigid is not looked at."""
    return checked_array(value, "a pose", (4, 4), finite=False)


def _rotations(states: FloatArray) -> "Rotation":
    """The rotations of states ``(..., 6)``, in one row."""
    # A copy: SciPy warns of the views that broadcasting makes.
    return scipy.spatial.transform.Rotation.from_rotvec(np.array(states[..., 3:]).reshape(-1, 3))


def _joined(positions: FloatArray, rotations: "Rotation") -> FloatArray:
    vectors = rotations.as_rotvec().reshape(*positions.shape[:-1], 3)
    return np.concatenate([positions, vectors], axis=-1)


def state_errors(
    space: StateSpace, states: FloatArray, truth: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distances ``(N,)`` in metres and angles ``(N,)`` in radians between states and the truth.

    NaN where either is unknown.
    """
    distances, angles = np.full((2, len(states)), np.nan)
    known = known_states(states) & known_states(truth)
    if np.any(known):
        offsets = space.difference(states[known], truth[known])
        distances[known] = np.linalg.norm(offsets[:, : space.positions], axis=1)
        angles[known] = np.linalg.norm(offsets[:, space.positions :], axis=1)
    return distances, angles


def known_states(states: FloatArray) -> BoolArray:
    """Which of the states ``(N, D)`` are known: finite in all numbers, ``(N,)``."""
    return np.asarray(np.all(np.isfinite(states), axis=1), dtype=np.bool_)
