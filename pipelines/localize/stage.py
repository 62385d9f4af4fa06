"""The stage ``localize``: a scene model and a data set in, a run out."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arguments import (
    check_fields,
    checked_instance,
    checked_number,
    checked_path,
)
from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.atomic import check_output
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.artifacts.provenance import provenance, sha256_of_file
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.dataset.dataset import (
    ODOMETRY_FILE,
    Dataset,
    load_dataset,
)
from pipelines.geometry.interpolation import MAX_GAP
from pipelines.lightfield.open_world import OpenWorld, scene_or_world
from pipelines.lightfield.scene import Scene
from pipelines.localize.belief import Region
from pipelines.localize.description import UNIT_OF_LENGTH, RunSummary
from pipelines.localize.landmarks import LandmarkSource
from pipelines.localize.localizer import NO_PNP, Localizer, region_of
from pipelines.localize.map_heights import notes_on_heights
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import camera_and_mount
from pipelines.localize.odometry import images_with_odometry
from pipelines.localize.pnp import MountedCamera, PnpLocalizer
from pipelines.localize.pnp_frames import beside, pnp_record
from pipelines.localize.run import FrameRecord, Run, save_run
from pipelines.localize.scene_of_run import relative_scene_path
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.true_states import states_of_truth
from pipelines.reconstruct.reconstruction import (
    DESCRIPTION_NAME,
    Reconstruction,
    load_reconstruction,
)
from pipelines.render.devices import resolved_device

# How errors name the odometry of a run that is to do without.
NO_ODOMETRY = Path("none")


@dataclass(frozen=True)
class LocalizeRequest:
    """What is to be localized in what. Paths may be given as texts.

    Attributes:
        scene: scene model, or the folder of a world of several, made by ``model``.
        dataset: folder with images, camera with mount, odometry.
        output: the file to be written, ``run.h5``.
        settings: of the particle filter.
        seed: of the filter's random numbers, not negative.
        odometry: TUM file to use instead of the data set's own; None: the data set's own.
        ignore_odometry: whether to do without the data set's odometry.
        mask: file to use instead of the data set's own; None: the data set's own.
        reconstruction: folder of the scene's reconstruction, whose points PnP then uses; None: PnP
            takes the scene's surface.
        overwrite: whether an existing file may be replaced.
        memory: megabytes that a world's open areas and all that belongs to localizing in them may
            take; None: 1000. A scene is in memory as a whole.
        max_gap: seconds between two poses of odometry between which those of images are
            interpolated, at most.

    Raises:
        OptionError: a value of another type.
    """

    scene: Path
    dataset: Path
    output: Path
    settings: LocalizerSettings = field(default_factory=LocalizerSettings)
    seed: int = 0
    odometry: Path | None = None
    ignore_odometry: bool = False
    mask: Path | None = None
    reconstruction: Path | None = None
    overwrite: bool = False
    memory: float | None = None
    max_gap: float = MAX_GAP

    def __post_init__(self) -> None:
        for name in ("scene", "dataset", "output", "odometry", "mask", "reconstruction"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, checked_path(value, name))
        check_fields(self)
        checked_number(self.seed, "seed", 0, whole=True)
        checked_number(self.max_gap, "the longest gap", 0.0)

    @property
    def odometry_source(self) -> Path:
        """Where the odometry is read, or how errors say that there is none."""
        if self.ignore_odometry:
            return NO_ODOMETRY
        return self.odometry if self.odometry is not None else self.dataset / ODOMETRY_FILE


@dataclass(frozen=True)
class RunOrigin:
    """Where a run comes from.

    Attributes:
        scene_path: how the run refers to its scene: from the folder in which the run is stored.
        odometry: the odometry's file, for errors; None: that of the data set.
        record: the run's provenance, plain JSON types; None: versions and settings.

    Raises:
        OptionError: a value of another type.
    """

    scene_path: str = ""
    odometry: Path | None = None
    record: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        checked_instance(self.scene_path, "scene_path", str)
        if self.odometry is not None:
            checked_instance(self.odometry, "odometry", Path)
        if self.record is not None:
            checked_instance(self.record, "record", dict)


def localize(request: LocalizeRequest, progress: Progress = no_progress) -> RunSummary:
    """Localizes the robot in every frame of a data set and writes the run.

    Args:
        request: what is localized in what, and with which settings.
        progress: told how far the work is.

    Returns:
        What a person or a program wants to know of the run: ``table()``, ``to_dict()``.

    Raises:
        InputError: an input cannot be used, or the output not be written.
        OptionError: settings that make no sense for this scene, or an argument of another type.
    """
    checked_instance(request, "the request", LocalizeRequest)
    settings, reconstruction = request.settings, request.reconstruction
    check_output(request.output, request.overwrite)
    if reconstruction is not None and not settings.uses_pnp:
        raise OptionError("a reconstruction is of use to PnP alone, which nothing asks for")
    scene = scene_or_world(request.scene, request.memory)
    points = None if reconstruction is None else load_reconstruction(reconstruction)
    dataset = load_dataset(
        request.dataset,
        odometry=request.odometry,
        mask=request.mask,
        reads_odometry=not request.ignore_odometry,
    )
    if settings.method == "filter":
        # The file says where it was computed: another device rounds differently.
        settings = replace(settings, device=resolved_device(settings.device))
    inputs = {"scene": scene.identifier}
    if dataset.odometry is not None:
        inputs["odometry"] = sha256_of_file(request.odometry_source)
    if dataset.mask is not None:
        inputs["mask"] = dataset.mask.sha256
    if reconstruction is not None:
        inputs["reconstruction"] = sha256_of_file(reconstruction / DESCRIPTION_NAME)
    origin = RunOrigin(
        relative_scene_path(request.scene, request.output),
        request.odometry_source,
        provenance("localize", {**settings.to_dict(), "seed": request.seed}, inputs),
    )
    run = localize_dataset(
        scene,
        dataset,
        settings,
        seed=request.seed,
        origin=origin,
        progress=progress,
        landmarks=None if points is None else _landmarks(scene, points, str(reconstruction)),
        max_gap=request.max_gap,
    )
    save_run(request.output, run, request.overwrite)
    return RunSummary(request.output, run)


def _landmarks(scene: Scene | OpenWorld, points: Reconstruction, name: str) -> LandmarkSource:
    if isinstance(scene, OpenWorld):
        raise OptionError(NO_PNP)
    return LandmarkSource(scene, points, name)


def localize_dataset(
    scene: Scene | OpenWorld,
    dataset: Dataset,
    settings: LocalizerSettings | None = None,
    *,
    seed: int = 0,
    origin: RunOrigin | None = None,
    progress: Progress = no_progress,
    landmarks: LandmarkSource | None = None,
    model: MeasurementModel | None = None,
    max_gap: float = MAX_GAP,
) -> Run:
    """Localizes the robot in every frame of a data set, in memory.

    Where the filter goes by odometry, images without are left out, which a note says.

    Args:
        scene: the light field, or a world of several.
        dataset: with camera, mount and odometry, and a mask where there is one.
        settings: of the particle filter; None: the defaults.
        seed: of the filter's random numbers, not negative.
        origin: where the data come from; None: the data set itself.
        progress: told how far the work is.
        landmarks: of the features that PnP uses; None: from the scene's surface.
        model: compares states with images; built from the scene when None.
        max_gap: seconds between two poses of odometry between which those of images are
            interpolated, at most.

    Raises:
        InputError: the data set lacks camera, mount or odometry, its odometry is not that of a
            robot on a floor, or an image cannot be read.
        OptionError: settings that make no sense for this scene, or an argument of another type.
    """
    settings = LocalizerSettings() if settings is None else settings
    if not isinstance(scene, OpenWorld):
        checked_instance(scene, "the scene", Scene)
    checked_instance(dataset, "the data set", Dataset)
    checked_instance(settings, "settings", LocalizerSettings)
    checked_number(seed, "seed", 0, whole=True)
    if model is not None and settings.method != "filter":
        raise OptionError("a measurement model is of use to the filter alone, not to method pnp")
    origin = RunOrigin() if origin is None else checked_instance(origin, "origin", RunOrigin)
    odometry = dataset.root / ODOMETRY_FILE if origin.odometry is None else origin.odometry
    record = origin.record
    if record is None:
        inputs = {"scene": scene.identifier}
        record = provenance("localize", {**settings.to_dict(), "seed": seed}, inputs)
    space = settings.state_space
    camera, mount = camera_and_mount(dataset, space)
    mask = None if dataset.mask is None else dataset.mask.used
    dataset, body_poses, notes = images_with_odometry(dataset, settings, odometry, max_gap)
    if space.angles == 1 and isinstance(scene, Scene):
        notes += notes_on_heights(scene, float(mount[2, 3]))
    if isinstance(scene, Scene) and scene.unit != "m":
        record = {**record, UNIT_OF_LENGTH: scene.unit}
        if space.angles == 1:
            notes.append(
                "the scene's scale is unknown, odometry and mount are metres: lfnav reconstruct or "
                "import it with --scale"
            )
    pnp = None
    if settings.uses_pnp:
        if isinstance(scene, OpenWorld):
            raise OptionError(NO_PNP)
        pnp = PnpLocalizer(
            scene,
            LandmarkSource(scene, None) if landmarks is None else landmarks,
            MountedCamera(camera, mount, mask),
            space,
            seed=seed,
            threads=settings.threads,
            progress=progress,
        )
    rng = np.random.default_rng(seed)
    localizer = None
    if settings.method == "filter":
        localizer = Localizer(scene, camera, mount, settings, rng, model, mask)
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
        scene_path=origin.scene_path,
        dataset_name=dataset.root.resolve().as_posix().split("/")[-1],
        camera=camera,
        base_from_camera=mount,
        settings=settings.to_dict(),
        seed=seed,
        frames=tuple(frames),
        encoded_images=tuple(dataset.read_image_bytes(index) for index in range(len(dataset))),
        odometry=None if body_poses is None else space.states(body_poses),
        groundtruth=states_of_truth(dataset, space, max_gap),
        provenance={**record, "notes": notes} if notes else record,
        areas=scene.area_map if isinstance(scene, OpenWorld) else None,
    )


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
        hypotheses = None if settings.proposal == "retrieval" else answer.hypotheses
        record = localizer.step(image, increment, time, name, hypotheses)
        return beside(record, answer, noted=settings.with_pnp)

    return step
