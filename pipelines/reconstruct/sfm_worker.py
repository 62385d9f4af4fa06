"""Structure from motion with pycolmap, in a process of its own.

Started by ``sfm`` as ``python -m pipelines.reconstruct.sfm_worker REQUEST``. There it can be
stopped, what pycolmap logs stays apart, and a crash is an error of one stage.

Protocol: the request is a JSON file (``Request``); events are JSON lines on stdout; pycolmap's
chatter goes to stderr; stdin stays open as long as the parent lives. A failed attempt is no error
here, the parent judges what came out.
"""

import json
import os
import shutil
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.processes import die_with_parent, own_output
from pipelines.geometry.camera import camera_from_dict
from pipelines.reconstruct.odometry_mapping import ROUNDS, OdometryMapping
from pipelines.reconstruct.photo_pairs import Pairs

# Degrees between the two first views. COLMAP's default of 16 is safest, but pictures taken facing
# forward do not have it.
WIDE_FIRST_ANGLE, NARROW_FIRST_ANGLE = 16.0, 4.0
# A model with this share of the images ends the search for a better one.
GOOD_SHARE = 0.95
# Sums over several threads come out in another order every time, and so does the result.
MAPPING_THREADS = 1
# The first one in a database.
CAMERA_NUMBER = 1


@dataclass(frozen=True)
class Request:
    """What the worker is to do.

    Attributes:
        images: folder of the images.
        names: their names in time order; the names sort in that order too.
        pairs: text file with two names a line: the images to compare; with odometry it is written
            here, by what the images show.
        database: file to be made.
        output: existing folder; each attempt's models come into ``<attempt>/<number>``.
        camera_model: COLMAP's name.
        width, height: pixels of the images.
        camera_params: COLMAP's parameters and pixel convention, fixed; None: to be estimated.
        threads: how many at most.
        seed, max_features, max_size: as in ``ReconstructSettings``.
        mask: a grey image of that size; no features are taken where it is 0; None: everywhere.
        odometry: file of NumPy with world_from_camera ``(N, 4, 4)``, from which the mapping
            starts; None: from the images alone.
        camera: of ``camera.toml``, where there is odometry.
    """

    images: str
    names: list[str]
    pairs: str
    database: str
    output: str
    camera_model: str
    width: int
    height: int
    camera_params: list[float] | None
    threads: int
    seed: int
    max_features: int
    max_size: int
    mask: str | None = None
    odometry: str | None = None
    camera: dict[str, Any] | None = None


# Names the attempt that starts from odometry, and the file of the poses that it starts from.
FROM_ODOMETRY, CORRECTED_POSES = "from odometry", "corrected.npy"

Emit = Callable[[dict[str, Any]], None]


def run(request: Request, emit: Emit) -> None:
    """Extracts, matches and maps; every step is announced through ``emit``."""
    import pycolmap

    pycolmap.set_random_seed(request.seed)
    emit({"phase": "features"})
    _extract(request)
    if request.odometry is not None:
        _map_from_odometry(request, emit)
        emit({"phase": "done"})
        return
    lines = Path(request.pairs).read_text(encoding="utf-8").splitlines()
    emit({"phase": "matching", "total": len(lines)})
    _match(request)
    attempts: dict[str, Callable[[Path], None]] = {
        "incremental": lambda folder: _map_incrementally(request, folder, emit, WIDE_FIRST_ANGLE),
        "incremental from narrow views": lambda folder: _map_incrementally(
            request, folder, emit, NARROW_FIRST_ANGLE
        ),
        "global": lambda folder: _map_globally(request, folder),
    }
    for name, attempt in attempts.items():
        emit({"phase": "mapping", "attempt": name})
        folder = Path(request.output) / name.replace(" ", "_")
        # Of a mapping that was killed; it begins anew.
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        attempt(folder)
        models = _models_in(folder)
        emit({"phase": "models", "attempt": name, "models": models})
        if models and max(count for _, count in models) >= GOOD_SHARE * len(request.names):
            break
    emit({"phase": "done"})


def _extract(request: Request) -> None:
    import pycolmap

    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = request.camera_model
    database = Path(request.database)
    if not database.exists():
        # Whole or not at all: after a kill the next call goes on with what is there.
        unfinished = database.with_suffix(".unfinished")
        unfinished.unlink(missing_ok=True)
        _register(request, reader, unfinished)
        unfinished.rename(database)
    reader.existing_camera_id = CAMERA_NUMBER
    if request.mask is not None:
        reader.camera_mask_path = request.mask
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.max_image_size = request.max_size
    extraction.sift.max_num_features = request.max_features
    extraction.num_threads = request.threads
    pycolmap.extract_features(
        request.database,
        request.images,
        image_names=request.names,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )


