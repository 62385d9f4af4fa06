"""The scene model on disk: ``scene.h5``.

Layout: ``scene`` (JSON: names, cameras, surface, scale source, provenance), ``timestamps``,
``camera_index``, ``world_from_camera``, ``bounds``, ``base_from_camera`` where there is one, and a
dataset a view, ``images/000000`` ..., with the bytes of the photo as recorded. With depth maps
also, for each view, ``depth/000000/inverse`` (16 bits; times ``depth/000000/scale``: 1 / metres; 0:
unknown) and ``depth/000000/confident``. Without a plane also the free ground: ``ground/cells``,
``ground/corner`` and ``ground/cell``.

A scene in compact storage holds WebP files as its photos, and of depth maps, in the place of
``inverse``, its ``differences`` (``differences_of``) and, in the place of ``confident``, its bits,
eight pixels a byte, row by row.

A scene without a plane, or in compact storage, is written as schema 2, any other one as schema 1.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arguments import PathLike, checked_instance, checked_path
from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.artifacts.errors import InputError, OptionError, reason_of
from pipelines.artifacts.json_fields import JsonFields
from pipelines.artifacts.kinds import refuse_world
from pipelines.artifacts.safe_hdf5 import (
    SafeFile,
    check_schema,
    create_hdf5,
    open_hdf5,
    write_array,
    write_json,
    write_schema,
)
from pipelines.dataset.images import image_header
from pipelines.dataset.webp import check_webp, webp_header
from pipelines.geometry.camera import Camera, camera_from_dict
from pipelines.geometry.plane import Plane, plane_from_coefficients
from pipelines.geometry.pose import are_rigid
from pipelines.lightfield.free_ground import FreeGround
from pipelines.lightfield.scene import Compaction, PlaneEstimate, Scene, SceneDepth

FORMAT = "lfnav scene"
SCHEMA_VERSION = 2
# Inverse depth is stored in at most so many levels.
FULL_LEVELS, COMPACT_LEVELS = 65535, 1023
MAX_IMAGE_BYTES = 256 * 1024 * 1024
SMALLEST_SIDE = 1e-6  # of the bounds, metres or units
# What JSON of another structure than expected leads to.
_MALFORMED = (KeyError, TypeError, ValueError, AttributeError, OverflowError, OptionError)


def save_scene(
    path: PathLike,
    scene: Scene,
    overwrite: bool = False,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Writes a scene model, whole or not at all.

    Args:
        path: the file.
        scene: the light field.
        overwrite: whether an existing file may be replaced.
        provenance: versions, settings and hashes of the inputs; plain JSON types.

    Raises:
        InputError: the file exists (without ``overwrite``) or cannot be written.
        OptionError: ``path`` is no path, or ``scene`` no scene.
    """
    path = checked_path(path, "the scene's path")
    checked_instance(scene, "the scene", Scene)
    with create_hdf5(path, overwrite) as file:
        is_full = scene.compaction is None
        write_schema(file, FORMAT, _schema_of(scene))
        write_json(file, "scene", {**_description(scene), "provenance": dict(provenance or {})})
        write_array(file, "timestamps", scene.timestamps)
        write_array(file, "camera_index", scene.camera_index)
        write_array(file, "world_from_camera", scene.world_from_camera)
        write_array(file, "bounds", scene.bounds)
        if scene.base_from_camera is not None:
            write_array(file, "base_from_camera", scene.base_from_camera)
        if scene.ground is not None:
            write_array(file, "ground/cells", scene.ground.cells, compress=True)
            write_array(file, "ground/corner", scene.ground.corner)
            write_array(file, "ground/cell", np.float64(scene.ground.cell))
        for index, data in enumerate(scene.encoded_images):
            write_array(file, f"images/{index:06d}", np.frombuffer(data, dtype=np.uint8))
        for index, depth in enumerate(scene.depth):
            _write_depth(file, f"depth/{index:06d}", depth, is_full)


def load_scene(path: PathLike) -> Scene:
    """Reads a scene model; photos stay encoded until they are used.

    Args:
        path: a ``scene.h5``, made by ``lfnav model`` or ``save_scene``.

    Raises:
        InputError: missing, not a scene, damaged, of a newer schema, or with contents that
            contradict each other.
        StageError: in compact storage, and Pillow was built without WebP.
        OptionError: ``path`` is no path.
    """
    path = checked_path(path, "the scene's path")
    refuse_world(path)
    scene = _read(path)
    if identified(scene).identifier != scene.identifier:
        raise InputError(path, "was changed after it was written", "make it again")
    return scene


