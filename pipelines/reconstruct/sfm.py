"""Structure from motion: poses, points and, where unknown, the camera, from the images alone.

This is the parent's side. The work is done by ``sfm_worker`` in a process of its own; here it is
started and monitored, and its result is judged (``checks``).
"""

import json
import logging
import math
import os
import queue
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.errors import InputError, StageError, quoted
from pipelines.artifacts.processes import WorkerProcess, worker_command
from pipelines.artifacts.stages import Progress
from pipelines.dataset.dataset import CAMERA_FILE, ODOMETRY_FILE, Dataset
from pipelines.dataset.images import read_image_header
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse
from pipelines.reconstruct.checks import (
    MIN_IMAGES,
    DatabaseFindings,
    ModelFindings,
    check_database,
    check_model,
    count_rows,
    measure,
    read_findings,
)
from pipelines.reconstruct.colmap_model import ColmapModel, colmap_params, read_model
from pipelines.reconstruct.connectivity import firm_pieces, restrict
from pipelines.reconstruct.drifting_odometry import align_to_drifting_odometry
from pipelines.reconstruct.known_poses import KnownPoses, poses_from_odometry
from pipelines.reconstruct.photo_files import place_photo, turned_back
from pipelines.reconstruct.photo_pairs import SPATIAL_LIMIT, image_pairs
from pipelines.reconstruct.pieces import firm_parts, put_together
from pipelines.reconstruct.settings import ReconstructSettings
from pipelines.reconstruct.sfm_worker import CORRECTED_POSES, Request

POLL_SECONDS = 0.3
MAX_THREADS = 16
ESTIMATED_CAMERA_MODEL = "SIMPLE_RADIAL"
# Table of COLMAP's database that grows while a phase runs.
COUNTED_TABLES = {"features": "keypoints", "matching": "two_view_geometries"}
PHASE_TEXTS = {"features": "finding features", "matching": "matching images"}

WORKER_COMMAND = worker_command("pipelines.reconstruct.sfm_worker")

_log = logging.getLogger(__name__)

# What each attempt left: its name, and folders of models with their numbers of images.
Attempts = list[tuple[str, list[tuple[str, int]]]]


@dataclass(frozen=True)
class StructureFromMotion:
    """The trusted outcome.

    Attributes:
        model: images are named by their index in the data set.
        findings: measures of the model.
        statistics: plain JSON types.
        dropped: name of an image without a pose -> the reason.
        is_placed: whether the model lies in odometry's world already, in metres.
    """

    model: ColmapModel
    findings: ModelFindings
    statistics: dict[str, Any]
    dropped: dict[str, str]
    is_placed: bool = False


def index_of(name: str) -> int:
    """Index in the data set of an image of the model."""
    return int(name.split(".", 1)[0])


def starts_from_odometry(dataset: Dataset, settings: ReconstructSettings) -> bool:
    """Whether the mapping starts from odometry: as asked for, or for many photos that have it.

    Raises:
        InputError: it is asked for, and the data set has no odometry or no camera.
    """
    odometry, camera = dataset.odometry, dataset.camera
    if settings.matcher == "auto":
        return (
            len(dataset) > SPATIAL_LIMIT
            and odometry is not None
            and camera is not None
            and not poses_from_odometry(dataset, settings.max_gap).dropped
        )
    if settings.matcher != "spatial":
        return False
    for missing, name in ((odometry is None, ODOMETRY_FILE), (camera is None, CAMERA_FILE)):
        if missing:
            raise InputError(
                dataset.root / name,
                "does not exist, and --matcher spatial chooses by it which images see the same",
                "use --matcher sequential or exhaustive",
            )
    return True


