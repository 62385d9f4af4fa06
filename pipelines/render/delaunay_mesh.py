"""The Delaunay mesh of recording centres in a virtual image, and its blending weights.

Heigl, Denzler, Niemann (2001), section 2: the projection centres of the recorded views, projected
into the virtual camera, are triangulated (Delaunay); inside a triangle the views at its vertices
are blended with weights that are 1 at the own vertex and 0 at the other two.
This module is the readable version, on SciPy's triangulation; ``native/delaunay_mesh.hpp`` is the
fast one.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray
from pipelines.geometry.camera import Intrinsics

# Recording centres count as lying in one plane with the virtual centre, which makes the mesh
# one-dimensional, when they leave that plane by less than this share of their distance (rms).
FLATNESS_LIMIT = 0.01
# A centre beside the virtual camera projects to infinity; it is moved to a large finite place.
SMALLEST_RELATIVE_DEPTH = 1e-7
# Centres that project nearer to each other than this, in pixels, are one vertex of the mesh. Far
# from the image, where floating-point numbers are coarser, it is this share of the coordinates.
COINCIDENT_PIXELS = 1e-6
COINCIDENT_SHARE = 1e-12
# Three vertices count as collinear when their triangle's area is less than this share of the square
# of its longest side.
SMALLEST_AREA = 1e-12
# These limits as the C++ core takes them.
MESH_LIMITS = np.array([FLATNESS_LIMIT, COINCIDENT_PIXELS, COINCIDENT_SHARE, SMALLEST_AREA])


@dataclass(frozen=True)
class PixelWeights:
    """Blending weights of each pixel of an image of H x W pixels.

    Attributes:
        views: ``(H, W, K)`` indices of the contributing views; K is 3 in a mesh.
        weights: ``(H, W, K)`` their weights, non-negative, sum 1, or 0 where no view contributes.
    """

    views: IntArray
    weights: FloatArray


def project_centres(
    centres: FloatArray, world_from_camera: FloatArray, intrinsics: Intrinsics
) -> FloatArray:
    """Projects recording centres into a virtual image, ignoring which side of it they are on.

    Centres behind the virtual camera come out mirrored, as the paper wants it: the viewing ray
    through such a pixel, extended backwards, passes through the centre.

    Args:
        centres: ``(N, 3)`` world coordinates.
        world_from_camera: ``(4, 4)`` virtual camera.
        intrinsics: of the virtual camera.

    Returns:
        ``(N, 2)`` pixels (possibly very far outside the image).
    """
    # The offset first: a centre at the virtual one is then at exactly zero, not at rounding noise.
    points = (centres - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
    distance = np.linalg.norm(points, axis=1)
    smallest = np.maximum(SMALLEST_RELATIVE_DEPTH * distance, 1e-300)
    depth = np.where(np.abs(points[:, 2]) < smallest, smallest, points[:, 2])
    return np.stack(
        [
            intrinsics.fx * points[:, 0] / depth + intrinsics.cx,
            intrinsics.fy * points[:, 1] / depth + intrinsics.cy,
        ],
        axis=1,
    )


def is_one_dimensional(centres: FloatArray, virtual_centre: FloatArray) -> bool:
    """Whether all recording centres and the virtual centre lie (nearly) in one plane.

    Then the projected centres are collinear and no Delaunay triangulation exists. A robot that
    moves in a plane is always in this situation.

    Args:
        centres: ``(N, 3)`` world coordinates.
        virtual_centre: ``(3,)``.
    """
    offsets = centres - virtual_centre
    scatter = np.linalg.eigvalsh(offsets.T @ offsets)
    return bool(scatter[0] <= FLATNESS_LIMIT**2 * scatter.sum())


def line_direction(
    centres: FloatArray, world_from_camera: FloatArray, intrinsics: Intrinsics
) -> FloatArray:
    """Unit direction ``(2,)`` in the image of the line on which coplanar centres project."""
    offsets = (centres - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
    _, vectors = np.linalg.eigh(offsets.T @ offsets)
    normal = vectors[:, 0]
    # The plane's trace is the image line (normal_x / fx, normal_y / fy, .); its direction is normal
    # to that. A plane that holds the image's whole horizon leaves the direction open: take rows.
    direction = np.array([-normal[1] / intrinsics.fy, normal[0] / intrinsics.fx])
    length = float(np.linalg.norm(direction))
    if length * max(intrinsics.fx, intrinsics.fy) < 1e-12:
        return np.array([1.0, 0.0])
    return direction / length


def pixel_weights(
    centres: FloatArray, world_from_camera: FloatArray, intrinsics: Intrinsics
) -> PixelWeights:
    """The mesh's weights at each pixel of a virtual image.

    Args:
        centres: ``(N, 3)`` recording centres of the views that take part, N >= 1.
        world_from_camera: ``(4, 4)`` virtual camera.
        intrinsics: of the virtual camera.
    """
    columns, rows = np.meshgrid(np.arange(intrinsics.width), np.arange(intrinsics.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(np.float64)
    vertices = project_centres(centres, world_from_camera, intrinsics)
    distance = np.linalg.norm(centres - world_from_camera[:3, 3], axis=1)
    kept = distinct_vertices(vertices, distance)
    flat = len(kept) < 3 or is_one_dimensional(centres[kept], world_from_camera[:3, 3])
    if not flat:
        try:
            views, weights = _weights_in_triangles(vertices[kept], pixels)
        except scipy.spatial.QhullError:
            flat = True
    if flat:
        direction = line_direction(centres[kept], world_from_camera, intrinsics)
        if len(kept) == 2:
            # Two vertices define their own line, whatever the plane through them.
            difference = vertices[kept[1]] - vertices[kept[0]]
            direction = difference / np.linalg.norm(difference)
        views, weights = _weights_on_line(vertices[kept] @ direction, pixels @ direction)
    shape = (intrinsics.height, intrinsics.width, 3)
    return PixelWeights(kept[views].reshape(shape), weights.reshape(shape))


def distinct_vertices(vertices: FloatArray, distance: FloatArray) -> IntArray:
    """Indices of vertices that do not coincide; of coinciding ones the nearest centre stays.

    Args:
        vertices: ``(N, 2)`` projected centres, pixels.
        distance: ``(N,)`` metres from the virtual centre.

    Returns:
        Indices in rising order of distance.
    """
    kept: list[int] = []
    for index in np.argsort(distance, kind="stable"):
        own = vertices[index]
        limit = max(COINCIDENT_PIXELS, COINCIDENT_SHARE * float(np.abs(own).max()))
        gaps = np.abs(vertices[kept] - own).max(axis=1) if kept else np.array([np.inf])
        if np.all(gaps > limit):
            kept.append(int(index))
    return np.array(kept, dtype=np.int64)


def _weights_on_line(vertices: FloatArray, pixels: FloatArray) -> tuple[IntArray, FloatArray]:
    """One-dimensional mesh: ramps between neighbours, the end views alone beyond the ends."""
    order = np.argsort(vertices, kind="stable")
    position = vertices[order]
    if len(order) == 1:
        views = np.zeros((len(pixels), 3), dtype=np.int64)
        return views, np.tile([1.0, 0.0, 0.0], (len(pixels), 1))
    right = np.clip(np.searchsorted(position, pixels, side="right"), 1, len(order) - 1)
    width = position[right] - position[right - 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        ramp = np.where(width > 0.0, (pixels - position[right - 1]) / width, 0.5)
    ramp = np.clip(ramp, 0.0, 1.0)
    views = np.stack([order[right - 1], order[right], order[right]], axis=1)
    return views, np.stack([1.0 - ramp, ramp, np.zeros_like(ramp)], axis=1)


def _weights_in_triangles(vertices: FloatArray, pixels: FloatArray) -> tuple[IntArray, FloatArray]:
    """Two-dimensional mesh: barycentric weights inside, the border's blend outside."""
    triangulation = scipy.spatial.Delaunay(vertices)
    simplex = triangulation.find_simplex(pixels)
    # Where outer vertices lie on a line, rounding adds triangles without area.
    solid = ~_is_flat(vertices[triangulation.simplices])
    inside = (simplex >= 0) & solid[simplex]
    views = np.zeros((len(pixels), 3), dtype=np.int64)
    weights = np.zeros((len(pixels), 3))
    transform = triangulation.transform[simplex[inside]]
    partial = np.einsum("nij,nj->ni", transform[:, :2], pixels[inside] - transform[:, 2])
    weights[inside] = np.column_stack([partial, 1.0 - partial.sum(axis=1)])
    views[inside] = triangulation.simplices[simplex[inside]]
    edges = _outer_edges(triangulation.simplices[solid].astype(np.int64))
    views[~inside], weights[~inside] = _weights_beyond(vertices, edges, pixels[~inside])
    weights = np.clip(weights, 0.0, 1.0)
    return views, weights / weights.sum(axis=1, keepdims=True)


