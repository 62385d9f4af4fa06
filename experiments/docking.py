"""Docks a simulated robot from many starts and tabulates the outcomes.

    python experiments/docking.py SCENE.h5 ROBOT -o FOLDER [--rows omni,diff] [--starts 20]
        [--workers 2] [--camera-width 240] [--samples 16]

For the lobby, ROBOT is ``sim:sample_data/elevators/scene/scene.xml``, or ``model:WORLD.h5`` with
another model of it as the robot's world; for the row ``doorway``, SCENE.h5 is a model of the place
that ``doorway.py`` photographs and ROBOT ``sim:sample_data/doorway/scene/scene.xml``. With
``sim:FOLDER`` it docks in several scenes of one place, by default the lobby under the lamps of the
map, under lamps from the side, in the evening and with people (``--scenes``). A path-traced docking
takes a minute or two. An interrupted study is continued: dockings whose run and result are in
FOLDER and have the same settings are not repeated.
"""

import argparse
import json
import math
import multiprocessing
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.atomic import write_text
from pipelines.dock.dock import Report
from pipelines.dock.goals import Goal
from pipelines.dock.robots.choice import RobotOptions
from pipelines.dock.robots.noise import MotionNoise
from pipelines.dock.robots.simulator import PathTracing
from pipelines.dock.settings import DockSettings
from pipelines.dock.stage import DockRequest, DockSummary, dock_robot
from pipelines.lightfield.scene_file import load_scene
from pipelines.localize.settings import LocalizerSettings

HALF_FIELD_OF_VIEW = math.radians(29.0)
SEED = 123
RANDOM = MotionNoise()
SYSTEMATIC = replace(RANDOM, scale=0.15, drift=math.radians(9.0))
# Scenes of one place. A robot docked farther from the goal than this (metres) is docked falsely.
SCENES = ("scene", "scene_side", "scene_evening", "scene_people")
FALSELY_DOCKED = 0.05
# The true path is checked at this many places between two images.
PLACES_ON_PATH = 20


def wall_distance(places: FloatArray) -> FloatArray:
    """Metres from places ``(N, 2)`` to the wall y = 0."""
    return -places[:, 1]


def pillar_distance(places: FloatArray) -> FloatArray:
    """Metres from places ``(N, 2)`` to the nearest of the two pillars of ``doorway.py``."""
    outside = np.maximum(np.abs(np.abs(places) - [0.65, 2.0]) - 0.2, 0.0)
    return np.asarray(np.hypot(outside[:, 0], outside[:, 1]))


@dataclass(frozen=True)
class Place:
    """Where dockings take place.

    Attributes:
        goal: x, y (metres) and heading (radians).
        x: range of x of the starts, metres.
        y: range of y of the starts, metres.
        wall: range of x in which the map shows the wall y = 0, metres.
        distance: from places ``(N, 2)`` to their distances from obstacles, metres.
    """

    goal: tuple[float, float, float]
    x: tuple[float, float]
    y: tuple[float, float]
    wall: tuple[float, float]
    distance: Callable[[FloatArray], FloatArray]


