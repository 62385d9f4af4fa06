"""The filter's settings: what a user can choose, said once and checked when it is made.

Config file, command line and docs/settings.md are made from the fields (``artifacts.setting``).
NumPy is imported only where it is needed, so that this takes no time.
"""

import math
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

from pipelines.artifacts.arguments import checked_choice
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.setting import check_settings, described, setting
from pipelines.artifacts.setting_kinds import AREA, DEGREES, POSE
from pipelines.localize.likelihood import LIKELIHOODS, Likelihood
from pipelines.render.choices import Blending, Quality
from pipelines.render.devices import Device

if TYPE_CHECKING:
    from pipelines.artifacts.arrays import FloatArray
    from pipelines.localize.state_space import StateSpace

METHODS = ("filter", "pnp")
PROPOSALS = ("retrieval", "pnp", "both")
STRATEGIES = ("mixture", "coarse_to_fine", "condensation")
ESTIMATES = ("refined", "mode", "mean", "max_weight")
RESAMPLING_SCHEMES = ("multinomial", "systematic", "stratified", "residual")
# Hypotheses that a search begins with.
START_PARTICLES = {"mixture": 6_000, "coarse_to_fine": 20_000, "condensation": 195}
DEGREES_OF_FREEDOM = (3, 6)
MAX_PARTICLES = 10_000_000
MAX_WIDTH = 4096
MAX_THREADS = 4096
LONGEST = 1e6

# Sections of the config file, in its order, and what they are about.
SECTIONS = {
    "filter": "The particle filter.",
    "start": "Where the robot may be at first.",
    "motion": "How far odometry is trusted: noise grows with motion; floors, each step.",
    "likelihood": "How the camera image is compared with a rendered view.",
    "rendering": "How views are rendered, and how large.",
    "estimate": "Which pose stands for the run, and what is known of the map's accuracy.",
}


@described
@dataclass(frozen=True)
class MotionModel:
    """How far odometry is trusted (``motion``). Zero is allowed everywhere and means: exact.

    Raises:
        OptionError: a value that is negative or not finite.
    """

    alpha1: float = setting(
        "motion", 0.04, "heading noise from rotation", unit="rad^2 per rad^2", limits=(0.0, LONGEST)
    )
    alpha2: float = setting(
        "motion",
        0.02,
        "heading noise from translation",
        unit="rad^2 per m^2",
        limits=(0.0, LONGEST),
    )
    alpha3: float = setting(
        "motion", 0.04, "position noise from translation", unit="m^2 per m^2", limits=(0.0, LONGEST)
    )
    alpha4: float = setting(
        "motion", 0.01, "position noise from rotation", unit="m^2 per rad^2", limits=(0.0, LONGEST)
    )
    position_floor: float = setting(
        "motion",
        0.02,
        "standard deviation of x and of y that each step adds",
        unit="metres",
        limits=(0.0, LONGEST),
    )
    heading_floor: float = setting(
        "motion",
        0.01,
        "standard deviation of the heading that each step adds",
        unit=DEGREES,
        limits=(0.0, LONGEST),
    )
    walk_position: float = setting(
        "motion",
        0.15,
        "standard deviation along each axis of a step without odometry",
        unit="metres",
        limits=(0.0, LONGEST),
    )
    walk_heading: float = setting(
        "motion",
        0.12,
        "standard deviation about each axis of a step without odometry",
        unit=DEGREES,
        limits=(0.0, LONGEST),
    )

    def __post_init__(self) -> None:
        check_settings(self)

    def standard_deviations(
        self, space: "StateSpace", increment: "FloatArray | None"
    ) -> tuple[float, float]:
        """Noise of one step: along each axis (metres) and of each angle (radians).

        Args:
            space: what a state is.
            increment: ``(D,)`` in the body's frame; None: nobody knows.
        """
        if increment is None:
            return self.walk_position, self.walk_heading
        translation_squared = float((increment[: space.positions] ** 2).sum())
        turn_squared = float((increment[space.positions :] ** 2).sum())
        position_variance = (
            self.alpha3 * translation_squared + self.alpha4 * turn_squared + self.position_floor**2
        )
        heading_variance = (
            self.alpha1 * turn_squared + self.alpha2 * translation_squared + self.heading_floor**2
        )
        return math.sqrt(position_variance), math.sqrt(heading_variance)


