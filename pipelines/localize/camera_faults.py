"""Is the camera's picture mirrored, upside down, or negative?

A driver that flips the picture, a camera mounted the other way round: half of such an image fits
the map (the doors of a lobby are as wide seen in a mirror), and a robot that believes it drives to
the wrong side. While the filter searches, each image is therefore looked up the other ways round
too. Where one of them explains the images better, again and again, the map is not what this camera
sees as it is.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from pipelines.artifacts.arrays import Float32Array
from pipelines.localize.observation import Observation, Observations
from pipelines.localize.places import compressed

Change = Callable[[Float32Array], Float32Array]
# What can be wrong with a picture.
FAULTS: Mapping[str, Change] = MappingProxyType(
    {
        "mirrored": lambda image: image[:, ::-1],
        "upside down": lambda image: image[::-1, ::-1],
        "mirrored and upside down": lambda image: image[::-1],
        "negative": lambda image: np.float32(255.0) - image,
    }
)
# Natural logarithm of the odds of each before the first image, and how far they can go.
FIRST_LOG_ODDS, MOST_LOG_ODDS = -4.0, 8.0


@dataclass(frozen=True)
class CameraFaults:
    """What speaks for each fault.

    Attributes:
        log_odds: by the name of the fault, against a picture as it should be.
    """

    log_odds: Mapping[str, float] = field(
        default_factory=lambda: dict.fromkeys(FAULTS, FIRST_LOG_ODDS)
    )

    @property
    def none(self) -> float:
        """Probability that the picture is as it should be."""
        return float(1.0 / (1.0 + np.sum(np.exp(list(self.log_odds.values())))))

    @property
    def likeliest(self) -> str:
        """The fault that most speaks for."""
        return max(self.log_odds, key=lambda name: self.log_odds[name])

    def updated(
        self, evidence: Callable[[Observations], float], observations: Observations
    ) -> "CameraFaults":
        """After one more image.

        Args:
            evidence: the most that the map says for an image anywhere.
            observations: the image.
        """
        usual = float(compressed(max(evidence(observations), 0.0)))
        log_odds = {}
        for name, change in FAULTS.items():
            other = float(compressed(max(evidence(_changed(observations, change)), 0.0)))
            sum_ = self.log_odds[name] + other - usual
            log_odds[name] = min(max(sum_, -MOST_LOG_ODDS), MOST_LOG_ODDS)
        return CameraFaults(log_odds)


def _changed(observations: Observations, change: Change) -> Observations:
    by_width = {
        width: Observation(np.ascontiguousarray(change(own.image)), own.intrinsics, own.number)
        for width, own in observations.by_width.items()
    }
    return Observations(by_width, observations.contrast)
