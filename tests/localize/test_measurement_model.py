"""The measurement model in front of the painted wall: absolute, whatever weighs the particles."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pipelines.artifacts.arrays import Float32Array, FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.pose import base_from_camera_mount, world_from_base_planar
from pipelines.localize.belief import Belief, normalise_log_weights
from pipelines.localize.likelihood import LIKELIHOODS, likelihood_named
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observation, Observer
from pipelines.localize.places import COMPRESSED
from pipelines.localize.state_space import PLANAR
from pipelines.render.choices import Channels, Cost
from tests.report_samples import (
    CAMERA,
    MOUNT,
    Paint,
    facing_wall,
    painted,
    photo,
    smooth,
    wall_scene,
)
from tests.sequence_samples import mixture_settings

# Between two recordings, nearer than they are, and turned: no view shows exactly this.
TRUTH = facing_wall(-0.4, 1.7, 0.15)
WRONG = facing_wall(1.3, 1.7, -0.3)
BACK_TO_THE_WALL = facing_wall(0.0, 1.7, np.pi)
STATES = np.stack([WRONG, TRUTH, BACK_TO_THE_WALL, TRUTH + np.array([0.3, 0.0, 0.0])])


def model_of(name: str = "evidence", paint: Paint = painted) -> MeasurementModel:
    chosen = mixture_settings(likelihood=likelihood_named(name))
    return MeasurementModel.of_scene(wall_scene(paint), MOUNT, chosen)


@pytest.fixture(scope="module")
def model() -> MeasurementModel:
    return model_of()


def observation_at(state: FloatArray, width: int = 24, paint: Paint = painted) -> Observation:
    return Observer(CAMERA, [width])(photo(state, paint=paint)).by_width[width]


def changed(observation: Observation, image: FloatArray | Float32Array) -> Observation:
    return Observation(np.clip(image, 0.0, 255.0).astype(np.float32), observation.intrinsics)


@pytest.mark.parametrize("name", sorted(LIKELIHOODS))
def test_every_likelihood_prefers_the_truth(name: str) -> None:
    # The paper's pixels are compared where a view that is a little off is nearly right.
    paint = painted if name == "evidence" else smooth
    own = model_of(name, paint)
    log_likelihoods = own.log_likelihoods(STATES, observation_at(TRUTH, paint=paint))
    assert int(np.argmax(log_likelihoods)) == 1
    assert np.isfinite(log_likelihoods).all()
    assert own.is_absolute is (name == "evidence")
    if name == "evidence":
        # A view of nothing says nothing, exactly.
        assert log_likelihoods[2] == 0.0
    else:
        costs = -log_likelihoods / LIKELIHOODS[name].inverse_temperature
        assert np.all((costs >= 0.0) & (costs <= 1.0))
        # Looking at nothing never wins, not even against a wrong view of something.
        assert costs[2] > costs[3]


@pytest.mark.parametrize("name", sorted(LIKELIHOODS))
def test_evidence_is_absolute_whichever_likelihood_weighs(
    name: str, model: MeasurementModel
) -> None:
    observation = observation_at(TRUTH)
    found = model_of(name).evidence(STATES, observation)
    np.testing.assert_allclose(found, model.evidence(STATES, observation), atol=1e-4)
    assert found[1] > 5.0
    assert found[0] < 0.0
    assert found[2] == 0.0


def test_evidence_is_the_cost_a_pixel_times_the_pixels_that_an_image_is_worth(
    model: MeasurementModel,
) -> None:
    observation = observation_at(TRUTH)
    own = observation.in_channels(Channels.CONTRAST)
    poses = world_from_base_planar(STATES) @ MOUNT
    table = model.pixels(24)
    costs = model.renderer.costs(poses, own.intrinsics, own.image, Cost.EVIDENCE, False, table)
    expected = -LIKELIHOODS["evidence"].inverse_temperature * costs / own.image[..., 0].size
    np.testing.assert_allclose(model.evidence(STATES, observation), expected, rtol=1e-9)


def test_opposite_brightness_noise_and_another_picture_speak_against_the_map(
    model: MeasurementModel,
) -> None:
    observation = observation_at(TRUTH)
    generator = np.random.default_rng(0)
    noise = generator.uniform(0.0, 255.0, observation.image.shape)
    images: tuple[FloatArray | Float32Array, ...] = (
        255.0 - observation.image,
        noise,
        observation.image[:, ::-1],
    )
    for image in images:
        assert model.evidence(TRUTH[None], changed(observation, image))[0] < 0.0
    # Nor is a bare wall what the map shows there.
    bare = np.full_like(observation.image, 120.0)
    assert model.evidence(TRUTH[None], changed(observation, bare))[0] < 0.0


@pytest.mark.parametrize(("gain", "offset"), [(0.6, 0.0), (0.7, 40.0), (1.2, -20.0)])
def test_another_exposure_says_the_same(
    gain: float, offset: float, model: MeasurementModel
) -> None:
    observation = observation_at(TRUTH)
    lit = Observation((gain * observation.image + offset).astype(np.float32), CAMERA.intrinsics)
    lit = replace(lit, intrinsics=observation.intrinsics)
    plain = model.evidence(STATES, observation)
    np.testing.assert_allclose(model.evidence(STATES, lit), plain, atol=0.1 * abs(plain[1]))


def test_pixels_that_do_not_show_the_scene_do_not_count(model: MeasurementModel) -> None:
    observation = observation_at(TRUTH)
    hidden = observation.image.copy()
    hidden[10:, 4:20] = np.random.default_rng(1).uniform(0.0, 255.0, hidden[10:, 4:20].shape)
    masked = hidden.copy()
    masked[10:, 4:20] = np.nan
    whole, dirty, left_out = (
        float(model.evidence(TRUTH[None], Observation(image, observation.intrinsics))[0])
        for image in (observation.image, hidden, masked)
    )
    share = np.isfinite(masked[..., 0]).mean()
    # A part of an image is worth a part.
    assert left_out == pytest.approx(share * whole, rel=0.25)
    assert dirty < left_out
    nothing = np.full_like(masked, np.nan)
    silent = Observation(nothing, observation.intrinsics)
    np.testing.assert_array_equal(model.evidence(STATES, silent), 0.0)


def test_one_pixel_in_five_is_unbiased() -> None:
    """Over all shifts of the pattern the mean is what the whole image says."""
    chosen = mixture_settings(fine_width=48, refine_width=48)
    fine = MeasurementModel.of_scene(wall_scene(), MOUNT, chosen)
    observation = Observer(CAMERA, [48])(photo(TRUTH)).by_width[48]
    whole = fine.evidence(STATES, observation)
    parts = [
        fine.evidence(STATES, replace(observation, number=number), pixel_subsampling=5)
        for number in range(5)
    ]
    np.testing.assert_allclose(np.mean(parts, axis=0), whole, atol=0.02 * abs(whole[1]))
    assert np.std(parts, axis=0)[1] > 1e-3
    # With pixels left out as well.
    gaps = observation.image.copy()
    gaps[:9] = np.nan
    holey = Observation(gaps, observation.intrinsics)
    whole = fine.evidence(STATES, holey)
    parts = [
        fine.evidence(STATES, replace(holey, number=number), pixel_subsampling=5)
        for number in range(5)
    ]
    np.testing.assert_allclose(np.mean(parts, axis=0), whole, atol=0.02 * abs(whole[1]))


def test_the_marginal_of_a_posterior_is_the_logarithm_of_the_priors_mean(
    model: MeasurementModel,
) -> None:
    """Few particles, so that all of them count: the sum can be done by hand."""
    observation = observation_at(TRUTH)
    rng = np.random.default_rng(2)
    states = PLANAR.moved(np.repeat(TRUTH[None], 40, axis=0), 0.1 * rng.standard_normal((40, 3)))
    log_prior = normalise_log_weights(rng.normal(0.0, 1.0, 40))[0]
    evidence = model.evidence(states, observation)
    exact = math.log(np.sum(np.exp(log_prior + evidence)))
    compressed = math.copysign(COMPRESSED * math.log1p(abs(exact) / COMPRESSED), exact)
    posterior = Belief(states, normalise_log_weights(log_prior + evidence)[0])
    found = model.marginal_evidence(posterior, log_prior, observation)
    assert found == pytest.approx(compressed, abs=1e-6)
    # Any other posterior gives a lower bound, as Jensen's inequality says.
    for power in (0.0, 0.3, 2.0):
        other = Belief(states, normalise_log_weights(log_prior + power * evidence)[0])
        assert model.marginal_evidence(other, log_prior, observation) <= compressed + 1e-9


def test_impossible_particles_have_no_say_in_the_marginal(model: MeasurementModel) -> None:
    observation = observation_at(TRUTH)
    states = np.stack([TRUTH, WRONG])
    log_prior = np.log([0.5, 0.5])
    with np.errstate(divide="ignore"):
        one = Belief(states, np.log(np.array([1.0, 0.0])))
    found = model.marginal_evidence(one, log_prior, observation)
    exact = float(model.evidence(TRUTH[None], observation)[0]) + math.log(0.5)
    assert found == pytest.approx(COMPRESSED * math.log1p(exact / COMPRESSED), abs=1e-6)


def test_what_is_learnt_does_not_depend_on_what_was_asked_before() -> None:
    first, other = model_of(), model_of()
    other.pixels(12)
    np.testing.assert_array_equal(first.pixels(24).table, other.pixels(24).table)
    assert first.pixels(24) is first.pixels(24)
    # What was begun ahead is what is asked for later, and begun once.
    ahead = model_of()
    ahead.learn_pixels([12, 24])
    ahead.learn_pixels([24])
    np.testing.assert_array_equal(ahead.pixels(24).table, first.pixels(24).table)
    np.testing.assert_array_equal(ahead.pixels(12).edges, other.pixels(12).edges)


# --- how much of it is explained ---------------------------------------------------------------


def test_what_is_explained_is_the_evidence_over_that_of_a_right_pose(
    model: MeasurementModel,
) -> None:
    # A little aside, where less is explained than everything.
    state = TRUTH + np.array([0.03, 0.0, 0.0])
    observation = observation_at(TRUTH)
    own, pixels = observation.in_channels(Channels.CONTRAST), model.pixels(24)
    strengths = np.abs(own.image.astype(np.float64) - 128.0).sum(axis=2)
    rows = np.searchsorted(pixels.edges, strengths.reshape(-1), side="right")
    usual = LIKELIHOODS["evidence"].inverse_temperature * np.mean(
        [pixels.expected[row] for row in rows]
    )
    found = float(model.evidence(state[None], observation)[0])
    assert 0.1 < found / usual < 1.0
    assert model.explained(state, observation) == pytest.approx(found / usual, rel=1e-3)


def test_less_is_explained_of_other_contents_and_from_elsewhere_and_never_nothing(
    model: MeasurementModel,
) -> None:
    observation = observation_at(TRUTH)
    hidden = observation.image.copy()
    hidden[4:14, 6:18] = np.random.default_rng(1).uniform(0.0, 255.0, hidden[4:14, 6:18].shape)
    whole = model.explained(TRUTH, observation)
    part = model.explained(TRUTH, changed(observation, hidden))
    aside = model.explained(TRUTH + np.array([0.1, 0.0, 0.0]), observation)
    assert 0.1 < part < whole <= 1.0
    assert aside < 0.7 * whole
    assert model.explained(WRONG, observation) == 0.1
    assert model.explained(BACK_TO_THE_WALL, observation) == 0.1
    # What a mask leaves out need not be explained.
    hidden[4:14, 6:18] = np.nan
    masked = Observation(hidden.astype(np.float32), observation.intrinsics)
    assert model.explained(TRUTH, masked) > 1.3 * part


def test_one_of_the_maps_own_photos_is_explained(model: MeasurementModel) -> None:
    assert model.explained(facing_wall(0.0, 2.0), observation_at(facing_wall(0.0, 2.0))) > 0.9


def test_a_camera_that_sits_elsewhere_shares_the_photos(model: MeasurementModel) -> None:
    raised = base_from_camera_mount((0.1, -0.05, 1.2), (0.0, 3.0, 10.0))
    other = model.mounted(raised)
    observation = observation_at(TRUTH)
    own = MeasurementModel.of_scene(wall_scene(painted), raised, mixture_settings())
    expected = own.evidence(STATES, observation)
    np.testing.assert_array_equal(other.evidence(STATES, observation), expected)
    assert other.renderer is model.renderer
    assert other.pixels(24) is model.pixels(24)
    # The one that it was made of is as it was.
    assert np.array_equal(model.body_from_camera, MOUNT)
    assert not np.array_equal(model.evidence(STATES, observation), expected)
    with pytest.raises(OptionError, match="body_from_camera"):
        model.mounted(np.zeros((4, 4)))
