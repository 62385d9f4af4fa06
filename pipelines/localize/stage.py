"""The stage ``localize``: a scene model and a data set in, a run out."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arguments import (
    PathLike,
    checked_instance,
    checked_number,
    checked_path,
)
from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.atomic import check_output
from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.artifacts.provenance import provenance, sha256_of_file
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.dataset.dataset import (
    ODOMETRY_FILE,
    PAIRING_TOLERANCE,
    Dataset,
    load_dataset,
    poses_at_images,
)
from pipelines.geometry.planarity import check_planar
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.localize.belief import Region
from pipelines.localize.dataset_camera import camera_and_mount
from pipelines.localize.description import RunSummary
from pipelines.localize.localizer import Localizer, region_of
from pipelines.localize.map_heights import notes_on_heights
from pipelines.localize.pnp import PnpLocalizer
from pipelines.localize.pnp_frames import beside, pnp_record
from pipelines.localize.run import FrameRecord, Run, save_run
from pipelines.localize.scene_of_run import relative_scene_path
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import StateSpace
from pipelines.reconstruct.reconstruction import (
    DESCRIPTION_NAME,
    Reconstruction,
    load_reconstruction,
)
from pipelines.render.devices import resolved_device

# How errors name the odometry of a run that is to do without.
NO_ODOMETRY = Path("none")


def localize(
    scene_path: PathLike,
    dataset_path: PathLike,
    output: PathLike,
    settings: LocalizerSettings | None = None,
    *,
    seed: int = 0,
    odometry: PathLike | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
    reconstruction: PathLike | None = None,
    ignore_odometry: bool = False,
    mask: PathLike | None = None,
) -> RunSummary:
    """Localizes the robot in every frame of a data set and writes the run.

    Args:
        scene_path: scene model, made by ``model``.
        dataset_path: folder with images, camera with mount, odometry.
        output: the file to be written, ``run.h5``.
        settings: of the filter; None: the defaults.
        seed: of the filter's random numbers, not negative.
        odometry: TUM file to use instead of the data set's own; None: the data set's own.
        overwrite: whether an existing file may be replaced.
        progress: told how far the work is.
        reconstruction: folder of the scene's reconstruction, whose points PnP then uses; None: PnP
            takes the scene's surface.
        ignore_odometry: whether to do without the data set's odometry.
        mask: file to use instead of the data set's own; None: the data set's own.

    Returns:
        What a person or a program wants to know of the run: ``table()``, ``to_dict()``.

    Raises:
        InputError: an input cannot be used, or the output not be written.
        OptionError: settings that make no sense for this scene, or an argument of another type.
    """
    scene_path = checked_path(scene_path, "the scene's path")
    dataset_path = checked_path(dataset_path, "the data set's path")
    output = checked_path(output, "the run's path")
    odometry, reconstruction, mask = (
        None if path is None else checked_path(path, f"the {name}'s path")
        for name, path in (
            ("odometry", odometry),
            ("reconstruction", reconstruction),
            ("mask", mask),
        )
    )
    settings = LocalizerSettings() if settings is None else settings
    checked_instance(settings, "settings", LocalizerSettings)
    check_output(output, overwrite)
    checked_number(seed, "seed", 0, whole=True)
    if reconstruction is not None and not settings.uses_pnp:
        raise OptionError("a reconstruction is of use to PnP alone, which nothing asks for")
    scene = load_scene(scene_path)
    points = None if reconstruction is None else load_reconstruction(reconstruction)
    dataset = load_dataset(dataset_path, odometry=odometry, mask=mask)
    if ignore_odometry:
        dataset = replace(dataset, odometry=None)
    if settings.method == "filter":
        # The file says where it was computed: another device rounds differently.
        settings = replace(settings, device=resolved_device(settings.device))
    source = odometry if odometry is not None else dataset_path / ODOMETRY_FILE
    if ignore_odometry:
        source = NO_ODOMETRY
    inputs = {"scene": scene.identifier}
    if dataset.odometry is not None:
        inputs["odometry"] = sha256_of_file(source)
    if dataset.mask is not None:
        inputs["mask"] = dataset.mask.sha256
    if reconstruction is not None:
        inputs["reconstruction"] = sha256_of_file(reconstruction / DESCRIPTION_NAME)
    run = localize_dataset(
        scene,
        dataset,
        settings,
        seed=seed,
        odometry_source=source,
        scene_path=relative_scene_path(scene_path, output),
        record=provenance("localize", {**settings.to_dict(), "seed": seed}, inputs),
        progress=progress,
        reconstruction=points,
        reconstruction_path=str(reconstruction),
    )
    save_run(output, run, overwrite)
    return RunSummary(output, run)


def localize_dataset(
    scene: Scene,
    dataset: Dataset,
    settings: LocalizerSettings | None = None,
    *,
    seed: int = 0,
    odometry_source: Path | None = None,
    scene_path: str = "",
    record: dict[str, Any] | None = None,
    progress: Progress = no_progress,
    reconstruction: Reconstruction | None = None,
    reconstruction_path: str = "reconstruction",
) -> Run:
    """Localizes the robot in every frame of a data set, in memory.

    Args:
        scene: the light field.
        dataset: with camera, mount and odometry, and a mask where there is one.
        settings: of the filter; None: the defaults.
        seed: of the filter's random numbers, not negative.
        odometry_source: how errors name the odometry's file; None: as the data set's own.
        scene_path: how the run refers to its scene: from the folder in which the run is stored.
        record: the run's provenance, plain JSON types; None: versions and settings.
        progress: told how far the work is.
        reconstruction: the scene's, whose points PnP then uses; None: the scene's surface.
        reconstruction_path: how errors name it.

    Raises:
        InputError: the data set lacks camera, mount or odometry, its odometry is not that of a
            robot on a floor, or an image cannot be read.
        OptionError: settings that make no sense for this scene, or an argument of another type.
    """
    settings = LocalizerSettings() if settings is None else settings
    checked_instance(scene, "the scene", Scene)
    checked_instance(dataset, "the data set", Dataset)
    checked_instance(settings, "settings", LocalizerSettings)
    checked_number(seed, "seed", 0, whole=True)
    if odometry_source is None:
        odometry_source = dataset.root / ODOMETRY_FILE
    if record is None:
        inputs = {"scene": scene.identifier}
        record = provenance("localize", {**settings.to_dict(), "seed": seed}, inputs)
    space = settings.state_space
    camera, mount = camera_and_mount(dataset, space)
    mask = None if dataset.mask is None else dataset.mask.used
    notes = list(check_odometry(dataset, settings, odometry_source))
    if space.angles == 1:
        notes += notes_on_heights(scene, float(mount[2, 3]))
    body_poses = None
    if dataset.odometry is not None:
        body_poses = poses_at_images(dataset, dataset.odometry, odometry_source)
    pnp = None
    if settings.uses_pnp:
        pnp = PnpLocalizer(
            scene,
            camera,
            mount,
            space,
            seed=seed,
            threads=settings.threads,
            reconstruction=reconstruction,
            reconstruction_path=reconstruction_path,
            progress=progress,
            mask=mask,
        )
    rng = np.random.default_rng(seed)
    localizer = None
    if settings.method == "filter":
        localizer = Localizer(scene, camera, mount, settings, rng, mask=mask)
    locate = _locator(localizer, pnp, region_of(scene, settings), settings, rng)
    frames = []
    for index in progress(range(len(dataset)), "localize", len(dataset)):
        increment = None
        if index > 0 and body_poses is not None:
            increment = space.increment(body_poses[index - 1], body_poses[index])
        time, name = float(dataset.timestamps[index]), dataset.image_names[index]
        frames.append(locate(dataset.read_image(index), increment, time, name))
    if localizer is not None:
        notes += localizer.notes
    return Run(
        scene_identifier=scene.identifier,
        scene_path=scene_path,
        dataset_name=dataset.root.resolve().as_posix().split("/")[-1],
        camera=camera,
        base_from_camera=mount,
        settings=settings.to_dict(),
        seed=seed,
        frames=tuple(frames),
        encoded_images=tuple(dataset.read_image_bytes(index) for index in range(len(dataset))),
        odometry=None if body_poses is None else space.states(body_poses),
        groundtruth=_groundtruth_states(dataset, space),
        provenance={**record, "notes": notes} if notes else record,
    )


def check_odometry(dataset: Dataset, settings: LocalizerSettings, source: Path) -> tuple[str, ...]:
    """Refuses to filter a planar robot's drive without odometry, or with that of something else.

    Returns:
        Lines on what is suspicious about the odometry.

    Raises:
        InputError: there is none, or no robot on a floor moves like this; ``source`` is named.
    """
    if settings.state_space.angles != 1:
        return ()
    if dataset.odometry is None and settings.method == "filter":
        raise InputError(
            source,
            "is missing: a planar robot is localized with odometry",
            "give the file with --odometry",
        )
    if dataset.odometry is None:
        return ()
    nearest = dataset.odometry.nearest(dataset.timestamps, PAIRING_TOLERANCE)
    if not np.any(nearest >= 0):
        return ()
    try:
        note = check_planar(dataset.odometry.poses[nearest[nearest >= 0]], source)
    except InputError as error:
        if settings.method == "filter":
            raise
        # Poses by features do without; the odometry is only shown beside them.
        note = str(error)
    return () if note is None else (note,)


def _locator(
    localizer: Localizer | None,
    pnp: PnpLocalizer | None,
    region: Region,
    settings: LocalizerSettings,
    rng: np.random.Generator,
) -> Callable[[ImageArray, FloatArray | None, float, str], FrameRecord]:
    """What makes a record of an image, the motion before it, its time and its name.

    Args:
        localizer: the filter; None: features alone.
        pnp: features; None: the filter alone.
        region: where the body may be.
        settings: of the filter.
        rng: of the particles of frames that features alone did not locate.
    """
    if pnp is None and localizer is not None:
        return localizer.step
    if pnp is None:
        raise StageError("a frame is located by the filter, by its features, or by both")

    def step(
        image: ImageArray, increment: FloatArray | None, time: float, name: str
    ) -> FrameRecord:
        answer = pnp.locate(image)
        if localizer is None:
            return pnp_record(answer, region, settings, rng, time, name)
        hypotheses = None if settings.proposal == "appearance" else answer.hypotheses
        record = localizer.step(image, increment, time, name, hypotheses)
        return beside(record, answer, noted=settings.with_pnp)

    return step


def _groundtruth_states(dataset: Dataset, space: StateSpace) -> FloatArray | None:
    """``(N, D)`` true states, NaN where there is none; for evaluation only."""
    if dataset.groundtruth is None:
        return None
    nearest = dataset.groundtruth.nearest(dataset.timestamps, PAIRING_TOLERANCE)
    states = np.full((len(dataset), space.dimension), np.nan)
    states[nearest >= 0] = space.states(dataset.groundtruth.poses[nearest[nearest >= 0]])
    return states
