"""Is the camera's picture mirrored, upside down, or negative?

A driver may flip the picture, or the camera may be mounted upside down. Half of such an image fits
the map (the doors of a lobby are as wide seen in a mirror), and a robot that believes it drives to
the wrong side. While the filter searches, each image is therefore also searched for as it would be
without each fault. A fault that explains the images better, again and again, becomes probable.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from pipelines.artifacts.arrays import Float32Array
from pipelines.localize.observation import Observation, Observations
from pipelines.localize.places import compressed

Change = Callable[[Float32Array], Float32Array]
# Fault of a picture -> what it does to an image.
FAULTS: Mapping[str, Change] = MappingProxyType(
    {
        "mirrored": lambda image: image[:, ::-1],
        "upside down": lambda image: image[::-1, ::-1],
        "mirrored and upside down": lambda image: image[::-1],
        "negative": lambda image: np.float32(255.0) - image,
    }
)
# Natural logarithm of the odds of each fault before the first image, and its largest size.
FIRST_LOG_ODDS, MOST_LOG_ODDS = -4.0, 8.0


@dataclass(frozen=True)
class CameraFaults:
    """How probable each fault is.

    Attributes:
        log_odds: name of the fault -> logarithm of its odds against a picture without fault.
    """

    log_odds: Mapping[str, float] = field(
        default_factory=lambda: dict.fromkeys(FAULTS, FIRST_LOG_ODDS)
    )

    @property
    def none(self) -> float:
        """Probability that the picture has no fault."""
        return float(1.0 / (1.0 + np.sum(np.exp(list(self.log_odds.values())))))

    @property
    def likeliest(self) -> str:
        """The most probable fault."""
        return max(self.log_odds, key=lambda name: self.log_odds[name])

    def updated(
        self, evidence: Callable[[Observations], float], observations: Observations
    ) -> "CameraFaults":
        """After one more image.

        Args:
            evidence: the largest evidence of an image for any state of the map.
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
