"""A docking as an animated picture: from above, and what the camera saw, step by step."""

from io import BytesIO
from typing import Any

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.stages import Progress
from pipelines.dataset.images import decode_image
from pipelines.localize.run import Run
from pipelines.report import style
from pipelines.report.docking import acted_on, draw_goal, draw_pose, record_of
from pipelines.report.surroundings import Surroundings
from pipelines.report.top_view import box_limits, draw_place
from pipelines.report.tracks import Tracks

WIDTH, HEIGHT, DPI = 9.0, 3.6, 72
SECONDS_A_STEP, SECONDS_AT_THE_END = 0.4, 2.5
# Of longer dockings, this many evenly spaced steps are shown.
MOST_STEPS = 120
COLOURS = 200
MOST_PARTICLES = 1000


def animation(run: Run, surroundings: Surroundings, tracks: Tracks, progress: Progress) -> bytes:
    """The docking as a GIF: the same bytes for the same run.

    Args:
        run: run of a docking.
        surroundings: the fixed part of the top view.
        tracks: the run's paths.
        progress: wraps the loop over steps to report progress.

    Raises:
        InputError: a camera image that cannot be decoded.
    """
    count = len(run.frames)
    shown = sorted({round(i) for i in np.linspace(0, count - 1, min(count, MOST_STEPS))})
    pictures = [
        Image.fromarray(_picture(run, surroundings, tracks, index)).quantize(COLOURS)
        for index in progress(shown, "animation", len(shown))
    ]
    durations = [round(1000 * SECONDS_A_STEP)] * len(pictures)
    durations[-1] = round(1000 * SECONDS_AT_THE_END)
    buffer = BytesIO()
    options: dict[str, Any] = {"duration": durations, "loop": 0, "optimize": False}
    pictures[0].save(buffer, format="GIF", save_all=True, append_images=pictures[1:], **options)
    return buffer.getvalue()


def _picture(run: Run, surroundings: Surroundings, tracks: Tracks, index: int) -> ImageArray:
    """The picture of one step, ``(H, W, 3)`` RGB."""
    figure = Figure(figsize=(WIDTH, HEIGHT), facecolor="white")
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(DPI)
    above = figure.add_axes((0.07, 0.13, 0.46, 0.77))
    frame, record, estimates = run.frames[index], record_of(run), acted_on(run)
    draw_place(above, surroundings, box_limits(surroundings.extent, 0.46 * WIDTH / (0.77 * HEIGHT)))
    draw_goal(above, record)
    stride = max(1, len(frame.particles) // MOST_PARTICLES)
    above.plot(*frame.particles[::stride, :2].T, ".", color=style.FAINT, markersize=1.5, zorder=1.5)
    if tracks.groundtruth is not None:
        path = tracks.groundtruth[: index + 1, :2]
        above.plot(*path.T, color=style.TRUTH, linewidth=3.0, alpha=0.5, zorder=3.0)
        draw_pose(above, tracks.groundtruth[index], style.TRUTH)
    above.plot(*estimates[: index + 1, :2].T, color=style.ESTIMATE, linewidth=1.2, zorder=3.4)
    if np.all(np.isfinite(estimates[index])):
        draw_pose(above, estimates[index], style.ESTIMATE)
    above.set_title(f"step {index}: {record.states[index]}", fontsize=10.0)
    camera = figure.add_axes((0.57, 0.13, 0.42, 0.77))
    image = decode_image(run.encoded_images[index], frame.image_name)
    width = round(0.42 * WIDTH * DPI)
    size = (width, round(width * image.shape[0] / image.shape[1]))
    camera.imshow(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    camera.set_axis_off()
    camera.set_title("camera", fontsize=10.0)
    pixels, (columns, rows) = canvas.print_to_buffer()  # type: ignore[no-untyped-call]
    return np.frombuffer(pixels, dtype=np.uint8).reshape(rows, columns, 4)[..., :3].copy()
