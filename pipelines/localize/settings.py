"""The filter's settings: what a user can choose, checked when it is made."""

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from pipelines.artifacts.errors import OptionError
from pipelines.localize.likelihood import LIKELIHOODS, Likelihood
from pipelines.localize.motion import MotionModel
from pipelines.localize.resampling import SCHEMES
from pipelines.localize.state_space import StateSpace, state_space_of_dimension
from pipelines.render.choices import Blending, Quality
from pipelines.render.devices import Device
from pipelines.render.surface import quality_named

METHODS = ("filter", "pnp")
PROPOSALS = ("appearance", "pnp", "both")
STRATEGIES = ("informed", "coarse_to_fine", "condensation")
ESTIMATES = ("refined", "mode", "mean", "max_weight")
# Hypotheses that a search begins with.
START_PARTICLES = {"informed": 6_000, "coarse_to_fine": 20_000, "condensation": 195}
DEGREES_OF_FREEDOM = (3, 6)
MAX_PARTICLES = 10_000_000
MAX_THREADS = 4096


@dataclass(frozen=True)
class LocalizerSettings:
    """Settings of the particle filter.

    Attributes:
        method: ``filter``, or ``pnp``: each image for itself, by its features (``pnp.py``); nothing
            of the filter is used then.
        with_pnp: whether the filter's frames carry the pose by features too, for comparison.
        proposal: where ``informed`` looks for the body: where the scene's ``appearance`` is that of
            the image, where the features say (``pnp``), or ``both``.
        strategy: ``informed``, ``coarse_to_fine`` or ``condensation`` (the paper's filter, step by
            step).
        degrees_of_freedom: 3 (a robot on the floor) or 6.
        particles: the number kept while tracking.
        start_particles: hypotheses that a search begins with: particles (coarse_to_fine), or places
            whose appearance is compared (informed); None: as ``START_PARTICLES`` says, or
            ``particles`` where that is more.
        start: the state around which to start, D numbers, metres and radians; None: anywhere.
        start_position_sigma: standard deviation around ``start``, metres.
        start_heading_sigma: likewise, radians.
        area: x_min, x_max, y_min, y_max to search in; None: the scene's bounds.
        likelihood: the observation model.
        motion: the motion model.
        resampling: name of a scheme.
        resampling_threshold: resample when the effective sample size falls below this share of the
            particles; 1: at every step (coarse_to_fine).
        smallest_effective_share: what an image leaves of the effective sample size
            (coarse_to_fine).
        shrink_factor: the fewest particles that remain from one frame to the next, as a share.
        roughening: how far copies of a particle are spread (coarse_to_fine).
        coarse_width, fine_width: pixels across in the comparison, searching and tracking.
        refine_width: pixels across in the last step of the alignment; 0: no refined estimate.
        blending: how the light field blends its views.
        quality: how finely its surface follows the depth maps; None: ``medium`` where it has some.
        estimate: the estimate that stands for the run.
        map_position_sigma, map_heading_sigma: how accurate the map's poses are taken to be, metres
            and radians; part of the refined estimate's covariance.
        threads: of the comparison; None: all processors.
        device: where it takes place.

    Raises:
        OptionError: a value that makes no sense.
    """

    method: str = "filter"
    with_pnp: bool = False
    proposal: str = "appearance"
    strategy: str = "informed"
    degrees_of_freedom: int = 3
    particles: int = 195
    start_particles: int | None = None
    start: tuple[float, ...] | None = None
    start_position_sigma: float = 0.3
    start_heading_sigma: float = math.radians(10.0)
    area: tuple[float, float, float, float] | None = None
    likelihood: Likelihood = LIKELIHOODS["evidence"]
    motion: MotionModel = field(default_factory=MotionModel)
    resampling: str = "systematic"
    resampling_threshold: float = 0.7
    smallest_effective_share: float = 0.1
    shrink_factor: float = 0.6
    roughening: float = 1.0
    coarse_width: int = 20
    fine_width: int = 40
    refine_width: int = 160
    blending: Blending = Blending.UNSTRUCTURED
    quality: str | None = None
    estimate: str = "refined"
    map_position_sigma: float = 0.01
    map_heading_sigma: float = math.radians(0.25)
    threads: int | None = None
    device: Device = Device.CPU

    def __post_init__(self) -> None:
        _one_of("method", self.method, METHODS)
        _one_of("proposal", self.proposal, PROPOSALS)
        _one_of("strategy", self.strategy, STRATEGIES)
        self._check_pnp()
        _one_of("resampling", self.resampling, tuple(SCHEMES))
        _one_of("estimate", self.estimate, ESTIMATES)
        if self.degrees_of_freedom not in DEGREES_OF_FREEDOM:
            raise OptionError(f"{self.degrees_of_freedom} degrees of freedom are neither 3 nor 6")
        quality_named(self.quality, has_depth=False, preferred=Quality.MEDIUM)
        _within("number of particles", self.particles, 1, MAX_PARTICLES)
        if self.start_particles is not None:
            _within("number of particles at the start", self.start_particles, 1, MAX_PARTICLES)
        if self.strategy != "condensation" and self.search_particles < self.particles:
            raise OptionError(
                f"the search cannot start with fewer particles ({self.search_particles}) than are "
                f"kept ({self.particles})"
            )
        _within("start position sigma", self.start_position_sigma, 0.0, 1e6)
        _within("start heading sigma", self.start_heading_sigma, 0.0, math.pi)
        _within("map position sigma", self.map_position_sigma, 0.0, 1e6)
        _within("map heading sigma", self.map_heading_sigma, 0.0, math.pi)
        _within("resampling threshold", self.resampling_threshold, 0.0, 1.0)
        _within("smallest effective share", self.smallest_effective_share, 0.0, 0.5)
        _within("shrink factor", self.shrink_factor, 0.0, 1.0)
        _within("roughening", self.roughening, 0.0, 10.0)
        _within("coarse width", self.coarse_width, 4, 4096)
        _within("fine width", self.fine_width, 4, 4096)
        if self.coarse_width > self.fine_width:
            raise OptionError(
                f"the coarse width {self.coarse_width} is larger than the fine width "
                f"{self.fine_width}"
            )
        if self.refine_width != 0:
            _within("refine width", self.refine_width, self.fine_width, 4096)
        if self.threads is not None:
            _within("number of threads", self.threads, 1, MAX_THREADS)
        if self.start is not None and len(self.start) != self.degrees_of_freedom:
            raise OptionError(
                f"a start of {len(self.start)} numbers for {self.degrees_of_freedom} degrees of "
                "freedom"
            )
        if self.start is not None and not all(map(math.isfinite, self.start)):
            raise OptionError(f"start {self.start} is not finite")
        if self.area is not None:
            _check_area(self.area)

    def _check_pnp(self) -> None:
        if self.method == "pnp" and (self.with_pnp or self.proposal != "appearance"):
            raise OptionError("method pnp runs without a filter, so that nothing is beside it")
        if self.proposal != "appearance" and self.strategy != "informed":
            raise OptionError(
                f"strategy {self.strategy} takes no proposals; {self.proposal} goes with informed"
            )

    @property
    def uses_pnp(self) -> bool:
        """Whether poses by features are needed."""
        return self.method == "pnp" or self.with_pnp or self.proposal != "appearance"

    @property
    def search_particles(self) -> int:
        """``start_particles``, or what stands for it."""
        if self.start_particles is not None:
            return self.start_particles
        return max(START_PARTICLES[self.strategy], self.particles)

    @property
    def state_space(self) -> StateSpace:
        """What a state is."""
        return state_space_of_dimension(self.degrees_of_freedom)

    @property
    def widths(self) -> tuple[int, ...]:
        """Widths in pixels, rising, in which camera images are needed."""
        doubled = [2 * self.fine_width] if self.refine_width >= 3 * self.fine_width else []
        finest = [self.refine_width] if self.refine_width else []
        return tuple(sorted({self.coarse_width, self.fine_width, *doubled, *finest}))

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; what the run file keeps."""
        values = asdict(self)
        values["likelihood"]["cost"] = self.likelihood.cost.name.lower()
        values["likelihood"]["channels"] = self.likelihood.channels.value
        values["blending"] = self.blending.name.lower()
        values["device"] = self.device.value
        for name in ("start", "area"):
            values[name] = None if values[name] is None else list(values[name])
        # Results do not depend on it, and the file shall not either.
        del values["threads"]
        return values


def strategy_defaults(strategy: str) -> dict[str, Any]:
    """The settings whose defaults a strategy changes, by field; ``strategy`` is among them.

    Heigl, Denzler and Niemann (2001) compare squared differences of all pixels, draw independently,
    and take the particle with the most weight.
    """
    if strategy != "condensation":
        return {"strategy": strategy}
    return {
        "strategy": strategy,
        "likelihood": replace(LIKELIHOODS["squared"], one_pixel_in=1),
        "resampling": "multinomial",
        "estimate": "max_weight",
    }


def _one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise OptionError(f"{name} {value!r} is none of {', '.join(known)}")


def _within(name: str, value: float, low: float, high: float) -> None:
    # Written so that NaN fails the test too.
    if not low <= value <= high:
        raise OptionError(f"{name} {value:g} is not between {low:g} and {high:g}")


def _check_area(area: tuple[float, float, float, float]) -> None:
    if not all(map(math.isfinite, area)):
        raise OptionError(f"area {area} is not finite")
    if area[0] >= area[1] or area[2] >= area[3]:
        raise OptionError(
            f"area {','.join(f'{value:g}' for value in area)} is empty; "
            "give x_min,x_max,y_min,y_max with min < max"
        )
