"""The stage ``model``: a reconstruction in, a scene model out."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.atomic import check_output
from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.artifacts.progress import Progress
from pipelines.artifacts.provenance import provenance, sha256_of_bytes, sha256_of_file
from pipelines.dataset.images import decode_image, read_image_bytes
from pipelines.geometry.camera import Undistorter
from pipelines.geometry.plane import plane_from_coefficients
from pipelines.lightfield.bundle import identifier_of, save_scene
from pipelines.lightfield.description import SceneSummary
from pipelines.lightfield.plane_estimation import (
    FINE_WIDTH,
    MIN_POINTS,
    plane_from_photos,
    plane_from_points,
)
from pipelines.lightfield.scene import PlaneEstimate, Scene, covered_bounds
from pipelines.lightfield.views import build_views, shrink
from pipelines.reconstruct.reconstruction import (
    DESCRIPTION_NAME,
    Reconstruction,
    load_reconstruction,
)

GEOMETRIES = ("plane",)


@dataclass(frozen=True)
class ModelSettings:
    """Options of the stage.

    Attributes:
        geometry: the kind of scene surface, one of ``GEOMETRIES``.
        plane: a, b, c, d of ``a x + b y + c z + d = 0`` in world coordinates; None: estimated.
        images: folder of the photos where they are no longer where the reconstruction found them.
        seed: of the random samples in the estimation from points.

    Raises:
        OptionError: an unknown geometry.
    """

    geometry: str = "plane"
    plane: tuple[float, ...] | None = None
    images: Path | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.geometry not in GEOMETRIES:
            raise OptionError(f"geometry {self.geometry!r} is none of {', '.join(GEOMETRIES)}")


def model(
    reconstruction: Path,
    output: Path,
    settings: ModelSettings,
    *,
    overwrite: bool,
    progress: Progress,
) -> SceneSummary:
    """Builds the scene model of a reconstruction and writes it.

    Args:
        reconstruction: folder made by ``reconstruct``.
        output: the file to be written.
        settings: the options.
        overwrite: whether an existing file may be replaced.
        progress: told how far the work is.

    Raises:
        InputError: the reconstruction or its photos cannot be used, or the output not be written.
        StageError: no plane can be estimated.
    """
    check_output(output, overwrite)
    source = load_reconstruction(reconstruction)
    scene = build_scene(source, settings, progress)
    inputs = {DESCRIPTION_NAME: sha256_of_file(reconstruction / DESCRIPTION_NAME)}
    options = {name: value for name, value in asdict(settings).items() if name != "images"}
    save_scene(output, scene, overwrite, provenance("model", _plain(options), inputs))
    return SceneSummary(output, scene)


def build_scene(source: Reconstruction, settings: ModelSettings, progress: Progress) -> Scene:
    """The light field of a reconstruction, in memory.

    Raises:
        InputError: a photo is missing, or is not the one that was reconstructed.
        StageError: no plane can be estimated.
    """
    root = settings.images if settings.images is not None else source.image_root
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
    images = tuple(encoded)
    surface = _surface(source, images, settings, progress)
    if surface.plane.signed_distance(source.world_from_camera[:, :3, 3]).max() <= 0.0:
        raise StageError("no photo was taken from the front of the plane; check --plane")
    cameras = [source.cameras[int(index)] for index in source.camera_index]
    return Scene(
        image_names=source.image_names,
        encoded_images=images,
        timestamps=source.timestamps,
        cameras=source.cameras,
        camera_index=source.camera_index,
        world_from_camera=source.world_from_camera,
        surface=surface,
        base_from_camera=source.base_from_camera,
        bounds=covered_bounds(source.world_from_camera, cameras, surface.plane),
        scale_source=source.scale_source,
        identifier=identifier_of(
            images,
            source.cameras,
            source.camera_index,
            source.world_from_camera,
            surface,
            source.base_from_camera,
        ),
    )


def _surface(
    source: Reconstruction,
    images: tuple[bytes, ...],
    settings: ModelSettings,
    progress: Progress,
) -> PlaneEstimate:
    centres = source.world_from_camera[:, :3, 3]
    if settings.plane is not None:
        plane = plane_from_coefficients(settings.plane).facing(centres)
        return PlaneEstimate(plane, 0.0, 0.0, "given", 1.0)
    if len(source.points) >= MIN_POINTS:
        rng = np.random.default_rng(settings.seed)
        return plane_from_points(source.points, source.world_from_camera, rng)
    undistorters = [Undistorter(camera) for camera in source.cameras]
    photos, intrinsics = [], []
    for index, data in enumerate(progress(images, "decode photos", len(images))):
        undistorter = undistorters[int(source.camera_index[index])]
        image = undistorter(decode_image(data, source.image_names[index]))
        small, pinhole = shrink(image, undistorter.intrinsics, FINE_WIDTH)
        photos.append(small)
        intrinsics.append(pinhole)
    views = build_views(photos, intrinsics, source.world_from_camera)
    return plane_from_photos(views, source.world_from_camera, progress)


def _plain(options: dict[str, Any]) -> dict[str, Any]:
    return {
        name: list(value) if isinstance(value, tuple) else value for name, value in options.items()
    }
