"""The figures of a report: overview, one for each chosen frame, curves; as PNG and PDF."""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.localize.run import Run
from pipelines.report import style
from pipelines.report.legend import legend_entries
from pipelines.report.surroundings import Surroundings
from pipelines.report.top_view import box_limits, close_up_extent, draw_top_view
from pipelines.report.tracks import Tracks
from pipelines.report.verdict import length_text
from pipelines.report.views import FrameViews, ModelView, mark_uncovered

# All lengths in inches; the page shows an inch as about 90 pixels.
WIDTH = 14.0
LEFT, RIGHT, BOTTOM = 0.66, 0.12, 0.08
GAP, COLUMN_GAP = 0.14, 0.66
TITLE, AXIS_LABEL, HEADING, LEGEND_LINE = 0.46, 0.5, 0.3, 0.26
ROW_GAP = 0.2
MAX_PICTURE_HEIGHT = 3.4
TOP_VIEW_SHARE = 1.25
LEGEND_COLUMNS = 5
MAX_NAME = 30
# Odometry's path starts at the true pose; a smaller error than this is rounding, metres.
SAME_PLACE = 1e-6


@dataclass(frozen=True)
class Content:
    """What the figures show.

    Attributes:
        run: the run.
        tracks: the run's paths.
        surroundings: the fixed part of the top views.
        views: number of each chosen frame -> its pictures, in order of time.
    """

    run: Run
    tracks: Tracks
    surroundings: Surroundings
    views: dict[int, FrameViews]