def load_part(path: Path, views: Sequence[int]) -> Scene:
    """Reads some views of a scene model, and no more of the file than these need.

    Args:
        path: the file.
        views: their numbers, from 0.

    Returns:
        A scene of these views, in their order, with the identifier of the whole. That the whole is
        what the identifier says is not checked; each part is read by its checksum.

    Raises:
        InputError: missing, not a scene, damaged, of a newer schema, without such views, or with
            contents that contradict each other.
        StageError: in compact storage, and Pillow was built without WebP.
    """
    return _read(path, views)


def _read(path: Path, views: Sequence[int] | None = None) -> Scene:
    """The scene in a file, or some of its views, checked but for the identifier."""
    with open_hdf5(path) as file:
        check_schema(file, FORMAT, SCHEMA_VERSION)
        description = file.read_json("scene")
        try:
            scene = _scene_of(file, description, views)
        except _MALFORMED as error:
            raise InputError(
                path, f"has contents that are no scene ({reason_of(error)})"
            ) from error
    _check(path, scene)
    return scene


def scene_provenance(path: Path) -> dict[str, Any]:
    """The provenance stored with a scene model.

    Raises:
        InputError: missing, not a scene, damaged, or of a newer schema.
    """
    with open_hdf5(path) as file:
        check_schema(file, FORMAT, SCHEMA_VERSION)
        description = file.read_json("scene")
    stored = description.get("provenance", {}) if isinstance(description, dict) else {}
    return stored if isinstance(stored, dict) else {}


def scene_identifier(path: Path) -> str:
    """The identifier stored with a scene model; whether it is that of the content is not checked.

    Raises:
        InputError: missing, not a scene, damaged, or of a newer schema.
    """
    with open_hdf5(path) as file:
        check_schema(file, FORMAT, SCHEMA_VERSION)
        return JsonFields(path, file.read_json("scene")).get("identifier", str)


def quantised(
    inverse_depth: Float32Array, most: int = FULL_LEVELS
) -> tuple[NDArray[np.uint16], float]:
    """Inverse depth in levels of at most ``most``, and the factor that makes 1 / metres of them.

    The factor is a power of two: what was read is written again as the same bytes.
    """
    scale = 2.0 ** math.ceil(math.log2(max(float(inverse_depth.max()), 1e-9) / most))
    return np.rint(inverse_depth / scale).astype(np.uint16), scale


def as_stored(
    inverse_depth: Float32Array, confident: BoolArray, most: int = FULL_LEVELS
) -> SceneDepth:
    """A depth map rounded to what the file keeps of it, in levels of at most ``most``."""
    levels, scale = quantised(inverse_depth, most)
    return SceneDepth((levels * scale).astype(np.float32), confident)


def identifier_of(
    encoded_images: tuple[bytes, ...],
    cameras: Sequence[Camera],
    camera_index: IntArray,
    world_from_camera: FloatArray,
    surface: PlaneEstimate | None,
    base_from_camera: FloatArray | None,
    depth: Sequence[SceneDepth] = (),
) -> str:
    """Hash of all that decides what a scene looks like; names it across files."""
    digest = hashlib.sha256()
    for data in encoded_images:
        digest.update(hashlib.sha256(data).digest())
    for index in camera_index.tolist():
        camera = cameras[index]
        digest.update(f"{camera.model} {camera.width} {camera.height}".encode())
        digest.update(np.array(camera.params, dtype="<f8").tobytes())
    digest.update(np.ascontiguousarray(world_from_camera, dtype="<f8").tobytes())
    if surface is not None:
        digest.update(surface.plane.coefficients().astype("<f8").tobytes())
    if base_from_camera is not None:
        digest.update(np.ascontiguousarray(base_from_camera, dtype="<f8").tobytes())
    for depth_map in depth:
        digest.update(np.ascontiguousarray(depth_map.inverse_depth, dtype="<f4").tobytes())
        digest.update(np.ascontiguousarray(depth_map.confident).tobytes())
    return digest.hexdigest()


def identified(scene: Scene) -> Scene:
    """The scene with the identifier that its content has."""
    identifier = identifier_of(
        scene.encoded_images,
        scene.cameras,
        scene.camera_index,
        scene.world_from_camera,
        scene.surface,
        scene.base_from_camera,
        scene.depth,
    )
    return replace(scene, identifier=identifier)


