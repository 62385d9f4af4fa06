"""The stage ``model --areas``: a reconstruction in, a world out: a light field for each area."""

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arguments import (
    PathLike,
    check_fields,
    checked_instance,
    checked_number,
    checked_path,
)
from pipelines.artifacts.atomic import atomic_folder, check_output
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.kinds import AREA_FOLDER, BUILDING_SUFFIX, WORLD_FILE
from pipelines.artifacts.provenance import provenance, sha256_of_file
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.lightfield.area_build import BuiltArea, area_task, build_areas
from pipelines.lightfield.area_file import read_area_file
from pipelines.lightfield.area_recognition import AreaRecognition, learn_recognition
from pipelines.lightfield.areas import (
    MIN_AREA_VIEWS,
    Division,
    divide_by_covisibility,
    divide_by_rectangles,
)
from pipelines.lightfield.retrieval_file import load_features
from pipelines.lightfield.retrieval_index import PhotoFeatures
from pipelines.lightfield.size_budget import view_memory
from pipelines.lightfield.stage import ModelSettings, plain_options
from pipelines.lightfield.stereo_depth import DepthSettings
from pipelines.lightfield.world_description import WorldSummary
from pipelines.lightfield.world_file import (
    World,
    WorldArea,
    area_path,
    recognition_bytes,
    save_index,
)
from pipelines.reconstruct.reconstruction import (
    DESCRIPTION_NAME,
    Reconstruction,
    load_reconstruction,
)

AUTOMATIC = "auto"
DEFAULT_AREA_VIEWS = 150
MAX_JOBS = 1024


@dataclass(frozen=True)
class AreaSettings:
    """How a world is divided.

    Attributes:
        file: rectangles and names, an ``areas.toml``; None: areas are found.
        views: the most photos of an area that is found; None: ``DEFAULT_AREA_VIEWS``, unless
            ``megabytes`` is given.
        megabytes: instead of this what such an area may take in memory as ``lfnav localize`` opens
            it.
        jobs: number of processes that build areas at once.

    Raises:
        OptionError: bounds that contradict each other, are too small, or do not go with a file.
    """

    file: Path | None = None
    views: int | None = None
    megabytes: float | None = None
    jobs: int = 1

    def __post_init__(self) -> None:
        check_fields(self)
        if self.views is not None and self.megabytes is not None:
            raise OptionError("--area-views and --area-memory exclude each other")
        if self.file is not None and (self.views is not None or self.megabytes is not None):
            raise OptionError("--area-views and --area-memory go with --areas auto, not a file")
        if self.views is not None:
            checked_number(self.views, "--area-views", MIN_AREA_VIEWS, whole=True)
        if self.megabytes is not None:
            checked_number(self.megabytes, "--area-memory", 0.0, 1e9)
        checked_number(self.jobs, "--jobs", 1, MAX_JOBS, whole=True)


