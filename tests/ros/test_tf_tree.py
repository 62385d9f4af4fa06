"""Frames and tracks: what lies between two transforms, and what no tree says."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.geometry.pose import inverse, pose_from_rotation, quaternion_of, rotation_angle
from pipelines.ros.pose_track import PoseSamples, PoseTrack, moved_enough
from pipelines.ros.tf_tree import TransformTree, base_of_tf, odometry_frames

NS = 1_000_000_000


def some_pose(seed: int) -> FloatArray:
    generator = np.random.default_rng(seed)
    rotation = scipy.spatial.transform.Rotation.from_rotvec(generator.normal(0.0, 1.0, 3))
    return pose_from_rotation(rotation.as_matrix(), generator.normal(0.0, 1.0, 3))


def transform(parent: str, child: str, pose: FloatArray, stamp: int = 0) -> Any:
    x, y, z = pose[:3, 3]
    turn = quaternion_of(pose)
    return SimpleNamespace(
        header=SimpleNamespace(
            frame_id=parent, stamp=SimpleNamespace(sec=stamp // NS, nanosec=stamp % NS)
        ),
        child_frame_id=child,
        transform=SimpleNamespace(
            translation=SimpleNamespace(x=x, y=y, z=z),
            rotation=SimpleNamespace(x=turn[0], y=turn[1], z=turn[2], w=turn[3]),
        ),
    )


def robot() -> TransformTree:
    """map -> odom -> base_link -> camera, the first two moving, and a joint that moves."""
    tree = TransformTree("drive.bag")
    tree.add([transform("base_link", "/camera", some_pose(1))], is_static=True)
    for number in range(21):
        stamp = number * NS // 10
        moving = [transform("odom", "base_link", some_pose(100 + number), stamp + 1)]
        if number % 5 == 0:
            moving.append(transform("map", "odom", some_pose(200 + number // 5), stamp + 7))
        moving.append(transform("base_link", "wheel", some_pose(300 + number), stamp))
        tree.add(moving, is_static=False)
    return tree


def test_fixed_transforms_are_composed_both_ways() -> None:
    tree = robot()
    tree.add([transform("camera", "lens", some_pose(2))], is_static=True)
    expected = some_pose(1) @ some_pose(2)
    np.testing.assert_allclose(tree.fixed("base_link", "lens"), expected, atol=1e-9)
    np.testing.assert_allclose(tree.fixed("lens", "base_link"), inverse(expected), atol=1e-9)
    np.testing.assert_allclose(tree.fixed("lens", "lens"), np.eye(4))


def test_a_track_goes_through_moving_and_fixed_frames() -> None:
    tree = robot()
    track = tree.track("odom", "camera", 0.2)
    assert track.stamps.tolist() == [number * NS // 10 + 1 for number in range(21)]
    np.testing.assert_allclose(track.poses[4], some_pose(104) @ some_pose(1), atol=1e-9)
    # map -> odom comes every half second: with gaps of 0.2 s nothing is known in between.
    assert tree.track("map", "base_link", 0.2).stamps.tolist() == [
        number * NS // 2 + 7 for number in range(4)
    ]
    whole = tree.track("map", "base_link", 0.6)
    assert len(whole) == 24
    assert base_of_tf(tree) == "base_link"
    assert odometry_frames(tree) == (("odom", "base_link"),)


@pytest.mark.parametrize(
    ("target", "source", "reason"),
    [
        ("base_link", "wheel", "moves in 'base_link'"),
        ("base_link", "camra", "no frame 'camra'; the nearest are 'camera'"),
        ("base_link", "sky", "tf does not connect 'sky' and 'base_link'"),
    ],
)
def test_frames_that_are_not_fixed_to_each_other(target: str, source: str, reason: str) -> None:
    tree = robot()
    tree.add([transform("heaven", "sky", np.eye(4))], is_static=True)
    with pytest.raises(InputError, match=reason):
        tree.fixed(target, source)


def test_a_track_of_what_does_not_move_is_none() -> None:
    with pytest.raises(InputError, match="does not move"):
        robot().track("base_link", "camera", 0.2)


def test_a_frame_that_is_never_used_may_be_broken() -> None:
    tree = robot()
    broken = transform("base_link", "broken", np.eye(4))
    broken.transform.rotation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
    tree.add([broken], is_static=True)
    assert tree.fixed("base_link", "camera").shape == (4, 4)
    with pytest.raises(InputError, match="quaternion"):
        tree.fixed("base_link", "broken")


def test_a_static_way_counts_before_one_that_moves() -> None:
    tree = robot()
    for number in range(3):
        moving = transform("base_link", "wheel", some_pose(number), number * NS)
        tree.add([moving, transform("wheel", "camera", some_pose(9), number * NS)], is_static=False)
    np.testing.assert_allclose(tree.fixed("base_link", "camera"), some_pose(1), atol=1e-9)


@given(st.floats(0.0, 1.0), st.integers(0, 1000))
def test_between_two_poses_lies_the_shortest_way(share: float, seed: int) -> None:
    first, second = some_pose(seed), some_pose(seed + 1)
    track = PoseTrack(np.array([0, NS]), np.stack([first, second]))
    poses, known = track.at(np.array([round(share * NS)]), 2.0)
    assert known.tolist() == [True]
    whole = float(rotation_angle(inverse(first) @ second))
    assert float(rotation_angle(inverse(first) @ poses[0])) == pytest.approx(
        share * whole, abs=1e-6
    )
    assert float(rotation_angle(inverse(poses[0]) @ second)) == pytest.approx(
        (1.0 - share) * whole, abs=1e-6
    )
    np.testing.assert_allclose(
        poses[0, :3, 3], first[:3, 3] + share * (second - first)[:3, 3], atol=1e-6
    )


def test_nothing_is_known_outside_and_in_gaps() -> None:
    track = PoseTrack(np.array([0, 1, 4]) * NS, np.stack([some_pose(k) for k in range(3)]))
    stamps = np.array([-1, 0, NS // 2, NS, 2 * NS, 4 * NS, 4 * NS + 1])
    _, known = track.at(stamps, 1.0)
    assert known.tolist() == [False, True, True, True, False, True, False]
    _, known = PoseTrack(np.array([5]), np.eye(4)[None]).at(np.array([4, 5, 6]), 1.0)
    assert known.tolist() == [False, True, False]


def test_samples_are_put_in_order_and_the_last_of_one_stamp_counts() -> None:
    samples = PoseSamples()
    for stamp, x in ((30, 3.0), (10, 1.0), (20, 2.0), (10, 9.0)):
        samples.add(stamp, SimpleNamespace(x=x, y=0.0, z=0.0), SimpleNamespace(x=0, y=0, z=0, w=1))
    track = samples.track("bag", "poses")
    assert track.stamps.tolist() == [10, 20, 30]
    assert track.poses[:, 0, 3].tolist() == [9.0, 2.0, 3.0]


def test_what_moved_enough() -> None:
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = [0.0, 0.4, 1.0, 1.9, 2.0]
    assert moved_enough(poses, 1.0, None) == [0, 2, 4]
    assert moved_enough(poses, None, 0.1) == [0]
