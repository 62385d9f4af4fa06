"""The stated 95 % region, over many runs in maps whose errors are drawn as stated."""

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.geometry.pose import world_from_base_planar
from pipelines.lightfield.scene import Scene
from pipelines.localize.consistency import REGION, chi_square_quantile
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR
from pipelines.localize.track import HEAVY_TAILS, Track
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo
from tests.sequence_samples import (
    START,
    TRUTH,
    increments,
    localizer,
    mixture_settings,
    scene_of,
)

RUNS = 10
SETTINGS = mixture_settings(start=START)


def disturbed_map(settings: LocalizerSettings, rng: np.random.Generator) -> Scene:
    """Seven photos of the wall, at poses that err as the settings say."""
    states = np.array([facing_wall(x, 2.0) for x in np.linspace(-1.5, 1.5, 7)])
    sigmas = np.array([settings.map_position_sigma] * 2 + [settings.map_heading_sigma])
    given = PLANAR.moved(states, sigmas * rng.standard_normal(states.shape))
    poses = world_from_base_planar(given) @ MOUNT
    return scene_of([photo(state) for state in states], poses, [-3.0, 3.0, -3.0, 0.0])


def with_a_person(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """A noisy image in which something of one colour covers a fifth of the view."""
    seen = image + 6.0 * rng.standard_normal(image.shape)
    column = int(rng.integers(0, CAMERA.width - 12))
    seen[8:, column : column + 12] = rng.uniform(0.0, 255.0, 3)
    return np.asarray(np.clip(seen, 0.0, 255.0).astype(np.uint8))


def squared_errors(seed: int, *, is_covered: bool) -> list[float]:
    """Normalised squared errors (NEES) of one run; wheels are 5 % off in each step."""
    rng = np.random.default_rng(seed)
    robot = localizer(SETTINGS, seed, disturbed_map(SETTINGS, rng))
    found = []
    for number, (truth, motion) in enumerate(zip(TRUTH, increments(TRUTH), strict=True)):
        image = with_a_person(photo(truth), rng) if is_covered else photo(truth)
        measured = motion * (1.0 + 0.05 * rng.standard_normal())
        record = robot.step(image, measured, float(number))
        if record.refined_covariance is None:
            continue
        error = PLANAR.difference(record.estimates["refined"], truth)
        found.append(float(error @ np.linalg.solve(record.refined_covariance, error)))
    return found


def share_inside(squared: FloatArray) -> float:
    return float(np.mean(squared <= chi_square_quantile(REGION, PLANAR.dimension)))


@pytest.mark.parametrize("is_covered", [False, True], ids=["clear", "covered"])
def test_the_truth_lies_in_the_stated_region(is_covered: bool) -> None:
    squared = np.array(
        [error for seed in range(RUNS) for error in squared_errors(seed, is_covered=is_covered)]
    )
    assert len(squared) >= 0.8 * RUNS * len(TRUTH)
    assert share_inside(squared) >= 0.88
    # Nor is it there because everything is: where all is in view, half the size is too small.
    if not is_covered:
        assert share_inside(4.0 * squared) < REGION


def test_the_stated_region_holds_errors_with_heavy_tails() -> None:
    # Student's t with nine degrees of freedom: a normal variable over the root of a chi-square one.
    rng = np.random.default_rng(0)
    count, freedom = 200_000, 9
    covariance = np.diag([0.01, 0.02, 0.005]) ** 2
    scale = np.sqrt(rng.chisquare(freedom, count) / freedom)
    errors = rng.multivariate_normal(np.zeros(3), covariance, count) / scale[:, None]
    stated = Track(np.zeros(3), covariance).stated_covariance
    np.testing.assert_allclose(stated, HEAVY_TAILS * covariance)
    squared = np.einsum("ni,ni->n", errors, np.linalg.solve(stated, errors.T).T)
    assert share_inside(squared) == pytest.approx(REGION, abs=0.005)
    blurred = Track(np.zeros(3), covariance, blur=2.0).stated_covariance
    np.testing.assert_allclose(blurred, 2.0 * stated)
