"""Configs: complete, read back as written, and refused in one line that names the key."""

import math
import tomllib
from dataclasses import fields, replace
from functools import reduce
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.toml_file import format_value, read_toml
from pipelines.localize.config import effective_settings, settings_of, settings_text
from pipelines.localize.config_keys import KEYS, SECTIONS, degrees_of
from pipelines.localize.likelihood import LIKELIHOODS, Likelihood
from pipelines.localize.motion import MotionModel
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.choices import Blending, Channels, Cost
from pipelines.render.devices import Device
from tests.chain_samples import lfnav, succeed

# A value of each setting that is not its default, as Python has it and as the file does.
OTHER: dict[str, tuple[Any, Any]] = {
    "strategy": ("coarse_to_fine", "coarse_to_fine"),
    "degrees_of_freedom": (6, 6),
    "particles": (77, 77),
    "start_particles": (900, 900),
    "start": ((1.5, -2.0, math.radians(90.0)), [1.5, -2, 90.0]),
    "start_position_sigma": (0.25, 0.25),
    "start_heading_sigma": (math.radians(7.0), 7.0),
    "area": ((-1.0, 2.0, 0.5, 3.0), [-1.0, 2.0, 0.5, 3.0]),
    "likelihood.cost": (Cost.ZNCC, "zncc"),
    "likelihood.sharpness": (33.0, 33.0),
    "likelihood.fit_gain": (True, True),
    "likelihood.channels": (Channels.GRADIENT, "gradient"),
    "likelihood.one_pixel_in": (3, 3),
    "motion.alpha1": (0.5, 0.5),
    "motion.alpha2": (0.6, 0.6),
    "motion.alpha3": (0.7, 0.7),
    "motion.alpha4": (0.8, 0.8),
    "motion.position_floor": (0.0, 0),
    "motion.heading_floor": (math.radians(2.0), 2.0),
    "motion.walk_position": (0.9, 0.9),
    "motion.walk_heading": (math.radians(12.0), 12.0),
    "resampling": ("residual", "residual"),
    "resampling_threshold": (0.5, 0.5),
    "smallest_effective_share": (0.2, 0.2),
    "shrink_factor": (0.3, 0.3),
    "roughening": (2.0, 2.0),
    "coarse_width": (16, 16),
    "fine_width": (48, 48),
    "refine_width": (320, 320),
    "blending": (Blending.DELAUNAY, "delaunay"),
    "quality": ("fine", "fine"),
    "estimate": ("mean", "mean"),
    "map_position_sigma": (0.03, 0.03),
    "map_heading_sigma": (math.radians(0.8), 0.8),
    "method": ("pnp", "pnp"),
    "with_pnp": (True, True),
    "proposal": ("both", "both"),
    "threads": (3, 3),
    "device": (Device.AUTO, "auto"),
}
# Evidence, the default, fits no gain, nor does this cost unless it is told to.
ALONG = {"likelihood.fit_gain": 'cost = "zncc"\n'}


def fields_of_all_settings() -> set[str]:
    """The fields of the settings and of what they consist of, found without the config's help."""
    names = {field.name for field in fields(LocalizerSettings)} - {"motion", "likelihood"}
    names |= {f"motion.{field.name}" for field in fields(MotionModel)}
    return names | {f"likelihood.{field.name}" for field in fields(Likelihood)}


def value_of(settings: LocalizerSettings, field: str) -> Any:
    return reduce(getattr, field.split("."), settings)


def written(folder: Path, text: str) -> Path:
    path = folder / "settings.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_no_setting_is_forgotten() -> None:
    assert sorted(key.field for key in KEYS) == sorted(fields_of_all_settings())
    assert set(OTHER) == fields_of_all_settings()
    assert len({(key.section, key.name) for key in KEYS}) == len(KEYS)
    assert {key.section for key in KEYS} == set(SECTIONS)


def test_names_of_angles_tell_their_unit() -> None:
    angles = {"start_heading_sigma", "map_heading_sigma", "motion.heading_floor"}
    angles.add("motion.walk_heading")
    assert {key.field for key in KEYS if key.name.endswith("_deg")} == angles


@pytest.mark.parametrize("field", OTHER)
def test_a_setting_is_read_from_the_file_and_written_back(tmp_path: Path, field: str) -> None:
    value, in_file = OTHER[field]
    key = next(key for key in KEYS if key.field == field)
    text = f"[{key.section}]\n{key.name} = {format_value(in_file)}\n{ALONG.get(field, '')}"
    settings = effective_settings(written(tmp_path, text), {})
    assert value_of(settings, field) == value
    assert value_of(LocalizerSettings(), field) != value
    # Nothing else changed; another kind of comparison comes with its own sharpness and channels.
    changed = {name for name in OTHER if value_of(settings, name) != value_of(DEFAULT, name)}
    along = {"likelihood.sharpness", "likelihood.fit_gain", "likelihood.channels"}
    if field in ALONG:
        along.add("likelihood.cost")
    assert changed - along <= {field}
    again = effective_settings(written(tmp_path, settings_text(settings)), {})
    assert again == settings


