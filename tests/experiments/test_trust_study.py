"""The study of trust: on a drive along the painted wall, and on what cannot be run."""

import json
import math
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.images import encode_png
from pipelines.experiments.disturbed_sequences import disturbances
from pipelines.experiments.null_images import null_image_disturbances
from pipelines.experiments.trust_conditions import TrustConditions, read_trust_conditions
from pipelines.experiments.trust_stage import study_trust
from pipelines.experiments.trust_study import disturbed_starts, rows_of, tasks_of
from pipelines.experiments.trust_table import as_json, as_markdown, sums_of
from pipelines.geometry.pose import world_from_base_planar
from pipelines.geometry.trajectory import Trajectory, format_tum
from pipelines.lightfield.scene_file import save_scene
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR
from pipelines.render.choices import Channels
from tests.report_samples import photo
from tests.sequence_samples import SCENE, TRUTH

ROOT = Path(__file__).parents[2]
FRAMES = 4
TIMES = np.linspace(10.0, 11.5, FRAMES)
CAMERA_TOML = """model = "SIMPLE_PINHOLE"
width = 48
height = 36
params = [24.0, 23.5, 17.5]

[mount]
x = 0.0
y = 0.0
z = 1.0
roll = 0.0
pitch = 0.0
yaw = 0.0
"""
FILTER = """
[filter]
particles = 60
start_particles = 2000

[rendering]
coarse_width = 12
fine_width = 24
refine_width = 48
"""
CONDITIONS = (
    """
[study]
seeds = "0-1"

[scenes]
wall = "scene.h5"

[[condition]]
name = "along"
scene = "wall"
path = "drive"
odometry = ["odometry.txt"]

[[condition]]
name = "nowhere"
scene = "wall"
path = "noise"
elsewhere = true
seeds = [3]

[[condition]]
name = "starts"
scene = "wall"
path = "drive"
starts = 2
seeds = [0]

[condition.start]
start_position_sigma = 0.05
start_heading_sigma_deg = 2.0

[[condition]]
name = "another day"
scene = "wall"
data = "days/noise"
elsewhere = true
"""
    + FILTER
)


def write_drive(folder: Path, *, is_noise: bool) -> None:
    """The first frames along the wall; or noise, of which nobody knows where it is."""
    (folder / "rgb").mkdir(parents=True)
    rng = np.random.default_rng(2)
    lines = []
    for number, time in enumerate(TIMES):
        image = photo(TRUTH[number])
        shown = rng.integers(0, 256, image.shape, dtype=np.uint8) if is_noise else image
        (folder / f"rgb/{number}.png").write_bytes(encode_png(shown))
        lines.append(f"{time:.1f} rgb/{number}.png")
    (folder / "rgb.txt").write_text("\n".join(lines) + "\n")
    (folder / "camera.toml").write_text(CAMERA_TOML)
    text = format_tum(Trajectory(TIMES, world_from_base_planar(TRUTH[:FRAMES])))
    (folder / "odometry.txt").write_text(text)
    if not is_noise:
        (folder / "groundtruth.txt").write_text(text)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("study")
    save_scene(root / "scene.h5", SCENE, overwrite=False)
    write_drive(root / "drive", is_noise=False)
    write_drive(root / "noise", is_noise=True)
    (root / "study.toml").write_text(CONDITIONS)
    return root


@pytest.fixture(scope="module")
def result(folder: Path) -> tuple[Path, TrustConditions]:
    chosen = read_trust_conditions(folder / "study.toml")
    study_trust(chosen, folder / "out", workers=1, overwrite=False, progress=no_progress)
    return folder / "out", chosen


