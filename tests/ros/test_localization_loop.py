"""The loop between messages and poses, without ROS: its parts, and all of them together."""

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.localize.run import FrameRecord
from pipelines.localize.state_space import PLANAR, SPATIAL
from pipelines.ros.health import ERROR, OK, WARN, Health
from pipelines.ros.localization_loop import LocalizationLoop
from pipelines.ros.newest_image import NewestQueue
from pipelines.ros.node_settings import (
    ENTRIES,
    NodeSettings,
    chosen_by_parameters,
    declared_defaults,
    effective_settings,
    parameter_value,
    setting_of_parameter,
)
from pipelines.ros.pose_publishing import (
    KnownPose,
    PosePublishing,
    full_covariance,
    known_pose,
    weighted_particles,
)
from pipelines.ros.pose_track import NANOSECONDS
from tests.localize_samples import frame_record
from tests.tf_samples import planar, transform

STATE = np.array([1.0, 2.0, 0.5])
MOMENT = 100 * NANOSECONDS


def test_the_newest_image_wins() -> None:
    queue: NewestQueue[int] = NewestQueue()
    assert queue.put(1) is None
    assert queue.put(2) == 1
    found = queue.get(0.0)
    assert found is not None
    assert found[0] == 2
    assert queue.get(0.01) is None
    queue.put(3)
    queue.clear()
    assert queue.get(0.01) is None
    queue.close()
    assert queue.get(60.0) is None
    assert queue.is_closed


def record_of(status: str, **estimates: FloatArray) -> FrameRecord:
    record = frame_record(0.0, estimates)
    return FrameRecord(**{**vars(record), "status": status})


@pytest.mark.parametrize("status", ["global", "lost"])
def test_a_pose_that_is_not_known_is_not_published(status: str) -> None:
    assert known_pose(record_of(status, mode=STATE), PLANAR, MOMENT, np.eye(4)) is None


def test_a_known_pose_and_the_drift_of_odometry() -> None:
    odometry = planar(3.0, 1.0, 40.0)
    pose = known_pose(
        record_of("tracking", mode=STATE, refined=STATE + 0.1), PLANAR, MOMENT, odometry
    )
    assert pose is not None
    assert pose.is_measured
    np.testing.assert_allclose(PLANAR.states(pose.map_from_base), STATE + 0.1)
    np.testing.assert_allclose(pose.map_from_odom @ odometry, pose.map_from_base, atol=1e-12)
    assert pose.covariance[5, 5] == 0.0025
    assert np.count_nonzero(pose.covariance) == 3


def test_covariances_of_both_spaces() -> None:
    full = full_covariance(np.arange(9.0).reshape(3, 3), PLANAR)
    assert full[5, 1] == 7.0
    six = np.arange(36.0).reshape(6, 6)
    np.testing.assert_array_equal(full_covariance(six, SPATIAL), six)


def test_poses_are_repeated_only_while_they_are_known() -> None:
    publishing = PosePublishing()
    blind = known_pose(record_of("blind", mode=STATE), PLANAR, MOMENT, np.eye(4))
    tracked = known_pose(record_of("tracking", mode=STATE), PLANAR, MOMENT, np.eye(4))
    # Odometry cannot carry on what was never known.
    assert blind is not None
    assert publishing.update(blind) is None
    assert publishing.repeated(MOMENT + 1) is None
    assert publishing.update(tracked) is tracked
    assert publishing.repeated(MOMENT) is None
    assert publishing.repeated(MOMENT + 1) is not None
    assert publishing.update(blind) is blind
    publishing.update(None)
    assert publishing.repeated(MOMENT + 1) is None
    assert publishing.update(blind) is None


def test_the_heaviest_particles_are_shown() -> None:
    record = record_of("tracking", mode=STATE)
    poses, weights = weighted_particles(record, PLANAR, 7)
    assert poses.shape == (7, 4, 4)
    assert weights.min() >= np.sort(np.exp(record.log_weights))[-7]


def test_health_says_what_is_wrong_once() -> None:
    health = Health(5.0, "camera/image")
    health.start(0.0)
    assert health.check_silence(4.9) is None
    assert health.check_silence(5.0) == "no image on camera/image for 5 s"
    assert health.check_silence(6.0) is None
    assert health.report(6.0).level == ERROR
    health.arrived(6.5, gave_up=False)
    assert health.check_silence(7.0) == "over: no image on camera/image for 5 s"
    assert health.report(7.0).level == WARN
    health.localized(0.02, "tracking", 0.875)
    report = health.report(7.0)
    assert (report.level, report.message) == (OK, "tracking")
    assert report.values["confidence"] == "0.875"
    assert report.values["image rate (Hz)"] == "0.5"
    assert report.values["latency median (ms)"] == "20.0"
    health.localized(0.02, "lost", 0.0)
    assert health.report(7.0).level == WARN


def test_topics_beside_each_other() -> None:
    topics = {
        "camera/image_raw": "camera/camera_info",
        "/front/image/compressed": "/front/camera_info",
        "image": "camera_info",
        "/image": "/camera_info",
    }
    for image, info in topics.items():
        assert NodeSettings(image_topic=image).info_topic == info
    assert NodeSettings(camera_info_topic="elsewhere").info_topic == "elsewhere"


