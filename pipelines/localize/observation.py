"""The camera image as the filter sees it: undistorted, in several sizes.

What is fixed to the camera is not the scene: dirt on the lens, the robot's own bumper, tape over a
part of the view. Those pixels keep their colours while everything else changes, and after a few
frames they are left out of the comparison (NaN). A bare wall may keep its colours too; nothing is
lost with it, since it tells no place from another. Where a mask says so, pixels are left out from
the first image on, whatever they show.

To weight particles, some of the pixels are enough. A subsampling pattern holds one pixel in a few,
as many of them in every row and column; it is shifted from image to image, so that each pixel is
compared in turn.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np

from pipelines.artifacts.arguments import checked_instance, checked_number
from pipelines.artifacts.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    ImageArray,
    checked_array,
)
from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.dataset.dataset import CAMERA_FILE, Dataset
from pipelines.dataset.mask import SMALLEST_USED_SHARE
from pipelines.geometry.camera import Camera, Intrinsics, Undistorter
from pipelines.lightfield.views import area_average, query_intrinsics
from pipelines.localize.state_space import StateSpace
from pipelines.render.channels import channel_image
from pipelines.render.choices import Channels

# An image whose grey levels differ by less than this (standard deviation) shows nothing: a covered
# lens, a dark room, a burnt-out frame.
SMALLEST_CONTRAST = 4.0
# A pixel that stayed within so many grey levels over so many images is fixed to the camera, if the
# usual pixel changed by more.
FIXED_RANGE, FIXED_IMAGES, USUAL_RANGE = 3.0, 4, 12.0
# More than this is not dirt: the robot stands still in front of something that flickers.
LARGEST_FIXED_SHARE = 0.6
# Less than this is not worth a search.
SMALLEST_FIXED_SHARE = 0.05
# A pixel of which a mask leaves out more than this share is left out.
LARGEST_MASKED_SHARE = 0.01
# Images are the same when less than this share of the colours differs by more than so many levels.
SAME_LEVELS, SAME_SHARE, SAME_WIDTH = 2, 0.005, 160
# Subsampling patterns: one pixel in so many -> columns by which each row is shifted against the
# row above.
SUBSAMPLING_SHIFTS = MappingProxyType({1: 0, 2: 1, 3: 1, 5: 2})
# At least so many pixels are compared, where an image has them.
FEWEST_COMPARED = 240


def subsampling_mask(shape: tuple[int, int], step: int, shift: int, number: int) -> BoolArray:
    """Which pixels ``shape`` a subsampling pattern holds: one in ``step`` of each row.

    Args:
        shape: rows and columns of the image.
        step: columns from one pixel to the next.
        shift: columns by which each row is shifted against the row above.
        number: which of the ``step`` patterns that together hold each pixel once; counted modulo
            ``step``.
    """
    rows, columns = np.indices(shape)
    return np.asarray((columns + shift * rows) % step == number % step)


@functools.lru_cache(maxsize=32)
def _cached_mask(shape: tuple[int, int], step: int, number: int) -> BoolArray:
    """The pixels of one of the filter's patterns; not to be changed."""
    return subsampling_mask(shape, step, SUBSAMPLING_SHIFTS[step], number)


@dataclass(frozen=True)
class Observation:
    """A camera image ready for comparison.

    Attributes:
        image: ``(H, W, 3)`` RGB, undistorted and area-averaged; NaN where it does not show the
            scene.
        intrinsics: of that image.
        number: of the image, counted from the first; it selects the subsampling pattern.
    """

    image: Float32Array
    intrinsics: Intrinsics
    number: int = 0

    @property
    def used(self) -> BoolArray:
        """``(H, W)`` pixels that show the scene."""
        return ~np.isnan(self.image[..., 0])

    @functools.cached_property
    def _cached_channels(self) -> dict[Channels, "Observation"]:
        return {}

    def in_channels(self, channels: Channels) -> "Observation":
        """The same image in other channels; computed once."""
        if channels is Channels.COLOUR:
            return self
        if channels not in self._cached_channels:
            made = channel_image(self.image, channels, self.used)
            made[~self.used] = np.nan
            self._cached_channels[channels] = Observation(made, self.intrinsics, self.number)
        return self._cached_channels[channels]

    def subsampled(self, one_in: int) -> Float32Array:
        """The image ``(H, W, 3)`` with NaN at all pixels that are not compared.

        Args:
            one_in: one in so many pixels is compared, a key of ``SUBSAMPLING_SHIFTS``; more of them
                where fewer than ``FEWEST_COMPARED`` would remain.
        """
        height, width = self.image.shape[:2]
        usable = int(np.count_nonzero(self.used))
        able = [step for step in SUBSAMPLING_SHIFTS if usable >= step * FEWEST_COMPARED]
        step = max((step for step in able if step <= one_in), default=1)
        is_compared = _cached_mask((height, width), step, self.number % step)
        return np.where(is_compared[..., None], self.image, np.float32(np.nan))


