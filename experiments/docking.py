"""Docks a simulated robot from many starts and makes a table of how that went.

    python experiments/docking.py SCENE.h5 ROBOT -o FOLDER [--rows omni,diff] [--starts 20]

ROBOT is ``sim:sample_data/elevators/scene/scene.xml``, or ``model:WORLD.h5`` with another model
of the same lobby as the robot's world. A path-traced docking takes a minute or two.
"""

import argparse
import json
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipelines.artifacts.array_types import FloatArray
from pipelines.dock.dock import Report
from pipelines.dock.robots.actuation import MotionNoise
from pipelines.dock.robots.choice import RobotOptions
from pipelines.dock.robots.simulator import PathTracing
from pipelines.dock.settings import DockSettings
from pipelines.dock.stage import DockSummary, Goal, dock_robot
from pipelines.localize.settings import LocalizerSettings

GOAL = (-1.15, -1.65, math.pi / 2.0)
# Starts: x, y; the wall is y = 0 and reaches from -5.2 to 5.2 m, the map shows it up to 2.8 m.
X, Y = (-3.0, 2.0), (-5.0, -2.5)
WALL = (-4.9, 2.8)
HALF_FIELD_OF_VIEW = math.radians(29.0)
SEED = 123
RANDOM = MotionNoise()
SYSTEMATIC = replace(RANDOM, scale=0.15, drift=math.radians(9.0))


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        title: of the row.
        drive: ``omni`` or ``diff``.
        motion: errors of movements and odometry.
        sees_wall: whether the camera sees some of the wall at the start, or none of it.
        fault: kind and step of something that goes wrong, or None.
    """

    title: str
    drive: str = "omni"
    motion: MotionNoise = RANDOM
    sees_wall: bool = True
    fault: tuple[str, int] | None = None


ROWS = {
    "omni": Row("omni, 2 % and 0.5° a step"),
    "systematic": Row("omni, 15 % and 9° a metre", motion=SYSTEMATIC),
    "diff": Row("differential drive", drive="diff"),
    "blind": Row("starts that see none of the wall", sees_wall=False),
    "blocked": Row("wheels blocked from step 8", fault=("blocked", 8)),
    "black": Row("camera black from step 8", fault=("black", 8)),
    "driver": Row("driver raises at step 8", fault=("driver", 8)),
}


def wall_share(state: FloatArray) -> float:
    """Share of the field of view of a state ``(3,)`` that meets the mapped wall."""
    directions = state[2] + np.linspace(-HALF_FIELD_OF_VIEW, HALF_FIELD_OF_VIEW, 31)
    towards = np.sin(directions) > 0.05
    reach = np.where(towards, -state[1] / np.where(towards, np.sin(directions), 1.0), np.inf)
    x = state[0] + np.where(towards, reach * np.cos(directions), np.inf)
    return float(np.mean((x > WALL[0]) & (x < WALL[1])))


def starts(count: int, sees_wall: bool) -> list[FloatArray]:
    """The same random starts every time."""
    rng = np.random.default_rng(SEED)
    found: list[FloatArray] = []
    while len(found) < count:
        state = np.array([rng.uniform(*X), rng.uniform(*Y), rng.uniform(-math.pi, math.pi)])
        share = wall_share(state)
        if (share > 0.25) if sees_wall else (share == 0.0):
            found.append(state)
    return found


def docked(
    scene: Path, robot: str, folder: Path, name: str, number: int, samples: int
) -> DockSummary:
    """One docking of a row; its run is left in the folder."""
    row = ROWS[name]
    x, y, heading = starts(number + 1, row.sees_wall)[number]
    return dock_robot(
        scene,
        robot,
        Goal(pose=GOAL),
        folder / name / f"start-{number:02d}.h5",
        DockSettings(drive=row.drive),
        LocalizerSettings(),
        RobotOptions(
            true_start=(float(x), float(y), float(heading)),
            motion=row.motion,
            tracing=PathTracing(samples),
            fault=row.fault,
        ),
        seed=number,
        overwrite=True,
        listener=_silent,
    )


def _silent(report: Report) -> None:
    """Says nothing of a step."""


def nearest_to_wall(summary: DockSummary) -> float:
    """Metres between the wall and the nearest place where the robot really was."""
    places = [e.true_state for e in summary.docking.entries if e.true_state is not None]
    return -max(float(place[1]) for place in places)


def table_line(name: str, results: list[DockSummary]) -> str:
    """A row of the table, Markdown."""
    errors = [r.true_error for r in results if r.exit_code == 0 and r.true_error is not None]
    metres, radians = np.array(errors or [(math.nan, math.nan)]).T
    endings = [r.docking.outcome.ending.word for r in results]
    counts = ", ".join(f"{endings.count(word)} {word}" for word in dict.fromkeys(endings))
    seconds = {
        part: sum(r.docking.seconds[part] for r in results) for part in ("total", "robot", "filter")
    }
    cells = [
        ROWS[name].title,
        f"{counts} of {len(results)}",
        f"{100 * np.median(metres):.1f} / {100 * metres.max():.1f} cm",
        f"{np.degrees(np.median(radians)):.2f} / {np.degrees(radians.max()):.2f}°",
        f"{min(nearest_to_wall(r) for r in results):.2f} m",
        f"{np.median([len(r.docking.entries) for r in results]):.0f}",
        f"{seconds['total'] / len(results):.0f}",
        f"{seconds['robot'] / seconds['total']:.0%} / {seconds['filter'] / seconds['total']:.0%}",
    ]
    return "| " + " | ".join(cells) + " |"


HEADING = (
    "| what | outcome | true error, median / worst docked | heading likewise | nearest to the wall "
    "| steps | seconds | time in robot / filter |\n|---|---|---|---|---|---|---|---|"
)


def main() -> int:
    """Docks, writes ``table.md`` and ``results.json``, prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("scene", type=Path)
    parser.add_argument("robot")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--rows", default=",".join(ROWS))
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--samples", type=int, default=8)
    options = parser.parse_args()
    lines, records = [HEADING], {}
    for name in options.rows.split(","):
        count = options.starts if ROWS[name].fault is None else 1
        results = []
        for number in range(count):
            results.append(
                docked(options.scene, options.robot, options.output, name, number, options.samples)
            )
            last = results[-1].to_dict()
            error = last["true_error"] or {"position_m": math.nan, "heading_deg": math.nan}
            print(
                f"{name} {number}: {last['outcome']}, {last['steps']} steps, "
                f"{100 * error['position_m']:.1f} cm, {error['heading_deg']:.2f} deg",
                file=sys.stderr,
                flush=True,
            )
        records[name] = [result.to_dict() for result in results]
        lines.append(table_line(name, results))
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (options.output / "results.json").write_text(json.dumps(records, indent=2), encoding="utf-8")
    print("\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
