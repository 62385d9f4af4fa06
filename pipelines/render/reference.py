"""The readable renderer: every step of the paper's section 2 in plain NumPy.

It is the truth that the fast path is tested against, and too slow for anything else.
"""

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray, IntArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane, plane_inverse_depth
from pipelines.lightfield.view_penalties import sees
from pipelines.lightfield.views import Views, without_depth
from pipelines.render.blending import occluded, unstructured_weights
from pipelines.render.choices import Blending, Quality
from pipelines.render.delaunay_mesh import PixelWeights, pixel_weights, project_centres
from pipelines.render.surface import depth_inverse_depth
from pipelines.render.view_mapping import ViewMapping

# A view is in the mesh when it sees any of a grid of so many by so many points of the surface.
FRUSTUM_SAMPLES = 5
# Below this sum of weights the blended views do not show the pixel.
SMALLEST_WEIGHT = 1e-6


def render_reference(
    views: Views,
    plane: Plane,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    blending: Blending = Blending.DELAUNAY,
    quality: Quality = Quality.PLANE,
) -> tuple[FloatArray, BoolArray]:
    """Renders a virtual view.

    Args:
        views: the light field's photos.
        plane: the scene's surface where ``quality`` is ``PLANE``.
        world_from_camera: ``(4, 4)`` virtual camera.
        intrinsics: of the virtual camera.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the depth maps.

    Returns:
        The image ``(H, W, 3)``, RGB in 0 to 255, zero where uncovered; and which pixels are
        covered, ``(H, W)``.
    """
    shape = (intrinsics.height, intrinsics.width)
    if quality is Quality.PLANE:
        views = without_depth(views)
        surface = plane_inverse_depth(plane, world_from_camera, intrinsics)
        usable = plane.signed_distance(views.centres) > 0.0
    else:
        surface = depth_inverse_depth(views, world_from_camera, intrinsics, quality)
        usable = np.ones(len(views), dtype=bool)
    mapping = ViewMapping.of(views, world_from_camera, intrinsics)
    if blending is Blending.DELAUNAY:
        usable &= views_in_frustum(views, mapping, surface)
    if not usable.any():
        return np.zeros((*shape, 3)), np.zeros(shape, dtype=bool)
    columns, rows = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    pixels: FloatArray = np.stack([columns, rows, np.ones(shape)], axis=-1)  # [H, W, 3]
    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    colours = np.zeros((len(views), *shape, 3))
    seen = np.zeros((len(views), *shape), dtype=bool)
    hidden = np.zeros((len(views), *shape), dtype=bool)
    for view in np.flatnonzero(usable):
        target = mapping.into_view(int(view), pixels, surface)
        width, height = views.arrays.level_size[view, 0]
        seen[view] = sees(target, width, height) & (surface > 0.0)
        hidden[view] = occluded(views, int(view), target, surface)
        colours[view] = sample_view(views, int(view), target, seen[view], focal)
    if blending is Blending.DELAUNAY:
        weights = _mesh_weights(views, usable, world_from_camera, intrinsics)
    else:
        weights = unstructured_weights(views, usable, mapping, surface)
    projected = project_centres(views.centres, world_from_camera, intrinsics)
    return _blend(weights, colours, seen, hidden, projected)


def frustum_positions(size: int) -> IntArray:
    """Pixel columns (or rows) ``(FRUSTUM_SAMPLES,)`` of the points that stand for the frustum."""
    return np.arange(FRUSTUM_SAMPLES) * (size - 1) // (FRUSTUM_SAMPLES - 1)


def views_in_frustum(views: Views, mapping: ViewMapping, surface: FloatArray) -> BoolArray:
    """Which views see any of a grid of surface points of the virtual frustum, ``(N,)``.

    Args:
        views: the light field's photos.
        mapping: from the virtual camera into the views.
        surface: ``(H, W)`` virtual inverse depth; 0 where there is no surface.
    """
    height, width = surface.shape
    rows, columns = np.meshgrid(frustum_positions(height), frustum_positions(width), indexing="ij")
    depth = surface[rows, columns].reshape(-1)
    samples = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3)
    linear = samples @ np.swapaxes(mapping.homographies, 1, 2)
    target = linear + depth[:, None] * mapping.epipoles[:, None]  # [N, S, 3]
    size = views.arrays.level_size[:, 0]
    seen = sees(target, size[:, None, 0], size[:, None, 1]) & (depth > 0.0)
    return np.asarray(seen.any(axis=1))


