"""The stage ``import``: a recording in another program's layout in, a data set out.

Where the source has exact poses the data set also holds ``reconstruction/``, so that ``lfnav
model`` follows at once. The folder appears whole or not at all.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.atomic import atomic_folder, check_output
from pipelines.artifacts.errors import InputError, StageError
from pipelines.artifacts.provenance import provenance, sha256_of_bytes
from pipelines.artifacts.stages import Progress
from pipelines.dataset.images import read_image_header
from pipelines.dataset.importers.camera_grid import read_camera_grid
from pipelines.dataset.importers.euroc import read_euroc
from pipelines.dataset.importers.kitti import read_kitti
from pipelines.dataset.importers.llff import read_llff
from pipelines.dataset.importers.nerfstudio import read_nerfstudio
from pipelines.dataset.importers.placing import place_depth, place_images, write_lists
from pipelines.dataset.importers.polycam import read_polycam
from pipelines.dataset.importers.recognition import Recognition, recognise
from pipelines.dataset.importers.record3d import read_record3d
from pipelines.dataset.importers.recording import IMAGE_FOLDER, Recording
from pipelines.dataset.importers.settings import POSED_KINDS, UNSCALED_KINDS, ImportSettings
from pipelines.dataset.importers.seven_scenes import read_seven_scenes
from pipelines.dataset.importers.video import extract_frames
from pipelines.reconstruct.alignment import Similarity, align_by_convention, mean_up
from pipelines.reconstruct.colmap_source import ColmapSource, read_colmap
from pipelines.reconstruct.import_description import ImportSummary
from pipelines.reconstruct.reconstruction import (
    Reconstruction,
    observations_of,
    write_reconstruction,
)

__all__ = ["ImportSettings", "import_source"]

FORMAT = "lfnav import"
RECORD_NAME = "import.json"
RECONSTRUCTION_FOLDER = "reconstruction"
# Source -> what reads it. Videos are decoded into the data set, COLMAP models bring points along.
_READERS: dict[str, Callable[[Path, ImportSettings], Recording]] = {
    "grid": read_camera_grid,
    "nerfstudio": lambda source, settings: read_nerfstudio(source, settings.allow_missing),
    "kitti": read_kitti,
    "7scenes": read_seven_scenes,
    "euroc": lambda source, _: read_euroc(source),
    "record3d": lambda source, _: read_record3d(source),
    "polycam": lambda source, _: read_polycam(source),
    "llff": lambda source, _: read_llff(source),
}
# Degrees by which the cameras may lean on average before the user is told.
LEANING_DEG = 45.0


def import_source(
    source: Path,
    output: Path,
    settings: ImportSettings,
    *,
    overwrite: bool,
    progress: Progress,
) -> ImportSummary:
    """Makes a data set of a recording in another layout.

    Args:
        source: the folder or file.
        output: folder to be written, as a whole or not at all.
        settings: which layout it is and its options.
        overwrite: whether an older import there may be replaced.
        progress: told how far the work is.

    Raises:
        InputError: the source is not recognised, incomplete or damaged, or ``output`` cannot be
            written.
        OptionError: an option is missing, or means nothing for this source.
        StageError: the world cannot be turned upright.
    """
    check_output(output, overwrite, RECORD_NAME)
    found = _recognised(source, settings.kind)
    settings.check_meant_for(found.kind)
    if found.kind == "video":
        with atomic_folder(output, overwrite, RECORD_NAME) as folder:
            (folder / IMAGE_FOLDER).mkdir()
            recording = extract_frames(source, folder, settings, progress)
            return _fill(folder, output, found, settings, recording, None, progress)
    colmap = read_colmap(source, settings) if found.kind == "colmap" else None
    recording = _READERS[found.kind](source, settings) if colmap is None else colmap.recording
    if settings.every is not None:
        recording = recording.thinned(settings.every)
    with atomic_folder(output, overwrite, RECORD_NAME) as folder:
        return _fill(folder, output, found, settings, recording, colmap, progress)


def _recognised(source: Path, kind: str) -> Recognition:
    if kind == "auto":
        return recognise(source)
    if not source.exists():
        raise InputError(source, "does not exist")
    if kind != "video" and not source.is_dir() and source.suffix.lower() != ".json":
        raise InputError(source, f"is a file; a source of kind {kind} is a folder")
    return Recognition(kind, "--from")


def _fill(
    folder: Path,
    output: Path,
    found: Recognition,
    settings: ImportSettings,
    recording: Recording,
    colmap: ColmapSource | None,
    progress: Progress,
) -> ImportSummary:
    """Writes everything into ``folder``, which will be ``output``."""
    posed = found.kind in POSED_KINDS
    ups = np.array([read_image_header(frame.file).up for frame in recording.frames], dtype=float)
    poses, world = _placed(recording, found.kind, settings, ups)
    hashes = place_images(folder, recording, link=settings.link, decode=posed, progress=progress)
    place_depth(folder, recording, progress)
    write_lists(folder, recording, poses)
    inputs = {"images": sha256_of_bytes("\n".join(hashes).encode())}
    record = provenance("import", settings.to_dict(), inputs)
    if posed and poses is not None:
        content = _reconstruction(output, found, settings, recording, hashes, poses)
        if colmap is not None:
            content = _with_points(content, colmap, world)
        final = output.absolute() / RECONSTRUCTION_FOLDER
        (folder / RECONSTRUCTION_FOLDER).mkdir()
        write_reconstruction(folder / RECONSTRUCTION_FOLDER, final, content, record)
    notes = (*recording.notes, *_notes_on_the_world(settings, poses, ups))
    if found.others:
        notes = (*notes, f"it could also be: {', '.join(found.others)} (say so with --from)")
    summary = ImportSummary(
        output=output,
        kind=found.kind,
        evidence=found.evidence,
        images=len(recording.frames),
        cameras=recording.cameras,
        world_from_camera=poses,
        is_metric=not _scale_is_arbitrary(found.kind, settings),
        depth_images=sum(frame.depth is not None for frame in recording.frames),
        points=0 if colmap is None else len(colmap.model.points.positions),
        reconstruction=output / RECONSTRUCTION_FOLDER if posed else None,
        notes=notes,
    )
    _write_record(folder / RECORD_NAME, summary, record)
    return summary


def _write_record(path: Path, summary: ImportSummary, record: dict[str, Any]) -> None:
    content = {
        "format": FORMAT,
        "schema_version": 1,
        "source": summary.kind,
        "images": summary.images,
        "notes": list(summary.notes),
        "provenance": record,
    }
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _placed(
    recording: Recording, kind: str, settings: ImportSettings, ups: FloatArray
) -> tuple[FloatArray | None, Similarity]:
    """world_from_camera in the world of the data set, and that world from the source's."""
    poses = recording.world_from_camera
    scale = 1.0 if settings.scale is None else settings.scale
    world = Similarity(scale, np.eye(3), np.zeros(3))
    if poses is None:
        return None, world
    # The world of structure from motion, which LLFF's is, has nothing that is up.
    if settings.upright or kind == "llff":
        try:
            world = align_by_convention(poses, scale, ups)
        except StageError as error:
            raise StageError(f"--upright: {error}") from error
    return world.transform_poses(poses), world


