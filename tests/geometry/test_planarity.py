"""Poses of robots on floors pass; what no robot on a floor can have is refused by its cause."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.geometry.planarity import Cause, cause_of, check_planar, planarity_of
from pipelines.geometry.pose import (
    BASE_FROM_FORWARD_CAMERA,
    pose_from_quaternion,
    pose_from_rotation,
    quaternion_of,
    world_from_base_planar,
    wrap_angle,
)
from pipelines.geometry.trajectory import read_tum
from pipelines.localize.state_space import PLANAR

CASE = Path(__file__).parents[3] / "shared/cases/odometry_quaternion_wxyz"
FILE = "odometry.txt"
seeds = st.integers(0, 2**32 - 1)
counts = st.integers(1, 40)


def planar_states(seed: int, count: int, turning: float = 0.15) -> FloatArray:
    """A drive with steps of up to half a metre that begins anywhere."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-math.pi, math.pi) + np.cumsum(rng.normal(0.0, turning, count))
    steps = rng.uniform(0.0, 0.5, count)
    start = rng.uniform(-20.0, 20.0, 2)
    x = start[0] + np.cumsum(steps * np.cos(heading))
    y = start[1] + np.cumsum(steps * np.sin(heading))
    return np.stack([x, y, np.asarray(wrap_angle(heading))], axis=1)


def turn(roll: float, pitch: float, yaw: float = 0.0) -> FloatArray:
    """A ``(4, 4)`` rotation by degrees about fixed x, y and z."""
    rotation = Rotation.from_euler("xyz", [roll, pitch, yaw], degrees=True).as_matrix()
    return pose_from_rotation(rotation, np.zeros(3))


def swapped(poses: FloatArray) -> FloatArray:
    """What is read from a file that has w first: x, y, z, w hold w, x, y, z."""
    x, y, z, w = quaternion_of(poses).T
    return pose_from_quaternion(poses[:, :3, 3], np.stack([w, x, y, z], axis=1))


def camera_frame(states: FloatArray) -> FloatArray:
    """The drive in the frame of its first camera: y down, z forward, as visual SLAM has it."""
    mount = pose_from_rotation(BASE_FROM_FORWARD_CAMERA, np.zeros(3))
    world_from_camera = world_from_base_planar(states) @ mount
    return np.asarray(np.linalg.inv(world_from_camera[0]) @ world_from_camera)


def noisy(poses: FloatArray, degrees: float, metres: float, seed: int) -> FloatArray:
    """With noise in roll, pitch and height."""
    rng = np.random.default_rng(seed)
    noise = np.stack([turn(*rng.normal(0.0, degrees, 2)) for _ in poses])
    result = poses @ noise
    result[:, 2, 3] += rng.normal(0.0, metres, len(poses))
    return np.asarray(result)


@given(seeds, counts)
def test_every_drive_on_a_floor_passes(seed: int, count: int) -> None:
    assert check_planar(world_from_base_planar(planar_states(seed, count)), FILE) is None


@given(seeds, counts, st.floats(-6.0, 6.0), st.floats(-6.0, 6.0))
def test_a_sensor_at_a_tilt_is_none_of_the_floors_business(
    seed: int, count: int, roll: float, pitch: float
) -> None:
    states = planar_states(seed, count)
    tilted = world_from_base_planar(states) @ turn(roll, pitch)
    assert check_planar(tilted, FILE) is None
    # Nor does it change the motion that the filter is told.
    for first, second, state, following in zip(
        tilted, tilted[1:], states, states[1:], strict=False
    ):
        assert PLANAR.increment(first, second) == pytest.approx(
            PLANAR.increment(world_from_base_planar(state), world_from_base_planar(following)),
            abs=1e-9,
        )


@given(seeds, st.integers(30, 200))
def test_noise_of_an_inertial_sensor_is_not_mentioned(seed: int, count: int) -> None:
    poses = noisy(world_from_base_planar(planar_states(seed, count)), 2.0, 0.01, seed)
    assert check_planar(poses, FILE) is None