@described
@dataclass(frozen=True)
class LocalizerSettings:
    """Settings of the particle filter (Heigl, Denzler, Niemann 2001, equations (1) and (2)).

    Metres and radians. ``strategy_defaults("condensation")`` has what makes it the paper's.

    Attributes:
        motion: how far odometry is trusted.
        likelihood: how a camera image is compared with a view.

    Raises:
        OptionError: a value that makes no sense.
    """

    method: str = setting(
        "filter",
        "filter",
        "filter: the particle filter; pnp: each image by itself, from SIFT features and landmarks",
        choices=METHODS,
        is_common=True,
    )
    with_pnp: bool = setting(
        "filter",
        False,
        "beside the filter, also estimate each pose from features (PnP), for comparison",
        is_common=True,
    )
    proposal: str = setting(
        "filter",
        "retrieval",
        "what proposes poses to the strategy mixture: image retrieval, features (pnp), or both",
        choices=PROPOSALS,
        former_values={"appearance": "retrieval"},
        is_common=True,
    )
    strategy: str = setting(
        "filter",
        "mixture",
        "mixture: mixture-proposal MCL, the image proposes poses; coarse_to_fine: many particles "
        "on small images first; condensation: the paper's filter",
        choices=STRATEGIES,
        former_values={"informed": "mixture"},
        is_common=True,
    )
    degrees_of_freedom: int = setting(
        "filter",
        3,
        "3: a robot on the floor; 6: a hand-held camera or a drone",
        choices=DEGREES_OF_FREEDOM,
        former=("dof",),
        is_common=True,
    )
    particles: int = setting(
        "filter", 195, "particles kept while tracking", limits=(1, MAX_PARTICLES), is_common=True
    )
    start_particles: int | None = setting(
        "filter",
        None,
        "hypotheses that a search begins with; auto: 6000 (mixture: places of image retrieval), "
        "20000 (coarse_to_fine), 195 (condensation), at least as many as particles",
        limits=(1, MAX_PARTICLES),
        unset="auto",
        is_common=True,
    )
    resampling: str = setting(
        "filter",
        "systematic",
        "resampling scheme; the default with condensation is multinomial, as in the paper",
        choices=RESAMPLING_SCHEMES,
        is_common=True,
    )
    resampling_threshold: float = setting(
        "filter",
        0.7,
        "resample when the effective sample size falls below this share of the particles; 1: at "
        "every step (coarse_to_fine)",
        limits=(0.0, 1.0),
    )
    smallest_effective_share: float = setting(
        "filter",
        0.1,
        "least effective sample size after an image, as a share of the particles (coarse_to_fine)",
        limits=(0.0, 0.5),
    )
    shrink_factor: float = setting(
        "filter",
        0.6,
        "share of the particles that remains at least from one frame to the next",
        limits=(0.0, 1.0),
    )
    roughening: float = setting(
        "filter",
        1.0,
        "factor on the noise that spreads copies of a particle (coarse_to_fine)",
        limits=(0.0, 10.0),
    )
    start: tuple[float, ...] | None = setting(
        "start",
        None,
        "start pose: x, y, heading, or x, y, z and the rotation vector, in metres and degrees; "
        "anywhere: search the whole area",
        unset="anywhere",
        former=("init", "pose"),
        former_values={"uniform": "anywhere"},
        kind=POSE,
        is_common=True,
    )
    start_position_sigma: float = setting(
        "start",
        0.3,
        "standard deviation of the position around start",
        unit="metres",
        limits=(0.0, LONGEST),
        former=("position_sigma",),
    )
    start_heading_sigma: float = setting(
        "start",
        math.radians(10.0),
        "standard deviation of the heading around start",
        unit=DEGREES,
        limits=(0.0, 180.0),
        former=("heading_sigma_deg",),
    )
    area: tuple[float, float, float, float] | None = setting(
        "start",
        None,
        "where the robot may be: x_min, x_max, y_min, y_max, metres; scene: where the model covers",
        unset="scene",
        kind=AREA,
        is_common=True,
    )
    motion: MotionModel = field(default_factory=MotionModel)
    likelihood: Likelihood = LIKELIHOODS["evidence"]
    blending: Blending = setting(
        "rendering",
        Blending.UNSTRUCTURED,
        "how views are blended: by viewing angle (unstructured), or by the paper's Delaunay mesh "
        "(delaunay)",
        is_common=True,
    )
    quality: str | None = setting(
        "rendering",
        None,
        "how finely the surface follows the depth maps; auto: medium, or plane without depth maps",
        choices=tuple(quality.name.lower() for quality in Quality),
        unset="auto",
        is_common=True,
    )
    coarse_width: int = setting(
        "rendering",
        20,
        "width of the images compared while searching",
        unit="pixels",
        limits=(4, MAX_WIDTH),
    )
    fine_width: int = setting(
        "rendering",
        40,
        "width of the images compared while tracking",
        unit="pixels",
        limits=(4, MAX_WIDTH),
        former=("width",),
        is_common=True,
    )
    refine_width: int = setting(
        "rendering",
        160,
        "width of the images in the last step of the alignment; 0: no refined estimate",
        unit="pixels",
        limits=(0, MAX_WIDTH),
        is_common=True,
    )
    threads: int | None = setting(
        "rendering",
        None,
        "threads that render and compare; no effect on results",
        limits=(1, MAX_THREADS),
        unset="all",
        is_common=True,
    )
    device: Device = setting(
        "rendering",
        Device.CPU,
        "where views are rendered and compared; auto: on a GPU where there is one. A GPU needs pip "
        'install "lfnav[gpu]"',
        is_common=True,
    )
    estimate: str = setting(
        "estimate",
        "refined",
        "estimate that stands for the run: refined is aligned with the image; the default with "
        "condensation is max_weight, as in the paper",
        choices=ESTIMATES,
        former=("kind",),
        is_common=True,
    )
    map_position_sigma: float = setting(
        "estimate",
        0.01,
        "standard deviation of the map's positions",
        unit="metres",
        limits=(0.0, LONGEST),
    )
    map_heading_sigma: float = setting(
        "estimate",
        math.radians(0.25),
        "standard deviation of the map's headings",
        unit=DEGREES,
        limits=(0.0, 180.0),
    )

    def __post_init__(self) -> None:
        check_settings(self)
        self._check_pnp()
        if self.strategy != "condensation" and self.search_particles < self.particles:
            raise OptionError(
                f"the search cannot start with fewer particles ({self.search_particles}) than are "
                f"kept ({self.particles})"
            )
        if self.coarse_width > self.fine_width:
            raise OptionError(
                f"coarse_width {self.coarse_width} is larger than fine_width {self.fine_width}"
            )
        if 0 < self.refine_width < self.fine_width:
            raise OptionError(
                f"refine_width {self.refine_width} is not between {self.fine_width}, which is "
                f"fine_width, and {MAX_WIDTH}"
            )
        if self.start is not None and len(self.start) != self.degrees_of_freedom:
            raise OptionError(
                f"a start of {len(self.start)} numbers for {self.degrees_of_freedom} degrees of "
                "freedom"
            )
        if self.area is not None and not (
            self.area[0] < self.area[1] and self.area[2] < self.area[3]
        ):
            raise OptionError(
                f"area {','.join(f'{value:g}' for value in self.area)} is empty; "
                "give x_min,x_max,y_min,y_max with min < max"
            )

    def _check_pnp(self) -> None:
        if self.method == "pnp" and (self.with_pnp or self.proposal != "retrieval"):
            raise OptionError("method pnp runs without a filter, so that nothing is beside it")
        if self.proposal != "retrieval" and self.strategy != "mixture":
            raise OptionError(
                f"strategy {self.strategy} takes no proposals; {self.proposal} goes with mixture"
            )

    @property
    def uses_pnp(self) -> bool:
        """Whether poses by features are needed."""
        return self.method == "pnp" or self.with_pnp or self.proposal != "retrieval"

    @property
    def search_particles(self) -> int:
        """``start_particles``, or what stands for it."""
        if self.start_particles is not None:
            return self.start_particles
        return max(START_PARTICLES[self.strategy], self.particles)

    @property
    def state_space(self) -> "StateSpace":
        """What a state is."""
        from pipelines.localize.state_space import state_space_of_dimension

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
    """The settings whose defaults a strategy changes.

    Heigl, Denzler and Niemann (2001) compare squared differences of all pixels, draw independently,
    and take the particle with the most weight.

    Args:
        strategy: ``mixture``, ``coarse_to_fine`` or ``condensation``, the paper's.

    Returns:
        Field of ``LocalizerSettings`` -> value, ``strategy`` among them.

    Raises:
        OptionError: another strategy.
    """
    checked_choice(strategy, "strategy", STRATEGIES)
    if strategy != "condensation":
        return {"strategy": strategy}
    return {
        "strategy": strategy,
        "likelihood": replace(LIKELIHOODS["squared"], pixel_subsampling=1),
        "resampling": "multinomial",
        "estimate": "max_weight",
    }
