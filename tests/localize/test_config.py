"""Configs: complete, read back as written, and refused in one line that names the key."""

import logging
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
from pipelines.artifacts.setting import Entry
from pipelines.artifacts.setting_kinds import degrees_of
from pipelines.artifacts.toml_file import format_value, read_toml
from pipelines.localize.config import ENTRIES, effective_settings, settings_of, settings_text
from pipelines.localize.likelihood import LIKELIHOODS, Likelihood
from pipelines.localize.settings import SECTIONS, LocalizerSettings, MotionModel
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
    "likelihood.inverse_temperature": (33.0, 33.0),
    "likelihood.fit_gain": (True, True),
    "likelihood.channels": (Channels.GRADIENT, "gradient"),
    "likelihood.pixel_subsampling": (3, 3),
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
    assert sorted(entry.path for entry in ENTRIES) == sorted(fields_of_all_settings())
    assert set(OTHER) == fields_of_all_settings()
    assert {entry.setting.section for entry in ENTRIES} == set(SECTIONS)
    # Options of the command line have no sections to tell two of one name apart.
    names = [name for entry in ENTRIES for name in entry.names]
    assert len(set(names)) == len(names)


def test_a_setting_has_the_same_name_everywhere() -> None:
    for entry in ENTRIES:
        attribute = entry.path.rpartition(".")[2]
        assert entry.name in {attribute, f"{attribute}_deg"}
        assert entry.setting.help


def test_names_of_angles_tell_their_unit() -> None:
    angles = {"start_heading_sigma", "map_heading_sigma", "motion.heading_floor"}
    angles.add("motion.walk_heading")
    assert {entry.path for entry in ENTRIES if entry.name.endswith("_deg")} == angles


@pytest.mark.parametrize("field", OTHER)
def test_a_setting_is_read_from_the_file_and_written_back(tmp_path: Path, field: str) -> None:
    value, in_file = OTHER[field]
    entry = next(entry for entry in ENTRIES if entry.path == field)
    text = (
        f"[{entry.setting.section}]\n{entry.name} = {format_value(in_file)}\n{ALONG.get(field, '')}"
    )
    settings = effective_settings(written(tmp_path, text), {})
    assert value_of(settings, field) == value
    assert value_of(LocalizerSettings(), field) != value
    # Nothing else changed; another cost comes with its own inverse temperature and channels.
    changed = {name for name in OTHER if value_of(settings, name) != value_of(DEFAULT, name)}
    along = {"likelihood.inverse_temperature", "likelihood.fit_gain", "likelihood.channels"}
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
        entry.path: entry.parsed(content[entry.setting.section][entry.name])
        for entry in ENTRIES
        if entry.path not in {"start", "start_heading_sigma"}
    }
    assert settings_of(chosen) == replace(
        settings, start=None, start_heading_sigma=DEFAULT.start_heading_sigma
    )
    x, y, heading_deg = content["start"]["start"]
    assert (x, y) == (length, -length)
    assert math.radians(heading_deg) == pytest.approx(-angle, rel=3e-16, abs=0.0)
    sigma_deg = content["start"]["start_heading_sigma_deg"]
    assert math.radians(sigma_deg) == pytest.approx(angle, rel=3e-16, abs=0.0)


@given(st.integers(0, 1800))
def test_tenths_of_degrees_stay_what_they_were(tenths: int) -> None:
    assert degrees_of(math.radians(tenths / 10.0)) == tenths / 10.0


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_text_is_read_as_it_was_written(text: str) -> None:
    assert tomllib.loads(f"key = {format_value(text)}")["key"] == text


def test_the_paper_has_its_own_defaults_unless_something_else_is_chosen(tmp_path: Path) -> None:
    paper = effective_settings(None, {"strategy": "condensation"})
    assert paper.likelihood == replace(LIKELIHOODS["squared"], pixel_subsampling=1)
    assert (paper.resampling, paper.estimate) == ("multinomial", "max_weight")
    path = written(tmp_path, '[filter]\nstrategy = "condensation"\nresampling = "residual"\n')
    mixed = effective_settings(path, {"estimate": "mode"})
    assert mixed == replace(paper, resampling="residual", estimate="mode")
    # A file that says everything leaves nothing to defaults.
    complete = written(tmp_path, settings_text(DEFAULT))
    changed = effective_settings(complete, {"strategy": "condensation"})
    assert changed == replace(DEFAULT, strategy="condensation")