@given(seeds, st.integers(2, 60))
def test_poses_that_pass_give_increments_that_are_right(seed: int, count: int) -> None:
    states = planar_states(seed, count)
    exact = world_from_base_planar(states)
    poses = noisy(exact, 3.0, 0.0, seed)
    if planarity_of(poses).is_contradiction:
        return
    for before in range(count - 1):
        wrong = PLANAR.increment(poses[before], poses[before + 1])
        right = PLANAR.increment(exact[before], exact[before + 1])
        assert np.abs(wrong - right)[:2] == pytest.approx(0.0, abs=0.02)
        assert abs(float(wrap_angle(wrong[2] - right[2]))) < math.radians(2.0)


@given(seeds, st.integers(2, 40))
def test_w_first_is_named(seed: int, count: int) -> None:
    states = planar_states(seed, count)
    # Where the heading is close to pi all the time, w is 0 and nothing can be told: begin at 0.
    states[:, 2] = wrap_angle(states[:, 2] - states[0, 2])
    poses = swapped(world_from_base_planar(states))
    with pytest.raises(InputError, match=r"as if w came first .*; lfnav reads tx ty tz qx"):
        check_planar(poses, FILE)


@given(seeds, st.integers(3, 40), st.floats(0.0, 2.0))
def test_w_first_is_named_with_noise(seed: int, count: int, degrees: float) -> None:
    states = planar_states(seed, count) * [1.0, 1.0, 0.1]
    poses = noisy(world_from_base_planar(states), degrees, 0.0, seed)
    assert planarity_of(swapped(poses)).is_contradiction
    assert cause_of(swapped(poses)) is Cause.W_FIRST


@given(seeds, st.integers(12, 40))
def test_the_frame_of_the_first_camera_is_named(seed: int, count: int) -> None:
    with pytest.raises(
        InputError, match=r"seems to be of a camera .*--degrees-of-freedom 6 without \[mount\]"
    ):
        check_planar(camera_frame(planar_states(seed, count)), FILE)


@example(198, 12, 0.0)
@given(seeds, st.integers(12, 40), st.floats(-30.0, 30.0))
def test_a_camera_in_a_level_world_is_named(seed: int, count: int, pitch: float) -> None:
    mount = pose_from_rotation(BASE_FROM_FORWARD_CAMERA, np.zeros(3))
    poses = world_from_base_planar(planar_states(seed, count)) @ turn(0.0, pitch) @ mount
    with pytest.raises(InputError, match="seems to be of a camera"):
        check_planar(poses, FILE)


def test_a_camera_that_drives_straight_ahead_is_named() -> None:
    poses = np.broadcast_to(np.eye(4), (10, 4, 4)).copy()
    poses[:, 2, 3] = 0.2 * np.arange(10)
    with pytest.raises(InputError, match=r"of a camera .*: it moves along its z axis"):
        check_planar(poses, FILE)


def test_a_ride_in_a_lift_is_no_camera() -> None:
    poses = world_from_base_planar(planar_states(3, 40))
    poses[20:, 2, 3] = 3.0
    with pytest.raises(
        InputError, match=r"changes its height by 3.00 m over .*; give --degrees-of-freedom 6"
    ):
        check_planar(poses, FILE)


def ramp(slope_deg: float, length: float, level: float = 5.0) -> FloatArray:
    """A level way, a ramp up, a level way, straight ahead; a pose every 10 cm."""
    along = np.arange(0.0, 2.0 * level + length, 0.1)
    on_ramp = np.clip(along - level, 0.0, length)
    slope = math.radians(slope_deg)
    poses = world_from_base_planar(np.zeros((len(along), 3)))
    poses[:, 0, 3] = along - on_ramp * (1.0 - math.cos(slope))
    poses[:, 2, 3] = on_ramp * math.sin(slope)
    is_on = (along > level) & (along < level + length)
    poses[is_on] = poses[is_on] @ turn(0.0, -slope_deg)
    return np.asarray(poses)