def _mesh_weights(
    views: Views, usable: BoolArray, world_from_camera: FloatArray, intrinsics: Intrinsics
) -> PixelWeights:
    """The Delaunay mesh's weights, with indices into all views and not only the usable ones."""
    indices = np.flatnonzero(usable)
    own = pixel_weights(views.centres[indices], world_from_camera, intrinsics)
    return PixelWeights(indices[own.views], own.weights)


def sample_view(
    views: Views, view: int, target: FloatArray, seen: BoolArray, focal: float
) -> FloatArray:
    """Bilinear samples of one view at the pyramid level that suits each pixel.

    Args:
        views: the light field's photos.
        view: which of them.
        target: ``(..., 3)`` homogeneous pixels in the view, the third component being the depth in
            the view divided by the virtual depth.
        seen: ``(...)`` where to sample; elsewhere the result is zero.
        focal: of the virtual camera, pixels.

    Returns:
        ``(..., 3)`` RGB.
    """
    result = np.zeros((*seen.shape, 3))
    depth = target[seen][:, 2]
    position = target[seen][:, :2] / depth[:, None]
    # How many pixels of the view a virtual pixel spans, on a surface that faces both.
    scale = views.arrays.focal[view] / (focal * depth)
    levels = np.clip(np.floor(np.log2(scale) + 0.5), 0, views.arrays.level_size.shape[1] - 1)
    samples = np.zeros((len(depth), 3))
    for level in np.unique(levels).astype(int):
        chosen = levels == level
        samples[chosen] = _bilinear(
            views.level(view, level), position[chosen], views.arrays.level_size[view, 0]
        )
    result[seen] = samples
    return result


def _bilinear(image: ImageArray, position: FloatArray, full_size: IntArray) -> FloatArray:
    height, width = image.shape[:2]
    x = np.clip((position[:, 0] + 0.5) * width / full_size[0] - 0.5, 0.0, width - 1.0)
    y = np.clip((position[:, 1] + 0.5) * height / full_size[1] - 0.5, 0.0, height - 1.0)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fx, fy = (x - left)[:, None], (y - top)[:, None]
    upper = image[top, left] * (1.0 - fx) + image[top, right] * fx
    lower = image[bottom, left] * (1.0 - fx) + image[bottom, right] * fx
    return np.asarray(upper * (1.0 - fy) + lower * fy)


def _blend(
    weights: PixelWeights,
    colours: FloatArray,
    seen: BoolArray,
    hidden: BoolArray,
    projected: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """Weighted sum of the chosen views; what one does not show is shared among the others.

    Where none of them shows a pixel, a fallback view is taken: that with the nearest projected
    centre.

    Args:
        weights: of each pixel.
        colours: ``(N, H, W, 3)`` samples of all views.
        seen: ``(N, H, W)`` pixels inside each view's image.
        hidden: ``(N, H, W)`` pixels that are occluded in it.
        projected: ``(N, 2)`` recording centres in the virtual image.
    """
    grid = np.indices(seen.shape[1:])
    rows, columns = grid[0], grid[1]
    image = np.zeros((*seen.shape[1:], 3))
    total = np.zeros(seen.shape[1:])
    for member in range(weights.views.shape[-1]):
        view = weights.views[..., member]
        shown = seen[view, rows, columns] & ~hidden[view, rows, columns]
        weight = np.maximum(weights.weights[..., member], 0.0) * shown
        image += weight[..., None] * colours[view, rows, columns]
        total += weight
    blended = total > SMALLEST_WEIGHT
    image[blended] /= total[blended][:, None]
    # An occluded view is the fallback only where all others are occluded too: depth is not exact
    # enough to leave holes.
    rest = ~blended
    pixels = np.stack([columns, rows], axis=-1)[rest].astype(float)
    offsets = pixels[:, None] - projected  # [P, N, 2]
    distance: FloatArray = np.sum(offsets * offsets, axis=2)
    clear = np.where((seen & ~hidden)[:, rest].T, distance, np.inf)
    any_view = np.where(seen[:, rest].T, distance, np.inf)
    has_clear = np.isfinite(clear.min(axis=1))
    nearest = np.where(has_clear, clear.argmin(axis=1), any_view.argmin(axis=1))
    found = np.isfinite(any_view.min(axis=1))
    image[rest] = np.where(found[:, None], colours[nearest, rows[rest], columns[rest]], 0.0)
    covered = blended.copy()
    covered[rest] = found
    return image, covered
