"""Camera images as the filter sees them: averaged, blind, stale, without what is fixed to it."""

from dataclasses import replace

import numpy as np
import pytest

from pipelines.artifacts.arrays import BoolArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.localize.observation import (
    FEWEST_COMPARED,
    SUBSAMPLING_SHIFTS,
    Observation,
    Observer,
    is_same,
)
from pipelines.render.channels import channel_image
from pipelines.render.choices import Channels
from tests.report_samples import CAMERA, facing_wall, photo

TRUTH = facing_wall(-0.4, 1.7, 0.15)


def test_observing_averages_the_image_and_scales_its_camera() -> None:
    image = photo(TRUTH)
    observation = Observer(CAMERA, [24])(image).by_width[24]
    means = image.reshape(18, 2, 24, 2, 3).astype(np.float64).mean(axis=(1, 3))
    assert np.abs(observation.image - means).max() <= 0.5 + 1e-9
    # Pixel centres at integers: the middle of the image stays the middle.
    assert observation.intrinsics.cx == pytest.approx(11.5)
    assert observation.intrinsics.cy == pytest.approx(8.5)
    assert observation.intrinsics.fx == pytest.approx(12.0)


def test_an_image_that_shows_nothing_is_blind_and_any_other_is_not() -> None:
    observer = Observer(CAMERA, [12, 24])
    generator = np.random.default_rng(0)
    for level in (0, 120, 255):
        noise = generator.normal(0.0, 3.0, (CAMERA.height, CAMERA.width, 3))
        covered = np.clip(level + noise, 0.0, 255.0).astype(np.uint8)
        assert observer(covered).is_blind
    seen = observer(photo(TRUTH))
    assert not seen.is_blind
    assert set(seen.by_width) == {12, 24}
    assert seen.contrast == pytest.approx(seen.by_width[12].image.mean(axis=2).std(), rel=1e-6)


# --- one pixel in so many -----------------------------------------------------------------------


def kept(number: int, one_in: int, height: int, width: int) -> BoolArray:
    """Which pixels of an image remain."""
    image = np.ones((height, width, 3), dtype=np.float32)
    observation = Observation(image, CAMERA.intrinsics, number)
    return np.asarray(~np.isnan(observation.subsampled(one_in)).any(axis=2))


@pytest.mark.parametrize("one_in", SUBSAMPLING_SHIFTS)
def test_pixels_take_turns_and_are_spread_over_rows_and_columns(one_in: int) -> None:
    masks = np.array([kept(number, one_in, 30, 40) for number in range(7, 7 + one_in)])
    np.testing.assert_array_equal(masks.sum(axis=0), 1)
    for mask in masks:
        for axis, size in ((0, 30), (1, 40)):
            counts = mask.sum(axis=axis)
            assert counts.max() - counts.min() <= 1
            assert abs(counts.mean() - size / one_in) < 1e-9
        # No two that remain are neighbours.
        assert one_in == 1 or not (mask[:, 1:] & mask[:, :-1]).any()
        assert one_in == 1 or not (mask[1:] & mask[:-1]).any()


@pytest.mark.parametrize(("width", "step"), [(20, 1), (28, 2), (36, 3), (40, 5)])
def test_enough_pixels_remain(width: int, step: int) -> None:
    height = 3 * width // 4
    remaining = kept(3, 5, height, width).sum()
    assert remaining == pytest.approx(height * width / step, rel=0.01)
    assert remaining >= FEWEST_COMPARED


def test_images_are_counted_and_what_is_fixed_stays_left_out() -> None:
    observer = Observer(CAMERA, [24])
    numbers = [observer(taped(photo(state))).by_width[24].number for state in WAY]
    assert numbers == list(range(len(WAY)))
    image = np.ones((34, 40, 3), dtype=np.float32)
    image[:4] = np.nan
    remaining = ~np.isnan(Observation(image, CAMERA.intrinsics).subsampled(5)[..., 0])
    assert not remaining[:4].any()
    np.testing.assert_array_equal(remaining[4:], kept(0, 5, 34, 40)[4:])
    # A row less, and a fifth of what is left would be too few.
    image[4] = np.nan
    remaining = ~np.isnan(Observation(image, CAMERA.intrinsics).subsampled(5)[..., 0])
    assert remaining.sum() >= FEWEST_COMPARED
    np.testing.assert_array_equal(remaining[5:], kept(0, 3, 34, 40)[5:])


# --- what is fixed to the camera ---------------------------------------------------------------

# Tape over the left third of the lens's lower half.
TAPE = (slice(18, 36), slice(0, 16))
WAY = [facing_wall(-1.0 + 0.3 * i, 1.5, 0.1 * i - 0.3) for i in range(7)]


def taped(image: ImageArray) -> ImageArray:
    hidden = image.copy()
    hidden[TAPE] = (120, 110, 90)
    return hidden


