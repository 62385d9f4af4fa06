"""The options of ``lfnav import``, and which of them mean something for which source."""

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import OptionError, quoted

KINDS = (
    *("grid", "colmap", "nerfstudio", "kitti", "7scenes"),
    *("euroc", "record3d", "polycam", "llff", "video"),
)
# Sources whose poses are exact enough to be a reconstruction as they are.
POSED_KINDS = ("grid", "colmap", "nerfstudio", "record3d", "polycam", "llff")
# Sources whose unit is none: that of structure from motion.
UNSCALED_KINDS = ("colmap", "nerfstudio", "llff")
IMAGE_FORMATS = ("jpeg", "png")
KITTI_CAMERAS = ("image_0", "image_1", "image_2", "image_3")

# Option -> the sources for which it means something.
_MEANT_FOR: dict[str, tuple[str, ...]] = {
    "pattern": ("grid",),
    "spacing": ("grid",),
    "focus": ("grid",),
    "allow_missing": ("grid", "colmap", "nerfstudio"),
    "focal": ("grid", "7scenes", "video"),
    "fov": ("grid", "video"),
    "images": ("colmap",),
    "scale": UNSCALED_KINDS,
    "upright": ("colmap", "nerfstudio", "7scenes", "record3d", "polycam", "llff"),
    "sequence": ("kitti",),
    "camera": ("kitti",),
    "camera_height": ("kitti",),
    "every": ("kitti", "7scenes", "euroc", "record3d", "video"),
    "fps": ("video",),
    "max_frames": ("video",),
    "image_format": ("video",),
    "link": tuple(kind for kind in KINDS if kind != "video"),
}


@dataclass(frozen=True)
class ImportSettings:
    """Options of the stage; None (or False) is "not given".

    Attributes:
        kind: one of ``KINDS``, or "auto".
        pattern: grid: file names with ``{row}`` and ``{col}``.
        spacing: grid: metres between neighbouring indices along columns (x, to the right) and rows
            (y, down); negative where the index runs the other way.
        focus: grid: distance (metres) of the plane that lies still in all images.
        focal: focal length in pixels.
        fov: horizontal field of view in degrees.
        allow_missing: grid, colmap, nerfstudio: share of the images that may be gone; None: of a
            grid none, of others ``MISSING_SHARE``.
        images: colmap: folder of the photos.
        scale: metres for one unit of the source.
        upright: turn the world so that the cameras stand upright in it.
        sequence: kitti: name of the sequence.
        camera: kitti: folder of the camera, one of ``KITTI_CAMERAS``.
        camera_height: kitti: metres above the road.
        every: take every so many images.
        fps: video: images a second at most.
        max_frames: video: images at most.
        image_format: video: one of ``IMAGE_FORMATS``.
        link: hard links instead of copies where the file system allows it.

    Raises:
        OptionError: a value that is impossible, or two that exclude each other.
    """

    kind: str = "auto"
    pattern: str | None = None
    spacing: tuple[float, float] | None = None
    focus: float | None = None
    focal: float | None = None
    fov: float | None = None
    allow_missing: float | None = None
    images: Path | None = None
    scale: float | None = None
    upright: bool = False
    sequence: str | None = None
    camera: str | None = None
    camera_height: float | None = None
    every: int | None = None
    fps: float | None = None
    max_frames: int | None = None
    image_format: str | None = None
    link: bool = False

    def __post_init__(self) -> None:
        if self.kind not in ("auto", *KINDS):
            raise OptionError(f"--from {quoted(self.kind)} is none of auto, {', '.join(KINDS)}")
        for name in ("focus", "focal", "scale", "camera_height", "fps", "every", "max_frames"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise OptionError(f"{option_name(name)} {value:g} is not positive")
        if self.allow_missing is not None and not 0.0 <= self.allow_missing <= 1.0:
            raise OptionError(f"--allow-missing {self.allow_missing:g} is no share from 0 to 1")
        if self.fov is not None and not 0.0 < self.fov < 180.0:
            raise OptionError(f"--fov {self.fov:g} is not between 0 and 180 degrees")
        if self.spacing is not None and not all(
            math.isfinite(step) and step != 0.0 for step in self.spacing
        ):
            raise OptionError("--spacing must not be zero")
        for name, choices in (("camera", KITTI_CAMERAS), ("image_format", IMAGE_FORMATS)):
            value = getattr(self, name)
            if value is not None and value not in choices:
                raise OptionError(
                    f"{option_name(name)} {quoted(value)} is none of {', '.join(choices)}"
                )
        for first, second in (("focal", "fov"), ("every", "fps")):
            if getattr(self, first) is not None and getattr(self, second) is not None:
                raise OptionError(
                    f"{option_name(first)} and {option_name(second)} exclude each other"
                )

    def check_meant_for(self, kind: str) -> None:
        """Makes sure that no option was given in vain.

        Raises:
            OptionError: an option has no meaning for sources of this kind.
        """
        for name, kinds in _MEANT_FOR.items():
            if getattr(self, name) not in (None, False) and kind not in kinds:
                raise OptionError(
                    f"{option_name(name)} means nothing for a source of kind {kind} "
                    f"(only for {', '.join(kinds)})"
                )

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types for the provenance, without paths and without what changes nothing."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        for name in ("images", "link"):
            del values[name]
        values["spacing"] = None if self.spacing is None else list(self.spacing)
        return values

    def focal_length(self, width: int) -> float | None:
        """Pixels, from ``focal`` or ``fov`` for an image of this width; None: neither is given."""
        if self.focal is not None:
            return self.focal
        if self.fov is not None:
            return width / 2.0 / math.tan(math.radians(self.fov) / 2.0)
        return None


def option_name(field: str) -> str:
    """The command line's name of a setting."""
    return "--" + field.replace("_", "-")