DEFAULT = LocalizerSettings()


def test_the_printed_defaults_are_the_defaults(tmp_path: Path) -> None:
    assert effective_settings(None, {}) == DEFAULT
    assert effective_settings(written(tmp_path, settings_text(DEFAULT)), {}) == DEFAULT
    assert effective_settings(written(tmp_path, ""), {}) == DEFAULT


@given(
    st.floats(0.0, math.pi),
    st.floats(0.0, 1e6),
    st.sampled_from(Cost),
    st.booleans(),
    st.sampled_from(Channels),
)
def test_any_numbers_are_read_as_they_were_written(
    angle: float, length: float, cost: Cost, wants_gain: bool, channels: Channels
) -> None:
    fit_gain = wants_gain and cost is not Cost.EVIDENCE
    settings = replace(
        DEFAULT,
        start=(length, -length, -angle),
        start_heading_sigma=angle,
        start_position_sigma=length,
        likelihood=Likelihood(cost, 1.0 + length, fit_gain, channels=channels),
    )
    content = tomllib.loads(settings_text(settings))
    chosen = {
        key.field: key.parsed(content[key.section][key.name])
        for key in KEYS
        if key.field not in {"start", "start_heading_sigma"}
    }
    assert settings_of(chosen) == replace(
        settings, start=None, start_heading_sigma=DEFAULT.start_heading_sigma
    )
    x, y, heading_deg = content["start"]["pose"]
    assert (x, y) == (length, -length)
    assert math.radians(heading_deg) == pytest.approx(-angle, rel=3e-16, abs=0.0)
    sigma_deg = content["start"]["heading_sigma_deg"]
    assert math.radians(sigma_deg) == pytest.approx(angle, rel=3e-16, abs=0.0)


@given(st.integers(0, 1800))
def test_tenths_of_degrees_stay_what_they_were(tenths: int) -> None:
    assert degrees_of(math.radians(tenths / 10.0)) == tenths / 10.0


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_text_is_read_as_it_was_written(text: str) -> None:
    assert tomllib.loads(f"key = {format_value(text)}")["key"] == text


def test_the_paper_has_its_own_defaults_unless_something_else_is_chosen(tmp_path: Path) -> None:
    paper = effective_settings(None, {"strategy": "condensation"})
    assert paper.likelihood == replace(LIKELIHOODS["squared"], one_pixel_in=1)
    assert (paper.resampling, paper.estimate) == ("multinomial", "max_weight")
    path = written(tmp_path, '[filter]\nstrategy = "condensation"\nresampling = "residual"\n')
    mixed = effective_settings(path, {"estimate": "mode"})
    assert mixed == replace(paper, resampling="residual", estimate="mode")
    # A file that says everything leaves nothing to defaults.
    complete = written(tmp_path, settings_text(DEFAULT))
    changed = effective_settings(complete, {"strategy": "condensation"})
    assert changed == replace(DEFAULT, strategy="condensation")


def test_a_kind_of_comparison_comes_with_its_sharpness(tmp_path: Path) -> None:
    path = written(tmp_path, '[likelihood]\ncost = "zncc"\nsharpness = 12.0\n')
    chosen = replace(LIKELIHOODS["zncc"], sharpness=12.0)
    assert effective_settings(path, {}).likelihood == chosen
    assert effective_settings(path, {"likelihood.cost": Cost.ZNCC}).likelihood == chosen
    other = effective_settings(path, {"likelihood.cost": Cost.GRADIENT})
    assert other.likelihood == LIKELIHOODS["gradient"]


