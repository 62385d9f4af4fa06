"""The photos as a GPU takes them: pyramids and depth maps in texture arrays, and tables.

A pyramid is one rectangle: the finest level, and to its right the others, one below the other. Each
view has a layer of its own while the GPU has layers enough; beyond that several share one, side by
side.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.views import Views
from pipelines.render.gpu_device import Gpu, fill_layer, layers_of, texture_array, upload
from pipelines.render.surface import sample_steps

WordArray = NDArray[np.uint32]


@dataclass(frozen=True)
class Placement:
    """Where N rectangles lie in the layers of a texture.

    Attributes:
        origin: ``(N, 2)`` column and row of their upper left corners.
        layer: ``(N,)`` the layer of each.
        width: width of the layers, pixels.
        height: height of the layers, pixels.
        layers: number of layers.
    """

    origin: IntArray
    layer: IntArray
    width: int
    height: int
    layers: int


@dataclass(frozen=True)
class GpuViews:
    """The photos on a GPU.

    Attributes:
        count: number of views that may take part.
        levels: number of levels of their pyramids.
        origin: ``(3,)`` world coordinates of the origin on the GPU, near the photos: it computes in
            single precision.
        table: buffer of ``View`` of ``geometry.wgsl``.
        areas: buffer of the levels' rectangles, ``(count, levels, 4)``.
        texels: texture view, RGB.
        depths: texture view, inverse depths.
        views: all photos, in the computer's memory.
        chosen: ``(count,)`` indices of the photos on the GPU.
    """

    count: int
    levels: int
    origin: FloatArray
    table: Any
    areas: Any
    texels: Any
    depths: Any
    views: Views
    chosen: IntArray


def upload_views(gpu: Gpu, views: Views, usable: BoolArray) -> GpuViews:
    """Uploads views to a GPU.

    Args:
        gpu: the GPU.
        views: the light field's photos.
        usable: ``(N,)`` views that may take part, and are uploaded.

    Raises:
        StageError: photos larger than the GPU's textures.
    """
    chosen = np.flatnonzero(usable)
    arrays = views.arrays
    levels = arrays.level_size.shape[1]
    places = _pyramid_places(arrays.level_size[chosen])
    extent = np.max(places[..., :2] + places[..., 2:], axis=(0, 1), initial=1)
    photos = placement(len(chosen), extent, gpu)
    areas = places.copy()
    areas[..., :2] += photos.origin[:, None]
    depth_extent = np.max(arrays.depth_size[chosen], axis=0, initial=1)
    maps = placement(len(chosen) if views.has_depth else 0, depth_extent, gpu)
    origin = views.centres.mean(axis=0)
    return GpuViews(
        count=len(chosen),
        levels=levels,
        origin=origin,
        table=upload(gpu, view_table(views, chosen, origin, photos, maps)),
        areas=upload(gpu, areas.astype(np.uint32)),
        texels=_texture(gpu, "rgba8uint", photos, _photo_layers(views, chosen, areas, photos)),
        depths=_texture(gpu, "r32float", maps, _depth_layers(views, chosen, maps)),
        views=views,
        chosen=chosen,
    )


def placement(count: int, extent: IntArray, gpu: Gpu) -> Placement:
    """Places rectangles in layers: one in each, if possible.

    Args:
        count: number of rectangles.
        extent: ``(2,)`` width and height of the largest.
        gpu: whose textures they have to fit into.

    Raises:
        StageError: one is larger than the GPU's textures, or all together are.
    """
    largest, most = gpu.limits["max-texture-dimension-2d"], gpu.limits["max-texture-array-layers"]
    width, height = int(extent[0]), int(extent[1])
    together = max(1, -(-count // most))
    columns = max(1, min(together, largest // width))
    rows = -(-together // columns)
    if columns * width > largest or rows * height > largest:
        raise StageError(
            f"{count} photos whose pyramids are of {width}x{height} pixels do not fit into this "
            f"GPU's textures ({most} layers of {largest}x{largest}); use device cpu"
        )
    number = np.arange(count)
    column, row = number % together % columns, number % together // columns
    return Placement(
        origin=np.column_stack([column * width, row * height]),
        layer=number // together,
        width=columns * width,
        height=rows * height,
        layers=max(1, -(-count // together)),
    )


def view_table(
    views: Views, chosen: IntArray, origin: FloatArray, photos: Placement, maps: Placement
) -> WordArray:
    """``(n, 20)`` words: ``View`` of ``geometry.wgsl``.

    Args:
        views: the light field's photos.
        chosen: ``(n,)`` indices of the photos on the GPU.
        origin: ``(3,)`` world coordinates of the origin on the GPU.
        photos: where their pyramids are placed.
        maps: where their depth maps are placed; none where there are none.
    """
    arrays = views.arrays
    table = np.zeros((len(chosen), 20), dtype=np.uint32)
    numbers = table.view(np.float32)
    rows = numbers[:, :12].reshape(-1, 3, 4)
    rows[..., :3] = arrays.projection[chosen, :, :3]
    rows[..., 3] = arrays.centres[chosen] - origin
    numbers[:, :12] = rows.reshape(-1, 12)
    numbers[:, 12:14] = arrays.level_size[chosen, 0]
    numbers[:, 14] = arrays.focal[chosen]
    numbers[:, 15] = photos.layer
    if len(maps.origin):
        size = arrays.depth_size[chosen]
        table[:, 16:18] = maps.origin
        table[:, 18] = size[:, 0] + (size[:, 1] << 16)
        table[:, 19] = maps.layer
    return table


def pose_table(world_from_camera: FloatArray, origin: FloatArray) -> Float32Array:
    """``(M, 12)`` numbers: ``Pose`` of ``geometry.wgsl``.

    Args:
        world_from_camera: ``(M, 4, 4)``.
        origin: ``(3,)`` world coordinates of the origin on the GPU.
    """
    rows = np.empty((len(world_from_camera), 3, 4), dtype=np.float32)
    rows[..., :3] = world_from_camera[:, :3, :3]
    rows[..., 3] = world_from_camera[:, :3, 3] - origin
    return rows.reshape(-1, 12)


def source_table(gpu_views: GpuViews, intrinsics: Intrinsics, spacing: float) -> WordArray:
    """``(n, 16)`` words: ``Source`` of ``surface.wgsl``.

    Args:
        gpu_views: the photos on the GPU.
        intrinsics: of the virtual camera.
        spacing: of the depth grid, virtual pixels.
    """
    arrays, chosen = gpu_views.views.arrays, gpu_views.chosen
    table = np.zeros((len(chosen), 16), dtype=np.uint32)
    rows = np.zeros((len(chosen), 3, 4), dtype=np.float32)
    rows[..., :3] = arrays.rays[chosen]
    rows[..., 3] = arrays.axes[chosen]
    table[:, :12] = rows.reshape(-1, 12).view(np.uint32)
    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    table[:, 12] = sample_steps(arrays, focal, spacing)[chosen]
    return table


def _pyramid_places(level_size: IntArray) -> IntArray:
    """Rectangles ``(n, L, 4)`` of the levels, relative to the pyramid's corner: x, y, w, h."""
    places = np.zeros((*level_size.shape[:2], 4), dtype=np.int64)
    places[..., 2:] = level_size
    for level in range(1, level_size.shape[1]):
        before = places[:, level - 1]
        is_repeated = (level_size[:, level] == level_size[:, level - 1]).all(axis=1)
        is_first = level == 1
        places[:, level, 0] = np.where(is_repeated, before[:, 0], level_size[:, 0, 0])
        below = np.zeros(len(before), np.int64) if is_first else before[:, 1] + before[:, 3]
        places[:, level, 1] = np.where(is_repeated, before[:, 1], below)
    return places