def _register(request: Request, reader: Any, path: Path) -> None:
    """Enters the camera and the images before their features are there.

    Left to the extraction, the images would be numbered in the order in which its threads happen
    to finish, and the numbers steer the mapping: no two runs would be alike.
    """
    import pycolmap

    if request.camera_params is None:
        # The focal length from the image's own record, else a guess from its size.
        camera = pycolmap.infer_camera_from_image(Path(request.images) / request.names[0], reader)
    else:
        camera = pycolmap.Camera(
            model=request.camera_model,
            width=request.width,
            height=request.height,
            params=request.camera_params,
        )
        camera.has_prior_focal_length = True
    with pycolmap.Database.open(path) as database:
        camera.camera_id = database.write_camera(camera)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(camera.sensor_id)
        rig_number = database.write_rig(rig)
        for name in request.names:
            image = pycolmap.Image(name=name, camera_id=camera.camera_id)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rig_number
            frame.add_data_id(image.data_id)
            database.write_frame(frame)


def _match(request: Request) -> None:
    import pycolmap

    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = request.seed
    verification.compute_relative_pose = request.odometry is not None
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = request.threads
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = request.pairs
    pycolmap.match_image_pairs(
        request.database,
        matching_options=matching,
        pairing_options=pairing,
        verification_options=verification,
        device=pycolmap.Device.cpu,
    )


def _map_from_odometry(request: Request, emit: Emit) -> None:
    """Chooses and matches pairs by odometry, and maps from its poses; after a kill it goes on."""
    mapping = OdometryMapping(
        Path(request.database),
        Path(request.images),
        request.names,
        camera_from_dict(request.camera or {}),
        np.load(request.odometry or ""),
        request.seed,
    )

    def match(pairs: Pairs) -> None:
        lines = [f"{request.names[first]} {request.names[second]}\n" for first, second in pairs]
        Path(request.pairs).write_text("".join(lines), encoding="utf-8")
        emit({"phase": "matching", "total": len(pairs)})
        _match(request)

    poses = mapping.compare(match)
    np.save(Path(request.output) / CORRECTED_POSES, poses)
    emit({"phase": "mapping", "attempt": FROM_ODOMETRY, "total": len(ROUNDS)})
    rounds = Path(request.output) / "rounds"
    rounds.mkdir(exist_ok=True)
    model = mapping.adjust(poses, rounds, lambda: emit({"phase": "image"}))
    models = [(str(model), len(request.names))]
    emit({"phase": "models", "attempt": FROM_ODOMETRY, "models": models})


def _map_incrementally(request: Request, folder: Path, emit: Emit, first_angle: float) -> None:
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = MAPPING_THREADS
    options.random_seed = request.seed
    options.mapper.random_seed = request.seed
    options.triangulation.random_seed = request.seed
    options.mapper.init_min_tri_angle = first_angle
    if request.camera_params is not None:
        options.ba_refine_focal_length = False
        options.ba_refine_extra_params = False
        options.mapper.abs_pose_refine_focal_length = False
        options.mapper.abs_pose_refine_extra_params = False
    pycolmap.incremental_mapping(
        request.database,
        request.images,
        folder,
        options=options,
        next_image_callback=lambda: emit({"phase": "image"}),
    )


def _map_globally(request: Request, folder: Path) -> None:
    import pycolmap

    options = pycolmap.GlobalPipelineOptions()
    options.num_threads = MAPPING_THREADS
    options.random_seed = request.seed
    options.mapper.random_seed = request.seed
    options.mapper.rotation_averaging.random_seed = request.seed
    options.mapper.global_positioning.random_seed = request.seed
    if request.camera_params is not None:
        options.mapper.bundle_adjustment.refine_focal_length = False
        options.mapper.bundle_adjustment.refine_extra_params = False
    pycolmap.global_mapping(request.database, request.images, folder, options=options)


def _models_in(folder: Path) -> list[tuple[str, int]]:
    """The models that an attempt left: folder and number of images with a pose."""
    models: list[tuple[str, int]] = []
    for model in sorted(folder.iterdir()):
        path = model / "images.bin"
        if path.is_file():
            with path.open("rb") as file:
                models.append((str(model), int.from_bytes(file.read(8), "little")))
    return models


def _die_with_parent() -> None:
    """Ends this process when the parent has ended, in whatever way."""
    die_with_parent()

    def wait_for_end_of_input() -> None:
        os.read(0, 1)
        os._exit(1)

    threading.Thread(target=wait_for_end_of_input, daemon=True).start()


def main(arguments: list[str]) -> None:
    """Reads the request and runs it."""
    _die_with_parent()
    # Whatever a library prints must not mix with the events.
    events = own_output()

    def emit(event: dict[str, Any]) -> None:
        events.write(json.dumps(event) + "\n")
        events.flush()

    request = Request(**json.loads(Path(arguments[0]).read_text(encoding="utf-8")))
    run(request, emit)


if __name__ == "__main__":
    main(sys.argv[1:])