def _write_depth(file: h5py.File, group: str, depth: SceneDepth, is_full: bool) -> None:
    levels, scale = quantised(depth.inverse_depth, FULL_LEVELS if is_full else COMPACT_LEVELS)
    if is_full:
        write_array(file, f"{group}/inverse", levels, compress=True)
    else:
        write_array(file, f"{group}/differences", differences_of(levels), compress=True)
    write_array(file, f"{group}/scale", np.float64(scale))
    if is_full:
        write_array(file, f"{group}/confident", depth.confident, compress=True)
    else:
        write_array(file, f"{group}/confident_bits", np.packbits(depth.confident), compress=True)


def _description(scene: Scene) -> dict[str, Any]:
    description = {
        "image_names": list(scene.image_names),
        "cameras": [camera.to_dict() for camera in scene.cameras],
        "surface": None if scene.surface is None else _surface_description(scene.surface),
        "scale_source": scene.scale_source,
        "identifier": scene.identifier,
    }
    if scene.compaction is not None:
        description["compaction"] = asdict(scene.compaction)
    return description


def _schema_of(scene: Scene) -> int:
    """The oldest schema that holds a scene, so that older programs read what they can show."""
    is_first = scene.surface is not None and scene.ground is None and scene.compaction is None
    return 1 if is_first else SCHEMA_VERSION


def _surface_description(surface: PlaneEstimate) -> dict[str, Any]:
    return {
        "plane": surface.plane.coefficients().tolist(),
        "offset_sigma": _finite_or_none(surface.offset_sigma),
        "angle_sigma": _finite_or_none(surface.angle_sigma),
        "method": surface.method,
        "quality": surface.quality,
    }


def _scene_of(file: SafeFile, description: Any, part: Sequence[int] | None = None) -> Scene:
    """The scene in a file, or a part of its views."""
    names = tuple(str(name) for name in description["image_names"])
    count = len(names)
    views = range(count) if part is None else part
    if any(not 0 <= view < count for view in views):
        raise InputError(file.path, "holds fewer views than are asked for")
    rows = np.array(views, dtype=np.int64)
    poses = file.read_array("world_from_camera", dtype_kind="f", shape=(count, 4, 4))
    compaction = _compaction_of(description.get("compaction"))
    base_from_camera = None
    if file.has("base_from_camera"):
        base_from_camera = file.read_array("base_from_camera", dtype_kind="f", shape=(4, 4))
    return Scene(
        image_names=tuple(names[view] for view in views),
        encoded_images=tuple(
            file.read_array(
                f"images/{view:06d}", dtype_kind="u", shape=(None,), max_bytes=MAX_IMAGE_BYTES
            ).tobytes()
            for view in views
        ),
        timestamps=file.read_array("timestamps", dtype_kind="f", shape=(count,))[rows],
        cameras=tuple(map(camera_from_dict, description["cameras"])),
        camera_index=file.read_array("camera_index", dtype_kind="i", shape=(count,))[rows],
        world_from_camera=poses[rows],
        surface=_surface_of(description["surface"]),
        base_from_camera=base_from_camera,
        bounds=file.read_array("bounds", dtype_kind="f", shape=(4,)),
        scale_source=str(description["scale_source"]),
        identifier=str(description["identifier"]),
        depth=_depth_of(file, views, compaction is None),
        ground=_ground_of(file),
        compaction=compaction,
    )


def _surface_of(stored: Any) -> PlaneEstimate | None:
    if stored is None:
        return None
    return PlaneEstimate(
        _stored_plane(stored["plane"]),
        _or_infinite(stored["offset_sigma"]),
        _or_infinite(stored["angle_sigma"]),
        str(stored["method"]),
        float(stored["quality"]),
    )


def _ground_of(file: SafeFile) -> FreeGround | None:
    if not file.has("ground"):
        return None
    return FreeGround(
        file.read_array("ground/corner", dtype_kind="f", shape=(2,)),
        float(file.read_array("ground/cell", dtype_kind="f", shape=())),
        file.read_array("ground/cells", dtype_kind="b", shape=(None, None)),
    )


def _compaction_of(stored: Any) -> Compaction | None:
    """What compact storage lost; None where the storage is full."""
    if stored is None:
        return None
    error = stored["depth_error"]
    found = Compaction(
        int(stored["recorded_bytes"]),
        float(stored["photo_psnr"]),
        None if error is None else float(error),
    )
    if found.recorded_bytes < 0 or not np.all(np.isfinite([found.photo_psnr, error or 0.0])):
        raise ValueError("the losses of compact storage are no numbers")
    return found


