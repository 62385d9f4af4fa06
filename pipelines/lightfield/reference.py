"""The readable renderer: every step of the paper's section 2 in plain NumPy.

It is the truth that the fast path is tested against, and too slow for anything else.
"""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, FloatArray, ImageArray, IntArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.blending import Blending, unstructured_weights
from pipelines.lightfield.net import PixelWeights, pixel_weights, project_centres, sees
from pipelines.lightfield.views import Views

# A view takes part when it sees one of so many points of the surface in the virtual frustum.
FRUSTUM_SAMPLES = 5
# Below this sum of weights the views of the net do not show the pixel.
SMALLEST_WEIGHT = 1e-6


def render_reference(
    views: Views,
    plane: Plane,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    blending: Blending = Blending.DELAUNAY,
) -> tuple[FloatArray, BoolArray]:
    """Renders a virtual view.

    Args:
        views: the light field's photos.
        plane: the scene's surface.
        world_from_camera: ``(4, 4)`` virtual camera.
        intrinsics: of the virtual camera.
        blending: the rule that chooses and weights the views.

    Returns:
        The image ``(H, W, 3)``, RGB in 0 to 255, zero where uncovered; and which pixels are
        covered, ``(H, W)``.
    """
    shape = (intrinsics.height, intrinsics.width)
    nothing = np.zeros((*shape, 3)), np.zeros(shape, dtype=bool)
    if plane.signed_distance(world_from_camera[:3, 3]) <= 0.0:
        return nothing
    maps, facing = plane_mappings(views, plane, world_from_camera, intrinsics)
    usable = plane.signed_distance(views.centres) > 0.0
    if blending is Blending.DELAUNAY:
        usable &= views_in_frustum(views, maps, facing, intrinsics)
    if not usable.any():
        return nothing
    columns, rows = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    pixels = np.stack([columns, rows, np.ones(shape)], axis=-1)  # [H, W, 3]
    in_front = pixels @ facing < 0.0
    colours = np.zeros((len(views), *shape, 3))
    seen = np.zeros((len(views), *shape), dtype=bool)
    for view in np.flatnonzero(usable):
        target = pixels @ maps[view].T
        width, height = views.level_size[view, 0]
        seen[view] = sees(target, width, height) & in_front
        colours[view] = _sample(views, int(view), maps[view], target, seen[view])
    if blending is Blending.DELAUNAY:
        weights = _net_weights(views, usable, world_from_camera, intrinsics)
    else:
        weights = unstructured_weights(views, plane, maps, facing, world_from_camera, intrinsics)
    corners = project_centres(views.centres, world_from_camera, intrinsics)
    return _blend(weights, colours, seen, corners)


def _net_weights(
    views: Views, usable: BoolArray, world_from_camera: FloatArray, intrinsics: Intrinsics
) -> PixelWeights:
    """The net's weights with indices into all views, not only those that take part."""
    indices = np.flatnonzero(usable)
    net = pixel_weights(views.centres[indices], world_from_camera, intrinsics)
    return PixelWeights(indices[net.views], net.weights)


def plane_mappings(
    views: Views, plane: Plane, world_from_camera: FloatArray, intrinsics: Intrinsics
) -> tuple[FloatArray, FloatArray]:
    """The mappings from virtual pixels over the plane into each view, the paper's B_i B_V^-1.

    A virtual pixel p has the viewing ray r = R K^-1 p and meets the plane n . x + d = 0 at
    C - r (n . C + d) / (n . r). Multiplied by -(n . r) > 0 this is linear in p.

    Returns:
        ``(N, 3, 3)`` matrices to homogeneous pixels of the views' finest levels (third component
        positive in front of the view), and ``(3,)`` coefficients whose product with p is negative
        where the ray meets the plane in front of the virtual camera.
    """
    centre = world_from_camera[:3, 3]
    rays = world_from_camera[:3, :3] @ np.linalg.inv(intrinsics.matrix())
    facing = plane.normal @ rays
    height = float(plane.signed_distance(centre))
    points = height * rays - np.outer(centre, facing)  # homogeneous scale: -facing . p
    maps = views.projection[:, :, :3] @ points - views.projection[:, :, 3:] * facing
    return maps, facing


def views_in_frustum(
    views: Views, maps: FloatArray, facing: FloatArray, intrinsics: Intrinsics
) -> BoolArray:
    """Which views see any of a grid of surface points of the virtual frustum, ``(N,)``."""
    columns, rows = np.meshgrid(
        np.linspace(-0.5, intrinsics.width - 0.5, FRUSTUM_SAMPLES),
        np.linspace(-0.5, intrinsics.height - 0.5, FRUSTUM_SAMPLES),
    )
    samples = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3)
    samples = samples[samples @ facing < 0.0]
    target = samples @ np.swapaxes(maps, 1, 2)  # [N, S, 3]
    size = views.level_size[:, 0]
    seen = sees(target, size[:, None, 0], size[:, None, 1])
    return np.asarray(seen.any(axis=1))


def _sample(
    views: Views, view: int, mapping: FloatArray, target: FloatArray, seen: BoolArray
) -> FloatArray:
    """Bilinear samples of one view at the pyramid level that suits each pixel, ``(H, W, 3)``."""
    result = np.zeros((*seen.shape, 3))
    depth = target[seen][:, 2]
    position = target[seen][:, :2] / depth[:, None]
    # The area that a virtual pixel covers in the view is |det H| / depth^3.
    scale = np.sqrt(np.abs(np.linalg.det(mapping)) / depth**3)
    levels = np.clip(np.floor(np.log2(scale) + 0.5), 0, views.level_size.shape[1] - 1)
    samples = np.zeros((len(depth), 3))
    for level in np.unique(levels).astype(int):
        chosen = levels == level
        samples[chosen] = _bilinear(
            views.level(view, level), position[chosen], views.level_size[view, 0]
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
    weights: PixelWeights, colours: FloatArray, seen: BoolArray, corners: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Weighted sum of what the chosen views show; what they do not show goes to the others."""
    rows, columns = np.indices(seen.shape[1:])
    image = np.zeros((*seen.shape[1:], 3))
    total = np.zeros(seen.shape[1:])
    for corner in range(3):
        view = weights.views[..., corner]
        weight = weights.weights[..., corner] * seen[view, rows, columns]
        image += weight[..., None] * colours[view, rows, columns]
        total += weight
    blended = total > SMALLEST_WEIGHT
    image[blended] /= total[blended][:, None]
    # Where no chosen view shows the pixel, the view with the nearest projected centre that does.
    pixels = np.stack([columns, rows], axis=-1)[~blended].astype(float)
    offsets = pixels[:, None] - corners  # [P, N, 2]
    distance: FloatArray = np.sum(offsets * offsets, axis=2)
    distance[~seen[:, ~blended].T] = np.inf
    nearest = distance.argmin(axis=1)
    found = np.isfinite(distance.min(axis=1))
    substitute = colours[nearest, rows[~blended], columns[~blended]]
    image[~blended] = np.where(found[:, None], substitute, 0.0)
    covered = blended.copy()
    covered[~blended] = found
    return image, covered
