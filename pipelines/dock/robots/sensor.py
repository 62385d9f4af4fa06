"""What a simulated camera does to its images: noise and a gain that wanders."""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.array_types import ImageArray
from pipelines.artifacts.errors import OptionError


@dataclass(frozen=True)
class SensorNoise:
    """Errors of images.

    Attributes:
        noise: standard deviation of each pixel, grey levels.
        gain: the brightness wanders by up to this share.

    Raises:
        OptionError: negative or not finite, or a gain of 1 or more.
    """

    noise: float = 2.0
    gain: float = 0.05

    def __post_init__(self) -> None:
        if not (0.0 <= self.noise <= 255.0 and 0.0 <= self.gain < 1.0):
            raise OptionError(
                f"sensor noise {self.noise:g} is not between 0 and 255, or gain {self.gain:g} not "
                "between 0 and 1"
            )


def as_recorded(image: ImageArray, sensor: SensorNoise, rng: np.random.Generator) -> ImageArray:
    """An exact image ``(H, W, 3)`` as the camera records it."""
    gain = 1.0 + sensor.gain * rng.uniform(-1.0, 1.0)
    noisy = gain * image + sensor.noise * rng.standard_normal(image.shape)
    return np.asarray(np.clip(np.rint(noisy), 0.0, 255.0), dtype=np.uint8)
