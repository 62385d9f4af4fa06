r"""Which file a source means by a name that was written on another machine.

Programs write what they saw: ``images\0001.jpg`` on Windows, or ``/home/somebody/project/images/
0001.jpg``. Such a name is looked for below the folder of the source, and nowhere else.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from pipelines.artifacts.errors import InputError, quoted
from pipelines.artifacts.file_content import is_file

# Share of a source's photos that may be gone where nobody says more.
MISSING_SHARE = 0.1
NAMED_MISSING = 3
_DRIVE = re.compile("[A-Za-z]:/")


@dataclass(frozen=True)
class NamedFile:
    """A file that a source names.

    Attributes:
        name: POSIX, relative to the folder, which it does not leave.
        is_there: whether it is a file.
    """

    name: str
    is_there: bool


def files_below(
    folder: Path, texts: Sequence[str], suffixes: Sequence[str] = ("",)
) -> list[NamedFile | None]:
    """The files that names mean.

    A name that is not there is tried with slashes for backslashes. Of an absolute one, which may
    be that of another machine, the longest end that is a file in the folder counts.

    Args:
        folder: that holds the files.
        texts: the names as the source has them.
        suffixes: that a name may lack, in the order in which they are tried.

    Returns:
        A file for each name; None where it leads out of the folder.
    """
    found = [_found(folder, text, suffixes) for text in texts]
    # What lay beside files that are here is gone; what lay elsewhere never belonged here.
    roots = {
        _slashes(text)[: -len(file.name)]
        for text, file in zip(texts, found, strict=True)
        if file is not None and file.is_there and _slashes(text).endswith(file.name)
    }
    return [file or _gone(_slashes(text), roots) for text, file in zip(texts, found, strict=True)]


def all_inside(
    texts: Sequence[str], files: Sequence[NamedFile | None], source: Path
) -> list[NamedFile]:
    """The files of ``files_below``.

    Raises:
        InputError: one of the names leads out of the folder; ``source`` is what names it.
    """
    inside = []
    for text, file in zip(texts, files, strict=True):
        if file is None:
            raise InputError(source, f"{quoted(text)} leads out of the folder")
        inside.append(file)
    return inside


def _slashes(text: str) -> str:
    return text.replace("\\", "/")


def _found(folder: Path, text: str, suffixes: Sequence[str]) -> NamedFile | None:
    """The file, or where it would be; None: it leads out of the folder."""
    candidates = [text] if text == _slashes(text) else [text, _slashes(text)]
    last = None
    for name in map(os.path.normpath, candidates):
        if "\0" in name or name == ".":
            continue
        if PurePosixPath(name).is_absolute() or _DRIVE.match(name):
            ends = _ends(folder, name)
        elif ".." in PurePosixPath(name).parts:
            ends = _ends_inside(folder, str(folder.absolute() / name))
        else:
            ends = [name]
            last = NamedFile(name, False)
        for end in ends:
            for suffix in suffixes:
                if is_file(folder / (end + suffix)):
                    return NamedFile(end + suffix, True)
    return last


def _ends(folder: Path, name: str) -> list[str]:
    """Ends of an absolute name that may be relative to the folder, the longest first."""
    inside = _ends_inside(folder, name)
    if inside:
        return inside
    parts = [part for part in PurePosixPath(name).parts if part != "/"]
    return ["/".join(parts[start:]) for start in range(len(parts))]


def _ends_inside(folder: Path, name: str) -> list[str]:
    """An absolute name relative to the folder, where it leads into it."""
    path = PurePosixPath(os.path.normpath(name))
    for base in (folder.absolute(), folder.resolve()):
        if path.is_relative_to(base) and path != PurePosixPath(base):
            return [str(path.relative_to(base))]
    return []


def _gone(name: str, roots: set[str]) -> NamedFile | None:
    """An absolute name below a root where other files of the source lay; None: it is elsewhere."""
    below = [name.removeprefix(root) for root in roots if root and name.startswith(root)]
    below = [rest for rest in below if rest and ".." not in PurePosixPath(rest).parts]
    return NamedFile(min(below, key=len), False) if below else None


def check_missing(
    folder: Path, files: Sequence[NamedFile], allowed: float | None, remedy: str = ""
) -> tuple[str, ...]:
    """Makes sure that no more photos are gone than may be.

    Args:
        folder: of the files.
        files: what the source names.
        allowed: share of them that may be gone; None: ``MISSING_SHARE``.
        remedy: what else can be done, for the error.

    Returns:
        A note about those that are left out.

    Raises:
        InputError: too many are gone, or all of them.
    """
    gone = [file.name for file in files if not file.is_there]
    if not gone:
        return ()
    share = MISSING_SHARE if allowed is None else allowed
    text = f"{len(gone)} of {len(files)} photos"
    if len(gone) == len(files) or len(gone) > share * len(files):
        raise InputError(
            folder / gone[0],
            f"is not there, but has a pose ({text} are missing)",
            f"{remedy}--allow-missing leaves them out",
        )
    names = ", ".join(map(quoted, gone[:NAMED_MISSING]))
    more = ", …" if len(gone) > NAMED_MISSING else ""
    return (f"{text} are not there and left out: {names}{more}",)
