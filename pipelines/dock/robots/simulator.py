"""``sim:SCENE.xml``: a simulated robot in a Mitsuba scene, with path-traced camera images.

The scene holds geometry, materials, light and an integrator; the sensor is added here. No GPU is
needed. Mitsuba's variant ``llvm_ad_rgb`` is two to three times as fast as ``scalar_rgb`` and needs
the library LLVM. The two draw different random numbers, so that their images differ in noise.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipelines.artifacts.arrays import Float32Array, FloatArray, ImageArray
from pipelines.artifacts.errors import InputError, OptionError, StageError, quoted
from pipelines.dock.robots.noise import SensorNoise, SimulatedMotion, SimulatedRobot, as_recorded
from pipelines.geometry.camera import Camera, Intrinsics

# Mitsuba's variants from fast to slow; the last one always works.
VARIANTS = ("llvm_ad_rgb", "scalar_rgb")
FASTEST = "fastest"
INSTALL = "pip install 'lfnav[sim]'"
# Mitsuba's camera looks along z with x to the left and y up.
CAMERA_FROM_MITSUBA = np.diag([-1.0, -1.0, 1.0, 1.0])
# Radiance is clipped at this: beyond it are fireflies of the path tracer, not lamps.
LARGEST_RADIANCE = 30.0
# Strength, patch and window of non-local means, which models the camera's own noise reduction.
DENOISING, PATCH, WINDOW = 12.0, 3, 11


@dataclass(frozen=True)
class PathTracing:
    """How images are rendered.

    Attributes:
        samples: number of paths a pixel.
        denoise: whether the path tracer's noise is smoothed.
        variant: Mitsuba's variant; ``fastest``: the first of ``VARIANTS`` that loads.

    Raises:
        OptionError: no samples, or an unknown variant.
    """

    samples: int = 16
    denoise: bool = True
    variant: str = FASTEST

    def __post_init__(self) -> None:
        if not 1 <= self.samples <= 65536:
            raise OptionError(f"{self.samples} samples a pixel are not between 1 and 65536")
        if self.variant not in (FASTEST, *VARIANTS):
            raise OptionError(
                f"variant {quoted(self.variant)} is none of {', '.join((FASTEST, *VARIANTS))}"
            )


class SimulatorRobot(SimulatedRobot):
    """A robot whose camera images are path-traced.

    Args:
        path: the Mitsuba scene.
        camera: without distortion.
        base_from_camera: ``(4, 4)`` the camera's mount.
        motion: the robot's true pose, and its errors of movements and odometry.
        sensor: errors of its images.
        tracing: how images are rendered.
        rng: the random numbers of its images, paths included.

    Raises:
        StageError: Mitsuba is not installed, or its variant does not load.
        InputError: the scene does not load.
        OptionError: a camera with distortion.
    """

    def __init__(
        self,
        path: Path,
        camera: Camera,
        base_from_camera: FloatArray,
        motion: SimulatedMotion,
        sensor: SensorNoise,
        tracing: PathTracing,
        rng: np.random.Generator,
    ) -> None:
        if camera.has_distortion:
            raise OptionError(
                "the simulator's camera has no lens distortion; give a PINHOLE camera"
            )
        super().__init__(camera, base_from_camera, motion, sensor, rng)
        self._mitsuba = imported_mitsuba(tracing.variant)
        self._variant = str(self._mitsuba.variant())
        self.note = f"path-traced, {self._variant}, {tracing.samples} paths a pixel"
        self._scene = _loaded(self._mitsuba, path)
        self._tracing = tracing

    def take_image(self) -> ImageArray:
        """The view at the true pose, ``(H, W, 3)`` RGB."""
        # The variant is a setting of the process; another robot may have changed it.
        self._mitsuba.set_variant(self._variant)
        pose, intrinsics = self._world_from_camera, self.camera.intrinsics
        sensor = _sensor(self._mitsuba, pose, intrinsics, self._tracing.samples)
        rendered = self._mitsuba.render(
            self._scene,
            sensor=sensor,
            spp=self._tracing.samples,
            seed=int(self._rng.integers(2**31)),
        )
        image = developed(np.asarray(rendered, dtype=np.float32)[..., :3])
        if self._tracing.denoise:
            image = _denoised(image)
        return as_recorded(image, self._sensor, self._rng)


def imported_mitsuba(variant: str = FASTEST) -> Any:
    """The module ``mitsuba``, set to a variant.

    Args:
        variant: one of ``VARIANTS``, or ``FASTEST``: the first of them that loads.

    Raises:
        StageError: it is not installed, or the variant does not load.
    """
    try:
        # Mitsuba's C++ part writes to the terminal where LLVM is missing.
        with _silent_stderr():
            import mitsuba
    except ImportError as error:
        raise StageError(
            f"robots of the kind sim: need Mitsuba, which is not installed; {INSTALL}"
        ) from error
    wanted = VARIANTS if variant == FASTEST else (variant,)
    loads = [name for name in wanted if _does_load(mitsuba, name)]
    if not loads:
        raise StageError(
            f"Mitsuba's variant {variant} does not load; {_REMEDIES.get(variant, INSTALL)}"
        )
    mitsuba.set_variant(loads[0])
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


_REMEDIES = {
    "llvm_ad_rgb": "install the library LLVM (Debian: libllvm19) or set DRJIT_LIBLLVM_PATH to it"
}


def _does_load(mitsuba: Any, variant: str) -> bool:
    """Whether a variant is installed, with the library that it needs."""
    if variant not in mitsuba.variants():
        return False
    if not variant.startswith("llvm"):
        return True
    import drjit

    return bool(drjit.has_backend(drjit.JitBackend.LLVM))


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Discards what a library writes to the file descriptor of standard error."""
    terminal, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(terminal, 2)
        os.close(terminal)
        os.close(nowhere)


