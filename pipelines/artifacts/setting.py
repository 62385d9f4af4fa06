"""A setting: a field of a dataclass that says everything about one choice of the user.

``setting`` makes such a field. Its section, unit, range, default and help text stand there and
nowhere else: values are checked, config files read and written, options of the command line made
and the page of the documentation written from it (``entries_of``). The name is that of the
attribute, everywhere. Angles, which are radians in Python and degrees for people, end in ``_deg``
where people meet them.

Nothing but the standard library is imported, so that a command line can be built from settings at
once.
"""

import inspect
import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import reduce
from typing import Any, TypeVar, get_type_hints

from pipelines.artifacts.arguments import check_fields
from pipelines.artifacts.errors import OptionError, quoted
from pipelines.artifacts.setting_kinds import (
    DEGREES,
    FLAG,
    Kind,
    kind_of_type,
    one_of,
    or_word,
)
from pipelines.artifacts.toml_file import format_value, type_name

logger = logging.getLogger(__name__)

Made = TypeVar("Made")

# Where a field's metadata holds its ``Setting``.
METADATA = "setting"


@dataclass(frozen=True)
class Setting:
    """What there is to say about a choice, besides its name, type and default.

    Attributes:
        section: of the config file.
        help: the meaning.
        unit: of the value as people give it; "": none. ``DEGREES``: radians in Python.
        limits: the smallest and the largest value, in this unit; None: there are none.
        choices: all possible values of a text or whole number; empty: any.
        unset: the word that stands for None, which TOML lacks; "": it is never None.
        former: names that it had in earlier versions, all of which are still understood.
        former_values: names that values had in earlier versions -> names that they have.
        is_common: whether the help of a command lists it.
        kind: of its values; None: as the type says.
    """

    section: str
    help: str
    unit: str = ""
    limits: tuple[float, float] | None = None
    choices: tuple[str | int, ...] = ()
    unset: str = ""
    former: tuple[str, ...] = ()
    former_values: Mapping[str, str] = field(default_factory=dict)
    is_common: bool = False
    kind: Kind | None = None

    def from_unit(self, value: float) -> float:
        """A number in the user's unit as Python has it."""
        return math.radians(value) if self.unit == DEGREES else value

    def refusal(self, value: Any) -> str | None:
        """Why a value is impossible, after its name; None where it is not."""
        if value is None and self.unset:
            return None
        if self.choices:
            known = ", ".join(map(str, self.choices))
            return None if value in self.choices else f"{quoted(value)} is none of {known}"
        if isinstance(value, tuple):
            return None if all(map(math.isfinite, value)) else f"{value} is not finite"
        if self.limits is None:
            return None
        low, high = self.limits
        # Written so that NaN fails the test too.
        if self.from_unit(low) <= value <= self.from_unit(high):
            return None
        shown = math.degrees(value) if self.unit == DEGREES else value
        return f"{shown:g} is not between {low:.12g} and {high:.12g}"


def setting(section: str, default: Any, help_text: str, **more: Any) -> Any:
    """A field of a dataclass that is a setting.

    Args:
        section: see ``Setting``.
        default: as Python has it.
        help_text: ``Setting.help``.
        more: the other attributes of ``Setting``.
    """
    return field(default=default, metadata={METADATA: Setting(section, help_text, **more)})


def described(kind: type[Made]) -> type[Made]:
    """Adds what its settings say of themselves to a dataclass's docstring.

    Args:
        kind: the dataclass; its docstring ends with a section ``Attributes`` or ``Raises``.
    """
    lines = []
    for item in fields(kind):  # type: ignore[arg-type]
        chosen = item.metadata.get(METADATA)
        if chosen is not None:
            unit = "radians" if chosen.unit == DEGREES else chosen.unit
            unset = f"None: {chosen.unset}" if chosen.unset else ""
            parts = (chosen.help, unit, unset)
            lines.append(f"    {item.name}: {'; '.join(part for part in parts if part)}.")
    text = inspect.cleandoc(kind.__doc__ or "")
    head, has_raises, raises = text.partition("\nRaises:\n")
    if "Attributes:\n" not in head:
        head = f"{head.rstrip()}\n\nAttributes:"
    kind.__doc__ = "\n".join([head.rstrip(), *lines, ""]) + has_raises + raises
    return kind


def public_name(attribute: str, chosen: Setting) -> str:
    """What people call the setting that an attribute holds."""
    return f"{attribute}_deg" if chosen.unit == DEGREES and not chosen.kind else attribute


