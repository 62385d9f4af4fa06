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
        "omni: the robot moves in any direction; diff: it rotates on the spot and drives arcs",
        choices=DRIVES,
        is_common=True,
    )
    largest_step: float = setting(
        "dock",
        0.4,
        "greatest length of one movement",
        unit="metres",
        limits=(0.01, 10.0),
        is_common=True,
    )
    largest_turn: float = setting(
        "dock",
        math.radians(40.0),
        "greatest rotation of one movement",
        unit=DEGREES,
        limits=(1.0, 180.0),
        former=("largest_turn",),
        is_common=True,
    )
    robot_radius: float = setting(
        "dock",
        0.0,
        "radius of the circle that the robot fills on the floor, for narrow passages; 0: not known",
        unit="metres",
        limits=(0.0, 100.0),
        is_common=True,
    )
    least_distance: float | None = setting(
        "dock",
        None,
        f"least distance of the robot's centre from the scene's surface; auto: robot_radius plus "
        f"{MARGIN:g}, or {USUAL_DISTANCE:g} where no radius is given",
        unit="metres",
        limits=(0.0, 100.0),
        unset="auto",
        is_common=True,
    )
    staging_distance: float = setting(
        "dock",
        0.8,
        "distance of the staging pose straight behind the goal; the last approach begins there. "
        "Where the goal lies behind a door, the staging pose has to lie before it",
        unit="metres",
        limits=(0.1, 100.0),
        is_common=True,
    )
    max_steps: int = setting(
        "dock",
        120,
        "movements after which docking is given up",
        limits=(1, 100_000),
        is_common=True,
    )
    max_seconds: float = setting(
        "dock",
        1800.0,
        "time after which docking is given up",
        unit="seconds",
        limits=(0.1, 1e7),
        is_common=True,
    )
    max_search: int = setting(
        "dock", 40, "steps of a search after which the robot is lost", limits=(1, 100_000)
    )
    patience: float = setting(
        "dock",
        10.0,
        "how long the robot stands still and takes images when something covers the view; a "
        "simulated robot, which has no clock, takes as many images without waiting",
        unit="seconds",
        limits=(0.0, 1e5),
        is_common=True,
    )
    max_attempts: int = setting(
        "dock",
        4,
        "approaches from the staging pose after which docking is given up",
        limits=(1, 1000),
    )
    position_tolerance: float = setting(
        "dock",
        0.01,
        "greatest distance of the estimate from the goal at which the robot is docked",
        unit="metres",
        limits=(1e-4, 10.0),
        is_common=True,
    )
    heading_tolerance: float = setting(
        "dock",
        math.radians(0.4),
        "greatest heading error of the estimate at which the robot is docked",
        unit=DEGREES,
        limits=(0.005, 180.0),
        former=("heading_tolerance",),
        is_common=True,
    )
    position_bound: float = setting(
        "dock",
        0.1,
        "docked only where the distance to the goal plus two standard deviations is below this",
        unit="metres",
        limits=(1e-4, 10.0),
    )
    heading_bound: float = setting(
        "dock",
        math.radians(4.0),
        "docked only where the heading error plus two standard deviations is below this",
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
