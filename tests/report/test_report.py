"""The report as a whole: files, honesty, safety, errors."""

import base64
import io
import re
import warnings
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from lfnav_cli.common import run_command
from lfnav_cli.report import command
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.localize.run import Run
from pipelines.report.stage import ReportSettings, ReportSummary, chosen_frames, report
from pipelines.report.style import figure_style
from pipelines.report.tracks import tracks_of
from pipelines.report.verdict import frame_ranges, verdict_of
from tests.report_samples import TRUTH, Files, spatial_wall_run, wall_run, written

HOSTILE = '<script>alert("1")</script> & <img src=http://x.example/y> $\\frac{1}{$'


class Collector(HTMLParser):
    """Tags, attributes and text of a page, as a browser would understand them."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.text = ""
        self.body_text = ""
        self._in_style = False
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        self._in_style = tag == "style"

    def handle_data(self, data: str) -> None:
        if self._in_style:
            self._in_style = False
            return
        self.text += data
        if "body" in self.tags:
            self.body_text += data


def page_text(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def first_line(folder: Path) -> str:
    return Collector(page_text(folder)).body_text.strip().splitlines()[0]


def small_report(folder: Path, run: Run) -> ReportSummary:
    files = written(folder, run)
    return report(files.run, folder / "report", ReportSettings(frames=(5,)))


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report about a run whose names were chosen by an attacker."""
    folder = tmp_path_factory.mktemp("hostile")
    run = wall_run(dataset_name=HOSTILE, image_name=HOSTILE + "{}")
    run = replace(run, settings={HOSTILE: HOSTILE}, provenance={"inputs": {HOSTILE: HOSTILE}})
    small_report(folder, run)
    return folder / "report"


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Files:
    return written(tmp_path_factory.mktemp("sample"), wall_run())


@pytest.fixture(scope="module")
def plain(sample: Files) -> Path:
    """The report with default settings."""
    report(sample.run, sample.run.parent / "report", ReportSettings())
    return sample.run.parent / "report"


def test_all_figures_are_there_and_can_be_opened(plain: Path) -> None:
    names = {"overview", "curves", "frame_0000", "frame_0002", "frame_0005"}
    found = {path.name for path in (plain / "figures").iterdir()}
    assert found == {f"{name}.{suffix}" for name in names for suffix in ("png", "pdf")}
    for name in names:
        with Image.open(plain / "figures" / f"{name}.png") as image:
            image.load()
            assert image.width >= 1400
            assert image.height >= 600
        pdf = (plain / "figures" / f"{name}.pdf").read_bytes()
        assert pdf.startswith(b"%PDF-")
        assert pdf.rstrip().endswith(b"%%EOF")
    assert sorted(path.name for path in plain.iterdir()) == ["figures", "report.html"]


def test_page_needs_nothing_beside_it(plain: Path) -> None:
    html = page_text(plain)
    page = Collector(html)
    sources = [value for name, value in page.attributes if name in ("src", "href", "srcset")]
    assert len(sources) == 5
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert "http://" not in html
    assert "https://" not in html
    assert "url(" not in html
    embedded = {base64.b64decode(source.split(",", 1)[1]) for source in sources}
    assert embedded == {path.read_bytes() for path in (plain / "figures").glob("*.png")}


def test_page_says_what_was_measured(plain: Path) -> None:
    text = Collector(page_text(plain)).text
    assert first_line(plain) == "Localized: mean error over the last 5 frames 5.0 cm and 0.0°."
    for fact in ("seed", "42", "noise.turn", "0.1", "area", "not set", "versions.lfnav"):
        assert fact in text
    assert "frames 1 to 5" in text


def test_names_from_files_are_shown_and_never_interpreted(hostile: Path) -> None:
    html = page_text(hostile)
    page = Collector(html)
    assert "script" not in page.tags
    assert "<script" not in html
    assert "<img src=http" not in html
    assert page.tags.count("img") == 3
    # Title, heading, data set, setting and its value, hash and its value, image.
    assert page.text.count(HOSTILE) == 8
    assert re.search(r"default-src 'none'; img-src data:", html)


