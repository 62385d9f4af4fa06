"""Settings as a TOML file: read with one line for what is wrong, and written with comments.

A file may hold any part of the settings. Names of earlier versions are understood, and a warning
says what they are called now.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.artifacts.setting import Entry
from pipelines.artifacts.toml_file import type_name

logger = logging.getLogger(__name__)

# ``Entry.path`` -> value, of those settings that somebody has chosen.
Choices = Mapping[str, Any]


def read_choices(path: Path, content: Mapping[str, Any], entries: Sequence[Entry]) -> Choices:
    """The settings that a file's content chooses; the values are of the right kind, not more.

    Args:
        path: of the file, for errors.
        content: its tables.
        entries: the settings that there are.

    Raises:
        InputError: unknown sections or keys, a key beside its former name, or values of the wrong
            type.
    """
    sections = tuple(dict.fromkeys(entry.setting.section for entry in entries))
    for section, table in content.items():
        if section not in sections:
            known = ", ".join(f"[{section}]" for section in sections)
            raise InputError(path, f"unknown key {quoted(section)}", f"known are {known}")
        if not isinstance(table, dict):
            raise InputError(
                path, f"{section} is {type_name(table)}, expected a table", f"write [{section}]"
            )
        own = [entry for entry in entries if entry.setting.section == section]
        understood = {name for entry in own for name in entry.names}
        for name in table:
            # A misspelt key would otherwise be ignored in silence.
            if name not in understood:
                known = ", ".join(entry.name for entry in own)
                reason = f"unknown key {quoted(name)} in [{section}]"
                raise InputError(path, reason, f"known are {known}")
    chosen = {}
    for entry in entries:
        table = content.get(entry.setting.section, {})
        name = name_in(path, table, entry, f"[{entry.setting.section}]")
        if name is None:
            continue
        try:
            chosen[entry.path] = entry.parsed(table[name])
        except ValueError as error:
            raise InputError(path, f"[{entry.setting.section}] {name} {error}") from error
    return chosen


def possible_choices(
    path: Path,
    content: Mapping[str, Any],
    entries: Sequence[Entry],
    build: Callable[[Choices], object],
) -> Choices:
    """The settings that a file's content chooses, which together make settings.

    Args:
        path: of the file, for errors.
        content: its tables.
        entries: the settings that there are.
        build: makes settings of choices; raises OptionError.

    Raises:
        InputError: as ``read_choices`` and ``check_choices`` say.
    """
    chosen = read_choices(path, content, entries)
    check_choices(path, chosen, entries, build)
    return chosen


def name_in(path: Path, table: Mapping[str, Any], entry: Entry, place: str) -> str | None:
    """The key of a table that holds a setting, by its name or a former one; None: it has none.

    Raises:
        InputError: there are two of them.
    """
    named = [name for name in entry.names if name in table]
    if not named:
        return None
    if len(named) > 1:
        reason = f"{place} {named[1]} is the former name of {named[0]}, which is there too"
        raise InputError(path, reason, "leave it out")
    if named[0] != entry.name:
        logger.warning("%s: %s %s is now called %s", path, place, named[0], entry.name)
    return named[0]


def check_choices(
    path: Path, chosen: Choices, entries: Sequence[Entry], build: Callable[[Choices], object]
) -> None:
    """Finds impossible values, and the key that is to blame.

    Args:
        path: of the file that chooses them.
        chosen: the choices.
        entries: the settings that there are.
        build: makes settings of choices; raises OptionError.

    Raises:
        InputError: the choices do not make settings.
    """

    def refusal(some: Choices) -> str | None:
        try:
            build(some)
        except OptionError as error:
            return str(error)
        return None

    reason = refusal(chosen)
    if reason is None:
        return
    # Wrong by itself; else, what the others would get along without.
    alone = [name for name in chosen if refusal({name: chosen[name]}) == reason]
    needless = [
        name
        for name in chosen
        if refusal({other: chosen[other] for other in chosen if other != name}) is None
    ]
    places = {entry.path: entry.place for entry in entries}
    blamed = [places[name] for name in (*alone, *needless)]
    raise InputError(path, f"{blamed[0]}: {reason}" if blamed else reason)


def settings_text(
    head: Sequence[str],
    sections: Mapping[str, str],
    entries: Sequence[Entry],
    value_of: Callable[[Entry], Any],
) -> str:
    """Settings as TOML, complete, with meanings, units and possible values as comments.

    Args:
        head: lines of comment at the top.
        sections: section -> its meaning.
        entries: the settings that there are.
        value_of: the value of a setting.
    """
    lines = [f"# {line}" for line in head]
    for section, meaning in sections.items():
        lines += ["", f"[{section}]  # {meaning}"]
        for entry in entries:
            if entry.setting.section == section:
                value = entry.text_of(value_of(entry))
                lines.append(f"{entry.name} = {value}  # {entry.comment}")
    return "\n".join(lines) + "\n"


def with_current_names(
    values: Mapping[str, Any], entries: Sequence[Entry], part: str = ""
) -> dict[str, Any]:
    """Settings as a file of an earlier version kept them, with the names that they have now.

    Args:
        values: attribute -> value as JSON, and dataclass -> the same of its own.
        entries: the settings that there are.
        part: path of the dataclass whose attributes these are.
    """
    current = {
        name: with_current_names(value, entries, f"{part}{name}.")
        if isinstance(value, Mapping)
        else value
        for name, value in values.items()
    }
    for entry in entries:
        attribute = entry.path.removeprefix(part)
        if not entry.path.startswith(part) or "." in attribute:
            continue
        for former in entry.setting.former:
            if former in current and attribute not in current:
                current[attribute] = current.pop(former)
        value = current.get(attribute)
        if isinstance(value, str):
            current[attribute] = entry.setting.former_values.get(value, value)
    return current
