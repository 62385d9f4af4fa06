"""What all subcommands share: options, progress bars, tables, the mapping of errors to exit codes."""

import functools
import json
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from pipelines.artifacts.progress import Progress
    from pipelines.artifacts.summary import Summary

T = TypeVar("T")
Decorated = TypeVar("Decorated", bound=Callable[..., Any])

EXIT_OK, EXIT_ERROR, EXIT_USAGE, EXIT_INTERRUPTED = 0, 1, 2, 130


def run_command(command: click.Command, arguments: Sequence[str] | None = None) -> int:
    """Runs a command; what the user can mend becomes one line on stderr.

    Returns:
        The exit code: 0, 1 for an error, 2 for wrong usage, 130 for Ctrl-C.
    """
    from pipelines.artifacts.errors import LfnavError

    try:
        code = command.main(args=arguments, standalone_mode=False, prog_name="lfnav")
        return code if isinstance(code, int) else EXIT_OK
    except click.UsageError as error:
        error.show()
        return EXIT_USAGE
    except click.ClickException as error:
        error.show()
        return EXIT_ERROR
    except (click.Abort, KeyboardInterrupt):
        click.echo("lfnav: interrupted", err=True)
        return EXIT_INTERRUPTED
    except LfnavError as error:
        click.echo(f"lfnav: {one_line(str(error))}", err=True)
        return EXIT_ERROR
    except BrokenPipeError:
        # The reader of a pipe (head, less) has gone; flushing at exit would complain again.
        sys.stderr.close()
        return EXIT_ERROR


def one_line(text: str) -> str:
    """The text with its line breaks and runs of blanks folded."""
    return " ".join(text.split())


def common_options(command: Decorated) -> Decorated:
    """Adds ``-v/--verbose`` and ``--quiet``; the command receives ``progress``, not the flags."""

    @click.option("-v", "--verbose", is_flag=True, help="Say what is done in detail, on stderr.")
    @click.option("--quiet", is_flag=True, help="Print errors only; no progress bars.")
    @functools.wraps(command)
    def wrapper(*args: Any, verbose: bool, quiet: bool, **kwargs: Any) -> Any:
        if verbose and quiet:
            raise click.UsageError("--verbose and --quiet exclude each other")
        level = logging.DEBUG if verbose else logging.ERROR if quiet else logging.WARNING
        logging.basicConfig(
            level=logging.WARNING, format="lfnav: %(message)s", stream=sys.stderr, force=True
        )
        logging.getLogger("pipelines").setLevel(level)
        context = click.get_current_context()
        context.meta["lfnav.quiet"] = quiet
        return command(*args, progress=make_progress(quiet), **kwargs)

    return wrapper  # type: ignore[return-value]


overwrite_option = click.option(
    "--overwrite", is_flag=True, help="Replace the output where it exists."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")


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
    """Left-aligned first column, right-aligned others, a rule below the headings."""
    widths = [max(len(row[i]) for row in rows if i < len(row)) for i in range(len(rows[0]))]
    lines = []
    for number, row in enumerate(rows):
        cells = [
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=False))
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
