"""Drives whose images are no views of the place, made of a recorded drive.

- ``frozen``: one image is shown six times more while the robot drives on; the truth is where it is.

The others show nothing that the map knows; they have no true poses, and whatever is tracked on them
is wrong:

- ``mirrored``, ``upside-down`` and ``negative``: the recorded images, left and right or brightness
  exchanged, or turned by half a turn. What they show is like the place in all but its arrangement.
- ``noise``: each pixel for itself.
- ``grey``: one grey.
- ``ramp``: grey that rises from one side to the other, in another direction in each image.
- ``stripes``: bright and dark, likewise.

Odometry is that of the recorded drive. The same seed gives the same bytes.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.stages import Progress
from pipelines.experiments.disturbed_sequences import Disturbance, write_drives

RECORD = "troubles.json"
FROZEN_FRAMES = 6
# Some stay before and after the frozen ones.
FEWEST_FRAMES = FROZEN_FRAMES + 2
GREY = 128
RAMP_LEVELS = (40.0, 215.0)
STRIPE_LEVELS = (60.0, 195.0)
# Stripes across the width of an image.
FEWEST_STRIPES, MOST_STRIPES = 3.0, 12.0

# An image from a recorded one, which it has the shape of, and random numbers.
Image = Callable[[ImageArray, np.random.Generator], ImageArray]


def mirrored(image: ImageArray, _rng: np.random.Generator) -> ImageArray:
    """The image ``(H, W, 3)`` with left and right exchanged."""
    return np.ascontiguousarray(image[:, ::-1])


def upside_down(image: ImageArray, _rng: np.random.Generator) -> ImageArray:
    """The image ``(H, W, 3)`` turned by half a turn, as of a camera that hangs."""
    return np.ascontiguousarray(image[::-1, ::-1])


def negative(image: ImageArray, _rng: np.random.Generator) -> ImageArray:
    """The image ``(H, W, 3)`` with bright and dark exchanged."""
    return np.asarray(255 - image, dtype=np.uint8)


def noise(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """Pixels ``(H, W, 3)`` of any colour."""
    return rng.integers(0, 256, image.shape, dtype=np.uint8)


def grey(image: ImageArray, _rng: np.random.Generator) -> ImageArray:
    """One grey, ``(H, W, 3)``."""
    return np.full_like(image, GREY)


def ramp(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """Grey ``(H, W, 3)`` that rises in a direction that is drawn."""
    along = _along(image, rng)
    low, high = RAMP_LEVELS
    share = (along - along.min()) / (along.max() - along.min())
    return _grey_image(low + (high - low) * share)


def stripes(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """Stripes ``(H, W, 3)`` of a direction, width and place that are drawn."""
    along = _along(image, rng) / image.shape[1]
    periods, start = rng.uniform(FEWEST_STRIPES, MOST_STRIPES), rng.random()
    return _grey_image(np.where((periods * along + start) % 1.0 < 0.5, *STRIPE_LEVELS))


KINDS: tuple[tuple[str, str, Image], ...] = (
    ("mirrored", "left and right are exchanged", mirrored),
    ("upside-down", "the images are turned by half a turn", upside_down),
    ("negative", "bright and dark are exchanged", negative),
    ("noise", "each pixel has a colour of its own", noise),
    ("grey", "the images have one grey", grey),
    ("ramp", "grey rises from one side to the other", ramp),
    ("stripes", "stripes, bright and dark", stripes),
)


def troubles(frames: int, seed: int = 0) -> tuple[Disturbance, ...]:
    """All of them for a drive of so many frames, at least ``FEWEST_FRAMES``.

    Args:
        frames: of the recorded drive.
        seed: of what is drawn, not negative.
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


def write_troubles(
    drive: Path, output: Path, *, seed: int, overwrite: bool, progress: Progress
) -> tuple[Path, ...]:
    """Writes a data set for each of ``troubles`` below a folder.

    Args:
        drive: the recorded drive, with ground truth, camera and odometry.
        output: the folder; appears whole or not at all.
        seed: of what is drawn, not negative.
        overwrite: whether one of an earlier time may be replaced.
        progress: told how far the work is.

    Returns:
        The data sets' folders.

    Raises:
        InputError: the drive cannot be used, lacks something or is too short, or the output cannot
            be written.
    """
    return write_drives(
        drive,
        output,
        lambda frames: troubles(frames, seed),
        RECORD,
        fewest_frames=FEWEST_FRAMES,
        overwrite=overwrite,
        progress=progress,
    )


def _drawn(image: Image, seed: int, kind: int) -> Callable[[int, ImageArray], ImageArray]:
    """Each frame of each kind draws for itself, whatever was drawn before."""
    return lambda number, recorded: image(recorded, np.random.default_rng([seed, kind, number]))


def _along(image: ImageArray, rng: np.random.Generator) -> FloatArray:
    """Pixels ``(H, W)`` in a direction that is drawn."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    rows, columns = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    return np.asarray(np.cos(angle) * columns + np.sin(angle) * rows, dtype=np.float64)


def _grey_image(levels: FloatArray) -> ImageArray:
    """Levels ``(H, W)`` as an image ``(H, W, 3)``."""
    return np.repeat(np.rint(levels).astype(np.uint8)[..., None], 3, axis=2)
