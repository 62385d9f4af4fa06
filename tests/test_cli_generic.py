"""What every subcommand has in common: help, exit codes, one-line errors, a light start."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfnav_cli import common
from lfnav_cli.main import COMMANDS, main, module_of, stop_cleanly
from pipelines.artifacts.errors import InputError, StageError

HEAVY = {"numpy", "scipy", "cv2", "pycolmap", "matplotlib", "h5py", "PIL", "tqdm", "wgpu"}

# Arguments with which each command gets as far as looking at its input, which does not exist.
INPUT_IS_MISSING = {
    "import": ["missing", "-o", "output"],
    "reconstruct": ["missing", "-o", "output", "--method", "odometry"],
    "model": ["missing", "-o", "output"],
    "render": ["missing", "-o", "output", "--pose", "0,0,0"],
    "localize": ["missing", "missing-data", "-o", "output"],
    "serve": ["missing", "--port", "0"],
    "dock": ["missing", "-o", "output", "--robot", "model:missing", "--goal", "0,0,0"],
    "ros localize": ["missing"],
    "ros dock-detector": ["missing", "--goal", "0,0,0"],
    "evaluate": ["missing"],
    "report": ["missing", "-o", "output"],
    "sweep": ["missing", "-o", "output"],
    "export": ["missing", "-o", "output", "--format", "tum"],
    "info": ["missing"],
}

# Groups have commands of their own.
GROUPS = {"ros": ("localize", "dock-detector")}
LEAVES = [name for name in COMMANDS if name not in GROUPS]
LEAVES += [f"{group} {name}" for group, names in GROUPS.items() for name in names]

every_command = pytest.mark.parametrize("name", LEAVES)
# The demonstration brings its own.
every_command_with_input = pytest.mark.parametrize("name", [n for n in LEAVES if n != "demo"])


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of the command line."""
    code = common.run_command(main, arguments)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def assert_one_line(text: str) -> None:
    assert text.startswith("lfnav: ")
    assert text.count("\n") == 1
    assert text.endswith("\n")


@pytest.mark.parametrize(
    "arguments", [["--help"], *([*name.split(), "--help"] for name in [*COMMANDS, *LEAVES])]
)
def test_help_loads_nothing_heavy(arguments: list[str]) -> None:
    program = (
        "import json, sys\n"
        "from lfnav_cli import common\n"
        "from lfnav_cli.main import main\n"
        f"code = common.run_command(main, {arguments!r})\n"
        "print(json.dumps(sorted(sys.modules)), file=sys.stderr)\n"
        "sys.exit(code)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60
    )
    assert result.returncode == 0, result.stderr
    assert "Usage: lfnav" in result.stdout
    loaded = set(json.loads(result.stderr))
    assert "click" in loaded
    assert not loaded & HEAVY


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(["--help"], capsys)
    assert code == 0
    assert "Example:" in out
    for name in COMMANDS:
        assert f"\n  {name} " in out


def test_commands_and_modules_are_the_same() -> None:
    folder = Path(common.__file__).parent
    modules = {path.stem for path in folder.glob("*.py")} - {
        "__init__",
        "main",
        "common",
        "setting_options",
    }
    assert modules == {module_of(name) for name in COMMANDS}


