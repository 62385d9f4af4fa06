"""The hypothesis that the camera sees nothing that the map shows.

Beside all poses in the map stands "outside": another room, a wall of people, a picture of something
else. An image's evidence for it is 0, by the definition of evidence. Each image changes the odds of
being inside by what it says, averaged over the prior of the poses: the marginal likelihood of the
filter. From one image to the next a robot may leave the map, or come back into what it shows. An
image that is explained much less than usual is no proof of a place either (``Usual``).
"""

import math
from dataclasses import dataclass, replace

# Probability that the next image does not show the map although this one does, and the reverse.
LEAVING, RETURNING = 0.01, 0.05
# Before the first image.
FIRST_INSIDE = 0.5
# How fast what is usual follows.
RATE = 0.2


@dataclass(frozen=True)
class Presence:
    """Whether the camera sees what the map shows.

    Attributes:
        inside: probability that it does.
    """

    inside: float = FIRST_INSIDE

    def predicted(self) -> "Presence":
        """Before the next image."""
        return replace(self, inside=(1.0 - LEAVING) * self.inside + RETURNING * (1.0 - self.inside))

    def updated(self, log_evidence: float) -> "Presence":
        """After an image with this marginal evidence for the map."""
        log_odds = math.log(self.inside) - math.log1p(-self.inside) + log_evidence
        # Beyond this it is 0 or 1 in double precision.
        log_odds = min(max(log_odds, -30.0), 30.0)
        return replace(self, inside=1.0 / (1.0 + math.exp(-log_odds)))


@dataclass(frozen=True)
class Usual:
    """A running mean of what is said of image after image.

    Attributes:
        mean: None before the first image.
    """

    mean: float | None = None

    def updated(self, value: float) -> "Usual":
        """After one more image."""
        before = value if self.mean is None else self.mean
        return Usual(before + RATE * (value - before))

    def is_poor(self, value: float, share: float) -> bool:
        """Whether a value is less than this share of the usual; False while nothing is."""
        return self.mean is not None and value < share * self.mean
