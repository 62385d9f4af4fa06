"""Size of a scene model on disk and in memory, by its parts."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.safe_hdf5 import open_hdf5
from pipelines.geometry.camera import Camera
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import POOL_SIDE, pyramid_texels, shrunk_size, texels_beyond

PARTS = ("photos", "depth_maps", "rest")
# The longer side of views to which ``lfnav localize`` shrinks the photos by default.
LOCALIZE_SIDE = 320
RESOLUTIONS = {"full_size": None, "localize": LOCALIZE_SIDE}
TEXEL_BYTES, DEPTH_BYTES = 4, 4


@dataclass(frozen=True)
class SizeBudget:
    """Bytes of a scene model, each as part (one of ``PARTS``) -> bytes.

    Attributes:
        views: the number of views.
        file: on disk; depth maps are compressed there, photos are as they were recorded.
        memory: in memory for each of ``RESOLUTIONS``: the scene (photos encoded as in the file) and
            the views that a renderer makes of it.
    """

    views: int
    file: Mapping[str, int]
    memory: Mapping[str, Mapping[str, int]]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "file_bytes": self._with_total(self.file),
            "memory_bytes": {name: self._with_total(of) for name, of in self.memory.items()},
        }

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        full, small = (self._text(self.memory[name]) for name in RESOLUTIONS)
        return [
            ("file", self._text(self.file)),
            ("in memory, full size", full),
            (f"in memory, {LOCALIZE_SIDE} px", f"{small} (as lfnav localize opens it)"),
        ]

    def _with_total(self, parts: Mapping[str, int]) -> dict[str, Any]:
        per_view = {name: round(value / self.views) for name, value in parts.items()}
        total = sum(parts.values())
        return {
            **parts,
            "total": total,
            "per_view": {**per_view, "total": round(total / self.views)},
            "share": {name: value / total for name, value in parts.items()},
        }

    def _text(self, parts: Mapping[str, int]) -> str:
        """Total and a view's, then the share and the bytes of every part that there is."""
        total = sum(parts.values())
        listed = ", ".join(
            f"{name.replace('_', ' ')} {value / total:.0%} ({_megabytes(value)})"
            for name, value in parts.items()
            if value > 0
        )
        return f"{_megabytes(total)}, {_megabytes(total / self.views)} a view: {listed}"


def size_budget(path: Path, scene: Scene) -> SizeBudget:
    """The sizes of a scene model.

    Args:
        path: the file that holds it.
        scene: what was read from there or written to there.

    Raises:
        InputError: the file cannot be read.
    """
    memory = {name: _memory(scene, side) for name, side in RESOLUTIONS.items()}
    return SizeBudget(len(scene), _on_disk(path, scene), memory)


def view_memory(camera: Camera, encoded_bytes: float, depth_side: int | None) -> float:
    """Bytes that one view of a scene takes in memory as ``lfnav localize`` opens it.

    Args:
        camera: that took the photo.
        encoded_bytes: of the photo's file.
        depth_side: longer side of its depth map, pixels; None: without one.
    """
    size = shrunk_size(camera.width, camera.height, LOCALIZE_SIDE)
    total = encoded_bytes + TEXEL_BYTES * pyramid_texels(*size)
    if depth_side is not None:
        stored = shrunk_size(camera.width, camera.height, depth_side)
        shown = shrunk_size(*stored, LOCALIZE_SIDE)
        # A map's 32-bit values and mask, and the values that the renderer makes of it.
        total += 5 * stored[0] * stored[1] + DEPTH_BYTES * shown[0] * shown[1]
    return total


def view_bytes(camera: Camera, side: int, channels: int, has_depth: bool) -> float:
    """Bytes of a view as a renderer takes it.

    Args:
        camera: that took the photo.
        side: the most pixels of the longer side.
        channels: how many kinds of pixels it has.
        has_depth: whether it has a depth map.
    """
    width, height = shrunk_size(camera.width, camera.height, side)
    total: float = channels * TEXEL_BYTES * pyramid_texels(width, height)
    if has_depth:
        total += DEPTH_BYTES * width * height * (1.0 + 1.0 / POOL_SIDE**2)
    return total


def _on_disk(path: Path, scene: Scene) -> dict[str, int]:
    with open_hdf5(path) as file:
        photos = sum(file.stored_bytes(f"images/{index:06d}") for index in range(len(scene)))
        depth = sum(
            file.stored_bytes(f"depth/{index:06d}/{name}")
            for index in range(len(scene.depth))
            for name in file.names(f"depth/{index:06d}")
        )
    try:
        total = path.stat().st_size
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error})") from error
    return {"photos": photos, "depth_maps": depth, "rest": total - photos - depth}


def _memory(scene: Scene, largest_side: int | None) -> dict[str, int]:
    """Bytes of the scene and of ``views_of_scene`` at this resolution."""
    photos, depth, widest = sum(map(len, scene.encoded_images)), 0, 0
    for index in range(len(scene)):
        camera = scene.camera_of(index)
        size = shrunk_size(camera.width, camera.height, largest_side)
        photos += TEXEL_BYTES * pyramid_texels(*size)
        widest = max(widest, size[0])
    photos += TEXEL_BYTES * texels_beyond(widest)
    for of_view in scene.depth:
        depth += of_view.inverse_depth.nbytes + of_view.confident.nbytes
        height, width = of_view.inverse_depth.shape
        size = shrunk_size(width, height, largest_side)
        depth += DEPTH_BYTES * size[0] * size[1]
    rest = scene.timestamps.nbytes + scene.camera_index.nbytes + scene.world_from_camera.nbytes
    return {"photos": photos, "depth_maps": depth, "rest": rest}


def _megabytes(count: float) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count / 1e3:.1f} kB"
