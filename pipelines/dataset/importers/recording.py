"""What an importer found: image files with times, cameras and poses; nothing is copied yet."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, quoted
from pipelines.geometry.camera import Camera

IMAGE_FOLDER, DEPTH_FOLDER = "rgb", "depth"


@dataclass(frozen=True)
class SourceFrame:
    """One image of the source.

    Attributes:
        file: where it lies now.
        name: POSIX, relative to the data set that is written; begins with ``rgb/``.
        timestamp: seconds.
        camera: which of the recording's cameras took it.
        depth: its depth image, 16-bit PNG; None where there is none.
    """

    file: Path
    name: str
    timestamp: float
    camera: int = 0
    depth: Path | None = None


@dataclass(frozen=True)
class Recording:
    """The images of a source in time order, and what the source knows about them.

    Attributes:
        frames: N images.
        cameras: the cameras that took them; none where the source does not know.
        world_from_camera: ``(N, 4, 4)``, z up where the source says what is up; None: no poses.
        base_from_camera: ``(4, 4)``, the mount; None where the body is the camera.
        depth_scale: value in a depth image / depth_scale = metres.
        depth_invalid: value in a depth image that means "unknown", besides 0.
        notes: what the user should know about how the source was read.
    """

    frames: tuple[SourceFrame, ...]
    cameras: tuple[Camera, ...]
    world_from_camera: FloatArray | None
    base_from_camera: FloatArray | None = None
    depth_scale: float | None = None
    depth_invalid: int | None = None
    notes: tuple[str, ...] = ()

    def thinned(self, every: int) -> "Recording":
        """Every ``every``-th image from the first on."""
        poses = self.world_from_camera
        return replace(
            self,
            frames=self.frames[::every],
            world_from_camera=None if poses is None else poses[::every],
        )


def name_below(folder: str, name: str, source: Path) -> str:
    """The name under which an image of the source is kept: POSIX, in ``folder``.

    Args:
        folder: ``rgb`` or ``depth``.
        name: relative path in the source.
        source: the file that gives the name, for the error.

    Raises:
        InputError: the name is absolute, leads out of its folder, or cannot stand in ``rgb.txt``.
    """
    relative = PurePosixPath(name)
    if not relative.parts or relative.is_absolute() or ".." in relative.parts:
        raise InputError(source, f"{quoted(name)} leads out of the folder of the images")
    text = str(relative)
    if not text.isprintable() or text != text.strip():
        raise InputError(source, f"{quoted(name)} is no file name that a list could hold")
    # What lies in a folder of that name already needs no second one.
    return text if text.startswith(f"{folder}/") else f"{folder}/{text}"


def first_duplicate(names: Sequence[str]) -> str | None:
    """The first name that stood in ``names`` before; None where all differ."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None
