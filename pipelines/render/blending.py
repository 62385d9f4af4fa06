"""Which views a pixel is blended from: the choice of rule, and the second rule, readable.

``DELAUNAY`` is the paper's mesh (``delaunay_mesh``). ``UNSTRUCTURED`` follows Buehler, Bosse,
McMillan, Gortler, Cohen (2001), "Unstructured lumigraph rendering": at a surface point the views
are ranked by a penalty for the angle between their ray and the virtual one, for a coarser
resolution, and for showing it near the border of their image; the k best share the weight, which
falls to zero where the next one takes over. Views that do not show the point, because it lies
outside their image or behind something nearer, are not ranked; the border's penalty grows without
bound, so that no weight jumps where an image ends. As in that paper, this is done at the corners of
a coarse grid of tiles in the virtual image, and the weights are interpolated in between.

Of a large light field most views are far from the best. So with more than ``MOST_RANKED`` views
candidates are selected first: the best view at each of a few points all over the image. The corners
choose among the candidates, and so may miss a view that is the best for one corner alone.
"""

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray
from pipelines.lightfield.view_penalties import border_penalties, ray_penalties, sees
from pipelines.lightfield.views import Views
from pipelines.render.delaunay_mesh import PixelWeights
from pipelines.render.view_mapping import ViewMapping

# Tiles are so many pixels wide and high, but there are never fewer or more of them than this.
TILE_SIDE = 5
FEWEST_TILES, MOST_TILES = 6, 40
VIEWS_PER_CORNER = 3
# A tile blends the views of its four corners.
VIEWS_PER_TILE = 4 * VIEWS_PER_CORNER
# Up to so many views are all candidates. Of more, the candidates are the best views at any point of
# a grid of so many points across and down.
MOST_RANKED = 64
CANDIDATE_POINTS = 4
# Penalties below this, in radians, count as the same ray.
SMALLEST_PENALTY = 1e-4
# A view whose depth map shows something nearer than this share of a point's distance does not
# show the point: depth maps are not more exact than that.
OCCLUSION_FACTOR = 1.05


