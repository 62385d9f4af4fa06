"""Stereo depth: the depth map of a view from it and its neighbours.

A plane sweep (Collins 1996): the neighbouring photos are warped as if the scene were a plane at one
of many inverse depths, and compared with the view in windows of 3 x 3 pixels, less the grey of
their centres, so that exposure does not matter. Larger windows were worse on every scene tried: the
aggregation along paths takes in the surroundings without blurring edges. At each pixel only the
best neighbours count, since the others may not see the point. Semi-global matching
(Hirschmueller 2008) then finds depths that are smooth except across edges of the image. When all
views are done, ``depth_filtering`` makes them agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from pipelines.artifacts.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    ImageArray,
    IntArray,
)
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import inverse
from pipelines.lightfield.stereo_neighbours import checked_range
from pipelines.lightfield.views import shrink
from pipelines.native import plane_sweep, semi_global_matching

MEDIAN_SIZE = 5
# Side of the window, in pixels, over which the distinctness of depths is averaged.
DISTINCTNESS_SIZE = 7


@dataclass(frozen=True)
class DepthSettings:
    """How depth maps are computed.

    Attributes:
        largest_side: photos are reduced to this longer side, pixels.
        planes: number of inverse depths of the sweep.
        neighbours: the most photos that a view is compared with.
        best: how many of these count at each pixel: those that agree best.
        saturation: grey levels; larger differences all cost the same.
        step_penalty, jump_penalty: cost of neighbouring pixels that lie one plane apart, or more.
        edge_contrast: grey levels between neighbouring pixels at which a jump costs half.
        distinctness: by how much the chosen plane's cost (of 240) must lie below the average one's
            before a depth is called confident.
        agreement: share of the inverse depth by which depths of the same point may differ.
        supporters: neighbours that must agree before a depth is called confident.

    Raises:
        OptionError: a value is out of its range.
    """

    largest_side: int = 480
    planes: int = 128
    neighbours: int = 8
    best: int = 2
    saturation: float = 20.0
    step_penalty: float = 6.0
    jump_penalty: float = 110.0
    edge_contrast: float = 10.0
    distinctness: float = 8.0
    agreement: float = 0.02
    supporters: int = 2

    def __post_init__(self) -> None:
        if self.largest_side < 16:
            raise OptionError(f"depth of {self.largest_side} pixels is too small; at least 16")
        if not 8 <= self.planes <= 1024:
            raise OptionError(f"{self.planes} depth planes are not between 8 and 1024")
        if self.neighbours < 1 or self.best < 1 or self.supporters < 1:
            raise OptionError("depth needs at least one neighbour")
        if not 0.0 < self.agreement < 1.0:
            raise OptionError(f"agreement {self.agreement:g} is not between 0 and 1")


@dataclass(frozen=True)
class DepthMap:
    """Depth at each pixel of one view.

    Attributes:
        inverse_depth: ``(H, W)`` float32, 1 / metres along the camera's z axis;
            positive everywhere.
        confident: ``(H, W)`` where the photos single out this depth, and after ``fuse_depth`` where
            neighbouring views found the same.
        intrinsics: of the pinhole image with these pixels.
    """

    inverse_depth: Float32Array
    confident: BoolArray
    intrinsics: Intrinsics


def estimate_depth(
    images: Sequence[ImageArray],
    intrinsics: Sequence[Intrinsics],
    world_from_camera: FloatArray,
    view: int,
    neighbours: IntArray,
    limits: tuple[float, float],
    settings: DepthSettings,
) -> DepthMap:
    """The depth map of one view, from it and its neighbours alone.

    Args:
        images: the N pinhole photos, ``(h, w, 3)`` RGB, or as ``working_photo`` makes them.
        intrinsics: of each.
        world_from_camera: ``(N, 4, 4)``.
        view: index of the view.
        neighbours: indices of the views to compare it with.
        limits: nearest and farthest depth, metres.
        settings: of the plane sweep and the matching.

    Raises:
        StageError: fewer than two photos, or no neighbour.
        OptionError: the limits are no range.
    """
    near, far = checked_range(*limits)
    if len(images) < 2 or len(neighbours) == 0:
        raise StageError(f"view {view} has no neighbouring photo to find depth with")
    side = settings.largest_side
    reference, pinhole = working_photo(images[view], intrinsics[view], side)
    photos, transfers = [], []
    for other in neighbours:
        photo, own = working_photo(images[other], intrinsics[other], side)
        photos.append(photo)
        transfers.append(
            pixel_transfer(pinhole, world_from_camera[view], own, world_from_camera[other])
        )
    levels = np.linspace(1.0 / far, 1.0 / near, settings.planes)
    index, distinct = semi_global_matching(
        plane_sweep(
            reference, photos, np.stack(transfers), levels, settings.best, settings.saturation
        ),
        reference,
        settings.step_penalty,
        settings.jump_penalty,
        settings.edge_contrast,
        # A jump is never cheaper than two steps.
        2.0 * settings.step_penalty,
    )
    confident = cv2.blur(distinct, (DISTINCTNESS_SIZE, DISTINCTNESS_SIZE)) >= settings.distinctness
    inverse_depth = np.interp(index, np.arange(settings.planes), levels).astype(np.float32)
    smooth = np.asarray(cv2.medianBlur(inverse_depth, MEDIAN_SIZE), dtype=np.float32)
    return DepthMap(smooth, np.asarray(confident, dtype=np.bool_), pinhole)


def working_photo(
    image: ImageArray, intrinsics: Intrinsics, largest_side: int
) -> tuple[ImageArray, Intrinsics]:
    """What the sweep takes of a photo.

    Args:
        image: ``(h, w, 3)`` RGB, or ``(h, w)``: what this function made of one.
        intrinsics: of the pinhole photo.
        largest_side: it is reduced to this longer side, pixels.

    Returns:
        Brightness ``(H, W)``, and its intrinsics.
    """
    small, pinhole = shrink(image, intrinsics, largest_side)
    if small.ndim == 2:
        return small, pinhole
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), dtype=np.uint8), pinhole


def pixel_transfer(
    pinhole: Intrinsics,
    world_from_camera: FloatArray,
    other: Intrinsics,
    world_from_other: FloatArray,
) -> FloatArray:
    """The transfer of pixels, with their inverse depths, from one camera to another.

    Args:
        pinhole: intrinsics of the first camera.
        world_from_camera: ``(4, 4)`` its pose.
        other: intrinsics of the second camera.
        world_from_other: ``(4, 4)`` its pose.

    Returns:
        ``(3, 4)`` matrix M: pixel (x, y) at inverse depth q lies at the homogeneous pixel
        M (x, y, 1, q). Its first three columns are the infinite homography, the last the epipole.
    """
    other_from_camera = inverse(world_from_other) @ world_from_camera
    rays = other_from_camera[:3, :3] @ np.linalg.inv(pinhole.matrix())
    return np.asarray(other.matrix() @ np.column_stack([rays, other_from_camera[:3, 3]]))