def test_a_cost_comes_with_its_inverse_temperature(tmp_path: Path) -> None:
    path = written(tmp_path, '[likelihood]\ncost = "zncc"\ninverse_temperature = 12.0\n')
    chosen = replace(LIKELIHOODS["zncc"], inverse_temperature=12.0)
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
        ("[filter]\nparticels = 5\n", r"unknown key 'particels' in \[filter\]; known are method"),
        ("[fliter]\n", r"unknown key 'fliter'; known are \[filter\], \[start\]"),
        ("particles = 5\n", "unknown key 'particles'; known are"),
        ("filter = 5\n", r"filter is a whole number, expected a table; write \[filter\]"),
        ("[filter]\nparticles = 5.0\n", r"\[filter\] particles is a number, expected a whole n"),
        ("[filter]\nparticles = true\n", r"particles is true or false, expected a whole number"),
        ("[filter]\nstrategy = 3\n", r"\[filter\] strategy is 3, expected one of mixture, c"),
        ("[filter]\nstart_particles = 'many'\n", "'many', expected a whole number or \"auto\""),
        ("[motion]\nalpha1 = '0.5'\n", r"\[motion\] alpha1 is '0.5', expected a number"),
        ("[motion]\nalpha1 = 1979-05-27\n", "alpha1 is a date or time, expected a number"),
        ("[likelihood]\ncost = 'l2'\n", "cost is 'l2', expected one of squared, robust, zncc"),
        ("[likelihood]\nchannels = 'red'\n", "channels is 'red', expected one of colour, contrast"),
        ("[likelihood]\nfit_gain = true\n", "evidence fits no gain: choose channels"),
        ("[likelihood]\nfit_gain = 1\n", "fit_gain is a whole number, expected true or false"),
        ("[start]\nstart = [1.0, 2.0]\n", "start is a list, expected a list of three or six numb"),
        ("[start]\narea = [1, 2, 'x', 4]\n", r"\[start\] area is a list, expected a list of fo"),
        ("[motion]\nalpha3 = -0.1\n", r"\[motion\] alpha3: alpha3 -0.1 is not between 0 and"),
        ("[motion]\nheading_floor_deg = -1\n", r"heading_floor_deg: heading_floor_deg -1 is not"),
        ("[motion]\nalpha3 = inf\n", r"\[motion\] alpha3: alpha3 inf is not between"),
        ("[filter]\nparticles = 0\n", r"\[filter\] particles: particles 0 is not between 1 a"),
        ("[filter]\nstrategy = 'magic'\n", r"\[filter\] strategy is 'magic', expected one of mi"),
        ("[rendering]\nfine_width = 0\n", r"\[rendering\] fine_width: fine_width 0 is not bet"),
        ("[rendering]\nquality = 'best'\n", r"\[rendering\] quality is 'best', expected one of"),
        ("[likelihood]\ninverse_temperature = 0\n", r"\[likelihood\] inverse_temperature: inv"),
        ("[start]\narea = [1, 0, 0, 1]\n", r"\[start\] area: area 1,0,0,1 is empty"),
        ("[start]\nstart = [0, 0, 0, 0, 0, 0]\n", r"\[start\] start: a start of 6 numbers for 3"),
        # Two that do not go together: the one without which the other is possible.
        (
            "[rendering]\nfine_width = 200\nrefine_width = 100\n",
            r"\[rendering\] fine_width: refine_width 100 is not between 200",
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
    with pytest.raises(OptionError, match="particles -1 is not between"):
        effective_settings(path, {"particles": -1})
    with pytest.raises(InputError, match="does not exist"):
        effective_settings(tmp_path / "missing.toml", {})
    with pytest.raises(InputError, match="at most"):
        read_toml(written(tmp_path, "#" * (2**20 + 1)))


def test_the_command_line_prints_what_it_is_given_back(tmp_path: Path) -> None:
    options = ("--particles", "300", "--start", "1,2,90", "--cost", "gradient")
    printed = succeed("localize", "--print-config", *options)
    path = written(tmp_path, printed)
    assert succeed("localize", "--print-config", "--config", path) == printed
    settings = effective_settings(path, {})
    assert settings.particles == 300
    assert settings.start == (1.0, 2.0, math.radians(90.0))
    assert settings.likelihood == LIKELIHOODS["gradient"]
    more = ("--start", "anywhere", "--particles", "20")
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
        f"lfnav: {path}: [motion] alpha1: alpha1 -1 is not between 0 and 1000000\n"
    )
    for arguments in ((), ("scene.h5",), ("scene.h5", "data")):
        outcome = lfnav("localize", *arguments)
        assert outcome.code == 2
        assert "Missing" in outcome.err
    assert list(tmp_path.iterdir()) == [path]


# --- names of earlier versions --------------------------------------------------------------------

