"""The photos as the renderers use them: undistorted, in area-averaged pyramids, in one buffer.

A view is sampled at the pyramid level whose pixels are about as large as those of the virtual
image, so that a photo seen from afar is averaged and not point-sampled (Williams 1983, "Pyramidal
parametrics").
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np

from pipelines.artifacts.arguments import checked_number
from pipelines.artifacts.arrays import Float32Array, FloatArray, ImageArray, IntArray
from pipelines.artifacts.processes import in_threads
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.geometry.camera import Camera, Intrinsics, Undistorter
from pipelines.geometry.pose import inverse
from pipelines.lightfield.scene import Scene

SMALLEST_LEVEL_SIDE = 8
# Side of the squares over which depth maps are max-pooled; a power of 2, so that a position in the
# pooled map rounds as one in the map does.
POOL_SIDE = 4


class ViewArrays(NamedTuple):
    """N posed pinhole photos as arrays, in the form that the C++ core takes.

    Attributes:
        texels: ``(T, 4)`` uint8, RGB and 255 (weights are summed in the fourth channel): all
            pyramid levels of all views, row by row, and at least one more row.
        level_start: ``(N, L)`` index of a level's first texel.
        level_size: ``(N, L, 2)`` width and height of each level; level 0 is the finest. Views with
            fewer levels repeat their last one.
        projection: ``(N, 3, 4)`` world points to homogeneous pixels of level 0.
        rays: ``(N, 3, 3)`` homogeneous pixels of level 0 to world directions whose length along the
            optical axis is 1.
        centres: ``(N, 3)`` recording centres, world coordinates.
        axes: ``(N, 3)`` optical axes.
        focal: ``(N,)`` mean focal length of level 0, pixels.
        inverse_depth: ``(D,)`` 1 / metres along the optical axis, all views' depth maps row by row;
            0 where unknown; empty where there are none.
        depth_start: ``(N,)`` index of a view's first value.
        depth_size: ``(N, 2)`` width and height of each view's depth map; 0 where it has none.
        pooled_depth: ``(B,)`` all depth maps max-pooled over squares of ``POOL_SIDE``, row by row:
            a point that these do not hide need not be looked up in the maps.
        pooled_start: ``(N,)`` index of a view's first pooled value.
    """

    texels: ImageArray
    level_start: IntArray
    level_size: IntArray
    projection: FloatArray
    rays: FloatArray
    centres: FloatArray
    axes: FloatArray
    focal: FloatArray
    inverse_depth: Float32Array
    depth_start: IntArray
    depth_size: IntArray
    pooled_depth: Float32Array
    pooled_start: IntArray


@dataclass(frozen=True)
class Views:
    """N posed pinhole photos with their pyramids and, where known, depth maps.

    Attributes:
        arrays: pyramids, poses and depth maps.
        intrinsics: pinhole intrinsics of level 0 of each view.
    """

    arrays: ViewArrays
    intrinsics: tuple[Intrinsics, ...]

    def __len__(self) -> int:
        return len(self.intrinsics)

    @property
    def centres(self) -> FloatArray:
        """``(N, 3)`` recording centres, world coordinates."""
        return self.arrays.centres

    @property
    def has_depth(self) -> bool:
        """Whether any view has a depth map."""
        return len(self.arrays.inverse_depth) > 0

    def level(self, view: int, level: int) -> ImageArray:
        """``(height, width, 3)`` RGB of one pyramid level of one view."""
        width, height = self.arrays.level_size[view, level]
        start = self.arrays.level_start[view, level]
        flat = self.arrays.texels[start : start + width * height]
        # OpenCV packs and unpacks colours many times as fast as NumPy copies three bytes of four.
        return np.asarray(cv2.cvtColor(flat.reshape(height, width, 4), cv2.COLOR_RGBA2RGB))

    def depth_map(self, view: int) -> Float32Array:
        """``(height, width)`` inverse depth of one view; empty where it has none."""
        width, height = self.arrays.depth_size[view]
        start = self.arrays.depth_start[view]
        return self.arrays.inverse_depth[start : start + width * height].reshape(height, width)


def build_views(
    images: Sequence[ImageArray],
    intrinsics: Sequence[Intrinsics],
    world_from_camera: FloatArray,
    inverse_depths: Sequence[Float32Array] | None = None,
) -> Views:
    """Builds the pyramids of pinhole photos.

    Args:
        images: N images ``(height, width, 3)``, RGB.
        intrinsics: of each image.
        world_from_camera: ``(N, 4, 4)``.
        inverse_depths: N depth maps ``(h, w)`` of the same fields of view, of any size; 0: unknown.
    """
    texels, level_start, level_size = _packed_pyramids(images)
    matrices = np.stack([pinhole.matrix() for pinhole in intrinsics])
    arrays = ViewArrays(
        texels=texels,
        level_start=level_start,
        level_size=level_size,
        projection=np.ascontiguousarray(matrices @ inverse(world_from_camera)[:, :3, :]),
        rays=np.ascontiguousarray(world_from_camera[:, :3, :3] @ np.linalg.inv(matrices)),
        centres=np.ascontiguousarray(world_from_camera[:, :3, 3]),
        axes=np.ascontiguousarray(world_from_camera[:, :3, 2]),
        focal=np.array([0.5 * (pinhole.fx + pinhole.fy) for pinhole in intrinsics]),
        **_packed_depths(len(images), inverse_depths),
    )
    return Views(arrays, tuple(intrinsics))


def _packed_pyramids(images: Sequence[ImageArray]) -> tuple[ImageArray, IntArray, IntArray]:
    """``texels``, ``level_start`` and ``level_size`` of ``ViewArrays``."""
    pyramids = list(in_threads(_pyramid, images))
    level_count = max(len(pyramid) for pyramid in pyramids)
    level_start = np.zeros((len(pyramids), level_count), dtype=np.int64)
    level_size = np.zeros((len(pyramids), level_count, 2), dtype=np.int64)
    count = sum(p.shape[0] * p.shape[1] for q in pyramids for p in q)
    count += texels_beyond(max(image.shape[1] for image in images))
    texels = np.full((count, 4), 255, dtype=np.uint8)
    position = 0
    for view, pyramid in enumerate(pyramids):
        for level, image in enumerate(pyramid):
            height, width = image.shape[:2]
            level_start[view, level:] = position
            level_size[view, level:] = width, height
            packed = cv2.cvtColor(image, cv2.COLOR_RGB2RGBA)
            texels[position : position + width * height] = packed.reshape(-1, 4)
            position += width * height
    return texels, level_start, level_size


def texels_beyond(widest: int) -> int:
    """Texels after those of the last image: readers access one to the right and one row below."""
    return widest + 2


def _packed_depths(count: int, inverse_depths: Sequence[Float32Array] | None) -> dict[str, Any]:
    """The fields of ``ViewArrays`` that hold depth."""
    size = np.zeros((count, 2), dtype=np.int64)
    maps = [np.zeros((0, 0), dtype=np.float32)] * count
    pooled = maps.copy()
    for view, depth in enumerate(inverse_depths or ()):
        size[view] = depth.shape[1], depth.shape[0]
        maps[view], pooled[view] = depth, _max_pooled(depth)
    return {
        "inverse_depth": _flattened(maps),
        "depth_start": _starts(maps),
        "depth_size": size,
        "pooled_depth": _flattened(pooled),
        "pooled_start": _starts(pooled),
    }


def _max_pooled(depth: Float32Array) -> Float32Array:
    """The largest value of each square of ``POOL_SIDE`` of a depth map."""
    height, width = (-(-side // POOL_SIDE) for side in depth.shape)
    margin = [(0, -side % POOL_SIDE) for side in depth.shape]
    rows = np.pad(depth, margin).reshape(height, POOL_SIDE, width * POOL_SIDE)
    # Column by column of the squares: ten times as fast as one maximum over both axes.
    highest = rows.max(axis=1)
    pooled: Float32Array = highest[:, ::POOL_SIDE].copy()
    for column in range(1, POOL_SIDE):
        np.maximum(pooled, highest[:, column::POOL_SIDE], out=pooled)
    return pooled


def _flattened(parts: Sequence[Float32Array]) -> Float32Array:
    return np.concatenate([part.reshape(-1) for part in parts]).astype(np.float32)


def _starts(parts: Sequence[Float32Array]) -> IntArray:
    """Index of each part's first value when all are flattened into one row."""
    sizes = np.array([part.size for part in parts], dtype=np.int64)
    return np.asarray(np.cumsum(sizes) - sizes)