def test_every_setting_is_a_parameter_and_back() -> None:
    both = effective_settings(None, {})
    defaults = declared_defaults(both)
    values = {entry.name: parameter_value(entry, defaults[entry.path]) for entry in ENTRIES}
    assert all(isinstance(value, bool | int | float | str | list) for value in values.values())
    assert chosen_by_parameters(defaults, values) == {}
    values |= {"particles": 300, "start": [1.0, 2.0, 90.0], "area": "0,1,0,1", "camera": "c.toml"}
    chosen = chosen_by_parameters(defaults, values)
    assert chosen["start"] == (1.0, 2.0, np.pi / 2)
    node, settings = effective_settings(None, chosen)
    assert (node.camera, settings.particles, settings.area) == ("c.toml", 300, (0, 1, 0, 1))


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("particles", 300.5, "parameter particles is a number, expected a whole number"),
        ("particles", "many", "parameter particles 'many' is not a whole number"),
        ("particles", -1, "parameter particles -1 is not between"),
        ("transform_tolerance", float("nan"), "transform_tolerance nan is not between"),
        ("image_topic", 5, "parameter image_topic is a whole number, expected a text"),
        ("start", [1.0], "parameter start is"),
    ],
)
def test_impossible_parameters_are_named(name: str, value: Any, text: str) -> None:
    (entry,) = [entry for entry in ENTRIES if entry.name == name]
    with pytest.raises(OptionError, match=text):
        setting_of_parameter(entry, value)


class Told:
    """Outputs that are remembered."""

    def __init__(self) -> None:
        self.poses: list[KnownPose] = []
        self.transforms: list[int] = []
        self.frames: list[int] = []
        self.lines: list[str] = []

    def pose(self, pose: KnownPose) -> None:
        self.poses.append(pose)

    def transform(self, map_from_odom: FloatArray, stamp: int) -> None:
        self.transforms.append(stamp)

    def frame(self, record: FrameRecord, stamp: int) -> None:
        self.frames.append(stamp)

    def say(self, text: str, *, is_error: bool) -> None:
        self.lines.append(text)


class StandingLocalizer:
    """A localizer that is always where it is told to be."""

    space = PLANAR
    is_mounted = True

    def __init__(self) -> None:
        self.status = "tracking"
        self.resets = 0

    def step(self, image: Any, seconds: float, name: str, odom_from_base: Any) -> FrameRecord:
        return record_of(self.status, mode=STATE)

    def reset(self) -> None:
        self.resets += 1


def image_at(stamp: int, encoding: str = "mono8") -> Any:
    return SimpleNamespace(
        header=SimpleNamespace(
            frame_id="camera",
            stamp=SimpleNamespace(sec=stamp // NANOSECONDS, nanosec=stamp % NANOSECONDS),
        ),
        width=4,
        height=4,
        step=4,
        encoding=encoding,
        is_bigendian=0,
        data=bytes(16),
    )


@pytest.fixture
def parts() -> Any:
    told, localizer = Told(), StandingLocalizer()
    settings = NodeSettings(camera="c.toml", transform_timeout=0.0)
    health = Health(5.0, settings.image_topic)
    loop = LocalizationLoop(localizer, settings, told, health)  # type: ignore[arg-type]
    loop.start()
    yield loop, told, localizer
    loop.stop()


def wait_for(condition: Any) -> None:
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def odometry_at(loop: LocalizationLoop, stamp: int) -> None:
    item = transform("odom", "base_link", stamp, np.eye(4))
    loop.on_transforms(SimpleNamespace(transforms=[item]), is_static=False)


def test_faults_are_said_and_the_next_image_may_be_better(parts: Any) -> None:
    loop, told, localizer = parts
    loop.on_image(image_at(MOMENT))
    wait_for(lambda: "tf has no frame 'odom'" in told.lines)
    odometry_at(loop, MOMENT + 1)
    loop.on_image(image_at(MOMENT + 1))
    wait_for(lambda: told.poses)
    assert "over: tf has no frame 'odom'" in told.lines
    assert told.transforms == [MOMENT + 1]
    # An image that cannot be used: the transform is repeated with its time.
    loop.on_image(image_at(MOMENT + 2, "32FC1"))
    wait_for(lambda: len(told.transforms) == 2)
    assert "depth" in told.lines[-1]
    # While lost, nothing is.
    localizer.status = "lost"
    odometry_at(loop, MOMENT + 3)
    loop.on_image(image_at(MOMENT + 3))
    wait_for(lambda: MOMENT + 3 in told.frames)
    loop.on_image(image_at(MOMENT + 4, "32FC1"))
    wait_for(lambda: "depth" in told.lines[-1])
    assert len(told.poses) == 1
    assert told.transforms == [MOMENT + 1, MOMENT + 2]


def test_images_without_time_and_old_ones_are_not_localized(parts: Any) -> None:
    loop, told, localizer = parts
    odometry_at(loop, MOMENT)
    loop.on_image(image_at(MOMENT))
    wait_for(lambda: told.frames)
    loop.on_image(image_at(0))
    assert "have no time" in told.lines[-1]
    loop.on_image(image_at(MOMENT))
    loop.on_image(image_at(MOMENT - NANOSECONDS // 10))
    assert localizer.resets == 0
    # A clock that was set back is another matter.
    loop.on_image(image_at(MOMENT - 10 * NANOSECONDS))
    assert localizer.resets == 1
    assert "the clock was set back: starting again" in told.lines
    assert told.frames == [MOMENT]


def test_settings_of_nothing_are_impossible() -> None:
    with pytest.raises(OptionError, match="image_topic is empty"):
        NodeSettings(image_topic="")
