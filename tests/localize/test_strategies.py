"""The strategies on problems whose answer is known: a Kalman filter, nothing, one particle."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import wrap_angle
from pipelines.localize.alignment import Alignment
from pipelines.localize.belief import Belief, region_of_area
from pipelines.localize.estimate import mean_state, state_covariance
from pipelines.localize.likelihood import Likelihood
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.mixture_mcl import MixtureProposalMcl
from pipelines.localize.observation import Observation, Observations
from pipelines.localize.search import GlobalSearch
from pipelines.localize.settings import LocalizerSettings, MotionModel
from pipelines.localize.state_space import PLANAR
from pipelines.localize.strategies import (
    CoarseToFine,
    Condensation,
    Posterior,
    Strategy,
    start_belief,
)
from pipelines.render.choices import Channels, Cost
from pipelines.render.renderer import Renderer
from tests.report_samples import MOUNT, wall_scene

REGION = region_of_area((-5.0, 5.0, -5.0, 5.0))
PIXEL = Observation(np.zeros((1, 1, 3), dtype=np.float32), Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0))
SEEN = Observations({20: PIXEL, 40: PIXEL}, contrast=50.0)
UNSEEN = Observations({20: PIXEL, 40: PIXEL}, contrast=0.0)
LogLikelihood = Callable[[FloatArray], FloatArray]
# Turns so small that the position does not notice: the problem is linear.
MOTION = MotionModel(0.0, 0.0, 0.0, 0.0, position_floor=0.06, heading_floor=0.004)
MEASURED = np.array([0.05, 0.08, 0.006])
SHARPNESS = 100.0


@dataclass(frozen=True)
class Measurement:
    """What stands for a camera image: where the state was seen, with Gaussian noise."""

    state: FloatArray

    def log_likelihoods(self, states: FloatArray) -> FloatArray:
        offsets = PLANAR.difference(states, self.state)
        return np.asarray(-0.5 * np.sum((offsets / MEASURED) ** 2, axis=1))


class Told(MeasurementModel):
    """A model that is told how likely states are, instead of looking at images."""

    def __init__(self, renderer: Renderer, peak: FloatArray, rule: LogLikelihood) -> None:
        kind = Likelihood(Cost.SQUARED, SHARPNESS)
        super().__init__(renderer.views, {Channels.CONTRAST: renderer}, PLANAR, MOUNT, kind)
        self.peak = peak
        self.rule = rule

    def log_likelihoods(self, states: FloatArray, observation: Observation) -> FloatArray:
        return self.rule(states)

    def evidence(
        self, states: FloatArray, observation: Observation, pixel_subsampling: int = 1
    ) -> FloatArray:
        # Whatever is seen, it is of the map.
        return np.full(len(states), 20.0)

    def aligned(
        self, state: FloatArray, observations: Any, widths: Any, prior: Any = None
    ) -> Alignment:
        # Half the second derivative of the cost in squared grey levels, as alignment states it.
        curvature = np.diag(MEASURED**-2.0) * 255.0**2 / (2.0 * SHARPNESS)
        return Alignment(self.peak, np.diag(MEASURED**2), curvature, 1.0, True)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer.of_scene(wall_scene(), 8, threads=1)


START = (0.3, -0.2, 0.0)


def settings(**changes: Any) -> LocalizerSettings:
    chosen: dict[str, Any] = {
        "particles": 600,
        "start_particles": 600,
        "start": START,
        "start_position_sigma": 0.2,
        "start_heading_sigma": 0.01,
        "motion": MOTION,
        "threads": 1,
        # So that coarse_to_fine is Bayes' rule as well.
        "smallest_effective_share": 0.0,
        "roughening": 0.0,
    }
    return LocalizerSettings(**{**chosen, **changes})


def condensation(told: Told, seed: int, **changes: Any) -> Strategy:
    chosen = settings(strategy="condensation", **changes)
    return Condensation(told, REGION, chosen, np.random.default_rng(seed))


def coarse_to_fine(told: Told, seed: int, **changes: Any) -> Strategy:
    chosen = settings(strategy="coarse_to_fine", **changes)
    return CoarseToFine(told, REGION, chosen, np.random.default_rng(seed))


def informed(told: Told, seed: int, **changes: Any) -> Strategy:
    views, chosen = wall_scene().world_from_camera, settings(**changes)
    rng = np.random.default_rng(seed)
    search = GlobalSearch(told, REGION, views, chosen, rng)
    return MixtureProposalMcl(told, REGION, search, chosen, rng)


def step(strategy: Strategy, observations: Observations, increment: FloatArray | None) -> Posterior:
    """One frame."""
    strategy.resample()
    strategy.predict(increment)
    return strategy.weight(observations)


every_strategy = pytest.mark.parametrize("make", [condensation, coarse_to_fine, informed])


# --- the Kalman filter -------------------------------------------------------------------------

INCREMENT = np.array([0.1, 0.05, 0.0])


def measurements(count: int) -> list[Measurement]:
    rng = np.random.default_rng(7)
    truth = np.array(START) + np.arange(count)[:, None] * INCREMENT
    return [Measurement(state + MEASURED * rng.standard_normal(3)) for state in truth]


def kalman(seen: list[Measurement]) -> list[tuple[FloatArray, FloatArray]]:
    """Means and variances; everything is independent along the axes."""
    mean, variance = np.array(START), np.array([0.2, 0.2, 0.01]) ** 2
    found = []
    for number, measurement in enumerate(seen):
        if number > 0:
            mean = mean + INCREMENT
            variance = variance + np.array([0.06, 0.06, 0.004]) ** 2
        gain = variance / (variance + MEASURED**2)
        mean = mean + gain * (measurement.state - mean)
        variance = (1.0 - gain) * variance
        found.append((mean, variance))
    return found


def moments(belief: Belief) -> tuple[FloatArray, FloatArray]:
    mean = mean_state(belief)
    return mean, np.diag(state_covariance(PLANAR, belief.states, belief.weights, mean))


@every_strategy
def test_the_filter_agrees_with_the_kalman_filter(make: Any, renderer: Renderer) -> None:
    seen, seeds = measurements(4), 10
    expected = kalman(seen)
    means = np.empty((seeds, len(seen), 3))
    variances = np.empty((seeds, len(seen), 3))
    for seed in range(seeds):
        told = Told(renderer, seen[0].state, seen[0].log_likelihoods)
        strategy = make(told, seed)
        for number, measurement in enumerate(seen):
            told.peak, told.rule = measurement.state, measurement.log_likelihoods
            belief = step(strategy, SEEN, INCREMENT if number else None).belief
            means[seed, number], variances[seed, number] = moments(belief)
    for number, (mean, variance) in enumerate(expected):
        sigma = np.sqrt(variance)
        error = means[:, number].std(axis=0) / math.sqrt(seeds)
        assert np.all(np.abs(means[:, number].mean(axis=0) - mean) < 5.0 * error + 0.02 * sigma)
        assert np.all(means[:, number].std(axis=0) < 0.25 * sigma)
        np.testing.assert_allclose(variances[:, number].mean(axis=0), variance, rtol=0.08)


def test_looking_at_the_image_makes_better_use_of_few_particles(renderer: Renderer) -> None:
    seen = measurements(4)
    expected = np.array([mean for mean, _ in kalman(seen)])
    errors = {}
    for make in (condensation, informed):
        squares = []
        for seed in range(25):
            told = Told(renderer, seen[0].state, seen[0].log_likelihoods)
            strategy = make(told, seed, particles=40, start_particles=40)
            for number, measurement in enumerate(seen):
                told.peak, told.rule = measurement.state, measurement.log_likelihoods
                belief = step(strategy, SEEN, INCREMENT if number else None).belief
                squares.append((mean_state(belief) - expected[number]) ** 2)
        errors[make] = np.sqrt(np.mean(squares, axis=0))
    assert np.median(errors[informed] / errors[condensation]) < 0.8


# --- where the image says nothing, or everything -----------------------------------------------


def impossible(states: FloatArray) -> FloatArray:
    return np.full(len(states), -np.inf)


def broken(states: FloatArray) -> FloatArray:
    values = np.zeros(len(states))
    values[len(states) // 2] = np.nan
    return values


def first_belief(make: Any, renderer: Renderer, seed: int = 0) -> tuple[Told, Strategy]:
    """A filter that has seen one image."""
    measurement = measurements(1)[0]
    told = Told(renderer, measurement.state, measurement.log_likelihoods)
    strategy = make(told, seed)
    step(strategy, SEEN, None)
    return told, strategy


def predicted() -> tuple[FloatArray, FloatArray]:
    """The Kalman filter's second prior."""
    mean, variance = kalman(measurements(1))[0]
    return mean + INCREMENT, variance + np.array([0.06, 0.06, 0.004]) ** 2