@dataclass(frozen=True)
class Observations:
    """One camera image in several sizes.

    Attributes:
        by_width: width in pixels -> the image.
        contrast: standard deviation of the grey levels in the coarsest, without what a mask leaves
            out.
        is_newly_masked: whether so many pixels were found to be fixed to the camera for the first
            time that what was concluded from earlier images may be wrong.
        is_repeated: whether it is the same image as the one before.
        is_stale: whether it is the same although the body has moved: the camera hangs.
        recorded: ``(height, width, 3)`` the image as recorded; None: not known.
    """

    by_width: Mapping[int, Observation]
    contrast: float
    is_newly_masked: bool = False
    is_repeated: bool = False
    is_stale: bool = False
    recorded: ImageArray | None = None

    def widths_from(self, least: int) -> list[int]:
        """The widths of at least so many pixels, rising."""
        return sorted(width for width in self.by_width if width >= least)

    @property
    def is_informative(self) -> bool:
        """Whether the image says anything about where the body is now."""
        return not (self.is_blind or self.is_stale)

    @property
    def is_blind(self) -> bool:
        """Whether the image shows nothing that could tell one place from another."""
        return self.contrast < SMALLEST_CONTRAST


class Observer:
    """Prepares the images of one camera, one after the other.

    Args:
        camera: the robot's.
        widths: of the images wanted, pixels; never more than the camera has.
        mask: ``(height, width)``, True where images as recorded are to be used; None: everywhere.

    Raises:
        OptionError: a mask of another size than the camera, one that leaves next to nothing, widths
            that are no whole numbers of at least 1, or a camera of another type.
    """

    def __init__(
        self, camera: Camera, widths: Sequence[int], mask: BoolArray | None = None
    ) -> None:
        self._undistorter = Undistorter(checked_instance(camera, "the camera", Camera))
        given: object = widths
        if not isinstance(given, Sequence) or not given:
            raise OptionError(f"widths {quoted(widths)} are no list of widths in pixels")
        for width in widths:
            checked_number(width, "width", 1, whole=True)
        self._intrinsics = {
            width: query_intrinsics(camera, self._undistorter, width) for width in set(widths)
        }
        self._used = {
            width: _used_pixels(mask, self._undistorter, pinhole)
            for width, pinhole in self._intrinsics.items()
        }
        self._lowest: Float32Array | None = None
        self._highest: Float32Array | None = None
        self._images = 0
        self._number = 0
        self._fixed_share = 0.0
        self._last: ImageArray | None = None

    def __call__(self, image: ImageArray) -> Observations:
        """The sizes of one image.

        Args:
            image: ``(height, width, 3)`` RGB, 8 bits, as recorded (not undistorted).

        Raises:
            OptionError: no image of 8 bits of the camera's size.
        """
        image = checked_array(image, "image", (None, None, 3), np.uint8)
        # First, since it refuses what is no image of this camera.
        straight = self._undistorter(image)
        is_repeated = self._last is not None and is_same(image, self._last)
        # A copy: a camera may fill one array again and again.
        self._last = image.copy()
        sizes = {
            width: area_average(straight, pinhole.width, pinhole.height).astype(np.float32)
            for width, pinhole in self._intrinsics.items()
        }
        coarsest, used = sizes[min(sizes)], self._used[min(sizes)]
        contrast = float(np.std(coarsest.mean(axis=2)[used]))
        is_newly_masked = False
        if contrast >= SMALLEST_CONTRAST and not is_repeated:
            fixed = self._fixed(coarsest, used)
            share = float(fixed[used].mean())
            is_newly_masked = share >= SMALLEST_FIXED_SHARE > self._fixed_share
            self._fixed_share = max(self._fixed_share, share)
            for small in sizes.values():
                height, width = small.shape[:2]
                small[cv2.resize(fixed.astype(np.float32), (width, height)) > 0.01] = np.nan
        for width, small in sizes.items():
            small[~self._used[width]] = np.nan
        by_width = {
            width: Observation(small, self._intrinsics[width], self._number)
            for width, small in sizes.items()
        }
        self._number += 1
        return Observations(by_width, contrast, is_newly_masked, is_repeated, recorded=self._last)

    def _fixed(self, image: Float32Array, used: BoolArray) -> BoolArray:
        """Pixels ``(H, W)``, among the used ones, that kept their colours in all images so far."""
        if self._lowest is None or self._highest is None:
            self._lowest = self._highest = image
        self._lowest = np.minimum(self._lowest, image)
        self._highest = np.maximum(self._highest, image)
        self._images += 1
        ranges = (self._highest - self._lowest).max(axis=2)
        fixed = np.asarray((ranges <= FIXED_RANGE) & used, dtype=np.bool_)
        is_moving = self._images >= FIXED_IMAGES and float(np.median(ranges[used])) >= USUAL_RANGE
        if not is_moving or float(fixed[used].mean()) > LARGEST_FIXED_SHARE:
            return np.zeros_like(fixed)
        return fixed


