"""The docking's settings: what a user can choose, said once and checked when it is made.

Config file, command line and docs/settings.md are made from the fields (``artifacts.setting``).
Where the robot starts and which area it must not leave are settings of the filter.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any

from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.setting import check_settings, described, setting
from pipelines.artifacts.setting_kinds import DEGREES

DRIVES = ("omni", "diff")
# A robot of a known radius keeps this much between its hull and the surface; any other keeps its
# middle this far from it. Metres.
MARGIN, USUAL_DISTANCE = 0.05, 0.5

SECTIONS = {"dock": "How the robot moves, and when it is docked or gives up."}


@described
@dataclass(frozen=True)
class DockSettings:
    """How to move, when to stop. Metres, radians, seconds.

    Raises:
        OptionError: a value that makes no sense.
    """

    drive: str = setting(
        "dock",
        "omni",
        "omni: any direction at any time; diff: turns on the spot and arcs",
        choices=DRIVES,
        is_common=True,
    )
    largest_step: float = setting(
        "dock",
        0.4,
        "length of one movement at most",
        unit="metres",
        limits=(0.01, 10.0),
        is_common=True,
    )
    largest_turn: float = setting(
        "dock",
        math.radians(40.0),
        "rotation of one movement at most",
        unit=DEGREES,
        limits=(1.0, 180.0),
        former=("largest_turn",),
        is_common=True,
    )
    robot_radius: float = setting(
        "dock",
        0.0,
        "radius of the circle that the robot fills on the floor, for narrow places; 0: not known",
        unit="metres",
        limits=(0.0, 100.0),
        is_common=True,
    )
    least_distance: float | None = setting(
        "dock",
        None,
        f"distance of the robot's middle from the scene's surface at least; auto: robot_radius and "
        f"{MARGIN:g}, or {USUAL_DISTANCE:g} where no radius is given",
        unit="metres",
        limits=(0.0, 100.0),
        unset="auto",
        is_common=True,
    )
    staging_distance: float = setting(
        "dock",
        0.8,
        "the last approach begins so far straight behind the goal. Where the goal lies behind a "
        "door: before the door",
        unit="metres",
        limits=(0.1, 100.0),
        is_common=True,
    )
    max_steps: int = setting(
        "dock", 120, "movements after which it gives up", limits=(1, 100_000), is_common=True
    )
    max_seconds: float = setting(
        "dock",
        1800.0,
        "time after which it gives up",
        unit="seconds",
        limits=(0.1, 1e7),
        is_common=True,
    )
    max_search: int = setting(
        "dock", 40, "steps of looking round after which it is lost", limits=(1, 100_000)
    )
    patience: float = setting(
        "dock",
        10.0,
        "it stands still so long when somebody covers the view; simulated robots, which have no "
        "clock, take as many images",
        unit="seconds",
        limits=(0.0, 1e5),
        is_common=True,
    )
    max_attempts: int = setting(
        "dock", 4, "so often it returns to the staging pose before it gives up", limits=(1, 1000)
    )
    position_tolerance: float = setting(
        "dock",
        0.01,
        "distance from the goal, by the estimate, at which it is docked",
        unit="metres",
        limits=(1e-4, 10.0),
        is_common=True,
    )
    heading_tolerance: float = setting(
        "dock",
        math.radians(0.4),
        "heading from the goal's, by the estimate, at which it is docked",
        unit=DEGREES,
        limits=(0.005, 180.0),
        former=("heading_tolerance",),
        is_common=True,
    )
    position_bound: float = setting(
        "dock",
        0.1,
        "two standard deviations and the distance to the goal together have to be below",
        unit="metres",
        limits=(1e-4, 10.0),
    )
    heading_bound: float = setting(
        "dock",
        math.radians(4.0),
        "two standard deviations and the heading from the goal's together have to be below",
        unit=DEGREES,
        limits=(0.005, 180.0),
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.distance_kept >= self.robot_radius:
            raise OptionError(
                f"a robot of radius {self.robot_radius:g} m touches the surface at the least "
                f"distance {self.distance_kept:g} m of its middle"
            )
        for what in ("position", "heading"):
            if getattr(self, f"{what}_bound") < getattr(self, f"{what}_tolerance"):
                raise OptionError(f"{what}_bound is smaller than {what}_tolerance")

    @property
    def distance_kept(self) -> float:
        """Metres at least between the robot's middle and the scene's surface."""
        if self.least_distance is not None:
            return self.least_distance
        return self.robot_radius + MARGIN if self.robot_radius > 0.0 else USUAL_DISTANCE

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return asdict(self)
