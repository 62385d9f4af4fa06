"""The localization's settings as a TOML file, and how it and the command line go together.

A file may hold any part of the settings. What it leaves out has the default of the strategy: the
paper's filter (``condensation``) differs from the others in how it compares, resamples and decides.
``settings_text`` writes all of them; reading that back gives the same settings.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

from pipelines.artifacts import settings_file
from pipelines.artifacts.setting import Entry, entries_of
from pipelines.artifacts.settings_file import Choices, possible_choices
from pipelines.artifacts.toml_file import read_toml
from pipelines.localize.likelihood import LIKELIHOODS
from pipelines.localize.settings import SECTIONS, LocalizerSettings, MotionModel, strategy_defaults

ENTRIES = entries_of(LocalizerSettings())
# Sections of files of ``lfnav dock`` that are no business of the localization.
FOREIGN_SECTIONS = ("dock",)

HEAD = (
    "Settings; give them back with --config FILE. Every key is an option of that name, too.",
    "Keys that are left out have their defaults. Angles are in degrees.",
)


def entry_named(name: str) -> Entry:
    """The setting of a name, or of a former name.

    Raises:
        KeyError: there is none.
    """
    for entry in ENTRIES:
        if name in entry.names:
            return entry
    raise KeyError(name)


def effective_settings(path: Path | None, options: Choices) -> LocalizerSettings:
    """Settings from a file and from options: options win over the file, the file over defaults.

    Args:
        path: a config file; None: there is none.
        options: settings chosen elsewhere.

    Raises:
        InputError: the file cannot be read, or has unknown keys or impossible values.
        OptionError: an option's value is impossible, by itself or together with the file's.
    """
    chosen: Choices = {}
    if path is not None:
        content = read_toml(path)
        own = {name: table for name, table in content.items() if name not in FOREIGN_SECTIONS}
        chosen = possible_choices(path, own, ENTRIES, settings_of)
    return settings_of(overridden(chosen, options))


def overridden(chosen: Choices, options: Choices) -> Choices:
    """Choices with others laid over them.

    Another cost comes with its own inverse temperature. Another width takes the widths that have to
    be smaller or larger along with it.
    """
    both = {**chosen, **options}
    if both.get("likelihood.cost") != chosen.get("likelihood.cost"):
        kept = [name for name in chosen if name.startswith("likelihood.") and name not in options]
        both = {name: value for name, value in both.items() if name not in kept}
    if "fine_width" in options:
        width, defaults = options["fine_width"], LocalizerSettings()
        if "coarse_width" not in options:
            coarse = both.get("coarse_width", defaults.coarse_width)
            both["coarse_width"] = max(4, min(coarse, width))
        if "refine_width" not in options:
            refine = both.get("refine_width", defaults.refine_width)
            both["refine_width"] = max(refine, width) if refine else refine
    return both


def settings_of(chosen: Choices) -> LocalizerSettings:
    """The settings with these choices, and defaults for the others.

    Raises:
        OptionError: values that make no sense.
    """
    values = strategy_defaults(chosen.get("strategy", LocalizerSettings.strategy))
    parts: dict[str, dict[str, Any]] = {"motion": {}, "likelihood": {}}
    for path, value in chosen.items():
        part, _, name = path.rpartition(".")
        (parts[part] if part else values)[name] = value
    usual = values.get("likelihood", LocalizerSettings.likelihood)
    cost = parts["likelihood"].get("cost", usual.cost)
    usual = LIKELIHOODS[cost.name.lower()] if cost is not usual.cost else usual
    values["likelihood"] = replace(usual, **parts["likelihood"])
    values["motion"] = MotionModel(**parts["motion"])
    return LocalizerSettings(**values)


def settings_text(settings: LocalizerSettings) -> str:
    """The settings as TOML, complete, with meanings, units and possible values as comments."""
    return settings_file.settings_text(
        HEAD, SECTIONS, ENTRIES, lambda entry: entry.value_in(settings)
    )
