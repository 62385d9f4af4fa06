"""Ways to choose pixels: each is right on average, and even subsets are the most exact."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.scenes import ROOT, workshop_scene
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import load_dataset
from pipelines.experiments.pixel_choices import CHOICES, costs_by_some, errors_of_choices
from pipelines.render.choices import Cost
from pipelines.render.comparison import prepared
from pipelines.render.renderer import Renderer
from tests.lightfield_samples import WALL, looking, noise_views, pinhole


@pytest.mark.parametrize("name", CHOICES)
def test_every_pixel_has_the_same_weight_on_average(name: str) -> None:
    generator = np.random.default_rng(0)
    grey = generator.uniform(0.0, 255.0, (12, 20)).cumsum(axis=1) % 255.0
    turns = 60 if "chance" not in name else 6000
    weights = np.array([CHOICES[name](grey, turn, generator) for turn in range(turns)])
    step = int(name.split()[2].strip(","))
    counts = (weights > 0.0).sum(axis=(1, 2))
    assert counts.max() - counts.min() <= 1
    assert counts.mean() == pytest.approx(grey.size / step, abs=1.0)
    mean = weights.mean(axis=0)
    expected = 1.0 / step if "chance" not in name else 1.0
    # Pixels with small chances weigh much: their means still vary after thousands of turns.
    np.testing.assert_allclose(mean, expected, rtol=1e-9 if "chance" not in name else 0.25)


def test_with_all_pixels_it_is_the_cost_of_the_filter() -> None:
    generator = np.random.default_rng(0)
    recorded = [looking([x, -3.0, 1.0], [0.0, 0.0, 1.0]) for x in (-0.5, 0.0, 0.6)]
    renderer = Renderer(noise_views(recorded, generator), WALL, threads=1)
    camera = pinhole(24, 18, 15.0)
    poses = np.array([looking([x, -2.5, 1.1], [1.5, 0.0, 1.0]) for x in (-0.4, 0.1, 0.3)])
    images, covered = renderer.render_many(poses, camera)
    image = (0.8 * images[1] + generator.uniform(0.0, 60.0, images[1].shape)).astype(np.float32)
    image[5:9, 3:] = np.nan
    expected = renderer.costs(poses, camera, image, Cost.ROBUST, True)
    weights = np.ones((camera.height, camera.width))
    found = costs_by_some(images, covered, prepared(image), weights)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert not covered.all()
    # Pixels of weight 0 are as good as not compared.
    weights[:, 10:] = 0.0
    image[:, 10:] = np.nan
    expected = renderer.costs(poses, camera, image, Cost.ROBUST, True)
    np.testing.assert_allclose(
        costs_by_some(images, covered, prepared(image), weights), expected, rtol=1e-5
    )


def test_even_subsets_are_more_exact_than_chance() -> None:
    drive = load_dataset(ROOT / "sample_data" / "workshop" / "test")
    generator = np.random.default_rng(0)
    errors, spread = errors_of_choices(workshop_scene(), drive, generator, every_frame=10)
    assert errors["one in 2, (x + y) mod 2"] < errors["one in 3, (x + y) mod 3"]
    assert errors["one in 3, (x + y) mod 3"] < errors["one in 5, (x + 2y) mod 5"]
    assert errors["one in 5, (x + 2y) mod 5"] < errors["one in 4, by chance"]
    assert errors["one in 5, (x + 2y) mod 5"] < 0.15 * spread


def test_a_drive_without_the_truth_is_refused(tmp_path: Path) -> None:
    for name in ("rgb", "rgb.txt", "camera.toml"):
        (tmp_path / name).symlink_to(ROOT / "sample_data" / "workshop" / "test" / name)
    drive = load_dataset(tmp_path)
    with pytest.raises(InputError, match="groundtruth"):
        errors_of_choices(workshop_scene(), drive, np.random.default_rng(0))