def test_each_condition_has_a_row(result: tuple[Path, TrustConditions]) -> None:
    content = json.loads((result[0] / "table.json").read_text())
    along, nowhere, starts = content["conditions"]
    assert (along["condition"], along["odometry"], along["runs"]) == ("along", "odometry.txt", 2)
    assert (along["frames"], along["successes"]) == (2 * FRAMES, 2)
    assert along["frames_right"] >= 6
    assert along["median_position_error_of_right_m"] < 0.1
    # Noise has no true pose, so nothing is right; and it is not the drive's one seed.
    assert (nowhere["runs"], nowhere["frames"], nowhere["frames_right"]) == (1, FRAMES, 0)
    assert nowhere["frames_wrong"] + nowhere["frames_silent"] == FRAMES
    assert (nowhere["successes"], nowhere["in_95_region"]) == (None, None)
    # Each frame for itself, twice.
    assert (starts["runs"], starts["frames"], starts["odometry"]) == (8, 8, "-")
    assert starts["frames_right"] >= 6
    in_map, elsewhere, everything = content["sums"]
    # Single frames, whose start was given, are no part of it.
    assert in_map["frames"] == along["frames"]
    assert elsewhere["frames"] == FRAMES
    assert everything["frames"] == in_map["frames"] + FRAMES
    assert (in_map["successes"], everything["successes"]) == (2, None)
    assert sum(item["forecasts"] for item in everything["reliability"]) == everything["frames"]


def test_the_table_says_what_was_skipped(result: tuple[Path, TrustConditions]) -> None:
    output, chosen = result
    text = (output / "table.md").read_text()
    assert chosen.skipped == ("another day",)
    assert "Skipped, since their data are absent: another day." in text
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len({row.count("|") for row in rows}) == 1
    assert rows[2].startswith("| along | odometry.txt | filter | 2 of 2 | ")
    with Image.open(output / "reliability.png") as image:
        assert image.width > 900


def test_two_processes_find_the_same(folder: Path, result: tuple[Path, TrustConditions]) -> None:
    chosen = read_trust_conditions(folder / "study.toml", data=folder)
    assert chosen.skipped == ("another day",)
    rows = rows_of(chosen.conditions[:2], workers=2, progress=no_progress)
    before = json.loads((result[0] / "table.json").read_text())["conditions"][:2]
    assert json.loads(as_json(rows, []))["conditions"] == before
    assert "Skipped" not in as_markdown(rows, [])
    assert [row.name for row in sums_of(rows[:1])] == ["all, in the map"]


def test_each_choice_of_channels_has_a_row_and_a_sum(folder: Path) -> None:
    text = CONDITIONS.replace("[study]", '[study]\nchannels = ["colour", "mixed"]', 1)
    text = text.replace('["odometry.txt"]', '["odometry.txt"]\nmethod = ["filter", "pnp"]', 1)
    (folder / "channels.toml").write_text(text)
    along = read_trust_conditions(folder / "channels.toml", seeds="0").conditions[0]
    tasks = tasks_of([along], 1)
    names = ["filter, colour", "filter, mixed", "pnp"]
    assert [task.method_name for task in tasks] == names
    assert [task.settings.likelihood.channels for task in tasks[:2]] == [
        Channels.COLOUR,
        Channels.MIXED,
    ]
    # Nothing else of the comparison has changed.
    for task in tasks[:2]:
        likelihood = replace(task.settings.likelihood, channels=Channels.CONTRAST)
        assert likelihood == along.settings.likelihood
    rows = rows_of([replace(along, methods=("filter",))], workers=1, progress=no_progress)
    assert [row.method for row in rows] == names[:2]
    assert [row.method for row in sums_of(rows)] == names[:2]
    assert rows[0].trust.position_errors.tolist() != rows[1].trust.position_errors.tolist()
    assert min(row.trust.right.sum() for row in rows) >= FRAMES - 1


def test_data_are_looked_for_where_they_are_said_to_be(folder: Path, tmp_path: Path) -> None:
    write_drive(tmp_path / "days/noise", is_noise=True)
    chosen = read_trust_conditions(folder / "study.toml", data=tmp_path, seeds="7")
    assert chosen.skipped == ()
    assert chosen.conditions[-1].dataset == tmp_path / "days/noise"
    assert {condition.seeds for condition in chosen.conditions} == {(7,)}
    other = tmp_path / "other.h5"
    save_scene(other, SCENE, overwrite=False)
    scenes = {"wall": other}
    chosen = read_trust_conditions(folder / "study.toml", scenes=scenes)
    assert {condition.scene for condition in chosen.conditions} == {other}
    with pytest.raises(OptionError, match="scene 'hall' is none of wall"):
        read_trust_conditions(folder / "study.toml", scenes={"hall": other})


