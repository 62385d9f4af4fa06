"""Building the scenes of areas: one after the other, in several processes, or on a cluster.

No area needs the photos of the others: a task holds the area's part of the reconstruction, and what
comes back is a summary of the finished file. Finished files are kept in a folder beside the output
until the world is written, under names that change with anything that they depend on: after a kill
the next call builds the areas that are missing.
"""

import dataclasses
import hashlib
import json
import logging
import multiprocessing
import signal
from collections.abc import Container, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.cluster import cluster_at
from pipelines.artifacts.errors import InputError, LfnavError, StageError, quoted
from pipelines.artifacts.processes import die_with_parent
from pipelines.artifacts.provenance import provenance, sha256_of_file, version_of
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.lightfield.areas import Area
from pipelines.lightfield.depth_maps import discard_finished
from pipelines.lightfield.description import LEFT_OUT
from pipelines.lightfield.retrieval_file import load_features, save_features
from pipelines.lightfield.retrieval_index import features_of
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene, save_scene
from pipelines.lightfield.size_budget import size_budget
from pipelines.lightfield.stage import FINISHED_SUFFIX, ModelSettings, build_scene, plain_options
from pipelines.reconstruct.reconstruction import Reconstruction, with_images

# The features of an area's photos lie in a file of their own, beside the area's.
FEATURES_SUFFIX = ".features.h5"
T = TypeVar("T")
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class AreaTask:
    """What is needed to build one area.

    Attributes:
        name: of the area.
        part: its photos and the points that they see.
        own: names of those that are at home in the area.
        settings: of the model.
        path: the file to be written; it is kept where it is there already and whole.
        inputs: hashes of what it is made from, for its provenance.
    """

    name: str
    part: Reconstruction
    own: frozenset[str]
    settings: ModelSettings
    path: Path
    inputs: dict[str, str]


@dataclass(frozen=True)
class BuiltArea:
    """A finished area.

    Attributes:
        path: the file.
        image_names: the photos that it holds.
        bounds: ``(4,)`` of the scene.
        identifier: of the scene.
        sha256: of the file.
        file_bytes: its size.
        memory_bytes: what ``lfnav localize`` holds of it in memory, by default.
        features: file with the local features of its own photos, in the scene's order.
    """

    path: Path
    image_names: tuple[str, ...]
    bounds: FloatArray
    identifier: str
    sha256: str
    file_bytes: int
    memory_bytes: int
    features: Path


def area_task(
    folder: Path, area: Area, source: Reconstruction, settings: ModelSettings
) -> AreaTask:
    """The task of building one area.

    Args:
        folder: for finished files.
        area: which photos it holds.
        source: the whole reconstruction.
        settings: of the model.
    """
    part = _part_of(source, area.views)
    own = [source.image_names[index] for index in area.own.tolist()]
    digest = hashlib.sha256()
    options = plain_options(settings)
    content = [area.name, options, part.image_names, own, part.image_hashes, version_of("lfnav")]
    digest.update(json.dumps(content).encode())
    for array in (part.world_from_camera, part.timestamps, part.points, part.observations):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(repr([part.cameras, part.camera_index.tolist(), part.scale_source]).encode())
    digest.update(repr(part.base_from_camera).encode())
    key = digest.hexdigest()
    path = folder / f"{area.name}.{key[:16]}.h5"
    return AreaTask(area.name, part, frozenset(own), settings, path, {"area": key})


def build_area(task: AreaTask, progress: Progress = no_progress) -> BuiltArea:
    """Builds one area and writes it, or finds it finished.

    Raises:
        LfnavError: as ``build_scene``; the message names the area.
    """
    # Given depth may have changed meanwhile, and taking it is quick.
    scene = None if task.settings.takes_depth else _finished(task.path)
    if scene is None:
        depth_folder = task.path.with_name(task.path.name + FINISHED_SUFFIX)
        try:
            scene = build_scene(task.part, task.settings, progress, depth_folder)
        except StageError as error:
            raise StageError(f"area {task.name}: {error}") from error
        left_out = sorted(set(task.part.image_names) - set(scene.image_names))
        record = provenance("model", plain_options(task.settings), task.inputs)
        save_scene(task.path, scene, overwrite=True, provenance={**record, LEFT_OUT: left_out})
        discard_finished(depth_folder)
    features = task.path.with_name(task.path.stem + FEATURES_SUFFIX)
    own = [index for index, name in enumerate(scene.image_names) if name in task.own]
    if not _has_features(features, len(own)):
        save_features(features, features_of(scene, own))
    budget = size_budget(task.path, scene)
    return BuiltArea(
        task.path,
        scene.image_names,
        scene.bounds,
        scene.identifier,
        sha256_of_file(task.path),
        sum(budget.file.values()),
        sum(budget.memory["localize"].values()),
        features,
    )


