"""The limit: what the work costs if nothing is done but what cannot be left out.

For each virtual pixel three photos are read between four texels each, weighted, and added up, by
the very instructions that the core uses (``limit.cpp``, compiled here for this processor).
Everything else is given beforehand: where in the photos, and with which weights. Nothing is chosen,
mapped, checked or compared with a camera image. Of three layouts (pixel by pixel, chunk by chunk,
photo by photo) the fastest was taken: a pixel's three reads follow each other, and its sum stays in
a register.
"""

import ctypes
import functools
import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.work import Work, homographies, net_weights
from pipelines.artifacts.arrays import Float32Array, ImageArray, Int32Array

SAMPLES_PER_PIXEL, CHANNELS = 3, 4
SOURCE = Path(__file__).with_suffix(".cpp")
# As CMakeLists.txt has it, but for one processor.
FLAGS = (
    "-std=c++20",
    "-O3",
    "-ffp-contract=fast",
    "-fno-math-errno",
    "-fopenmp-simd",
    "-Wno-psabi",
)


@dataclass(frozen=True)
class LimitWork:
    """Three samples of each of P pixels, one after the other.

    Attributes:
        texels: ``(T, 4)`` of all photos.
        upper: ``(3 P,)`` int32 index of each sample's upper left texel.
        lower: ``(3 P,)`` int32 that of the lower left one.
        fraction: ``(3 P,)`` how far it lies to the right of these.
        upper_weight: ``(3 P,)`` of the upper texels, and
        lower_weight: ``(3 P,)`` of the lower ones.
    """

    texels: ImageArray
    upper: Int32Array
    lower: Int32Array
    fraction: Float32Array
    upper_weight: Float32Array
    lower_weight: Float32Array


def limit_work(work: Work) -> LimitWork:
    """Where and how the photos are read for the first particle; others' places are as good."""
    views, pose = work.views.arrays, work.poses[0]
    columns, rows = np.meshgrid(np.arange(work.intrinsics.width), np.arange(work.intrinsics.height))
    pixels = np.stack([columns, rows, np.ones_like(rows)]).reshape(3, -1)
    places = homographies(work, pose) @ pixels
    sizes = views.level_size[:, 0, :, None]
    # (2, 3, P); a pixel and a row further on are there, too.
    place = np.clip(places[:, :2] / places[:, 2:], 0.0, sizes - 1)
    first = np.minimum(place, sizes - 2).astype(np.int32)
    left, top, width = first[:, 0], first[:, 1], sizes[:, 0]
    upper = views.level_start[:, :1] + top * width + left
    weights = net_weights(work, pose).reshape(SAMPLES_PER_PIXEL, -1)
    lower_weight = weights * (place[:, 1] - top)

    def flat(values: np.ndarray, kind: type) -> Any:
        return np.ascontiguousarray(values.T, dtype=kind).reshape(-1)

    return LimitWork(
        views.texels,
        flat(upper, np.int32),
        flat(upper + width, np.int32),
        flat(place[:, 0] - left, np.float32),
        flat(weights - lower_weight, np.float32),
        flat(lower_weight, np.float32),
    )


def limit_image(work: LimitWork, times: int) -> Float32Array:
    """The view ``(P, 4)``: colours, and 255; computed so many times."""
    image = np.empty((len(work.upper) // SAMPLES_PER_PIXEL, CHANNELS), dtype=np.float32)
    arrays = (
        work.texels,
        work.upper,
        work.lower,
        work.fraction,
        work.upper_weight,
        work.lower_weight,
        image,
    )
    pointers = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
    _library().add_samples(*pointers, ctypes.c_size_t(len(image)), ctypes.c_size_t(times))
    return image


@functools.cache
def _library() -> ctypes.CDLL:
    """The loop, compiled; calls of it release the interpreter lock."""
    headers = SOURCE.parents[1] / "native"
    # Clang for Arm calls it otherwise; what either does not know is an error.
    processor = "-mcpu=native" if os.uname().machine in {"arm64", "aarch64"} else "-march=native"
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "limit.so"
        compiler = os.environ.get("CXX", "c++")
        command = [compiler, *FLAGS, processor, f"-I{headers}", "-shared", "-fPIC", str(SOURCE)]
        subprocess.run([*command, "-o", str(target)], check=True)
        # What is loaded stays when its file goes.
        return ctypes.CDLL(str(target))
