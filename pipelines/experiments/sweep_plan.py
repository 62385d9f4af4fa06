"""The runs of a sweep by its config, each with a key that is a hash of all its inputs."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path

from pipelines.artifacts.provenance import sha256_of_bytes, version_of
from pipelines.artifacts.stages import Progress
from pipelines.dataset.dataset import ODOMETRY_FILE, Dataset, load_dataset
from pipelines.experiments.sweep_config import SweepConfig, SweepDataset
from pipelines.experiments.sweep_inputs import dataset_hash, odometry_hash, scene_hash
from pipelines.experiments.sweep_run import Setup, SweepRun
from pipelines.lightfield.scene_file import load_scene
from pipelines.localize.likelihood import LIKELIHOODS, Likelihood
from pipelines.localize.odometry import images_with_odometry
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.stage import NO_ODOMETRY
from pipelines.render.devices import resolved_device

# Increase this when stored results are no longer what would be computed.
RESULTS_VERSION = 4


def planned_runs(config: SweepConfig, progress: Progress) -> tuple[SweepRun, ...]:
    """All runs of a config, those of one line of the table next to each other.

    Args:
        config: of the sweep.
        progress: wraps the loop over data sets to report progress.

    Raises:
        InputError: a scene or a data set cannot be used, or has no ground truth.
    """
    runs: list[SweepRun] = []
    for dataset in progress(config.datasets, "inputs", len(config.datasets)):
        # What would fail in every run fails now.
        load_scene(dataset.scene)
        hashes = {"scene": scene_hash(dataset.scene)}
        for odometry in dataset.odometry:
            loaded = _checked_dataset(dataset, odometry)
            for settings in config.settings:
                images_with_odometry(loaded, settings, odometry or dataset.path / ODOMETRY_FILE)
            if "dataset" not in hashes:
                hashes["dataset"] = dataset_hash(loaded)
            inputs = dict(hashes)
            if loaded.odometry is not None:
                inputs["odometry"] = odometry_hash(dataset.path, odometry)
            runs += _runs(config, dataset, odometry, inputs)
    return tuple(runs)


def _checked_dataset(dataset: SweepDataset, odometry: Path | None) -> Dataset:
    """A data set with one of its odometry files.

    Raises:
        InputError: it cannot be used, or has no ground truth.
    """
    is_without = odometry == NO_ODOMETRY
    loaded = load_dataset(
        dataset.path, odometry=None if is_without else odometry, reads_odometry=not is_without
    )
    loaded.true_poses("is missing: a sweep measures errors against it")
    return loaded


def _runs(
    config: SweepConfig, dataset: SweepDataset, odometry: Path | None, inputs: Mapping[str, str]
) -> Iterator[SweepRun]:
    """The runs of all settings and seeds on a data set with one odometry file."""
    for chosen, seed in product(config.settings, config.seeds):
        # There is one process a processor. The number of threads does not change results. The
        # device does, by rounding: all runs of a sweep have the same.
        settings = replace(chosen, threads=1, device=resolved_device(chosen.device))
        # PnP uses single images: with any odometry file it is the same run.
        uses_odometry = odometry != NO_ODOMETRY and settings.method != "pnp"
        used = {name: of for name, of in inputs.items() if uses_odometry or name != "odometry"}
        yield SweepRun(
            setup=_setup(dataset, odometry, settings, inputs),
            scene=dataset.scene,
            dataset=dataset.path,
            odometry=odometry if uses_odometry else None,
            uses_odometry=uses_odometry,
            settings=settings,
            seed=seed,
            inputs=used,
            key=run_key(settings, seed, used),
        )


def run_key(settings: LocalizerSettings, seed: int, inputs: Mapping[str, str]) -> str:
    """SHA-256 of everything that a run's result depends on except for the source code.

    Args:
        settings: the filter's settings.
        seed: of the filter's random numbers.
        inputs: name of an input -> SHA-256 of its content.
    """
    content = {
        "results": RESULTS_VERSION,
        "lfnav": version_of("lfnav"),
        "settings": settings.to_dict(),
        "seed": seed,
        "inputs": dict(inputs),
    }
    return sha256_of_bytes(json.dumps(content, sort_keys=True).encode("utf-8"))


def _setup(
    dataset: SweepDataset,
    odometry: Path | None,
    settings: LocalizerSettings,
    inputs: Mapping[str, str],
) -> Setup:
    """The line of the table that a run belongs to."""
    if odometry is not None:
        name = odometry.name
    else:
        name = ODOMETRY_FILE if "odometry" in inputs else "none"
    if settings.method == "pnp":
        return Setup(dataset.name, name, settings.method, None, None, None, None)
    return Setup(
        dataset=dataset.name,
        odometry=name,
        method=settings.method,
        strategy=settings.strategy,
        proposal=settings.proposal if settings.strategy == "mixture" else None,
        likelihood=_name_of(settings.likelihood),
        particles=settings.particles,
    )


def _name_of(likelihood: Likelihood) -> str:
    """A likelihood's name in tables: its cost, and its pixel subsampling unless that is usual."""
    name = likelihood.cost.name.lower()
    step = likelihood.pixel_subsampling
    if step == LIKELIHOODS[name].pixel_subsampling:
        return name
    return f"{name}, all pixels" if step == 1 else f"{name}, pixel subsampling {step}"