def test_starts_lie_as_far_from_the_truth_as_the_filter_is_told(folder: Path) -> None:
    dataset = load_dataset(folder / "drive")
    settings = LocalizerSettings(start_position_sigma=0.3, start_heading_sigma=0.1)
    drawn = list(disturbed_starts(dataset, settings, 500, [4]))
    assert len(drawn) == 500 * FRAMES
    offsets = []
    for number, (single, chosen, _) in enumerate(drawn):
        assert single.image_names == (f"rgb/{number // 500}.png",)
        assert chosen.start is not None
        offsets.append(PLANAR.difference(np.array(chosen.start), TRUTH[number // 500]))
    spread = np.std(offsets, axis=0)
    assert spread == pytest.approx([0.3, 0.3, 0.1], rel=0.06)
    assert np.abs(np.mean(offsets, axis=0)).max() < 0.03
    again = list(disturbed_starts(dataset, settings, 500, [4]))
    assert [item[1].start for item in again] == [item[1].start for item in drawn]
    assert list(disturbed_starts(load_dataset(folder / "noise"), settings, 2, [0])) == []


def test_what_cannot_be_run_is_said(folder: Path) -> None:
    chosen = read_trust_conditions(folder / "study.toml")
    (folder / "broken").mkdir()
    write_drive(folder / "broken/drive", is_noise=False)
    (folder / "broken/drive/rgb/2.png").write_bytes(b"no image")
    text = CONDITIONS.replace('path = "drive"', 'path = "broken/drive"')
    (folder / "broken.toml").write_text(text)
    with pytest.raises(StageError, match=r"along, odometry\.txt: .*2\.png"):
        rows_of(
            read_trust_conditions(folder / "broken.toml").conditions,
            workers=1,
            progress=no_progress,
        )
    with pytest.raises(OptionError, match="0 workers"):
        rows_of(chosen.conditions, workers=0, progress=no_progress)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "along"', "name = 3", "condition 1: name is not a text"),
        ('name = "along"\n', "", "condition 1: name is missing"),
        ('name = "along"', 'name = "nowhere"', "two conditions have the same name"),
        ('scene = "wall"', 'scene = "hall"', "scene 'hall' is unknown; .* wall"),
        (
            'wall = "scene.h5"',
            'wall = "other.h5"',
            "other.h5: is missing: the scene of condition 1",
        ),
        ("elsewhere = true", "elsewhere = 1", "condition 2: elsewhere is not true or false"),
        (
            "elsewhere = true",
            "elsewhere = false",
            "noise/groundtruth.txt: is missing: .* elsewhere",
        ),
        ("starts = 2", "starts = 0.5", "condition 3: starts is not a whole number"),
        ("starts = 2", "starts = -1", "condition 3: starts is not between 0 and"),
        ("starts = 2", 'starts = 2\nmethod = "pnp"', "condition 3: starts are of no use to pnp"),
        ("starts = 2", "starts = 2\nelsewhere = true", "no true pose to start around"),
        ("start_position_sigma = 0.05", "start = [0, 0, 0]", "starts are drawn, but .* a pose"),
        (
            "start_position_sigma = 0.05",
            "start_position_sigma = -1",
            "condition 3: start_position_sigma",
        ),
        ("starts = 2", "speed = 2", "unknown key 'speed' in condition 3"),
        ('path = "noise"', 'path = "noise"\ndata = "x"', "condition 2 needs either path or data"),
        ('path = "noise"', 'path = "nothing"', "nothing: is missing: the sequence of condition 2"),
        ('data = "days/noise"', 'data = "../x"', "leads out of the folder of --data"),
        ('odometry = ["odometry.txt"]', 'odometry = "o"\nmethod = "ekf"', "one of filter, pnp"),
        ('odometry = ["odometry.txt"]', "odometry = [1]", "odometry is not a list of file names"),
        ('seeds = "0-1"', 'seeds = "a"', "study. seeds: 'a' is no seed"),
        ('"0-1"', '"0-1"\nchannels = ["red"]', "channels are not some of colour, contrast, gradi"),
        ('"0-1"', '"0-1"\nchannels = [1]', "channels are not some of colour"),
        ('"0-1"', '"0-1"\nchannels = []', "channels is empty"),
        ('"0-1"', '"0-1"\nchannels = ["mixed", "mixed"]', "channels: mixed is there twice"),
        ("[study]", "[studies]", "unknown key 'studies' in the file"),
        ("[filter]", '[filter]\nmethod = "pnp"', "its method stands in"),
    ],
)
def test_conditions_that_make_no_sense_are_refused(
    folder: Path, tmp_path: Path, old: str, new: str, message: str
) -> None:
    for name in ("scene.h5", "drive", "noise"):
        (tmp_path / name).symlink_to(folder / name)
    text = CONDITIONS.replace(old, new, 1)
    assert text != CONDITIONS
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_trust_conditions(tmp_path / "study.toml")


def test_the_script_prints_the_table_or_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script: dict[str, Any] = runpy.run_path(str(ROOT / "experiments/trust.py"))
    for name in ("scene.h5", "noise"):
        (tmp_path / name).symlink_to(folder / name)
    start, _, rest = CONDITIONS.partition("[[condition]]")
    only = start + "[[condition]]" + rest.split("[[condition]]")[-1]
    (tmp_path / "days.toml").write_text(only)
    output = tmp_path / "out"
    arguments = [str(tmp_path / "days.toml"), "-o", str(output)]
    assert script["main"](arguments) == 1
    error = capsys.readouterr().err
    assert "all of its conditions are skipped: no data in any folder; give the folder" in error
    assert error.count("\n") == 1
    assert not output.exists()
    assert script["main"]([*arguments, "--scene", "wall"]) == 1
    assert capsys.readouterr().err == "trust.py: --scene needs NAME=FILE\n"
    write_drive(tmp_path / "data/days/noise", is_noise=True)
    assert script["main"]([*arguments, "--data", str(tmp_path / "data"), "--seeds", "1"]) == 0
    assert "| another day | odometry.txt | filter | - | 0.0 |" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["trust", "days", "channels"])