def _notes_on_the_world(
    settings: ImportSettings, poses: FloatArray | None, ups: FloatArray
) -> tuple[str, ...]:
    if poses is None or settings.upright:
        return ()
    up = mean_up(poses, ups)
    length = float(np.linalg.norm(up))
    lean = float(np.degrees(np.arccos(np.clip(up[2] / length, -1.0, 1.0)))) if length else 90.0
    if lean <= LEANING_DEG:
        return ()
    return (
        f"the cameras stand {lean:.0f} degrees off the world's z axis, which lfnav takes for up; "
        "--upright turns the world",
    )


def _scale_is_arbitrary(kind: str, settings: ImportSettings) -> bool:
    return kind in UNSCALED_KINDS and settings.scale is None


def _reconstruction(
    output: Path,
    found: Recognition,
    settings: ImportSettings,
    recording: Recording,
    hashes: tuple[str, ...],
    poses: FloatArray,
) -> Reconstruction:
    source = "--scale" if found.kind in UNSCALED_KINDS else "given poses"
    return Reconstruction(
        method="poses",
        image_root=output.absolute(),
        image_names=tuple(frame.name for frame in recording.frames),
        image_hashes=hashes,
        timestamps=np.array([frame.timestamp for frame in recording.frames]),
        cameras=recording.cameras,
        camera_index=np.array([frame.camera for frame in recording.frames], dtype=np.int64),
        world_from_camera=poses,
        points=np.empty((0, 3)),
        observations=np.empty((0, 2), dtype=np.int64),
        base_from_camera=recording.base_from_camera,
        scale_source="arbitrary" if _scale_is_arbitrary(found.kind, settings) else source,
        dropped={},
        statistics={},
    )


def _with_points(
    content: Reconstruction, colmap: ColmapSource, world: Similarity
) -> Reconstruction:
    """The reconstruction with the model's points in the data set's world."""
    points = colmap.model.points
    observations, pixels = observations_of(colmap.model, colmap.images)
    known = points.errors[points.errors >= 0.0]
    statistics = {"mean_reprojection_error_px": float(known.mean())} if len(known) else {}
    return replace(
        content,
        points=world.transform_points(points.positions),
        observations=observations,
        observed_pixels=pixels,
        point_colors=points.colors,
        point_errors=points.errors,
        statistics=statistics,
    )
