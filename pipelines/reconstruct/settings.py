"""How a reconstruction is to be made."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.artifacts.arguments import check_fields
from pipelines.artifacts.errors import OptionError, quoted
from pipelines.geometry.interpolation import MAX_GAP
from pipelines.reconstruct.reconstruction import METHODS

MATCHERS = ("auto", "spatial", "sequential", "exhaustive")


@dataclass(frozen=True)
class ReconstructSettings:
    """How camera poses are found.

    Attributes:
        method: "sfm", "odometry" or "poses".
        poses: TUM file of world_from_body, for method "poses" and no other.
        matcher: which pairs of images structure from motion compares. "spatial": those that by
            odometry see the same, and that look alike; the mapping starts from odometry then.
            "auto" takes it for more than 150 images that have odometry and a known camera.
        scale: metres a unit of the model, for structure from motion without odometry.
        seed: of all random choices of structure from motion.
        max_features: features an image.
        planar: structure from motion of a robot's camera: adjusted with poses on the floor.
        max_gap: seconds between two poses of odometry or of ``poses`` between which those of
            images are interpolated, at most.
        max_size: pixels; features are sought in images reduced to this longer side.

    Raises:
        OptionError: a value is impossible, or does not go with the method.
    """

    method: str
    poses: Path | None = None
    matcher: str = "auto"
    scale: float | None = None
    seed: int = 0
    max_features: int = 4096
    max_size: int = 960
    planar: bool = False
    max_gap: float = MAX_GAP

    def __post_init__(self) -> None:
        check_fields(self)
        if self.method not in METHODS:
            raise OptionError(
                f"unknown method {quoted(self.method)}; known are {', '.join(METHODS)}"
            )
        if self.matcher not in MATCHERS:
            raise OptionError(
                f"unknown matcher {quoted(self.matcher)}; known are {', '.join(MATCHERS)}"
            )
        if self.method == "poses" and self.poses is None:
            raise OptionError("--method poses needs --poses FILE")
        if self.method != "poses" and self.poses is not None:
            raise OptionError(f"--poses goes with --method poses, not with {self.method}")
        if self.scale is not None and self.method != "sfm":
            raise OptionError(f"--scale goes with --method sfm, not with {self.method}")
        if self.scale is not None and not (math.isfinite(self.scale) and self.scale > 0.0):
            raise OptionError(f"--scale {self.scale:g} is not a positive number")
        if self.planar and self.method != "sfm":
            raise OptionError(f"--planar goes with --method sfm, not with {self.method}")
        if not (math.isfinite(self.max_gap) and self.max_gap >= 0.0):
            raise OptionError(f"--max-gap {self.max_gap:g} is not a number of seconds")
        if not 0 <= self.seed < 2**31:
            raise OptionError(f"--seed {self.seed} is not in 0 to {2**31 - 1}")
        if not 64 <= self.max_features <= 65536:
            raise OptionError(f"--max-features {self.max_features} is not in 64 to 65536")
        if not 64 <= self.max_size <= 16384:
            raise OptionError(f"--max-size {self.max_size} is not in 64 to 16384")

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, for the record; only what the method uses."""
        # What is left at its default does not change the record of older versions.
        gap = {} if self.max_gap == MAX_GAP else {"max_gap": self.max_gap}
        if self.method == "odometry":
            return {"method": self.method, **gap}
        if self.method == "poses":
            name = self.poses.name if self.poses else None
            return {"method": self.method, "poses": name, **gap}
        return {
            "method": self.method,
            "matcher": self.matcher,
            "scale": self.scale,
            "seed": self.seed,
            "max_features": self.max_features,
            "max_size": self.max_size,
            "planar": self.planar,
            **gap,
        }
