"""The keys of a localization config: where each setting stands, what it may be, what it means.

Lengths are metres, images pixels. Angles are degrees, as at the command line, and every key that
holds some ends in ``_deg`` (the pose, which mixes both, says so in its comment). The alphas of the
motion model are ratios of variances, as the model defines them, with radians.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import reduce
from typing import Any

from pipelines.artifacts.toml_file import format_value, type_name
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.choices import Blending, Channels, Cost
from pipelines.render.devices import Device

SECTIONS = {
    "filter": "The particle filter.",
    "start": "Where the robot may be at first.",
    "motion": "How far odometry is trusted: noise grows with motion; floors, each step.",
    "likelihood": "How the camera image is compared with a rendered view.",
    "rendering": "How views are rendered, and how large.",
    "estimate": "Which pose stands for the run, and what is known of the map's accuracy.",
}


@dataclass(frozen=True)
class Kind:
    """A kind of value.

    Attributes:
        expected: in words.
        read: from TOML's types; raises ValueError, TypeError or OverflowError for another kind.
        write: as TOML's types.
    """

    expected: str
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


@dataclass(frozen=True)
class Key:
    """A key of the file.

    Attributes:
        section: the table that it stands in.
        name: what it is called there.
        field: the attribute of ``LocalizerSettings``, or ``motion.X`` and ``likelihood.X``.
        kind: of its value.
        comment: unit and meaning.
    """

    section: str
    name: str
    field: str
    kind: Kind
    comment: str

    @property
    def place(self) -> str:
        """How errors name it."""
        return f"[{self.section}] {self.name}"

    def parsed(self, value: object) -> Any:
        """The setting that a value of the file stands for.

        Raises:
            ValueError: another kind of value; the text says which was expected.
        """
        try:
            return self.kind.read(value)
        except (ValueError, TypeError, OverflowError) as error:
            found = repr(value) if isinstance(value, str) else type_name(value)
            raise ValueError(f"is {found}, expected {self.kind.expected}") from error

    def value_in(self, settings: LocalizerSettings) -> Any:
        """The setting's value."""
        return reduce(getattr, self.field.split("."), settings)

    def line(self, settings: LocalizerSettings) -> str:
        """The line of the file."""
        value = format_value(self.kind.write(self.value_in(settings)))
        return f"{self.name} = {value}  # {self.comment}"


def degrees_of(radians: float) -> float:
    """The shortest number of degrees that is read back as these radians.

    Where rounding leaves none, the nearest is taken, which is read back one bit beside.
    """
    exact = math.degrees(radians)
    candidates = (float(f"{exact:.{digits}g}") for digits in range(1, 18))
    beside = (math.nextafter(exact, end) for end in (-math.inf, math.inf))
    for candidate in (*candidates, *beside):
        if math.radians(candidate) == radians:
            return candidate
    return exact


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _whole(value: object) -> int:
    # In Python a bool is an int as well.
    if type(value) is not int:
        raise TypeError
    return value


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError
    return float(value)


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise TypeError
    return value


def _numbers(value: object, counts: tuple[int, ...]) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) not in counts:
        raise TypeError
    return tuple(_number(item) for item in value)


def _area(value: object) -> tuple[float, ...]:
    return _numbers(value, (4,))


def _pose(value: object) -> tuple[float, ...]:
    """Metres and degrees become metres and radians."""
    numbers = _numbers(value, (3, 6))
    positions = 2 if len(numbers) == 3 else 3
    return (*numbers[:positions], *map(math.radians, numbers[positions:]))


def _pose_text(state: tuple[float, ...]) -> list[float]:
    positions = 2 if len(state) == 3 else 3
    return [*map(float, state[:positions]), *map(degrees_of, state[positions:])]


def _named(names: type[Enum]) -> Kind:
    """One of the members of an enumeration, in lower case."""

    def read(value: object) -> Enum:
        members = {member.name.lower(): member for member in names}
        if value not in members:
            raise ValueError
        return members[_text(value)]

    known = ", ".join(member.name.lower() for member in names)
    return Kind(f"one of {known}", read, lambda member: str(names(member).name.lower()))


def _or_word(kind: Kind, word: str) -> Kind:
    """A kind of value, or a word that stands for None, which TOML lacks."""
    return Kind(
        f'{kind.expected} or "{word}"',
        lambda value: None if value == word else kind.read(value),
        lambda value: word if value is None else kind.write(value),
    )


TEXT = Kind("a text", _text, str)
WHOLE = Kind("a whole number", _whole, int)
NUMBER = Kind("a number", _number, float)
FLAG = Kind("true or false", _flag, bool)
ANGLE = Kind("a number", lambda value: math.radians(_number(value)), degrees_of)
AREA = Kind("a list of four numbers", _area, lambda area: list(map(float, area)))
POSE = Kind("a list of three or six numbers", _pose, _pose_text)

