"""The stage ``report``: from a run and its scene to a folder with a page and figures."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pipelines.artifacts.arguments import PathLike, check_fields, checked_instance, checked_path
from pipelines.artifacts.atomic import atomic_folder, check_output
from pipelines.artifacts.errors import InputError, LfnavError, OptionError
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.lightfield.obstacle_points import obstacle_points, obstacle_points_of_world
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import scene_provenance
from pipelines.localize.run import Run, load_run
from pipelines.localize.scene_of_run import load_scene_of_run
from pipelines.report.animation import animation
from pipelines.report.content import page_of
from pipelines.report.docking import docking_figure
from pipelines.report.figures import Content, frame_figure, overview_figure, pdf_of, png_of
from pipelines.report.page import html_of
from pipelines.report.style import figure_style
from pipelines.report.surroundings import surroundings_of
from pipelines.report.time_plots import time_figure
from pipelines.report.tracks import tracks_of
from pipelines.report.verdict import Verdict
from pipelines.report.views import ViewMaker, renderer_at

PAGE_NAME = "report.html"
FIGURE_FOLDER = "figures"
ANIMATION_NAME = "animation.gif"


@dataclass(frozen=True)
class ReportSettings:
    """What the report shows.

    Attributes:
        frames: numbers of the frames to show, from 0; None: the first, the middle and the last.
        estimate: name of the run's estimate to show; None: the run's default.
        scene: path of the scene file; None: the path in the run.

    Raises:
        OptionError: a value of another type.
    """

    frames: tuple[int, ...] | None = None
    estimate: str | None = None
    scene: Path | None = None

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class ReportSummary:
    """Summary of a report.

    Attributes:
        folder: the report's folder.
        frames: numbers of the frames shown.
        files: paths of the files written, relative to the folder.
        verdict: first line of the page.
    """

    folder: Path
    frames: tuple[int, ...]
    files: tuple[str, ...]
    verdict: Verdict

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        return [
            ("report", ""),
            ("page", str(self.folder / PAGE_NAME)),
            ("figures", f"{len(self.files) - 1} files in {self.folder / FIGURE_FOLDER}"),
            ("frames shown", ", ".join(str(index) for index in self.frames)),
            ("verdict", self.verdict.sentence),
        ]

    def to_dict(self) -> dict[str, Any]:
        """The same for programs."""
        return {
            "page": str(self.folder / PAGE_NAME),
            "files": list(self.files),
            "frames": list(self.frames),
            "verdict": {"kind": self.verdict.kind, "sentence": self.verdict.sentence},
        }


def report(
    run_path: PathLike,
    output: PathLike,
    settings: ReportSettings | None = None,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> ReportSummary:
    """Writes a page and figures about a run into a folder.

    The same files give the same report, byte for byte.

    Args:
        run_path: a ``run.h5``.
        output: folder to be written: ``report.html`` and ``figures/``.
        settings: what to show; None: the defaults.
        overwrite: whether an older report there may be replaced.
        progress: told how far the work is.

    Returns:
        What was written: ``table()``, ``to_dict()``.

    Raises:
        InputError: a file that cannot be used, a scene that the run does not belong to, or an
            output that exists.
        OptionError: a frame or an estimate that the run does not have, or an argument of another
            type.
    """
    run_path = checked_path(run_path, "the run's path")
    output = checked_path(output, "the report's path")
    settings = ReportSettings() if settings is None else settings
    checked_instance(settings, "settings", ReportSettings)
    check_output(output, overwrite, PAGE_NAME)
    run = load_run(run_path)
    scene_path, scene = load_scene_of_run(run, run_path, settings.scene)
    indices = chosen_frames(settings.frames, len(run.frames))
    content = _content(run, run_path, scene, indices, settings.estimate, progress)
    figures = _drawn(content, progress)
    pngs = {name: png for name, (png, _) in figures.items()}
    moving = _animation(content, progress)
    if moving is not None:
        pngs["animation"] = moving
    if isinstance(scene, Scene):
        made = scene_provenance(scene_path)
    else:
        made = dict(scene.index.provenance)
    page = page_of(content, scene, made, pngs)
    with atomic_folder(output, overwrite, PAGE_NAME) as folder:
        (folder / PAGE_NAME).write_text(html_of(page), encoding="utf-8")
        (folder / FIGURE_FOLDER).mkdir()
        files = [PAGE_NAME]
        for name, (png, pdf) in figures.items():
            for suffix, data in ((".png", png), (".pdf", pdf)):
                (folder / FIGURE_FOLDER / f"{name}{suffix}").write_bytes(data)
                files.append(f"{FIGURE_FOLDER}/{name}{suffix}")
        if moving is not None:
            (folder / FIGURE_FOLDER / ANIMATION_NAME).write_bytes(moving)
            files.append(f"{FIGURE_FOLDER}/{ANIMATION_NAME}")
    return ReportSummary(output, indices, tuple(files), page.verdict)


def chosen_frames(wanted: tuple[int, ...] | None, count: int) -> tuple[int, ...]:
    """The frames to show of ``count``, in order and each once.

    Raises:
        OptionError: a number that is not a frame.
    """
    if wanted is None:
        return tuple(sorted({0, (count - 1) // 2, count - 1}))
    if not wanted:
        raise OptionError("no frame to show; give at least one, for example --frames 0")
    for index in wanted:
        if not 0 <= index < count:
            raise OptionError(f"the run has no frame {index}; its frames are 0 to {count - 1}")
    return tuple(sorted(set(wanted)))


def _content(
    run: Run,
    run_path: Path,
    scene: Scene | OpenWorld,
    indices: tuple[int, ...],
    estimate: str | None,
    progress: Progress,
) -> Content:
    tracks = tracks_of(run, estimate)
    maker = ViewMaker(run, renderer_at(scene))
    views = {}
    for index in progress(indices, "views", len(indices)):
        odometry = None if tracks.odometry_states is None else tracks.odometry_states[index]
        try:
            views[index] = maker.views(index, tracks.estimated_states[index], odometry)
        except LfnavError as error:
            raise InputError(run_path, f"frame {index} cannot be shown ({error})") from error
    clouds = [run.frames[index].particles for index in indices]
    around = surroundings_of(scene, tracks, clouds)
    if run.docking is not None:
        # A docking robot avoids obstacles: show them.
        top = float(run.base_from_camera[2, 3])
        if isinstance(scene, OpenWorld):
            points = obstacle_points_of_world(scene, top)
        else:
            points = obstacle_points(scene, top)
        around = replace(around, obstacles=points)
    return Content(run, tracks, around, views)


def _animation(content: Content, progress: Progress) -> bytes | None:
    """The docking as a GIF; None where the run is no docking."""
    if content.run.docking is None:
        return None
    with figure_style():
        return animation(content.run, content.surroundings, content.tracks, progress)


def _drawn(content: Content, progress: Progress) -> dict[str, tuple[bytes, bytes]]:
    """Name -> PNG and PDF of each figure, in the order of the page."""
    indices = list(content.views)
    docking = ["docking"] if content.run.docking is not None else []
    names = [*docking, "overview", "curves", *(f"frame_{index:04d}" for index in indices)]
    drawn = {}
    with figure_style():
        for name in progress(names, "figures", len(names)):
            if name == "overview":
                figure = overview_figure(content)
            elif name == "docking":
                figure = docking_figure(content.run, content.surroundings, content.tracks)
            elif name == "curves":
                figure = time_figure(content.run, content.tracks, indices)
            else:
                figure = frame_figure(content, int(name.removeprefix("frame_")))
            drawn[name] = (png_of(figure), pdf_of(figure))
    return drawn