def developed(radiance: Float32Array) -> ImageArray:
    """An image ``(H, W, 3)`` from linear radiance, by the response curve of the sample photos.

    x = L (1 + L / 9) / (1 + L) * 1.35 (Reinhard et al. 2002, equation 4, white point 3), clipped,
    then the sRGB curve.
    """
    light = np.clip(np.nan_to_num(radiance.astype(np.float64)), 0.0, LARGEST_RADIANCE)
    linear = np.clip(light * (1.0 + light / 9.0) / (1.0 + light) * 1.35, 0.0, 1.0)
    curved = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )
    return np.asarray(np.rint(255.0 * curved), dtype=np.uint8)


def _denoised(image: ImageArray) -> ImageArray:
    """An image ``(H, W, 3)`` smoothed by non-local means."""
    smooth = cv2.fastNlMeansDenoisingColored(image, None, DENOISING, DENOISING, PATCH, WINDOW)
    return np.asarray(smooth, dtype=np.uint8)


def _loaded(mitsuba: Any, path: Path) -> Any:
    """A Mitsuba scene.

    Raises:
        InputError: the scene does not load.
    """
    if not path.is_file():
        raise InputError(path, "does not exist")
    try:
        return mitsuba.load_file(str(path.resolve()))
    except Exception as error:
        # Mitsuba raises RuntimeError and others, with messages of several lines.
        reason = " ".join(str(error).split())[:200]
        raise InputError(path, f"is no scene that Mitsuba can load ({reason})") from error


def _sensor(mitsuba: Any, pose: FloatArray, pinhole: Intrinsics, samples: int) -> Any:
    """A Mitsuba sensor.

    Args:
        mitsuba: the module.
        pose: ``(4, 4)`` world_from_camera.
        pinhole: intrinsics of the camera.
        samples: number of paths a pixel.
    """
    fov = np.degrees(2.0 * np.arctan2(pinhole.width / 2.0, pinhole.fx))
    return mitsuba.load_dict(
        {
            "type": "perspective",
            "fov": float(fov),
            "fov_axis": "x",
            "near_clip": 0.01,
            "far_clip": 1000.0,
            "principal_point_offset_x": (pinhole.cx + 0.5) / pinhole.width - 0.5,
            "principal_point_offset_y": (pinhole.cy + 0.5) / pinhole.height - 0.5,
            "to_world": mitsuba.ScalarTransform4f(pose @ CAMERA_FROM_MITSUBA),
            "film": {
                "type": "hdrfilm",
                "width": pinhole.width,
                "height": pinhole.height,
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent", "sample_count": samples},
        }
    )