def is_same(image: ImageArray, before: ImageArray) -> bool:
    """Whether two images as recorded are one: a sensor's noise alone would tell two apart."""
    if image.shape != before.shape:
        return False
    # Every few pixels of every few rows of a large image tell as much as all.
    stride = max(1, image.shape[1] // SAME_WIDTH)
    part = np.s_[::stride, ::stride]
    difference = cv2.absdiff(np.ascontiguousarray(image[part]), np.ascontiguousarray(before[part]))
    return int(np.count_nonzero(difference > SAME_LEVELS)) < SAME_SHARE * difference.size


def check_mask(mask: BoolArray, camera: Camera) -> None:
    """Refuses a mask that has not a pixel for each of the camera's.

    Raises:
        OptionError: it has another shape.
    """
    mask = checked_array(mask, "the mask", (...,), np.bool_)
    if mask.shape != (camera.height, camera.width):
        raise OptionError(
            f"the mask has the shape {mask.shape}, "
            f"images of the camera have {(camera.height, camera.width)}"
        )


def _used_pixels(
    mask: BoolArray | None, undistorter: Undistorter, pinhole: Intrinsics
) -> BoolArray:
    """Pixels ``(H, W)`` of the undistorted and averaged image that a mask lets be used."""
    if mask is None:
        return np.ones((pinhole.height, pinhole.width), dtype=np.bool_)
    check_mask(mask, undistorter.camera)
    straight = undistorter(np.where(mask, np.uint8(0), np.uint8(255)))
    size = (pinhole.width, pinhole.height)
    shares = cv2.resize(straight.astype(np.float32), size, interpolation=cv2.INTER_AREA) / 255.0
    used = np.asarray(shares <= LARGEST_MASKED_SHARE, dtype=np.bool_)
    if float(used.mean()) < SMALLEST_USED_SHARE:
        raise OptionError(
            f"the mask leaves {used.mean():.1%} of the undistorted image at {pinhole.width} pixels "
            f"across, less than {SMALLEST_USED_SHARE:.0%}; mask coherent areas and fewer of them"
        )
    return used


def camera_and_mount(dataset: Dataset, space: StateSpace) -> tuple[Camera, FloatArray]:
    """The camera of a data set, and ``body_from_camera``, ``(4, 4)``.

    Args:
        dataset: what was recorded.
        space: what a state is; with six degrees of freedom the camera may be the body.

    Raises:
        InputError: the data set does not say.
        OptionError: no data set.
    """
    checked_instance(dataset, "the data set", Dataset)
    if dataset.camera is None:
        raise InputError(
            dataset.root / CAMERA_FILE, "is missing: localization needs the robot's camera"
        )
    if dataset.base_from_camera is None and space.angles == 3:
        return dataset.camera, np.eye(4)
    if dataset.base_from_camera is None:
        raise InputError(
            dataset.root / CAMERA_FILE,
            "has no [mount]: a planar robot needs to know where its camera sits",
            "add [mount] with x, y, z, roll, pitch, yaw, or give "
            "--degrees-of-freedom 6 for a hand-held camera",
        )
    return dataset.camera, dataset.base_from_camera
