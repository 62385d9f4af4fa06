"""Pixel subsampling: log-likelihoods by some of the pixels against those by all.

Views are rendered at states around the true pose and compared with the camera image by the filter's
default cost. Pixels left out get the weight 0, others the reciprocal of their probability to be
chosen. Only the differences between states count: an error that all states share changes no
particle's weight.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import CAMERA_FILE, GROUNDTRUTH_FILE, Dataset
from pipelines.lightfield.scene import Scene
from pipelines.localize.likelihood import LIKELIHOODS
from pipelines.localize.measurement_model import VIEW_RESOLUTION_FACTOR
from pipelines.localize.observation import Observer, subsampling_mask
from pipelines.localize.state_space import PLANAR
from pipelines.render.comparison import NO_TABLE, compare, prepared
from pipelines.render.renderer import Renderer

WIDTH = 40
# Standard deviations of the states around the true pose: metres and radians.
SPREAD = np.array([0.06, 0.06, 0.03])
# Number of these states, and number of choices of pixels by each rule, for each image.
STATES, REPETITIONS = 60, 5
# An image has the true pose of the nearest timestamp within this, seconds.
LARGEST_TIME_GAP = 0.1

# From grey levels (H, W), the number of the repetition, and random numbers to the pixels' weights
# (H, W).
Choice = Callable[[FloatArray, int, np.random.Generator], FloatArray]


def by_lattice(step: int, shift: int) -> Choice:
    """One pixel in ``step`` of each row, ``shift`` columns farther in each row."""

    def choose(grey: FloatArray, number: int, _rng: np.random.Generator) -> FloatArray:
        rows, columns = grey.shape
        return subsampling_mask((rows, columns), step, shift, -number).astype(np.float64)

    return choose


def every_other(grey: FloatArray, number: int, _rng: np.random.Generator) -> FloatArray:
    """Every other column and row."""
    weights = np.zeros(grey.shape)
    weights[number // 2 % 2 :: 2, number % 2 :: 2] = 1.0
    return weights


def by_gradient(share: float, floor: float) -> Choice:
    """A random share of the pixels, with probabilities proportional to gradient plus floor.

    Systematic sampling with unequal probabilities (Madow 1949), the pixels in random order. A
    pixel's weight is the reciprocal of its probability.

    Args:
        share: of the pixels, 0 to 1.
        floor: added to the gradient, grey levels a pixel.
    """

    def choose(grey: FloatArray, _number: int, rng: np.random.Generator) -> FloatArray:
        along_y, along_x = np.gradient(grey)
        wanted = share * grey.size
        chance = np.hypot(along_x, along_y).ravel() + floor
        chance *= wanted / chance.sum()
        # No pixel is chosen more than once; probabilities above 1 go to the others.
        while chance.max() > 1.0 + 1e-9:
            is_sure = chance >= 1.0
            chance[is_sure] = 1.0
            chance[~is_sure] *= (wanted - is_sure.sum()) / chance[~is_sure].sum()
        order = rng.permutation(grey.size)
        ends = np.floor(np.cumsum(chance[order]) - rng.random())
        is_taken = np.zeros(grey.size, dtype=bool)
        is_taken[order] = np.diff(ends, prepend=-1.0) > 0.0
        return np.where(is_taken, 1.0 / chance, 0.0).reshape(grey.shape)

    return choose


CHOICES: Mapping[str, Choice] = MappingProxyType(
    {
        "one in 2, (x + y) mod 2": by_lattice(2, 1),
        "one in 3, (x + y) mod 3": by_lattice(3, 1),
        "one in 5, (x + 2y) mod 5": by_lattice(5, 2),
        "one in 10, (x + 3y) mod 10": by_lattice(10, 3),
        "one in 4, every other column and row": every_other,
        "one in 4, by chance": by_gradient(0.25, 1e9),
        "one in 4, by chance, gradient + 20": by_gradient(0.25, 20.0),
        "one in 4, by chance, gradient + 2": by_gradient(0.25, 2.0),
    }
)


def errors_of_choices(
    scene: Scene, dataset: Dataset, rng: np.random.Generator, every_frame: int = 3
) -> tuple[dict[str, float], float]:
    """Errors of log-likelihoods by some of the pixels against those by all.

    Args:
        scene: the light field.
        dataset: sequence of a robot on a floor in that scene, with camera and ground truth.
        rng: random numbers of the states around the true pose and of the choices.
        every_frame: one in this many frames is used.

    Returns:
        The standard deviation of the errors, by choice, and that of the log-likelihoods themselves.
        Both are among states of one image, as root mean square over images and repetitions.

    Raises:
        InputError: the data set has no camera, or no ground truth at any image.
    """
    if dataset.camera is None:
        raise InputError(dataset.root / CAMERA_FILE, "is missing")
    if dataset.groundtruth is None:
        raise InputError(dataset.root / GROUNDTRUTH_FILE, "is missing")
    likelihood = LIKELIHOODS["robust"]
    renderer = Renderer.of_scene(scene, VIEW_RESOLUTION_FACTOR * WIDTH)
    observer = Observer(dataset.camera, [WIDTH])
    nearest = dataset.groundtruth.nearest(dataset.timestamps, LARGEST_TIME_GAP)
    squares: dict[str, list[float]] = {name: [] for name in CHOICES}
    spreads = []
    for frame in range(0, len(dataset), every_frame):
        observation = observer(dataset.read_image(frame)).by_width[WIDTH]
        if nearest[frame] < 0:
            continue
        truth = PLANAR.states(dataset.groundtruth.poses[[nearest[frame]]])
        noise = SPREAD * rng.standard_normal((STATES, 3))
        poses = PLANAR.poses(PLANAR.moved(np.repeat(truth, STATES, axis=0), noise))
        images, covered = renderer.render_many(
            poses @ dataset.body_from_camera, observation.intrinsics
        )
        query = prepared(observation.image)
        grey = query[..., :3].mean(axis=2, dtype=np.float64)
        whole = likelihood.inverse_temperature * costs_by_some(
            images, covered, query, np.ones(grey.shape)
        )
        spreads.append(float(np.var(whole)))
        for name, choose in CHOICES.items():
            for number in range(REPETITIONS):
                part = costs_by_some(images, covered, query, choose(grey, number, rng))
                squares[name].append(float(np.var(likelihood.inverse_temperature * part - whole)))
    if not spreads:
        raise InputError(dataset.root / GROUNDTRUTH_FILE, "has no pose at any image")
    errors = {name: float(np.sqrt(np.mean(values))) for name, values in squares.items()}
    return errors, float(np.sqrt(np.mean(spreads)))


def costs_by_some(
    images: Float32Array, covered: BoolArray, query: Float32Array, weights: FloatArray
) -> FloatArray:
    """The filter's default cost ``robust`` of views, with a weight for each pixel.

    Args:
        images: ``(M, H, W, 3)`` rendered views.
        covered: ``(M, H, W)`` pixels that a recorded view covers.
        query: ``(H, W, 4)`` camera image as ``comparison.prepared`` returns it.
        weights: ``(H, W)`` of the pixels.

    Returns:
        ``(M,)`` costs.
    """
    likelihood = LIKELIHOODS["robust"]
    weighted = query.copy()
    weighted[..., 3] *= weights
    views = np.concatenate([images, covered[..., None].astype(np.float32)], axis=3)
    costs = [
        compare(likelihood.cost, view, weighted, likelihood.fit_gain, NO_TABLE) for view in views
    ]
    return np.array(costs)
