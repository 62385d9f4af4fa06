"""Kinds of likelihood: how a view and a camera image are compared, and how much that is trusted.

The cost of a comparison (``pipelines.render.comparison``) becomes a log-likelihood,
``-inverse_temperature * cost``. The default, ``evidence``, is absolute: a log-likelihood ratio
against an image that does not show the map. The others say only which of several states fits
better; the paper's is ``squared``.
"""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from types import MappingProxyType

from pipelines.artifacts.arguments import checked_choice
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.setting import check_settings, described, setting
from pipelines.render.choices import Channels, Cost


@described
@dataclass(frozen=True)
class Likelihood:
    """A kind of comparison and how much it is trusted.

    For the squared difference the inverse temperature is n 255^2 / (2 sigma^2) with n independent
    pixels of standard deviation sigma: neighbouring pixels and the errors of the model are far from
    independent, so n is about ten. For evidence it is the number of independent pixels that an
    image is worth, whatever its size.

    Raises:
        OptionError: an inverse temperature that is not positive and finite, or values that do not
            go together.
    """

    cost: Cost = setting(
        "likelihood",
        MISSING,
        "how images are compared: evidence (local contrast, against an image that does not show "
        "the map) or a difference; the default with condensation is squared, as in the paper",
        former=("likelihood",),
        is_common=True,
    )
    inverse_temperature: float = setting(
        "likelihood",
        MISSING,
        "log-likelihood lost per unit of cost; each cost has its own default",
        limits=(1e-9, 1e9),
        former=("sharpness",),
    )
    fit_gain: bool = setting(
        "likelihood",
        True,
        "fit a brightness factor before the comparison; not possible with evidence",
    )
    pixel_subsampling: int = setting(
        "likelihood",
        1,
        "one in so many pixels is compared; 1: all",
        choices=(1, 2, 3, 5),
        former=("one_pixel_in",),
    )
    channels: Channels = setting("likelihood", Channels.COLOUR, "image channels that are compared")

    def __post_init__(self) -> None:
        check_settings(self)
        if self.cost is Cost.GRADIENT and self.pixel_subsampling != 1:
            raise OptionError("gradients are of neighbouring pixels: pixel_subsampling has to be 1")
        if self.cost is Cost.EVIDENCE and self.fit_gain:
            raise OptionError("evidence fits no gain: choose channels that bear another light")

    @property
    def proposal_inverse_temperature(self) -> float:
        """The inverse temperature of a squared difference whose peaks are about as wide."""
        if self.cost is Cost.EVIDENCE:
            return EVIDENCE_PEAK_INVERSE_TEMPERATURE
        is_squared = self.cost is Cost.SQUARED
        return self.inverse_temperature if is_squared else SQUARED_INVERSE_TEMPERATURE


# The squared difference's, by which other costs' peaks are taken to be as wide.
SQUARED_INVERSE_TEMPERATURE = 800.0
EVIDENCE_PEAK_INVERSE_TEMPERATURE = 8000.0
# Independent pixels that an image is worth, as evidence. Windows of local contrast have 25 pixels,
# of which an image 40 pixels wide has 48; edges are narrower than windows.
INDEPENDENT_PIXELS = 150.0
# Of particles around the truth, log-likelihoods by a fifth of 40x30 pixels differ from those by all
# by 0.4 (standard deviation), and among each other by 4 to 5: docs/performance.md.
PIXEL_SUBSAMPLING = 5


LIKELIHOODS: Mapping[str, Likelihood] = MappingProxyType(
    {
        "evidence": Likelihood(
            Cost.EVIDENCE, INDEPENDENT_PIXELS, False, PIXEL_SUBSAMPLING, Channels.CONTRAST
        ),
        "squared": Likelihood(
            Cost.SQUARED, SQUARED_INVERSE_TEMPERATURE, pixel_subsampling=PIXEL_SUBSAMPLING
        ),
        "robust": Likelihood(Cost.ROBUST, 80.0, pixel_subsampling=PIXEL_SUBSAMPLING),
        "zncc": Likelihood(Cost.ZNCC, 60.0, fit_gain=False, pixel_subsampling=PIXEL_SUBSAMPLING),
        "gradient": Likelihood(Cost.GRADIENT, 60.0),
    }
)


def likelihood_named(name: str) -> Likelihood:
    """The likelihood with its default inverse temperature.

    Args:
        name: ``evidence``, ``squared`` (the paper's: Heigl, Denzler, Niemann 2001, section 6),
            ``robust``, ``zncc`` or ``gradient``.

    Raises:
        OptionError: unknown name.
    """
    return LIKELIHOODS[checked_choice(name, "likelihood", LIKELIHOODS)]
