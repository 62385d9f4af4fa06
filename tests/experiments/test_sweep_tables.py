"""The table of a sweep, against figures computed by hand."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.json_fields import JsonFields
from pipelines.experiments.sweep_plots import PLOTS, figure_of, write_plots
from pipelines.experiments.sweep_result import RunResult
from pipelines.experiments.sweep_run import Setup
from pipelines.experiments.sweep_tables import Line, as_csv, as_json, as_markdown, lines_of

GOOD = RunResult(
    success=True,
    position_error_m=0.02,
    heading_error_deg=0.5,
    median_position_error_m=0.03,
    median_heading_error_deg=0.6,
    settled_position_error_m=0.025,
    settled_heading_error_deg=0.4,
    close_share=0.95,
    frames_until_converged=2,
    frames_to_recover=1,
    frames=20,
    in_95_region=0.9,
    frames_blind=0,
    confidence_blind=None,
    confidence=0.8,
    cpu_seconds_per_frame=0.25,
    seconds_per_frame=0.75,
    seconds_while_searching=1.0,
    seconds_while_tracking=0.125,
    frames_right=18,
    frames_silent=2,
    frames_wrong=0,
    wrong_at_the_end=False,
    # 2 frames that say 5 % and are never close, 18 that say 95 % and nearly always are.
    confidence_sums=((2.0, 0.1, 0.0), *((0.0, 0.0, 0.0),) * 8, (18.0, 17.1, 17.0)),
)
WRONG = replace(
    GOOD,
    success=False,
    position_error_m=3.0,
    heading_error_deg=40.0,
    frames_until_converged=None,
    frames_to_recover=None,
    frames_right=0,
    frames_silent=5,
    frames_wrong=15,
    wrong_at_the_end=True,
    confidence_sums=((5.0, 0.0, 0.0), *((0.0, 0.0, 0.0),) * 8, (15.0, 15.0, 0.0)),
)
LOST = replace(
    WRONG,
    position_error_m=None,
    heading_error_deg=None,
    median_position_error_m=None,
    median_heading_error_deg=None,
    settled_position_error_m=None,
    settled_heading_error_deg=None,
    close_share=0.0,
    in_95_region=None,
    confidence=None,
    seconds_while_tracking=None,
)
DARK = replace(GOOD, frames_blind=5, confidence_blind=0.0)
HERE = Setup("lobby", "odometry.txt", "filter", "mixture", "retrieval", "robust", 195)
PNP = Setup("lobby", "odometry.txt", "pnp", None, None, None, None)
THERE = replace(HERE, dataset="a|b", particles=50)


@given(st.integers(1, 200), st.data())
def test_the_interval_is_wilsons(runs: int, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, runs))
    results = (GOOD,) * successes + (WRONG,) * (runs - successes)
    low, high = Line(HERE, results, 0).interval
    # Wilson (1927), with the 97.5 % quantile of the normal distribution.
    z, share = 1.959963984540054, successes / runs
    centre = (share + z**2 / (2 * runs)) / (1 + z**2 / runs)
    root = math.sqrt(share * (1 - share) / runs + z**2 / (4 * runs**2))
    half = z / (1 + z**2 / runs) * root
    assert (low, high) == pytest.approx((centre - half, centre + half), abs=1e-9)


def test_quantiles_are_those_of_runs() -> None:
    errors = [0.5, 0.1, 0.4, 0.2, 0.3, 0.7, 0.6, 0.8, 0.9, 1.0]
    line = Line(HERE, tuple(replace(GOOD, position_error_m=error) for error in errors), 0)
    quantiles = [line.quantile("position_error_m", share) for share in (0.1, 0.5, 0.9)]
    assert quantiles == [0.1, 0.5, 0.9]


def test_what_never_happened_takes_infinitely_long_but_no_time() -> None:
    line = Line(HERE, (GOOD, GOOD, LOST), 0)
    assert line.quantile("position_error_m", 0.5) == 0.02
    assert math.isinf(line.quantile("position_error_m", 0.9))
    assert math.isinf(line.quantile("frames_until_converged", 0.9))
    assert line.quantile("seconds_while_tracking", 0.9) == 0.125
    assert math.isnan(Line(HERE, (LOST,), 0).quantile("seconds_while_tracking", 0.5))


def test_lines_gather_the_seeds_of_a_setup() -> None:
    outcomes = [(THERE, GOOD), (HERE, None), (THERE, WRONG), (HERE, None), (THERE, None)]
    there, here = lines_of(outcomes)
    assert (there.setup, there.results, there.broken) == (THERE, (GOOD, WRONG), 1)
    assert (here.setup, here.results, here.broken) == (HERE, (), 2)
    assert (there.successes, there.success_rate) == (1, 0.5)
    assert math.isnan(here.success_rate)
    assert here.interval == (0.0, 1.0)


LINES = lines_of([(HERE, GOOD), (HERE, GOOD), (HERE, LOST), (THERE, None)])


def test_csv_and_json_say_the_same() -> None:
    content = json.loads(as_json(LINES, ["it broke"]))
    assert content["failures"] == ["it broke"]
    first, second = content["lines"]
    assert (first["dataset"], first["particles"], first["runs"]) == ("lobby", 195, 3)
    assert (first["successes"], first["success_rate"]) == (2, pytest.approx(2 / 3))
    assert (first["position_error_m_q50"], first["position_error_m_q90"]) == (0.02, None)
    assert (first["in_95_region"], first["good_at_the_end"]) == (0.9, 2)
    assert (first["right_share"], first["wrong_share"]) == (36 / 60, 15 / 60)
    assert (first["silent_share"], first["wrong_at_the_end"]) == (9 / 60, 1)
    assert first["calibration_error"] == pytest.approx((0.2 + (17.1 - 17.0) * 2 + 15.0) / 60)
    assert second["calibration_error"] is None
    assert first["close_share"] == pytest.approx(1.9 / 3.0)
    assert (second["runs"], second["broken"], second["success_rate"]) == (0, 1, None)
    for row, line in zip(csv.DictReader(as_csv(LINES).splitlines()), content["lines"], strict=True):
        assert {name: value or None for name, value in row.items()} == {
            name: None if value is None else str(value) for name, value in line.items()
        }


def test_markdown_is_a_table_that_names_what_broke() -> None:
    text = as_markdown(LINES, ["a|b, seed 3: no image"])
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len({row.count("|") for row in rows}) == 1
    assert "| lobby | odometry.txt | mixture | robust | 195 | 2 of 3 | 21 to 94 % |" in rows[2]
    assert "| 2.0, never | 0.50, never | 2.5, never | 0.40, never | 2, never |" in rows[2]
    assert rows[2].endswith("| 2 of 3 | 1, never | 90 % | 60, 15, 25 | 1 of 3 | 0.26 | 0.250 |")
    assert "| a/b | " in rows[3]
    assert "0 of 0 (1 broke)" in rows[3]
    assert "Runs that broke: 1." in text
    assert "- a|b, seed 3: no image" in text


def test_what_is_compared_is_named() -> None:
    setups = (replace(HERE, proposal="both"), replace(HERE, strategy="condensation"), PNP)
    rows = as_markdown(lines_of([(setup, GOOD) for setup in setups]), []).splitlines()[2:5]
    assert "| mixture, proposal both | robust | 195 |" in rows[0]
    assert "| condensation | robust | 195 |" in rows[1]
    assert "| pnp | - | - |" in rows[2]


def test_images_that_show_nothing_have_a_table_of_their_own() -> None:
    assert "show nothing" not in as_markdown(LINES, [])
    text = as_markdown(lines_of([(HERE, DARK), (HERE, DARK), (PNP, GOOD)]), [])
    assert "| lobby | odometry.txt | mixture | 5.0 | 0.00 | 0.80 |" in text.splitlines()
    assert "| lobby | odometry.txt | pnp | 0.0" not in text


@pytest.mark.parametrize("result", [GOOD, WRONG, LOST, DARK])
def test_results_are_read_as_they_were_written(result: RunResult) -> None:
    values = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert RunResult.of_json(JsonFields(Path("x.json"), values)) == result


@pytest.mark.parametrize("name", GOOD.to_dict())
@pytest.mark.parametrize("value", ["", [], {}])
def test_results_of_another_kind_are_refused(name: str, value: Any) -> None:
    good = json.loads(json.dumps(GOOD.to_dict()))
    without = {key: item for key, item in good.items() if key != name}
    for values in ({**good, name: value}, without):
        with pytest.raises(InputError, match=name):
            RunResult.of_json(JsonFields(Path("x.json"), values))


@pytest.mark.parametrize("sums", [[[1.0, 2.0, 3.0]], [["a", 0, 0]] * 10, [[math.inf, 0, 0]] * 10])
def test_sums_of_another_shape_are_refused(sums: list[list[Any]]) -> None:
    values = {**GOOD.to_dict(), "confidence_sums": sums}
    with pytest.raises(InputError, match="confidence_sums"):
        RunResult.of_json(JsonFields(Path("x.json"), values))


def test_figures_show_every_line(tmp_path: Path) -> None:
    write_plots(tmp_path, LINES)
    for plot in PLOTS:
        with Image.open(tmp_path / f"{plot.name}.png") as image:
            assert image.width > 300
    success = figure_of(PLOTS[0], lines_of([(HERE, GOOD), (HERE, WRONG), (THERE, GOOD)]))
    shown = [np.concatenate([line.get_ydata() for line in axes.lines]) for axes in success.axes]
    assert [values.tolist() for values in shown] == [[50.0], [100.0]]
    assert [axes.get_title() for axes in success.axes] == [
        "lobby\nodometry.txt",
        "a|b\nodometry.txt",
    ]


def test_what_has_no_particles_is_a_line_across() -> None:
    axes = figure_of(PLOTS[0], lines_of([(HERE, GOOD), (PNP, GOOD), (PNP, WRONG)])).axes[0]
    shown = {line.get_label(): np.asarray(line.get_ydata()).tolist() for line in axes.lines}
    assert shown == {"mixture, robust": [100.0], "pnp": [50.0, 50.0]}
    assert [label.get_text() for label in axes.get_xticklabels()] == ["195"]


def test_a_figure_says_when_runs_lie_beyond_it() -> None:
    convergence = next(plot for plot in PLOTS if plot.name == "convergence")
    axes = figure_of(convergence, LINES[:1]).axes[0]
    shown = np.concatenate([line.get_ydata() for line in axes.lines])
    assert shown.tolist() == [2.0, axes.get_ylim()[1]]
