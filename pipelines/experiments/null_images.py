"""Sequences whose images do not show the place, made from a recorded one.

- ``frozen``: one image is repeated six times while the robot drives on; true poses are kept.

The others have no true poses, so that every frame with the status "tracking" is wrong:

- ``mirrored``: the recorded images, left and right exchanged.
- ``upside-down``: the recorded images, rotated by 180 degrees.
- ``negative``: the recorded images, bright and dark exchanged.
- ``noise``: independent random pixels.
- ``grey``: one grey level.
- ``ramp``: grey levels that rise linearly, in a random direction in each image.
- ``stripes``: bright and dark stripes, of random direction, width and phase in each image.

Odometry is that of the recorded sequence. The same seed gives the same bytes.
"""

from collections.abc import Callable

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.experiments.disturbed_sequences import Disturbance, DisturbanceSet

# The name by which folders that older versions wrote are recognized, too.
RECORD = "troubles.json"
FROZEN_FRAMES = 6
# At least one frame before and one after the frozen ones.
FEWEST_FRAMES = FROZEN_FRAMES + 2
GREY = 128
RAMP_LEVELS = (40.0, 215.0)
STRIPE_LEVELS = (60.0, 195.0)
# Stripes across the width of an image.
FEWEST_STRIPES, MOST_STRIPES = 3.0, 12.0

# From a recorded image and random numbers to an image of the same shape.
Alteration = Callable[[ImageArray, np.random.Generator], ImageArray]


def mirrored(image: ImageArray, _rng: np.random.Generator) -> ImageArray:
    """The image ``(H, W, 3)`` with left and right exchanged."""
    return np.ascontiguousarray(image[:, ::-1])


def upside_down(image: ImageArray, _rng: np.random.Generator) -> ImageArray:
    """The image ``(H, W, 3)`` rotated by 180 degrees."""
    return np.ascontiguousarray(image[::-1, ::-1])


def negative(image: ImageArray, _rng: np.random.Generator) -> ImageArray:
    """The image ``(H, W, 3)`` with bright and dark exchanged."""
    return np.asarray(255 - image, dtype=np.uint8)


def noise(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """Independent random colours ``(H, W, 3)``."""
    return rng.integers(0, 256, image.shape, dtype=np.uint8)


def grey(image: ImageArray, _rng: np.random.Generator) -> ImageArray:
    """An image ``(H, W, 3)`` of one grey level."""
    return np.full_like(image, GREY)


def ramp(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """Grey levels ``(H, W, 3)`` that rise linearly in a random direction."""
    along = _along(image, rng)
    low, high = RAMP_LEVELS
    share = (along - along.min()) / (along.max() - along.min())
    return _grey_image(low + (high - low) * share)


def stripes(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """Stripes ``(H, W, 3)`` of random direction, width and phase."""
    along = _along(image, rng) / image.shape[1]
    periods, start = rng.uniform(FEWEST_STRIPES, MOST_STRIPES), rng.random()
    return _grey_image(np.where((periods * along + start) % 1.0 < 0.5, *STRIPE_LEVELS))


KINDS: tuple[tuple[str, str, Alteration], ...] = (
    ("mirrored", "left and right are exchanged", mirrored),
    ("upside-down", "the images are rotated by 180 degrees", upside_down),
    ("negative", "bright and dark are exchanged", negative),
    ("noise", "each pixel has a colour of its own", noise),
    ("grey", "the images have one grey", grey),
    ("ramp", "grey rises from one side to the other", ramp),
    ("stripes", "stripes, bright and dark", stripes),
)


def null_image_disturbances(frames: int, seed: int = 0) -> tuple[Disturbance, ...]:
    """The disturbances of a sequence, ``frozen`` first.

    Args:
        frames: number of its frames, at least ``FEWEST_FRAMES``.
        seed: seed of the random images, not negative.
    """
    order = tuple(range(frames))
    first = (frames - FROZEN_FRAMES) // 2
    last = first + FROZEN_FRAMES
    shown = (*order[:first], *(first - 1,) * FROZEN_FRAMES, *order[last:])
    frozen = Disturbance(
        name="frozen",
        meaning=f"frames {first} to {last - 1} show the image of frame {first - 1} once more",
        order=order,
        jumps=frozenset(),
        altered=lambda *_: None,
        shown=shown,
    )
    others = (
        Disturbance(name, meaning, order, frozenset(), _drawn(image, seed, kind), has_truth=False)
        for kind, (name, meaning, image) in enumerate(KINDS)
    )
    return (frozen, *others)


def null_images(seed: int) -> DisturbanceSet:
    """The disturbances with the random images of a seed that is not negative."""
    return DisturbanceSet(
        RECORD, FEWEST_FRAMES, lambda frames: null_image_disturbances(frames, seed)
    )


def _drawn(image: Alteration, seed: int, kind: int) -> Callable[[int, ImageArray], ImageArray]:
    """The images of a kind; the random numbers of each depend on its frame alone."""
    return lambda number, recorded: image(recorded, np.random.default_rng([seed, kind, number]))


def _along(image: ImageArray, rng: np.random.Generator) -> FloatArray:
    """Coordinate ``(H, W)`` of each pixel along a random direction, pixels."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    rows, columns = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    return np.asarray(np.cos(angle) * columns + np.sin(angle) * rows, dtype=np.float64)


def _grey_image(levels: FloatArray) -> ImageArray:
    """Grey levels ``(H, W)`` as an image ``(H, W, 3)``."""
    return np.repeat(np.rint(levels).astype(np.uint8)[..., None], 3, axis=2)
