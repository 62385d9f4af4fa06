"""The same work in OpenCV: ``warpPerspective``, blending, ``norm``.

OpenCV is given what the fused path works out for itself: homographies and blending weights are
computed before the clock starts. Of several ways to say this the fastest were taken: photos as
floats, ``accumulateProduct``, buffers that are used again. With a fourth channel of nothing it is
faster still, as is the fused path, since four floats are what a processor reads at once; both ways
are measured.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.work import Work, homographies, net_weights
from pipelines.artifacts.arrays import Float32Array, FloatArray


@dataclass(frozen=True)
class OpenCvWork:
    """What OpenCV is given: everything that does not touch pixels is done.

    Attributes:
        photos: three images ``(h, w, C)`` float32; RGB, and zero where C is 4.
        homographies: ``(M, 3, 3, 3)`` from virtual pixels to pixels of each photo.
        weights: ``(M, 3, H, W, C)``, each weight once a channel.
        query: ``(H, W, C)`` float32, the camera image.
    """

    photos: tuple[Float32Array, ...]
    homographies: FloatArray
    weights: Float32Array
    query: Float32Array


def opencv_work(work: Work, channels: int) -> OpenCvWork:
    """Prepares the task for OpenCV with 3 or 4 channels."""
    weights = np.array([net_weights(work, pose) for pose in work.poses])
    return OpenCvWork(
        photos=tuple(_floats(work.views.level(view, 0), channels) for view in range(3)),
        homographies=np.array([homographies(work, pose) for pose in work.poses]),
        weights=np.repeat(weights[..., None], channels, axis=-1),
        query=_floats(work.query, channels),
    )


def opencv_image(
    work: OpenCvWork, particle: int, warped: Float32Array, blend: Float32Array
) -> None:
    """Renders the view at one particle.

    Args:
        work: the task.
        particle: which.
        warped: ``(H, W, C)`` overwritten.
        blend: ``(H, W, C)`` receives the view.
    """
    height, width = blend.shape[:2]
    blend[:] = 0.0
    for view, photo in enumerate(work.photos):
        cv2.warpPerspective(
            photo,
            work.homographies[particle, view],
            (width, height),
            dst=warped,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        )
        cv2.accumulateProduct(warped, work.weights[particle, view], blend)


def opencv_costs(work: OpenCvWork) -> FloatArray:
    """Mean squared difference relative to 255^2 for every particle, as ``Cost.SQUARED``."""
    warped, blend = np.empty_like(work.query), np.empty_like(work.query)
    height, width = work.query.shape[:2]
    scale = 1.0 / (255.0**2 * 3 * height * width)
    costs = np.empty(len(work.homographies))
    for particle in range(len(costs)):
        opencv_image(work, particle, warped, blend)
        costs[particle] = scale * cv2.norm(blend, work.query, cv2.NORM_L2SQR)
    return costs


def _floats(image: np.ndarray, channels: int) -> Float32Array:
    """``(H, W, channels)``: the image's colours, and zero behind them."""
    result = np.zeros((*image.shape[:2], channels), dtype=np.float32)
    result[..., :3] = image[..., :3]
    return result
