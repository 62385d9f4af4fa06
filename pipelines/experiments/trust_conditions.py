"""Conditions of the study of trust, from a TOML file.

```toml
[study]
seeds = "0-9"                            # or a list
channels = ["contrast", "gradient"]      # optional: the filter runs with each of them

[scenes]
lobby = "../../out/scene.h5"             # relative to this file

[[condition]]                            # one table for each
name = "control"
scene = "lobby"                          # one of [scenes]
path = "../../sequences/lobby"           # relative to this file; or, instead of it,
data = "lobby_days/control_left"         # relative to the folder that is given with --data
odometry = ["odometry.txt"]              # optional; relative to the data set; "none": no odometry
method = ["filter", "pnp"]               # optional; pnp: features of single images
elsewhere = false                        # optional; true: the images show another place
seeds = "0-4"                            # optional; instead of those of [study]
starts = 5                               # optional: localize each frame alone, with this many
                                         # random starts around its true pose, of the standard
                                         # deviations in [start]

[condition.start]                        # optional: this and other sections as in a config of
start_position_sigma = 0.3               # lfnav localize, for this condition


[filter]                                 # optional: the same sections, for all conditions
particles = 195
```

A condition whose folder ``data`` is absent is skipped, and the table says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.artifacts.settings_file import Choices, possible_choices, read_choices
from pipelines.artifacts.toml_file import read_toml
from pipelines.dataset.dataset import GROUNDTRUTH_FILE
from pipelines.experiments.config_tables import (
    absolute_path,
    checked_list,
    checked_table,
    named_seeds,
    read_seeds,
    refuse_duplicates,
)
from pipelines.localize.config import ENTRIES, overridden, settings_of
from pipelines.localize.settings import METHODS, SECTIONS, LocalizerSettings
from pipelines.localize.stage import NO_ODOMETRY
from pipelines.render.choices import Channels

STUDY_KEYS = ("seeds", "channels")
CONDITION_KEYS = (
    "name",
    "scene",
    "path",
    "data",
    "odometry",
    "method",
    "elsewhere",
    "seeds",
    "starts",
)
MAX_STARTS = 1000


@dataclass(frozen=True)
class Condition:
    """A sequence, and how it is localized.

    Attributes:
        name: name in the table.
        scene: absolute path of the scene model.
        dataset: absolute path of the sequence.
        odometry: absolute paths of TUM files; None: the data set's own; ``NO_ODOMETRY``: none.
        methods: ``filter`` or ``pnp``, or both.
        seeds: seeds of the filter and of the starts.
        settings: the filter's settings.
        is_elsewhere: whether the images show another place than the scene.
        starts: number of starts from which each frame is localized alone; 0: the whole sequence is
            localized.
        channels: image channels, with each of which the filter runs; empty: those of ``settings``.
    """

    name: str
    scene: Path
    dataset: Path
    odometry: tuple[Path | None, ...]
    methods: tuple[str, ...]
    seeds: tuple[int, ...]
    settings: LocalizerSettings
    is_elsewhere: bool
    starts: int
    channels: tuple[Channels, ...]


@dataclass(frozen=True)
class TrustConditions:
    """The conditions of a file.

    Attributes:
        path: the file.
        data: the folder that ``data`` of a condition is relative to; None: there is none.
        conditions: those whose data are present.
        skipped: names of those whose data are absent.
    """

    path: Path
    data: Path | None
    conditions: tuple[Condition, ...]
    skipped: tuple[str, ...]


def read_trust_conditions(
    path: Path,
    *,
    data: Path | None = None,
    scenes: Mapping[str, Path] | None = None,
    seeds: str | None = None,
) -> TrustConditions:
    """Reads and checks the conditions of a study.

    Args:
        path: the TOML file.
        data: folder that ``data`` of a condition is relative to; None: conditions with ``data`` are
            skipped.
        scenes: scene models that replace those of the same name in the file.
        seeds: seeds that replace all in the file: ``"0-19"`` or ``"3,4,8"``.

    Raises:
        InputError: the file is unreadable, or has unknown or missing keys, or values of the wrong
            type or range; or a scene or a sequence is missing.
        OptionError: ``seeds`` has another form, or ``scenes`` a name that the file does not have.
    """
    content = read_toml(path)
    rest = {key: value for key, value in content.items() if key in SECTIONS}
    known = ("study", "scenes", "condition", *SECTIONS)
    checked_table(path, content, "the file", known)
    study = checked_table(path, content.get("study", {}), "[study]", STUDY_KEYS)
    usual = named_seeds(seeds) if seeds is not None else read_seeds(path, "[study]", study)
    channels = _channels(path, study)
    base = possible_choices(path, rest, ENTRIES, settings_of)
    places = _scenes(path, content.get("scenes", {}), scenes or {})
    tables = content.get("condition", [])
    if not isinstance(tables, list) or not tables:
        raise InputError(path, "has no condition", "write [[condition]] and its keys below")
    conditions, skipped = [], []
    for number, table in enumerate(tables, start=1):
        place = f"condition {number}"
        values = checked_table(path, table, place, (*CONDITION_KEYS, *SECTIONS))
        name = _text(path, place, values, "name")
        own = usual if seeds is not None or "seeds" not in values else None
        condition = Condition(
            name=name,
            scene=_scene(path, place, values, places),
            dataset=_dataset(path, place, values, data),
            odometry=(),
            methods=_methods(path, place, values),
            seeds=own or read_seeds(path, place, values),
            settings=_settings(path, place, values, base),
            is_elsewhere=_flag(path, place, values, "elsewhere"),
            starts=_count(path, place, values, "starts"),
            channels=channels,
        )
        condition = replace(condition, odometry=_odometry(path, place, values, condition.dataset))
        _check(path, place, condition)
        if "data" in values and not condition.dataset.is_dir():
            skipped.append(name)
            continue
        _check_inputs(path, place, condition)
        conditions.append(condition)
    refuse_duplicates(path, "two conditions have the same name", [*_names(conditions), *skipped])
    return TrustConditions(path, data, tuple(conditions), tuple(skipped))


def _names(conditions: list[Condition]) -> list[str]:
    return [condition.name for condition in conditions]


def _scenes(path: Path, table: Any, others: Mapping[str, Path]) -> dict[str, Path]:
    if not isinstance(table, dict) or not table:
        raise InputError(path, "has no [scenes]", 'write [scenes] and name = "scene.h5" below')
    for name in others:
        if name not in table:
            raise OptionError(f"scene {quoted(name)} is none of {', '.join(table)} in {path}")
    for name in table:
        _text(path, "[scenes]", table, name)
    return {
        name: others[name].absolute() if name in others else absolute_path(path.parent, value)
        for name, value in table.items()
    }


def _scene(path: Path, place: str, values: Mapping[str, Any], places: Mapping[str, Path]) -> Path:
    name = _text(path, place, values, "scene")
    if name not in places:
        reason = f"{place}: scene {quoted(name)} is unknown"
        raise InputError(path, reason, f"[scenes] has {', '.join(places)}")
    return places[name]


def _dataset(path: Path, place: str, values: Mapping[str, Any], data: Path | None) -> Path:
    if ("path" in values) == ("data" in values):
        raise InputError(path, f"{place} needs either path or data")
    if "path" in values:
        return absolute_path(path.parent, _text(path, place, values, "path"))
    name = _text(path, place, values, "data")
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise InputError(path, f"{place}: data {quoted(name)} leads out of the folder of --data")
    # Without a folder the path does not exist, and the condition is skipped.
    return absolute_path(path.parent / "no folder is given" if data is None else data, name)


def _odometry(
    path: Path, place: str, values: Mapping[str, Any], dataset: Path
) -> tuple[Path | None, ...]:
    if "odometry" not in values:
        return (None,)
    files = checked_list(path, f"{place}: odometry", values["odometry"])
    if not all(isinstance(file, str) and file for file in files):
        raise InputError(path, f"{place}: odometry is not a list of file names")
    refuse_duplicates(path, f"{place}: odometry", files)
    return tuple(
        NO_ODOMETRY if file == str(NO_ODOMETRY) else absolute_path(dataset, file) for file in files
    )


def _methods(path: Path, place: str, values: Mapping[str, Any]) -> tuple[str, ...]:
    methods = checked_list(path, f"{place}: method", values.get("method", METHODS[0]))
    for method in methods:
        if method not in METHODS:
            raise InputError(path, f"{place}: method is not one of {', '.join(METHODS)}")
    refuse_duplicates(path, f"{place}: method", methods)
    return tuple(methods)


def _channels(path: Path, study: Mapping[str, Any]) -> tuple[Channels, ...]:
    if "channels" not in study:
        return ()
    known = {member.value: member for member in Channels}
    names = checked_list(path, "[study] channels", study["channels"])
    if not all(isinstance(name, str) and name in known for name in names):
        raise InputError(path, f"[study] channels are not some of {', '.join(known)}")
    refuse_duplicates(path, "[study] channels", names)
    return tuple(known[name] for name in names)


def _settings(
    path: Path, place: str, values: Mapping[str, Any], base: Choices
) -> LocalizerSettings:
    own = read_choices(path, {key: values[key] for key in SECTIONS if key in values}, ENTRIES)
    try:
        return settings_of(overridden(base, own))
    except OptionError as error:
        raise InputError(path, f"{place}: {error}") from error


def _check(path: Path, place: str, condition: Condition) -> None:
    if not 0 <= condition.starts <= MAX_STARTS:
        raise InputError(path, f"{place}: starts is not between 0 and {MAX_STARTS}")
    if condition.settings.method != METHODS[0]:
        raise InputError(path, f"{place}: its method stands in [filter]", "write method above it")
    if condition.starts and condition.is_elsewhere:
        raise InputError(path, f"{place}: there is no true pose to start around elsewhere")
    if condition.starts and condition.methods != METHODS[:1]:
        raise InputError(path, f"{place}: starts are of no use to pnp")
    if condition.starts and condition.settings.start is not None:
        raise InputError(path, f"{place}: starts are drawn, but [start] has a pose")


def _check_inputs(path: Path, place: str, condition: Condition) -> None:
    if not condition.scene.is_file():
        raise InputError(condition.scene, f"is missing: the scene of {place} in {path}")
    if not condition.dataset.is_dir():
        raise InputError(condition.dataset, f"is missing: the sequence of {place} in {path}")
    has_truth = (condition.dataset / GROUNDTRUTH_FILE).is_file()
    if not has_truth and not condition.is_elsewhere:
        raise InputError(
            condition.dataset / GROUNDTRUTH_FILE,
            f"is missing: {place} in {path} cannot be judged",
            "write elsewhere = true there where its images show another place",
        )


def _text(path: Path, place: str, values: Mapping[str, Any], key: str) -> str:
    value = values.get(key)
    if not isinstance(value, str) or not value.strip():
        reason = f"{key} is missing" if key not in values else f"{key} is not a text"
        raise InputError(path, f"{place}: {reason}")
    return value


def _flag(path: Path, place: str, values: Mapping[str, Any], key: str) -> bool:
    value = values.get(key, False)
    if not isinstance(value, bool):
        raise InputError(path, f"{place}: {key} is not true or false")
    return value


def _count(path: Path, place: str, values: Mapping[str, Any], key: str) -> int:
    value = values.get(key, 0)
    if type(value) is not int:
        raise InputError(path, f"{place}: {key} is not a whole number")
    return value