def _is_flat(triangles: FloatArray) -> BoolArray:
    """Which of the triangles ``(t, 3, 2)`` have no area to within rounding."""
    sides = triangles - np.roll(triangles, 1, axis=1)
    area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    return np.asarray(area <= SMALLEST_AREA * np.sum(sides**2, axis=2).max(axis=1))


def _outer_edges(triangles: IntArray) -> IntArray:
    """The edges ``(e, 2)`` that belong to one triangle only of ``(t, 3)``.

    These are not the edges of the convex hull, which leaves out vertices along a straight border.
    """
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    edges, count = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    return np.asarray(edges[count == 1])


def _weights_beyond(
    vertices: FloatArray, edges: IntArray, pixels: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Blend at the nearest point of the outer edges (e, 2): an edge's two views or a vertex's."""
    start, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    edge = end - start
    along = np.einsum("nej,ej->ne", pixels[:, None] - start, edge) / np.sum(edge**2, axis=1)
    along = np.clip(along, 0.0, 1.0)
    nearest = start + along[..., None] * edge
    distance = np.sum((pixels[:, None] - nearest) ** 2, axis=-1)
    best = np.argmin(distance, axis=1)
    ramp = along[np.arange(len(pixels)), best]
    first, second = edges[best, 0], edges[best, 1]
    return (
        np.stack([first, second, second], axis=1).astype(np.int64),
        np.stack([1.0 - ramp, ramp, np.zeros_like(ramp)], axis=1),
    )
