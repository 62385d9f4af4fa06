"""What strangers wrote, in messages: one line, without control characters, cut."""

import ast
import json
import unicodedata
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.artifacts.errors import (
    QUOTED_CHARACTERS,
    REASON_CHARACTERS,
    InputError,
    LfnavError,
    OptionError,
    StageError,
    quoted,
    reason_of,
)
from pipelines.artifacts.json_fields import read_json_object
from pipelines.artifacts.toml_file import read_toml
from pipelines.dataset.dataset import load_dataset
from pipelines.experiments.config_tables import named_seeds
from pipelines.geometry.trajectory import read_tum
from pipelines.localize.config import effective_settings

MEGABYTES = "9x" * 5_000_000
# It sets the window's title, clears the screen, and writes another line over the first.
TERMINAL = "\x1b]0;owned\x07\x1b[2J\x1b[1;31mdone\r\n\u202eall is well\x9b31m"
HOSTILE = {
    "long": MEGABYTES,
    # Of a file that is not too large to be read.
    "wide": "x" * 100_000,
    "terminal": TERMINAL,
    "lines": "a\u2028b\x0bc\x85d",
}


def is_harmless(text: str) -> bool:
    """Whether a text is one line that a terminal shows as it is."""
    return not any(unicodedata.category(letter)[0] == "C" for letter in text) and (
        len(text.splitlines()) <= 1
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("rgb/1.png", "'rgb/1.png'"),
        ("Tür 3", "'Tür 3'"),
        ("it's", r"'it\'s'"),
        ("a\\b", r"'a\\b'"),
        ("a\nb\x1b[2J", r"'a\nb\x1b[2J'"),
        ("\u202e", r"'\u202e'"),
        (17, "'17'"),
        (None, "'None'"),
        ("x" * QUOTED_CHARACTERS, "'" + "x" * QUOTED_CHARACTERS + "'"),
        ("x" * (QUOTED_CHARACTERS + 1), "'" + "x" * QUOTED_CHARACTERS + "'..."),
        # An escape is shown as a whole or not at all.
        ("x" * (QUOTED_CHARACTERS - 1) + "\n", "'" + "x" * (QUOTED_CHARACTERS - 1) + "'..."),
    ],
)
def test_quoted(text: object, expected: str) -> None:
    assert quoted(text) == expected


@given(st.text(max_size=200))
def test_what_is_quoted_is_harmless_and_reads_back(text: str) -> None:
    shown = quoted(text)
    assert is_harmless(shown)
    assert len(shown) <= QUOTED_CHARACTERS + 5
    if not shown.endswith("..."):
        assert ast.literal_eval(shown) == text


@given(st.text(max_size=400))
def test_the_reason_of_an_error_is_harmless(text: str) -> None:
    shown = reason_of(ValueError(text))
    assert is_harmless(shown)
    assert len(shown) <= REASON_CHARACTERS + 3


def test_the_name_of_a_file_is_shown_harmlessly() -> None:
    error = InputError(Path(f"data/{TERMINAL}.png"), "does not exist")
    assert is_harmless(str(error))
    assert error.path == Path(f"data/{TERMINAL}.png")


def dataset_with(list_text: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        (folder / "rgb.txt").write_text(list_text)
        return load_dataset(folder)

    return read


def file_with(reader: Callable[[Path], object], text: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        (folder / "file").write_text(text)
        return reader(folder / "file")

    return read


def json_choice(path: Path) -> object:
    return read_json_object(path, 2**26).choice("model", ("a", "b"))


def config(path: Path) -> object:
    return effective_settings(path, {})


def test_no_message_holds_control_characters_or_goes_on_for_ever() -> None:
    for made in (LfnavError, OptionError, StageError, lambda text: InputError("a", text)):
        message = str(made("estimates/\x1b[31mred\x1b[0m\ud800 is missing" + "A" * 100_000))
        assert "\\x1b[31mred\\x1b[0m\\ud800 is missing" in message
        assert is_harmless(message)
        assert len(message) < 9000


READERS: dict[str, Callable[[str], Callable[[Path], object]]] = {
    "timestamp": lambda text: dataset_with(f"{text} rgb/1.png\n"),
    "image name": lambda text: dataset_with(f"1.0 rgb/{text}\n"),
    "image outside": lambda text: dataset_with(f"1.0 ../{text}\n"),
    "pose": lambda text: file_with(read_tum, f"{text} 0 0 0 0 0 0 1\n"),
    "toml": lambda text: file_with(read_toml, f"{text} =\n"),
    "setting": lambda text: file_with(config, f"[filter]\n{json.dumps(text)} = 1\n"),
    "section": lambda text: file_with(config, f"[{json.dumps(text)}]\n"),
    "value of a setting": lambda text: file_with(
        config, f"[filter]\nstrategy = {json.dumps(text)}\n"
    ),
    "seeds": lambda text: lambda _: named_seeds(text),
    "json": lambda text: file_with(json_choice, f'{{"model": {text}}}'),
    "json choice": lambda text: file_with(
        json_choice,
        '{"model": "' + text.replace("\x1b", "\\u001b").replace("\r\n", "\\n") + '"}',
    ),
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
def test_hostile_content_of_files_is_told_in_one_short_harmless_line(
    reader: Callable[[str], Callable[[Path], object]], text: str, tmp_path: Path
) -> None:
    with pytest.raises(LfnavError) as caught:
        reader(text)(tmp_path)
    message = str(caught.value)
    assert is_harmless(message)
    assert len(message) < 700
