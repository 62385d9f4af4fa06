"""What images usually say, against which one of them is judged."""

from dataclasses import dataclass

# How fast what is usual follows.
RATE = 0.2


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
