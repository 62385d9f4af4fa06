"""The settings of a docking as a TOML file: those of the localization, and ``[dock]``."""

from pathlib import Path

from pipelines.artifacts import settings_file
from pipelines.artifacts.setting import entries_of
from pipelines.artifacts.settings_file import Choices, possible_choices
from pipelines.artifacts.toml_file import read_toml
from pipelines.dock.settings import SECTIONS, DockSettings
from pipelines.localize import config, settings

DOCK_ENTRIES = entries_of(DockSettings())
ENTRIES = (*config.ENTRIES, *DOCK_ENTRIES)
ALL_SECTIONS = {**settings.SECTIONS, **SECTIONS}

Both = tuple[settings.LocalizerSettings, DockSettings]


def effective_settings(path: Path | None, options: Choices) -> Both:
    """The filter's and the docking's settings: options win over the file, it over the defaults.

    Args:
        path: a config file; None: there is none.
        options: settings chosen elsewhere.

    Raises:
        InputError: the file cannot be read, or has unknown keys or impossible values.
        OptionError: an option's value is impossible, by itself or together with the file's.
    """
    chosen: Choices = {}
    if path is not None:
        chosen = possible_choices(path, read_toml(path), ENTRIES, settings_of)
    return settings_of(config.overridden(chosen, options))


def settings_of(chosen: Choices) -> Both:
    """The settings with these choices, and defaults for the others.

    Raises:
        OptionError: values that make no sense.
    """
    own = {entry.path for entry in DOCK_ENTRIES}
    docking = {path: value for path, value in chosen.items() if path in own}
    others = {path: value for path, value in chosen.items() if path not in own}
    return config.settings_of(others), DockSettings(**docking)


def settings_text(both: Both) -> str:
    """The settings as TOML, complete, with meanings, units and possible values as comments."""
    own = {entry.path for entry in DOCK_ENTRIES}
    return settings_file.settings_text(
        config.HEAD,
        ALL_SECTIONS,
        ENTRIES,
        lambda entry: entry.value_in(both[entry.path in own]),
    )
