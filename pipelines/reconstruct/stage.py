"""The stage ``reconstruct``: a data set in, a folder of posed images out."""

import hashlib
import json
import logging
import math
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arguments import PathLike, checked_instance, checked_path
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.atomic import check_output
from pipelines.artifacts.errors import InputError, LfnavError, OptionError, StageError
from pipelines.artifacts.processes import WorkerError
from pipelines.artifacts.provenance import provenance, sha256_of_bytes, sha256_of_file
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.dataset.dataset import ODOMETRY_FILE, Dataset, load_dataset
from pipelines.dataset.images import decode_image, read_image_header
from pipelines.geometry.planarity import check_planar, check_quaternion_order, note_on_speed
from pipelines.geometry.pose import inverse, planar_state_of
from pipelines.reconstruct.alignment import Similarity, align_by_convention, align_to_odometry
from pipelines.reconstruct.description import ReconstructionSummary
from pipelines.reconstruct.known_poses import (
    KnownPoses,
    known_camera,
    poses_from_file,
    poses_from_odometry,
)
from pipelines.reconstruct.planar_adjustment import adjust_in_plane
from pipelines.reconstruct.pose_check import note_on_poses
from pipelines.reconstruct.reconstruction import (
    DESCRIPTION_NAME,
    Reconstruction,
    observations_of,
    save_reconstruction,
)
from pipelines.reconstruct.settings import ReconstructSettings
from pipelines.reconstruct.sfm import index_of, structure_from_motion

__all__ = ["ReconstructSettings", "reconstruct"]

# Beside the output: what structure from motion has finished, until all is done.
UNFINISHED_SUFFIX = ".sfm-in-progress"

_log = logging.getLogger(__name__)


