"""nav2's dock database: which docks there are, and where."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.artifacts.arguments import checked_path
from pipelines.artifacts.atomic import check_output, write_text
from pipelines.artifacts.errors import OptionError, quoted
from pipelines.lightfield.open_world import scene_or_world

# The plugin of nav2 that takes poses of a detector.
DOCK_TYPE = "simple_charging_dock"
FRAME = "map"
_NAME = re.compile(r"[A-Za-z_]\w*")


@dataclass(frozen=True)
class DocksSummary:
    """What was written."""

    path: Path
    docks: Mapping[str, tuple[float, float, float]]

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        rows = [("dock", "x", "y", "heading")]
        rows += [
            (name, f"{x:.3f} m", f"{y:.3f} m", f"{math.degrees(heading):.1f} deg")
            for name, (x, y, heading) in self.docks.items()
        ]
        return [*rows, ("file", str(self.path), "", "")]

    def to_dict(self) -> dict[str, Any]:
        """The same for programs."""
        docks = {
            name: {"x_m": x, "y_m": y, "heading_rad": heading}
            for name, (x, y, heading) in self.docks.items()
        }
        return {"kind": "nav2-docks", "path": str(self.path), "docks": docks}


def export_docks(
    scene: Path,
    output: Path,
    docks: Mapping[str, tuple[float, float, float]],
    dock_type: str = DOCK_TYPE,
    *,
    overwrite: bool = False,
) -> DocksSummary:
    """Writes a dock database.

    Args:
        scene: scene model or world in whose map the docks are.
        output: file to write.
        docks: name -> x, y (metres) and heading (radians) of the docked robot.
        dock_type: the docking plugin's name in nav2's parameters.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: no scene, or a file that cannot be written.
        OptionError: no docks, names that are none, or a dock outside of the scene.
    """
    output = checked_path(output, "output")
    check_output(output, overwrite)
    if not docks:
        raise OptionError("there are no docks: give --dock NAME=X,Y,DEG")
    for name in (*docks, dock_type):
        if not _NAME.fullmatch(name):
            raise OptionError(f"{quoted(name)} is not a name of letters, digits and underscores")
    x_min, x_max, y_min, y_max = scene_or_world(scene, None).bounds
    lines = ["# For nav2's docking server: parameter dock_database.", "docks:"]
    for name, (x, y, heading) in docks.items():
        if not (x_min <= x <= x_max and y_min <= y <= y_max):
            raise OptionError(
                f"dock {name} lies outside of the scene model, which covers "
                f"x {x_min:.2f} to {x_max:.2f} m, y {y_min:.2f} to {y_max:.2f} m"
            )
        lines += [
            f"  {name}:",
            f"    type: {dock_type}",
            f"    frame: {FRAME}",
            f"    pose: [{x:.6f}, {y:.6f}, {heading:.6f}]",
            f"    id: {name}",
        ]
    write_text(output, "\n".join(lines) + "\n", overwrite)
    return DocksSummary(output, dict(docks))