def check_settings(instance: Any) -> None:
    """Checks every setting of a dataclass by itself.

    Raises:
        OptionError: a value that is impossible or of another type; the text names it.
    """
    check_fields(instance)
    for item in fields(instance):
        chosen = item.metadata.get(METADATA)
        if chosen is None:
            continue
        refusal = chosen.refusal(getattr(instance, item.name))
        if refusal is not None:
            raise OptionError(f"{public_name(item.name, chosen)} {refusal}")


@dataclass(frozen=True)
class Entry:
    """A setting in its place.

    Attributes:
        path: of the attribute, from the outermost dataclass on: ``motion.alpha1``.
        name: what people call it.
        setting: the rest.
        kind: of its values.
        default: as Python has it.
    """

    path: str
    name: str
    setting: Setting
    kind: Kind
    default: Any

    @property
    def place(self) -> str:
        """How errors about a config file name it."""
        return f"[{self.setting.section}] {self.name}"

    @property
    def names(self) -> tuple[str, ...]:
        """The name, and those of earlier versions."""
        return (self.name, *self.setting.former)

    def parsed(self, value: object) -> Any:
        """The setting that a value of a TOML file stands for.

        Raises:
            ValueError: another kind of value; the text says which was expected.
        """
        self.warn_of_former(value)
        try:
            return self.kind.read(self._current(value))
        except (ValueError, TypeError, OverflowError) as error:
            is_choice = self.kind.choices and type(value) is int
            found = str(value) if is_choice else type_name(value)
            found = quoted(value) if isinstance(value, str) else found
            raise ValueError(f"is {found}, expected {self.kind.expected}") from error

    def parsed_text(self, text: str) -> Any:
        """The setting that a text at the command line stands for; without ``warn_of_former``.

        Raises:
            ValueError: another kind of value; the text says which was expected.
        """
        value = self._current(text)
        try:
            is_word = value == self.setting.unset and self.setting.unset
            return self.kind.read(value if is_word else self.kind.parse(str(value)))
        except (ValueError, TypeError, OverflowError) as error:
            raise ValueError(
                f"{quoted(text)} is not {self.kind.expected_text or self.kind.expected}"
            ) from error

    def _current(self, value: object) -> object:
        """The value, by the name that it has now."""
        return self.setting.former_values.get(value, value) if isinstance(value, str) else value

    def warn_of_former(self, value: object) -> None:
        """Logs what a value that is given by a former name is called now."""
        current = self._current(value)
        if current is not value:
            logger.warning("%s %s is now called %s", self.name, value, current)

    def value_in(self, settings: Any) -> Any:
        """The setting's value."""
        return reduce(getattr, self.path.split("."), settings)

    def text_of(self, value: Any) -> str:
        """A value as TOML."""
        return format_value(self.kind.write(value))

    @property
    def is_flag(self) -> bool:
        """Whether it is true or false."""
        return self.kind is FLAG

    @property
    def default_text(self) -> str:
        """The default, as people write it."""
        value = self.kind.write(self.default)
        return value if isinstance(value, str) else format_value(value)

    @property
    def comment(self) -> str:
        """Meaning, unit and possible values in one line."""
        unit = self.setting.unit
        is_said = all(choice in self.setting.help for choice in self.kind.choices)
        values = "" if is_said else ", ".join(self.kind.choices)
        return "; ".join(part for part in (self.setting.help, unit, values) if part)

    @property
    def range_text(self) -> str:
        """Which values are possible, in words."""
        chosen = self.setting
        if self.kind.choices:
            known = ", ".join(self.kind.choices)
        elif chosen.limits is None:
            return self.kind.expected
        else:
            known = "{:.12g} to {:.12g}".format(*chosen.limits)
        return f"{known}; {chosen.unset}" if chosen.unset else known


def entries_of(settings: Any, prefix: str = "") -> tuple[Entry, ...]:
    """All settings of a dataclass and of the dataclasses in it, with their defaults.

    Args:
        settings: an instance with defaults.
        prefix: of the paths.
    """
    hints = get_type_hints(type(settings))
    found: list[Entry] = []
    for item in fields(settings):
        value = getattr(settings, item.name)
        chosen = item.metadata.get(METADATA)
        if chosen is not None:
            kind = chosen.kind or (
                one_of(chosen.choices)
                if chosen.choices
                else kind_of_type(hints[item.name], chosen.unit)
            )
            kind = or_word(kind, chosen.unset) if chosen.unset else kind
            name = public_name(item.name, chosen)
            found.append(Entry(prefix + item.name, name, chosen, kind, value))
        elif is_dataclass(value):
            found += entries_of(value, f"{prefix}{item.name}.")
    return tuple(found)
