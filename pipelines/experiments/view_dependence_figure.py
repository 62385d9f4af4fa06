"""The figure of the study of view-dependent appearance, and its table."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.experiments.view_dependence import GEOMETRIES, RULES, PartViews, ViewDependence
from pipelines.render.image_quality import fitted_gain, psnr

# Geometry and rule of the pictures beside the photo, left to right.
PICTURES = (("own", "light_field"), ("true", "light_field"), ("true", "mean"))
# Errors of this size, grey levels, have the brightest colour.
LARGEST_ERROR = 80.0
# Colours of Okabe and Ito (2008), and hatches for print in grey.
BARS = {"light_field": ("#0072B2", ""), "mean": ("#E69F00", "//"), "median": ("#D55E00", "..")}
SURROUNDINGS = 0.3


def markdown(results: Sequence[ViewDependence]) -> str:
    """The table as Markdown: PSNR (dB), one line for each set and geometry."""
    heads = ("held-out photos", "surface", *RULES.values(), "light field better by")
    lines = [f"| {' | '.join(heads)} |", "|---|---|---:|---:|---:|---:|"]
    for result in results:
        for geometry, name in GEOMETRIES.items():
            means = [f"{result.mean(geometry, rule):.1f}" for rule in RULES]
            cells = [f"{result.name} ({len(result.photos)})", name, *means]
            lines.append(f"| {' | '.join(cells)} | {result.advantage(geometry):.1f} |")
    lines += ["", f"Photos that the light field shows better over {GEOMETRIES['own']} than over"]
    better = [f"{r.photos_better_over_own_depth()} of {len(r.photos)} ({r.name})" for r in results]
    lines.append(f"{GEOMETRIES['true']}: {', '.join(better)}.")
    return "\n".join(lines) + "\n"


def write_figure(
    path: Path, results: Sequence[ViewDependence], photo: ImageArray, views: PartViews
) -> None:
    """Writes a PNG: one photo, rendered views of it, their errors, and the means of all sets.

    Args:
        path: of the PNG.
        results: measurements of the sets.
        photo: ``(H, W, 3)`` RGB, the photo shown.
        views: that photo's pixels of the parts, all of them rendered.
    """
    with mpl.rc_context({"font.family": ["DejaVu Sans"], "font.size": 9.0}):
        figure = Figure(figsize=(12.0, 5.6), layout="constrained")
        grid = figure.subplots(2, 1 + len(PICTURES))
        _picture(grid[0, 0], photo, "photo, held out")
        _bars(grid[1, 0], results)
        for axes, key in zip(grid.T[1:], PICTURES, strict=True):
            image, error = _compared(photo, views.images[key], views.shown)
            quality = psnr(views.images[key], photo, views.shown)
            title = f"{RULES[key[1]]},\n{GEOMETRIES[key[0]]}"
            _picture(axes[0], image, title)
            axes[1].imshow(error, cmap="magma", vmin=0.0, vmax=LARGEST_ERROR)
            axes[1].set_title(f"error, PSNR {quality:.1f} dB")
            axes[1].axis("off")
        figure.colorbar(grid[1, -1].images[0], ax=grid[1, -1], label="grey levels", shrink=0.8)
        figure.savefig(path, dpi=110)


def _picture(axes: Axes, image: ImageArray, title: str) -> None:
    axes.imshow(image)
    axes.set_title(title)
    axes.axis("off")


def _compared(
    photo: ImageArray, image: ImageArray, shown: BoolArray
) -> tuple[ImageArray, FloatArray]:
    """The image pasted into the darkened photo, and the error of each pixel, grey levels."""
    adjusted = fitted_gain(image, photo, shown) * image.astype(np.float64)
    error = np.abs(adjusted - photo).mean(axis=-1)
    pasted = np.where(shown[..., None], adjusted, SURROUNDINGS * photo)
    return np.clip(pasted, 0.0, 255.0).astype(np.uint8), np.where(shown, error, 0.0)


def _bars(axes: Axes, results: Sequence[ViewDependence]) -> None:
    """Draws the mean PSNR of each rule over the depth from the photos, one group a set."""
    width = 0.8 / len(RULES)
    for number, (rule, name) in enumerate(RULES.items()):
        places = np.arange(len(results)) + (number - 0.5 * (len(RULES) - 1)) * width
        heights = [result.mean("own", rule) for result in results]
        colour, hatch = BARS[rule]
        drawn = axes.bar(places, heights, width, color=colour, hatch=hatch, label=name)
        axes.bar_label(drawn, fmt="%.1f")
    axes.set_xticks(np.arange(len(results)), [result.name for result in results])
    axes.set_ylabel("PSNR (dB)")
    axes.set_ylim(0.0, 1.45 * axes.dataLim.y1)
    axes.legend(loc="upper left", frameon=False, ncols=2, fontsize=8.0)
    axes.spines[["top", "right"]].set_visible(False)
