"""The run: what the filter believed frame by frame, in memory and as the file ``run.h5``.

Layout of the file: ``run`` (JSON: scene, data set, camera, settings, seed, provenance),
``base_from_camera``, ``odometry`` and ``groundtruth`` where known, ``docking`` where the robot was
docked (``docking_record``), and a group a frame, ``frames/0000`` ..., with ``frame`` (JSON),
``image`` (the recorded file's bytes), ``particles``, ``log_weights``, ``modes``, ``covariance``,
``estimates/NAME`` and ``refined_covariance``. Seconds of wall time are attributes of the frame's
group: all datasets of two runs with the same seed are equal, and time never is.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipelines.artifacts.arguments import (
    PathLike,
    checked_choice,
    checked_instance,
    checked_number,
    checked_path,
)
from pipelines.artifacts.arrays import FloatArray, checked_array
from pipelines.artifacts.errors import InputError, LfnavError, OptionError, quoted, reason_of
from pipelines.artifacts.safe_hdf5 import (
    SafeFile,
    check_schema,
    create_hdf5,
    open_hdf5,
    write_array,
    write_attribute,
    write_json,
    write_schema,
)
from pipelines.artifacts.settings_file import with_current_names
from pipelines.geometry.camera import Camera, camera_from_dict
from pipelines.lightfield.area_map import AreaMap, read_area_map, write_area_map
from pipelines.localize.belief import NORMALISATION_TOLERANCE, Belief
from pipelines.localize.config import ENTRIES
from pipelines.localize.docking_record import DockingRecord, read_docking, write_docking
from pipelines.localize.state_space import StateSpace, state_space_of_dimension

FORMAT = "lfnav run"
SCHEMA_VERSION = 2
STATUSES = ("global", "tracking", "blind", "stale", "lost")
# Of images that say nothing of where the body is: odometry alone carries the pose on.
BY_ODOMETRY = ("blind", "stale")
# Estimate -> its fallback in frames without it: in a search, or for a blind image, none is aligned.
STAND_INS = {"refined": "mode"}
# The default estimate of a run is the first of these that the frames have.
ESTIMATE_PREFERENCE = ("refined", "mode", "mean", "max_weight")
# The pose by features; where it only runs beside the filter it is never the default.
PNP_ESTIMATE = "pnp"
MAX_IMAGE_BYTES = 256 * 1024 * 1024
SECONDS_PREFIX = "seconds_"
# What JSON of another structure than expected leads to.
_MALFORMED = (KeyError, TypeError, ValueError, AttributeError, OverflowError)


@dataclass(frozen=True)
class FrameRecord:
    """The belief after one image, and what was concluded from it.

    Attributes:
        timestamp: seconds.
        image_name: as in the data set.
        particles: ``(M, D)`` states, metres and radians, weighted with this image, before
            resampling.
        log_weights: ``(M,)`` normalised.
        estimates: name -> state ``(D,)``; empty where no estimate can be given (lost).
        modes: ``(K, D + 1)`` state and share of the weight; heaviest first.
        covariance: ``(D, D)`` of the heaviest mode.
        effective_sample_size: 1 / sum of the squared weights.
        confidence: 0 to 1; of the filter the probability that the estimate is within 0.1 m and 3
            degrees of the truth.
        status: one of ``STATUSES``: still searching, following one place, following it by odometry
            alone since the image shows nothing (blind) or is an old one (stale), or lost.
        seconds: stage -> wall time.
        refined_covariance: ``(D, D)`` of the error of the estimate ``refined``, or None.
        area_belief: ``(A,)`` in a world of areas the probability of each; what is left is that of
            none of them. None: a scene.

    Raises:
        OptionError: shapes, ranges or names that do not fit the above.
        StageError: weights that do not add up to 1.
    """

    timestamp: float
    image_name: str
    particles: FloatArray
    log_weights: FloatArray
    estimates: Mapping[str, FloatArray]
    modes: FloatArray
    covariance: FloatArray
    effective_sample_size: float
    confidence: float
    status: str
    seconds: Mapping[str, float]
    refined_covariance: FloatArray | None = None
    area_belief: FloatArray | None = None

    def __post_init__(self) -> None:
        _check_mapping(self.estimates, "estimates")
        _check_mapping(self.seconds, "seconds")
        # Belief's own checks are the ones that particles and weights have to pass.
        Belief(self.particles, self.log_weights)
        dimension = self.particles.shape[1]
        for name, state in self.estimates.items():
            if not checked_instance(name, "name of an estimate", str).isidentifier():
                raise OptionError(f"{quoted(name)} is not a name for an estimate")
            checked_array(state, f"estimate {name}", (dimension,))
        checked_array(self.modes, "modes", (None, dimension + 1))
        square = (dimension, dimension)
        checked_array(self.covariance, "covariance", square)
        if self.refined_covariance is not None:
            checked_array(self.refined_covariance, "covariance of refined", square)
        if self.area_belief is not None:
            belief = checked_array(self.area_belief, "belief over areas", (None,))
            if np.any(belief < 0.0) or belief.sum() > 1.0 + NORMALISATION_TOLERANCE:
                raise OptionError("the belief over areas is not made of probabilities")
        checked_choice(self.status, "status", STATUSES)
        checked_number(self.confidence, "confidence", 0.0, 1.0)
        checked_array(self.timestamp, "timestamp", ())
        checked_array(self.effective_sample_size, "effective sample size", ())
        for stage, seconds in self.seconds.items():
            checked_array(seconds, f"seconds of {quoted(stage)}", ())
            if not checked_instance(stage, "name of a stage", str).isidentifier():
                raise OptionError(f"{quoted(stage)} is not a name for a stage")

    @property
    def belief(self) -> Belief:
        """Particles and weights as a belief."""
        return Belief(self.particles, self.log_weights)


@dataclass(frozen=True)
class Run:
    """A localized recording.

    Attributes:
        scene_identifier: content hash of the scene model it was made with.
        scene_path: where that was, relative to the run file where possible (``locate_scene``).
        dataset_name: name of the localized data set.
        camera: its camera.
        base_from_camera: ``(4, 4)`` the camera's mount.
        settings: the filter's settings, plain JSON types. A text ``estimate`` among them names the
            default estimate.
        seed: of the random numbers.
        frames: at least one, in order of time.
        encoded_images: the camera images' file content, one a frame, as recorded.
        odometry: ``(N, D)`` states of integrated odometry in its own frame, or None.
        groundtruth: ``(N, D)`` true states, NaN in frames without one, or None.
        provenance: versions and hashes of the inputs, plain JSON types.
        docking: goal, commands and outcome, where the robot was docked and not only followed.
        areas: of the world, in the order of the frames' ``area_belief``; None: it was made with one
            scene.

    Raises:
        OptionError: no frames, or parts of different length, or times that do not increase.
    """

    scene_identifier: str
    scene_path: str
    dataset_name: str
    camera: Camera
    base_from_camera: FloatArray
    settings: Mapping[str, Any]
    seed: int
    frames: tuple[FrameRecord, ...]
    encoded_images: tuple[bytes, ...]
    odometry: FloatArray | None
    groundtruth: FloatArray | None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    docking: DockingRecord | None = None
    areas: AreaMap | None = None

    def __post_init__(self) -> None:
        for number, frame in enumerate(checked_instance(self.frames, "frames", tuple)):
            checked_instance(frame, f"frame {number}", FrameRecord)
        checked_instance(self.encoded_images, "encoded images", tuple)
        checked_instance(self.camera, "camera", Camera)
        _check_mapping(self.settings, "settings")
        count = len(self.frames)
        if count == 0:
            raise OptionError("the run has no frames")
        if len(self.encoded_images) != count:
            raise OptionError(f"{count} frames with {len(self.encoded_images)} images")
        if np.any(np.diff(self.timestamps) <= 0.0):
            raise OptionError("the frames' timestamps do not increase")
        checked_array(self.base_from_camera, "base_from_camera", (4, 4))
        dimension = self.frames[0].particles.shape[1]
        if any(frame.particles.shape[1] != dimension for frame in self.frames):
            raise OptionError("the frames' states differ in their degrees of freedom")
        if self.areas is not None:
            checked_instance(self.areas, "areas", AreaMap)
        areas = 0 if self.areas is None else len(self.areas)
        if any((0 if f.area_belief is None else len(f.area_belief)) != areas for f in self.frames):
            raise OptionError("the frames' beliefs over areas are not of the run's areas")
        shape = (count, dimension)
        if self.odometry is not None:
            checked_array(self.odometry, "odometry", shape)
        if self.groundtruth is not None:
            checked_array(self.groundtruth, "ground truth", shape, finite=False)

    @property
    def space(self) -> StateSpace:
        """What a state of this run is."""
        return state_space_of_dimension(self.frames[0].particles.shape[1])

    @property
    def timestamps(self) -> FloatArray:
        """``(N,)`` seconds."""
        return np.array([frame.timestamp for frame in self.frames])

    @property
    def frame_seconds(self) -> FloatArray:
        """``(N,)`` wall time of each frame, without PnP where it only ran beside the filter."""
        settings = self.settings
        beside = settings.get("with_pnp") and settings.get("proposal") == "retrieval"
        skipped = PNP_ESTIMATE if beside else None
        return np.array(
            [
                sum(time for stage, time in frame.seconds.items() if stage != skipped)
                for frame in self.frames
            ],
            dtype=np.float64,
        )

    @property
    def estimate_names(self) -> tuple[str, ...]:
        """Names of the estimates that any frame has, sorted."""
        return tuple(sorted({name for frame in self.frames for name in frame.estimates}))

    @property
    def own_estimate_names(self) -> tuple[str, ...]:
        """Names of the estimates, sorted, without PnP where that only ran beside the filter."""
        is_own = self.settings.get("method") == "pnp"
        return tuple(name for name in self.estimate_names if is_own or name != PNP_ESTIMATE)

    @property
    def default_estimate(self) -> str:
        """The default estimate: the one that the settings name, else the finest there is.

        Raises:
            OptionError: no frame has an estimate.
        """
        names = self.own_estimate_names
        for name in (self.settings.get("estimate"), *ESTIMATE_PREFERENCE, *names):
            if name in names:
                return str(name)
        raise OptionError("no frame of the run has an estimate: the filter was lost throughout")

    def estimated_states(self, estimate: str | None = None) -> FloatArray:
        """``(N, D)`` states of one kind of estimate; NaN in frames where the filter gave none.

        Args:
            estimate: its name; None for ``default_estimate``, for which in frames that lack it the
                coarser estimate of ``STAND_INS`` is taken.

        Raises:
            OptionError: no frame has an estimate of this name.
        """
        name = self.default_estimate if estimate is None else estimate
        checked_instance(name, "estimate", str)
        if name not in self.estimate_names:
            raise OptionError(
                f"the run has no estimate {quoted(name)}; it has {', '.join(self.estimate_names)}"
            )
        missing = np.full(self.space.dimension, np.nan)
        stand_in = STAND_INS.get(name, name) if estimate is None else name
        return np.stack(
            [
                frame.estimates.get(name, frame.estimates.get(stand_in, missing))
                for frame in self.frames
            ]
        )


def _check_mapping(value: object, name: str) -> None:
    if not isinstance(value, Mapping):
        raise OptionError(f"{name} of type {type(value).__name__} instead of a mapping")


def save_run(path: PathLike, run: Run, overwrite: bool = False) -> None:
    """Writes a run, whole or not at all.

    Args:
        path: of the file, ``run.h5``.
        run: the run.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the file exists and ``overwrite`` is not set, or cannot be written.
        OptionError: ``path`` is no path, or ``run`` no run.
    """
    path = checked_path(path, "the run's path")
    checked_instance(run, "the run", Run)
    with create_hdf5(path, overwrite) as file:
        write_schema(file, FORMAT, SCHEMA_VERSION)
        header = {
            "scene_identifier": run.scene_identifier,
            "scene_path": run.scene_path,
            "dataset_name": run.dataset_name,
            "camera": run.camera.to_dict(),
            "settings": dict(run.settings),
            "seed": run.seed,
            "frames": len(run.frames),
            "provenance": dict(run.provenance),
        }
        write_json(file, "run", header)
        if run.areas is not None:
            write_area_map(file, run.areas)
        write_array(file, "base_from_camera", run.base_from_camera)
        for name, states in (("odometry", run.odometry), ("groundtruth", run.groundtruth)):
            if states is not None:
                write_array(file, name, states)
        if run.docking is not None:
            write_docking(file, run.docking)
        for index, (frame, image) in enumerate(zip(run.frames, run.encoded_images, strict=True)):
            _write_frame(file.create_group(_group_name(index)), frame, image)


def load_run(path: PathLike) -> Run:
    """Reads a run; the file may come from anybody.

    Args:
        path: of the file, ``run.h5``.

    Raises:
        OptionError: ``path`` is no path.
        InputError: not a run, of a newer schema, damaged, or with values that do not fit together.
    """
    path = checked_path(path, "the run's path")
    with open_hdf5(path) as file:
        check_schema(file, FORMAT, SCHEMA_VERSION)
        try:
            return _read_run(file)
        except InputError:
            raise
        except (LfnavError, *_MALFORMED) as error:
            raise InputError(path, f"is not a valid run ({reason_of(error)})") from error


def _group_name(index: int) -> str:
    return f"frames/{index:04d}"


def _write_frame(group: Any, frame: FrameRecord, image: bytes) -> None:
    header = {
        "timestamp": float(frame.timestamp),
        "image_name": frame.image_name,
        "effective_sample_size": float(frame.effective_sample_size),
        "confidence": float(frame.confidence),
        "status": frame.status,
        "degrees_of_freedom": frame.particles.shape[1],
        "estimates": sorted(frame.estimates),
        "stages": sorted(frame.seconds),
    }
    write_json(group, "frame", header)
    write_array(group, "image", np.frombuffer(image, dtype=np.uint8))
    write_array(group, "particles", frame.particles, compress=True)
    write_array(group, "log_weights", frame.log_weights, compress=True)
    write_array(group, "modes", frame.modes)
    write_array(group, "covariance", frame.covariance)
    if frame.refined_covariance is not None:
        write_array(group, "refined_covariance", frame.refined_covariance)
    if frame.area_belief is not None:
        write_array(group, "area_belief", frame.area_belief)
    for name, state in frame.estimates.items():
        write_array(group, f"estimates/{name}", state)
    for stage, seconds in frame.seconds.items():
        write_attribute(group, SECONDS_PREFIX + stage, float(seconds))


def _read_run(file: SafeFile) -> Run:
    header = file.read_json("run")
    count = int(header["frames"])
    if count != len(file.names("frames")):
        raise InputError(file.path, f"declares {count} frames, has {len(file.names('frames'))}")
    frames, images = [], []
    for index in range(count):
        frame, image = _read_frame(file, _group_name(index))
        frames.append(frame)
        images.append(image)
    return Run(
        scene_identifier=str(header["scene_identifier"]),
        scene_path=str(header["scene_path"]),
        dataset_name=str(header["dataset_name"]),
        camera=camera_from_dict(header["camera"]),
        base_from_camera=_read_floats(file, "base_from_camera", (4, 4)),
        settings=with_current_names(dict(header["settings"]), ENTRIES),
        seed=int(header["seed"]),
        frames=tuple(frames),
        encoded_images=tuple(images),
        odometry=_read_optional_states(file, "odometry", count),
        groundtruth=_read_optional_states(file, "groundtruth", count),
        provenance=dict(header["provenance"]),
        docking=read_docking(file, count),
        areas=read_area_map(file),
    )


def _read_frame(file: SafeFile, group: str) -> tuple[FrameRecord, bytes]:
    header = file.read_json(f"{group}/frame")
    image = file.read_array(
        f"{group}/image", dtype_kind="u", shape=(None,), max_bytes=MAX_IMAGE_BYTES
    )
    if image.dtype != np.uint8:
        raise InputError(file.path, f"{group}/image is not made of bytes")
    # Files of schema 1 know robots on the floor only.
    dimension = int(header.get("degrees_of_freedom", 3))
    square = (dimension, dimension)
    refined_covariance = None
    if file.has(f"{group}/refined_covariance"):
        refined_covariance = _read_floats(file, f"{group}/refined_covariance", square)
    has_areas = file.has(f"{group}/area_belief")
    frame = FrameRecord(
        timestamp=float(header["timestamp"]),
        image_name=str(header["image_name"]),
        particles=_read_floats(file, f"{group}/particles", (None, dimension)),
        log_weights=_read_floats(file, f"{group}/log_weights", (None,)),
        estimates={
            str(name): _read_floats(file, f"{group}/estimates/{name}", (dimension,))
            for name in header["estimates"]
        },
        modes=_read_floats(file, f"{group}/modes", (None, dimension + 1)),
        covariance=_read_floats(file, f"{group}/covariance", square),
        effective_sample_size=float(header["effective_sample_size"]),
        confidence=float(header["confidence"]),
        status=str(header["status"]),
        seconds={
            str(stage): file.attribute(f"{SECONDS_PREFIX}{stage}", float, group)
            for stage in header["stages"]
        },
        refined_covariance=refined_covariance,
        area_belief=_read_floats(file, f"{group}/area_belief", (None,)) if has_areas else None,
    )
    return frame, image.tobytes()


def _read_floats(file: SafeFile, name: str, shape: tuple[int | None, ...]) -> FloatArray:
    values = file.read_array(name, dtype_kind="f", shape=shape)
    return np.asarray(values, dtype=np.float64)


def _read_optional_states(file: SafeFile, name: str, count: int) -> FloatArray | None:
    return _read_floats(file, name, (count, None)) if file.has(name) else None