def test_a_width_at_the_command_line_takes_the_others_along(tmp_path: Path) -> None:
    small = effective_settings(None, {"fine_width": 10})
    assert (small.coarse_width, small.fine_width, small.refine_width) == (10, 10, 160)
    large = effective_settings(None, {"fine_width": 200})
    assert (large.coarse_width, large.fine_width, large.refine_width) == (20, 200, 200)
    path = written(tmp_path, "[rendering]\nrefine_width = 0\ncoarse_width = 30\n")
    assert effective_settings(path, {"fine_width": 200}).refine_width == 0
    assert effective_settings(path, {"fine_width": 200}).coarse_width == 30


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[filter]\nparticels = 5\n", r"unknown key 'particels' in \[filter\]; known are strat"),
        ("[fliter]\n", r"unknown key 'fliter'; known are \[filter\], \[start\]"),
        ("particles = 5\n", "unknown key 'particles'; known are"),
        ("filter = 5\n", r"filter is a whole number, expected a table; write \[filter\]"),
        ("[filter]\nparticles = 5.0\n", r"\[filter\] particles is a number, expected a whole n"),
        ("[filter]\nparticles = true\n", r"particles is true or false, expected a whole number"),
        ("[filter]\nstrategy = 3\n", r"\[filter\] strategy is a whole number, expected a text"),
        ("[filter]\nstart_particles = 'many'\n", "'many', expected a whole number or \"auto\""),
        ("[motion]\nalpha1 = '0.5'\n", r"\[motion\] alpha1 is '0.5', expected a number"),
        ("[motion]\nalpha1 = 1979-05-27\n", "alpha1 is a date or time, expected a number"),
        ("[likelihood]\ncost = 'l2'\n", "cost is 'l2', expected one of squared, robust, zncc"),
        ("[likelihood]\nchannels = 'red'\n", "channels is 'red', expected one of colour, contrast"),
        ("[likelihood]\nfit_gain = true\n", "evidence fits no gain: choose channels"),
        ("[likelihood]\nfit_gain = 1\n", "fit_gain is a whole number, expected true or false"),
        ("[start]\npose = [1.0, 2.0]\n", "pose is a list, expected a list of three or six numb"),
        ("[start]\narea = [1, 2, 'x', 4]\n", r"\[start\] area is a list, expected a list of fo"),
        ("[motion]\nalpha3 = -0.1\n", r"\[motion\] alpha3: motion noise alpha3 = -0.1 is not"),
        ("[motion]\nheading_floor_deg = -1\n", r"heading_floor_deg: motion noise heading_floor"),
        ("[motion]\nalpha3 = inf\n", r"\[motion\] alpha3: motion noise alpha3 = inf is not"),
        ("[filter]\nparticles = 0\n", r"\[filter\] particles: number of particles 0 is not b"),
        ("[filter]\nstrategy = 'magic'\n", r"\[filter\] strategy: strategy 'magic' is none of"),
        ("[rendering]\nfine_width = 0\n", r"\[rendering\] fine_width: fine width 0 is not bet"),
        ("[rendering]\nquality = 'best'\n", r"\[rendering\] quality: quality 'best' is none of"),
        ("[likelihood]\nsharpness = 0\n", r"\[likelihood\] sharpness: a likelihood's sharpness"),
        ("[start]\narea = [1, 0, 0, 1]\n", r"\[start\] area: area 1,0,0,1 is empty"),
        ("[start]\npose = [0, 0, 0, 0, 0, 0]\n", r"\[start\] pose: a start of 6 numbers for 3"),
        # Two that do not go together: the one without which the other is possible.
        (
            "[rendering]\nfine_width = 200\nrefine_width = 100\n",
            r"\[rendering\] fine_width: refine width 100 is not between 200",
        ),
        ("[filter\n", "is not TOML"),
        ("[filter]\nparticles = 5\nparticles = 6\n", "is not TOML"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=reason) as caught:
        effective_settings(path, {"particles": 50})
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_options_are_blamed_for_what_they_say(tmp_path: Path) -> None:
    path = written(tmp_path, "[filter]\nparticles = 300\n")
    with pytest.raises(OptionError, match="number of particles -1"):
        effective_settings(path, {"particles": -1})
    with pytest.raises(InputError, match="does not exist"):
        effective_settings(tmp_path / "missing.toml", {})
    with pytest.raises(InputError, match="at most"):
        read_toml(written(tmp_path, "#" * (2**20 + 1)))


def test_the_command_line_prints_what_it_is_given_back(tmp_path: Path) -> None:
    options = ("--particles", "300", "--init", "1,2,90", "--likelihood", "gradient")
    printed = succeed("localize", "--print-config", *options)
    path = written(tmp_path, printed)
    assert succeed("localize", "--print-config", "--config", path) == printed
    settings = effective_settings(path, {})
    assert settings.particles == 300
    assert settings.start == (1.0, 2.0, math.radians(90.0))
    assert settings.likelihood == LIKELIHOODS["gradient"]
    more = ("--init", "uniform", "--particles", "20")
    changed = effective_settings(
        written(tmp_path, succeed("localize", "--print-config", "--config", path, *more)), {}
    )
    assert changed == replace(settings, start=None, particles=20)


def test_bad_configs_through_the_command_line(tmp_path: Path) -> None:
    path = written(tmp_path, "[motion]\nalpha1 = -1\n")
    output = tmp_path / "run.h5"
    outcome = lfnav("localize", "scene.h5", "data", "-o", output, "--config", path)
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err == (
        f"lfnav: {path}: [motion] alpha1: motion noise alpha1 = -1 is not 0 or more\n"
    )
    for arguments in ((), ("scene.h5",), ("scene.h5", "data")):
        outcome = lfnav("localize", *arguments)
        assert outcome.code == 2
        assert "Missing" in outcome.err
    assert list(tmp_path.iterdir()) == [path]
