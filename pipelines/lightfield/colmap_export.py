"""A scene model as a COLMAP project: ``images/``, and ``sparse/`` with cameras and poses.

Photos are written as stored; those of compact scenes as PNG, since few such programs read WebP.

The scene model keeps no sparse points, so the model has none; programs that want some triangulate
them from the known poses.
"""

import json
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from pipelines.artifacts.atomic import atomic_folder, check_output
from pipelines.artifacts.errors import InputError, quoted
from pipelines.dataset.images import encode_png
from pipelines.geometry.pose import inverse
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.reconstruct.colmap_model import ColmapModel, ModelImage, ModelPoints, write_model

IMAGE_FOLDER, MODEL_FOLDER = "images", "sparse"
RECORD_NAME = "export.json"
FORMAT = "lfnav export"


@dataclass(frozen=True)
class ColmapExportSummary:
    """The ``Summary`` of an export."""

    output: Path
    images: int
    cameras: int
    image_bytes: int
    are_recorded: bool

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        kind = "as recorded" if self.are_recorded else "PNG of the compact photos"
        return [
            ("COLMAP project", str(self.output)),
            ("images", f"{self.images} ({self.image_bytes / 1e6:.1f} MB {kind})"),
            ("cameras", str(self.cameras)),
            ("model", f"{self.output / MODEL_FOLDER} (poses, no points)"),
        ]

    def to_dict(self) -> dict[str, Any]:
        """The same for programs."""
        return {
            "kind": "colmap",
            "path": str(self.output),
            "images": self.images,
            "cameras": self.cameras,
            "image_bytes": self.image_bytes,
        }


def export_scene_to_colmap(scene_path: Path, output: Path, overwrite: bool) -> ColmapExportSummary:
    """Writes a folder that COLMAP, and what reads its models, can open.

    Args:
        scene_path: the file ``scene.h5``.
        output: the folder, written as a whole or not at all.
        overwrite: whether an older export there may be replaced.

    Raises:
        InputError: the scene cannot be read or has image names that are no file names, or the
            output cannot be written.
    """
    check_output(output, overwrite, RECORD_NAME)
    scene = load_scene(scene_path)
    names = _file_names(scene_path, scene)
    size = 0
    with atomic_folder(output, overwrite, RECORD_NAME) as folder:
        for index, name in enumerate(names):
            is_recorded = scene.compaction is None
            data = scene.encoded_images[index] if is_recorded else encode_png(scene.image(index))
            size += len(data)
            target = folder / IMAGE_FOLDER / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
        (folder / MODEL_FOLDER).mkdir()
        write_model(folder / MODEL_FOLDER, _model_of(scene, names))
        record = {
            "format": FORMAT,
            "schema_version": 1,
            "scene": scene.identifier,
            "plane": None if scene.surface is None else scene.plane.coefficients().tolist(),
            "scale_source": scene.scale_source,
        }
        text = json.dumps(record, indent=2, allow_nan=False) + "\n"
        (folder / RECORD_NAME).write_text(text, encoding="utf-8")
    return ColmapExportSummary(
        output, len(names), len(scene.cameras), size, scene.compaction is None
    )


def _file_names(path: Path, scene: Scene) -> tuple[str, ...]:
    """The names of the views, which a scene from a stranger might use to leave the folder."""
    names: list[str] = []
    for name in scene.image_names:
        relative = PurePosixPath(name)
        is_safe = bool(relative.parts) and not relative.is_absolute() and name.isprintable()
        if not is_safe or ".." in relative.parts:
            raise InputError(path, f"a view is called {quoted(name)}, which is no file name")
        names.append(str(relative if scene.compaction is None else relative.with_suffix(".png")))
    if len(set(names)) != len(names):
        raise InputError(path, "two views have the same name")
    folders = {str(parent) for name in names for parent in PurePosixPath(name).parents}
    clash = sorted(folders & set(names))
    if clash:
        raise InputError(path, f"a view is called {quoted(clash[0])}, which is also a folder")
    return tuple(names)


def _model_of(scene: Scene, names: tuple[str, ...]) -> ColmapModel:
    """Numbered from 1, as COLMAP does; keypoints and points are not part of a scene."""
    camera_from_world = inverse(scene.world_from_camera)
    images = tuple(
        ModelImage(
            row + 1,
            name,
            int(scene.camera_index[row]) + 1,
            camera_from_world[row],
            np.empty((0, 2)),
            np.empty(0, dtype=np.int64),
        )
        for row, name in enumerate(names)
    )
    points = ModelPoints(
        np.empty(0, dtype=np.int64),
        np.empty((0, 3)),
        np.empty((0, 3), dtype=np.uint8),
        np.empty(0),
        np.empty((0, 3), dtype=np.int64),
    )
    cameras = {row + 1: camera for row, camera in enumerate(scene.cameras)}
    return ColmapModel(cameras, images, points)
