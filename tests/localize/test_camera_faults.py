"""Pictures that are mirrored, upside down or negative are told from right ones, by the map."""

from collections.abc import Callable

import numpy as np
import pytest

from pipelines.artifacts.arrays import Float32Array
from pipelines.geometry.camera import Intrinsics
from pipelines.localize.camera_faults import FAULTS, FIRST_LOG_ODDS, MOST_LOG_ODDS, CameraFaults
from pipelines.localize.observation import Observation, Observations
from pipelines.localize.places import COMPRESSED
from tests.report_samples import photo
from tests.sequence_samples import SCENE, TRUTH, localize_sequence, localizer, mixture_settings

PINHOLE = Intrinsics(4, 3, 2.0, 2.0, 1.5, 1.0)
PICTURE = np.random.default_rng(0).uniform(0.0, 255.0, (3, 4, 3)).astype(np.float32)
PICTURE[0, 1] = np.nan


def seen(picture: Float32Array) -> Observations:
    return Observations({4: Observation(picture, PINHOLE, 7)}, contrast=50.0)


def looks_like(wanted: Float32Array, most: float) -> Callable[[Observations], float]:
    """A map in which only one picture is found."""

    def evidence(observations: Observations) -> float:
        image = observations.by_width[4].image
        return most if np.array_equal(image, wanted, equal_nan=True) else -3.0

    return evidence


PICTURES: dict[str, Float32Array] = {
    "mirrored": np.flip(PICTURE, 1),
    "upside down": np.rot90(PICTURE, 2),
    "mirrored and upside down": np.flip(PICTURE, 0),
    "negative": np.float32(255.0) - PICTURE,
}


@pytest.mark.parametrize("fault", sorted(FAULTS))
def test_the_way_round_that_the_map_shows_is_found(fault: str) -> None:
    faults, evidence = CameraFaults(), looks_like(PICTURES[fault], 20.0)
    gain = COMPRESSED * np.log(1.0 + 20.0 / COMPRESSED)
    first = faults.updated(evidence, seen(PICTURE))
    assert first.log_odds[fault] == pytest.approx(FIRST_LOG_ODDS + gain)
    # What no way round shows leaves the odds as they are: less than nothing is not counted.
    assert {first.log_odds[name] for name in FAULTS if name != fault} == {FIRST_LOG_ODDS}
    for _ in range(9):
        first = first.updated(evidence, seen(PICTURE))
    assert first.likeliest == fault
    assert first.log_odds[fault] == MOST_LOG_ODDS
    odds = np.exp(MOST_LOG_ODDS) + 3.0 * np.exp(FIRST_LOG_ODDS)
    assert first.none == pytest.approx(1.0 / (1.0 + odds))
    # It was another camera's picture all the time: that can be learnt, too.
    right = looks_like(PICTURE, 20.0)
    for _ in range(9):
        first = first.updated(right, seen(PICTURE))
    assert set(first.log_odds.values()) == {-MOST_LOG_ODDS}
    assert first.none > 0.99


def test_before_the_first_image_the_picture_is_probably_right() -> None:
    assert CameraFaults().none == pytest.approx(1.0 / (1.0 + 4.0 * np.exp(FIRST_LOG_ODDS)))


def test_a_filter_whose_camera_is_upside_down_does_not_claim_a_place() -> None:
    """Nor one whose pictures are mirrored or negative: ``test_strange_images.py``."""
    images = [np.rot90(photo(state), 2).copy() for state in TRUTH]
    records = localize_sequence(localizer(mixture_settings(), 0, SCENE), images=images)
    assert "tracking" not in [record.status for record in records]
    assert max(record.confidence for record in records) < 0.5