def model_world(
    reconstruction: PathLike,
    output: PathLike,
    areas: AreaSettings | None = None,
    settings: ModelSettings | None = None,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> WorldSummary:
    """Divides a reconstruction into areas, builds the light field of each, and writes the world.

    Args:
        reconstruction: folder made by ``reconstruct``.
        output: the folder to be written.
        areas: how it is divided; None: the defaults.
        settings: of each area's model; None: the defaults. ``max_views`` holds for each area.
        overwrite: whether an existing world may be replaced, as a whole.
        progress: told how far the work is.

    Returns:
        What a person or a program wants to know of it.

    Raises:
        InputError: the reconstruction, its photos or the file of areas cannot be used, or the
            output not be written.
        StageError: an area cannot be built.
        OptionError: an impossible setting, or an argument of another type.
    """
    reconstruction = checked_path(reconstruction, "the reconstruction's path")
    output = checked_path(output, "the world's path")
    areas = AreaSettings() if areas is None else areas
    settings = ModelSettings() if settings is None else settings
    checked_instance(areas, "areas", AreaSettings)
    checked_instance(settings, "settings", ModelSettings)
    check_output(output, overwrite, WORLD_FILE)
    source = load_reconstruction(reconstruction)
    division, record = _divided(source, areas, settings)
    building = output.with_name(output.name + BUILDING_SUFFIX)
    tasks = [area_task(building, a.name, source, a.views, settings) for a in division.areas]
    built = build_areas(tasks, areas.jobs, progress)
    inputs = {DESCRIPTION_NAME: sha256_of_file(reconstruction / DESCRIPTION_NAME)}
    world = _index(
        source, division, built, record, provenance("model", plain_options(settings), inputs)
    )
    recognition = _recognition(world, built, progress)
    with atomic_folder(output, overwrite, WORLD_FILE) as folder:
        (folder / AREA_FOLDER).mkdir()
        for area, scene in zip(world.areas, built, strict=True):
            _place(scene.path, area_path(folder, area.name))
        save_index(folder / WORLD_FILE, world, recognition)
    shutil.rmtree(building, ignore_errors=True)
    return WorldSummary(output, world, recognition_bytes(output))


def _divided(
    source: Reconstruction, areas: AreaSettings, settings: ModelSettings
) -> tuple[Division, dict[str, Any]]:
    """The areas, and how they were made, for the index."""
    if areas.file is not None:
        drawn = read_area_file(areas.file)
        return divide_by_rectangles(source, drawn), {
            "method": "file",
            "sha256": sha256_of_file(areas.file),
        }
    largest = areas.views or DEFAULT_AREA_VIEWS
    if areas.megabytes is not None:
        largest = _views_in(areas.megabytes, source, settings)
    return divide_by_covisibility(source, largest), {"method": AUTOMATIC, "area_views": largest}


def _views_in(megabytes: float, source: Reconstruction, settings: ModelSettings) -> int:
    """How many photos of this reconstruction an area may have that takes so much memory."""
    root = settings.images if settings.images is not None else source.image_root
    side = DepthSettings().largest_side if settings.geometry == "depth" else None
    sizes = []
    for name, index in zip(source.image_names, source.camera_index.tolist(), strict=True):
        try:
            encoded = (root / name).stat().st_size
        except OSError as error:
            raise InputError(root / name, f"cannot be read ({error.strerror or error})") from error
        sizes.append(view_memory(source.cameras[index], encoded, side))
    of_one = float(np.mean(sizes))
    largest = int(megabytes * 1e6 / of_one)
    if largest < MIN_AREA_VIEWS:
        raise OptionError(
            f"--area-memory {megabytes:g} holds {largest} of these photos; an area needs room for "
            f"{MIN_AREA_VIEWS}, {MIN_AREA_VIEWS * of_one / 1e6:.1f} MB"
        )
    return largest


def _index(
    source: Reconstruction,
    division: Division,
    built: list[BuiltArea],
    record: dict[str, Any],
    origin: dict[str, Any],
) -> World:
    number_of = {name: number for number, name in enumerate(source.image_names)}
    rows = []
    for number, (area, scene) in enumerate(zip(division.areas, built, strict=True)):
        rows.append(
            WorldArea(
                name=area.name,
                views=np.array([number_of[name] for name in scene.image_names], dtype=np.int64),
                rectangle=area.rectangle,
                bounds=scene.bounds,
                neighbours=tuple(
                    division.areas[other].name for other in division.neighbours_of(number)
                ),
                identifier=scene.identifier,
                sha256=scene.sha256,
                file_bytes=scene.file_bytes,
                memory_bytes=scene.memory_bytes,
            )
        )
    return World(
        image_names=source.image_names,
        timestamps=source.timestamps,
        world_from_camera=source.world_from_camera,
        home=division.home.astype(np.int64),
        links=division.paths.links,
        link_lengths=division.paths.lengths,
        areas=tuple(rows),
        division=record,
        provenance=origin,
    )


def _recognition(world: World, built: list[BuiltArea], progress: Progress) -> AreaRecognition:
    """What finds the areas of an image, from the features that were found as areas were built."""

    def part(area: WorldArea, scene: BuiltArea) -> Callable[[], PhotoFeatures]:
        photos = area.views.tolist()
        return lambda: dict(zip(photos, load_features(scene.features, len(photos)), strict=True))

    names = [area.name for area in world.areas]
    return learn_recognition(
        [part(area, scene) for area, scene in zip(world.areas, built, strict=True)],
        world.world_from_camera[:, :3, 3],
        world.home,
        [
            np.array([number, *map(names.index, area.neighbours)], dtype=np.int64)
            for number, area in enumerate(world.areas)
        ],
        progress,
    )


def _place(finished: Path, target: Path) -> None:
    """Puts a finished file into the world; it also stays where it is until the world is there."""
    try:
        os.link(finished, target)
    except OSError:
        # A file system without hard links.
        shutil.copyfile(finished, target)