def test_tape_on_the_lens_is_left_out_after_a_few_images() -> None:
    observer = Observer(CAMERA, [12, 24])
    seen = [observer(taped(photo(state))) for state in WAY]
    assert not np.isnan(seen[0].by_width[24].image).any()
    hidden = np.isnan(seen[-1].by_width[24].image[..., 0])
    # All of the tape, half a pixel of its border, and nothing else.
    assert hidden[10:, :7].all()
    assert not hidden[:8].any()
    assert not hidden[:, 10:].any()
    # Said once, when it is found out.
    assert [observations.is_newly_masked for observations in seen].count(True) == 1
    found = [bool(np.isnan(observations.by_width[12].image).any()) for observations in seen]
    assert found == sorted(found)
    assert found.index(True) == [observations.is_newly_masked for observations in seen].index(True)


def test_without_tape_nothing_is_left_out() -> None:
    observer = Observer(CAMERA, [12, 24])
    for state in WAY:
        observations = observer(photo(state))
        assert not observations.is_newly_masked
        assert not np.isnan(observations.by_width[24].image).any()


def test_a_robot_that_stands_still_keeps_all_its_pixels() -> None:
    observer = Observer(CAMERA, [24])
    for _ in range(8):
        observations = observer(taped(photo(TRUTH)))
        assert not np.isnan(observations.by_width[24].image).any()


def test_black_images_in_between_do_not_count() -> None:
    plain, interrupted = Observer(CAMERA, [24]), Observer(CAMERA, [24])
    black = np.zeros((CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    for state in WAY:
        expected = plain(taped(photo(state))).by_width[24].image
        assert interrupted(black).is_blind
        found = interrupted(taped(photo(state))).by_width[24].image
        np.testing.assert_array_equal(found, expected)


# --- the same image again ----------------------------------------------------------------------


def noisy(image: ImageArray, seed: int, sigma: float = 1.0) -> ImageArray:
    """The same scene once more, as a sensor sees it."""
    noise = sigma * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(np.rint(image + noise), 0.0, 255.0).astype(np.uint8)


def test_the_same_image_is_told_from_the_same_scene_and_from_the_next() -> None:
    image = photo(TRUTH)
    assert is_same(image, image.copy())
    # A clock in the corner of the picture, or one bit of a decoder, makes no other image.
    stamped = image.copy()
    stamped[0, :2] = 255
    assert is_same(stamped, image)
    assert is_same(np.clip(image.astype(int) + 1, 0, 255).astype(np.uint8), image)
    assert not is_same(noisy(image, 0), noisy(image, 1))
    assert not is_same(photo(TRUTH + np.array([0.03, 0.0, 0.0])), image)
    assert not is_same(image[:-1], image)


def test_repetition_is_that_of_the_image_before() -> None:
    observer = Observer(CAMERA, [24])
    first, second = photo(WAY[0]), photo(WAY[1])
    images = (first, first, second, first, first, first)
    found = [observer(image).is_repeated for image in images]
    assert found == [False, True, False, False, True, True]


def test_a_camera_that_fills_one_array_again_and_again_does_not_hang() -> None:
    observer = Observer(CAMERA, [24])
    frame = np.empty((CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    found = []
    for state in WAY:
        frame[:] = photo(state)
        found.append(observer(frame).is_repeated)
    assert found == [False] * len(WAY)


def test_an_image_that_was_refused_is_not_remembered() -> None:
    observer = Observer(CAMERA, [24])
    image = photo(TRUTH)
    observer(image)
    with pytest.raises(OptionError):
        observer(image[:10])
    assert observer(image).is_repeated


def test_only_a_blind_or_a_stale_image_says_nothing() -> None:
    seen = Observer(CAMERA, [24])(photo(TRUTH))
    assert seen.is_informative
    assert replace(seen, is_repeated=True).is_informative
    assert not replace(seen, is_repeated=True, is_stale=True).is_informative
    assert not replace(seen, contrast=0.0).is_informative


# --- in channels -------------------------------------------------------------------------------


def test_channels_leave_out_what_the_image_leaves_out_and_do_not_see_it() -> None:
    generator = np.random.default_rng(2)
    image = generator.uniform(0.0, 255.0, (18, 24, 3)).astype(np.float32)
    hidden = generator.uniform(size=(18, 24)) < 0.2
    image[hidden] = np.nan
    observation = Observation(image, CAMERA.intrinsics, 3)
    assert observation.in_channels(Channels.COLOUR) is observation
    for channels in set(Channels) - {Channels.COLOUR}:
        found = observation.in_channels(channels)
        np.testing.assert_array_equal(found.used, ~hidden)
        assert np.isfinite(found.image[~hidden]).all()
        assert (found.number, found.intrinsics) == (3, CAMERA.intrinsics)
        other = np.where(hidden[..., None], 0.0, image)
        expected = channel_image(other.astype(np.float32), channels, ~hidden)
        np.testing.assert_array_equal(found.image[~hidden], expected[~hidden])
        # Made once, and the colours stay.
        assert observation.in_channels(channels) is found
    np.testing.assert_array_equal(np.isnan(observation.image[..., 0]), hidden)
