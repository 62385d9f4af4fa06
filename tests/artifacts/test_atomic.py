"""Files and folders appear whole or not at all, whatever happens while they are written."""

import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipelines.artifacts import atomic
from pipelines.artifacts.atomic import (
    atomic_file,
    atomic_folder,
    check_output,
    write_bytes,
    write_text,
)
from pipelines.artifacts.errors import InputError

MARKER = "reconstruction.json"


def names_in(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_a_file_appears_with_its_content_and_leaves_nothing_behind(tmp_path: Path) -> None:
    target = tmp_path / "new" / "deeper" / "a.txt"
    with atomic_file(target, overwrite=False) as temporary:
        assert temporary.parent == target.parent
        assert temporary.suffix == ".txt"
        temporary.write_text("content")
        assert not target.exists()
    assert target.read_text() == "content"
    assert names_in(target.parent) == ["a.txt"]


def test_a_file_obeys_the_umask_like_any_other(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("")
    write_text(tmp_path / "atomic", "", overwrite=False)
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("plain", "atomic")]
    assert modes[0] == modes[1]


@pytest.mark.parametrize("error", [RuntimeError("no"), KeyboardInterrupt()])
def test_when_writing_fails_the_old_file_stays(tmp_path: Path, error: BaseException) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def write() -> None:
        with atomic_file(target, overwrite=True) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(type(error)):
        write()
    assert target.read_text() == "old"
    assert names_in(tmp_path) == ["a.txt"]


def test_an_existing_file_is_refused_without_overwrite(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(InputError, match=r"a\.txt: exists already; use --overwrite"):
        write_text(target, "new", overwrite=False)
    assert target.read_text() == "old"
    write_text(target, "new", overwrite=True)
    assert target.read_text() == "new"


@pytest.mark.parametrize("links_work", [True, False])
def test_a_file_that_appears_meanwhile_is_not_clobbered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links_work: bool
) -> None:
    if not links_work:

        def no_links(source: Path, target: Path) -> None:
            raise PermissionError(1, "Operation not permitted", str(source), None, str(target))

        monkeypatch.setattr(os, "link", no_links)
    target = tmp_path / "a.txt"

    def write() -> None:
        with atomic_file(target, overwrite=False) as temporary:
            temporary.write_text("mine")
            target.write_text("somebody else's")

    with pytest.raises(InputError, match="exists already"):
        write()
    assert target.read_text() == "somebody else's"
    assert names_in(tmp_path) == ["a.txt"]


def test_a_file_is_written_where_hard_links_do_not_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(source: Path, target: Path) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", no_links)
    write_text(tmp_path / "a.txt", "new", overwrite=False)
    assert (tmp_path / "a.txt").read_text() == "new"
    assert names_in(tmp_path) == ["a.txt"]


def test_a_parent_that_is_a_file_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    target = tmp_path / "file" / "a.txt"
    with pytest.raises(InputError, match="is not a folder"):
        check_output(target, overwrite=False)
    with pytest.raises(InputError, match=r"a\.txt: cannot be written"):
        write_text(target, "", overwrite=False)


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no /proc")
def test_a_folder_where_nothing_can_be_written_is_an_input_error() -> None:
    # Even root cannot make a file there.
    target = Path("/proc/lfnav.txt")
    with pytest.raises(InputError, match="cannot be written") as caught:
        write_text(target, "", overwrite=False)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_is_an_input_error(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match="no space left"),
        atomic_file(tmp_path / "a.bin", overwrite=False),
        Path("/dev/full").open("wb", buffering=0) as file,
    ):
        file.write(b"data")
    assert names_in(tmp_path) == []


def test_an_error_over_another_file_is_not_blamed_on_the_output(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), atomic_file(tmp_path / "a.txt", overwrite=False):
        (tmp_path / "missing").read_text()


def test_what_is_no_regular_file_is_not_replaced(tmp_path: Path) -> None:
    for path, reason in ((tmp_path, "is a folder"), (Path("/dev/null"), "not a regular file")):
        with pytest.raises(InputError, match=reason):
            check_output(path, overwrite=True)
        with pytest.raises(InputError, match=reason):
            write_text(path, "", overwrite=True)


def test_a_link_is_written_through(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "real").write_text("old")
    (tmp_path / "link").symlink_to("folder/real")
    write_text(tmp_path / "link", "new", overwrite=True)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "folder" / "real").read_text() == "new"


def test_a_long_name_works(tmp_path: Path) -> None:
    target = tmp_path / ("ü" * 120 + ".h5")
    write_bytes(target, b"data", overwrite=False)
    assert target.read_bytes() == b"data"


def test_a_change_of_folder_meanwhile_does_no_harm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    with atomic_file(Path("a.txt"), overwrite=False) as temporary:
        os.chdir("elsewhere")
        temporary.write_text("content")
    assert (tmp_path / "a.txt").read_text() == "content"


def test_check_output_writes_nothing(tmp_path: Path) -> None:
    check_output(tmp_path / "a" / "b", overwrite=False)
    assert names_in(tmp_path) == []


# --- folders -----------------------------------------------------------------------------------


def fill(folder: Path, content: str) -> None:
    (folder / MARKER).write_text(content)
    (folder / "sparse").mkdir()
    (folder / "sparse" / "images.bin").write_text(content)


