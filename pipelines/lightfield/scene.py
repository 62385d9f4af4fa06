"""The scene model: photos with poses and the surface that they show.

The light field of Heigl, Denzler, Niemann (2001), section 2: views are rendered directly from the
recorded photos via a scene surface; no resampling to a regular grid takes place.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arguments import checked_index
from pipelines.artifacts.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    ImageArray,
    IntArray,
)
from pipelines.artifacts.errors import InputError, StageError
from pipelines.dataset.images import decode_image
from pipelines.dataset.webp import decode_webp
from pipelines.geometry.camera import Camera
from pipelines.geometry.plane import Plane
from pipelines.lightfield.free_ground import FreeGround


@dataclass(frozen=True)
class PlaneEstimate:
    """A plane and its uncertainty.

    Attributes:
        plane: in world coordinates, normal towards the cameras.
        offset_sigma: standard deviation of the distance from the cameras to the plane, metres.
        angle_sigma: standard deviation of the normal's direction, radians.
        method: "given", "points" or "photos".
        quality: for "points" the share of the points that lie on the plane; for "photos" the mean
            normalised cross-correlation between neighbouring photos mapped over the plane; else 1.
    """

    plane: Plane
    offset_sigma: float
    angle_sigma: float
    method: str
    quality: float


@dataclass(frozen=True)
class SceneDepth:
    """The depth map of one view: of its undistorted photo, at any size.

    Attributes:
        inverse_depth: ``(h, w)`` float32, 1 / metres along the optical axis; 0 where unknown.
        confident: ``(h, w)`` where neighbouring views agree, or a depth camera measured.
    """

    inverse_depth: Float32Array
    confident: BoolArray


@dataclass(frozen=True)
class Compaction:
    """What compact storage took from a scene (``lightfield.compact``).

    Attributes:
        recorded_bytes: of the photos' files as recorded, all together.
        photo_psnr: of the stored photos against the recorded ones at the stored size, dB.
        depth_error: median relative error of depth by quantisation; None without depth maps.
    """

    recorded_bytes: int
    photo_psnr: float
    depth_error: float | None


@dataclass(frozen=True)
class Scene:
    """A light field of N views (Heigl, Denzler, Niemann 2001, section 2).

    World and robot base follow REP-103 (x forward, y left, z up), cameras OpenCV (x right, y down,
    z forward). ``load_scene`` reads one and checks it.

    Attributes:
        image_names: N names, for people.
        encoded_images: N JPEG or PNG files as recorded, or WebP in compact storage.
        timestamps: ``(N,)`` seconds.
        cameras: the cameras that took them.
        camera_index: ``(N,)`` index into ``cameras``.
        world_from_camera: ``(N, 4, 4)`` where the views were taken from, metres.
        surface: the plane that approximates the scene's surface; None where depth maps alone show
            it, since no plane does.
        base_from_camera: ``(4, 4)`` mount of the recording robot; None where the map was not made
            by a robot.
        bounds: ``(4,)`` x_min, x_max, y_min, y_max in metres: where on the ground a robot can stand
            and see what the views show.
        scale_source: where the metric scale comes from, as the reconstruction states it.
        identifier: hash of the content; a run names the scene that it belongs to by it.
        depth: a depth map a view; empty where the plane is all that is known of the surface.
        ground: the part of ``bounds`` that the surface leaves free; None: all of it.
        compaction: what compact storage lost; None: nothing, photos are as recorded.
    """

    image_names: tuple[str, ...]
    encoded_images: tuple[bytes, ...]
    timestamps: FloatArray
    cameras: tuple[Camera, ...]
    camera_index: IntArray
    world_from_camera: FloatArray
    surface: PlaneEstimate | None
    base_from_camera: FloatArray | None
    bounds: FloatArray
    scale_source: str
    identifier: str
    depth: tuple[SceneDepth, ...] = ()
    ground: FreeGround | None = None
    compaction: Compaction | None = None

    @property
    def unit(self) -> str:
        """The unit of lengths: "m", or "units" where nothing says how many metres one is."""
        return "units" if self.scale_source == "arbitrary" else "m"

    def __len__(self) -> int:
        return len(self.image_names)

    @property
    def plane(self) -> Plane:
        """The plane that approximates the scene's surface.

        Raises:
            StageError: no plane does; depth maps alone show the surface.
        """
        if self.surface is None:
            raise StageError("the scene has no plane: depth maps alone show its surface")
        return self.surface.plane

    @property
    def plane_if_any(self) -> Plane | None:
        """The plane that approximates the scene's surface; None where no plane does."""
        return None if self.surface is None else self.surface.plane

    def camera_of(self, index: int) -> Camera:
        """The camera that took a view.

        Args:
            index: of the view, from 0.

        Raises:
            OptionError: no such view.
        """
        return self.cameras[int(self.camera_index[checked_index(index, "views", len(self))])]

    def image(self, index: int) -> ImageArray:
        """Decodes the photo of a view.

        Args:
            index: of the view, from 0.

        Returns:
            ``(height, width, 3)`` RGB, 8 bits, as recorded (not undistorted), or as stored compact.

        Raises:
            OptionError: no such view.
            InputError: the stored photo cannot be decoded or has another size than its camera.
        """
        camera = self.camera_of(index)
        decode = decode_image if self.compaction is None else decode_webp
        image = decode(self.encoded_images[index], self.image_names[index])
        if image.shape[:2] != (camera.height, camera.width):
            raise InputError(
                self.image_names[index],
                f"stored photo is {image.shape[1]}x{image.shape[0]}, "
                f"its camera {camera.width}x{camera.height}",
            )
        return image


def covered_bounds(
    world_from_camera: FloatArray, cameras: list[Camera], plane: Plane, margin: float = 0.5
) -> FloatArray:
    """The ground rectangle from which the views' part of the surface can be seen.

    It spans the recording positions (plus ``margin``) and the parts of the surface that the photos
    show, since a robot may stand anywhere between them. Surface farther than three times the median
    distance is left out: a ray that grazes the plane meets it arbitrarily far away.

    Args:
        world_from_camera: ``(N, 4, 4)``.
        cameras: the camera of each view.
        plane: the surface.
        margin: metres around the recording positions.

    Returns:
        ``(4,)`` x_min, x_max, y_min, y_max in metres.
    """
    centres = world_from_camera[:, :3, 3]
    directions = []
    for pose, camera in zip(world_from_camera, cameras, strict=True):
        pinhole = camera.intrinsics
        columns, rows = np.meshgrid(
            np.linspace(0, pinhole.width - 1, 9), np.linspace(0, pinhole.height - 1, 7)
        )
        directions.append(pinhole.rays(columns, rows).reshape(-1, 3) @ pose[:3, :3].T)
    rays = np.stack(directions)  # [N, R, 3]
    height = plane.signed_distance(centres)[:, None]
    approach = -(rays @ plane.normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(approach > 1e-9, height / approach, 0.0)
    hits = distance > 0.0
    spread = centres[:, :2]
    corners = [spread.min(axis=0) - margin, spread.max(axis=0) + margin]
    if np.any(hits):
        near = hits & (distance <= 3.0 * np.median(distance[hits]))
        points = (centres[:, None, :] + distance[..., None] * rays)[near][:, :2]
        corners += [points.min(axis=0), points.max(axis=0)]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    return np.array([low[0], high[0], low[1], high[1]])