FORMER = """
[filter]
strategy = "informed"
proposal = "appearance"

[start]
pose = [1.0, 2.0, 90.0]
position_sigma = 0.2
heading_sigma_deg = 5.0

[likelihood]
cost = "zncc"
sharpness = 12.0
one_pixel_in = 2

[estimate]
kind = "mode"
"""


def test_files_of_earlier_versions_are_read_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = written(tmp_path, FORMER)
    with caplog.at_level(logging.WARNING, logger="pipelines"):
        settings = effective_settings(path, {})
    assert settings == LocalizerSettings(
        strategy="mixture",
        proposal="retrieval",
        start=(1.0, 2.0, math.radians(90.0)),
        start_position_sigma=0.2,
        start_heading_sigma=math.radians(5.0),
        likelihood=replace(LIKELIHOODS["zncc"], inverse_temperature=12.0, pixel_subsampling=2),
        estimate="mode",
    )
    assert [record.getMessage() for record in caplog.records] == [
        "proposal appearance is now called retrieval",
        "strategy informed is now called mixture",
        f"{path}: [start] pose is now called start",
        f"{path}: [start] position_sigma is now called start_position_sigma",
        f"{path}: [start] heading_sigma_deg is now called start_heading_sigma_deg",
        f"{path}: [likelihood] sharpness is now called inverse_temperature",
        f"{path}: [likelihood] one_pixel_in is now called pixel_subsampling",
        f"{path}: [estimate] kind is now called estimate",
    ]


def test_a_name_beside_its_former_one_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "[likelihood]\nsharpness = 5.0\ninverse_temperature = 6.0\n")
    reason = r"sharpness is the former name of inverse_temperature, which is there too; leave it"
    with pytest.raises(InputError, match=reason):
        effective_settings(path, {})


def test_options_of_earlier_versions_are_understood_and_not_shown() -> None:
    former = ("--init", "1,2,90", "--dof", "3", "--width", "32", "--likelihood", "zncc")
    present = ("--start", "1,2,90", "--degrees-of-freedom", "3", "--fine-width", "32")
    print_config = ("localize", "--print-config")
    assert succeed(*print_config, *former) == succeed(*print_config, *present, "--cost", "zncc")
    assert lfnav(*print_config, "--init", "uniform").out == succeed(*print_config)
    text = succeed("localize", "--help")
    for name in ("--init", "--dof", "--width", "--likelihood"):
        assert f" {name} " not in text
    outcome = lfnav(*print_config, "--strategy", "informed")
    assert outcome.code == 0
    assert outcome.err == "lfnav: strategy informed is now called mixture\n"
    assert 'strategy = "mixture"' in outcome.out


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: str(entry.name))
def test_every_setting_is_an_option(entry: Entry) -> None:
    value, in_file = OTHER[entry.path]
    text = ",".join(map(str, in_file)) if isinstance(in_file, list) else str(in_file)
    option = f"--{entry.name.replace('_', '-')}"
    given = [option] if entry.is_flag else [f"{option}={text}"]
    if entry.path in ALONG:
        given.append("--cost=zncc")
    content = tomllib.loads(succeed("localize", "--print-config", *given))
    assert entry.parsed(content[entry.setting.section][entry.name]) == value


def test_a_word_at_the_command_line_takes_back_what_the_file_says(tmp_path: Path) -> None:
    path = written(tmp_path, "[start]\nstart = [1, 2, 3]\n[filter]\nwith_pnp = true\n")
    back = ("--start", "anywhere", "--no-with-pnp")
    printed = succeed("localize", "--print-config", "--config", path, *back)
    assert printed == succeed("localize", "--print-config")


@pytest.mark.parametrize(
    ("option", "value", "reason"),
    [
        ("--fine-width", "4.5", "'4.5' is not a whole number"),
        ("--strategy", "magic", "'magic' is not one of 'mixture', 'coarse_to_fine', "),
        ("--area", "1,2", "'1,2' is not of the form XMIN,XMAX,YMIN,YMAX"),
        ("--start", "1,2,x", "'1,2,x' is not of the form X,Y,DEG or"),
        ("--threads", "many", "'many' is not a whole number or 'all'"),
    ],
)
def test_wrong_usage_is_one_line_that_names_the_option(
    option: str, value: str, reason: str
) -> None:
    outcome = lfnav("localize", "--print-config", option, value)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.count("\n") == 1
    assert f"'{option}': {reason}" in outcome.err


def test_settings_of_a_docking_are_not_in_the_way(tmp_path: Path) -> None:
    path = written(tmp_path, '[dock]\ndrive = "diff"\n[filter]\nparticles = 77\n')
    assert effective_settings(path, {}).particles == 77
