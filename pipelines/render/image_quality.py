"""Image quality of rendered views: PSNR and SSIM over the covered pixels."""

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray

# Constants of Wang, Bovik, Sheikh, Simoncelli (2004), "Image quality assessment", for 8 bits.
SSIM_SIGMA = 1.5
SSIM_MEAN_CONSTANT = (0.01 * 255.0) ** 2
SSIM_VARIANCE_CONSTANT = (0.03 * 255.0) ** 2
# Two equal images have no finite PSNR; nothing rendered comes near this.
LARGEST_PSNR = 100.0


def fitted_gain(rendered: ImageArray, recorded: ImageArray, covered: BoolArray) -> float:
    """The brightness factor that fits ``rendered`` to ``recorded`` best where it is covered."""
    a, b = rendered[covered].astype(np.float64), recorded[covered].astype(np.float64)
    square = float(np.sum(a * a))
    return float(np.sum(a * b)) / square if square > 0.0 else 1.0


def psnr(rendered: ImageArray, recorded: ImageArray, covered: BoolArray) -> float:
    """Peak signal-to-noise ratio (dB) over the covered pixels, after one gain factor.

    Args:
        rendered: ``(H, W, 3)``.
        recorded: ``(H, W, 3)``.
        covered: ``(H, W)``; with no pixel covered the result is 0.
    """
    if not covered.any():
        return 0.0
    gain = fitted_gain(rendered, recorded, covered)
    difference = gain * rendered[covered].astype(np.float64) - recorded[covered]
    error = float(np.mean(difference**2))
    return min(LARGEST_PSNR, 10.0 * float(np.log10(255.0**2 / max(error, 1e-12))))


def ssim(rendered: ImageArray, recorded: ImageArray, covered: BoolArray) -> float:
    """Mean structural similarity of the brightness over the covered pixels, after one gain factor.

    Windows are Gaussians of 1.5 pixels (Wang et al. 2004). Uncovered pixels count as equal inside
    the windows of covered ones.
    """
    if not covered.any():
        return 0.0
    gain = fitted_gain(rendered, recorded, covered)
    b = cv2.cvtColor(recorded, cv2.COLOR_RGB2GRAY).astype(np.float64)
    a = np.clip(gain * cv2.cvtColor(rendered, cv2.COLOR_RGB2GRAY).astype(np.float64), 0.0, 255.0)
    a = np.where(covered, a, b)
    mean_a, mean_b = _window(a), _window(b)
    variance_a = _window(a * a) - mean_a**2
    variance_b = _window(b * b) - mean_b**2
    covariance = _window(a * b) - mean_a * mean_b
    similarity = (
        (2.0 * mean_a * mean_b + SSIM_MEAN_CONSTANT)
        * (2.0 * covariance + SSIM_VARIANCE_CONSTANT)
        / (
            (mean_a**2 + mean_b**2 + SSIM_MEAN_CONSTANT)
            * (variance_a + variance_b + SSIM_VARIANCE_CONSTANT)
        )
    )
    return float(similarity[covered].mean())


def _window(image: FloatArray) -> FloatArray:
    blurred = cv2.GaussianBlur(image, (11, 11), SSIM_SIGMA, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, dtype=np.float64)
