"""What a sweep is asked for: read, multiplied out, refused in one line."""

import logging
from dataclasses import replace
from pathlib import Path

import pytest

from pipelines.artifacts.errors import InputError, OptionError
from pipelines.experiments.config_tables import parse_seeds
from pipelines.experiments.sweep_config import read_sweep_config
from pipelines.localize.likelihood import LIKELIHOODS
from pipelines.localize.stage import NO_ODOMETRY
from pipelines.render.choices import Cost

DATASET = '[[dataset]]\nscene = "scene.h5"\npath = "drives/lobby"\n'


def written(folder: Path, text: str) -> Path:
    path = folder / "sweep.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_everything_is_combined_with_everything(tmp_path: Path) -> None:
    config = read_sweep_config(
        written(
            tmp_path,
            """
            [sweep]
            seeds = "3-5"
            strategy = ["mixture", "condensation"]
            cost = ["zncc", "squared"]
            particles = [50, 195, 500]
            [filter]
            resampling = "stratified"
            [motion]
            alpha1 = 0.5
            [likelihood]
            cost = "zncc"
            inverse_temperature = 7
            [[dataset]]
            name = "lobby"
            scene = "scene.h5"
            path = "/drives/lobby"
            odometry = ["odometry.txt", "../worse.txt"]
            [[dataset]]
            scene = "/scene.h5"
            path = "drives/hall"
            """,
        )
    )
    assert config.seeds == (3, 4, 5)
    combinations = {(s.strategy, s.likelihood.cost, s.particles) for s in config.settings}
    assert len(config.settings) == len(combinations) == 12
    assert all(s.resampling == "stratified" and s.motion.alpha1 == 0.5 for s in config.settings)
    # The inverse temperature that was chosen belongs to the comparison that was chosen.
    for settings in config.settings:
        is_zncc = settings.likelihood.cost is Cost.ZNCC
        assert settings.likelihood.inverse_temperature == (7.0 if is_zncc else 800.0)
    lobby, hall = config.datasets
    assert (lobby.name, lobby.scene) == ("lobby", tmp_path / "scene.h5")
    assert lobby.odometry == (
        Path("/drives/lobby/odometry.txt"),
        Path("/drives/lobby/../worse.txt"),
    )
    assert (hall.name, hall.scene) == ("drives/hall", Path("/scene.h5"))
    assert (hall.path, hall.odometry) == (tmp_path / "drives/hall", (None,))


def test_what_is_not_varied_is_the_strategys_default(tmp_path: Path) -> None:
    text = '[sweep]\nseeds = [4]\nstrategy = ["condensation", "mixture"]\n' + DATASET
    paper, default = read_sweep_config(written(tmp_path, text)).settings
    every_pixel = replace(LIKELIHOODS["squared"], pixel_subsampling=1)
    assert (paper.likelihood, paper.estimate) == (every_pixel, "max_weight")
    assert (default.likelihood, default.estimate) == (LIKELIHOODS["evidence"], "refined")
    one = read_sweep_config(written(tmp_path, "[sweep]\nseeds = 3\nparticles = 9\n" + DATASET))
    assert (one.seeds, [settings.particles for settings in one.settings]) == ((3,), [9])


def test_only_what_has_a_meaning_is_combined(tmp_path: Path) -> None:
    text = """
    [sweep]
    seeds = 1
    method = ["filter", "pnp"]
    strategy = ["condensation", "coarse_to_fine", "mixture"]
    proposal = ["retrieval", "both"]
    cost = ["robust", "zncc"]
    particles = [50, 195]
    """
    config = read_sweep_config(written(tmp_path, text + DATASET))
    pnp = [settings for settings in config.settings if settings.method == "pnp"]
    found = {(s.strategy, s.proposal) for s in config.settings if s.method == "filter"}
    assert len(pnp) == 1
    # Two likelihoods and two numbers of particles for each.
    assert len(config.settings) == 1 + 4 * 4
    assert found == {
        ("condensation", "retrieval"),
        ("coarse_to_fine", "retrieval"),
        ("mixture", "retrieval"),
        ("mixture", "both"),
    }


def test_a_drive_may_be_tried_without_its_odometry(tmp_path: Path) -> None:
    text = "[sweep]\nseeds = 1\n" + DATASET + 'odometry = ["none", "./none", "odometry.txt"]\n'
    (dataset,) = read_sweep_config(written(tmp_path, text)).datasets
    assert dataset.odometry == (
        NO_ODOMETRY,
        tmp_path / "drives/lobby/none",
        tmp_path / "drives/lobby/odometry.txt",
    )


def test_seeds_of_the_command_line_win(tmp_path: Path) -> None:
    path = written(tmp_path, '[sweep]\nseeds = "0-9"\n' + DATASET)
    assert read_sweep_config(path, "7,2").seeds == (7, 2)
    assert read_sweep_config(written(tmp_path, DATASET), "0-1").seeds == (0, 1)
    for text in ("", "-3", "a", "5-3", "0-99999999", "1,,2", "1.5"):
        with pytest.raises(OptionError, match="seeds"):
            read_sweep_config(path, text)