def with_depth(views: Views, inverse_depths: Sequence[Float32Array]) -> Views:
    """The same photos with other depth maps.

    Args:
        views: the photos.
        inverse_depths: N depth maps ``(h, w)`` of the same fields of view, of any size; 0: unknown.
    """
    packed = _packed_depths(len(views), inverse_depths)
    return Views(views.arrays._replace(**packed), views.intrinsics)


def without_depth(views: Views) -> Views:
    """The same photos as if they had no depth maps."""
    return Views(views.arrays._replace(**_packed_depths(len(views), None)), views.intrinsics)


def without_view(views: Views, index: int) -> Views:
    """The same light field without one of its views."""
    kept = np.arange(len(views)) != index
    arrays = views.arrays
    # Texels and depths are shared; nothing refers to those of the removed view any more.
    fewer = arrays._replace(
        **{
            name: np.ascontiguousarray(getattr(arrays, name)[kept])
            for name in arrays._fields
            if name not in ("texels", "inverse_depth", "pooled_depth")
        }
    )
    return Views(fewer, tuple(k for i, k in enumerate(views.intrinsics) if i != index))


def views_of_scene(
    scene: Scene, largest_side: int | None = None, progress: Progress = no_progress
) -> Views:
    """Decodes and undistorts a scene's photos.

    Args:
        scene: the light field.
        largest_side: photos are area-averaged until their longer side has at most so many pixels;
            None keeps them as recorded.
        progress: shown while decoding.

    Raises:
        OptionError: a side without pixels.
        InputError: a photo cannot be decoded.
    """
    if largest_side is not None:
        checked_number(largest_side, "largest side of photos", 1, whole=True)
    undistorters = [Undistorter(camera) for camera in scene.cameras]

    def view(index: int) -> tuple[ImageArray, Intrinsics]:
        undistorter = undistorters[int(scene.camera_index[index])]
        return shrink(undistorter(scene.image(index)), undistorter.intrinsics, largest_side)

    found = progress(in_threads(view, range(len(scene))), "decode views", len(scene))
    images, intrinsics = zip(*found, strict=True)
    depths = [shrunk_depth(depth.inverse_depth, largest_side) for depth in scene.depth]
    return build_views(images, intrinsics, scene.world_from_camera, depths or None)


