"""The stage ``model``: a reconstruction in, a scene model out."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, overload

import numpy as np

from pipelines.artifacts.arguments import (
    PathLike,
    check_fields,
    checked_choice,
    checked_instance,
    checked_number,
    checked_path,
)
from pipelines.artifacts.arrays import ImageArray, IntArray
from pipelines.artifacts.atomic import check_output
from pipelines.artifacts.errors import InputError, StageError
from pipelines.artifacts.processes import in_threads
from pipelines.artifacts.provenance import provenance, sha256_of_bytes, sha256_of_file
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.dataset.images import decode_image, read_image_bytes
from pipelines.dataset.webp import check_webp
from pipelines.geometry.camera import Intrinsics, Undistorter
from pipelines.geometry.plane import plane_from_coefficients
from pipelines.lightfield.compact import STORAGES, compact_scene
from pipelines.lightfield.depth_maps import (
    depth_from_photos,
    discard_finished,
    given_depth,
    points_of_depth,
)
from pipelines.lightfield.description import LEFT_OUT, SceneSummary, summary_of
from pipelines.lightfield.ground_carving import free_ground
from pipelines.lightfield.plane_estimation import (
    FINE_WIDTH,
    MIN_POINTS,
    NoDominantPlaneError,
    plane_from_photos,
    plane_from_points,
)
from pipelines.lightfield.scene import PlaneEstimate, Scene, SceneDepth, covered_bounds
from pipelines.lightfield.scene_file import identified, save_scene
from pipelines.lightfield.stereo_depth import DepthSettings
from pipelines.lightfield.stereo_neighbours import StandIn
from pipelines.lightfield.usual_depths import depths_of_maps, depths_of_photos, depths_of_points
from pipelines.lightfield.view_selection import KnownSurface, select_views
from pipelines.lightfield.views import build_views, shrink
from pipelines.reconstruct.reconstruction import (
    DESCRIPTION_NAME,
    Reconstruction,
    load_reconstruction,
    with_images,
)

# Beside the output while depth maps are computed.
FINISHED_SUFFIX = ".depth-in-progress"
GEOMETRIES = ("plane", "depth")
DEPTH_SOURCES = ("photos", "given")


@dataclass(frozen=True)
class ModelSettings:
    """Options of the stage.

    Attributes:
        geometry: the kind of scene surface: ``plane``, or ``depth``: a depth map a photo.
        depth: where depth maps come from: computed from the ``photos``, or ``given`` by the data
            set.
        plane: a, b, c, d of ``a x + b y + c z + d = 0`` in world coordinates, metres; None:
            estimated.
        images: folder of the photos where they are no longer where the reconstruction found them;
            None: where it found them.
        seed: of the random samples in the estimation from points.
        max_views: how many photos the model may hold: those that together show best what all of
            them show; None: all.
        storage: ``full``: photos as recorded; ``compact``: as small as localization and docking
            allow.

    Raises:
        OptionError: an unknown geometry or storage, a model without photos, a plane that is none,
            or a value of another type.
    """

    geometry: str = "plane"
    depth: str = "photos"
    plane: tuple[float, ...] | None = None
    images: Path | None = None
    seed: int = 0
    max_views: int | None = None
    storage: str = "full"

    def __post_init__(self) -> None:
        check_fields(self)
        if self.max_views is not None:
            checked_number(self.max_views, "number of photos", 1, whole=True)
        if self.plane is not None:
            plane_from_coefficients(self.plane)
        checked_number(self.seed, "seed", 0, whole=True)
        checked_choice(self.geometry, "geometry", GEOMETRIES)
        checked_choice(self.depth, "depth", DEPTH_SOURCES)
        checked_choice(self.storage, "storage", STORAGES)

    @property
    def takes_depth(self) -> bool:
        """Whether the depth maps are those of the data set."""
        return self.geometry == "depth" and self.depth == "given"


def model(
    reconstruction: PathLike,
    output: PathLike,
    settings: ModelSettings | None = None,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> SceneSummary:
    """Builds the scene model of a reconstruction, a light field, and writes it.

    The photos stay as they are, and what they show is approximated by a surface (Heigl, Denzler,
    Niemann 2001, section 2): a plane, or a depth map a photo by a plane sweep (Collins 1996) with
    semi-global matching (Hirschmueller 2008). Depth maps do without a plane where the photos have
    no dominant one.

    Args:
        reconstruction: folder made by ``reconstruct``.
        output: the file to be written, ``scene.h5``; ``load_scene`` reads it.
        settings: the options; None: the defaults.
        overwrite: whether an existing file may be replaced.
        progress: told how far the work is.

    Returns:
        What a person or a program wants to know of it: ``table()``, ``to_dict()``.

    Raises:
        InputError: the reconstruction or its photos cannot be used, or the output not be written.
        StageError: no plane can be estimated.
        OptionError: an argument of another type.
    """
    reconstruction = checked_path(reconstruction, "the reconstruction's path")
    output = checked_path(output, "the scene's path")
    settings = ModelSettings() if settings is None else settings
    checked_instance(settings, "settings", ModelSettings)
    check_output(output, overwrite)
    source = load_reconstruction(reconstruction)
    finished = output.with_name(output.name + FINISHED_SUFFIX)
    scene = build_scene(source, settings, progress, finished)
    inputs = {DESCRIPTION_NAME: sha256_of_file(reconstruction / DESCRIPTION_NAME)}
    left_out = sorted(set(source.image_names) - set(scene.image_names))
    record = {**provenance("model", plain_options(settings), inputs), LEFT_OUT: left_out}
    save_scene(output, scene, overwrite, record)
    discard_finished(finished)
    return summary_of(output, scene)


def build_scene(
    source: Reconstruction,
    settings: ModelSettings | None = None,
    progress: Progress = no_progress,
    finished: Path | None = None,
) -> Scene:
    """The light field of a reconstruction, in memory (Heigl, Denzler, Niemann 2001, section 2).

    Args:
        source: posed photos; ``load_reconstruction`` reads them.
        settings: the options; None: the defaults.
        progress: told how far the work is.
        finished: folder in which finished depth maps are kept until all are done; None: nowhere.

    Raises:
        InputError: a photo is missing, or is not the one that was reconstructed.
        StageError: no plane can be estimated, or Pillow cannot write compact photos.
        OptionError: an argument of another type.
    """
    settings = ModelSettings() if settings is None else settings
    checked_instance(source, "the reconstruction", Reconstruction)
    checked_instance(settings, "settings", ModelSettings)
    if settings.storage == "compact":
        # Before anything takes long.
        check_webp()
    root = settings.images if settings.images is not None else source.image_root
    images = _read_photos(source, root)
    given = given_depth(source, root) if settings.takes_depth else ()
    surface, stand_in = _approximations(source, images, given, settings, progress)
    if settings.max_views is not None:
        # Before depth: the photos that are left out would, as neighbours in the sweep, improve the
        # rendering by less than 0.1 dB, for the time and memory of decoding all of them.
        kept = _select(source, stand_in, given, settings.max_views, progress)
        source, images = with_images(source, kept), tuple(images[index] for index in kept)
        given = tuple(given[index] for index in kept) if given else ()
    depth = given or _depth(source, images, stand_in, settings, finished, progress)
    if surface is None:
        ground = free_ground(source.world_from_camera, _undistorted(source), depth)
        bounds = ground.bounds
    else:
        cameras = [source.cameras[int(index)] for index in source.camera_index]
        ground, bounds = None, covered_bounds(source.world_from_camera, cameras, surface.plane)
    scene = Scene(
        image_names=source.image_names,
        encoded_images=images,
        timestamps=source.timestamps,
        cameras=source.cameras,
        camera_index=source.camera_index,
        world_from_camera=source.world_from_camera,
        surface=surface,
        base_from_camera=source.base_from_camera,
        bounds=bounds,
        scale_source=source.scale_source,
        identifier="",
        depth=depth,
        ground=ground,
    )
    if settings.storage == "compact":
        return compact_scene(scene, progress)
    return identified(scene)


def _read_photos(source: Reconstruction, root: Path) -> tuple[bytes, ...]:
    """The files of all photos, each the one that was reconstructed."""
    encoded = []
    for name, expected in zip(source.image_names, source.image_hashes, strict=True):
        data = read_image_bytes(root / name)
        if sha256_of_bytes(data) != expected:
            raise InputError(
                root / name,
                "is not the photo that was reconstructed",
                "reconstruct again, or name the folder of the photos with --images",
            )
        encoded.append(data)
    return tuple(encoded)


def _select(
    source: Reconstruction,
    stand_in: StandIn,
    given: tuple[SceneDepth, ...],
    count: int,
    progress: Progress,
) -> IntArray:
    """Indices of the photos that the model holds."""
    surface = KnownSurface(stand_in, source.points, source.observations, given)
    return select_views(source.world_from_camera, _undistorted(source), surface, count, progress)


def _undistorted(source: Reconstruction) -> list[Intrinsics]:
    """The intrinsics of each undistorted photo."""
    pinholes = [Undistorter(camera).intrinsics for camera in source.cameras]
    return [pinholes[int(index)] for index in source.camera_index]


class _SmallPhotos:
    """The photos undistorted and reduced, decoded when they are first needed and then kept."""

    def __init__(self, source: Reconstruction, encoded: tuple[bytes, ...]) -> None:
        self._photos = _Photos(source, encoded)
        self._decoded: tuple[list[ImageArray], list[Intrinsics]] | None = None

    def decoded(self, progress: Progress) -> tuple[list[ImageArray], list[Intrinsics]]:
        """Images ``(h, w, 3)`` and their intrinsics."""
        if self._decoded is None:
            photos, pinholes = self._photos, self._photos.intrinsics

            def small(view: int) -> tuple[ImageArray, Intrinsics]:
                return shrink(photos[view], pinholes[view], FINE_WIDTH)

            found = in_threads(small, range(len(photos)))
            pairs = list(progress(found, "decode photos", len(photos)))
            self._decoded = [image for image, _ in pairs], [pinhole for _, pinhole in pairs]
        return self._decoded


class _Photos(Sequence[ImageArray]):
    """The photos undistorted, at full size ``(h, w, 3)``, decoded each time one is asked for."""

    def __init__(self, source: Reconstruction, encoded: tuple[bytes, ...]) -> None:
        self._names = source.image_names
        self._encoded = encoded
        undistorters = [Undistorter(camera) for camera in source.cameras]
        self._undistorters = [undistorters[int(index)] for index in source.camera_index]
        self.intrinsics = [undistorter.intrinsics for undistorter in self._undistorters]

    def __len__(self) -> int:
        return len(self._encoded)

    @overload
    def __getitem__(self, index: int) -> ImageArray: ...

    @overload
    def __getitem__(self, index: slice) -> list[ImageArray]: ...

    def __getitem__(self, index: int | slice) -> ImageArray | list[ImageArray]:
        if isinstance(index, slice):
            return [self[view] for view in range(*index.indices(len(self)))]
        return self._undistorters[index](decode_image(self._encoded[index], self._names[index]))


def _approximations(
    source: Reconstruction,
    images: tuple[bytes, ...],
    given: tuple[SceneDepth, ...],
    settings: ModelSettings,
    progress: Progress,
) -> tuple[PlaneEstimate | None, StandIn]:
    """The scene's plane, None where there is none, and what is taken for the surface without it."""
    photos = _SmallPhotos(source, images)
    surface = _surface(source, photos, given, settings, progress)
    centres = source.world_from_camera[:, :3, 3]
    if surface is not None and surface.plane.signed_distance(centres).max() <= 0.0:
        raise StageError("no photo was taken from the front of the plane; check --plane")
    return surface, _stand_in(source, photos, given, surface, progress)