def test_same_files_give_the_same_report(hostile: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    report(hostile.parent / "run.h5", again, ReportSettings(frames=(5,)))
    files = sorted(hostile.rglob("*.*"))
    assert len(files) == 7
    for path in files:
        assert (again / path.relative_to(hostile)).read_bytes() == path.read_bytes(), path.name


def test_existing_output_stays_without_overwrite(sample: Files, plain: Path) -> None:
    before = page_text(plain)
    result = run_command(command, [str(sample.run), "-o", str(plain), "--frames", "1"])
    assert result == 1
    assert page_text(plain) == before


def test_overwrite_replaces_a_report_but_no_other_folder(sample: Files, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="lfnav did not make it"):
        report(sample.run, mine, ReportSettings(), overwrite=True)
    assert (mine / "thesis.txt").read_text() == "years of work"
    old = tmp_path / "old"
    (old / "figures").mkdir(parents=True)
    (old / "report.html").write_text("old")
    (old / "figures" / "frame_9999.png").write_text("old")
    report(sample.run, old, ReportSettings(frames=(1,), estimate="mean"), overwrite=True)
    assert "estimate \u201cmean\u201d" in page_text(old)
    assert not (old / "figures" / "frame_9999.png").exists()


def test_lost_run_says_so_first(tmp_path: Path) -> None:
    run = wall_run(statuses="gttlll", groundtruth=None)
    summary = small_report(tmp_path, run)
    assert summary.verdict.kind == "bad"
    assert first_line(tmp_path / "report").startswith("Lost: ")
    assert "Errors are unknown: no ground truth" in Collector(page_text(tmp_path / "report")).text


def test_run_without_any_estimate_odometry_or_truth(tmp_path: Path) -> None:
    run = wall_run(statuses="llllll", groundtruth=None, odometry=None)
    small_report(tmp_path, run)
    assert first_line(tmp_path / "report").startswith("Lost: ")


@pytest.mark.parametrize(
    ("run", "kind", "beginning"),
    [
        (wall_run(), "good", "Localized: mean error over the last 5 frames 5.0 cm and 0.0°."),
        (wall_run(offset=0.4), "bad", "Failed, although the filter says tracking: mean error"),
        (wall_run(groundtruth=None), "unknown", "Tracking at the last frame with confidence 0.90;"),
        (wall_run(statuses="gggggg"), "bad", "Not localized: at the last frame the filter was"),
        (wall_run(statuses="tttttl"), "bad", "Lost: "),
        (wall_run(statuses="ttttbb"), "good", "By odometry alone: the last image shows nothing"),
        (wall_run(offset=0.4, statuses="tttttb"), "bad", "By odometry alone: "),
        (wall_run(statuses="tttttb", groundtruth=None), "unknown", "By odometry alone: "),
        (wall_run(groundtruth=np.full((6, 3), np.nan)), "unknown", "Tracking at the last frame"),
    ],
)
def test_verdict_is_honest(run: Run, kind: str, beginning: str) -> None:
    verdict = verdict_of(run, tracks_of(run, None).estimate_errors)
    assert verdict.kind == kind
    assert verdict.sentence.startswith(beginning)


def test_verdict_tells_of_being_lost_in_between() -> None:
    run = wall_run(statuses="gltltt", groundtruth=None)
    assert "It was lost in between, at frames 1, 3." in verdict_of(run, None).sentence


def test_unknown_errors_of_single_frames_are_allowed(tmp_path: Path) -> None:
    truth = TRUTH.copy()
    truth[5] = np.nan
    small_report(tmp_path, wall_run(groundtruth=truth))
    assert "Localized: " in first_line(tmp_path / "report")


@pytest.mark.parametrize(
    ("indices", "text"),
    [([4], "frame 4"), ([0, 1, 2], "frames 0 to 2"), ([1, 3, 4, 5, 9], "frames 1, 3 to 5, 9")],
)
def test_frame_ranges(indices: list[int], text: str) -> None:
    assert frame_ranges(indices) == text


def test_default_frames_are_first_middle_and_last() -> None:
    assert chosen_frames(None, 20) == (0, 9, 19)
    assert chosen_frames(None, 1) == (0,)
    assert chosen_frames((7, 2, 7), 20) == (2, 7)
    with pytest.raises(OptionError, match="no frame 20; its frames are 0 to 19"):
        chosen_frames((20,), 20)


def one_line_error(arguments: list[str]) -> str:
    """What the command prints when it fails, of which there must be one line."""
    runner = CliRunner()
    # The mapping of errors to lines belongs to the front door, not to click.
    # Before click 8.2 both streams are one.
    with runner.isolation() as streams:
        code = run_command(command, arguments)
        printed = "".join(own.getvalue().decode() for own in filter(None, streams[:2]))
    assert code == 1
    lines = printed.strip().splitlines()
    assert len(lines) == 1, printed
    return lines[0]


def test_scene_of_another_run_is_refused(sample: Files, tmp_path: Path) -> None:
    files = written(tmp_path, replace(wall_run(), scene_identifier="0" * 64))
    line = one_line_error([str(files.run), "-o", str(tmp_path / "report")])
    assert str(files.run) in line
    assert "belongs to another scene" in line
    line = one_line_error(
        [str(files.run), "-o", str(tmp_path / "report"), "--scene", str(sample.scene)]
    )
    assert "belongs to another scene" in line
    assert str(sample.scene) in line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.h5", "scene.h5"]


def test_missing_scene_can_be_named(tmp_path: Path) -> None:
    files = written(tmp_path, wall_run())
    moved = files.scene.rename(tmp_path / "moved.h5")
    line = one_line_error([str(files.run), "-o", str(tmp_path / "report")])
    assert str(files.scene) in line
    assert "--scene" in line
    arguments = [str(files.run), "-o", str(tmp_path / "report"), "--scene", str(moved)]
    assert run_command(command, [*arguments, "--frames", "0", "--quiet"]) == 0
    assert (tmp_path / "report" / "report.html").is_file()


def test_camera_image_that_cannot_be_decoded(tmp_path: Path) -> None:
    run = wall_run()
    images = (b"\x89PNG\r\n\x1a\n rubbish", *run.encoded_images[1:])
    files = written(tmp_path, replace(run, encoded_images=images))
    line = one_line_error([str(files.run), "-o", str(tmp_path / "report"), "--frames", "0"])
    assert str(files.run) in line
    assert "frame 0" in line
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--frames", "77"], "no frame 77; its frames are 0 to 5"),
        (["--estimate", "gut_feeling"], "gut_feeling"),
    ],
)
def test_what_the_run_does_not_have(
    sample: Files, tmp_path: Path, options: list[str], words: str
) -> None:
    assert words in one_line_error([str(sample.run), "-o", str(tmp_path / "report"), *options])
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize("frames", ["", "a", "1,,2", "-1", "1.5"])
def test_frames_that_are_no_numbers_are_wrong_usage(frames: str) -> None:
    assert run_command(command, ["run.h5", "-o", "report", "--frames", frames]) == 2


