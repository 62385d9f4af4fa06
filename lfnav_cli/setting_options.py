"""Options of a command out of settings: one for each, of the same name as in a config file."""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from pipelines.artifacts.setting import Entry

Decorated = TypeVar("Decorated", bound=Callable[..., Any])


@dataclass(frozen=True)
class Given:
    """A value that was given at the command line, and its text; None may be one."""

    value: Any
    text: str


class SettingType(click.ParamType):  # type: ignore[type-arg]
    """The values of a setting."""

    def __init__(self, entry: "Entry") -> None:
        self.name = entry.name
        self._entry = entry

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Given:
        """The text of an option as Python has it."""
        if isinstance(value, Given):
            return value
        try:
            return Given(self._entry.parsed_text(value), value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class SettingOption(click.Option):
    """An option that is also understood by the setting's former names, which the help omits."""

    def __init__(self, entry: "Entry") -> None:
        self._former = [option_of(name) for name in entry.setting.former]
        about = f"{entry.setting.help[0].upper()}{entry.setting.help[1:]}"
        if entry.setting.unit:
            about += f". Unit: {entry.setting.unit}"
        names = option_of(entry.name)
        if entry.is_flag:
            super().__init__(
                [f"{names}/--no-{names[2:]}"],
                default=None,
                hidden=not entry.setting.is_common,
                help=f"{about}.",
            )
            return
        super().__init__(
            [names],
            type=SettingType(entry),
            metavar=entry.kind.form,
            hidden=not entry.setting.is_common,
            help=f"{about}. Default: {entry.default_text}.",
        )

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        """Tells the parser all names; errors and help go on to say the present one."""
        present = self.opts
        self.opts = [*present, *self._former]
        super().add_to_parser(parser, ctx)
        self.opts = present


config_file_option = click.option(
    "--config",
    metavar="FILE.toml",
    type=click.Path(path_type=Path),
    help="Settings file. Options win over it, and it wins over the defaults.",
)
print_config_option = click.option(
    "--print-config",
    is_flag=True,
    help="Print all settings as a config file and exit; needs no other arguments.",
)


def config_options(command: Decorated) -> Decorated:
    """Adds ``--config`` and ``--print-config``."""
    return config_file_option(print_config_option(command))


def missing(values: Mapping[str, object]) -> click.MissingParameter:
    """The error for the first parameter that has no value: only --print-config does without."""
    context = click.get_current_context()
    absent = [item for item in context.command.params if values.get(item.name or "", 0) is None]
    return click.MissingParameter(ctx=context, param=absent[0])


class SettingsCommand(click.Command):
    """A command whose help lists the settings after the other options."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Options, and then the settings that are common."""
        parts: dict[str, list[tuple[str, str]]] = {"Options": [], "Settings": []}
        for item in self.get_params(ctx):
            record = item.get_help_record(ctx)
            if record is not None and isinstance(item, click.Option):
                parts["Settings" if isinstance(item, SettingOption) else "Options"].append(record)
        for title, records in parts.items():
            with formatter.section(title):
                formatter.write_dl(records)


def option_of(name: str) -> str:
    """The option of a setting's name."""
    return f"--{name.replace('_', '-')}"


def localizer_entries() -> "Sequence[Entry]":
    """The settings of the localization, whose modules need the standard library alone."""
    from pipelines.localize.config import ENTRIES

    return ENTRIES


def dock_entries() -> "Sequence[Entry]":
    """The settings of docking, and those of the localization."""
    from pipelines.dock.config import ENTRIES

    return ENTRIES


def setting_options(entries: "Sequence[Entry]") -> Callable[[Decorated], Decorated]:
    """Adds an option for each setting; the command receives ``chosen``: path -> value.

    Only what was given is among ``chosen``. It belongs below ``common_options``, which decides
    where warnings go.
    """

    def decorate(command: Decorated) -> Decorated:
        @functools.wraps(command)
        def wrapper(*args: Any, **values: Any) -> Any:
            chosen = {}
            for entry in entries:
                value = values.pop(entry.name)
                if isinstance(value, Given):
                    entry.warn_of_former(value.text)
                    chosen[entry.path] = value.value
                elif value is not None:
                    chosen[entry.path] = value
            return command(*args, chosen=chosen, **values)

        parameters = getattr(wrapper, "__click_params__", [])
        # Click lists parameters of decorators from the last one on.
        wrapper.__click_params__ = [  # type: ignore[attr-defined]
            *parameters,
            *reversed([SettingOption(entry) for entry in entries]),
        ]
        return wrapper  # type: ignore[return-value]

    return decorate