def _texture(gpu: Gpu, pixel_format: str, place: Placement, layers: Iterator[NDArray[Any]]) -> Any:
    texture = texture_array(gpu, pixel_format, place.width, place.height, place.layers)
    for number, pixels in enumerate(layers):
        fill_layer(gpu, texture, number, pixels)
    return layers_of(texture)


def _photo_layers(
    views: Views, chosen: IntArray, areas: IntArray, place: Placement
) -> Iterator[NDArray[np.uint8]]:
    """The layers' pixels ``(height, width, 4)``, one after the other."""
    for layer in range(place.layers):
        pixels = np.zeros((place.height, place.width, 4), dtype=np.uint8)
        for number in np.flatnonzero(place.layer == layer):
            for level, (x, y, width, height) in enumerate(areas[number].tolist()):
                photo = views.level(int(chosen[number]), level)
                pixels[y : y + height, x : x + width, :3] = photo
        yield pixels


def _depth_layers(
    views: Views, chosen: IntArray, place: Placement
) -> Iterator[NDArray[np.float32]]:
    """The layers' inverse depths ``(height, width)``, one after the other."""
    for layer in range(place.layers):
        pixels = np.zeros((place.height, place.width), dtype=np.float32)
        for number in np.flatnonzero(place.layer == layer):
            x, y = place.origin[number].tolist()
            depth = views.depth_map(int(chosen[number]))
            pixels[y : y + depth.shape[0], x : x + depth.shape[1]] = depth
        yield pixels