def test_spans_include_both_ends() -> None:
    assert parse_seeds("0-0") == (0,)
    assert parse_seeds(" 8 - 10 ") == (8, 9, 10)
    assert parse_seeds("1, 5,3") == (1, 5, 3)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (DATASET, r"\[sweep\] seeds is missing; write seeds = \"0-19\""),
        ("[sweep]\nseeds = '9-1'\n" + DATASET, r"\[sweep\] seeds: from 9 to 1 are not"),
        ("[sweep]\nseeds = 'many'\n" + DATASET, r"\[sweep\] seeds: 'many' is no seed"),
        ("[sweep]\nseeds = [0, -1]\n" + DATASET, "seeds are not whole numbers from 0 on"),
        ("[sweep]\nseeds = [0, true]\n" + DATASET, "seeds are not whole numbers from 0 on"),
        ("[sweep]\nseeds = []\n" + DATASET, r"\[sweep\] seeds is empty"),
        ("[sweep]\nseeds = [1, 2, 1]\n" + DATASET, r"\[sweep\] seeds: 1 is there twice"),
        ("[sweep]\nseed = 1\n" + DATASET, r"unknown key 'seed' in \[sweep\]; known are seeds"),
        ("sweep = 1\n" + DATASET, r"\[sweep\] is a whole number, expected a table"),
        ("[sweep]\nseeds = 1\n", r"names no data set; write \[\[dataset\]\]"),
        ("[sweep]\nseeds = 1\n[dataset]\nscene = 's'\n", "names no data set"),
        ("[sweep]\nseeds = 1\n[[dataset]]\nscene = 's'\n", "data set 1: path is missing"),
        (f"[sweep]\nseeds = 1\n{DATASET}speed = 1\n", "unknown key 'speed' in data set 1"),
        (f"[sweep]\nseeds = 1\n{DATASET}name = 1\n", "data set 1: name is not a text"),
        (f"[sweep]\nseeds = 1\n{DATASET}odometry = [1]\n", "odometry is not a list of file names"),
        (f"[sweep]\nseeds = 1\n{DATASET}odometry = []\n", "data set 1: odometry is empty"),
        (f"[sweep]\nseeds = 1\n{DATASET}{DATASET}", "same name: drives/lobby is there twice"),
        (
            "[sweep]\nseeds = 1\nstrategy = 'magic'\n" + DATASET,
            r"\[sweep\] strategy is 'magic', e",
        ),
        (
            "[sweep]\nseeds = 1\nmethod = 'gps'\n" + DATASET,
            r"\[sweep\] method is 'gps', expected",
        ),
        (
            "[sweep]\nseeds = 1\nproposal = ['pnp', 'sonar']\n" + DATASET,
            r"\[sweep\] proposal is 'sonar', expected one of retrieval, pnp, both",
        ),
        (
            "[sweep]\nseeds = 1\nstrategy = 'condensation'\nproposal = ['pnp', 'both']\n" + DATASET,
            r"\[sweep\] proposal: none of the runs has a use for it; leave it out",
        ),
        (
            "[sweep]\nseeds = 1\nparticles = [5, 6]\n[filter]\nmethod = 'pnp'\n" + DATASET,
            r"\[sweep\] particles: none of the runs has a use for it",
        ),
        (
            "[sweep]\nseeds = 1\nparticles = [5, 0]\n" + DATASET,
            r"\[sweep\]: particles 0 is not be",
        ),
        ("[sweep]\nseeds = 1\nparticles = ['5']\n" + DATASET, r"\[sweep\] particles is '5', exp"),
        ("[sweep]\nseeds = 1\ncost = 'l1'\n" + DATASET, r"\[sweep\] cost is 'l1', expected on"),
        (
            "[sweep]\nseeds = 1\ncost = ['zncc', 'zncc']\n" + DATASET,
            r"\[sweep\] cost: zncc is there twice",
        ),
        ("[sweep]\nseeds = 1\n[motion]\nalpha1 = -1\n" + DATASET, r"\[motion\] alpha1: alpha1 -1"),
        ("[sweep]\nseeds = 1\n[fliter]\n" + DATASET, "unknown key 'fliter'"),
        (
            "[sweep]\nseeds = '0-99999'\nparticles = [5, 6]\n" + DATASET,
            "asks for 200000 runs; at most 100000",
        ),
        ("[sweep\n", "is not TOML"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=reason) as caught:
        read_sweep_config(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_names_of_earlier_versions_are_read(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    former = """
    [sweep]
    seeds = 1
    strategy = ["informed", "condensation"]
    proposal = ["appearance", "both"]
    likelihood = ["robust", "zncc"]
    one_pixel_in = [1, 2]
    """
    present = """
    [sweep]
    seeds = 1
    strategy = ["mixture", "condensation"]
    proposal = ["retrieval", "both"]
    cost = ["robust", "zncc"]
    pixel_subsampling = [1, 2]
    """
    path = written(tmp_path, former + DATASET)
    with caplog.at_level(logging.WARNING, logger="pipelines"):
        settings = read_sweep_config(path).settings
    said = {record.getMessage() for record in caplog.records}
    assert f"{path}: [sweep] likelihood is now called cost" in said
    assert "strategy informed is now called mixture" in said
    assert len(said) == 4
    assert settings == read_sweep_config(written(tmp_path, present + DATASET)).settings


def test_options_hold_for_all_runs(tmp_path: Path) -> None:
    path = written(
        tmp_path, "[sweep]\nseeds = 1\nparticles = [5, 6]\n[motion]\nalpha1 = 1\n" + DATASET
    )
    options = {"motion.alpha1": 0.5, "resampling": "residual"}
    settings = read_sweep_config(path, options=options).settings
    assert [chosen.particles for chosen in settings] == [5, 6]
    assert all((s.motion.alpha1, s.resampling) == (0.5, "residual") for s in settings)
    with pytest.raises(OptionError, match=r"particles is given, but .*sweep\.toml varies it"):
        read_sweep_config(path, options={"particles": 7})
