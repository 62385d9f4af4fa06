"""Transforms as they arrive."""

import threading
import time

import numpy as np
import pytest

from pipelines.geometry.pose import inverse
from pipelines.ros.pose_track import NANOSECONDS
from pipelines.ros.transform_buffer import TransformBuffer, TransformError
from tests.tf_samples import planar, transform

SECOND = NANOSECONDS


def moving() -> TransformBuffer:
    buffer = TransformBuffer()
    for second in range(5):
        pose = planar(float(second), 0.0, 80.0 * second)
        buffer.add([transform("odom", "base", second * SECOND, pose)], is_static=False)
    buffer.add([transform("/base", "camera", 0, planar(0.5, 0.1, 90.0))], is_static=True)
    return buffer


def test_between_two_messages_a_pose_is_interpolated() -> None:
    found = moving().lookup("odom", "base", 5 * SECOND // 2)
    np.testing.assert_allclose(found, planar(2.5, 0.0, 200.0), atol=1e-12)


def test_the_way_goes_up_and_down_the_tree() -> None:
    buffer = moving()
    expected = planar(1.0, 0.0, 80.0) @ planar(0.5, 0.1, 90.0)
    np.testing.assert_allclose(buffer.lookup("odom", "camera", SECOND), expected, atol=1e-12)
    np.testing.assert_allclose(
        buffer.lookup("camera", "odom", SECOND), inverse(expected), atol=1e-12
    )
    np.testing.assert_allclose(buffer.lookup("base", "base", SECOND), np.eye(4))


def test_messages_may_come_in_any_order_and_twice() -> None:
    buffer = TransformBuffer()
    for second in (3, 1, 2, 1, 0):
        pose = planar(float(second), 0.0, 0.0)
        buffer.add([transform("odom", "base", second * SECOND, pose)], is_static=False)
    for stamp in range(0, 3 * SECOND, SECOND // 4):
        assert buffer.lookup("odom", "base", stamp)[0, 3] == pytest.approx(stamp / SECOND)


@pytest.mark.parametrize(
    ("target", "source", "stamp", "text"),
    [
        ("odom", "bose", 0, "tf has no frame 'bose'; the nearest are 'base'"),
        ("odom", "base", 5 * SECOND, "tf of 'base' in 'odom' ends 1.000 s before the image"),
        ("odom", "base", -SECOND, "tf of 'base' in 'odom' begins 1.000 s after the image"),
        ("odom", "other", 0, "tf does not connect 'odom' and 'other'"),
    ],
)
def test_what_is_missing_is_named(target: str, source: str, stamp: int, text: str) -> None:
    buffer = moving()
    buffer.add([transform("elsewhere", "other", 0, np.eye(4))], is_static=True)
    with pytest.raises(TransformError, match=text):
        buffer.lookup(target, source, stamp)


def test_a_gap_is_not_bridged() -> None:
    buffer = TransformBuffer()
    for second in (0, 2):
        buffer.add([transform("odom", "base", second * SECOND, np.eye(4))], is_static=False)
    with pytest.raises(TransformError, match="gap of 2"):
        buffer.lookup("odom", "base", SECOND)


def test_only_the_last_seconds_are_kept() -> None:
    buffer = TransformBuffer(seconds=3.0)
    for second in range(1000):
        buffer.add([transform("odom", "base", second * SECOND, np.eye(4))], is_static=False)
    buffer.lookup("odom", "base", 996 * SECOND)
    with pytest.raises(TransformError, match="begins"):
        buffer.lookup("odom", "base", 995 * SECOND)


def test_what_is_no_transform_is_refused() -> None:
    buffer = TransformBuffer()
    bad = transform("odom", "base", 0, np.eye(4))
    bad.transform.rotation.w = 0.0
    nan = transform("odom", "wheel", 0, np.eye(4))
    nan.transform.translation.x = float("nan")
    assert buffer.add([bad, nan], is_static=False) == ("base", "wheel")
    assert buffer.frames == ()


def test_a_clock_set_back_forgets_what_moves() -> None:
    buffer = moving()
    buffer.clear()
    assert buffer.frames == ("base", "camera")


def test_an_image_waits_for_its_odometry() -> None:
    buffer = moving()
    late = transform("odom", "base", 5 * SECOND, planar(5.0, 0.0, 0.0))
    thread = threading.Timer(0.1, lambda: buffer.add([late], is_static=False))
    thread.start()
    assert buffer.wait("odom", "base", 5 * SECOND, 20.0)[0, 3] == 5.0
    thread.join()
    begin = time.monotonic()
    with pytest.raises(TransformError, match="ends"):
        buffer.wait("odom", "base", 6 * SECOND, 0.05)
    assert time.monotonic() - begin >= 0.05


def test_a_loop_of_frames_ends() -> None:
    buffer = TransformBuffer()
    buffer.add(
        [transform("a", "b", 0, np.eye(4)), transform("b", "a", 0, np.eye(4))], is_static=True
    )
    np.testing.assert_allclose(buffer.lookup("a", "b", 0), np.eye(4))