def test_the_projects_conditions_name_what_make_makes(name: str, tmp_path: Path) -> None:
    text = (ROOT / f"experiments/conditions/{name}.toml").read_text()
    made = {
        **{f"out/experiments/disturbed/{kind.name}": kind.has_truth for kind in disturbances(20)},
        **{
            f"out/experiments/troubles/{kind.name}": kind.has_truth
            for kind in null_image_disturbances(20)
        },
        "sample_data/elevators/test": True,
        "sample_data/workshop/test": True,
    }
    for drive, has_truth in made.items():
        (tmp_path / drive).mkdir(parents=True)
        if has_truth:
            (tmp_path / drive / "groundtruth.txt").touch()
    for scene in ("elevators", "workshop", "depth-maps/elevators", "depth-maps/workshop"):
        (tmp_path / "out/experiments" / scene).mkdir(parents=True, exist_ok=True)
        (tmp_path / "out/experiments" / scene / "scene.h5").touch()
    path = tmp_path / f"experiments/conditions/{name}.toml"
    path.parent.mkdir(parents=True)
    path.write_text(text)
    chosen = read_trust_conditions(path)
    if name == "days":
        assert chosen.conditions == ()
        assert len(chosen.skipped) == 13
        return
    for condition in chosen.conditions:
        assert condition.dataset.resolve().is_relative_to(tmp_path)
        if condition.starts:
            assert condition.settings.start_heading_sigma == pytest.approx(math.radians(10.0))
    assert len(chosen.conditions) == (17 if name == "trust" else 7)
    # All there are; or as the settings say.
    assert set(chosen.conditions[0].channels) == (set() if name == "trust" else set(Channels))
    # No path leads out of the project.
    assert not [line for line in text.splitlines() if '"/' in line or '"../../../' in line]
