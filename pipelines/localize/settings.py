"""The filter's settings: what a user can choose, checked when it is made."""

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from pipelines.artifacts.errors import OptionError
from pipelines.lightfield.blending import Blending
from pipelines.lightfield.proxy import Quality, quality_named
from pipelines.localize.likelihood import LIKELIHOODS, Likelihood
from pipelines.localize.motion import MotionModel
from pipelines.localize.resampling import SCHEMES

STRATEGIES = ("coarse_to_fine", "condensation")
ESTIMATES = ("mode", "mean", "max_weight")
MAX_PARTICLES = 10_000_000
MAX_THREADS = 4096


@dataclass(frozen=True)
class LocalizerSettings:
    """Settings of the particle filter.

    Attributes:
        strategy: ``coarse_to_fine`` or ``condensation`` (the paper's filter, step by step).
        particles: the number kept while tracking.
        start_particles: the number at the start of a search (coarse_to_fine).
        start: x, y (metres) and heading (radians) around which to start; None: anywhere.
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
        blending: how the light field blends its views.
        quality: how finely its surface follows the depth maps; None: ``medium`` where it has some.
        estimate: the estimate that stands for the run.
        threads: of the comparison; None: all processors.

    Raises:
        OptionError: a value that makes no sense.
    """

    strategy: str = "coarse_to_fine"
    particles: int = 195
    start_particles: int = 20_000
    start: tuple[float, float, float] | None = None
    start_position_sigma: float = 0.3
    start_heading_sigma: float = math.radians(10.0)
    area: tuple[float, float, float, float] | None = None
    likelihood: Likelihood = LIKELIHOODS["squared"]
    motion: MotionModel = field(default_factory=MotionModel)
    resampling: str = "systematic"
    resampling_threshold: float = 0.7
    smallest_effective_share: float = 0.1
    shrink_factor: float = 0.6
    roughening: float = 1.0
    coarse_width: int = 20
    fine_width: int = 40
    blending: Blending = Blending.UNSTRUCTURED
    quality: str | None = None
    estimate: str = "mode"
    threads: int | None = None

    def __post_init__(self) -> None:
        _one_of("strategy", self.strategy, STRATEGIES)
        _one_of("resampling", self.resampling, tuple(SCHEMES))
        _one_of("estimate", self.estimate, ESTIMATES)
        quality_named(self.quality, has_depth=False, preferred=Quality.MEDIUM)
        _within("number of particles", self.particles, 1, MAX_PARTICLES)
        _within("number of particles at the start", self.start_particles, 1, MAX_PARTICLES)
        if self.is_coarse_to_fine and self.start_particles < self.particles:
            raise OptionError(
                f"the search cannot start with fewer particles ({self.start_particles}) than are "
                f"kept ({self.particles})"
            )
        _within("start position sigma", self.start_position_sigma, 0.0, 1e6)
        _within("start heading sigma", self.start_heading_sigma, 0.0, math.pi)
        _within("resampling threshold", self.resampling_threshold, 0.0, 1.0)
        _within("smallest effective share", self.smallest_effective_share, 0.0, 0.5)
        _within("shrink factor", self.shrink_factor, 0.0, 1.0)
        _within("roughening", self.roughening, 0.0, 10.0)
        _within("coarse width", self.coarse_width, 4, 4096)
        _within("fine width", self.fine_width, 4, 4096)
        if self.threads is not None:
            _within("number of threads", self.threads, 1, MAX_THREADS)
        if self.start is not None and not all(map(math.isfinite, self.start)):
            raise OptionError(f"start {self.start} is not finite")
        if self.area is not None:
            _check_area(self.area)

    @property
    def is_coarse_to_fine(self) -> bool:
        """Whether the number of particles shrinks from many to ``particles``."""
        return self.strategy == "coarse_to_fine"

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; what the run file keeps."""
        values = asdict(self)
        values["likelihood"]["cost"] = self.likelihood.cost.name.lower()
        values["blending"] = self.blending.name.lower()
        for name in ("start", "area"):
            values[name] = None if values[name] is None else list(values[name])
        # Results do not depend on it, and the file shall not either.
        del values["threads"]
        return values


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
