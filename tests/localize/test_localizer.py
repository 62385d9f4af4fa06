"""The particle filter in front of a painted wall whose views are true by construction."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Undistorter
from pipelines.geometry.pose import world_from_base_planar, wrap_angle
from pipelines.localize.likelihood import likelihood_named
from pipelines.localize.localizer import Localizer
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.renderer import Renderer
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo
from tests.sequence_samples import (
    BLACK,
    PERIOD,
    SCENE,
    START,
    TRUTH,
    content,
    heading_error,
    increments,
    localize_sequence,
    localizer,
    mixture_settings,
    paper_settings,
    periodic_scene,
    position_error,
    search_settings,
)

every_strategy = pytest.mark.parametrize(
    "make", [mixture_settings, search_settings, paper_settings]
)


# --- the same seed, the same numbers -----------------------------------------------------------


@every_strategy
def test_a_seed_determines_every_record_whatever_the_threads(make: Any) -> None:
    first = [content(record) for record in localize_sequence(localizer(make(), seed=3))]
    again = [content(record) for record in localize_sequence(localizer(make(), seed=3))]
    threads = [content(record) for record in localize_sequence(localizer(make(threads=2), seed=3))]
    assert first == again
    assert first == threads


@every_strategy
def test_another_seed_gives_other_particles(make: Any) -> None:
    first, other = (localize_sequence(localizer(make(), seed=seed), TRUTH[:2]) for seed in (3, 4))
    for record, another in zip(first, other, strict=True):
        assert not np.any(np.isin(record.particles[:, 0], another.particles[:, 0]))


# --- the paper's filter ------------------------------------------------------------------------


def paper_filter(chosen: LocalizerSettings, seed: int) -> list[tuple[FloatArray, FloatArray]]:
    """Particles and log-weights of each frame by the paper's steps, written down once more.

    Nothing of ``pipelines.localize`` is used here but its numbers; the renderer's costs are not
    what is tested.
    """
    rng = np.random.default_rng(seed)
    renderer = Renderer.of_scene(SCENE, 4 * chosen.fine_width, chosen.blending, threads=1)
    count, noise = chosen.particles, chosen.motion
    x_min, x_max, y_min, y_max = SCENE.bounds
    low, high = np.array([x_min, y_min, -np.pi]), np.array([x_max, y_max, np.pi])
    states = low + (high - low) * rng.random((count, 3))
    states[:, 2] = wrap_angle(states[:, 2])
    log_weights = np.full(count, -np.log(count))
    frames: list[tuple[FloatArray, FloatArray]] = []
    for number, true_state in enumerate(TRUTH):
        if number > 0:
            # Draw with probability proportional to weight, each draw on its own.
            weights = np.exp(log_weights - np.max(log_weights))
            sums = np.cumsum(weights)
            drawn = states[np.searchsorted(sums, rng.random(count) * sums[-1], side="right")]
            # Move each by odometry and noise.
            forward, left, turn = increments(TRUTH)[number]
            driven = forward * forward + left * left
            along = noise.alpha3 * driven + noise.alpha4 * turn * turn + noise.position_floor**2
            about = noise.alpha1 * turn * turn + noise.alpha2 * driven + noise.heading_floor**2
            spread = np.array([np.sqrt(along), np.sqrt(along), np.sqrt(about)])
            move = np.array([forward, left, turn]) + spread * rng.standard_normal((count, 3))
            cosine, sine = np.cos(drawn[:, 2]), np.sin(drawn[:, 2])
            states = np.stack(
                [
                    drawn[:, 0] + cosine * move[:, 0] - sine * move[:, 1],
                    drawn[:, 1] + sine * move[:, 0] + cosine * move[:, 1],
                    wrap_angle(drawn[:, 2] + move[:, 2]),
                ],
                axis=1,
            )
        # Weight with the likelihood of the image, normalise.
        image, pinhole = photo(true_state), CAMERA.intrinsics.resized(24, 18)
        query = np.rint(image.reshape(18, 2, 24, 2, 3).mean(axis=(1, 3)) + 1e-9)
        costs = renderer.costs(
            world_from_base_planar(states) @ MOUNT,
            pinhole,
            query.astype(np.uint8),
            chosen.likelihood.cost,
            chosen.likelihood.fit_gain,
        )
        log_weights = np.full(count, -np.log(count)) - chosen.likelihood.inverse_temperature * costs
        log_weights = log_weights - np.max(log_weights)
        log_weights = log_weights - np.log(np.sum(np.exp(log_weights)))
        frames.append((states, log_weights))
    return frames


@pytest.mark.parametrize("seed", range(3))
def test_condensation_does_exactly_the_steps_of_the_paper(seed: int) -> None:
    chosen = paper_settings(particles=150)
    records = localize_sequence(localizer(chosen, seed))
    expected = paper_filter(chosen, seed)
    for record, (states, log_weights) in zip(records, expected, strict=True):
        np.testing.assert_array_equal(record.particles, states)
        np.testing.assert_array_equal(record.log_weights, log_weights)
        heaviest = states[int(np.argmax(log_weights))]
        # None is given where the image more probably shows something else.
        if record.status != "lost":
            np.testing.assert_array_equal(record.estimates["max_weight"], heaviest)


def test_condensation_keeps_the_number_of_particles_and_the_width() -> None:
    records = localize_sequence(localizer(paper_settings(particles=77)))
    assert [len(record.particles) for record in records] == [77] * len(TRUTH)


def test_condensation_tracks_from_a_pose() -> None:
    chosen = paper_settings(particles=195, start=START, start_position_sigma=0.15)
    for seed in range(5):
        last = localize_sequence(localizer(chosen, seed))[-1]
        assert position_error(last, TRUTH[-1], "max_weight") < 0.15
        assert heading_error(last, TRUTH[-1], "max_weight") < math.radians(6.0)


# --- the search --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_the_robot_is_found_anywhere_and_tracked(seed: int) -> None:
    records = localize_sequence(localizer(search_settings(), seed))
    assert records[0].status == "global"
    words = [record.status for record in records]
    found = words.index("tracking")
    assert words == ["global"] * found + ["tracking"] * (len(words) - found)
    assert found <= 4
    counts = [len(record.particles) for record in records]
    assert counts[0] == 2000
    assert counts == sorted(counts, reverse=True)
    for record, truth in zip(records[-3:], TRUTH[-3:], strict=True):
        for estimate in ("mode", "mean"):
            assert position_error(record, truth, estimate) < 0.1
            assert heading_error(record, truth, estimate) < math.radians(4.0)
    assert records[-1].confidence > 0.5
    assert records[0].confidence < 0.1


def test_the_covariance_covers_the_error() -> None:
    for seed in range(3):
        last = localize_sequence(localizer(search_settings(), seed))[-1]
        error = last.estimates["mode"] - TRUTH[-1]
        assert error @ np.linalg.solve(last.covariance, error) < 25.0


@every_strategy
def test_a_record_says_what_it_is_about(make: Any) -> None:
    record = localize_sequence(localizer(make()), TRUTH[:2])[-1]
    np.testing.assert_array_equal(record.belief.states, record.particles)
    assert record.image_name == "1.png"
    assert record.timestamp == 1.0
    assert {"prepare", "filter", "estimate"} == set(record.seconds)
    assert min(record.seconds.values()) >= 0.0


@every_strategy
def test_the_motion_before_the_first_image_is_not_used(make: Any) -> None:
    image = photo(TRUTH[0])
    without = localizer(make()).step(image)
    ignored = localizer(make()).step(image, np.array([5.0, 5.0, 1.0]))
    assert content(without) == content(ignored)


@pytest.mark.parametrize("make", [mixture_settings, search_settings])
@pytest.mark.parametrize("motion", [np.zeros(3), None], ids=["stands still", "unknown"])
def test_a_robot_that_stands_still_is_found_too(make: Any, motion: FloatArray | None) -> None:
    truth = np.repeat(TRUTH[2:3], 8, axis=0)
    robot = localizer(make(), 1)
    records = [robot.step(photo(state), motion) for state in truth]
    assert records[-1].status == "tracking"
    assert position_error(records[-1], truth[-1]) < 0.1


# --- two places that look the same -------------------------------------------------------------


@pytest.mark.parametrize(
    "chosen",
    [
        # As many as by default: with fewer, chance lets one of the places win.
        mixture_settings(particles=LocalizerSettings().particles, start_particles=4000),
        search_settings(particles=400, start_particles=4000),
    ],
    ids=["mixture", "coarse_to_fine"],
)
def test_two_equal_places_stay_two_answers(chosen: LocalizerSettings) -> None:
    truth = TRUTH[:5] - np.array([2.0, 0.0, 0.0])
    twin = truth + np.array([PERIOD, 0.0, 0.0])
    scene = periodic_scene()
    for seed in range(2):
        last = localize_sequence(localizer(chosen, seed, scene), truth)[-1]
        assert last.status == "global"
        assert len(last.modes) >= 2
        assert last.modes[:2, 3].min() > 0.15
        places = [truth[-1, 0], twin[-1, 0]]
        np.testing.assert_allclose(sorted(last.modes[:2, 0]), places, atol=0.15)
        # Nearly half of the weight lies elsewhere, and the confidence says so.
        assert last.confidence < 0.8


# --- nothing to go by --------------------------------------------------------------------------


@every_strategy
def test_behind_a_covered_lens_odometry_carries_the_estimates(make: Any) -> None:
    images = [photo(state) for state in TRUTH[:4]] + [BLACK] * 3 + [photo(TRUTH[7])]
    chosen = make(start=START, start_position_sigma=0.1)
    records = localize_sequence(localizer(chosen), TRUTH, images)
    # Particles that nothing aligned explain the first image tolerably; the second confirms it.
    assert records[0].status in ("global", "tracking")
    assert [record.status for record in records[1:4]] == ["tracking"] * 3
    for record, truth in zip(records[4:7], TRUTH[4:7], strict=True):
        assert record.status == "blind"
        assert record.confidence == 0.0
        assert set(record.estimates) == {"max_weight", "mean", "mode"}
        assert record.refined_covariance is None
        assert position_error(record, truth, "mean") < 0.15
        assert len(record.particles) == 60
    # Nothing corrects odometry: its noise adds up.
    spreads = [np.trace(record.covariance[:2, :2]) for record in records[3:7]]
    assert spreads == sorted(spreads)
    assert records[7].status == "tracking"
    assert position_error(records[7], TRUTH[7]) < 0.3


@every_strategy
def test_black_images_from_the_start_never_claim_to_track(make: Any) -> None:
    records = localize_sequence(localizer(make()), TRUTH, [BLACK] * len(TRUTH))
    assert {record.status for record in records} == {"blind"}
    assert max(record.confidence for record in records) == 0.0


@every_strategy
def test_a_known_start_and_black_images_are_blind_and_not_tracked(make: Any) -> None:
    record = localizer(make(start=START)).step(BLACK)
    assert record.status == "blind"
    assert record.confidence == 0.0


@every_strategy
def test_a_camera_that_hangs_is_stale_once_odometry_moves(make: Any) -> None:
    images = [photo(state) for state in TRUTH[:4]] + [photo(TRUTH[3])] * 3 + [photo(TRUTH[7])]
    records = localize_sequence(
        localizer(make(start=START, start_position_sigma=0.1)), TRUTH, images
    )
    assert "stale" not in {record.status for record in records[:4]}
    for record, truth in zip(records[4:7], TRUTH[4:7], strict=True):
        assert record.status == "stale"
        assert record.confidence == 0.0
        assert record.refined_covariance is None
        # Odometry carries the estimate, the old image does not hold it back.
        assert position_error(record, truth, "mean") < 0.2
    assert records[7].status != "stale"
    assert position_error(records[7], TRUTH[7]) < 0.3


@every_strategy
def test_the_same_image_of_a_robot_that_stands_still_is_not_stale(make: Any) -> None:
    robot = localizer(make(start=START, start_position_sigma=0.1))
    image, nothing = photo(TRUTH[0]), np.zeros(3)
    words = {robot.step(image, motion).status for motion in (None, nothing, nothing, None, None)}
    assert "stale" not in words
    # Steps too small to be seen add up; turning counts as well.
    for step in ([0.004, 0.0, 0.0], [0.0, 0.0, 0.003]):
        found = [robot.step(image, np.array(step)).status for _ in range(5)]
        assert found[0] != "stale"
        assert found[-1] == "stale"
        assert robot.step(photo(TRUTH[1]), nothing).status != "stale"
        robot.step(image, nothing)


@every_strategy
def test_a_camera_that_hangs_from_the_first_image_on_is_stale(make: Any) -> None:
    for chosen in (make(), make(start=START, start_position_sigma=0.1)):
        robot = localizer(chosen)
        first = robot.step(photo(TRUTH[0]))
        # There is none before it that it could be, whatever odometry says.
        assert first.status != "stale"
        for _ in range(3):
            record = robot.step(photo(TRUTH[0]), np.array([0.1, 0.0, 0.0]))
            assert (record.status, record.confidence) == ("stale", 0.0)
            assert record.refined_covariance is None


def test_a_hanging_camera_never_makes_the_robot_surer_of_where_it_was() -> None:
    """Twenty times the same picture, while odometry says that the robot drives away."""
    robot = localizer(mixture_settings(start=START, start_position_sigma=0.1))
    robot.step(photo(TRUTH[0]))
    robot.step(photo(TRUTH[1]), increments(TRUTH)[1])
    records = [robot.step(photo(TRUTH[1]), np.array([0.1, 0.0, 0.0])) for _ in range(20)]
    assert {record.status for record in records} == {"stale"}
    spreads = [float(np.trace(record.covariance[:2, :2])) for record in records]
    assert spreads[-1] > spreads[0]
    assert {record.confidence for record in records} == {0.0}


@pytest.mark.parametrize("make", [search_settings, paper_settings])
def test_a_kidnapped_robot_is_not_followed_silently(make: Any) -> None:
    elsewhere = facing_wall(2.2, 0.9, -0.5)
    images = [photo(state) for state in TRUTH[:6]] + [photo(elsewhere)] * 2
    chosen = make(start=START, start_position_sigma=0.15, particles=195)
    records = localize_sequence(localizer(chosen, 1), TRUTH, images)
    assert records[5].status == "tracking"
    assert records[6].confidence < 0.3 * records[5].confidence
    assert records[6].status == "lost"
    # A pose that the filter does not believe in itself is not given.
    assert records[6].estimates == {}


# --- where to start ----------------------------------------------------------------------------


def test_a_start_pose_is_where_the_particles_are() -> None:
    chosen = search_settings(
        particles=2000,
        start=(0.5, -1.5, 3.1),
        start_position_sigma=0.2,
        start_heading_sigma=0.3,
    )
    record = localizer(chosen).step(photo(TRUTH[0]))
    assert len(record.particles) == 2000
    deviation = record.particles - np.array([0.5, -1.5, 3.1])
    deviation[:, 2] = wrap_angle(deviation[:, 2])
    assert np.all(np.abs(deviation.mean(axis=0)) < 0.03)
    np.testing.assert_allclose(deviation.std(axis=0), [0.2, 0.2, 0.3], rtol=0.1)
    # The image was taken somewhere else. By squared differences the nearest of these places looks
    # like it well enough to be followed; that the robot is there is not believed.
    assert record.confidence < 0.1
    asked = replace(chosen, strategy="mixture", likelihood=likelihood_named("evidence"))
    assert localizer(asked).step(photo(TRUTH[0])).status != "tracking"


def test_the_start_is_uniform_over_the_scene_or_over_the_area() -> None:
    whole = localizer(search_settings()).step(photo(TRUTH[0])).particles
    area = (-1.0, 0.5, -2.0, -1.5)
    part = localizer(search_settings(area=area)).step(photo(TRUTH[0])).particles
    for states, bounds in ((whole, SCENE.bounds), (part, area)):
        low, high = np.array(bounds)[[0, 2]], np.array(bounds)[[1, 3]]
        assert np.all((states[:, :2] >= low) & (states[:, :2] <= high))
        share = (states[:, :2] - low) / (high - low)
        np.testing.assert_allclose(share.mean(axis=0), 0.5, atol=0.05)
        np.testing.assert_allclose(share.std(axis=0), math.sqrt(1.0 / 12.0), atol=0.02)
        np.testing.assert_allclose(np.cos(states[:, 2]).mean(), 0.0, atol=0.1)


@pytest.mark.parametrize(
    "area",
    [
        (4.0, 5.0, -2.0, -1.0),
        (-9.0, -3.0, -2.0, -1.0),
        (-1.0, 1.0, 0.0, 1.0),
        (-1.0, 1.0, -9.0, -4.0),
    ],
)
@every_strategy
def test_an_area_outside_the_model_is_refused(
    make: Any, area: tuple[float, float, float, float]
) -> None:
    with pytest.raises(OptionError, match=r"covers x -3.00 to 3.00 m, y -3.00 to 0.00 m"):
        localizer(make(area=area))


def test_an_area_that_overlaps_the_model_is_searched() -> None:
    chosen = search_settings(area=(2.0, 4.0, -2.0, -1.0))
    states = localizer(chosen).step(photo(TRUTH[0])).particles
    assert states[:, 0].max() > 3.5


# --- bad input from a robot program ------------------------------------------------------------


@pytest.mark.parametrize("shape", [(24, 18, 3), (36, 49, 3), (48, 36, 3)])
def test_an_image_of_another_size_is_refused(shape: tuple[int, int, int]) -> None:
    with pytest.raises(OptionError, match="its camera 48x36"):
        localizer(mixture_settings()).step(np.zeros(shape, dtype=np.uint8))


@pytest.mark.parametrize(
    "increment",
    [[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0], [0.0, 0.0, -np.inf], [0.1, 0.0], [[0.1, 0.0, 0.0]]],
)
def test_a_motion_that_is_not_three_finite_numbers_is_refused(increment: list[float]) -> None:
    robot = localizer(mixture_settings())
    robot.step(photo(TRUTH[0]))
    with pytest.raises(OptionError, match="increment"):
        robot.step(photo(TRUTH[1]), np.array(increment))


@every_strategy
def test_what_was_refused_leaves_no_trace(make: Any) -> None:
    plain, troubled = localizer(make(), 5), localizer(make(), 5)
    # Tape on the lens: what is remembered of earlier images matters too.
    images = [photo(state) for state in TRUTH[:5]]
    for image in images:
        image[18:, :16] = (120, 110, 90)
    expected = localize_sequence(plain, TRUTH[:5], images)
    motions = increments(TRUTH)
    records = []
    for number, image in enumerate(images):
        for bad_image, bad_motion in ((BLACK[:10], motions[number]), (image, np.full(3, np.nan))):
            with pytest.raises(OptionError):
                troubled.step(bad_image, bad_motion)
        records.append(troubled.step(image, motions[number], float(number), f"{number}.png"))
    assert [content(record) for record in records] == [content(record) for record in expected]


@every_strategy
def test_the_caller_keeps_its_arrays(make: Any) -> None:
    image, motion = photo(TRUTH[0]), np.array([0.1, 0.0, 0.05])
    image_before, motion_before = image.copy(), motion.copy()
    robot = localizer(make())
    first = robot.step(image, motion)
    before = content(first)
    robot.step(image, motion)
    np.testing.assert_array_equal(image, image_before)
    np.testing.assert_array_equal(motion, motion_before)
    # A record is history: later steps do not change it.
    assert content(first) == before


def test_a_measurement_model_can_be_shared() -> None:
    chosen = mixture_settings()
    model = MeasurementModel.of_scene(SCENE, MOUNT, chosen)
    expected = [content(record) for record in localize_sequence(localizer(chosen), TRUTH[:3])]
    # What one localizer has learnt in it changes nothing for the next.
    for _ in range(2):
        shared = Localizer(SCENE, CAMERA, MOUNT, chosen, np.random.default_rng(0), model)
        assert [content(record) for record in localize_sequence(shared, TRUTH[:3])] == expected


def test_a_distorted_camera_is_undistorted_before_it_is_compared() -> None:
    bent = replace(CAMERA, model="SIMPLE_RADIAL", params=(24.0, 23.5, 17.5, -0.05))
    pinhole = Undistorter(bent).intrinsics
    assert pinhole != CAMERA.intrinsics
    robot = Localizer(SCENE, bent, MOUNT, mixture_settings(), np.random.default_rng(0))
    records = [
        robot.step(distorted_photo(state, -0.05), motion)
        for state, motion in zip(TRUTH, increments(TRUTH), strict=True)
    ]
    assert position_error(records[-1], TRUTH[-1]) < 0.1


def distorted_photo(state: FloatArray, k: float) -> ImageArray:
    """Radial distortion x' = x (1 + k r^2), inverted pixel by pixel on a fine pinhole photo."""
    factor = 8
    wide = replace(CAMERA.intrinsics, width=96, height=72, cx=47.5, cy=35.5)
    fine = photo(state, wide.resized(factor * wide.width, factor * wide.height))
    rows, columns = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    bent_x, bent_y = (columns - 23.5) / 24.0, (rows - 17.5) / 24.0
    x, y = bent_x.copy(), bent_y.copy()
    for _ in range(50):
        scale = 1.0 + k * (x * x + y * y)
        x, y = bent_x / scale, bent_y / scale
    u = np.rint((24.0 * x + 47.5 + 0.5) * factor - 0.5).astype(int)
    v = np.rint((24.0 * y + 35.5 + 0.5) * factor - 0.5).astype(int)
    return np.asarray(fine[v, u], dtype=np.uint8)