def structure_from_motion(
    dataset: Dataset, settings: ReconstructSettings, folder: Path, progress: Progress
) -> StructureFromMotion:
    """Runs structure from motion on all images of a data set.

    The camera is fixed where the data set knows it, else a SIMPLE_RADIAL camera is estimated. No
    features are taken where the data set's mask says so.

    Args:
        dataset: the images, and odometry where ``starts_from_odometry``.
        settings: the options.
        folder: for what is finished, of the same data set and settings alone: a later call goes on
            with what it finds there.
        progress: told how far the work is.

    Raises:
        InputError: fewer than three images, or no odometry though it is needed.
        WorkerError: the worker crashed.
        StageError: its result cannot be trusted; the data set and the reason are named.
    """
    count = len(dataset.image_names)
    if count < MIN_IMAGES:
        raise InputError(
            dataset.root, f"holds {count} images; structure from motion needs {MIN_IMAGES}"
        )
    odometry = None
    if starts_from_odometry(dataset, settings):
        odometry = poses_from_odometry(dataset, settings.max_gap)
    # The worker runs in it, where a path from here would lead elsewhere.
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    request, turned = _prepare(dataset, settings, odometry, folder)
    own_names = {name: dataset.image_names[index_of(name)] for name in request.names}
    try:
        attempts, findings = _work(request, folder, dataset.camera, own_names, progress)
        if odometry is None:
            model, measured, attempt = _best_model(attempts, count, findings)
            placement: dict[str, Any] | None = None
        else:
            model, placement = _placed_model(attempts, odometry, request.names, folder)
            measured, attempt = measure(model), attempts[-1][0]
            check_model(measured, count, placement["pieces"])
    except StageError as error:
        raise type(error)(f"{dataset.root}: {error}") from error
    posed = {image.name for image in model.images}
    dropped = {} if odometry is None else dict(odometry.dropped)
    dropped |= {
        own: f"structure from motion found no firm pose ({findings.features.get(name, 0)} features)"
        for name, own in own_names.items()
        if name not in posed
    }
    statistics = {
        "registered": measured.registered,
        "images": count,
        **measured.to_dict(),
        "mapper": attempt,
        "pairs_compared": len(Path(request.pairs).read_text(encoding="utf-8").splitlines()),
        "pairs_verified": findings.verified_pairs,
        "pairs_by_rotation_share": findings.rotation_share,
        "camera_estimated": dataset.camera is None,
        **(placement or {}),
    }
    model = turned_back(model, turned)
    return StructureFromMotion(model, measured, statistics, dropped, placement is not None)


def _placed_model(
    attempts: Attempts, odometry: KnownPoses, names: list[str], folder: Path
) -> tuple[ColmapModel, dict[str, Any]]:
    """The model that started from odometry, in odometry's world, and how it was put there."""
    (path, _), *_ = attempts[-1][1]
    model = read_model(Path(path))
    parts = firm_parts(model)
    if not parts:
        raise StageError("no model: no three images see the same points")
    row_of_index = {index: row for row, index in enumerate(odometry.image_index.tolist())}
    images = sorted(parts[0].images, key=lambda image: image.name)
    rows = [row_of_index[index_of(image.name)] for image in images]
    alignment = align_to_drifting_odometry(
        inverse(np.array([image.camera_from_world for image in images])),
        odometry.world_from_camera[rows],
    )
    corrected = np.load(folder / "models" / CORRECTED_POSES)
    whole = put_together(
        model, parts, alignment.world_from_model, dict(zip(names, corrected, strict=True))
    )
    return whole.model, {
        "pieces": whole.pieces,
        "placed_by_odometry": whole.lone,
        "alignment_images": len(rows),
        "alignment_scale": alignment.world_from_model.scale,
        "odometry_drift_m": alignment.place_drift,
        "odometry_drift_deg": math.degrees(alignment.heading_drift),
    }


def _prepare(
    dataset: Dataset, settings: ReconstructSettings, odometry: KnownPoses | None, folder: Path
) -> tuple[Request, set[str]]:
    """Lays out the worker's folder, in which there may be what an earlier call has finished.

    The images are linked under numbers: COLMAP orders by name and its lists cannot hold blanks.

    Returns:
        The request, and the names of images that were turned against the first.
    """
    images, output = folder / "images", folder / "models"
    output.mkdir(exist_ok=True)
    shutil.rmtree(images, ignore_errors=True)
    images.mkdir()
    indices = range(len(dataset)) if odometry is None else odometry.image_index.tolist()
    header = read_image_header(dataset.image_path(0))
    size = (header.width, header.height)
    placed = [
        place_photo(dataset.image_path(index), images, f"{index:06d}", size) for index in indices
    ]
    names, turned = [name for name, _ in placed], {name for name, is_turned in placed if is_turned}
    if turned and dataset.mask is not None:
        raise InputError(
            dataset.root,
            "has a mask of one size, and photos in portrait and in landscape",
            "take the mask away, or reconstruct them without each other",
        )
    pair_file, odometry_file = folder / "pairs.txt", folder / "odometry.npy"
    if odometry is None:
        pairs = image_pairs(len(names), settings.matcher)
        lines = [f"{names[first]} {names[second]}\n" for first, second in pairs]
        pair_file.write_text("".join(lines), encoding="utf-8")
    else:
        np.save(odometry_file, odometry.world_from_camera)
    mask_file = folder / "mask.png"
    if dataset.mask is not None:
        mask_file.write_bytes(dataset.mask.encoded())
    camera = dataset.camera
    return Request(
        images=str(images),
        names=names,
        pairs=str(pair_file),
        database=str(folder / "database.db"),
        output=str(output),
        camera_model=ESTIMATED_CAMERA_MODEL if camera is None else camera.model,
        width=header.width,
        height=header.height,
        camera_params=None if camera is None else list(colmap_params(camera)),
        threads=min(MAX_THREADS, os.cpu_count() or 1),
        seed=settings.seed,
        max_features=settings.max_features,
        max_size=settings.max_size,
        mask=None if dataset.mask is None else str(mask_file),
        odometry=None if odometry is None else str(odometry_file),
        camera=None if odometry is None or camera is None else camera.to_dict(),
    ), turned


