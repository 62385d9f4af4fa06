"""What a pixel's difference says about "the map shows this here", learnt from the map itself.

Each photo is left out once and rendered from all others where it was taken: the differences that
remain are the noise of a right pose, with all that a light field gets wrong (surfaces that are not
quite there, reflections, poses that are a little off). Rendered at poses of other photos, the
differences are those of an image that has nothing to do with the view. The logarithm of the ratio
of the two densities is a pixel's evidence,

    log((1 - e) p(difference | right pose) / p(difference | elsewhere) + e),

with a share ``e`` of pixels that no map can know (people, moved things, another lamp), so that a
mismatch counts no more than log e against a pose. Densities depend on how much a pixel shows
(``comparison.pixel_strength``): that a bare wall fits is worth nothing, since it fits everywhere.

Pixels that show next to nothing earn little where they fit: a blank wall fits every blank wall, in
all of its pixels or in none.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import Float32Array, FloatArray, IntArray
from pipelines.artifacts.processes import in_threads
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.views import Views, area_average
from pipelines.render.channels import channel_image
from pipelines.render.choices import Channels
from pipelines.render.comparison import (
    EVIDENCE_BIN,
    EVIDENCE_BINS,
    EVIDENCE_ROWS,
    PixelEvidence,
    pixel_strength,
    sum_of_channels,
)
from pipelines.render.renderer import Renderer

# At most so many photos are left out, and each is rendered at so many other photos' poses.
MOST_LEFT_OUT, ELSEWHERE = 24, 4
# Share of an image's pixels that no map can know.
UNKNOWN_SHARE = 0.65
# Pixels that show less than this (``pixel_strength``) earn little.
FAINT = 30.0
# Pixels that are taken for known before any photo is looked at: differences at the right pose are
# then exponentially distributed with this mean, and elsewhere even. What remains where a map has
# one photo alone.
PRIOR_PIXELS, PRIOR_MEAN = 200.0, 40.0
PRIOR_EDGES = np.linspace(10.0, 90.0, EVIDENCE_ROWS - 1)
# Strengths between the rows of pixels that show next to nothing.
FAINT_EDGES = (10.0, FAINT)


@dataclass(frozen=True)
class _LeftOut:
    """How a photo that was left out differs from what all others make of it.

    Attributes:
        strengths: ``(P,)`` of its pixels, see ``pixel_strength``.
        right: ``(1, P)`` uint8 bins of the differences at its own pose; ``EVIDENCE_BINS`` where
            the others do not show what the pixel shows.
        elsewhere: ``(K, P)`` the same at poses of other photos.
    """

    strengths: Float32Array
    right: NDArray[np.uint8]
    elsewhere: NDArray[np.uint8]


def learn_evidence(
    colours: Views,
    channels: Channels,
    width: int,
    renderer: Renderer,
) -> PixelEvidence:
    """Learns from N photos what differences say, on as many threads as the renderer has.

    Args:
        colours: the photos in colours.
        channels: in which images are compared.
        width: of the images that will be compared, pixels.
        renderer: of the photos in these channels.
    """
    count = len(colours)
    poses = poses_of(colours)

    def left_out(index: int) -> _LeftOut:
        image, pinhole = photo_in_channels(colours, index, channels, width)
        # Evenly over the others: neighbours show nearly the same.
        steps = np.arange(1, ELSEWHERE + 1) * count // (ELSEWHERE + 1)
        others = np.unique((index + steps[steps > 0]) % count)
        shown = np.concatenate([poses[index : index + 1], poses[others]])
        images, covered = renderer.without_view(index, threads=1).render_many(shown, pinhole)
        differences = sum_of_channels(np.abs(images - image))
        bins = np.minimum(differences / EVIDENCE_BIN, EVIDENCE_BINS - 1).astype(np.uint8)
        bins[~covered] = EVIDENCE_BINS
        bins = bins.reshape(len(shown), -1)
        return _LeftOut(pixel_strength(image).reshape(-1), bins[:1], bins[1:])

    # A photo a thread: their statistics are work for one processor, too.
    photos = in_threads(left_out, left_out_photos(count), renderer.threads)
    return _pixel_evidence(list(photos))


def left_out_photos(count: int) -> list[int]:
    """Which of so many photos are left out, evenly over all; none where there are no others."""
    if count < 2:
        return []
    chosen = np.linspace(0, count - 1, min(count, MOST_LEFT_OUT)).round().astype(int)
    return [int(index) for index in np.unique(chosen)]


def photo_in_channels(
    colours: Views, index: int, channels: Channels, width: int
) -> tuple[Float32Array, Intrinsics]:
    """A photo ``(H, width, 3)`` as images are compared with it, and its intrinsics."""
    pinhole = colours.intrinsics[index]
    height = max(1, round(pinhole.height * width / pinhole.width))
    small = area_average(colours.level(index, 0), width, height)
    return channel_image(small, channels), pinhole.resized(width, height)


def poses_of(views: Views) -> FloatArray:
    """``(N, 4, 4)`` world_from_camera of the photos."""
    poses = np.tile(np.eye(4), (len(views), 1, 1))
    matrices = np.stack([pinhole.matrix() for pinhole in views.intrinsics])
    poses[:, :3, :3] = views.arrays.rays @ matrices
    poses[:, :3, 3] = views.centres
    return poses


def _pixel_evidence(photos: list[_LeftOut]) -> PixelEvidence:
    """Rows by strength, and the logarithms of the ratio of densities in each."""
    edges = _edges(
        [
            np.broadcast_to(photo.strengths, photo.elsewhere.shape)[photo.elsewhere < EVIDENCE_BINS]
            for photo in photos
        ]
    )
    rows = [np.searchsorted(edges, photo.strengths, side="right") for photo in photos]
    middles = EVIDENCE_BIN * (np.arange(EVIDENCE_BINS) + 0.5)
    prior = np.exp(-middles / PRIOR_MEAN)
    density = _densities(rows, [photo.right for photo in photos], prior)
    even = np.ones(EVIDENCE_BINS)
    ratio = density / _densities(rows, [photo.elsewhere for photo in photos], even)
    table = np.log((1.0 - UNKNOWN_SHARE) * ratio + UNKNOWN_SHARE)
    between = np.concatenate([[0.0], edges, edges[-1:]])
    strength = 0.5 * (between[:-1] + between[1:])
    worth = strength**4 / (strength**4 + FAINT**4)
    table *= np.where(table > 0.0, worth[:, None], 1.0)
    expected = np.sum(density * table, axis=1)
    return PixelEvidence(
        edges.astype(np.float32), table.astype(np.float32), expected.astype(np.float32)
    )


def _edges(found: list[Float32Array]) -> FloatArray:
    """``(EVIDENCE_ROWS - 1,)`` strengths between the rows.

    Pixels that show next to nothing have rows of their own, whether the photos have many of them,
    few or none: a blank image is compared with a map that is nowhere blank.
    """
    strengths = np.concatenate(found or [np.empty(0, np.float32)])
    strong = strengths[strengths >= FAINT]
    if len(strong) < PRIOR_PIXELS:
        return PRIOR_EDGES
    rows = EVIDENCE_ROWS - len(FAINT_EDGES)
    # Quantiles of numbers in order are found faster, by more than it takes to sort them.
    strong.sort()
    return np.append(FAINT_EDGES, np.quantile(strong, np.linspace(0.0, 1.0, rows + 1)[1:-1]))


def _densities(
    rows: list[IntArray], bins: list[NDArray[np.uint8]], prior: FloatArray
) -> FloatArray:
    """``(EVIDENCE_ROWS, EVIDENCE_BINS)`` probabilities of the bins in each row, smoothed.

    Args:
        rows: ``(P,)`` of the pixels of each photo.
        bins: ``(K, P)`` of their differences in K comparisons, see ``_LeftOut``.
        prior: ``(EVIDENCE_BINS,)`` in proportion to what is expected before.
    """
    counts = np.tile(PRIOR_PIXELS * prior / prior.sum(), (EVIDENCE_ROWS, 1))
    # One bin more, for what is not compared.
    columns = EVIDENCE_BINS + 1
    for own_rows, own_bins in zip(rows, bins, strict=True):
        cells = (own_rows * columns + own_bins).reshape(-1)
        found = np.bincount(cells, minlength=EVIDENCE_ROWS * columns)
        counts += found.reshape(EVIDENCE_ROWS, columns)[:, :EVIDENCE_BINS]
    smooth = cv2.filter2D(
        counts, -1, np.array([[0.25, 0.5, 0.25]]), borderType=cv2.BORDER_REPLICATE
    )
    return np.asarray(smooth / smooth.sum(axis=1, keepdims=True))
