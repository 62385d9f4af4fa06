"""The settings of the nodes: topics, frames, times. Those that AMCL has are called as there."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.setting import Entry, check_settings, described, entries_of, setting
from pipelines.artifacts.settings_file import Choices
from pipelines.localize import config
from pipelines.localize.settings import LocalizerSettings

LONGEST_SECONDS = 3600.0


@described
@dataclass(frozen=True)
class NodeSettings:
    """Where a node reads and publishes. Seconds.

    Raises:
        OptionError: a value that makes no sense.
    """

    image_topic: str = setting(
        "ros",
        "camera/image_raw",
        "topic of the camera images; .../compressed is read as CompressedImage",
        is_common=True,
    )
    camera_info_topic: str | None = setting(
        "ros",
        None,
        "topic of the CameraInfo; beside: camera_info beside the images",
        unset="beside",
        is_common=True,
    )
    camera: str | None = setting(
        "ros",
        None,
        "camera.toml with camera and mount; messages: by CameraInfo and tf",
        unset="messages",
        is_common=True,
    )
    odometry_topic: str | None = setting(
        "ros",
        None,
        "topic of nav_msgs/Odometry to use; tf: from odom_frame_id to base_frame_id",
        unset="tf",
        is_common=True,
    )
    global_frame_id: str = setting("ros", "map", "frame of the scene model", is_common=True)
    odom_frame_id: str = setting("ros", "odom", "frame of the odometry", is_common=True)
    base_frame_id: str = setting("ros", "base_link", "frame of the robot", is_common=True)
    tf_broadcast: bool = setting(
        "ros", True, "whether the transform from odom_frame_id to global_frame_id is published"
    )
    transform_tolerance: float = setting(
        "ros",
        1.0,
        "how long a published transform is valid beyond its image",
        unit="seconds",
        limits=(0.0, LONGEST_SECONDS),
    )
    transform_timeout: float = setting(
        "ros",
        0.2,
        "how long an image waits for the odometry of its moment",
        unit="seconds",
        limits=(0.0, LONGEST_SECONDS),
    )
    camera_silence: float = setting(
        "ros",
        5.0,
        "time without images after which the camera is reported as silent",
        unit="seconds",
        limits=(0.1, LONGEST_SECONDS),
    )
    max_particles_published: int = setting(
        "ros",
        500,
        "at most so many particles, the heaviest, are published",
        limits=(1, 1_000_000),
    )

    def __post_init__(self) -> None:
        check_settings(self)
        for name in ("image_topic", "global_frame_id", "odom_frame_id", "base_frame_id"):
            if not getattr(self, name):
                raise OptionError(f"{name} is empty")

    @property
    def info_topic(self) -> str:
        """Topic of the CameraInfo."""
        if self.camera_info_topic:
            return self.camera_info_topic
        head, slash, _ = self.image_topic.removesuffix("/compressed").rpartition("/")
        return f"{head}{slash}camera_info"

    @property
    def is_compressed(self) -> bool:
        """Whether images come as CompressedImage."""
        return self.image_topic.endswith("/compressed")

    @property
    def camera_file(self) -> Path | None:
        """The file with camera and mount; None: messages say."""
        return Path(self.camera) if self.camera else None


NODE_ENTRIES = entries_of(NodeSettings())
ENTRIES = (*NODE_ENTRIES, *config.ENTRIES)
Both = tuple[NodeSettings, LocalizerSettings]


def effective_settings(path: Path | None, options: Choices) -> Both:
    """The node's and the filter's settings: options win over the file, it over the defaults.

    Args:
        path: a config file of the localization; None: there is none.
        options: settings chosen elsewhere.

    Raises:
        InputError: the file cannot be read, or has unknown keys or impossible values.
        OptionError: an option's value is impossible, by itself or together with the file's.
    """
    own = {item.name for item in fields(NodeSettings)}
    node = {name: value for name, value in options.items() if name in own}
    others = {name: value for name, value in options.items() if name not in own}
    return NodeSettings(**node), config.effective_settings(path, others)


def parameter_value(entry: Entry, value: Any) -> Any:
    """A setting as a ROS parameter: true or false, a number, a list of numbers, or a text."""
    return entry.kind.write(value)


def setting_of_parameter(entry: Entry, value: Any) -> Any:
    """The setting that the value of a ROS parameter stands for.

    Args:
        entry: the setting.
        value: true or false, a number, a sequence of numbers, or a text: either as in a config
            file or as at the command line.

    Raises:
        OptionError: none of its values; the text names the parameter.
    """
    if not isinstance(value, str | bool | int | float | None):
        value = list(value)
    try:
        try:
            made = entry.parsed(value)
        except ValueError:
            if not isinstance(value, str):
                raise
            made = entry.parsed_text(value)
    except ValueError as error:
        raise OptionError(f"parameter {entry.name} {error}") from error
    refusal = entry.setting.refusal(made)
    if refusal is not None:
        raise OptionError(f"parameter {entry.name} {refusal}")
    return made


def chosen_by_parameters(defaults: Choices, values: dict[str, Any]) -> Choices:
    """What parameters choose: those that differ from what they were declared with.

    Args:
        defaults: path -> value that the parameter was declared with.
        values: name -> value of the parameter.

    Raises:
        OptionError: an impossible value; the text names the parameter.
    """
    chosen: dict[str, Any] = {}
    for entry in ENTRIES:
        if entry.name not in values:
            continue
        made = setting_of_parameter(entry, values[entry.name])
        if made != defaults[entry.path]:
            chosen[entry.path] = made
    return chosen


def declared_defaults(both: Both) -> Choices:
    """Path -> value of all settings, as they are without parameters."""
    node = {entry.path for entry in NODE_ENTRIES}
    return {entry.path: entry.value_in(both[entry.path not in node]) for entry in ENTRIES}