def _depth_of(file: SafeFile, views: Sequence[int], is_full: bool) -> tuple[SceneDepth, ...]:
    """The depth maps of views; none where the file has none."""
    if not file.has("depth"):
        return ()
    maps = []
    for view in views:
        group = f"depth/{view:06d}"
        levels, confident = _levels_of(file, group, is_full)
        scale = float(file.read_array(f"{group}/scale", dtype_kind="f", shape=()))
        if not (np.isfinite(scale) and scale > 0.0) or levels.size == 0 or not levels.any():
            raise InputError(file.path, f"{group} holds no depth")
        maps.append(SceneDepth((levels * scale).astype(np.float32), confident))
    return tuple(maps)


def _levels_of(file: SafeFile, group: str, is_full: bool) -> tuple[NDArray[np.uint16], BoolArray]:
    """Levels of inverse depth and where they are confident, both ``(h, w)``."""
    if is_full:
        levels = file.read_array(f"{group}/inverse", dtype_kind="u", shape=(None, None))
        return levels, file.read_array(f"{group}/confident", dtype_kind="b", shape=levels.shape)
    stored = file.read_array(f"{group}/differences", dtype_kind="u", shape=(None, None))
    if stored.dtype != np.uint16:
        raise InputError(file.path, f"{group}/differences has type {stored.dtype}, not uint16")
    bits = file.read_array(f"{group}/confident_bits", dtype_kind="u", shape=(-(-stored.size // 8),))
    if bits.dtype != np.uint8:
        raise InputError(file.path, f"{group}/confident_bits has type {bits.dtype}, not uint8")
    confident = np.unpackbits(bits, count=stored.size).reshape(stored.shape)
    return levels_of(stored), confident.astype(np.bool_)


def _stored_plane(coefficients: Any) -> Plane:
    """The plane exactly as it was stored: normalising again could change its last bit."""
    normalised = plane_from_coefficients(coefficients)
    plane = Plane(np.array([float(c) for c in coefficients[:3]]), float(coefficients[3]))
    if not np.allclose(plane.coefficients(), normalised.coefficients(), rtol=1e-9, atol=1e-12):
        raise OptionError("the plane's normal is not of unit length")
    return plane


def _check(path: Path, scene: Scene) -> None:
    """What must hold before a renderer may index into the arrays."""
    if len(scene) == 0:
        raise InputError(path, "holds no views")
    if scene.surface is None and not scene.depth:
        raise InputError(path, "holds neither a plane nor depth maps")
    if not scene.cameras or np.any(
        (scene.camera_index < 0) | (scene.camera_index >= len(scene.cameras))
    ):
        raise InputError(path, "names a camera that it does not hold")
    poses = [scene.world_from_camera]
    if scene.base_from_camera is not None:
        poses.append(scene.base_from_camera[None])
    for pose in poses:
        if not np.all(are_rigid(pose)):
            raise InputError(path, "holds a pose that is no rigid transform")
    if not all(SMALLEST_SIDE <= side < np.inf for side in np.diff(scene.bounds)[::2]):
        raise InputError(path, "has bounds that enclose no area")
    header_of = image_header
    if scene.compaction is not None:
        check_webp()
        header_of = webp_header
    for index, data in enumerate(scene.encoded_images):
        header, camera = header_of(data, path), scene.camera_of(index)
        if (header.width, header.height) != (camera.width, camera.height):
            raise InputError(path, f"photo {index} and its camera differ in size")


def _finite_or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _or_infinite(value: float | None) -> float:
    return float("inf") if value is None else float(value)


def differences_of(levels: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """What a plane through the pixels on the left, above and diagonally above fails to predict.

    On surfaces that are flat in space inverse depth is linear in the image, so that nearly all
    that is left is small. Signs alternate (0, -1, 1, -2, ...) so that small numbers have small
    bytes; arithmetic is modulo 2^16 and loses nothing.

    Args:
        levels: ``(h, w)``.

    Returns:
        ``(h, w)``; ``levels_of`` turns it back.
    """
    zero = np.uint16(0)
    signed = np.diff(np.diff(levels, axis=0, prepend=zero), axis=1, prepend=zero).view(np.int16)
    return ((signed << 1) ^ (signed >> 15)).view(np.uint16)


def levels_of(differences: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The levels ``(h, w)`` of which ``differences_of`` made these."""
    wrapped = (differences >> 1) ^ (np.uint16(0) - (differences & 1))
    return np.cumsum(np.cumsum(wrapped, axis=1, dtype=np.uint16), axis=0, dtype=np.uint16)
