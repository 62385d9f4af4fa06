"""Camera models and pinhole intrinsics.

Pixel centres lie at integer coordinates, as in OpenCV: the top-left pixel's centre is (0, 0) and
an image covers [-0.5, width - 0.5]. Camera models and the order of their parameters are COLMAP's.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from pipelines.artifacts.arguments import checked_instance, checked_number
from pipelines.artifacts.arrays import Float32Array, FloatArray, ImageArray, checked_array
from pipelines.artifacts.errors import OptionError, quoted

# Pixels: what is larger is no camera, and its square is no number.
LARGEST_NUMBER = 1e12

# COLMAP's model name -> names of its parameters, in order.
CAMERA_MODELS: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
}


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion.

    Pixel centres lie at integer coordinates; the camera's axes are OpenCV's: x right, y down, z
    forward.

    Attributes:
        width, height: of its images, pixels.
        fx, fy: focal lengths, pixels.
        cx, cy: the principal point, pixels.

    Raises:
        OptionError: sizes or focal lengths that are not positive, or numbers that are not finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        checked_number(self.width, "image width", 1, whole=True)
        checked_number(self.height, "image height", 1, whole=True)
        for name in ("fx", "fy", "cx", "cy"):
            value = getattr(self, name)
            checked_number(value, name, -LARGEST_NUMBER, LARGEST_NUMBER)
            if name.startswith("f") and value <= 0.0:
                raise OptionError(f"focal length {name} = {value:g} is not positive")

    def matrix(self) -> FloatArray:
        """The ``(3, 3)`` calibration matrix: camera coordinates to homogeneous pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def rays(self, columns: FloatArray, rows: FloatArray) -> FloatArray:
        """The directions in which pixels look.

        Args:
            columns: ``(...)`` of the pixels, centres at integers.
            rows: ``(...)`` of the pixels.

        Returns:
            ``(..., 3)`` camera coordinates, with z = 1.
        """
        x, y = (columns - self.cx) / self.fx, (rows - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def vector(self) -> FloatArray:
        """``(4,)``: fx, fy, cx, cy."""
        return np.array([self.fx, self.fy, self.cx, self.cy])

    def resized(self, width: int, height: int) -> "Intrinsics":
        """Intrinsics of the same image area-averaged to another size.

        Args:
            width, height: pixels.

        Raises:
            OptionError: not whole numbers of at least 1.
        """
        checked_number(width, "image width", 1, whole=True)
        checked_number(height, "image height", 1, whole=True)
        scale_x, scale_y = width / self.width, height / self.height
        return Intrinsics(
            width,
            height,
            self.fx * scale_x,
            self.fy * scale_y,
            (self.cx + 0.5) * scale_x - 0.5,
            (self.cy + 0.5) * scale_y - 0.5,
        )


@dataclass(frozen=True)
class Camera:
    """A camera as COLMAP describes it (Schonberger and Frahm 2016); its axes are OpenCV's.

    Attributes:
        model: SIMPLE_PINHOLE (f, cx, cy), PINHOLE (fx, fy, cx, cy), SIMPLE_RADIAL (f, cx, cy, k),
            RADIAL (f, cx, cy, k1, k2), OPENCV (fx, fy, cx, cy, k1, k2, p1, p2), FULL_OPENCV (these
            and k3, k4, k5, k6), or OPENCV_FISHEYE (fx, fy, cx, cy, k1, k2, k3, k4).
        width, height: of its images, pixels.
        params: focal lengths, principal point and distortion, in the order above: pixels, with
            pixel centres at integers, and numbers without a unit.

    Raises:
        OptionError: unknown model, wrong number of parameters, a size or focal length that is not
            positive, or parameters that are not finite.
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        checked_instance(self.model, "camera model", str)
        if self.model not in CAMERA_MODELS:
            known = ", ".join(CAMERA_MODELS)
            raise OptionError(f"unknown camera model {quoted(self.model)}; known are {known}")
        names = CAMERA_MODELS[self.model]
        checked_number(self.width, "image width", whole=True)
        checked_number(self.height, "image height", whole=True)
        checked_array(self.params, "camera params", (None,), finite=False)
        if len(self.params) != len(names):
            raise OptionError(
                f"camera model {self.model} takes {len(names)} params ({', '.join(names)}), "
                f"got {len(self.params)}"
            )
        if self.width < 1 or self.height < 1:
            raise OptionError(f"camera size {self.width}x{self.height} is not positive")
        if not all(np.isfinite(self.params)):
            raise OptionError("camera params are not all finite")
        for name, value in zip(names, self.params, strict=True):
            if name.startswith("f") and value <= 0.0:
                raise OptionError(f"focal length {name} = {value:g} is not positive")

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types: what ``camera_from_dict`` reads back."""
        return {
            "model": self.model,
            "width": self.width,
            "height": self.height,
            "params": list(self.params),
        }

    def _named(self) -> dict[str, float]:
        return dict(zip(CAMERA_MODELS[self.model], self.params, strict=True))

    @property
    def intrinsics(self) -> Intrinsics:
        """The pinhole part of the model, distortion ignored."""
        named = self._named()
        fx = named.get("fx", named.get("f", 0.0))
        fy = named.get("fy", named.get("f", 0.0))
        return Intrinsics(self.width, self.height, fx, fy, named["cx"], named["cy"])

    @property
    def distortion(self) -> FloatArray:
        """OpenCV's distortion coefficients: ``(8,)`` k1 k2 p1 p2 k3 k4 k5 k6, fisheye ``(4,)``."""
        named = self._named()
        if self.model == "OPENCV_FISHEYE":
            return np.array([named[k] for k in ("k1", "k2", "k3", "k4")])
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        coefficients = np.array([named.get(name, 0.0) for name in names])
        if "k" in named:
            coefficients[0] = named["k"]
        return coefficients

    @property
    def has_distortion(self) -> bool:
        """Whether an image has to be resampled before it is a pinhole image."""
        # A fisheye with zero coefficients is still equidistant, not a pinhole.
        return self.model == "OPENCV_FISHEYE" or bool(np.any(self.distortion != 0.0))

    def rays(self, pixels: FloatArray) -> FloatArray:
        """The directions in which pixels look.

        Args:
            pixels: ``(N, 2)`` column and row, centres at integers, as recorded (not undistorted).

        Returns:
            ``(N, 3)`` camera coordinates, with z = 1.

        Raises:
            OptionError: no array of this shape.
        """
        pixels = checked_array(pixels, "pixels", (None, 2), finite=False)
        if len(pixels) == 0:
            return np.empty((0, 3))
        matrix, coefficients = self.intrinsics.matrix(), self.distortion
        if self.model == "OPENCV_FISHEYE":
            flat = cv2.fisheye.undistortPoints(pixels[:, None], matrix, coefficients)
        else:
            flat = cv2.undistortPoints(pixels[:, None], matrix, coefficients)
        return np.column_stack([np.asarray(flat, np.float64)[:, 0], np.ones(len(pixels))])


def camera_from_dict(fields: Mapping[str, Any]) -> Camera:
    """The camera of ``Camera.to_dict``, from a file that is not trusted.

    Raises:
        KeyError, TypeError, ValueError, OverflowError: fields that are missing or no such values.
        OptionError: values that no camera has.
    """
    return Camera(
        str(fields["model"]),
        int(fields["width"]),
        int(fields["height"]),
        tuple(float(value) for value in fields["params"]),
    )


def cameras_text(cameras: Sequence[Camera]) -> str:
    """Models and sizes for people, equal ones counted: ``"81 x PINHOLE 384x384"``."""
    counts = Counter(f"{camera.model} {camera.width}x{camera.height}" for camera in cameras)
    return ", ".join(text if count == 1 else f"{count} x {text}" for text, count in counts.items())


class Undistorter:
    """Resamples images of one camera so that they obey a pinhole model.

    The pinhole's field of view is the largest rectangle that lies wholly inside the image, so
    that no pixel of the result is extrapolated.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self._maps: tuple[Float32Array, Float32Array] | None = None
        if not camera.has_distortion:
            self.intrinsics = camera.intrinsics
            return
        size = (camera.width, camera.height)
        matrix, coefficients = camera.intrinsics.matrix(), camera.distortion
        if camera.model == "OPENCV_FISHEYE":
            new_matrix = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(
                matrix, coefficients, size, np.eye(3), balance=0.0
            )
            maps = cv2.fisheye.initUndistortRectifyMap(
                matrix, coefficients, np.eye(3), new_matrix, size, cv2.CV_32FC1
            )
        else:
            new_matrix, _ = cv2.getOptimalNewCameraMatrix(matrix, coefficients, size, 0.0)
            maps = cv2.initUndistortRectifyMap(
                matrix, coefficients, np.eye(3), new_matrix, size, cv2.CV_32FC1
            )
        self._maps = (
            np.asarray(maps[0], dtype=np.float32),
            np.asarray(maps[1], dtype=np.float32),
        )
        self.intrinsics = Intrinsics(
            camera.width,
            camera.height,
            float(new_matrix[0, 0]),
            float(new_matrix[1, 1]),
            float(new_matrix[0, 2]),
            float(new_matrix[1, 2]),
        )

    def __call__(self, image: ImageArray) -> ImageArray:
        """The pinhole image, ``(height, width, channels)``, of a recorded image of that shape.

        Raises:
            OptionError: the image has another size than the camera.
        """
        if image.shape[:2] != (self.camera.height, self.camera.width):
            raise OptionError(
                f"image is {image.shape[1]}x{image.shape[0]}, "
                f"its camera {self.camera.width}x{self.camera.height}"
            )
        if self._maps is None:
            return image
        # Without a border mode of its own, pixels at the rim would mix with black.
        return np.asarray(
            cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
            dtype=np.uint8,
        )

    def nearest(self, values: Float32Array) -> Float32Array:
        """Resamples an ``(height, width)`` array by nearest neighbour, without taking means."""
        if self._maps is None:
            return values
        resampled = cv2.remap(values, *self._maps, cv2.INTER_NEAREST, borderValue=0.0)
        return np.asarray(resampled, dtype=np.float32)
