"""What a sweep runs: data sets, seeds and settings, from a TOML file.

```toml
[sweep]
seeds = "0-19"                          # or a list: [0, 1, 5]
method = ["filter", "pnp"]              # optional, as are the next five; a list or one value
strategy = ["mixture", "condensation"]
proposal = ["retrieval", "both"]
cost = ["robust", "squared"]
pixel_subsampling = [1, 5]
particles = [50, 195, 1000]

[[dataset]]                             # one table for each
name = "lobby"                          # optional: what tables and figures call it
scene = "out/scene.h5"                  # relative to this file
path = "drives/lobby"                   # the robot's data set, with groundtruth.txt; likewise
odometry = ["odometry.txt", "none"]     # optional; relative to the data set; "none": do without

[filter]                                # these and the rest as in a config of lfnav localize
resampling = "systematic"
```

Every data set is run with each of its odometry files, each seed, and each combination of settings,
as far as they have a meaning: method ``pnp`` has neither strategy nor particles, likelihood or
proposal, and only the strategy ``mixture`` takes proposals.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.settings_file import (
    Choices,
    name_in,
    possible_choices,
)
from pipelines.artifacts.toml_file import read_toml
from pipelines.experiments.config_tables import (
    MAX_RUNS,
    absolute_path,
    checked_list,
    checked_table,
    named_seeds,
    read_seeds,
    refuse_duplicates,
)
from pipelines.localize.config import ENTRIES, entry_named, overridden, settings_of
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.stage import NO_ODOMETRY

DATASET_KEYS = ("name", "scene", "path", "odometry")
NO_CHOICES: Choices = MappingProxyType({})
# What [sweep] may vary: what tables have a column for.
VARIED = tuple(
    entry_named(name)
    for name in ("method", "strategy", "proposal", "cost", "pixel_subsampling", "particles")
)
# Names of today, which errors tell, and those of earlier versions.
SWEEP_KEYS = ("seeds", *(entry.name for entry in VARIED))
FORMER_KEYS = tuple(former for entry in VARIED for former in entry.setting.former)


@dataclass(frozen=True)
class SweepDataset:
    """A robot's drive and the scene that it is localized in.

    Attributes:
        name: what tables and figures call it.
        scene: scene model, absolute.
        path: the data set, absolute.
        odometry: TUM files, absolute; None: the data set's own ``odometry.txt``, if it has one;
            ``NO_ODOMETRY``, the one relative path: none, even if it has.
    """

    name: str
    scene: Path
    path: Path
    odometry: tuple[Path | None, ...]


@dataclass(frozen=True)
class SweepConfig:
    """All that is run: the product of the three.

    Attributes:
        datasets: at least one.
        seeds: of the filter.
        settings: of the filter.
    """

    datasets: tuple[SweepDataset, ...]
    seeds: tuple[int, ...]
    settings: tuple[LocalizerSettings, ...]


def read_sweep_config(
    path: Path, seeds: str | None = None, options: Choices = NO_CHOICES
) -> SweepConfig:
    """Reads and checks the config of a sweep.

    Args:
        path: the TOML file.
        seeds: takes the place of those in the file: ``"0-19"`` or ``"3,4,8"``.
        options: settings of all runs; they win over those of the file.

    Raises:
        InputError: unreadable; unknown or missing keys; values of the wrong type, impossible ones,
            or more runs than anybody wants.
        OptionError: ``seeds`` names no seeds, or ``options`` something that the file varies.
    """
    content = read_toml(path)
    sweep = _sweep_table(path, content.get("sweep", {}))
    tables = content.get("dataset", [])
    if not isinstance(tables, list) or not tables:
        raise InputError(path, "names no data set", "write [[dataset]] and its keys below")
    datasets = tuple(
        _dataset(path, f"data set {number}", table) for number, table in enumerate(tables, start=1)
    )
    names = [dataset.name for dataset in datasets]
    refuse_duplicates(path, "two data sets have the same name", names)
    rest = {key: value for key, value in content.items() if key not in {"sweep", "dataset"}}
    chosen_seeds = read_seeds(path, "[sweep]", sweep) if seeds is None else named_seeds(seeds)
    config = SweepConfig(datasets, chosen_seeds, _settings(path, rest, sweep, options))
    runs = len(config.seeds) * len(config.settings) * sum(len(data.odometry) for data in datasets)
    if runs > MAX_RUNS:
        raise InputError(path, f"asks for {runs} runs; at most {MAX_RUNS} are made")
    return config


def _sweep_table(path: Path, table: Any) -> Mapping[str, Any]:
    """The table ``[sweep]``, with the names of today."""
    understood = SWEEP_KEYS
    if isinstance(table, dict):
        understood += tuple(former for former in FORMER_KEYS if former in table)
    checked = dict(checked_table(path, table, "[sweep]", understood))
    for entry in VARIED:
        name = name_in(path, checked, entry, "[sweep]")
        if name is not None:
            checked[entry.name] = checked.pop(name)
    return checked


def _settings(
    path: Path, rest: Mapping[str, Any], sweep: Mapping[str, Any], options: Choices
) -> tuple[LocalizerSettings, ...]:
    """Every combination of what is varied, on top of what is chosen for all."""
    base = possible_choices(path, rest, ENTRIES, settings_of)
    base = overridden(base, options)
    varied: dict[str, list[Any]] = {}
    for entry in VARIED:
        name = entry.name
        if name not in sweep:
            continue
        if entry.path in options:
            raise OptionError(f"{name} is given, but {path} varies it: leave it out here or there")
        values = checked_list(path, f"[sweep] {name}", sweep[name])
        try:
            varied[entry.path] = [entry.parsed(value) for value in values]
        except ValueError as error:
            raise InputError(path, f"[sweep] {name} {error}") from error
        refuse_duplicates(path, f"[sweep] {name}", varied[entry.path])
    combinations = []
    for combination in product(*varied.values()):
        chosen = _with_a_meaning(base, dict(zip(varied, combination, strict=True)))
        try:
            combinations.append(settings_of(overridden(base, chosen)))
        except OptionError as error:
            raise InputError(path, f"[sweep]: {error}") from error
    for entry in VARIED:
        used = {entry.value_in(settings) for settings in combinations}
        if len(varied.get(entry.path, ())) > 1 and len(used) == 1:
            reason = f"[sweep] {entry.name}: none of the runs has a use for it"
            raise InputError(path, reason, "leave it out")
    return tuple(dict.fromkeys(combinations))


def _with_a_meaning(base: Choices, varied: Choices) -> Choices:
    """What is varied without that of which such a run makes no use."""
    chosen = {**base, **varied}
    if chosen.get("method") == "pnp":
        return {field: value for field, value in varied.items() if field == "method"}
    if chosen.get("strategy", LocalizerSettings.strategy) != "mixture":
        return {field: value for field, value in varied.items() if field != "proposal"}
    return varied


def _dataset(path: Path, place: str, table: Any) -> SweepDataset:
    values = checked_table(path, table, place, DATASET_KEYS)
    for key in ("scene", "path"):
        if key not in values:
            raise InputError(path, f"{place}: {key} is missing")
    for key in ("name", "scene", "path"):
        if not isinstance(values.get(key, "-"), str) or not values.get(key, "-").strip():
            raise InputError(path, f"{place}: {key} is not a text")
    scene, root = (absolute_path(path.parent, values[key]) for key in ("scene", "path"))
    odometry: tuple[Path | None, ...] = (None,)
    if "odometry" in values:
        files = checked_list(path, f"{place}: odometry", values["odometry"])
        if not all(isinstance(file, str) and file for file in files):
            raise InputError(path, f"{place}: odometry is not a list of file names")
        refuse_duplicates(path, f"{place}: odometry", files)
        odometry = tuple(
            NO_ODOMETRY if file == str(NO_ODOMETRY) else absolute_path(root, file) for file in files
        )
    return SweepDataset(values.get("name", "/".join(root.parts[-2:])), scene, root, odometry)
