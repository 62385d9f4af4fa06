"""Settings of ``lfnav dock``: those of the localization by the same names, and its own."""

import math
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from pipelines.artifacts.errors import InputError, OptionError
from pipelines.dock.config import DOCK_ENTRIES, effective_settings, settings_of, settings_text
from pipelines.dock.settings import DockSettings
from pipelines.dock.settings_page import settings_page
from pipelines.dock.stage import DockRequest
from pipelines.localize.config import ENTRIES
from pipelines.localize.settings import LocalizerSettings
from tests.chain_samples import lfnav, succeed


def written(folder: Path, text: str) -> Path:
    path = folder / "dock.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_no_setting_is_forgotten_and_no_name_is_there_twice() -> None:
    assert [entry.path for entry in DOCK_ENTRIES] == [field.name for field in fields(DockSettings)]
    # Two attributes keep the names that their options had.
    names = [name for entry in (*ENTRIES, *DOCK_ENTRIES) for name in entry.names]
    assert len(set(names)) == len(names)


def test_what_is_printed_is_read_back(tmp_path: Path) -> None:
    both = settings_of({"drive": "diff", "largest_turn": math.radians(25.0), "particles": 50})
    assert effective_settings(written(tmp_path, settings_text(both)), {}) == both
    assert effective_settings(None, {}) == (LocalizerSettings(), DockSettings())


def test_options_win_over_the_file_and_it_over_defaults(tmp_path: Path) -> None:
    path = written(tmp_path, "[dock]\nmax_steps = 7\npatience = 3\n[rendering]\nfine_width = 48\n")
    options = ("--max-steps", "9", "--start", "1,2,90", "--area", "0,1,2,3", "--largest-turn", "30")
    content = tomllib.loads(succeed("dock", "--print-config", "--config", path, *options))
    dock = content["dock"]
    assert (dock["max_steps"], dock["patience"], dock["max_attempts"]) == (9, 3.0, 4)
    assert dock["largest_turn_deg"] == 30.0
    assert content["rendering"]["fine_width"] == 48
    assert content["start"]["start"] == [1.0, 2.0, 90.0]
    assert content["start"]["area"] == [0.0, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[dock]\nspeed = 1\n", r"unknown key 'speed' in \[dock\]; known are drive, largest_step"),
        ("[dock]\ndrive = 'fly'\n", r"\[dock\] drive is 'fly', expected one of omni, diff"),
        ("[dock]\nmax_steps = 0\n", r"\[dock\] max_steps: max_steps 0 is not between 1 and"),
        ("[filter]\nparticles = 0\n", r"\[filter\] particles: particles 0 is not between 1"),
        (
            "[dock]\nrobot_radius = 0.5\nleast_distance = 0.2\n",
            r"\[dock\] robot_radius: a robot of radius 0.5 m touches the surface",
        ),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=reason) as caught:
        effective_settings(path, {})
    assert "\n" not in str(caught.value)
    outcome = lfnav("dock", "--print-config", "--config", path)
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith(f"lfnav: {path}: ")


def test_without_a_scene_or_a_robot_there_is_nothing_to_dock() -> None:
    for arguments in ((), ("scene.h5",)):
        outcome = lfnav("dock", *arguments)
        assert outcome.code == 2
        assert "Missing" in outcome.err


def test_docking_goes_by_the_filter_alone() -> None:
    for settings in (LocalizerSettings(method="pnp"), LocalizerSettings(proposal="both")):
        with pytest.raises(OptionError, match="docking goes by the filter alone"):
            DockRequest(Path("scene.h5"), "robot", None, settings)


def test_the_page_of_the_docs_is_up_to_date() -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "settings.md"
    assert page.read_text(encoding="utf-8") == settings_page(), "make docs-settings"


def test_the_page_names_every_setting_and_every_former_name() -> None:
    page = settings_page()
    for entry in (*ENTRIES, *DOCK_ENTRIES):
        assert f"\n| `{entry.name}` | `{entry.default_text}` |" in page
        for former in entry.setting.former:
            assert f"`{former}`" in page