def png_of(figure: Figure) -> bytes:
    """The figure as PNG: the same bytes for the same figure."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=style.PNG_DPI, metadata={"Software": None})
    return buffer.getvalue()


def pdf_of(figure: Figure) -> bytes:
    """The figure as PDF: the same bytes for the same figure."""
    buffer = BytesIO()
    # Without a date the same figure gives the same file.
    metadata = {"CreationDate": None, "Producer": None, "Creator": "lfnav"}
    figure.savefig(buffer, format="pdf", dpi=style.PDF_DPI, metadata=metadata)
    return buffer.getvalue()


def overview_figure(content: Content) -> Figure:
    """A row for each chosen frame: top view, camera, view at the estimate, view at odometry."""
    aspect = _picture_aspect(content)
    inner = WIDTH - LEFT - RIGHT - 3 * GAP
    width = min(inner / (3 + TOP_VIEW_SHARE), MAX_PICTURE_HEIGHT * aspect)
    height = width / aspect
    top_width = inner - 3 * width
    row = TITLE + height + AXIS_LABEL
    layout = _Layout(
        HEADING + len(content.views) * row, _legend_lines(content, list(content.views))
    )
    columns = [LEFT + top_width + GAP + i * (width + GAP) for i in range(3)]
    heads = ["from above", "camera", "rendered at the estimate", "rendered at odometry"]
    for x, text in zip([LEFT, *columns], heads, strict=True):
        layout.text(x, HEADING - 0.05, text, weight="bold", size=12.0)
    limits = box_limits(content.surroundings.extent, top_width / height)
    for number, (index, views) in enumerate(content.views.items()):
        y = HEADING + number * row + TITLE
        axes = layout.axes(LEFT, y, top_width, height)
        draw_top_view(axes, content.surroundings, content.run, content.tracks, index, limits)
        _title(axes, *_frame_lines(content, index))
        boxes = [layout.axes(x, y, width, height) for x in columns]
        _show_three(boxes, content, index, views)
    layout.legend(content, list(content.views))
    return layout.figure


def frame_figure(content: Content, index: int) -> Figure:
    """One frame large: the three pictures, below them the top view, a close-up, the difference."""
    aspect = _picture_aspect(content)
    column = (WIDTH - LEFT - RIGHT - 2 * COLUMN_GAP) / 3
    height = min(column / aspect, MAX_PICTURE_HEIGHT)
    width = height * aspect
    lower = max(height, 0.7 * column)
    top_row, bottom_row = HEADING + TITLE, 2 * (HEADING + TITLE) + height + ROW_GAP
    layout = _Layout(bottom_row + lower + AXIS_LABEL, _legend_lines(content, [index]))
    lefts = [LEFT + i * (column + COLUMN_GAP) for i in range(3)]
    centred = [left + (column - width) / 2.0 for left in lefts]
    upper = ["camera", "rendered at the estimate", "rendered at odometry"]
    for x, text in zip(centred, upper, strict=True):
        layout.text(x, HEADING - 0.05, text, weight="bold", size=12.0)
    _show_three(
        [layout.axes(x, top_row, width, height) for x in centred],
        content,
        index,
        content.views[index],
    )
    heads = ["from above", "close-up of the estimate", "camera minus view at the estimate"]
    for x, text in zip([*lefts[:2], centred[2]], heads, strict=True):
        layout.text(x, bottom_row - TITLE - 0.05, text, weight="bold", size=12.0)
    whole = layout.axes(lefts[0], bottom_row, column, lower)
    close = layout.axes(lefts[1], bottom_row, column, lower)
    _draw_top_views(content, index, whole, close, column / lower)
    difference = layout.axes(centred[2], bottom_row, width, height)
    _show_difference(difference, content.views[index].at_estimate)
    layout.legend(content, [index])
    return layout.figure


def _draw_top_views(content: Content, index: int, whole: Axes, close: Axes, aspect: float) -> None:
    run, tracks, around = content.run, content.tracks, content.surroundings
    draw_top_view(whole, around, run, tracks, index, box_limits(around.extent, aspect))
    _title(whole, *_frame_lines(content, index))
    near = close_up_extent(run.frames[index], tracks, index, around)
    if near is None:
        _placeholder(close, "no close-up: the belief is spread\nover much of the area")
        return
    draw_top_view(close, around, run, tracks, index, box_limits(near, aspect), detail=True)
    _title(close, *_spread_lines(content, index))


class _Layout:
    """A figure in which boxes are placed in inches from the top left corner."""

    def __init__(self, content_height: float, legend_lines: int) -> None:
        self.height = content_height + legend_lines * LEGEND_LINE + BOTTOM
        self.figure = Figure(figsize=(WIDTH, self.height), facecolor="white")

    def axes(self, x: float, y: float, width: float, height: float) -> Axes:
        """Axes whose box has its top left corner at (x, y)."""
        bottom = self.height - y - height
        return self.figure.add_axes(
            (x / WIDTH, bottom / self.height, width / WIDTH, height / self.height)
        )

    def text(self, x: float, y: float, text: str, *, weight: str, size: float) -> None:
        """Text whose base line begins at (x, y)."""
        self.figure.text(x / WIDTH, 1.0 - y / self.height, text, fontweight=weight, fontsize=size)

    def legend(self, content: Content, indices: Sequence[int]) -> None:
        """The legend of a figure of the frames ``indices``, at the bottom."""
        handles, labels, handlers = legend_entries(
            content.run, content.tracks, content.surroundings, indices
        )
        self.figure.legend(
            handles,
            labels,
            handler_map=handlers,
            loc="lower left",
            bbox_to_anchor=(LEFT / WIDTH - 0.005, 0.02 / self.height),
            ncols=LEGEND_COLUMNS,
            frameon=False,
            handlelength=3.0,
            columnspacing=1.6,
            borderpad=0.0,
        )


def _legend_lines(content: Content, indices: Sequence[int]) -> int:
    entries = legend_entries(content.run, content.tracks, content.surroundings, indices)
    return -(-len(entries[1]) // LEGEND_COLUMNS)


def _picture_aspect(content: Content) -> float:
    height, width = next(iter(content.views.values())).real.shape[:2]
    return float(width / height)


def _title(axes: Axes, first: str, second: str = "") -> None:
    """Two lines above a box, starting at its left edge."""
    for y, text, colour in ((17.0, first, style.TEXT), (4.5, second, style.FAINT)):
        axes.annotate(
            text, (0.0, 1.0), xycoords="axes fraction", xytext=(0.0, y),
            textcoords="offset points", fontsize=9.5, color=colour, annotation_clip=False,
        )  # fmt: skip


def _show(axes: Axes, image: ImageArray | FloatArray, **options: object) -> None:
    axes.imshow(image, aspect="auto", **options)  # type: ignore[arg-type]
    axes.set_xticks([])
    axes.set_yticks([])


def _show_three(boxes: Sequence[Axes], content: Content, index: int, views: FrameViews) -> None:
    _show(boxes[0], views.real)
    _title(boxes[0], shortened(content.run.frames[index].image_name), _camera_text(content.run))
    odometry = content.tracks.odometry
    states = (content.tracks.estimated[index], None if odometry is None else odometry[index])
    missing = ("the run has no estimate here", "the run had no odometry")
    for axes, view, state, reason in zip(
        boxes[1:], (views.at_estimate, views.at_odometry), states, missing, strict=True
    ):
        if view is None or state is None:
            _placeholder(axes, reason)
            continue
        _show(axes, view.picture)
        _title(axes, pose_text(state), _error_text(content, index, axes is boxes[2], view))


def _show_difference(axes: Axes, view: ModelView | None) -> None:
    if view is None:
        _placeholder(axes, "the run has no estimate here")
        return
    _show(axes, difference_picture(view))
    _title(axes, "black: equal, white: 128 grey levels or more apart", _coverage_text(view))


def difference_picture(view: ModelView) -> ImageArray:
    """``(H, W, 3)``: absolute differences as grey levels, doubled; uncovered pixels striped."""
    doubled = np.clip(2.0 * np.nan_to_num(view.difference), 0.0, 255.0).astype(np.uint8)
    return mark_uncovered(np.repeat(doubled[..., None], 3, axis=2), view.covered)


def _placeholder(axes: Axes, text: str) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor("#F5F5F5")
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=style.FAINT)


def shortened(name: str) -> str:
    """The end of a long name, which tells files of one folder apart."""
    printable = "".join(letter if letter.isprintable() else "�" for letter in name)
    return printable if len(printable) <= MAX_NAME else "…" + printable[-(MAX_NAME - 1) :]


def pose_text(state: FloatArray) -> str:
    """x, y and heading of a state ``(3,)`` for people."""
    text = f"x {state[0]:.2f} m, y {state[1]:.2f} m, heading {np.degrees(state[2]):.1f}°"
    return text.replace("-", "−")


def _frame_lines(content: Content, index: int) -> tuple[str, str]:
    frame = content.run.frames[index]
    seconds = frame.timestamp - content.run.frames[0].timestamp
    return (
        f"frame {index}, {seconds:.2f} s: {style.STATUS_WORDS.get(frame.status, frame.status)}",
        f"{len(frame.log_weights):,} particles, {frame.effective_sample_size:,.0f} effective; "
        f"confidence {frame.confidence:.2f}",
    )


def _spread_lines(content: Content, index: int) -> tuple[str, str]:
    covariance = content.run.frames[index].covariance
    sigma = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    space = content.run.space
    lengths = [
        f"σ {axis} {length_text(float(value))}"
        for axis, value in zip("xyz", sigma[: space.positions], strict=False)
    ]
    angle = "heading" if space.angles == 1 else "angle"
    degrees = np.degrees(np.linalg.norm(sigma[space.positions :]))
    return (
        f"{', '.join(lengths)}, σ {angle} {degrees:.1f}°",
        "of the main cluster, as the filter claims",
    )


def _camera_text(run: Run) -> str:
    return "as recorded" + (", lens distortion removed" if run.camera.has_distortion else "")


def _error_text(content: Content, index: int, is_odometry: bool, view: ModelView) -> str:
    """Error against ground truth and difference from the camera image."""
    tracks = content.tracks
    errors = tracks.odometry_errors if is_odometry else tracks.estimate_errors
    position = np.nan if errors is None else float(errors.position_error_m.per_frame[index])
    heading = np.nan if errors is None else float(errors.heading_error_deg.per_frame[index])
    if np.isnan(position):
        return f"error unknown; {_difference_text(view)}"
    if is_odometry and position < SAME_PLACE:
        return f"set to the true pose; {_difference_text(view)}"
    return f"error {length_text(position)}, {heading:.1f}°; {_difference_text(view)}"


def _difference_text(view: ModelView) -> str:
    if not view.covered.any():
        return "no view covers it"
    return f"differs by {view.mean_difference:.0f}/255"


def _coverage_text(view: ModelView) -> str:
    return f"{_difference_text(view)}; {view.covered.mean():.0%} covered"
