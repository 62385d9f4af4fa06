"""The settings of a robot that is driven over ROS: ``ros2:FILE.toml``."""

import math
from dataclasses import dataclass
from pathlib import Path

from pipelines.artifacts.setting import check_settings, described, entries_of, setting
from pipelines.artifacts.setting_kinds import DEGREES
from pipelines.artifacts.settings_file import Choices, possible_choices
from pipelines.artifacts.toml_file import read_toml
from pipelines.ros.node_settings import NodeSettings
from pipelines.ros.velocity_control import VelocityLimits

SECTION = "robot"


@described
@dataclass(frozen=True)
class RobotSettings:
    """Topics, limits, times. Metres, radians, seconds.

    Raises:
        OptionError: a value that makes no sense.
    """

    image_topic: str = setting(
        SECTION, "camera/image_raw", "topic of the camera images; .../compressed: CompressedImage"
    )
    camera_info_topic: str | None = setting(
        SECTION,
        None,
        "topic of the CameraInfo; beside: camera_info beside the images",
        unset="beside",
    )
    camera: str | None = setting(
        SECTION,
        None,
        "camera.toml with camera and mount; messages: by CameraInfo and tf",
        unset="messages",
    )
    base_frame_id: str = setting(SECTION, "base_link", "frame of the robot")
    odometry_topic: str = setting(SECTION, "odom", "topic of nav_msgs/Odometry")
    cmd_vel_topic: str = setting(SECTION, "cmd_vel", "topic of the velocities")
    stamped: bool = setting(
        SECTION, False, "whether velocities are TwistStamped, as since Kilted, or Twist"
    )
    holonomic: bool = setting(
        SECTION, True, "whether the robot drives sideways; false goes with drive diff"
    )
    max_speed: float = setting(
        SECTION, 0.2, "greatest speed", unit="metres a second", limits=(0.001, 20.0)
    )
    max_turn_speed: float = setting(
        SECTION,
        math.radians(30.0),
        "greatest rotation in a second",
        unit=DEGREES,
        limits=(0.1, 1000.0),
    )
    acceleration: float = setting(
        SECTION,
        0.3,
        "greatest change of speed in a second",
        unit="metres a second",
        limits=(0.001, 100.0),
    )
    turn_acceleration: float = setting(
        SECTION,
        math.radians(60.0),
        "greatest change of the rotation speed in a second",
        unit=DEGREES,
        limits=(0.1, 10000.0),
    )
    rate: float = setting(
        SECTION, 20.0, "velocities that are sent in a second", limits=(1.0, 1000.0)
    )
    start_timeout: float = setting(
        SECTION,
        10.0,
        "how long camera, mount, odometry and whoever drives are waited for at first",
        unit="seconds",
        limits=(0.1, 3600.0),
    )
    image_timeout: float = setting(
        SECTION,
        5.0,
        "time without an image after which the robot has failed",
        unit="seconds",
        limits=(0.1, 3600.0),
    )
    odometry_timeout: float = setting(
        SECTION,
        0.5,
        "time without odometry after which the robot is stopped and has failed",
        unit="seconds",
        limits=(0.05, 60.0),
    )
    stall_timeout: float = setting(
        SECTION,
        1.0,
        "time without motion by odometry after which a movement is ended",
        unit="seconds",
        limits=(0.1, 60.0),
    )

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def limits(self) -> VelocityLimits:
        """Of speed and acceleration."""
        return VelocityLimits(
            self.max_speed, self.max_turn_speed, self.acceleration, self.turn_acceleration
        )

    @property
    def info_topic(self) -> str:
        """Topic of the CameraInfo."""
        node = NodeSettings(image_topic=self.image_topic, camera_info_topic=self.camera_info_topic)
        return node.info_topic


ENTRIES = entries_of(RobotSettings())


def robot_settings_of(path: Path | None) -> RobotSettings:
    """The settings in a file with one section, ``[robot]``; None: the defaults.

    Raises:
        InputError: the file cannot be read, or has unknown keys or impossible values.
    """
    if path is None:
        return RobotSettings()
    return _made(possible_choices(path, read_toml(path), ENTRIES, _made))


def _made(chosen: Choices) -> RobotSettings:
    return RobotSettings(**chosen)