KEYS = (
    Key("filter", "strategy", "strategy", TEXT, "informed, coarse_to_fine or condensation"),
    Key("filter", "method", "method", TEXT, "filter, or pnp: features of each image for itself"),
    Key("filter", "with_pnp", "with_pnp", FLAG, "also note the pose by features, to compare"),
    Key(
        "filter",
        "proposal",
        "proposal",
        TEXT,
        "where informed looks for the robot: appearance, pnp or both",
    ),
    Key("filter", "degrees_of_freedom", "degrees_of_freedom", WHOLE, "3: on the floor; 6: any"),
    Key("filter", "particles", "particles", WHOLE, "kept while tracking"),
    Key(
        "filter",
        "start_particles",
        "start_particles",
        _or_word(WHOLE, "auto"),
        "a search begins with so many hypotheses; auto: as the strategy needs",
    ),
    Key(
        "filter", "resampling", "resampling", TEXT, "multinomial, systematic, stratified, residual"
    ),
    Key(
        "filter",
        "resampling_threshold",
        "resampling_threshold",
        NUMBER,
        "resample below this share of effective particles (coarse_to_fine)",
    ),
    Key(
        "filter",
        "smallest_effective_share",
        "smallest_effective_share",
        NUMBER,
        "share of effective particles that an image leaves (coarse_to_fine)",
    ),
    Key(
        "filter",
        "shrink_factor",
        "shrink_factor",
        NUMBER,
        "fewest particles that remain from frame to frame, a share",
    ),
    Key("filter", "roughening", "roughening", NUMBER, "spread of a particle's copies, a factor"),
    Key(
        "start",
        "pose",
        "start",
        _or_word(POSE, "anywhere"),
        "[x, y, heading], or [x, y, z, rx, ry, rz]: metres and degrees; or anywhere",
    ),
    Key("start", "position_sigma", "start_position_sigma", NUMBER, "metres around the pose"),
    Key("start", "heading_sigma_deg", "start_heading_sigma", ANGLE, "degrees around the pose"),
    Key(
        "start",
        "area",
        "area",
        _or_word(AREA, "scene"),
        "[x_min, x_max, y_min, y_max], metres; scene: what the model covers",
    ),
    Key("motion", "alpha1", "motion.alpha1", NUMBER, "heading from turning, rad^2 a rad^2"),
    Key("motion", "alpha2", "motion.alpha2", NUMBER, "heading from driving, rad^2 a m^2"),
    Key("motion", "alpha3", "motion.alpha3", NUMBER, "position from driving, m^2 a m^2"),
    Key("motion", "alpha4", "motion.alpha4", NUMBER, "position from turning, m^2 a rad^2"),
    Key("motion", "position_floor", "motion.position_floor", NUMBER, "metres, each step"),
    Key("motion", "heading_floor_deg", "motion.heading_floor", ANGLE, "degrees, each step"),
    Key("motion", "walk_position", "motion.walk_position", NUMBER, "metres, without odometry"),
    Key("motion", "walk_heading_deg", "motion.walk_heading", ANGLE, "degrees, without odometry"),
    Key(
        "likelihood",
        "cost",
        "likelihood.cost",
        _named(Cost),
        "evidence, squared, robust, zncc, gradient",
    ),
    Key(
        "likelihood",
        "channels",
        "likelihood.channels",
        _named(Channels),
        "colour, contrast, gradient, mixed, chroma",
    ),
    Key("likelihood", "sharpness", "likelihood.sharpness", NUMBER, "log-likelihood a unit of cost"),
    Key("likelihood", "fit_gain", "likelihood.fit_gain", FLAG, "fit the brightness first"),
    Key("likelihood", "one_pixel_in", "likelihood.one_pixel_in", WHOLE, "compared: 1, 2, 3 or 5"),
    Key("rendering", "blending", "blending", _named(Blending), "unstructured or delaunay"),
    Key(
        "rendering",
        "quality",
        "quality",
        _or_word(TEXT, "auto"),
        "plane, coarse, medium, fine; auto: medium where the scene has depth maps",
    ),
    Key("rendering", "coarse_width", "coarse_width", WHOLE, "pixels across while searching"),
    Key("rendering", "fine_width", "fine_width", WHOLE, "pixels across while tracking"),
    Key("rendering", "refine_width", "refine_width", WHOLE, "pixels across, alignment; 0: none"),
    Key("rendering", "threads", "threads", _or_word(WHOLE, "all"), "changes no result"),
    Key("rendering", "device", "device", _named(Device), "auto, cpu or gpu"),
    Key("estimate", "kind", "estimate", TEXT, "refined, mode, mean or max_weight"),
    Key("estimate", "map_position_sigma", "map_position_sigma", NUMBER, "metres"),
    Key("estimate", "map_heading_sigma_deg", "map_heading_sigma", ANGLE, "degrees"),
)
