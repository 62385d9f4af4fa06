"""Depth maps for all views of a scene: computed from the photos, or those that the data set has.

Computing takes seconds a view. Finished views are kept in a folder beside the output until all are
done, under a name that changes with anything that they depend on: after a kill the next call goes
on where the last one stopped.
"""

import hashlib
import io
import json
import logging
import shutil
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import Float32Array, FloatArray, ImageArray, IntArray
from pipelines.artifacts.atomic import write_bytes
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.processes import in_threads, processor_count
from pipelines.artifacts.stages import Progress
from pipelines.dataset.dataset import DEPTH_LIST, load_dataset
from pipelines.dataset.images import decode_depth, read_image_bytes
from pipelines.geometry.camera import Intrinsics, Undistorter
from pipelines.geometry.plane import plane_inverse_depth
from pipelines.lightfield.depth_filtering import refine_depth_maps
from pipelines.lightfield.depth_storage import as_stored
from pipelines.lightfield.packed_depth import PackedDepthMaps
from pipelines.lightfield.scene import SceneDepth
from pipelines.lightfield.stereo_depth import (
    DepthMap,
    DepthSettings,
    estimate_depth,
    working_photo,
)
from pipelines.lightfield.stereo_neighbours import (
    StandIn,
    UsualDepths,
    choose_neighbours,
    depth_range,
)
from pipelines.lightfield.views import shrunk_size
from pipelines.reconstruct.reconstruction import Reconstruction

_log = logging.getLogger(__name__)

# Depth maps become points at so many pixels along their longer side.
POINTS_ALONG_SIDE = 24


def depth_from_photos(
    source: Reconstruction,
    photos: Sequence[ImageArray],
    intrinsics: Sequence[Intrinsics],
    stand_in: StandIn,
    settings: DepthSettings,
    finished: Path | None,
    progress: Progress,
) -> tuple[SceneDepth, ...]:
    """Depth maps from the photos by plane sweep and fusion, on all processors.

    Args:
        source: poses, sparse points, hashes of the photos.
        photos: undistorted, ``(h, w, 3)`` RGB; each is asked for once.
        intrinsics: of each.
        stand_in: gives the depth range of views with too few sparse points.
        settings: of the plane sweep, the matching and the fusion.
        finished: folder for finished views; None keeps nothing.
        progress: told how far the work is.

    Raises:
        StageError: fewer than two photos.
    """
    poses = source.world_from_camera
    neighbours = choose_neighbours(
        poses, intrinsics, stand_in, source.points, source.observations, settings.neighbours
    )
    # Handed on and not kept: memory holds the maps of one round and those of the next.
    refined = refine_depth_maps(
        _swept(source, photos, intrinsics, stand_in, neighbours, settings, finished, progress),
        poses,
        neighbours,
        settings,
        processor_count(),
        progress,
    )
    return tuple(as_stored(depth.inverse_depth, depth.confident) for depth in refined)


def _swept(
    source: Reconstruction,
    photos: Sequence[ImageArray],
    intrinsics: Sequence[Intrinsics],
    stand_in: StandIn,
    neighbours: Sequence[IntArray],
    settings: DepthSettings,
    finished: Path | None,
    progress: Progress,
) -> PackedDepthMaps:
    """The depth maps of all views, each from it and its neighbours alone."""
    poses = source.world_from_camera
    count = len(photos)

    def working(view: int) -> tuple[ImageArray, Intrinsics]:
        return working_photo(photos[view], intrinsics[view], settings.largest_side)

    # Small and grey: of hundreds of photos at full size memory would not hold all.
    small = list(progress(in_threads(working, range(count)), "decode photos", count))
    greys, pinholes = [grey for grey, _ in small], [pinhole for _, pinhole in small]
    folder = None if finished is None else finished / _key(source, stand_in, settings)

    def one(view: int) -> DepthMap:
        stored = None if folder is None else _load(folder, view)
        if stored is not None:
            return DepthMap(stored.inverse_depth, stored.confident, pinholes[view])
        if len(neighbours[view]) == 0:
            _log.warning(
                "%s sees nothing that another photo sees; its depth is a guess",
                source.image_names[view],
            )
            return _guessed_depth(poses[view], intrinsics[view], stand_in, settings)
        limits = depth_range(
            view, poses, intrinsics[view], stand_in, source.points, source.observations
        )
        result = estimate_depth(greys, pinholes, poses, view, neighbours[view], limits, settings)
        if folder is not None:
            _store(folder, view, result)
        return result

    with ThreadPoolExecutor(processor_count()) as pool:
        return PackedDepthMaps(progress(pool.map(one, range(count)), "depth maps", count))


def _guessed_depth(
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    stand_in: StandIn,
    settings: DepthSettings,
) -> DepthMap:
    """The stand-in's depth, nowhere confident; its farthest depth where a plane is not seen."""
    size = shrunk_size(intrinsics.width, intrinsics.height, settings.largest_side)
    pinhole = intrinsics.resized(*size)
    if isinstance(stand_in, UsualDepths):
        inverse = np.full((pinhole.height, pinhole.width), 1.0 / stand_in.typical)
    else:
        inverse = plane_inverse_depth(stand_in, world_from_camera, pinhole)
    farthest = inverse[inverse > 0.0].min() if np.any(inverse > 0.0) else 0.1
    everywhere: Float32Array = np.where(inverse > 0.0, inverse, farthest).astype(np.float32)
    return DepthMap(everywhere, np.zeros(everywhere.shape, dtype=np.bool_), pinhole)


