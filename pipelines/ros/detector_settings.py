"""The settings of the dock detector. Nothing is imported that is slow to load."""

from dataclasses import dataclass

from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.setting import check_settings, described, entries_of, setting
from pipelines.artifacts.setting_kinds import POSE

SECTION = "dock-detector"


@described
@dataclass(frozen=True)
class DetectorSettings:
    """Which dock is detected, and when its pose is sure. Metres, radians, seconds.

    Raises:
        OptionError: a value that makes no sense.
    """

    goal: tuple[float, ...] | None = setting(
        SECTION,
        None,
        "pose of the docked robot in the map: x, y, heading, metres and degrees",
        unset="none",
        kind=POSE,
        is_common=True,
    )
    max_age: float = setting(
        SECTION,
        1.0,
        "a pose of an image that is older is not sent; nav2 refuses it, too",
        unit="seconds",
        limits=(0.01, 60.0),
        is_common=True,
    )
    least_confidence: float = setting(
        SECTION,
        0.5,
        "a pose that is right with a smaller probability is not sent",
        limits=(0.0, 1.0),
        is_common=True,
    )
    largest_sigma: float = setting(
        SECTION,
        0.1,
        "a pose whose position has a larger standard deviation is not sent",
        unit="metres",
        limits=(0.001, 10.0),
        is_common=True,
    )
    detection_range: float = setting(
        SECTION,
        5.0,
        "a dock that is farther away is not detected",
        unit="metres",
        limits=(0.1, 1000.0),
        is_common=True,
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.goal is not None and len(self.goal) != 3:
            raise OptionError("the goal of a dock is of the form X,Y,DEG")


ENTRIES = entries_of(DetectorSettings())
