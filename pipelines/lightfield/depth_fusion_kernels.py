"""The compiled parts of ``depth_fusion``: depth maps seen from another view, and compared."""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray
from pipelines.lightfield.compiled import compiled

# Homogeneous depth below which a point counts as behind the camera.
_NEAR = 1e-6


@compiled
def project_depth(
    inverse_depth: Float32Array, rays: FloatArray, shift: FloatArray, projected: Float32Array
) -> None:
    """Writes a neighbour's depth map as the reference view would see it.

    Args:
        inverse_depth: ``(h, w)`` the neighbour's.
        rays: ``(3, 3)`` A, and ``shift`` ``(3,)`` b: a pixel p of the neighbour with inverse depth
            q lies at the reference's homogeneous pixel A p + q b.
        shift: see ``rays``.
        projected: ``(H, W)`` result: inverse depth in the reference, the nearest surface where
            several meet; 0 where none falls.
    """
    height, width = projected.shape
    projected[:] = np.float32(0.0)
    for y in range(inverse_depth.shape[0]):
        for x in range(inverse_depth.shape[1]):
            q = inverse_depth[y, x]
            depth = rays[2, 0] * x + rays[2, 1] * y + rays[2, 2] + q * shift[2]
            if depth <= _NEAR:
                continue
            u = (rays[0, 0] * x + rays[0, 1] * y + rays[0, 2] + q * shift[0]) / depth
            v = (rays[1, 0] * x + rays[1, 1] * y + rays[1, 2] + q * shift[1]) / depth
            if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
                continue
            column, row = np.int64(u + 0.5), np.int64(v + 0.5)
            projected[row, column] = max(projected[row, column], np.float32(q / depth))


@compiled
def judge(
    candidate: Float32Array,
    rays: FloatArray,
    shift: FloatArray,
    other: Float32Array,
    trust: Float32Array,
    agreement: float,
    support: Float32Array,
    violation: Float32Array,
) -> None:
    """Asks one neighbour what it holds of a candidate for each pixel's depth.

    Args:
        candidate: ``(H, W)`` inverse depths in the reference; 0 means none.
        rays: ``(3, 3)`` A, and ``shift`` ``(3,)`` b: a pixel p of the reference with inverse depth
            q lies at the neighbour's homogeneous pixel A p + q b.
        shift: see ``rays``.
        other: ``(h, w)`` the neighbour's inverse depths.
        trust: ``(h, w)`` what the neighbour's word counts at each of its pixels.
        agreement: share of the inverse depth within which both are the same surface.
        support: ``(H, W)`` grows by the trust where the neighbour sees this surface.
        violation: ``(H, W)`` grows by the trust where it sees through it.
    """
    height, width = other.shape
    for y in range(candidate.shape[0]):
        for x in range(candidate.shape[1]):
            q = candidate[y, x]
            if q <= np.float32(0.0):
                continue
            depth = rays[2, 0] * x + rays[2, 1] * y + rays[2, 2] + q * shift[2]
            if depth <= _NEAR:
                continue
            u = (rays[0, 0] * x + rays[0, 1] * y + rays[0, 2] + q * shift[0]) / depth
            v = (rays[1, 0] * x + rays[1, 1] * y + rays[1, 2] + q * shift[1]) / depth
            if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
                continue
            row, column = np.int64(v + 0.5), np.int64(u + 0.5)
            found = other[row, column]
            expected = q / depth
            if abs(found - expected) <= agreement * expected:
                support[y, x] += trust[row, column]
            elif found < expected:
                violation[y, x] += trust[row, column]


@compiled
def choose(
    candidates: Float32Array,
    support: Float32Array,
    violation: Float32Array,
    agreement: float,
    chosen: Float32Array,
    votes: Float32Array,
) -> None:
    """Takes the candidate that the neighbours hold best and averages all that agree with it.

    Args:
        candidates: ``(C, H, W)`` inverse depths, 0 for none; the view's own first.
        support: ``(C, H, W)`` neighbours that see the candidate.
        violation: ``(C, H, W)`` neighbours that see through it.
        agreement: share of the inverse depth within which candidates are the same surface.
        chosen: ``(H, W)`` result.
        votes: ``(H, W)`` result: neighbours that see the chosen less those that see through it.
    """
    count, height, width = candidates.shape
    for y in range(height):
        for x in range(width):
            best, most = 0, support[0, y, x] - violation[0, y, x] + 0.5
            for c in range(1, count):
                standing = support[c, y, x] - violation[c, y, x]
                if candidates[c, y, x] > 0.0 and standing > most:
                    best, most = c, standing
            middle = candidates[best, y, x]
            total, members = 0.0, 0
            for c in range(count):
                if abs(candidates[c, y, x] - middle) <= agreement * middle:
                    total += candidates[c, y, x]
                    members += 1
            chosen[y, x] = np.float32(total / members)
            votes[y, x] = support[best, y, x] - violation[best, y, x]