def discard_finished(finished: Path) -> None:
    """Removes the folder of finished views, once the scene that needed them is written."""
    shutil.rmtree(finished, ignore_errors=True)


def _key(source: Reconstruction, stand_in: StandIn, settings: DepthSettings) -> str:
    """Name that changes with anything that the depth maps depend on."""
    digest = hashlib.sha256(json.dumps([asdict(settings), source.image_hashes]).encode())
    for array in (source.world_from_camera, source.points, source.observations):
        digest.update(np.ascontiguousarray(array).tobytes())
    if isinstance(stand_in, UsualDepths):
        digest.update(np.array([stand_in.near, stand_in.typical, stand_in.far]).tobytes())
    else:
        digest.update(stand_in.coefficients().tobytes())
    for camera in source.cameras:
        digest.update(repr(camera).encode())
    return digest.hexdigest()[:32]


def _store(folder: Path, view: int, depth: DepthMap) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, inverse_depth=depth.inverse_depth, confident=depth.confident)
    write_bytes(folder / f"{view:06d}.npz", buffer.getvalue(), overwrite=True)


def _load(folder: Path, view: int) -> SceneDepth | None:
    """A finished view; None where there is none that can be read: it is then computed again."""
    path = folder / f"{view:06d}.npz"
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            return SceneDepth(
                np.asarray(stored["inverse_depth"], dtype=np.float32),
                np.asarray(stored["confident"], dtype=np.bool_),
            )
    except (OSError, ValueError, KeyError, EOFError):
        return None


def given_depth(source: Reconstruction, root: Path) -> tuple[SceneDepth, ...]:
    """The depth images of the data set that was reconstructed, as its depth camera measured them.

    Args:
        source: the posed photos.
        root: folder of the data set.

    Raises:
        InputError: the data set has no depth, a depth image is missing, is of another size than
            its photo, or holds nothing.
    """
    dataset = load_dataset(root)
    if dataset.depth_names is None or dataset.depth_scale is None:
        missing = DEPTH_LIST if dataset.depth_names is None else "camera.toml"
        reason = "is missing" if dataset.depth_names is None else "has no depth_scale"
        raise InputError(root / missing, f"{reason}: depth cannot be taken from the data set")
    names = dict(zip(dataset.image_names, dataset.depth_names, strict=True))
    undistorters = [Undistorter(camera) for camera in source.cameras]
    maps = []
    for index, image_name in enumerate(source.image_names):
        name = names.get(image_name)
        if name is None:
            raise InputError(root / image_name, "has no depth image in depth.txt")
        path = root / name
        values = decode_depth(read_image_bytes(path), path)
        camera = source.cameras[int(source.camera_index[index])]
        if values.shape != (camera.height, camera.width):
            raise InputError(
                path,
                f"is {values.shape[1]}x{values.shape[0]}, its photo {camera.width}x{camera.height}",
                "register depth to the photos",
            )
        if not values.any():
            raise InputError(path, "holds no depth: all values are zero")
        inverse = _inverse(values.astype(np.float32), dataset.depth_scale)
        inverse = undistorters[int(source.camera_index[index])].nearest(inverse)
        maps.append(as_stored(inverse, inverse > 0.0))
    return tuple(maps)


def points_of_depth(source: Reconstruction, depth: Sequence[SceneDepth]) -> FloatArray:
    """Surface points ``(P, 3)``, world coordinates, at a coarse grid of the depth maps' pixels.

    Args:
        source: poses and cameras of the views.
        depth: a map a view, of the undistorted photo.
    """
    points = []
    undistorters = [Undistorter(camera) for camera in source.cameras]
    for index, (view, pose) in enumerate(zip(depth, source.world_from_camera, strict=True)):
        height, width = view.inverse_depth.shape
        pinhole = undistorters[int(source.camera_index[index])].intrinsics.resized(width, height)
        step = max(1, max(height, width) // POINTS_ALONG_SIDE)
        rows, columns = np.mgrid[step // 2 : height : step, step // 2 : width : step]
        values = view.inverse_depth[rows, columns]
        known = values > 0.0
        pixels = np.stack([columns[known], rows[known], np.ones(np.count_nonzero(known))], axis=-1)
        local = pixels @ np.linalg.inv(pinhole.matrix()).T / values[known, None]
        points.append(local @ pose[:3, :3].T + pose[:3, 3])
    return np.concatenate(points)


def _inverse(values: Float32Array, depth_scale: float) -> Float32Array:
    """1 / metres of depth values; 0 where they are 0: unknown."""
    known = values > 0.0
    return np.where(known, depth_scale / np.where(known, values, 1.0), 0.0).astype(np.float32)