def tile_count(size: int) -> int:
    """How many tiles there are across (or down) an image of so many pixels."""
    return min(max(size // TILE_SIDE, FEWEST_TILES), MOST_TILES)


def tile_borders(size: int) -> IntArray:
    """Pixel columns (or rows) ``(tiles + 1,)`` on which the tiles' corners lie."""
    tiles = tile_count(size)
    return np.minimum(np.arange(tiles + 1) * size // tiles, size - 1)


def candidate_positions(size: int) -> IntArray:
    """Pixel columns (or rows) ``(CANDIDATE_POINTS,)`` at which candidate views are selected."""
    return np.arange(CANDIDATE_POINTS) * (size - 1) // (CANDIDATE_POINTS - 1)


def occluded(views: Views, view: int, target: FloatArray, surface: FloatArray) -> BoolArray:
    """Whether a view sees something nearer in the directions of surface points.

    Args:
        views: the light field's photos.
        view: which of them.
        target: ``(..., 3)`` homogeneous pixels of the points in the view, the third component being
            the depth in the view divided by the virtual depth.
        surface: ``(...)`` virtual inverse depths of the points.
    """
    depth_map = views.depth_map(view)
    if depth_map.size == 0:
        return np.zeros(surface.shape, dtype=bool)
    width, height = views.arrays.level_size[view, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = target[..., 0] / target[..., 2]
        y = target[..., 1] / target[..., 2]
        own = surface / target[..., 2]
    usable = sees(target, width, height)
    columns = np.where(usable, (x + 0.5) * (depth_map.shape[1] / width), 0).astype(np.int64)
    rows = np.where(usable, (y + 0.5) * (depth_map.shape[0] / height), 0).astype(np.int64)
    columns = np.minimum(columns, depth_map.shape[1] - 1)
    rows = np.minimum(rows, depth_map.shape[0] - 1)
    return np.asarray(usable & (depth_map[rows, columns] > OCCLUSION_FACTOR * own))


def unstructured_weights(
    views: Views, usable: BoolArray, mapping: ViewMapping, surface: FloatArray
) -> PixelWeights:
    """Unstructured-lumigraph weights at each pixel of a virtual image.

    Args:
        views: the light field's photos.
        usable: ``(N,)`` views that may take part.
        mapping: from the virtual camera into the views.
        surface: ``(H, W)`` virtual inverse depth; 0 where there is no surface.

    Returns:
        Views and weights ``(H, W, VIEWS_PER_TILE)``; all zero where no corner sees any view.
    """

    def weights_at(columns: IntArray, rows: IntArray, usable: BoolArray) -> FloatArray:
        found = np.zeros((len(rows), len(columns), len(views)))
        for i, row in enumerate(rows):
            for j, column in enumerate(columns):
                if surface[row, column] > 0.0:
                    pixel, depth = np.array([column, row, 1.0]), float(surface[row, column])
                    found[i, j] = _point_weights(views, usable, mapping, pixel, depth)
        return found

    height, width = surface.shape
    if usable.sum() > MOST_RANKED:
        found = weights_at(candidate_positions(width), candidate_positions(height), usable)
        found = found.reshape(-1, len(views))
        usable = np.zeros_like(usable)
        # The best view has the largest weight.
        usable[found.argmax(axis=1)[found.any(axis=1)]] = True
    columns, rows = tile_borders(width), tile_borders(height)
    at_corner = weights_at(columns, rows, usable)
    shape = (height, width, VIEWS_PER_TILE)
    chosen, weights = np.zeros(shape, dtype=np.int64), np.zeros(shape)
    for y in range(height):
        i = _tile_of(rows, y)
        for x in range(width):
            j = _tile_of(columns, x)
            corners = at_corner[i : i + 2, j : j + 2].reshape(4, -1)
            members = np.flatnonzero(corners.any(axis=0))
            fx = (x - columns[j]) / max(columns[j + 1] - columns[j], 1)
            fy = (y - rows[i]) / max(rows[i + 1] - rows[i], 1)
            shares = np.array([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
            chosen[y, x, : len(members)] = members
            weights[y, x, : len(members)] = shares @ corners[:, members]
    return PixelWeights(chosen, weights)


def _tile_of(borders: IntArray, position: int) -> int:
    """Index of the tile in which a pixel column (or row) lies."""
    return int(np.clip(np.searchsorted(borders, position, side="right") - 1, 0, len(borders) - 2))


def _point_weights(
    views: Views,
    usable: BoolArray,
    mapping: ViewMapping,
    pixel: FloatArray,
    inverse_depth: float,
) -> FloatArray:
    """Weights ``(N,)`` of the views at one virtual pixel; at most k are not zero, sum 1 or 0.

    Args:
        views: the light field's photos.
        usable: ``(N,)`` views that may take part.
        mapping: from the virtual camera into the views.
        pixel: ``(3,)`` homogeneous virtual pixel, third component 1.
        inverse_depth: of the surface there.
    """
    weights = np.zeros(len(views))
    target = mapping.into_all_views(pixel, inverse_depth)
    size = views.arrays.level_size[:, 0]
    seen = usable & sees(target, size[:, 0], size[:, 1])
    for view in np.flatnonzero(seen):
        seen[view] = not occluded(views, int(view), target[view], np.array(inverse_depth))
    candidates = np.flatnonzero(seen)
    if len(candidates) == 0:
        return weights
    pose, intrinsics = mapping.world_from_camera, mapping.intrinsics
    centre = pose[:3, 3]
    ray = pose[:3, :3] @ np.linalg.inv(intrinsics.matrix()) @ pixel
    penalty = ray_penalties(views.centres[candidates], centre, centre + ray / inverse_depth)
    penalty += border_penalties(target[candidates], size[candidates])
    order = np.argsort(penalty, kind="stable")
    best = order[:VIEWS_PER_CORNER]
    # Where no further view takes over, it is as if one with an infinite penalty did.
    limit = penalty[order[VIEWS_PER_CORNER]] if len(order) > VIEWS_PER_CORNER else np.inf
    share = np.maximum(1.0 - penalty[best] / max(limit, 2.0 * SMALLEST_PENALTY), 0.0)
    share /= np.maximum(penalty[best], SMALLEST_PENALTY)
    total = share.sum()
    weights[candidates[best]] = share / total if total > 0.0 else 1.0 / len(best)
    return weights
