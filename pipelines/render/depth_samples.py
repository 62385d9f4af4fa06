"""What of the views' depth maps is projected into virtual images: samples, in batches.

A batch holds samples that are near each other, with a box around them, so that the C++ core passes
over what a virtual camera does not see. In a batch neighbours do not follow each other: numbers
that are written to one place, one after the other, wait for each other.
"""

from typing import NamedTuple

import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.lightfield.views import ViewArrays

# Samples in a batch, and batches that are looked at together.
BATCH, BATCHES = 64, 16
# Rows of samples that are gone through column by column, so that batches are as wide as high.
STRIP = 12
# How far apart neighbours are in a batch; odd, so that all places are taken.
APART = 51


class DepthSamples(NamedTuple):
    """Samples of N views' depth maps.

    Attributes:
        values: ``(B, 3, BATCH)`` columns and rows in the depth map, from its middle, and inverse
            depths; a view's last batch is filled up with its last sample.
        boxes: ``(6, B + BATCHES)`` around the batches: the middles of columns, rows and inverse
            depths, and how far these go from there.
        starts: ``(N,)`` each view's first batch.
        ends: ``(N,)`` the one behind its last.
    """

    values: Float32Array
    boxes: Float32Array
    starts: IntArray
    ends: IntArray


def take_samples(views: ViewArrays, is_source: BoolArray, steps: FloatArray) -> DepthSamples:
    """Takes samples of the depth maps of some views.

    Args:
        views: the light field.
        is_source: ``(N,)`` whose depth maps.
        steps: ``(N,)`` from one sample to the next, at least 1 pixel of the depth map.
    """
    empty = np.empty((0, 3, BATCH), dtype=np.float32)
    batches = [
        _batches(views, view, float(steps[view])) if is_source[view] else empty
        for view in range(len(steps))
    ]
    counts = np.array([len(own) for own in batches], dtype=np.int64)
    ends = np.cumsum(counts)
    ordered = np.concatenate([empty, *batches])
    low, high = ordered.min(axis=2), ordered.max(axis=2)
    boxes = np.zeros((6, len(ordered) + BATCHES), dtype=np.float32)
    # Where a depth is infinite, so is its box.
    with np.errstate(over="ignore", invalid="ignore"):
        boxes[:3, : len(ordered)] = (np.float32(0.5) * (low + high)).T
        boxes[3:, : len(ordered)] = (np.float32(0.5) * (high - low)).T
    # np.take copies ten times as fast as an indexed assignment would.
    values = np.take(ordered, np.argsort(np.arange(BATCH) * APART % BATCH), axis=2)
    return DepthSamples(values, boxes, ends - counts, ends)


def joined_samples(some: DepthSamples, others: DepthSamples) -> DepthSamples:
    """Samples of some views and of others of the same light field; no view is in both."""
    first = len(some.values)
    is_other = others.ends > others.starts
    return DepthSamples(
        np.concatenate([some.values, others.values]),
        np.concatenate([some.boxes[:, :first], others.boxes], axis=1),
        np.where(is_other, first + others.starts, some.starts),
        np.where(is_other, first + others.ends, some.ends),
    )


def _batches(views: ViewArrays, view: int, step: float) -> Float32Array:
    """A view's samples ``(B, 3, BATCH)``, neighbour after neighbour."""
    width, height = (int(side) for side in views.depth_size[view])
    start = int(views.depth_start[view])
    depth = views.inverse_depth[start : start + width * height].reshape(height, width)
    columns, rows = _sampled(width, step), _sampled(height, step)
    strips = -(-len(rows) // STRIP)
    # Beyond the last row there is no depth.
    chosen = np.zeros((strips * STRIP, len(columns)), dtype=np.float32)
    chosen[: len(rows)] = depth[np.ix_(rows, columns)]
    x = np.broadcast_to(columns - (0.5 * width - 0.5), chosen.shape)
    y = np.zeros(len(chosen))
    y[: len(rows)] = rows - (0.5 * height - 0.5)
    samples = np.stack([x, np.broadcast_to(y[:, None], chosen.shape), chosen]).astype(np.float32)
    ordered = samples.reshape(3, strips, STRIP, len(columns)).swapaxes(2, 3).reshape(3, -1)
    # Most often all are known.
    is_known = ordered[2] > 0.0
    known = ordered if is_known.all() else ordered[:, is_known]
    missing = -known.shape[1] % BATCH
    whole = np.pad(known, ((0, 0), (0, missing)), mode="edge") if missing else known
    return whole.reshape(3, -1, BATCH).swapaxes(0, 1)


def _sampled(length: int, step: float) -> IntArray:
    """Columns, or rows, that are sampled."""
    places = step * np.arange(np.ceil(length / step) + 1.0)
    return places[places < length].astype(np.int64)
