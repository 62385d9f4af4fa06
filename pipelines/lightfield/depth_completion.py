"""Depth where no neighbouring view confirms any: the surfaces around it are carried on.

What only one photo shows has no parallax. A floor or a wall mostly goes on as it was, so planes are
fitted at the rim of the unconfirmed region and extended into it.
"""

from dataclasses import replace

import cv2
import numpy as np

from pipelines import native
from pipelines.lightfield.depth import DepthMap

# Specks of confidence smaller than half of this window, in pixels, are no surface to start from.
SPECK_SIZE = 7
MEDIAN_SIZE = 5


def complete_depth(depth_map: DepthMap) -> DepthMap:
    """Replaces depth that is not confident by that of the surfaces around it.

    Returns:
        Depth everywhere, unchanged where it is still confident; a map without any confident pixel
        keeps its depth.
    """
    confident = depth_map.confident.astype(np.uint8)
    known = np.asarray((cv2.medianBlur(confident, SPECK_SIZE) > 0) & depth_map.confident)
    if not np.any(known):
        return replace(depth_map, confident=known)
    carried = native.complete_depth(depth_map.inverse_depth, known)
    # Single directions leave streaks. A mean would take them away too, and blur the rim.
    smooth = np.asarray(cv2.medianBlur(carried, MEDIAN_SIZE), dtype=np.float32)
    completed = np.where(known, depth_map.inverse_depth, smooth)
    return replace(depth_map, inverse_depth=completed, confident=known)
