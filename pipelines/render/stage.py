"""The stage ``render``: virtual views of a scene model as images or a video."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.atomic import atomic_file, atomic_folder, check_output, write_bytes
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.artifacts.kinds import is_world
from pipelines.artifacts.stages import Progress
from pipelines.dataset.images import encode_png
from pipelines.geometry.camera import Intrinsics, Undistorter
from pipelines.geometry.pose import base_from_camera_mount, world_from_base_planar
from pipelines.geometry.trajectory import read_tum
from pipelines.lightfield.open_world import open_world
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.render.area_renderers import AT_ONCE_MEGABYTES
from pipelines.render.choices import Blending, Quality
from pipelines.render.devices import Device
from pipelines.render.renderer import Rendering
from pipelines.render.renderer_choice import renderers_of
from pipelines.render.surface import quality_named

LISTING = "views.txt"
VIDEO_SUFFIX = ".mp4"
LARGEST_WIDTH = 8192


@dataclass(frozen=True)
class RenderSettings:
    """Options of the stage.

    Attributes:
        pose: x, y (metres) and heading (radians) of the robot's base; or None.
        poses: TUM file of world_from_base where the scene has a mount, else world_from_camera.
        width: of the images, pixels; None: as the scene's first camera.
        blending: how the light field blends its views.
        quality: name of a ``Quality``; None: the finest that the scene has depth maps for.
        frames_per_second: of a video.
        device: where the views are rendered.

    Raises:
        OptionError: neither or both kinds of poses, or impossible sizes.
    """

    pose: tuple[float, float, float] | None = None
    poses: Path | None = None
    width: int | None = None
    blending: Blending = Blending.UNSTRUCTURED
    quality: str | None = None
    frames_per_second: float = 10.0
    device: Device = Device.CPU

    def __post_init__(self) -> None:
        if (self.pose is None) == (self.poses is None):
            raise OptionError("give either one pose or a file of poses")
        if self.width is not None and not 4 <= self.width <= LARGEST_WIDTH:
            raise OptionError(f"width {self.width} is not between 4 and {LARGEST_WIDTH}")
        if not 0.1 <= self.frames_per_second <= 1000.0:
            raise OptionError(f"{self.frames_per_second:g} frames a second is not possible")


@dataclass(frozen=True)
class RenderSummary:
    """What was rendered."""

    path: Path
    width: int
    height: int
    coverage: tuple[float, ...]

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        return [
            ("output", str(self.path)),
            ("views", f"{len(self.coverage)} of {self.width}x{self.height} pixels"),
            ("covered", f"{np.mean(self.coverage):.1%} on average, {min(self.coverage):.1%} least"),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "path": str(self.path),
            "width": self.width,
            "height": self.height,
            "coverage": list(self.coverage),
        }


def render(
    scene_path: Path,
    output: Path,
    settings: RenderSettings,
    *,
    overwrite: bool,
    progress: Progress,
) -> RenderSummary:
    """Renders virtual views and writes them with masks of their covered pixels.

    Args:
        scene_path: scene model, or the folder of a world of several.
        output: ``NAME.png`` for one view (with ``NAME_mask.png``), ``NAME.mp4`` for a video (with
            ``NAME_mask.mp4``), else a folder of ``000000.png``, ``000000_mask.png``, ...
            Masks are white where any photo shows the pixel.
        settings: poses and size.
        overwrite: whether existing output may be replaced.
        progress: told how far the work is.

    Raises:
        InputError: an input cannot be used, or the output not be written.
        OptionError: a PNG for several poses.
    """
    mask_path = output.with_name(f"{output.stem}_mask{output.suffix}")
    for path in (output, mask_path) if output.suffix in (".png", VIDEO_SUFFIX) else (output,):
        check_output(path, overwrite, None if path.suffix else LISTING)
    world = open_world(scene_path, AT_ONCE_MEGABYTES) if is_world(scene_path) else None
    scene = load_scene(scene_path) if world is None else world.outlines[0]
    poses = _camera_poses(scene, settings)
    if output.suffix == ".png" and len(poses) != 1:
        raise OptionError(f"{output}: {len(poses)} views do not fit in one PNG; name a folder")
    intrinsics = virtual_intrinsics(scene, settings.width)
    quality = quality_named(settings.quality, bool(scene.depth), Quality.FINE)
    renderer_at = renderers_of(
        scene if world is None else world, None, settings.blending, quality, settings.device
    )
    renderings = (
        renderer_at(pose).render(pose, intrinsics) for pose in progress(poses, "render", len(poses))
    )
    if output.suffix == ".png":
        rendering = next(iter(renderings))
        write_bytes(output, encode_png(rendering.image), overwrite)
        write_bytes(mask_path, encode_png(_mask_image(rendering.covered)), overwrite)
        coverage = [rendering.coverage]
    elif output.suffix == VIDEO_SUFFIX:
        coverage = _write_videos(output, mask_path, renderings, intrinsics, settings, overwrite)
    else:
        coverage = _write_folder(output, renderings, overwrite)
    return RenderSummary(output, intrinsics.width, intrinsics.height, tuple(coverage))


def virtual_intrinsics(scene: Scene, width: int | None) -> Intrinsics:
    """Intrinsics of the scene's first camera, undistorted, at ``width`` pixels."""
    intrinsics = Undistorter(scene.camera_of(0)).intrinsics
    if width is None:
        return intrinsics
    return intrinsics.resized(width, max(1, round(intrinsics.height * width / intrinsics.width)))