def test_a_steep_ramp_is_refused_with_its_numbers() -> None:
    with pytest.raises(
        InputError, match=r"leans by .* 12 degrees and changes .* 1.04 m .*--degrees-of-freedom 6"
    ):
        check_planar(ramp(12.0, 5.0), FILE)


def test_a_ramp_of_a_building_is_mentioned() -> None:
    note = check_planar(ramp(4.0, 6.0), FILE)
    assert note is not None
    assert re.search("changes its height by 0.42 m over (5.9|6.0) m", note)
    assert "--degrees-of-freedom 6" in note


def test_going_up_and_down_a_ramp_makes_it_no_flatter() -> None:
    once = ramp(5.0, 4.0)
    often = np.concatenate([once, once[::-1]] * 5)
    assert planarity_of(often).climb_path == pytest.approx(planarity_of(once).climb_path)
    assert check_planar(often, FILE) is not None


def test_a_street_that_falls_is_mentioned() -> None:
    states = np.zeros((92, 3))
    states[:, 0] = np.arange(92.0)
    poses = world_from_base_planar(states)
    poses[:, 2, 3] = -1.1 * np.arange(92.0) / 91.0
    note = check_planar(poses, FILE)
    assert note is not None
    assert re.search("by 1.10 m over (89|90|91)", note)


def test_a_hand_held_body_is_refused() -> None:
    rng = np.random.default_rng(0)
    poses = world_from_base_planar(planar_states(1, 50))
    poses = np.stack([pose @ turn(*rng.uniform(-40.0, 40.0, 2)) for pose in poses])
    with pytest.raises(InputError, match="is not of a robot on a floor: it leans by up to"):
        check_planar(poses, FILE)


def test_z_down_is_named() -> None:
    poses = world_from_base_planar(planar_states(2, 20)) @ turn(180.0, 0.0)
    with pytest.raises(InputError, match="its z axis points down"):
        check_planar(poses, FILE)


def test_odometry_that_began_at_the_identity_of_a_tilted_sensor_passes_with_a_note() -> None:
    # One plane, seen from a frame that leans by 9 degrees: it seems to climb.
    angle = np.linspace(0.0, 2.0 * np.pi, 40)
    circle = np.stack([np.cos(angle), np.sin(angle), angle + np.pi / 2.0], axis=1)
    base = world_from_base_planar(circle)
    sensor = turn(0.0, 9.0)
    found = planarity_of(np.linalg.inv(base[0] @ sensor) @ base @ sensor)
    assert found.wobble == pytest.approx(0.0, abs=1e-6)
    assert math.degrees(found.constant_lean) == pytest.approx(9.0)
    assert found.climb == pytest.approx(2.0 * math.sin(math.radians(9.0)), rel=0.01)


@pytest.mark.parametrize("count", [1, 2, 50])
def test_a_robot_that_stands_passes(count: int) -> None:
    assert check_planar(np.broadcast_to(np.eye(4), (count, 4, 4)), FILE) is None


def test_two_poses_that_lean_apart_are_refused() -> None:
    poses = np.stack([np.eye(4), turn(0.0, 40.0)])
    with pytest.raises(InputError, match="leans by up to 40 degrees"):
        check_planar(poses, FILE)


def test_a_robot_that_always_leans_much_is_mentioned() -> None:
    note = check_planar(world_from_base_planar(planar_states(4, 30)) @ turn(0.0, 20.0), FILE)
    assert note is not None
    assert "leans by up to 20 degrees" in note


@pytest.mark.parametrize(
    ("name", "cause"), [("odometry.txt", Cause.W_FIRST), ("orbslam.txt", Cause.CAMERA)]
)
def test_the_reported_case(name: str, cause: Cause) -> None:
    if not (CASE / name).is_file():
        pytest.skip(f"{CASE / name} is not there")
    poses = read_tum(CASE / name).poses
    assert planarity_of(poses).is_contradiction
    assert cause_of(poses) is cause
