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

from pipelines.artifacts.arrays import Float32Array, FloatArray, IntArray
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
    """A photo in channels, and the renderer of all others.

    Attributes:
        image: ``(H, W, 3)``.
        intrinsics: of it.
        world_from_camera: ``(4, 4)``.
        renderer: of the other photos.
    """

    image: Float32Array
    intrinsics: Intrinsics
    world_from_camera: FloatArray
    renderer: Renderer


def learn_evidence(
    colours: Views,
    channels: Channels,
    width: int,
    renderer: Renderer,
) -> PixelEvidence:
    """Learns from N photos what differences say.

    Args:
        colours: the photos in colours.
        channels: in which images are compared.
        width: of the images that will be compared, pixels.
        renderer: of the photos in these channels.
    """
    count = len(colours)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_LEFT_OUT)).round().astype(int))
    poses = _poses(colours)
    left_out = []
    for index in chosen if count > 1 else []:
        pinhole = colours.intrinsics[index]
        height = max(1, round(pinhole.height * width / pinhole.width))
        small = area_average(colours.level(index, 0), width, height)
        left_out.append(
            _LeftOut(
                channel_image(small, channels),
                pinhole.resized(width, height),
                poses[index],
                renderer.without_view(int(index)),
            )
        )
    return _pixel_evidence(left_out, chosen, poses)


def _poses(views: Views) -> FloatArray:
    """``(N, 4, 4)`` world_from_camera of the photos."""
    poses = np.tile(np.eye(4), (len(views), 1, 1))
    matrices = np.stack([pinhole.matrix() for pinhole in views.intrinsics])
    poses[:, :3, :3] = views.arrays.rays @ matrices
    poses[:, :3, 3] = views.centres
    return poses


def _pixel_evidence(left_out: list[_LeftOut], chosen: IntArray, poses: FloatArray) -> PixelEvidence:
    """Rows by strength, and the logarithms of the ratio of densities in each."""
    right: list[tuple[Float32Array, Float32Array]] = []
    elsewhere: list[tuple[Float32Array, Float32Array]] = []
    for index, photo in zip(chosen, left_out, strict=False):
        # Evenly over the others: neighbours show nearly the same.
        steps = np.arange(1, ELSEWHERE + 1) * len(poses) // (ELSEWHERE + 1)
        others = np.unique((index + steps[steps > 0]) % len(poses))
        shown = np.concatenate([photo.world_from_camera[None], poses[others]])
        images, covered = photo.renderer.render_many(shown, photo.intrinsics)
        differences = np.abs(images - photo.image).sum(axis=3)
        strengths = np.broadcast_to(pixel_strength(photo.image), differences.shape)
        right.append((strengths[0][covered[0]], differences[0][covered[0]]))
        elsewhere.append((strengths[1:][covered[1:]], differences[1:][covered[1:]]))
    strengths = np.concatenate([each[0] for each in elsewhere] or [np.empty(0, np.float32)])
    edges = _edges(strengths)
    middles = EVIDENCE_BIN * (np.arange(EVIDENCE_BINS) + 0.5)
    prior = np.exp(-middles / PRIOR_MEAN)
    density = _densities(right, edges, prior)
    ratio = density / _densities(elsewhere, edges, np.ones(EVIDENCE_BINS))
    table = np.log((1.0 - UNKNOWN_SHARE) * ratio + UNKNOWN_SHARE)
    between = np.concatenate([[0.0], edges, edges[-1:]])
    strength = 0.5 * (between[:-1] + between[1:])
    worth = strength**4 / (strength**4 + FAINT**4)
    table *= np.where(table > 0.0, worth[:, None], 1.0)
    expected = np.sum(density * table, axis=1)
    return PixelEvidence(
        edges.astype(np.float32), table.astype(np.float32), expected.astype(np.float32)
    )


def _edges(strengths: Float32Array) -> FloatArray:
    """``(EVIDENCE_ROWS - 1,)`` strengths between the rows.

    Pixels that show next to nothing have rows of their own, whether the photos have many of them,
    few or none: a blank image is compared with a map that is nowhere blank.
    """
    strong = strengths[strengths >= FAINT]
    if len(strong) < PRIOR_PIXELS:
        return PRIOR_EDGES
    rows = EVIDENCE_ROWS - len(FAINT_EDGES)
    return np.append(FAINT_EDGES, np.quantile(strong, np.linspace(0.0, 1.0, rows + 1)[1:-1]))


def _densities(
    found: list[tuple[Float32Array, Float32Array]], edges: FloatArray, prior: FloatArray
) -> FloatArray:
    """``(EVIDENCE_ROWS, EVIDENCE_BINS)`` probabilities of the bins in each row, smoothed."""
    counts = np.tile(PRIOR_PIXELS * prior / prior.sum(), (EVIDENCE_ROWS, 1))
    for strengths, differences in found:
        rows = np.searchsorted(edges, strengths, side="right")
        columns = np.minimum(differences / EVIDENCE_BIN, EVIDENCE_BINS - 1).astype(np.int64)
        np.add.at(counts, (rows, columns), 1.0)
    smooth = cv2.filter2D(
        counts, -1, np.array([[0.25, 0.5, 0.25]]), borderType=cv2.BORDER_REPLICATE
    )
    return np.asarray(smooth / smooth.sum(axis=1, keepdims=True))