def _camera_poses(scene: Scene, settings: RenderSettings) -> FloatArray:
    """``(P, 4, 4)`` world_from_camera."""
    if settings.poses is not None:
        body = read_tum(settings.poses).poses
        return body if scene.base_from_camera is None else body @ scene.base_from_camera
    if scene.base_from_camera is not None:
        mount = scene.base_from_camera
    else:
        # No robot recorded the map: a level camera at the height at which the photos were taken.
        height = float(np.median(scene.world_from_camera[:, 2, 3]))
        mount = base_from_camera_mount([0.0, 0.0, height], [0.0, 0.0, 0.0])
    return np.asarray(world_from_base_planar(np.array([settings.pose])) @ mount)


def _mask_image(covered: BoolArray) -> ImageArray:
    return np.repeat((covered * np.uint8(255))[..., None], 3, axis=2).astype(np.uint8)


def _write_folder(output: Path, renderings: Iterable[Rendering], overwrite: bool) -> list[float]:
    coverage = []
    with atomic_folder(output, overwrite, LISTING) as folder:
        lines = ["# image mask coverage"]
        for index, rendering in enumerate(renderings):
            name, mask = f"{index:06d}.png", f"{index:06d}_mask.png"
            (folder / name).write_bytes(encode_png(rendering.image))
            (folder / mask).write_bytes(encode_png(_mask_image(rendering.covered)))
            coverage.append(rendering.coverage)
            lines.append(f"{name} {mask} {rendering.coverage:.4f}")
        (folder / LISTING).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return coverage


def _write_videos(
    output: Path,
    mask_path: Path,
    renderings: Iterable[Rendering],
    intrinsics: Intrinsics,
    settings: RenderSettings,
    overwrite: bool,
) -> list[float]:
    coverage = []
    with atomic_file(output, overwrite) as video, atomic_file(mask_path, overwrite) as mask_video:
        writers = [
            _VideoWriter(path, intrinsics, settings.frames_per_second)
            for path in (video, mask_video)
        ]
        for rendering in renderings:
            writers[0].add(rendering.image)
            writers[1].add(_mask_image(rendering.covered))
            coverage.append(rendering.coverage)
        for writer in writers:
            writer.close()
    return coverage


class _VideoWriter:
    """An MP4 file that is written frame by frame."""

    def __init__(self, path: Path, intrinsics: Intrinsics, frames_per_second: float) -> None:
        self._path = path
        self._writer = cv2.VideoWriter(
            str(path),
            cv2.VideoWriter.fourcc(*"mp4v"),
            frames_per_second,
            (intrinsics.width, intrinsics.height),
        )
        if not self._writer.isOpened():
            raise StageError("this build of OpenCV cannot write MP4; name a folder instead")

    def add(self, image: ImageArray) -> None:
        """Appends an RGB image ``(H, W, 3)``."""
        self._writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))

    def close(self) -> None:
        """Finishes the file.

        Raises:
            StageError: nothing was written.
        """
        self._writer.release()
        if self._path.stat().st_size == 0:
            raise StageError("the video could not be written; is the disk full?")