LOBBY = Place((-1.15, -1.65, math.pi / 2.0), (-3.0, 2.0), (-5.0, -2.5), (-4.9, 2.8), wall_distance)
DOORWAY = Place((0.0, -1.0, math.pi / 2.0), (-1.4, 1.4), (-5.0, -3.4), (-2.4, 2.4), pillar_distance)


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        title: text in the table.
        settings: the docking's settings.
        motion: errors of movements and odometry.
        sees_wall: whether the camera sees some of the wall at the start, or none of it.
        fault: kind of a fault and the step at which it begins; None: no fault.
        place: where the robot docks.
        starts: largest number of starts.
    """

    title: str
    settings: DockSettings = field(default_factory=DockSettings)
    motion: MotionNoise = RANDOM
    sees_wall: bool = True
    fault: tuple[str, int] | None = None
    place: Place = LOBBY
    starts: int = 20


ROWS = {
    "omni": Row("omni, 2 % and 0.5° a step"),
    "systematic": Row("omni, 15 % and 9° a metre", motion=SYSTEMATIC),
    "diff": Row("differential drive", DockSettings(drive="diff")),
    "blind": Row("starts that see none of the wall", sees_wall=False, starts=10),
    "people": Row("people walk by from step 8", fault=("people", 8), starts=10),
    "cover": Row("camera covered from step 8", fault=("cover", 8), starts=1),
    "frozen": Row("camera hangs from step 8", fault=("frozen", 8), starts=1),
    "blocked": Row("wheels blocked from step 8", fault=("blocked", 8), starts=1),
    "black": Row("camera black from step 8", fault=("black", 8), starts=1),
    "driver": Row("driver raises at step 8", fault=("driver", 8), starts=1),
    "doorway": Row(
        "passage of 0.9 m, robot of 0.6 m",
        DockSettings(staging_distance=2.2, robot_radius=0.3),
        place=DOORWAY,
        starts=10,
    ),
}
LOBBY_ROWS = [name for name, row in ROWS.items() if row.place is LOBBY]


def wall_share(place: Place, state: FloatArray) -> float:
    """Share of the field of view of a state ``(3,)`` that meets the mapped wall."""
    directions = state[2] + np.linspace(-HALF_FIELD_OF_VIEW, HALF_FIELD_OF_VIEW, 31)
    towards = np.sin(directions) > 0.05
    reach = np.where(towards, -state[1] / np.where(towards, np.sin(directions), 1.0), np.inf)
    x = state[0] + np.where(towards, reach * np.cos(directions), np.inf)
    return float(np.mean((x > place.wall[0]) & (x < place.wall[1])))


def starts(row: Row, count: int) -> list[FloatArray]:
    """Random starts of a row, the same in every call."""
    rng = np.random.default_rng(SEED)
    found: list[FloatArray] = []
    place = row.place
    while len(found) < count:
        x, y = rng.uniform(*place.x), rng.uniform(*place.y)
        state = np.array([x, y, rng.uniform(-math.pi, math.pi)])
        share = wall_share(place, state)
        if (share > 0.25) if row.sees_wall else (share == 0.0):
            found.append(state)
    return found


@dataclass(frozen=True)
class Inputs:
    """What all dockings of a table have in common.

    Attributes:
        scene: scene model in which the robot is localized.
        identifier: identifier of the scene model.
        folder: folder to write.
        tracing: how a ``sim:`` robot renders images.
        camera_width: width of these images, pixels.
        threads: number of threads of the filter; None: one a processor.
    """

    scene: Path
    identifier: str
    folder: Path
    tracing: PathTracing
    camera_width: int
    threads: int | None


@dataclass(frozen=True)
class Task:
    """One docking.

    Attributes:
        row: key of ``ROWS``.
        world: name of the robot's world; empty where there is only one.
        robot: name of the robot as ``robots.choice.robot_named`` takes it.
        number: number of the start.
    """

    row: str
    world: str
    robot: str
    number: int

    @property
    def key(self) -> str:
        """Key of the table's line."""
        return f"{self.row} {self.world}".strip()


def result_of(inputs: Inputs, task: Task) -> dict[str, Any]:
    """The result of one docking, from the folder where it was done with the same settings."""
    row, number = ROWS[task.row], task.number
    x, y, heading = (float(value) for value in starts(row, number + 1)[number])
    options = RobotOptions(
        true_start=(x, y, heading),
        camera_width=inputs.camera_width,
        motion=row.motion,
        tracing=inputs.tracing,
        fault=row.fault,
    )
    made_with = {
        "scene": inputs.identifier,
        "robot": task.robot,
        "goal": list(row.place.goal),
        "settings": row.settings.to_dict(),
        "options": json.loads(json.dumps(asdict(options), default=str)),
    }
    path = inputs.folder / task.world / task.row / f"start-{number:02d}.h5"
    record = path.with_suffix(".json")
    if path.is_file() and record.is_file():
        before: dict[str, Any] = json.loads(record.read_text(encoding="utf-8"))
        if before["made_with"] == made_with:
            return before
    request = DockRequest(
        inputs.scene,
        task.robot,
        Goal(pose=row.place.goal),
        LocalizerSettings(threads=inputs.threads),
        row.settings,
        options,
        seed=number,
    )
    summary = dock_robot(request, path, overwrite=True, listener=_silent)
    result = {
        "made_with": made_with,
        "nearest_m": nearest(row.place, summary),
        **summary.to_dict(),
    }
    write_text(record, json.dumps(result, indent=2), overwrite=True)
    return result


def tasks(names: list[str], robot: str, scenes: list[str], count: int) -> list[Task]:
    """All dockings: the first start of everything, then the second, and so on."""
    kind, _, rest = robot.partition(":")
    worlds = {"": robot}
    if kind == "sim" and Path(rest).is_dir():
        worlds = {name: f"sim:{Path(rest) / name}.xml" for name in scenes}
    return [
        Task(name, world, worlds[world], number)
        for number in range(count)
        for world in worlds
        for name in names
        if number < ROWS[name].starts
    ]


def done(inputs: Inputs, chosen: list[Task], workers: int) -> Iterator[tuple[Task, dict[str, Any]]]:
    """Executes dockings in several processes; yields them as they end."""
    if workers == 1:
        yield from ((task, result_of(inputs, task)) for task in chosen)
        return
    # Mitsuba does not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        running = {pool.submit(result_of, inputs, task): task for task in chosen}
        for ended in as_completed(running):
            yield running[ended], ended.result()


