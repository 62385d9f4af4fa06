"""The localization's settings as a TOML file, and how it and the command line go together.

A file may hold any part of the settings. What it leaves out has the default of the strategy: the
paper's filter (``condensation``) differs from the others in how it compares, resamples and decides.
``settings_text`` writes all of them; reading that back gives the same settings.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.artifacts.toml_file import read_toml, type_name
from pipelines.localize.config_keys import KEYS, SECTIONS
from pipelines.localize.likelihood import LIKELIHOODS
from pipelines.localize.motion import MotionModel
from pipelines.localize.settings import LocalizerSettings, strategy_defaults

# Field of ``Key.field`` -> value, of those settings that somebody has chosen.
Choices = Mapping[str, Any]

_HEAD = (
    "# Settings of lfnav localize; give them back with --config FILE.",
    "# Keys that are left out have their defaults. Angles are in degrees where the name ends in",
    "# _deg; all other units are metres, radians and pixels.",
)


def effective_settings(path: Path | None, options: Choices) -> LocalizerSettings:
    """Settings from a file and from options: options win over the file, the file over defaults.

    Args:
        path: a config file; None: there is none.
        options: settings chosen elsewhere.

    Raises:
        InputError: the file cannot be read, or has unknown keys or impossible values.
        OptionError: an option's value is impossible, by itself or together with the file's.
    """
    chosen: Choices = {} if path is None else read_choices(path, read_toml(path))
    if path is not None:
        check_choices(path, chosen)
    return settings_of(overridden(chosen, options))


def read_choices(path: Path, content: Mapping[str, Any]) -> Choices:
    """The settings that a file's content chooses; the values are of the right type, not more.

    Raises:
        InputError: unknown sections or keys, or values of the wrong type.
    """
    for section, table in content.items():
        if section not in SECTIONS:
            raise InputError(
                path, f"unknown key {quoted(section)}", f"known are {_named_sections()}"
            )
        if not isinstance(table, dict):
            raise InputError(
                path, f"{section} is {type_name(table)}, expected a table", f"write [{section}]"
            )
        known = [key.name for key in KEYS if key.section == section]
        for name in table:
            # A misspelt key would otherwise be ignored in silence.
            if name not in known:
                reason = f"unknown key {quoted(name)} in [{section}]"
                raise InputError(path, reason, f"known are {', '.join(known)}")
    chosen = {}
    for key in KEYS:
        if key.name in content.get(key.section, {}):
            try:
                chosen[key.field] = key.parsed(content[key.section][key.name])
            except ValueError as error:
                raise InputError(path, f"{key.place} {error}") from error
    return chosen


def check_choices(path: Path, chosen: Choices) -> None:
    """Finds impossible values, and the key that is to blame.

    Raises:
        InputError: the choices do not make settings.
    """
    reason = _refusal(chosen)
    if reason is None:
        return
    # Wrong by itself; else, what the others would get along without.
    alone = [name for name in chosen if _refusal({name: chosen[name]}) == reason]
    needless = [
        name
        for name in chosen
        if _refusal({other: chosen[other] for other in chosen if other != name}) is None
    ]
    places = {key.field: key.place for key in KEYS}
    blamed = [places[name] for name in (*alone, *needless)]
    raise InputError(path, f"{blamed[0]}: {reason}" if blamed else reason)


def overridden(chosen: Choices, options: Choices) -> Choices:
    """Choices with others laid over them.

    Another kind of comparison comes with its own sharpness. Another width takes the widths that
    have to be smaller or larger along with it.
    """
    both = {**chosen, **options}
    if both.get("likelihood.cost") != chosen.get("likelihood.cost"):
        kept = [name for name in chosen if name.startswith("likelihood.") and name not in options]
        both = {name: value for name, value in both.items() if name not in kept}
    if "fine_width" in options:
        width, defaults = options["fine_width"], LocalizerSettings()
        coarse = both.get("coarse_width", defaults.coarse_width)
        refine = both.get("refine_width", defaults.refine_width)
        both["coarse_width"] = max(4, min(coarse, width))
        both["refine_width"] = max(refine, width) if refine else refine
    return both


def settings_of(chosen: Choices) -> LocalizerSettings:
    """The settings with these choices, and defaults for the others.

    Raises:
        OptionError: values that make no sense.
    """
    values = strategy_defaults(chosen.get("strategy", LocalizerSettings.strategy))
    parts: dict[str, dict[str, Any]] = {"motion": {}, "likelihood": {}}
    for field, value in chosen.items():
        part, _, name = field.rpartition(".")
        (parts[part] if part else values)[name] = value
    usual = values.get("likelihood", LocalizerSettings.likelihood)
    cost = parts["likelihood"].get("cost", usual.cost)
    usual = LIKELIHOODS[cost.name.lower()] if cost is not usual.cost else usual
    values["likelihood"] = replace(usual, **parts["likelihood"])
    values["motion"] = MotionModel(**parts["motion"])
    return LocalizerSettings(**values)


def settings_text(settings: LocalizerSettings) -> str:
    """The settings as TOML, complete, with units and meanings as comments."""
    lines = list(_HEAD)
    for section, meaning in SECTIONS.items():
        lines += ["", f"[{section}]  # {meaning}"]
        lines += [key.line(settings) for key in KEYS if key.section == section]
    return "\n".join(lines) + "\n"


def _refusal(chosen: Choices) -> str | None:
    """Why choices are impossible; None where they are not."""
    try:
        settings_of(chosen)
    except OptionError as error:
        return str(error)
    return None


def _named_sections() -> str:
    return ", ".join(f"[{section}]" for section in SECTIONS)