def _surface(
    source: Reconstruction,
    photos: _SmallPhotos,
    given: tuple[SceneDepth, ...],
    settings: ModelSettings,
    progress: Progress,
) -> PlaneEstimate | None:
    """The plane that was asked for, or the dominant one; None where depth maps do without one."""
    centres = source.world_from_camera[:, :3, 3]
    if settings.plane is not None:
        plane = plane_from_coefficients(settings.plane).facing(centres)
        return PlaneEstimate(plane, 0.0, 0.0, "given", 1.0)
    try:
        return _dominant_plane(source, photos, given, settings, progress)
    except NoDominantPlaneError:
        if settings.geometry == "plane":
            raise
        return None


def _dominant_plane(
    source: Reconstruction,
    photos: _SmallPhotos,
    given: tuple[SceneDepth, ...],
    settings: ModelSettings,
    progress: Progress,
) -> PlaneEstimate:
    """The dominant plane of points, given depth or photos."""
    points = source.points
    if len(points) < MIN_POINTS and given:
        points = points_of_depth(source, given)
    if len(points) >= MIN_POINTS:
        rng = np.random.default_rng(settings.seed)
        return plane_from_points(points, source.world_from_camera, rng)
    views = build_views(*photos.decoded(progress), source.world_from_camera)
    return plane_from_photos(views, source.world_from_camera, progress)


def _stand_in(
    source: Reconstruction,
    photos: _SmallPhotos,
    given: tuple[SceneDepth, ...],
    surface: PlaneEstimate | None,
    progress: Progress,
) -> StandIn:
    """What is taken for the surface where nothing better is known: the plane, else usual depths."""
    if surface is not None:
        return surface.plane
    known = depths_of_maps(given) or depths_of_points(source)
    if known is not None:
        return known
    images, intrinsics = photos.decoded(progress)
    return depths_of_photos(images, intrinsics, source.world_from_camera)


def _depth(
    source: Reconstruction,
    images: tuple[bytes, ...],
    stand_in: StandIn,
    settings: ModelSettings,
    finished: Path | None,
    progress: Progress,
) -> tuple[SceneDepth, ...]:
    """A depth map a view, from the photos; none where the plane is all that was asked for."""
    if settings.geometry == "plane":
        return ()
    photos = _Photos(source, images)
    return depth_from_photos(
        source, photos, photos.intrinsics, stand_in, DepthSettings(), finished, progress
    )


def plain_options(settings: ModelSettings) -> dict[str, Any]:
    """The options as plain JSON types, without where the photos lie."""
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in asdict(settings).items()
        if name != "images"
    }
