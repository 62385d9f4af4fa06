"""Kinds of likelihood: how a view and a camera image are compared, and how much that is trusted.

The cost of a comparison (``pipelines.render.comparison``) becomes a log-likelihood,
``-sharpness * cost``. The default, ``evidence``, is absolute: a log-likelihood ratio against an
image that does not show the map. The others say only which of several states fits better; the
paper's is ``squared``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.localize.belief import effective_sample_size, normalise_log_weights
from pipelines.localize.observation import LATTICES
from pipelines.render.choices import Channels, Cost


@dataclass(frozen=True)
class Likelihood:
    """A kind of comparison and how much it is trusted.

    Attributes:
        cost: the kind of comparison.
        sharpness: log-likelihood lost for a unit of cost. For the squared difference it is
            n 255^2 / (2 sigma^2) with n independent pixels of standard deviation sigma:
            neighbouring pixels and the errors of the model are far from independent, so n is about
            ten. For evidence it is the number of independent pixels that an image is worth,
            whatever its size.
        fit_gain: whether a brightness factor is fitted before the comparison.
        one_pixel_in: one in so many pixels is compared, a key of ``observation.LATTICES``.
        channels: what of the images is compared.

    Raises:
        OptionError: a sharpness that is not positive and finite, or pixels that no lattice has.
    """

    cost: Cost
    sharpness: float
    fit_gain: bool = True
    one_pixel_in: int = 1
    channels: Channels = Channels.COLOUR

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sharpness) and self.sharpness > 0.0):
            raise OptionError(f"a likelihood's sharpness {self.sharpness:g} must be positive")
        if self.one_pixel_in not in LATTICES:
            known = ", ".join(map(str, LATTICES))
            raise OptionError(f"one pixel in {self.one_pixel_in} is none of one in {known}")
        if self.cost is Cost.GRADIENT and self.one_pixel_in != 1:
            raise OptionError("gradients are of neighbouring pixels: compare one pixel in 1")

        if self.cost is Cost.EVIDENCE and self.fit_gain:
            raise OptionError("evidence fits no gain: choose channels that bear another light")

    @property
    def proposal_sharpness(self) -> float:
        """The sharpness of a squared difference whose peaks are about as wide."""
        if self.cost is Cost.EVIDENCE:
            return EVIDENCE_PEAK_SHARPNESS
        return self.sharpness if self.cost is Cost.SQUARED else SQUARED_SHARPNESS


# The squared difference's sharpness, by which other costs' peaks are taken to be as wide.
SQUARED_SHARPNESS = 800.0
EVIDENCE_PEAK_SHARPNESS = 8000.0
# Independent pixels that an image is worth, as evidence. Windows of local contrast have 25 pixels,
# of which an image 40 pixels wide has 48; edges are narrower than windows.
INDEPENDENT_PIXELS = 150.0
# Of particles around the truth, log-likelihoods by a fifth of 40x30 pixels differ from those by all
# by 0.4 (standard deviation), and among each other by 4 to 5: docs/performance.md.
ONE_PIXEL_IN = 5


LIKELIHOODS: Mapping[str, Likelihood] = MappingProxyType(
    {
        "evidence": Likelihood(
            Cost.EVIDENCE, INDEPENDENT_PIXELS, False, ONE_PIXEL_IN, Channels.CONTRAST
        ),
        "squared": Likelihood(Cost.SQUARED, SQUARED_SHARPNESS, one_pixel_in=ONE_PIXEL_IN),
        "robust": Likelihood(Cost.ROBUST, 80.0, one_pixel_in=ONE_PIXEL_IN),
        "zncc": Likelihood(Cost.ZNCC, 60.0, fit_gain=False, one_pixel_in=ONE_PIXEL_IN),
        "gradient": Likelihood(Cost.GRADIENT, 60.0),
    }
)


def likelihood_named(name: str) -> Likelihood:
    """The likelihood with its default sharpness.

    Raises:
        OptionError: unknown name.
    """
    if name not in LIKELIHOODS:
        raise OptionError(f"likelihood {name!r} is none of {', '.join(LIKELIHOODS)}")
    return LIKELIHOODS[name]


def tempered(
    log_weights: FloatArray, log_likelihoods: FloatArray, smallest_share: float
) -> tuple[FloatArray, float]:
    """Adds log-likelihoods to log-weights, flattened as far as needed to keep particles alive.

    A likelihood that is sharper than the particles are dense leaves one of them with all the
    weight, the nearest by chance. Raised to a power below 1 it selects more slowly and more surely
    (annealed weights, Deutscher and Reid 2005).

    Args:
        log_weights: ``(M,)`` normalised prior weights.
        log_likelihoods: ``(M,)``; -inf is allowed.
        smallest_share: of M that the effective sample size shall keep; 0 leaves the likelihood as
            it is.

    Returns:
        Normalised log-weights ``(M,)`` and the power in (0, 1]. Where the image rules out all
        particles alike, the prior weights remain.

    Raises:
        StageError: log-likelihoods that are NaN or +inf: the comparison is broken.
    """
    broken = int(np.count_nonzero(np.isnan(log_likelihoods) | np.isposinf(log_likelihoods)))
    if broken:
        raise StageError(f"{broken} of {len(log_likelihoods)} log-likelihoods are NaN or +inf")
    largest = np.max(log_likelihoods)
    if np.isneginf(largest):
        return log_weights, 1.0
    relative = log_likelihoods - largest

    def posterior(power: float) -> FloatArray:
        return normalise_log_weights(log_weights + power * relative)[0]

    wanted = smallest_share * len(log_weights)
    # The prior's own spread is the most that any power can keep.
    wanted = min(wanted, 0.5 * effective_sample_size(log_weights))
    if effective_sample_size(posterior(1.0)) >= wanted:
        return posterior(1.0), 1.0
    low, high = 1e-9, 1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        if effective_sample_size(posterior(middle)) >= wanted:
            low = middle
        else:
            high = middle
    return posterior(low), low