@every_strategy
@pytest.mark.parametrize("what", ["impossible", "blind"])
def test_an_image_that_says_nothing_leaves_the_prior(
    make: Any, what: str, renderer: Renderer
) -> None:
    means, variances = [], []
    for seed in range(8):
        told, strategy = first_belief(make, renderer, seed)
        # Proposals elsewhere must not pull the belief there.
        told.rule, told.peak = impossible, told.peak + np.array([0.3, 0.0, 0.0])
        belief = step(strategy, SEEN if what == "impossible" else UNSEEN, INCREMENT).belief
        mean, variance = moments(belief)
        means.append(mean)
        variances.append(variance)
    mean, variance = predicted()
    sigma = np.sqrt(variance)
    assert np.all(np.abs(np.mean(means, axis=0) - mean) < 0.08 * sigma)
    np.testing.assert_allclose(np.mean(variances, axis=0), variance, rtol=0.1)


@every_strategy
def test_a_broken_comparison_is_an_error_and_no_weight(make: Any, renderer: Renderer) -> None:
    told, strategy = first_belief(make, renderer)
    told.rule = broken
    with pytest.raises(StageError, match="NaN"):
        step(strategy, SEEN, INCREMENT)


@every_strategy
def test_one_particle_may_take_all(make: Any, renderer: Renderer) -> None:
    told, strategy = first_belief(make, renderer)

    def only_the_foremost(states: FloatArray) -> FloatArray:
        return np.where(states[:, 0] == states[:, 0].max(), 0.0, -np.inf)

    told.rule = only_the_foremost
    belief = step(strategy, SEEN, INCREMENT).belief
    assert belief.weights.max() == 1.0
    chosen = belief.states[int(np.argmax(belief.log_weights))]
    # The next belief grew from it alone.
    told.rule, told.peak = lambda states: np.zeros(len(states)), chosen
    after = step(strategy, SEEN, INCREMENT).belief
    mean, variance = moments(after)
    expected = PLANAR.composed(chosen, INCREMENT)
    np.testing.assert_allclose(mean[:2], expected[:2], atol=0.015)
    np.testing.assert_allclose(variance[:2], 0.06**2, rtol=0.25)