def build_areas(
    tasks: Sequence[AreaTask], jobs: int, scheduler: str | None, progress: Progress
) -> list[BuiltArea]:
    """Builds areas in order, or several at once.

    Args:
        tasks: the areas.
        jobs: number of processes; 1: this one, and no other.
        scheduler: address of a Dask scheduler, whose workers build the areas instead; they need
            the same files under the same paths. None: this machine builds them.
        progress: told how far the work is.

    Returns:
        What came of each task, in their order.

    Raises:
        LfnavError: an area cannot be built, or its process ended; those that are finished are kept.
        OptionError: Dask is not installed, or no scheduler answers.
    """
    if scheduler is not None:
        with cluster_at(scheduler) as client:
            # Where a worker is lost, Dask gives its area to another one, which goes on with the
            # depth maps that are finished.
            return _built_by(client.get_executor(pure=False), tasks, progress)
    if jobs == 1:
        return [build_area(task, _naming(task.name, progress)) for task in tasks]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(tasks)), context, _prepare_process) as pool:
        return _built_by(pool, tasks, progress)


def _built_by(pool: Executor, tasks: Sequence[AreaTask], progress: Progress) -> list[BuiltArea]:
    """What the processes of a pool or a cluster make of the tasks, in their order."""
    built: dict[int, BuiltArea] = {}
    waiting: dict[Future[BuiltArea], int] = {}
    try:
        # A process may be lost before all of them have their first task.
        for number, task in enumerate(tasks):
            waiting[pool.submit(build_area, task)] = number
        for done in progress(as_completed(waiting), "areas", len(tasks)):
            built[waiting[done]] = done.result()
    except (LfnavError, KeyboardInterrupt):
        _cancel(waiting)
        raise
    except BrokenProcessPool as error:
        # It ends by itself, and stumbles over futures that were cancelled meanwhile.
        raise _lost("was ended, for lack of memory perhaps", tasks, built) from error
    except Exception as error:
        # A worker of a cluster was lost, or has another lfnav, other files, no room.
        _cancel(waiting)
        how = f"failed ({quoted(f'{type(error).__name__}: {error}')})"
        raise _lost(how, tasks, built) from error
    return [built[number] for number in range(len(tasks))]


def _lost(how: str, tasks: Sequence[AreaTask], built: Container[int]) -> StageError:
    missing = ", ".join(task.name for number, task in enumerate(tasks) if number not in built)
    return StageError(
        f"a process that built an area {how}; finished areas are kept, missing are {missing}: "
        "run it again, with fewer processes at once"
    )


def _cancel(futures: Iterable[Future[BuiltArea]]) -> None:
    """Takes back what has not begun."""
    for future in futures:
        future.cancel()


def _prepare_process() -> None:
    """In a process of the pool: the parent alone hears Ctrl-C, and the end is a common one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with_parent()


def _naming(area: str, progress: Progress) -> Progress:
    """Progress that says which area it is about."""

    def named(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
        return progress(items, f"{area}: {description}", total)

    return named


def _part_of(source: Reconstruction, views: IntArray) -> Reconstruction:
    """The photos of an area, and the points that one of them sees."""
    part = with_images(source, views)
    seen = np.unique(part.observations[:, 0])
    observations = part.observations.copy()
    observations[:, 0] = np.searchsorted(seen, observations[:, 0])
    used = np.unique(part.camera_index)
    fields: dict[str, Any] = {
        "points": part.points[seen],
        "observations": observations,
        "cameras": tuple(part.cameras[int(index)] for index in used),
        "camera_index": np.searchsorted(used, part.camera_index),
        "dropped": {},
    }
    for name in ("point_colors", "point_errors"):
        values = getattr(part, name)
        fields[name] = values[seen] if len(values) else values
    return dataclasses.replace(part, **fields)


def _finished(path: Path) -> Scene | None:
    """A file that an earlier call finished; None where there is none that is whole."""
    if not path.is_file():
        return None
    try:
        scene = load_scene(path)
    except InputError:
        return None
    _log.info("%s was finished before", path.name)
    return scene


def _has_features(path: Path, photos: int) -> bool:
    """Whether an earlier call finished the features of so many photos."""
    if not path.is_file():
        return False
    try:
        load_features(path, photos)
    except InputError:
        return False
    return True
