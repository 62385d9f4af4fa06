"""Where nobody knows the motion: nothing but the image says where the body is.

The motion is taken to go on as between the last two images, and to be farther and farther from that
until the image is explained. An image that is explained much less than images usually are proves no
place, however much better it fits there than elsewhere: far away something may look like it.
"""

import math
from dataclasses import replace

from pipelines.localize.prediction import Prediction

# The motion goes on as between the last two images, give or take this share of it.
SPEED_CHANGE = 0.5
# While the image does not fit, so many times that is tried, so often, at most as far as this angle:
# a hand turns a camera by half its view in a moment.
SPEED_GROWTH, SPEED_GROWTHS = 4.0, 2
LARGEST_WALK_ANGLE = math.pi / 2.0
# The body may be anywhere with this probability, twice that while the image does not fit. Every
# image is looked up all over the map as well, though more briefly.
UNKNOWN_MOTION_SHARE, UNKNOWN_MOTION_SEARCHED = 0.1, 8
# An image that is explained less than the first share of how well images usually are does not fit
# yet; less than the second, and it proves no place.
FITTING_SHARE, PROVING_SHARE = 0.7, 0.5


def widened(prediction: Prediction, anywhere_share: float) -> Prediction:
    """The prior when the image does not fit where the body was thought to be."""
    return replace(
        prediction,
        position_sigma=SPEED_GROWTH * prediction.position_sigma,
        angle_sigma=min(SPEED_GROWTH * prediction.angle_sigma, LARGEST_WALK_ANGLE),
        anywhere_share=max(anywhere_share, 2.0 * UNKNOWN_MOTION_SHARE),
    )
