"""How well two images agree, window by window: also in what is a small part of them.

Where much of two images is the same, a sum over all pixels hardly sees what differs. The mean over
windows does: a window that shows another picture agrees in nothing, however many others agree.
"""

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array
from pipelines.artifacts.processes import in_threads
from pipelines.lightfield.views import Views
from pipelines.render.channels import ZERO
from pipelines.render.choices import Channels
from pipelines.render.pixel_evidence import left_out_photos, photo_in_channels, poses_of
from pipelines.render.renderer import Renderer

# Windows are so many to the width of an image, half overlapping. One counts where so much of it is
# covered, and one of the images shows something: root mean square of a channel, as bytes.
WINDOWS_ACROSS, COVERED_SHARE, STRUCTURE = 10, 0.9, 25.0


def agreement(image: Float32Array, view: Float32Array, shown: BoolArray) -> float:
    """Mean over the windows of two images of how alike they are.

    Args:
        image: ``(H, W, 3)`` in channels of local contrast.
        view: ``(H, W, 3)`` in the same.
        shown: ``(H, W)`` pixels of both that are to be compared.

    Returns:
        Mean normalised correlation, at most 1; 0 where no window shows anything.
    """
    side = max(3, image.shape[1] // WINDOWS_ACROSS)
    known = np.where(shown[..., None], image - np.float32(ZERO), np.float32(0.0))
    rendered = np.where(shown[..., None], view - np.float32(ZERO), np.float32(0.0))

    def of_windows(values: Float32Array) -> Float32Array:
        means = cv2.boxFilter(values, -1, (side, side))
        half = side // 2
        rows, columns = (slice(half, length - half, half) for length in values.shape)
        return np.asarray(means[rows, columns], dtype=np.float32)

    own = of_windows((known**2).mean(axis=2))
    other = of_windows((rendered**2).mean(axis=2))
    both = of_windows((known * rendered).mean(axis=2))
    covered = of_windows(shown.astype(np.float32))
    counts = (covered >= COVERED_SHARE) & (np.maximum(own, other) >= STRUCTURE**2)
    if not counts.any():
        return 0.0
    return float(np.mean(both[counts] / np.sqrt(np.maximum(own * other, 1.0)[counts])))


def usual_agreement(colours: Views, channels: Channels, width: int, renderer: Renderer) -> float:
    """How well photos agree with what all others make of them where they were taken: the median.

    Args:
        colours: the photos in colours.
        channels: of local contrast.
        width: of the images that will be compared, pixels.
        renderer: of the photos in these channels.

    Returns:
        At most 1; 0 where the photos show nothing of each other.
    """
    poses = poses_of(colours)

    def left_out(index: int) -> float:
        image, pinhole = photo_in_channels(colours, index, channels, width)
        others = renderer.without_view(index, threads=1)
        views, covered = others.render_many(poses[index : index + 1], pinhole)
        return agreement(image, views[0], covered[0])

    found = list(in_threads(left_out, left_out_photos(len(colours)), renderer.threads))
    return max(0.0, float(np.median(found))) if found else 0.0
