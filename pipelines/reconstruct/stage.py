"""The stage ``reconstruct``: a data set in, a folder of posed images out."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.atomic import check_output
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.progress import Progress
from pipelines.artifacts.provenance import provenance, sha256_of_bytes, sha256_of_file
from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.reconstruct.description import ReconstructionSummary
from pipelines.reconstruct.known_poses import (
    KnownPoses,
    known_camera,
    poses_from_file,
    poses_from_odometry,
)
from pipelines.reconstruct.reconstruction import (
    DESCRIPTION_NAME,
    METHODS,
    Reconstruction,
    save_reconstruction,
)

MATCHERS = ("auto", "sequential", "exhaustive")


@dataclass(frozen=True)
class ReconstructSettings:
    """How camera poses are found.

    Attributes:
        method: "sfm", "odometry" or "poses".
        poses: TUM file of world_from_body, for method "poses" and no other.
        matcher: which pairs of images structure from motion compares.
        scale: metres a unit of the model, for structure from motion without odometry.
        seed: of all random choices of structure from motion.
        max_features: features an image.
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

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise OptionError(f"unknown method {self.method!r}; known are {', '.join(METHODS)}")
        if self.matcher not in MATCHERS:
            raise OptionError(f"unknown matcher {self.matcher!r}; known are {', '.join(MATCHERS)}")
        if self.method == "poses" and self.poses is None:
            raise OptionError("--method poses needs --poses FILE")
        if self.method != "poses" and self.poses is not None:
            raise OptionError(f"--poses goes with --method poses, not with {self.method}")
        if self.scale is not None and self.method != "sfm":
            raise OptionError(f"--scale goes with --method sfm, not with {self.method}")
        if self.scale is not None and not (math.isfinite(self.scale) and self.scale > 0.0):
            raise OptionError(f"--scale {self.scale:g} is not a positive number")
        if not 0 <= self.seed < 2**31:
            raise OptionError(f"--seed {self.seed} is not in 0 to {2**31 - 1}")
        if not 64 <= self.max_features <= 65536:
            raise OptionError(f"--max-features {self.max_features} is not in 64 to 65536")
        if not 64 <= self.max_size <= 16384:
            raise OptionError(f"--max-size {self.max_size} is not in 64 to 16384")

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, for the record; only what the method uses."""
        if self.method == "odometry":
            return {"method": self.method}
        if self.method == "poses":
            return {"method": self.method, "poses": self.poses.name if self.poses else None}
        return {
            "method": self.method,
            "matcher": self.matcher,
            "scale": self.scale,
            "seed": self.seed,
            "max_features": self.max_features,
            "max_size": self.max_size,
        }


def reconstruct(
    dataset: Path,
    output: Path,
    settings: ReconstructSettings,
    *,
    overwrite: bool,
    progress: Progress,
) -> ReconstructionSummary:
    """Finds camera poses of the images of a data set and writes the reconstruction.

    Args:
        dataset: folder of a data set.
        output: folder to be written, as a whole or not at all.
        settings: the method and its options.
        overwrite: whether an older reconstruction there may be replaced.
        progress: told how far the work is.

    Raises:
        InputError: the data set lacks what the method needs, or ``output`` cannot be written.
        StageError: structure from motion found nothing that can be trusted.
    """
    check_output(output, overwrite, DESCRIPTION_NAME)
    data = load_dataset(dataset)
    if settings.method == "poses" and settings.poses is not None:
        result = _from_known_poses(
            data, settings, poses_from_file(data, settings.poses), "given poses", progress
        )
    else:
        result = _from_known_poses(data, settings, poses_from_odometry(data), "odometry", progress)
    record = provenance("reconstruct", settings.to_dict(), _inputs(data, settings, result))
    save_reconstruction(output, result, record, overwrite)
    return ReconstructionSummary(output, result)


def _from_known_poses(
    data: Dataset,
    settings: ReconstructSettings,
    poses: KnownPoses,
    scale_source: str,
    progress: Progress,
) -> Reconstruction:
    camera = known_camera(data)
    indices = poses.image_index.tolist()
    return Reconstruction(
        method=settings.method,
        image_root=data.root.resolve(),
        image_names=tuple(data.image_names[index] for index in indices),
        image_hashes=hash_images(data, indices, progress),
        timestamps=data.timestamps[poses.image_index],
        cameras=(camera,),
        camera_index=np.zeros(len(indices), dtype=np.int64),
        world_from_camera=poses.world_from_camera,
        points=np.empty((0, 3)),
        observations=np.empty((0, 2), dtype=np.int64),
        base_from_camera=data.base_from_camera,
        scale_source=scale_source,
        dropped=poses.dropped,
        statistics={},
    )


def hash_images(data: Dataset, indices: list[int], progress: Progress) -> tuple[str, ...]:
    """SHA-256 of the files of the images ``indices``."""
    return tuple(
        sha256_of_bytes(data.read_image_bytes(index))
        for index in progress(indices, "hashing images", len(indices))
    )


def _inputs(data: Dataset, settings: ReconstructSettings, result: Reconstruction) -> dict[str, str]:
    """Name of each input file that the result depends on -> its hash."""
    inputs = {"images": sha256_of_bytes("\n".join(result.image_hashes).encode())}
    names = ["rgb.txt", "camera.toml"]
    if settings.method != "poses":
        names.append("odometry.txt")
    for name in names:
        if (data.root / name).is_file():
            inputs[name] = sha256_of_file(data.root / name)
    if settings.poses is not None:
        inputs["poses"] = sha256_of_file(settings.poses)
    return inputs
