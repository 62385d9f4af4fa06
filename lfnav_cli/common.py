"""What all subcommands share: options, progress bars, tables, and errors as exit codes."""

import functools
import json
import logging
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from pipelines.artifacts.stages import Progress, Summary

T = TypeVar("T")
Decorated = TypeVar("Decorated", bound=Callable[..., Any])

EXIT_OK, EXIT_ERROR, EXIT_USAGE, EXIT_INTERRUPTED = 0, 1, 2, 130


def run_command(command: click.Command, arguments: Sequence[str] | None = None) -> int:
    """Runs a command; whatever goes wrong becomes one line on stderr.

    Returns:
        The exit code: 0, 1 for an error, 2 for wrong usage, 130 for Ctrl-C.
    """
    from pipelines.artifacts.errors import LfnavError

    try:
        code = command.main(args=arguments, standalone_mode=False, prog_name="lfnav")
        return code if isinstance(code, int) else EXIT_OK
    except click.UsageError as error:
        place = error.ctx.command_path if error.ctx else "lfnav"
        print_error(f"{error.format_message()}  (see '{place} --help')")
        return EXIT_USAGE
    except click.ClickException as error:
        print_error(error.format_message())
        return EXIT_ERROR
    except (click.Abort, KeyboardInterrupt):
        print_error("interrupted")
        return EXIT_INTERRUPTED
    except LfnavError as error:
        print_error(str(error))
        return EXIT_ERROR
    except ImportError as error:
        # The C++ core ends its import where the environment asks for what there is not.
        if not isinstance(error.__cause__, LfnavError):
            return _defect(error, arguments)
        print_error(str(error.__cause__))
        return EXIT_ERROR
    except MemoryError:
        print_error("out of memory")
        return EXIT_ERROR
    except OSError as error:
        print_error(str(error))
        return EXIT_ERROR
    except Exception as error:  # noqa: BLE001
        return _defect(error, arguments)


def _defect(error: Exception, arguments: Sequence[str] | None) -> int:
    """Reports a defect of lfnav; where it happened helps only whoever asks for it."""
    if {"-v", "--verbose"} & set(sys.argv[1:] if arguments is None else arguments):
        traceback.print_exception(error)
    kind = type(error).__name__
    print_error(f"internal error, please report it: {kind}: {error}  (-v shows where)")
    return EXIT_ERROR


def print_error(text: str) -> None:
    """Writes one line on stderr that begins with the program's name."""
    click.echo(f"lfnav: {one_line(text)}", err=True)


def one_line(text: str) -> str:
    """The text with its line breaks and runs of blanks folded."""
    return " ".join(text.split())


def common_options(command: Decorated) -> Decorated:
    """Adds ``-v/--verbose`` and ``--quiet``; the command receives ``progress``, not the flags."""

    @click.option("-v", "--verbose", is_flag=True, help="Say what is done in detail, on stderr.")
    @click.option("--quiet", is_flag=True, help="Print errors only; no progress bars.")
    @functools.wraps(command)
    def wrapper(*args: Any, verbose: bool, quiet: bool, **kwargs: Any) -> Any:
        context = click.get_current_context()
        if verbose and quiet:
            raise click.UsageError("--verbose and --quiet exclude each other", ctx=context)
        configure_logging(verbose, quiet)
        context.meta["lfnav.quiet"] = quiet
        return command(*args, progress=make_progress(quiet), **kwargs)

    return wrapper  # type: ignore[return-value]


def configure_logging(verbose: bool, quiet: bool) -> None:
    """Sends the library's log to stderr: warnings, or everything, or errors alone."""
    level = logging.DEBUG if verbose else logging.ERROR if quiet else logging.WARNING
    logging.basicConfig(
        level=logging.WARNING, format="lfnav: %(message)s", stream=sys.stderr, force=True
    )
    logging.getLogger("pipelines").setLevel(level)


overwrite_option = click.option(
    "--overwrite", is_flag=True, help="Replace the output where it exists."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")


blending_option = click.option(
    "--blending",
    type=click.Choice(["unstructured", "delaunay"]),
    default="unstructured",
    show_default=True,
    help="How views are blended: by viewing angle, or by the paper's Delaunay mesh.",
)


device_option = click.option(
    "--device",
    type=click.Choice(["auto", "cpu", "gpu"]),
    default="cpu",
    help="Where views are rendered: on the CPU (the default), on a GPU, or (auto) on a GPU where "
    'there is one. A GPU needs pip install "lfnav[gpu]".',
)
quality_option = click.option(
    "--quality",
    type=click.Choice(["plane", "coarse", "medium", "fine"]),
    help="How finely the surface follows the depth maps. Default: fine; plane without them.",
)


max_gap_option = click.option(
    "--max-gap",
    type=float,
    metavar="SECONDS",
    default=0.2,
    show_default=True,
    help="An image's pose is interpolated between two poses that are at most so far apart.",
)


def make_progress(quiet: bool) -> "Progress":
    """Progress bars on stderr; none where stderr is no terminal or ``quiet`` is set."""

    def progress(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
        if quiet or not sys.stderr.isatty():
            yield from items
            return
        from tqdm import tqdm

        yield from tqdm(items, desc=description, total=total, leave=False, file=sys.stderr)

    return progress


def print_summary(summary: "Summary", as_json: bool = False) -> None:
    """Prints what a stage found, as a table or as JSON; nothing under ``--quiet`` without JSON."""
    if as_json:
        click.echo(json.dumps(summary.to_dict(), indent=2, allow_nan=False))
    elif not click.get_current_context().meta.get("lfnav.quiet", False):
        click.echo(format_table(summary.table()))


def format_table(rows: Sequence[Sequence[str]]) -> str:
    """Names to the left; figures, from three columns on, to the right; a rule below the head."""
    if not rows:
        return ""
    columns = max(len(row) for row in rows)
    padded = [[*row, *[""] * (columns - len(row))] for row in rows]
    widths = [max(len(row[column]) for row in padded) for column in range(columns)]
    lines = []
    for number, row in enumerate(padded):
        cells = [
            cell.ljust(width) if column == 0 or columns == 2 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
        if number == 0:
            lines.append("  ".join("-" * width for width in widths))
    return "\n".join(lines)


def parse_numbers(count: int, form: str) -> Callable[..., tuple[float, ...] | None]:
    """A click callback for options like ``X,Y,DEG``: exactly ``count`` finite numbers.

    Args:
        count: how many numbers, separated by commas.
        form: the option's metavar, for the error text.
    """

    def callback(
        context: click.Context, parameter: click.Parameter, value: str | None
    ) -> tuple[float, ...] | None:
        if value is None:
            return None
        try:
            numbers = tuple(float(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        # nan and inf compare false with themselves minus themselves.
        if len(numbers) != count or any(number - number != 0.0 for number in numbers):
            raise click.BadParameter(f"{value!r} is not of the form {form}")
        return numbers

    return callback
