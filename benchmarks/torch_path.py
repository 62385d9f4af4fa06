"""The same work in PyTorch on the CPU: ``grid_sample``, where torch is installed.

Like OpenCV it is given homographies and blending weights. All particles are sampled in one call a
photo, their images one below the other: one call for each would take longer.
"""

import importlib
import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.work import Work, homographies, net_weights
from pipelines.artifacts.arrays import FloatArray

PACKAGE = "torch"


def is_installed() -> bool:
    """Whether there is a PyTorch to compare with."""
    return importlib.util.find_spec(PACKAGE) is not None


@dataclass(frozen=True)
class TorchWork:
    """What PyTorch is given, as tensors of single precision.

    Attributes:
        torch: the package.
        photos: three, ``(1, 3, h, w)``.
        maps: ``(3, M, 3, 3)`` from virtual pixels to [-1, 1] in each photo.
        pixels: ``(3, H W)`` homogeneous virtual pixels.
        weights: ``(3, M, H W)``.
        query: ``(3, 1, H W)``.
    """

    torch: Any
    photos: tuple[Any, ...]
    maps: Any
    pixels: Any
    weights: Any
    query: Any


def torch_work(work: Work) -> TorchWork:
    """Prepares the task; PyTorch works on one thread from then on."""
    torch: Any = importlib.import_module(PACKAGE)
    torch.set_num_threads(1)
    photos = [work.views.level(view, 0)[..., :3] for view in range(3)]
    maps = np.array([homographies(work, pose) for pose in work.poses])
    for view, photo in enumerate(photos):
        height, width = photo.shape[:2]
        # The middles of the first and the last pixel are -1 and 1.
        shrink = np.diag([2.0 / (width - 1), 2.0 / (height - 1), 1.0])
        shrink[:2, 2] = -1.0
        maps[:, view] = shrink @ maps[:, view]
    columns, rows = np.meshgrid(np.arange(work.intrinsics.width), np.arange(work.intrinsics.height))
    pixels = np.stack([columns, rows, np.ones_like(rows)]).reshape(3, -1)
    weights = np.array([net_weights(work, pose) for pose in work.poses])
    count = len(work.poses)

    def tensor(array: np.ndarray) -> Any:
        return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))

    return TorchWork(
        torch,
        tuple(tensor(photo.transpose(2, 0, 1)[None]) for photo in photos),
        tensor(maps.swapaxes(0, 1)),
        tensor(pixels),
        tensor(weights.swapaxes(0, 1).reshape(3, count, -1)),
        tensor(work.query.transpose(2, 0, 1).reshape(3, 1, -1)),
    )


def torch_costs(work: TorchWork) -> FloatArray:
    """Mean squared difference relative to 255^2 for every particle, as ``Cost.SQUARED``."""
    torch = work.torch
    with torch.inference_mode():
        blend: Any = 0.0
        for photo, maps, weights in zip(work.photos, work.maps, work.weights, strict=True):
            places = maps @ work.pixels
            # (M, 2, P) becomes (1, M, P, 2): one image, M rows high.
            grid = (places[:, :2] / places[:, 2:]).movedim(1, 2)[None]
            shown = torch.nn.functional.grid_sample(
                photo, grid, mode="bilinear", padding_mode="border", align_corners=True
            )
            blend = blend + shown[0] * weights
        squares = torch.square(blend - work.query).mean(dim=(0, 2))
        return np.asarray(squares.numpy(), dtype=np.float64) / 255.0**2