def test_a_folder_appears_whole(tmp_path: Path) -> None:
    target = tmp_path / "parent" / "folder"
    with atomic_folder(target, overwrite=False, marker=MARKER) as temporary:
        fill(temporary, "new")
        assert not target.exists()
    assert names_in(target) == [MARKER, "sparse"]
    assert names_in(target.parent) == ["folder"]


@pytest.mark.parametrize("exchange", [True, False])
def test_an_old_folder_is_replaced_as_a_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exchange: bool
) -> None:
    if not exchange:
        monkeypatch.setattr(atomic, "_rename_with", lambda source, target, flag: False)
    target = tmp_path / "folder"
    target.mkdir()
    (target / MARKER).write_text("old")
    (target / "left over").write_text("old")
    with (
        pytest.raises(InputError, match="exists already"),
        atomic_folder(target, overwrite=False, marker=MARKER),
    ):
        pass
    with atomic_folder(target, overwrite=True, marker=MARKER) as temporary:
        fill(temporary, "new")
    assert names_in(target) == [MARKER, "sparse"]
    assert (target / MARKER).read_text() == "new"
    assert names_in(tmp_path) == ["folder"]


@pytest.mark.skipif(sys.platform != "linux", reason="folders are exchanged on Linux only")
def test_on_linux_there_is_no_moment_without_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_rename(source: Path, target: Path) -> None:
        raise AssertionError("the old folder was moved away before the new one was there")

    monkeypatch.setattr(os, "rename", no_rename)
    for content in ("old", "new"):
        with atomic_folder(tmp_path / "folder", overwrite=True, marker=MARKER) as temporary:
            fill(temporary, content)
    assert (tmp_path / "folder" / MARKER).read_text() == "new"
    assert names_in(tmp_path) == ["folder"]


def test_when_filling_fails_the_old_folder_stays(tmp_path: Path) -> None:
    target = tmp_path / "folder"
    target.mkdir()
    (target / MARKER).write_text("old")

    def write() -> None:
        with atomic_folder(target, overwrite=True, marker=MARKER) as temporary:
            fill(temporary, "half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write()
    assert names_in(target) == [MARKER]
    assert names_in(tmp_path) == ["folder"]


def test_a_folder_of_somebody_else_is_not_replaced(tmp_path: Path) -> None:
    target = tmp_path / "thesis"
    target.mkdir()
    (target / "chapter1.tex").write_text("years of work")
    with pytest.raises(InputError, match="lfnav did not make it"):
        check_output(target, overwrite=True, marker=MARKER)
    with (
        pytest.raises(InputError, match="lfnav did not make it"),
        atomic_folder(target, overwrite=True, marker=MARKER),
    ):
        pass
    assert names_in(target) == ["chapter1.tex"]


def test_an_empty_folder_is_replaced_with_overwrite(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with atomic_folder(tmp_path / "folder", overwrite=True, marker=MARKER) as temporary:
        fill(temporary, "new")
    assert names_in(tmp_path / "folder") == [MARKER, "sparse"]


@pytest.mark.parametrize("no_replace", [True, False])
def test_a_folder_that_appears_meanwhile_is_not_clobbered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_replace: bool
) -> None:
    if not no_replace:
        monkeypatch.setattr(atomic, "_rename_with", lambda source, target, flag: False)
    target = tmp_path / "folder"

    def write() -> None:
        with atomic_folder(target, overwrite=False, marker=MARKER) as temporary:
            fill(temporary, "mine")
            target.mkdir()
            (target / "theirs").write_text("")

    with pytest.raises(InputError, match="exists already"):
        write()
    assert names_in(target) == ["theirs"]
    assert names_in(tmp_path) == ["folder"]


def test_a_file_is_not_replaced_by_a_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("old")
    with pytest.raises(InputError, match="is not a folder"):
        check_output(tmp_path / "file", overwrite=True, marker=MARKER)


# --- killed ------------------------------------------------------------------------------------

# Rewrites a file and a folder for ever, always with 200,000 equal characters, and so slowly that
# most kills come while it writes.
ENDLESS_WRITER = """
import itertools, sys, time
from pathlib import Path
from pipelines.artifacts.atomic import atomic_file, atomic_folder
folder = Path(sys.argv[1])

def write(path, digit):
    with path.open("w") as file:
        for _ in range(10):
            file.write(digit * 20_000)
            file.flush()
            time.sleep(0.0002)

for number in itertools.count():
    digit = str(number % 10)
    with atomic_file(folder / "file.txt", overwrite=True) as temporary:
        write(temporary, digit)
    with atomic_folder(folder / "folder", overwrite=True, marker="marker") as temporary:
        for name in ("marker", "second"):
            write(temporary / name, digit)
    if number == 1:
        print("running", flush=True)
"""


def assert_whole(text: str) -> None:
    assert len(text) == 200_000
    assert len(set(text)) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="folders are exchanged on Linux only")
def test_after_a_kill_at_any_moment_old_or_new_is_there_whole(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    for attempt in range(6):
        process = subprocess.Popen(
            [sys.executable, "-c", ENDLESS_WRITER, str(tmp_path)],
            cwd=root,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        assert process.stdout.readline() == "running\n"
        time.sleep(0.003 + 0.0037 * attempt)
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        process.stdout.close()
        assert_whole((tmp_path / "file.txt").read_text())
        texts = [(tmp_path / "folder" / name).read_text() for name in ("marker", "second")]
        assert_whole(texts[0])
        assert texts[0] == texts[1]
