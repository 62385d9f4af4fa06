"""The docking's settings: what a user can choose, checked when it is made."""

import math
from dataclasses import asdict, dataclass
from typing import Any

from pipelines.artifacts.arguments import check_fields
from pipelines.artifacts.errors import OptionError, quoted

DRIVES = ("omni", "diff")
# A robot of a known radius keeps this much between its hull and the surface; any other keeps its
# middle this far from it. Metres.
MARGIN, USUAL_DISTANCE = 0.05, 0.5


@dataclass(frozen=True)
class DockSettings:
    """How to move, when to stop. Metres, radians, seconds.

    Attributes:
        drive: ``omni`` (any direction at any time) or ``diff`` (turns on the spot and arcs).
        start: roughly where the robot stands, x, y and heading; None: anywhere in the area.
        area: x_min, x_max, y_min, y_max that the robot must not leave; None: the scene's bounds.
        largest_step, largest_turn: of one movement.
        robot_radius: of the circle that the robot fills on the floor; 0: not known.
        least_distance: of the robot's middle from the scene's surface; None: the robot's radius and
            ``MARGIN``, or ``USUAL_DISTANCE`` where no radius is known.
        staging_distance: the staging pose is this far straight behind the goal.
        max_steps, max_seconds: after so many movements, or so much time, it gives up.
        max_search: so many steps it looks round before it is lost.
        patience: so long it waits, standing still, when something covers the view. Simulated robots
            take as many images and have no clock.
        max_attempts: so often it returns to the staging pose before it gives up.
        position_tolerance, heading_tolerance: how near the estimate has to be to the goal.
        position_bound, heading_bound: what the belief must rule out before it is called docked: two
            standard deviations and the distance to the goal together.

    Raises:
        OptionError: a value that makes no sense.
    """

    drive: str = "omni"
    start: tuple[float, float, float] | None = None
    area: tuple[float, float, float, float] | None = None
    largest_step: float = 0.4
    largest_turn: float = math.radians(40.0)
    robot_radius: float = 0.0
    least_distance: float | None = None
    staging_distance: float = 0.8
    max_steps: int = 120
    max_seconds: float = 1800.0
    max_search: int = 40
    patience: float = 10.0
    max_attempts: int = 4
    position_tolerance: float = 0.01
    heading_tolerance: float = math.radians(0.4)
    position_bound: float = 0.1
    heading_bound: float = math.radians(4.0)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.drive not in DRIVES:
            raise OptionError(f"drive {quoted(self.drive)} is none of {', '.join(DRIVES)}")
        if self.start is not None and not all(map(math.isfinite, self.start)):
            raise OptionError(f"start {self.start} is not finite")
        _within("largest step", self.largest_step, 0.01, 10.0)
        _within("largest turn", self.largest_turn, math.radians(1.0), math.pi)
        _within("robot radius", self.robot_radius, 0.0, 100.0)
        _within("least distance", self.distance_kept, 0.0, 100.0)
        if self.distance_kept < self.robot_radius:
            raise OptionError(
                f"a robot of radius {self.robot_radius:g} m touches the surface at the least "
                f"distance {self.distance_kept:g} m of its middle"
            )
        _within("staging distance", self.staging_distance, 0.1, 100.0)
        _within("number of steps", self.max_steps, 1, 100_000)
        _within("number of seconds", self.max_seconds, 0.1, 1e7)
        _within("number of search steps", self.max_search, 1, 100_000)
        _within("patience", self.patience, 0.0, 1e5)
        _within("number of attempts", self.max_attempts, 1, 1000)
        _within("position tolerance", self.position_tolerance, 1e-4, 10.0)
        _within("heading tolerance", self.heading_tolerance, 1e-4, math.pi)
        _within("position bound", self.position_bound, self.position_tolerance, 10.0)
        _within("heading bound", self.heading_bound, self.heading_tolerance, math.pi)

    @property
    def distance_kept(self) -> float:
        """Metres at least between the robot's middle and the scene's surface."""
        if self.least_distance is not None:
            return self.least_distance
        return self.robot_radius + MARGIN if self.robot_radius > 0.0 else USUAL_DISTANCE

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        values = asdict(self)
        for name in ("start", "area"):
            values[name] = None if values[name] is None else list(values[name])
        return values


def _within(name: str, value: float, low: float, high: float) -> None:
    # Written so that NaN fails the test too.
    if not low <= value <= high:
        raise OptionError(f"{name} {value:g} is not between {low:g} and {high:g}")
