"""Settings of the filter: what is impossible is refused in one line when they are made."""

import json
import math
from typing import Any

import pytest

from pipelines.artifacts.errors import OptionError
from pipelines.localize.likelihood import Likelihood
from pipelines.localize.settings import MAX_PARTICLES, LocalizerSettings, MotionModel
from pipelines.render.choices import Blending, Channels, Cost

NAN, INF = math.nan, math.inf

# Keyword -> impossible values, and what the error says about each of them.
IMPOSSIBLE: dict[str, tuple[tuple[Any, ...], str]] = {
    "method": (("sift", ""), "method"),
    "proposal": (("none", ""), "proposal"),
    "map_position_sigma": ((-0.1, NAN, INF), "map_position_sigma"),
    "map_heading_sigma": ((-0.1, 4.0, NAN, INF), "map_heading_sigma_deg"),
    "degrees_of_freedom": ((0, 2, 4, 7, NAN), "degrees_of_freedom"),
    "strategy": (("", "Condensation", "annealed"), "strategy"),
    "resampling": (("", "wheel"), "resampling"),
    "estimate": (("", "median"), "estimate"),
    "quality": (("", "finest"), "quality"),
    "particles": ((0, -1, MAX_PARTICLES + 1, NAN), "particles"),
    "start_particles": ((0, -5, MAX_PARTICLES + 1), "start_particles"),
    "start_position_sigma": ((-0.1, NAN, INF), "start_position_sigma"),
    "start_heading_sigma": ((-0.1, 4.0, NAN, INF), "start_heading_sigma_deg"),
    "resampling_threshold": ((-0.1, 1.1, NAN), "resampling_threshold"),
    "smallest_effective_share": ((-0.1, 0.6, NAN), "smallest_effective_share"),
    "shrink_factor": ((-0.1, 1.5, NAN), "shrink_factor"),
    "roughening": ((-1.0, 11.0, NAN, INF), "roughening"),
    "coarse_width": ((3, 0, -20, 5000), "coarse_width"),
    "fine_width": ((3, 0, -40, 5000), "fine_width"),
    "refine_width": ((-1, 3, 39, 5000, NAN), "refine_width"),
    "start": (
        ((NAN, 0.0, 0.0), (0.0, INF, 0.0), (0.0, 0.0, -INF), (0.0, 0.0), (0.0,) * 6),
        "start",
    ),
    "area": (
        (
            (NAN, 1.0, 0.0, 1.0),
            (0.0, INF, 0.0, 1.0),
            (1.0, 1.0, 0.0, 1.0),
            (2.0, 1.0, 0.0, 1.0),
            (0.0, 1.0, 3.0, 3.0),
            (0.0, 1.0, 3.0, -3.0),
        ),
        "area",
    ),
    "threads": ((0, -2, 5000), "threads"),
}
CASES = [(name, value, text) for name, (values, text) in IMPOSSIBLE.items() for value in values]


@pytest.mark.parametrize(("name", "value", "text"), CASES)
def test_impossible_values_are_refused_by_name(name: str, value: Any, text: str) -> None:
    with pytest.raises(OptionError, match=text) as caught:
        LocalizerSettings(**{name: value})
    assert "\n" not in str(caught.value)


def test_every_setting_with_a_range_is_in_the_table() -> None:
    fields = set(LocalizerSettings.__dataclass_fields__)
    # These are checked by their own types when they are made.
    assert set(IMPOSSIBLE) == fields - {"likelihood", "motion", "blending", "with_pnp", "device"}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("particles", 1),
        ("start_particles", MAX_PARTICLES),
        ("start_position_sigma", 0.0),
        ("start_heading_sigma", math.pi),
        ("resampling_threshold", 1.0),
        ("smallest_effective_share", 0.0),
        ("shrink_factor", 1.0),
        ("roughening", 0.0),
        ("coarse_width", 4),
        ("refine_width", 0),
        ("refine_width", 4096),
        ("degrees_of_freedom", 6),
        ("threads", 1),
    ],
)
def test_the_ends_of_the_ranges_are_possible(name: str, value: Any) -> None:
    assert getattr(LocalizerSettings(**{name: value}), name) == value


def test_a_search_begins_with_as_many_hypotheses_as_its_strategy_needs() -> None:
    for strategy in ("mixture", "coarse_to_fine"):
        chosen = LocalizerSettings(strategy=strategy)
        assert chosen.search_particles > 10 * chosen.particles
        assert LocalizerSettings(strategy=strategy, start_particles=777).search_particles == 777
        # Never fewer than are kept.
        many = LocalizerSettings(strategy=strategy, particles=50_000)
        assert many.search_particles == 50_000


def test_images_may_be_as_fine_as_the_finest_alignment() -> None:
    assert LocalizerSettings(fine_width=4096, refine_width=4096).widths == (20, 4096)
    assert LocalizerSettings(fine_width=4096, refine_width=0).fine_width == 4096
    with pytest.raises(
        OptionError, match="refine_width 160 is not between 200, which is fine_width, and 4096"
    ):
        LocalizerSettings(fine_width=200)


def test_the_alignment_climbs_in_steps_of_two_to_three() -> None:
    chosen = LocalizerSettings(coarse_width=20, fine_width=40, refine_width=160)
    assert chosen.widths == (20, 40, 80, 160)
    assert LocalizerSettings(fine_width=40, refine_width=100).widths == (20, 40, 100)
    assert LocalizerSettings(fine_width=40, refine_width=0).widths == (20, 40)


def test_the_start_has_as_many_numbers_as_a_state() -> None:
    spatial = LocalizerSettings(degrees_of_freedom=6, start=(0.0,) * 6)
    assert spatial.state_space.name == "spatial"
    assert LocalizerSettings().state_space.name == "planar"
    with pytest.raises(OptionError, match="start of 3 numbers for 6 degrees of freedom"):
        LocalizerSettings(degrees_of_freedom=6, start=(0.0, 0.0, 0.0))


def test_a_search_does_not_start_with_fewer_particles_than_it_keeps() -> None:
    with pytest.raises(OptionError, match=r"fewer particles \(100\) than are kept \(195\)"):
        LocalizerSettings(start_particles=100, particles=195)
    # The paper's filter has one number of particles.
    LocalizerSettings(strategy="condensation", start_particles=100, particles=195)


def test_what_the_run_file_keeps_is_plain_json_and_complete() -> None:
    settings = LocalizerSettings(
        start=(1.0, 2.0, 0.5),
        area=(0.0, 1.0, -1.0, 2.0),
        likelihood=Likelihood(Cost.ZNCC, 50.0, fit_gain=False, channels=Channels.CONTRAST),
        motion=MotionModel(alpha1=0.5),
        blending=Blending.DELAUNAY,
    )
    values = settings.to_dict()
    assert json.loads(json.dumps(values, allow_nan=False)) == values
    # The number of threads changes no result and must not change the file.
    assert set(values) == set(LocalizerSettings.__dataclass_fields__) - {"threads"}
    assert values["start"] == [1.0, 2.0, 0.5]
    assert values["area"] == [0.0, 1.0, -1.0, 2.0]
    assert values["likelihood"] == {
        "cost": "zncc",
        "inverse_temperature": 50.0,
        "fit_gain": False,
        "pixel_subsampling": 1,
        "channels": "contrast",
    }
    assert values["motion"]["alpha1"] == 0.5
    assert values["blending"] == "delaunay"
    assert LocalizerSettings().to_dict()["start"] is None


def test_threads_do_not_reach_the_run_file() -> None:
    assert LocalizerSettings(threads=1).to_dict() == LocalizerSettings(threads=2).to_dict()
