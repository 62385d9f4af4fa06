"""What one image decides between places: against Bayes' rule, sums by hand, and bounds."""

import math

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import StageError
from pipelines.localize.places import (
    COMPRESSED,
    JOINED_POSITION,
    PLACE_ANGLE,
    PLACE_POSITION,
    PlaceWeighting,
    compressed,
    log_priors,
    place_labels,
    places_of,
    weighted_by_place,
)
from pipelines.localize.state_space import PLANAR, SPATIAL, StateSpace

evidences = st.floats(-400.0, 400.0)


def shares_of(log_weights: FloatArray, labels: IntArray) -> FloatArray:
    """The places' shares of the weight, by label."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(np.bincount(labels, weights) / weights.sum())


def prior_shares(prior: FloatArray, labels: IntArray) -> FloatArray:
    """Logarithms ``(4,)`` of what the particles hold of each place before the image."""
    result = np.zeros(4)
    for place in np.unique(labels[labels > 0]):
        result[place] = logarithm_of_sum(prior[labels == place])
    return result


def weigh(prior: FloatArray, evidence: FloatArray, labels: IntArray) -> PlaceWeighting:
    """With places whose prior is what the particles hold of them."""
    return weighted_by_place(prior, evidence, labels, prior_shares(prior, labels))


def labels_of(space: StateSpace, states: FloatArray, hypotheses: FloatArray) -> IntArray:
    return place_labels(space, states, hypotheses, places_of(space, hypotheses))


# --- compression -------------------------------------------------------------------------------


@given(evidences, evidences)
def test_compression_keeps_order_and_sign_and_never_says_more(first: float, second: float) -> None:
    a, b = float(compressed(first)), float(compressed(second))
    assert abs(a) <= abs(first) * (1.0 + 1e-12)
    assert math.copysign(1.0, a) == math.copysign(1.0, first) or a == 0.0
    assert float(compressed(-first)) == -a
    if first < second:
        assert a <= b


def test_little_evidence_is_kept_and_much_of_it_counts_as_its_logarithm() -> None:
    small = np.linspace(-0.01, 0.01, 7)
    np.testing.assert_allclose(compressed(small), small, rtol=2e-3)
    # A thousand times the evidence says a constant more.
    much = compressed(np.array([1e5, 1e8, 1e11]))
    np.testing.assert_allclose(np.diff(much), COMPRESSED * math.log(1000.0), rtol=1e-3)


# --- weights -----------------------------------------------------------------------------------


@st.composite
def beliefs(draw: st.DrawFn, largest: float) -> tuple[FloatArray, FloatArray, IntArray]:
    """Log-weights before an image, its evidence, and places."""
    count = draw(st.integers(1, 40))
    prior = draw(arrays(np.float64, count, elements=st.floats(-8.0, 0.0)))
    evidence = draw(arrays(np.float64, count, elements=st.floats(-largest, largest)))
    labels = draw(arrays(np.int64, count, elements=st.integers(0, 3)))
    return prior - np.log(np.exp(prior).sum()), evidence, labels


def in_places(labels: IntArray) -> IntArray:
    """Particles in no place are one, where there is no other."""
    return labels if np.any(labels > 0) else np.ones_like(labels)


def logarithm_of_sum(values: FloatArray) -> float:
    top = float(values.max())
    return top + math.log(float(np.exp(values - top).sum()))


def squeezed(evidence: float) -> float:
    return math.copysign(COMPRESSED * math.log(1.0 + abs(evidence) / COMPRESSED), evidence)


@given(beliefs(0.004))
def test_small_evidence_gives_the_weights_of_bayes(
    case: tuple[FloatArray, FloatArray, IntArray],
) -> None:
    prior, evidence, labels = case
    found = weigh(prior, evidence, labels)
    np.testing.assert_allclose(found.log_weights, prior + evidence, atol=1e-5)
    own = in_places(labels) > 0
    expected = math.log(np.sum(np.exp((prior + evidence)[own])))
    # Where most of the prior is in no place, that is not small.
    assert found.marginal == pytest.approx(squeezed(expected), abs=1e-5)


@given(beliefs(300.0))
def test_within_a_place_weights_are_those_of_bayes(
    case: tuple[FloatArray, FloatArray, IntArray],
) -> None:
    prior, evidence, labels = case
    log_weights = weigh(prior, evidence, labels).log_weights
    for place in np.unique(labels):
        own = labels == place
        expected = (prior + evidence)[own]
        np.testing.assert_allclose(
            log_weights[own] - log_weights[own].max(), expected - expected.max(), atol=1e-6
        )


@given(beliefs(300.0), st.integers(0, 3))
def test_with_one_place_all_is_bayes_rule_and_only_the_marginal_compressed(
    case: tuple[FloatArray, FloatArray, IntArray], place: int
) -> None:
    prior, evidence, labels = case
    found = weigh(prior, evidence, np.full_like(labels, place))
    exact = logarithm_of_sum(prior + evidence)
    np.testing.assert_allclose(
        found.log_weights - logarithm_of_sum(found.log_weights), prior + evidence - exact, atol=1e-6
    )
    assert found.marginal == pytest.approx(squeezed(exact), abs=1e-6)


@given(beliefs(300.0))
def test_a_place_loses_what_its_evidence_loses_by_being_compressed(
    case: tuple[FloatArray, FloatArray, IntArray],
) -> None:
    prior, evidence, labels = case
    found = weigh(prior, evidence, labels)
    exact, shares = prior + evidence, prior_shares(prior, labels)
    kept, loss = {}, {}
    for place in np.unique(in_places(labels)):
        own = in_places(labels) == place
        before = shares[place] if np.any(labels > 0) else 0.0
        mean = logarithm_of_sum(exact[own]) - before
        kept[place], loss[place] = squeezed(mean), mean - squeezed(mean)
    if 0 in kept:
        # On the slopes of the best place, or where nothing is seen: worth as much less as that one.
        del kept[0]
        loss[0] = loss[max(kept, key=lambda place: kept[place])]
    for place, of_place in loss.items():
        own = in_places(labels) == place
        np.testing.assert_allclose(exact[own] - found.log_weights[own], of_place, atol=1e-6)
    assert found.largest == pytest.approx(max(kept.values()), abs=1e-6)
    total = logarithm_of_sum(exact[in_places(labels) > 0])
    assert found.marginal == pytest.approx(squeezed(total), abs=1e-6)


@given(beliefs(300.0), st.permutations(range(1, 4)))
def test_names_of_places_and_the_order_of_particles_do_not_matter(
    case: tuple[FloatArray, FloatArray, IntArray], names: list[int]
) -> None:
    prior, evidence, labels = case
    found = weigh(prior, evidence, labels)
    named = weigh(prior, evidence, np.array([0, *names])[labels])
    backwards = weigh(prior[::-1], evidence[::-1], labels[::-1])
    np.testing.assert_allclose(named.log_weights, found.log_weights, atol=1e-9)
    np.testing.assert_allclose(backwards.log_weights[::-1], found.log_weights, atol=1e-9)
    for other in (named, backwards):
        assert other.marginal == pytest.approx(found.marginal, abs=1e-9)
        assert other.largest == pytest.approx(found.largest, abs=1e-9)


@given(beliefs(300.0), st.data())
def test_several_particles_at_one_state_count_as_one_with_all_their_weight(
    case: tuple[FloatArray, FloatArray, IntArray], data: st.DataObject
) -> None:
    prior, evidence, labels = case
    times = data.draw(arrays(np.int64, len(prior), elements=st.integers(1, 5)))
    found = weigh(prior, evidence, labels)
    split = weigh(
        np.repeat(prior - np.log(times), times),
        np.repeat(evidence, times),
        np.repeat(labels, times),
    )
    together = np.repeat(found.log_weights - np.log(times), times)
    np.testing.assert_allclose(split.log_weights, together, atol=1e-6)
    assert split.marginal == pytest.approx(found.marginal, abs=1e-6)
    assert split.largest == pytest.approx(found.largest, abs=1e-6)


@pytest.mark.parametrize("evidence", [10.0, 60.0, 400.0])
def test_one_image_changes_the_odds_of_places_no_more_than_compressed_and_several_do(
    evidence: float,
) -> None:
    labels = np.array([1, 1, 2, 2, 2])
    prior = np.log(np.array([0.2, 0.3, 0.1, 0.2, 0.2]))
    gains = np.where(labels == 1, evidence, 0.0)
    log_weights = weigh(prior, gains, labels).log_weights
    shares = shares_of(log_weights, labels)
    power = COMPRESSED * math.log(1.0 + evidence / COMPRESSED)
    assert math.log(shares[1] / shares[2]) == pytest.approx(power, rel=1e-9)
    # The same again and again adds up.
    for _ in range(4):
        before = log_weights - np.log(np.exp(log_weights).sum())
        log_weights = weigh(before, gains, labels).log_weights
    shares = shares_of(log_weights, labels)
    assert math.log(shares[1] / shares[2]) == pytest.approx(5.0 * power, rel=1e-6)


def test_the_marginal_is_the_integral_over_a_grid() -> None:
    """One place, a Gaussian prior and a Gaussian bump of evidence, by particles and by the grid."""
    sigma, width, height = 0.4, 0.15, 3.0

    def evidence(x: FloatArray) -> FloatArray:
        return np.asarray(height * np.exp(-0.5 * (x / width) ** 2) - 1.0)

    grid = np.linspace(-4.0, 4.0, 20_001)
    density = np.exp(-0.5 * (grid / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
    exact = math.log(np.trapezoid(density * np.exp(evidence(grid)), grid))
    x = sigma * np.random.default_rng(0).standard_normal(200_000)
    prior, labels = np.full(len(x), -math.log(len(x))), np.zeros(len(x), dtype=np.int64)
    marginal = weigh(prior, evidence(x), labels).marginal
    assert marginal == pytest.approx(COMPRESSED * math.log(1.0 + exact / COMPRESSED), abs=0.01)
    # Drawn from elsewhere and weighted for it, particles say the same.
    y = np.random.default_rng(1).uniform(-1.5, 1.5, 200_000)
    log_density = -0.5 * (y / sigma) ** 2 - math.log(sigma * math.sqrt(2.0 * math.pi))
    drawn = log_density + math.log(3.0) - math.log(len(y))
    other = weigh(drawn, evidence(y), labels).marginal
    assert other == pytest.approx(marginal, abs=0.02)


def test_places_that_are_impossible_have_no_weight_and_no_say() -> None:
    labels = np.array([0, 1, 1, 2])
    prior = np.log(np.array([0.25, 0.25, 0.25, 0.25]))
    evidence = np.array([-np.inf, 1.0, -np.inf, 0.5])
    found = weigh(prior, evidence, labels)
    np.testing.assert_array_equal(np.isneginf(found.log_weights), [True, False, True, False])
    # What is impossible has its share of the prior all the same.
    assert found.marginal == pytest.approx(squeezed(math.log(0.25 * math.e + 0.25 * math.e**0.5)))
    assert found.largest == pytest.approx(squeezed(0.5))
    none = weigh(prior, np.full(4, -np.inf), labels)
    assert np.isneginf(none.log_weights).all()
    assert none.marginal == none.largest == -math.inf


def test_a_wide_prior_costs_a_place_its_volume_and_is_not_compressed() -> None:
    """The same evidence for two places, one a hundred times likelier before the image."""
    labels = np.array([1, 2])
    prior = np.log(np.array([0.5, 0.005]))
    found = weigh(prior, np.full(2, 40.0), labels).log_weights
    assert found[0] - found[1] == pytest.approx(math.log(100.0))


def test_a_places_prior_is_its_density_times_its_volume_at_most_one() -> None:
    hypotheses = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [3.0, 0.0, 0.0]])
    places = places_of(PLANAR, hypotheses)
    densities = np.log(np.array([0.002, 0.004, 50.0]))
    found = log_priors(PLANAR, densities, places)
    volume = math.pi * PLACE_POSITION**2 * 2.0 * PLACE_ANGLE
    assert found[0] == 0.0
    assert found[places[0]] == pytest.approx(math.log(0.004 * volume))
    assert found[places[2]] == 0.0
    spatial = log_priors(SPATIAL, np.log(np.array([0.01])), np.array([1]))
    balls = (4.0 / 3.0 * math.pi) ** 2 * PLACE_POSITION**3 * PLACE_ANGLE**3
    assert spatial[1] == pytest.approx(math.log(0.01 * balls))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_broken_comparison_is_an_error_and_no_place_without_weight(value: float) -> None:
    evidence = np.array([0.0, value, 1.0, 1.0])
    with pytest.raises(StageError, match="1 of 4 log-likelihoods"):
        weigh(np.full(4, -math.log(4.0)), evidence, np.array([0, 0, 1, 1]))


# --- labels ------------------------------------------------------------------------------------


def test_states_belong_to_the_hypotheses_near_them() -> None:
    hypotheses = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    states = np.array(
        [
            [0.05, 0.02, 0.0],
            [-0.3, 0.0, 0.05],
            [3.1, 0.1, -0.1],
            [0.0, 0.0, 2.1],
            [0.0, 0.0, 1.0],  # turned between two
            [9.0, 9.0, 0.0],
        ]
    )
    labels = labels_of(PLANAR, states, hypotheses)
    # The first two hypotheses are one place; what is near none is a place of its own.
    assert labels[0] == labels[1] != 0
    assert len({int(labels[0]), int(labels[2]), int(labels[3]), 0}) == 4
    assert labels[4] == labels[5] == 0


def test_hypotheses_chain_and_headings_go_round() -> None:
    chain = np.array([[0.2 * i, 0.0, math.pi - 0.02] for i in range(9)])
    states = np.array([[0.0, 0.0, -math.pi + 0.05], [1.6, 0.0, math.pi - 0.05]])
    labels = labels_of(PLANAR, states, chain)
    assert labels[0] == labels[1] != 0


def test_without_hypotheses_all_states_are_one_place() -> None:
    labels = labels_of(PLANAR, np.zeros((5, 3)), np.empty((0, 3)))
    np.testing.assert_array_equal(labels, 0)


def test_labels_in_six_dimensions() -> None:
    hypotheses = np.array([[0.0] * 6, [0.0, 0.0, 0.0, 0.0, 0.0, 1.5]])
    states = SPATIAL.moved(
        np.repeat(hypotheses, 20, axis=0),
        0.02 * np.random.default_rng(3).standard_normal((40, 6)),
    )
    labels = labels_of(SPATIAL, states, hypotheses)
    assert len(set(labels[:20])) == len(set(labels[20:])) == 1
    assert labels[0] != labels[20]
    assert 0 not in labels


@given(arrays(np.float64, st.integers(1, 30), elements=st.floats(0.0, 5.0)))
def test_places_are_chains_of_near_hypotheses_numbered_as_they_come(xs: FloatArray) -> None:
    hypotheses = np.column_stack([xs, np.zeros((len(xs), 2))])
    near = np.abs(xs[:, None] - xs[None, :]) <= JOINED_POSITION
    _, expected = scipy.sparse.csgraph.connected_components(scipy.sparse.coo_array(near))
    np.testing.assert_array_equal(places_of(PLANAR, hypotheses), expected + 1)
