"""The options of ``lfnav import``, and which of them mean something for which source."""

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import OptionError, quoted

KINDS = (
    *("grid", "colmap", "nerfstudio", "kitti", "7scenes"),
    *("euroc", "record3d", "polycam", "llff", "video", "bag"),
)
# Sources whose poses are exact enough to be a reconstruction as they are.
POSED_KINDS = ("grid", "colmap", "nerfstudio", "record3d", "polycam", "llff")
# Sources whose unit is none: that of structure from motion.
UNSCALED_KINDS = ("colmap", "nerfstudio", "llff")
IMAGE_FORMATS = ("jpeg", "png")
KITTI_CAMERAS = ("image_0", "image_1", "image_2", "image_3")
_OF_BAGS = (
    "odometry",
    "groundtruth",
    "base",
    "mount",
    "max_gap",
    "distance",
    "angle",
    "start",
    "end",
)

# Option -> the sources for which it means something.
_MEANT_FOR: dict[str, tuple[str, ...]] = {
    "pattern": ("grid",),
    "spacing": ("grid",),
    "focus": ("grid",),
    "allow_missing": ("grid", "colmap", "nerfstudio"),
    "focal": ("grid", "7scenes", "video", "bag"),
    "fov": ("grid", "video", "bag"),
    "images": ("colmap",),
    "scale": UNSCALED_KINDS,
    "upright": ("colmap", "nerfstudio", "7scenes", "record3d", "polycam", "llff"),
    "sequence": ("kitti",),
    "camera": ("kitti", "bag"),
    "camera_height": ("kitti",),
    "every": ("kitti", "7scenes", "euroc", "record3d", "video", "bag"),
    "fps": ("video",),
    "max_frames": ("video",),
    "image_format": ("video",),
    "link": tuple(kind for kind in KINDS if kind not in ("video", "bag")),
    **dict.fromkeys(_OF_BAGS, ("bag",)),
}


_POSITIVE = (
    "focus",
    "focal",
    "scale",
    "camera_height",
    "fps",
    "every",
    "max_frames",
    "max_gap",
    "distance",
    "angle",
    "end",
)


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
        camera: kitti: folder of the camera, one of ``KITTI_CAMERAS``. bag: topic of its images.
        camera_height: kitti: metres above the road.
        every: take every so many images.
        fps: video: images a second at most.
        max_frames: video: images at most.
        image_format: video: one of ``IMAGE_FORMATS``.
        link: hard links instead of copies where the file system allows it.
        odometry: bag: topic of the odometry, ``PARENT:CHILD`` of tf, or ``none``.
        groundtruth: bag: topic of the true poses, or ``PARENT:CHILD`` of tf.
        base: bag: the robot's frame, on which the camera is mounted.
        mount: bag: the camera on that frame, where tf does not say: x, y, z in metres, roll, pitch,
            yaw in degrees.
        max_gap: bag: seconds between two poses at most for one to be interpolated between them;
            None: ``MAX_GAP`` of ``geometry.interpolation``.
        distance: bag: metres from one image to the next.
        angle: bag: degrees from one image to the next; of both one is enough.
        start, end: bag: seconds after the camera's first image.

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
    odometry: str | None = None
    groundtruth: str | None = None
    base: str | None = None
    mount: tuple[float, ...] | None = None
    max_gap: float | None = None
    distance: float | None = None
    angle: float | None = None
    start: float | None = None
    end: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in ("auto", *KINDS):
            raise OptionError(f"--from {quoted(self.kind)} is none of auto, {', '.join(KINDS)}")
        for name in _POSITIVE:
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
        if self.start is not None and not (math.isfinite(self.start) and self.start >= 0.0):
            raise OptionError(f"--start {self.start:g} is negative or not finite")
        if self.end is not None and self.end <= (self.start or 0.0):
            raise OptionError(f"--end {self.end:g} does not come after --start {self.start or 0:g}")
        if self.mount is not None and not (
            len(self.mount) == 6 and all(math.isfinite(value) for value in self.mount)
        ):
            raise OptionError("--mount is not six finite numbers")
        self._check_choice("image_format", IMAGE_FORMATS)
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
        if kind == "kitti":
            self._check_choice("camera", KITTI_CAMERAS)

    def _check_choice(self, name: str, choices: tuple[str, ...]) -> None:
        value = getattr(self, name)
        if value is not None and value not in choices:
            raise OptionError(
                f"{option_name(name)} {quoted(value)} is none of {', '.join(choices)}"
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types for the provenance, without paths and without what changes nothing."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        for name in ("images", "link"):
            del values[name]
        for name in _OF_BAGS:
            if values[name] is None:
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