def test_figures_do_not_depend_on_the_users_settings_nor_change_them() -> None:
    with mpl.rc_context({"font.size": 40.0, "axes.grid": True}):
        with figure_style():
            assert mpl.rcParams["font.size"] == 10.0
            assert not mpl.rcParams["axes.grid"]
            assert not mpl.rcParams["text.parse_math"]
        assert mpl.rcParams["font.size"] == 40.0


def test_names_in_scripts_that_the_font_lacks_give_no_warning(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        small_report(tmp_path, wall_run(image_name="\u6b63\u9580/{}.png"))


def test_png_is_what_the_page_shows(plain: Path) -> None:
    first = re.search(r"base64,([A-Za-z0-9+/=]+)", page_text(plain))
    assert first is not None
    with Image.open(io.BytesIO(base64.b64decode(first.group(1)))) as shown:
        assert shown.format == "PNG"


def test_blind_frames_are_told_on_the_page(tmp_path: Path) -> None:
    small_report(tmp_path, wall_run(statuses="gttbbt"))
    text = page_text(tmp_path / "report")
    assert "blind, by odometry alone" in text
    assert "frames 3 to 4" in text


def test_a_spatial_run_is_reported_as_seen_from_above(tmp_path: Path) -> None:
    run = spatial_wall_run()
    small_report(tmp_path, run)
    assert "Localized: " in first_line(tmp_path / "report")
    tracks = tracks_of(run, None)
    above = wall_run()
    planar = tracks_of(above, None)
    # The camera looks along the robot's heading, and the mount is straight above the robot.
    np.testing.assert_allclose(tracks.estimated, planar.estimated, atol=1e-9)
    assert tracks.groundtruth is not None
    np.testing.assert_allclose(tracks.groundtruth, TRUTH, atol=1e-9)
    assert tracks.estimated_states.shape == (6, 6)