@every_strategy
def test_the_headings_jump_makes_no_difference(make: Any, renderer: Renderer) -> None:
    place = np.array([0.3, -0.2, np.pi - 0.002])
    measurement = Measurement(place)
    told = Told(renderer, place, measurement.log_likelihoods)
    strategy = make(told, 3, start=(0.3, -0.2, -np.pi + 0.001), start_heading_sigma=0.02)
    belief = step(strategy, SEEN, None).belief
    assert np.all((belief.states[:, 2] > -np.pi) & (belief.states[:, 2] <= np.pi))
    assert abs(float(wrap_angle(mean_state(belief)[2] - place[2]))) < 0.002


# --- where they start --------------------------------------------------------------------------


def test_the_start_is_around_the_pose_or_anywhere() -> None:
    rng = np.random.default_rng(0)
    around = start_belief(PLANAR, REGION, settings(particles=4000, start_particles=4000), 7, rng)
    assert len(around) == 4000
    np.testing.assert_allclose(around.states.mean(axis=0), START, atol=0.02)
    np.testing.assert_allclose(around.states.std(axis=0), [0.2, 0.2, 0.01], rtol=0.06)
    anywhere = start_belief(PLANAR, REGION, settings(start=None), 4000, rng)
    assert len(anywhere) == 4000
    np.testing.assert_allclose(
        anywhere.states[:, :2].std(axis=0), 10.0 / math.sqrt(12.0), rtol=0.05
    )