def shrunk_depth(inverse_depth: Float32Array, largest_side: int | None) -> Float32Array:
    """A depth map of at most so many pixels a side; no means, since these lie on no surface."""
    height, width = inverse_depth.shape
    size = shrunk_size(width, height, largest_side)
    if size == (width, height):
        return inverse_depth
    resized = cv2.resize(inverse_depth, size, interpolation=cv2.INTER_NEAREST)
    return np.asarray(resized, dtype=np.float32)


def shrink(
    image: ImageArray, intrinsics: Intrinsics, largest_side: int | None
) -> tuple[ImageArray, Intrinsics]:
    """Area-averages an image until its longer side has at most ``largest_side`` pixels."""
    width, height = shrunk_size(intrinsics.width, intrinsics.height, largest_side)
    if (width, height) == (intrinsics.width, intrinsics.height):
        return image, intrinsics
    return area_average(image, width, height), intrinsics.resized(width, height)


def shrunk_size(width: int, height: int, largest_side: int | None) -> tuple[int, int]:
    """Width and height of an image reduced until its longer side has at most so many pixels."""
    longer = max(width, height)
    if largest_side is None or longer <= largest_side:
        return width, height
    scale = largest_side / longer
    return max(1, round(width * scale)), max(1, round(height * scale))


def area_average(image: ImageArray, width: int, height: int) -> ImageArray:
    """The image ``(h, w, 3)`` with each new pixel the mean of the area that it covers."""
    resized = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(resized, dtype=np.uint8)


def pinhole_query(
    image: ImageArray, camera: Camera, undistorter: Undistorter, width: int
) -> tuple[ImageArray, Intrinsics]:
    """A camera image as the comparison takes it: undistorted and area-averaged.

    Args:
        image: ``(height, width, 3)`` RGB as recorded.
        camera: the camera that took it.
        undistorter: of that camera.
        width: of the result, pixels; the height keeps the aspect ratio.

    Returns:
        The image and its pinhole intrinsics.
    """
    intrinsics = query_intrinsics(camera, undistorter, width)
    return area_average(undistorter(image), intrinsics.width, intrinsics.height), intrinsics


def query_intrinsics(camera: Camera, undistorter: Undistorter, width: int) -> Intrinsics:
    """Pinhole intrinsics of ``camera`` at ``width`` pixels, never more than it recorded."""
    width = min(width, camera.width)
    height = max(1, round(camera.height * width / camera.width))
    return undistorter.intrinsics.resized(width, height)


def pyramid_texels(width: int, height: int) -> int:
    """Pixels of all levels of the pyramid of an image of so many pixels."""
    total = width * height
    while min(width, height) >= 2 * SMALLEST_LEVEL_SIDE:
        width, height = (width + 1) // 2, (height + 1) // 2
        total += width * height
    return total


def _pyramid(image: ImageArray) -> list[ImageArray]:
    levels = [image]
    while min(levels[-1].shape[:2]) >= 2 * SMALLEST_LEVEL_SIDE:
        height, width = levels[-1].shape[:2]
        levels.append(area_average(levels[-1], (width + 1) // 2, (height + 1) // 2))
    return levels