@every_command
def test_help_has_an_example_and_the_common_options(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run([*name.split(), "--help"], capsys)
    assert code == 0, err
    assert "Example:" in out
    assert f"lfnav {name}" in out.split("Example:")[1]
    assert "--verbose" in out
    assert "--quiet" in out
    if "--output" in out:
        assert "--overwrite" in out


@every_command
def test_every_option_is_explained(name: str) -> None:
    command: click.Command | None = main
    for part in name.split():
        assert isinstance(command, click.Group)
        command = command.get_command(click.Context(command), part)
    assert command is not None
    options = [item for item in command.params if isinstance(item, click.Option)]
    assert options
    assert [option.name for option in options if not option.help] == []


@every_command_with_input
def test_missing_input_is_one_line_and_leaves_nothing(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = run([*name.split(), *INPUT_IS_MISSING[name]], capsys)
    assert code == 1
    assert out == ""
    assert_one_line(err)
    assert "missing" in err
    assert list(tmp_path.iterdir()) == []


@every_command
def test_verbose_and_quiet_exclude_each_other(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    inputs = INPUT_IS_MISSING.get(name, [])
    code, _, err = run([*name.split(), *inputs, "--verbose", "--quiet"], capsys)
    assert code == 2
    assert_one_line(err)
    assert "--verbose and --quiet" in err


@pytest.mark.parametrize(
    ("name", "wrong"),
    [*((name, ["--no-such-option"]) for name in LEAVES), *((n, []) for n in INPUT_IS_MISSING)],
)
def test_wrong_usage(name: str, wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run([*name.split(), *wrong], capsys)
    assert code == 2
    assert out == ""
    assert_one_line(err)
    assert f"lfnav {name} --help" in err


def test_unknown_command(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(["teleport"], capsys)
    assert code == 2
    assert_one_line(err)
    assert "teleport" in err


def test_no_command_shows_the_help_as_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run([], capsys)
    assert code == 2
    assert out == ""
    assert "Usage: lfnav" in err


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(["--version"], capsys)
    assert code == 0
    assert version("lfnav") in out


def failing(error: BaseException) -> click.Command:
    @click.command()
    @common.common_options
    def command(progress: object) -> None:
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (InputError("map.h5", "is\ntruncated", "make it again"), 1, "map.h5: is truncated; make"),
        (StageError("nothing matched"), 1, "nothing matched"),
        (OSError(28, "No space left on device", "x.h5"), 1, "No space left on device"),
        (MemoryError(), 1, "out of memory"),
        (KeyError("pose"), 1, "internal error"),
        (click.UsageError("say where"), 2, "say where"),
        (click.ClickException("odd"), 1, "odd"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_failures_become_one_line(
    error: BaseException, code: int, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert common.run_command(failing(error), []) == code
    err = capsys.readouterr().err.lstrip("\n")  # click ends the line in which ^C was echoed
    assert_one_line(err)
    assert text in err


def test_a_defect_shows_its_place_to_those_who_ask(capsys: pytest.CaptureFixture[str]) -> None:
    assert common.run_command(failing(KeyError("pose")), ["-v"]) == 1
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert "internal error" in err.splitlines()[-1]


def test_termination_unwinds_the_program() -> None:
    # Only an exception lets the writers of files remove their temporary ones.
    with pytest.raises(SystemExit) as caught:
        stop_cleanly(signal.SIGTERM, None)
    assert caught.value.code == 128 + signal.SIGTERM


class Findings:
    def table(self) -> list[tuple[str, ...]]:
        return [("what", "value"), ("error", "1.5"), ("a long name", "2"), ("note",)]

    def to_dict(self) -> dict[str, float]:
        return {"error": 1.5}


def printing() -> click.Command:
    @click.command()
    @common.json_option
    @common.common_options
    def command(as_json: bool, progress: object) -> None:
        common.print_summary(Findings(), as_json)

    return command


def test_table_json_and_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    assert common.run_command(printing(), []) == 0
    assert capsys.readouterr().out.splitlines() == [
        "what         value",
        "-----------  -----",
        "error        1.5",
        "a long name  2",
        "note",
    ]
    assert common.run_command(printing(), ["--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"error": 1.5}
    assert common.run_command(printing(), ["--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert common.run_command(printing(), ["--quiet", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"error": 1.5}


def test_no_progress_bar_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(common.make_progress(quiet=False)([1, 2, 3], "counting")) == [1, 2, 3]
    assert capsys.readouterr().err == ""


def parsed(text: str) -> Callable[[], tuple[float, ...] | None]:
    callback = common.parse_numbers(3, "X,Y,DEG")
    option = click.Option(["--pose"])
    return lambda: callback(click.Context(main), option, text)


@given(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3))
def test_numbers_are_read_as_they_were_written(numbers: tuple[float, ...]) -> None:
    assert parsed(",".join(map(repr, numbers)))() == numbers


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "1,2,x", "1,2,nan", "inf,0,0", "1 2 3"])
def test_other_than_three_finite_numbers_is_wrong_usage(text: str) -> None:
    with pytest.raises(click.BadParameter, match="X,Y,DEG"):
        parsed(text)()
