"""Channels: what of a photo is compared, its colours or features that other light changes little.

Other light scales and shifts the grey levels of a neighbourhood, but hardly moves an edge.
``CONTRAST`` takes each colour's difference from the mean of its neighbourhood and divides it by the
spread of the grey levels there (local contrast normalisation, Jarrett et al. 2009; the mean product
of two such images is the mean of their local ZNCC scores). ``GRADIENT`` keeps the slopes of the
grey levels, divided by how steep the neighbourhood is (as block-normalised gradients, Dalal and
Triggs 2005), and their length.

Two are mixtures. ``MIXED`` takes the local contrast of the grey levels and their two slopes.
``CHROMA`` takes that contrast and two colours, red against green and yellow against blue, divided
by the brightness of the neighbourhood. These also distinguish even surfaces of different paint, and
are invariant to brighter or dimmer light, but not to light of another colour.

Channels are bytes like colours, 128 on an even surface (in ``CHROMA`` a grey one), and take the
place of RGB: the same code blends and compares views of them. They are computed from each level of
a photo's pyramid, so that a neighbourhood is as many pixels wide as in the image that it is
compared with.
"""

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, ImageArray
from pipelines.artifacts.processes import in_threads
from pipelines.lightfield.views import Views
from pipelines.render.choices import Channels

# Side of the neighbourhood, pixels.
WINDOW = 5
# Grey levels: spreads and slopes below these are noise, and are not amplified.
SMALLEST_SPREAD, SMALLEST_SLOPE = 3.0, 1.5
# Grey levels that are added to the brightness: in the dark, colour is noise.
SMALLEST_BRIGHTNESS = 8.0
# A colour that differs by a quarter of the brightness counts as much as a spread of one.
COLOURFULNESS = 4.0
# The channels' zero, and how much a spread of one is, as bytes.
ZERO, SCALE = 128.0, 40.0
# How much of each pixel, and of each neighbourhood, is used where all of an image is.
ONE = np.ones((), dtype=np.float32)
# Luma of ITU-R BT.601.
LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)


def channel_image(
    image: ImageArray | Float32Array, channels: Channels, shown: BoolArray | None = None
) -> Float32Array:
    """The channels ``(H, W, 3)`` of an image, 0 to 255.

    Args:
        image: ``(H, W, 3)`` RGB, 0 to 255.
        channels: which.
        shown: ``(H, W)`` pixels that show the scene; others are in no neighbourhood. None: all
            do.
    """
    colours = np.asarray(image, dtype=np.float32)
    if channels is Channels.COLOUR:
        return colours
    used = share = ONE
    if shown is not None:
        colours = np.where(shown[..., None], colours, np.float32(0.0))
        used = shown.astype(np.float32)
        share = np.maximum(_box(used), np.float32(1e-6))
    values = _MADE_BY[channels](colours, used, share)
    values *= SCALE
    values += ZERO
    return np.clip(values, 0.0, 255.0, out=values)


def _box(values: Float32Array) -> Float32Array:
    """Mean over the neighbourhood of each pixel; images are mirrored at their borders."""
    blurred = cv2.blur(values, (WINDOW, WINDOW), borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(blurred, dtype=np.float32)


def _thrice(values: Float32Array) -> Float32Array:
    """Numbers ``(H, W)`` for each of three channels: ``(H, W, 3)``; one for all stays one.

    NumPy's broadcasting does the same, but in inner loops of three numbers, which takes several
    times as long. Where this is used, results overwrite arrays that are no longer needed: with
    arrays of this size allocation takes longer than the arithmetic.
    """
    if values.ndim == 0:
        return values
    return np.asarray(cv2.merge([values, values, values]), dtype=np.float32)


def _contrast(colours: Float32Array, used: Float32Array, share: Float32Array) -> Float32Array:
    grey = colours @ LUMA
    values = colours - _box(colours) / _thrice(share)
    variance = np.maximum(_box(grey * grey) / share - (_box(grey) / share) ** 2, np.float32(0.0))
    spread = np.sqrt(variance + np.float32(SMALLEST_SPREAD**2))
    values *= _thrice(used)
    values /= _thrice(spread)
    return values


def _gradient(colours: Float32Array, used: Float32Array, share: Float32Array) -> Float32Array:
    grey = cv2.copyMakeBorder(colours @ LUMA, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    shown = np.ascontiguousarray(np.broadcast_to(used, colours.shape[:2]))
    known = cv2.copyMakeBorder(shown, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    across = 0.5 * (grey[1:-1, 2:] - grey[1:-1, :-2]) * known[1:-1, 2:] * known[1:-1, :-2]
    down = 0.5 * (grey[2:, 1:-1] - grey[:-2, 1:-1]) * known[2:, 1:-1] * known[:-2, 1:-1]
    squares = across**2 + down**2
    steepness = np.sqrt(_box(squares) / share + np.float32(SMALLEST_SLOPE**2))
    slopes = np.stack([across, down, np.sqrt(squares)], axis=2)
    slopes *= _thrice(used)
    slopes /= _thrice(steepness)
    return slopes


def _mixed(colours: Float32Array, used: Float32Array, share: Float32Array) -> Float32Array:
    # Local contrast is linear in the colours: the greys' is the grey of all three.
    contrast = _contrast(colours, used, share) @ LUMA
    slopes = _gradient(colours, used, share)
    return np.concatenate([contrast[..., None], slopes[..., :2]], axis=2)


def _chroma(colours: Float32Array, used: Float32Array, share: Float32Array) -> Float32Array:
    contrast = _contrast(colours, used, share) @ LUMA
    red, green, blue = np.moveaxis(colours, 2, 0)
    brightness = _box(colours @ LUMA) / share + np.float32(SMALLEST_BRIGHTNESS)
    scale = np.float32(COLOURFULNESS) * used / brightness
    yellow = np.float32(0.5) * (red + green)
    return np.stack([contrast, scale * (red - green), scale * (yellow - blue)], axis=2)


_MADE_BY = {
    Channels.CONTRAST: _contrast,
    Channels.GRADIENT: _gradient,
    Channels.MIXED: _mixed,
    Channels.CHROMA: _chroma,
}


def views_in_channels(views: Views, channels: Channels) -> Views:
    """The same photos with these channels in the place of colours, at each pyramid level."""
    if channels is Channels.COLOUR:
        return views
    arrays = views.arrays
    texels = arrays.texels.copy()

    def replace_colours(view: int) -> None:
        for level, start in enumerate(arrays.level_start[view]):
            # Views with fewer levels repeat their last one.
            if level > 0 and start == arrays.level_start[view, level - 1]:
                break
            width, height = arrays.level_size[view, level]
            made = np.rint(channel_image(views.level(view, level), channels)).astype(np.uint8)
            packed = cv2.cvtColor(made, cv2.COLOR_RGB2RGBA)
            texels[start : start + width * height] = packed.reshape(-1, 4)

    # Exhausted, so that errors are raised here.
    list(in_threads(replace_colours, range(len(views))))
    return Views(arrays._replace(texels=texels), views.intrinsics)