def reconstruct(
    dataset: PathLike,
    output: PathLike,
    settings: ReconstructSettings,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> ReconstructionSummary:
    """Finds camera poses of the images of a data set and writes the reconstruction.

    Poses come from structure from motion (COLMAP: Schonberger and Frahm 2016), from odometry, or
    from a file. The world is metric, its z points up (REP-103); cameras have the axes of OpenCV.

    Args:
        dataset: folder of a data set.
        output: folder to be written, as a whole or not at all; ``load_reconstruction`` reads it.
            Structure from motion keeps what it has finished in a folder beside it: after a kill
            the next call goes on.
        settings: the method and its options.
        overwrite: whether an older reconstruction there may be replaced.
        progress: told how far the work is.

    Returns:
        What a person or a program wants to know of it: ``table()``, ``to_dict()``.

    Raises:
        InputError: the data set lacks what the method needs, or ``output`` cannot be written.
        StageError: structure from motion found nothing that can be trusted.
        OptionError: settings that do not go with the data set, or an argument of another type.
    """
    dataset = checked_path(dataset, "the data set's path")
    output = checked_path(output, "the reconstruction's path")
    checked_instance(settings, "settings", ReconstructSettings)
    check_output(output, overwrite, DESCRIPTION_NAME)
    data = load_dataset(dataset, reads_odometry=settings.method != "poses")
    data, repeated = _without_repeats(data)
    if settings.planar and (data.odometry is None or data.base_from_camera is None):
        # Said before minutes are spent on structure from motion.
        raise InputError(
            data.root,
            "has no odometry.txt or no [mount] in camera.toml, and --planar needs both",
            "without --planar the camera moves freely",
        )
    _check_movement(data, settings.planar)
    unfinished = output.with_name(output.name + UNFINISHED_SUFFIX)
    if settings.method == "sfm":
        dropped: dict[str, str] = {}
        if settings.planar:
            data, dropped = _with_odometry(data, settings)
        result = _from_images(data, settings, unfinished, progress)
        if settings.planar:
            result = _in_plane(data, settings, result)
        result = replace(result, dropped=dropped | result.dropped)
    elif settings.poses is not None:
        poses = poses_from_file(data, settings.poses, settings.max_gap)
        known_camera(data)
        for note in _notes_on_given(data, poses):
            _log.warning("%s: %s", settings.poses, note)
        result = _from_known_poses(data, settings, poses, "given poses", progress)
    else:
        poses = poses_from_odometry(data, settings.max_gap)
        result = _from_known_poses(data, settings, poses, "odometry", progress)
    if repeated:
        result = replace(result, dropped=result.dropped | repeated)
    record = provenance("reconstruct", settings.to_dict(), _inputs(data, settings, result))
    save_reconstruction(output, result, record, overwrite)
    shutil.rmtree(unfinished, ignore_errors=True)
    return ReconstructionSummary(output, result)


def _notes_on_given(data: Dataset, poses: KnownPoses) -> list[str]:
    """What photos and times say against given poses."""
    times = data.timestamps[poses.image_index]
    speed = note_on_speed(times, poses.world_from_camera[:, :3, 3])
    return [note for note in (note_on_poses(data, poses), speed) if note is not None]


def _without_repeats(data: Dataset) -> tuple[Dataset, dict[str, str]]:
    """Each image once, and why the others are dropped: a map learns nothing from the same photo."""
    first: dict[str, int] = {}
    repeated: dict[str, str] = {}
    for index, name in enumerate(data.image_names):
        if first.setdefault(name, index) != index:
            at = f"{name} at {data.timestamps[index]:.6f}"
            repeated[at] = f"is the image of {data.timestamps[first[name]]:.6f} once more"
    return (data.part(first.values()), repeated) if repeated else (data, {})


def _check_movement(data: Dataset, planar: bool) -> None:
    """Refuses a robot's odometry that has another order of quaternions, or leaves the floor."""
    if data.odometry is None or data.base_from_camera is None:
        return
    source = data.root / ODOMETRY_FILE
    if not planar:
        check_quaternion_order(data.odometry.poses, source)
        return
    note = check_planar(data.odometry.poses, source, "without --planar the camera moves freely")
    if note is not None:
        _log.warning("%s", note)


def _from_known_poses(
    data: Dataset,
    settings: ReconstructSettings,
    poses: KnownPoses,
    scale_source: str,
    progress: Progress,
) -> Reconstruction:
    for note in poses.notes:
        _log.warning("%s", note)
    camera = known_camera(data)
    indices = poses.image_index.tolist()
    return Reconstruction(
        method=settings.method,
        image_root=data.root.resolve(),
        image_names=tuple(data.image_names[index] for index in indices),
        image_hashes=hash_images(data, indices, progress),
        timestamps=data.timestamps[poses.image_index],
        cameras=(camera,),
        camera_index=np.zeros(len(indices), dtype=np.int64),
        world_from_camera=poses.world_from_camera,
        points=np.empty((0, 3)),
        observations=np.empty((0, 2), dtype=np.int64),
        base_from_camera=data.base_from_camera,
        scale_source=scale_source,
        dropped=poses.dropped,
        statistics={},
    )


def _from_images(
    data: Dataset, settings: ReconstructSettings, unfinished: Path, progress: Progress
) -> Reconstruction:
    """Structure from motion, then the metric world."""
    if settings.scale is not None and data.odometry is not None:
        raise OptionError(f"--scale: the odometry of {data.root} gives the scale already")
    hashes = hash_images(data, list(range(len(data))), progress)
    try:
        folder = unfinished / _key(data, settings, hashes)
        found = structure_from_motion(data, settings, folder, progress)
    except WorkerError:
        # Killed for lack of memory, perhaps: the next call goes on where this one stopped.
        raise
    except LfnavError:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise
    images = sorted(found.model.images, key=lambda image: index_of(image.name))
    indices = [index_of(image.name) for image in images]
    model_from_camera = inverse(np.array([image.camera_from_world for image in images]))
    try:
        placed = _place(data, settings, indices, model_from_camera, found.is_placed)
    except StageError as error:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise StageError(f"{data.root}: {error}") from error
    observations, pixels = observations_of(found.model, images)
    camera_numbers = list(found.model.cameras)
    points = found.model.points
    return Reconstruction(
        method=settings.method,
        image_root=data.root.resolve(),
        image_names=tuple(data.image_names[index] for index in indices),
        image_hashes=tuple(hashes[index] for index in indices),
        timestamps=data.timestamps[indices],
        cameras=tuple(found.model.cameras.values()),
        camera_index=np.array([camera_numbers.index(image.camera) for image in images]),
        world_from_camera=placed.world_from_model.transform_poses(model_from_camera),
        points=placed.world_from_model.transform_points(points.positions),
        observations=observations,
        base_from_camera=data.base_from_camera,
        scale_source=placed.scale_source,
        dropped=found.dropped,
        statistics={**found.statistics, **placed.statistics},
        observed_pixels=pixels,
        point_colors=points.colors,
        point_errors=points.errors,
    )


def _with_odometry(data: Dataset, settings: ReconstructSettings) -> tuple[Dataset, dict[str, str]]:
    """The images that have odometry, and why the others are dropped: the floor is known by it."""
    odometry = poses_from_odometry(data, settings.max_gap)
    return data.part(odometry.image_index.tolist()), odometry.dropped


def _in_plane(data: Dataset, settings: ReconstructSettings, free: Reconstruction) -> Reconstruction:
    """The reconstruction with its poses on the floor."""
    odometry = poses_from_odometry(data, settings.max_gap)
    names = [data.image_names[index] for index in odometry.image_index.tolist()]
    row_of_name = {name: row for row, name in enumerate(names)}
    rows = [row_of_name[name] for name in free.image_names]
    world_from_base = odometry.world_from_camera[rows] @ inverse(data.body_from_camera)
    try:
        return adjust_in_plane(free, planar_state_of(world_from_base)).reconstruction
    except StageError as error:
        raise StageError(f"{data.root}: {error}") from error


@dataclass(frozen=True)
class _Placement:
    """How the model lies in the world, and who said so."""

    world_from_model: Similarity
    scale_source: str
    statistics: dict[str, Any]


def _place(
    data: Dataset,
    settings: ReconstructSettings,
    indices: list[int],
    model_from_camera: FloatArray,
    is_placed: bool,
) -> _Placement:
    """The world by odometry where there is some, else by convention."""
    if is_placed:
        return _Placement(Similarity(1.0, np.eye(3), np.zeros(3)), "odometry", {})
    if data.odometry is None:
        scale = 1.0 if settings.scale is None else settings.scale
        source = "arbitrary" if settings.scale is None else "--scale"
        ups = np.array([read_image_header(data.image_path(i)).up for i in indices], dtype=float)
        return _Placement(align_by_convention(model_from_camera, scale, ups), source, {})
    row_of_index = {index: row for row, index in enumerate(indices)}
    odometry = poses_from_odometry(data, settings.max_gap)
    shared = [
        (row_of_index[index], row)
        for row, index in enumerate(odometry.image_index.tolist())
        if index in row_of_index
    ]
    alignment = align_to_odometry(
        model_from_camera[[row for row, _ in shared]],
        odometry.world_from_camera[[row for _, row in shared]],
    )
    statistics = {
        "alignment_images": len(shared),
        "alignment_scale": alignment.world_from_model.scale,
        "alignment_position_rmse_m": alignment.position_rmse,
        "alignment_rotation_rmse_deg": math.degrees(alignment.rotation_rmse),
    }
    return _Placement(alignment.world_from_model, "odometry", statistics)


def _key(data: Dataset, settings: ReconstructSettings, hashes: tuple[str, ...]) -> str:
    """Name that changes with anything that features, matches and models depend on."""
    camera = None if data.camera is None else data.camera.to_dict()
    mask = None if data.mask is None else data.mask.sha256
    mount = None if data.base_from_camera is None else data.base_from_camera.tolist()
    content = [settings.to_dict(), hashes, camera, mask, mount, data.timestamps.tolist()]
    digest = hashlib.sha256(json.dumps(content).encode())
    if data.odometry is not None:
        digest.update(data.odometry.timestamps.tobytes() + data.odometry.poses.tobytes())
    return digest.hexdigest()[:16]


def hash_images(data: Dataset, indices: list[int], progress: Progress) -> tuple[str, ...]:
    """SHA-256 of the files of the images ``indices``; each is decoded once.

    Raises:
        InputError: an image is damaged. Structure from motion would drop it without a word.
    """
    hashes: list[str] = []
    for index in progress(indices, "checking images", len(indices)):
        content = data.read_image_bytes(index)
        decode_image(content, data.image_path(index))
        hashes.append(sha256_of_bytes(content))
    return tuple(hashes)


def _inputs(data: Dataset, settings: ReconstructSettings, result: Reconstruction) -> dict[str, str]:
    """Name of each input file that the result depends on -> its hash."""
    inputs = {"images": sha256_of_bytes("\n".join(result.image_hashes).encode())}
    names = ["rgb.txt", "camera.toml"]
    if settings.method != "poses":
        names.append("odometry.txt")
    for name in names:
        if (data.root / name).is_file():
            inputs[name] = sha256_of_file(data.root / name)
    if settings.method == "sfm" and data.mask is not None:
        inputs["mask.png"] = data.mask.sha256
    if settings.poses is not None:
        inputs["poses"] = sha256_of_file(settings.poses)
    return inputs