def _work(
    request: Request,
    folder: Path,
    camera: Camera | None,
    own_names: dict[str, str],
    progress: Progress,
) -> tuple[Attempts, DatabaseFindings]:
    """Runs the worker.

    Returns:
        The models that each attempt left, as folders and numbers of images; what was found in the
        images and between them.
    """
    attempts: Attempts = []
    findings = DatabaseFindings({}, 0, 0.0)
    with _Worker(request, folder) as worker:
        event = worker.next_event()
        while event["phase"] != "done":
            if event["phase"] == "models":
                attempts.append((event["attempt"], [(p, n) for p, n in event["models"]]))
                _log.info("%s mapping: models of %s images", *_sizes_of(attempts[-1]))
                event = worker.next_event()
                continue
            phase = str(event["phase"])
            if phase == "mapping" and not attempts:
                # Mapping what cannot succeed takes longest.
                size = (request.width, request.height)
                findings = read_findings(Path(request.database), camera, size)
                check_database(findings, own_names)
            text = PHASE_TEXTS.get(phase, f"mapping ({event.get('attempt', '')})")
            total = event.get("total", len(request.names))
            steps = worker.steps(COUNTED_TABLES.get(phase), total)
            for _ in progress(steps, text, total):
                pass
            event = worker.last_event
    return attempts, findings


def _sizes_of(attempt: tuple[str, list[tuple[str, int]]]) -> tuple[str, list[int]]:
    return attempt[0], [count for _, count in attempt[1]]


def _best_model(
    attempts: Attempts, total: int, database: DatabaseFindings
) -> tuple[ColmapModel, ModelFindings, str]:
    """The firm model with the most images that passes the checks, its measures, its attempt."""
    candidates: list[tuple[ColmapModel, str, list[int]]] = []
    for name, models in attempts:
        found = [read_model(Path(path)) for path, _ in models]
        pieces = [(model, rows) for model in found for rows in firm_pieces(model)]
        sizes = [len(rows) for _, rows in pieces]
        candidates += [(restrict(model, rows), name, sizes) for model, rows in pieces]
    candidates.sort(key=lambda candidate: -len(candidate[0].images))
    failures: list[StageError] = []
    for model, name, sizes in candidates:
        findings = measure(model)
        try:
            check_model(findings, total, sizes)
        except StageError as error:
            failures.append(error)
            continue
        return model, findings, name
    if failures:
        raise failures[0]
    raise StageError(
        f"no model: {database.verified_pairs} pairs of images match, but none of them sees the "
        "scene from two sufficiently different places"
    )


class _Worker:
    """The worker process and what it is doing; killed when the block ends, however it ends."""

    def __init__(self, request: Request, folder: Path) -> None:
        self.database = Path(request.database)
        self.last_event: dict[str, Any] = {"phase": "start"}
        request_path = folder / "request.json"
        request_path.write_text(json.dumps(asdict(request)), encoding="utf-8")
        command = (*WORKER_COMMAND, str(request_path))
        self._process = WorkerProcess(command, folder, "structure from motion")

    def __enter__(self) -> "_Worker":
        self._process.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._process.__exit__(*exception)

    def next_event(self, timeout: float | None = None) -> dict[str, Any]:
        """The next event; ``queue.Empty`` after ``timeout`` seconds.

        Raises:
            StageError: the worker ended before it was done.
        """
        event = self._process.read(timeout)
        if "phase" not in event:
            raise StageError(f"the worker for structure from motion said {quoted(event)}")
        if event["phase"] != "image":
            self.last_event = event
        return event

    def steps(self, table: str | None, total: int) -> Iterator[int]:
        """Yields once for each finished item of a phase, until the next phase begins.

        Args:
            table: of the database, whose rows are the finished items; None: they are announced.
            total: items at most.
        """
        done = 0
        while True:
            finished = done
            try:
                event = self.next_event(timeout=POLL_SECONDS)
                if event["phase"] != "image":
                    return
                finished += 1
            except queue.Empty:
                if table is not None:
                    finished = count_rows(self.database, table)
            while done < min(finished, total):
                done += 1
                yield done