def _silent(report: Report) -> None:
    """Ignores a step."""


def nearest(place: Place, summary: DockSummary) -> float:
    """Least distance (metres) of the robot's centre from obstacles along its true path."""
    states = [e.true_state for e in summary.docking.entries if e.true_state is not None]
    places = np.stack(states)[:, :2]
    shares = np.linspace(0.0, 1.0, PLACES_ON_PATH)[:, None, None]
    between = places[:1] if len(places) == 1 else places[:-1] + shares * np.diff(places, axis=0)
    return float(place.distance(between.reshape(-1, 2)).min())


def table_line(key: str, results: list[dict[str, Any]]) -> str:
    """A row of the table, Markdown."""
    name, _, world = key.partition(" ")
    docked = [r["true_error"] for r in results if r["exit_code"] == 0 and r["true_error"]]
    errors = [(error["position_m"], error["heading_deg"]) for error in docked]
    metres, degrees = np.array(errors or [(math.nan, math.nan)]).T
    falsely = int(np.sum(metres > FALSELY_DOCKED))
    outcomes = [r["outcome"] for r in results]
    others = [word for word in dict.fromkeys(outcomes) if word != "docked"]
    counts = ", ".join(f"{outcomes.count(word)} {word}" for word in others)
    parts = ("total", "robot", "filter")
    seconds = {part: sum(r["seconds"][part] for r in results) for part in parts}
    robot, belief = (seconds[part] / seconds["total"] for part in ("robot", "filter"))
    cells = [
        ROWS[name].title + (f", {world}" if world else ""),
        f"{outcomes.count('docked')} of {len(results)}",
        counts or "–",
        f"{falsely}",
        f"{100 * np.median(metres):.1f} / {100 * metres.max():.1f} cm" if errors else "–",
        f"{np.median(degrees):.2f} / {degrees.max():.2f}°" if errors else "–",
        f"{min(r['nearest_m'] for r in results):.2f} m",
        f"{np.median([r['steps'] for r in results]):.0f}",
        f"{seconds['total'] / len(results):.0f}",
        f"{robot:.0%} / {belief:.0%} / {1.0 - robot - belief:.0%}",
    ]
    return "| " + " | ".join(cells) + " |"


HEADING = (
    "| what | docked | other outcomes | falsely (> 5 cm) | true error, median / worst docked "
    "| median / worst heading error | nearest | steps | seconds | time in robot / filter / rest |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)


def main(arguments: Sequence[str]) -> int:
    """Docks, writes ``table.md`` and ``results.json``, prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("scene", type=Path)
    parser.add_argument("robot", help="as for lfnav dock; sim:FOLDER: several scenes in FOLDER")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--rows", default=",".join(LOBBY_ROWS))
    parser.add_argument("--scenes", default=",".join(SCENES), help="of sim:FOLDER, without .xml")
    parser.add_argument("--starts", type=int, default=20, help="a row at most")
    parser.add_argument("--samples", type=int, default=PathTracing().samples, help="paths a pixel")
    parser.add_argument("--variant", default=PathTracing().variant, help="of Mitsuba")
    parser.add_argument("--camera-width", type=int, default=RobotOptions().camera_width)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args(arguments)
    inputs = Inputs(
        options.scene,
        load_scene(options.scene).identifier,
        options.output,
        PathTracing(options.samples, variant=options.variant),
        options.camera_width,
        None if options.workers == 1 else 1,
    )
    chosen = tasks(
        options.rows.split(","), options.robot, options.scenes.split(","), options.starts
    )
    # The table is written after every docking.
    results: dict[str, dict[int, dict[str, Any]]] = {task.key: {} for task in chosen}
    for task, last in done(inputs, chosen, options.workers):
        results[task.key][task.number] = last
        error = last["true_error"] or {"position_m": math.nan, "heading_deg": math.nan}
        print(
            f"{task.key} {task.number}: {last['outcome']}, {last['steps']} steps, "
            f"{100 * error['position_m']:.1f} cm, {error['heading_deg']:.2f} deg, "
            f"nearest {last['nearest_m']:.2f} m, {last['seconds']['total']:.0f} s",
            file=sys.stderr,
            flush=True,
        )
        found = {key: [each[n] for n in sorted(each)] for key, each in results.items()}
        write_table(options.output, found)
    print((options.output / "table.md").read_text(encoding="utf-8"), end="")
    return 0


def write_table(folder: Path, results: dict[str, list[dict[str, Any]]]) -> None:
    """Writes the table and the results so far."""
    lines = [HEADING, *(table_line(name, found) for name, found in results.items() if found)]
    (folder / "table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "results.json").write_text(json.dumps(results, indent=2), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
