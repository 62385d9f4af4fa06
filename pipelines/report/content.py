"""The content of the page about a run: numbers, notes, and how to read each figure."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import PlaneEstimate, Scene
from pipelines.localize.description import notes_of
from pipelines.localize.run import PNP_ESTIMATE, Run
from pipelines.report.docking import ANIMATION_CAPTION, CAPTION, docking_verdict
from pipelines.report.figures import Content
from pipelines.report.page import Page, Picture, Table, flattened
from pipelines.report.tracks import Tracks
from pipelines.report.verdict import frame_ranges, verdict_of

# Keys of the evaluation's numbers, and their names on the page.
ERROR_COLUMNS = {"median": "median", "rmse": "RMSE", "max": "max", "last5_mean": "mean of last 5"}

OVERVIEW_CAPTION = (
    "Each row is one frame. Left, the place from above: every dot is a hypothesis of where the "
    "robot stands, black for the likeliest, palest from a ten-thousandth of its weight down. Arrow "
    "heads are poses. Then what the camera saw, what the model shows at the estimated pose, and "
    "what it shows at the pose that odometry alone would give. If the estimate is right, the "
    "second picture looks like the first. \u201cDiffers by\u201d is the mean absolute difference "
    "in grey levels where the model covers the picture; striped pixels are shown by no recorded "
    "view."
)
CURVES_CAPTION = (
    "All panels share the frame axis. {errors} The shaded bands are what the filter itself "
    "claims: one and two standard deviations of its main cluster of hypotheses. An error that "
    "stays outside the band means that the filter was too sure. Background: yellow while it was "
    "searching, hatched where it said that it was lost, grey where the image showed nothing and "
    "odometry alone carried the pose on, white while it was tracking. Effective sample size: how "
    "many equally weighted hypotheses the belief is worth. Bars: wall-clock time of each stage of "
    "a frame."
)
FRAME_CAPTION = (
    "Upper row: three pictures of equal size as from one camera, so that a point has to be at the "
    "same place in each. Lower row: the place from above; the surroundings of the estimate, with "
    "the ellipse that holds the pose with 95 % probability if the filter is right; and the "
    "absolute difference between the camera image and the view at the estimate. A misplaced "
    "estimate shows as bright double edges; evenly grey areas are changes of light."
)


def page_of(
    content: Content,
    scene: Scene | OpenWorld,
    scene_origin: Mapping[str, Any],
    figures: Mapping[str, bytes],
) -> Page:
    """The page of a run.

    Args:
        content: what the figures show.
        scene: the scene model, or the world.
        scene_origin: its provenance.
        figures: name -> PNG (GIF for ``animation``), in the order in which the page shows them.
    """
    run, tracks = content.run, content.tracks
    is_docking = run.docking is not None
    return Page(
        title=("D" + run.dataset_name[1:] if is_docking else f"Localization of {run.dataset_name}"),
        verdict=docking_verdict(run) if is_docking else verdict_of(run, tracks.estimate_errors),
        subtitle=(
            f"{len(run.frames)} frames, estimate \u201c{tracks.estimate_name}\u201d, "
            f"seed {run.seed}, {_size_of(scene)} ({run.scene_path})"
        ),
        tables=[_error_table(tracks), _course_table(run)],
        notes=[*(f"Note: {note}." for note in notes_of(run)), *_notes(tracks)],
        pictures=[_picture(name, png, content) for name, png in figures.items()],
        details=_details(run, scene, scene_origin),
    )


def _size_of(scene: Scene | OpenWorld) -> str:
    if isinstance(scene, Scene):
        return f"scene of {len(scene)} views"
    return f"world of {len(scene.area_map)} areas, {len(scene.index.image_names)} photos"


def _error_table(tracks: Tracks) -> Table:
    title = "Error against ground truth"
    if tracks.evaluation is None:
        return Table(title, [("unknown", "nothing to compare the estimate with")])
    rows = [("", *ERROR_COLUMNS.values())]
    for name, errors in (
        ("estimate", tracks.estimate_errors),
        ("odometry alone", tracks.odometry_errors),
        ("pnp", tracks.pnp_errors),
    ):
        if errors is None:
            continue
        position, heading = errors.position_error_m, errors.heading_error_deg
        lengths = [f"{100.0 * getattr(position, column):.1f} cm" for column in ERROR_COLUMNS]
        angles = [f"{getattr(heading, column):.1f}\u00b0" for column in ERROR_COLUMNS]
        rows += [(f"{name}, position", *lengths), (f"{name}, heading", *angles)]
    return Table(title, rows, has_heading=True, numeric=True)


def _course_table(run: Run) -> Table:
    counts = [len(frame.log_weights) for frame in run.frames]
    total = run.frame_seconds
    last = run.frames[-1]
    rows = [
        ("tracking", _status_text(run, "tracking")),
        ("searching", _status_text(run, "global")),
        ("blind, by odometry alone", _status_text(run, "blind")),
        ("stale image, by odometry alone", _status_text(run, "stale")),
        ("lost", _status_text(run, "lost")),
        ("at the last frame", f"{last.status}, confidence {last.confidence:.2f}"),
        ("particles", f"{counts[0]:,} at the first frame, {counts[-1]:,} at the last"),
    ]
    if PNP_ESTIMATE in run.estimate_names:
        located = sum(PNP_ESTIMATE in frame.estimates for frame in run.frames)
        rows.append(("pose by features (pnp)", f"in {located} of {len(run.frames)} frames"))
    if np.any(total > 0.0):
        times = f"median {np.median(total):.3g} s, longest {np.max(total):.3g} s"
        rows.append(("time a frame", times))
    return Table("Course of the run", rows)


def _status_text(run: Run, status: str) -> str:
    indices = [index for index, frame in enumerate(run.frames) if frame.status == status]
    if not indices:
        return "never"
    return "all frames" if len(indices) == len(run.frames) else frame_ranges(indices)


def _notes(tracks: Tracks) -> list[str]:
    notes = []
    if tracks.odometry is not None:
        start = "true" if tracks.groundtruth is not None else "first estimated"
        notes.append(
            f"Odometry has no place of its own: its path is drawn from the {start} pose on, "
            "and only its increments were used for the estimate."
        )
    if tracks.groundtruth is None:
        notes.append("Errors are unknown: no ground truth came with the run.")
    else:
        notes.append("Ground truth served for the comparison only, never for the estimate.")
    return notes


def _picture(name: str, png: bytes, content: Content) -> Picture:
    dataset = content.run.dataset_name
    if name == "overview":
        shown = frame_ranges(list(content.views))
        alternative = f"Top views and camera, estimated and odometry views, {shown} of {dataset}"
        return Picture("Where the robot was", png, alternative, OVERVIEW_CAPTION)
    if name == "docking":
        return Picture("How it docked", png, f"Path and distance to the goal, {dataset}", CAPTION)
    if name == "animation":
        return Picture("Step by step", png, f"Animation, {dataset}", ANIMATION_CAPTION, "gif")
    if name == "curves":
        caption = CURVES_CAPTION.format(errors=_errors_caption(content.tracks))
        alternative = f"Errors, particles, confidence and time over the frames of {dataset}"
        return Picture("Over time", png, alternative, caption)
    index = int(name.removeprefix("frame_"))
    caption = FRAME_CAPTION if index == next(iter(content.views)) else "Read as the figure above."
    alternative = f"Frame {index} of {dataset}: pictures, top view, close-up, difference"
    image_name = content.run.frames[index].image_name
    caption = f"Camera image: {image_name}. {caption}"
    return Picture(f"Frame {index}", png, alternative, caption)


def _errors_caption(tracks: Tracks) -> str:
    if tracks.groundtruth is not None:
        return "Errors are distances from ground truth."
    if tracks.odometry is None:
        return "Errors are unknown without ground truth."
    return (
        "Errors are unknown without ground truth; the grey curve is how far estimate and odometry "
        "lie apart, which is no error of either."
    )


def _details(run: Run, scene: Scene | OpenWorld, scene_origin: Mapping[str, Any]) -> list[Table]:
    camera = run.camera
    first = scene if isinstance(scene, Scene) else scene.outlines[0]
    origin = [
        ("data set", run.dataset_name),
        ("camera", f"{camera.model}, {camera.width}\u00d7{camera.height} pixels"),
        ("camera parameters", ", ".join(f"{value:.6g}" for value in camera.params)),
        ("scene", run.scene_path),
        ("scene identifier", scene.identifier),
        *_surface_rows(first.surface),
        ("scale from", first.scale_source),
        *flattened(run.provenance),
    ]
    settings = [("seed", str(run.seed)), *flattened(run.settings)]
    return [
        Table("Settings of the filter", settings),
        Table("Origin of the run", origin),
        Table("Origin of the scene", flattened(scene_origin)),
    ]


def _surface_rows(surface: PlaneEstimate | None) -> list[tuple[str, str]]:
    if surface is None:
        return [("scene surface", "depth maps, no plane")]
    return [
        ("scene surface", f"plane, found by: {surface.method}"),
        ("plane a, b, c, d", ", ".join(f"{v:.4f}" for v in surface.plane.coefficients())),
        ("plane uncertainty", _plane_uncertainty(surface.offset_sigma, surface.angle_sigma)),
    ]


def _plane_uncertainty(offset_sigma: float, angle_sigma: float) -> str:
    if not (np.isfinite(offset_sigma) and np.isfinite(angle_sigma)):
        return "unknown"
    return f"\u03c3 {100.0 * offset_sigma:.1f} cm, {np.degrees(angle_sigma):.2f}\u00b0"
