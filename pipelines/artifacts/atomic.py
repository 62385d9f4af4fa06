"""Files and folders that appear at once and whole, or not at all.

Everything is written under a temporary name beside its final place, flushed to the disk and then
renamed: whoever is killed at any moment leaves the old content or the new one, never half of it.
"""

import ctypes
import errno
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pipelines.artifacts.errors import InputError

_EXISTS = "exists already"
_USE_OVERWRITE = "use --overwrite to replace it"
# From linux/fs.h and fcntl.h, for renameat2.
_RENAME_NOREPLACE, _RENAME_EXCHANGE = 1, 2
_AT_FDCWD = -100


def check_output(path: Path, overwrite: bool, marker: str | None = None) -> None:
    """Finds out before the work starts whether its result can be stored; writes nothing.

    Args:
        path: the file or folder to be written; missing parents are made when it is written.
        overwrite: whether something that exists there may be replaced.
        marker: None for a file; for a folder the name of a file that a folder made by this
            program holds, without which a folder that is not empty is not replaced.

    Raises:
        InputError: ``path`` exists (without ``overwrite``) or must not be replaced, or its parent
            is no folder or cannot be written to.
    """
    if os.path.lexists(path) and not overwrite:
        raise InputError(path, _EXISTS, _USE_OVERWRITE)
    if os.path.exists(path):
        _check_replaceable(path, marker)
    parent = Path(os.path.abspath(path)).parent
    while not os.path.lexists(parent):
        parent = parent.parent
    if not parent.is_dir():
        raise InputError(path, f"cannot be written ({parent} is not a folder)")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise InputError(path, f"cannot be written (no permission to write in {parent})")


def _check_replaceable(path: Path, marker: str | None) -> None:
    """Refuses to replace what is no file, or a folder that this program did not make."""
    if marker is None:
        if path.is_dir():
            raise InputError(path, "is a folder, not a file", "give another name")
        if not stat.S_ISREG(path.stat().st_mode):
            raise InputError(path, "is not a regular file", "give another name")
        return
    if not path.is_dir():
        raise InputError(path, "is not a folder", "give another name")
    try:
        replaceable = (path / marker).is_file() or not any(path.iterdir())
    except OSError as error:
        raise InputError(path, f"cannot be read ({_reason(error)})") from error
    if not replaceable:
        raise InputError(
            path,
            f"will not be overwritten: it holds files but no {marker}, so lfnav did not make it",
            "give another name",
        )


@contextmanager
def atomic_file(path: Path, overwrite: bool) -> Iterator[Path]:
    """Yields a temporary path to write to; it becomes ``path`` when the block ends well.

    The temporary file exists (empty), lies in the folder of ``path`` and has the same suffix.
    When the block raises, it is removed and ``path`` is what it was.

    Raises:
        InputError: ``path`` must not be replaced or cannot be written; the disk is full; without
            ``overwrite``, a file of this name appeared meanwhile.
    """
    check_output(path, overwrite)
    target = _final_place(path)
    temporary = _temporary_name(target)
    try:
        _make_folder(target.parent)
        # Not tempfile: its files can be read by their owner alone, this obeys the umask.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        _flush(temporary)
        _publish_file(temporary, target, overwrite)
        _flush(target.parent)
    except OSError as error:
        if _is_about_another_file(error, temporary, target):
            raise
        raise _write_error(path, error) from error
    finally:
        # Gone already where it was published by renaming.
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def atomic_folder(path: Path, overwrite: bool, marker: str) -> Iterator[Path]:
    """Yields a temporary folder to fill; it becomes ``path`` when the block ends well.

    Args:
        path: the folder's final place.
        overwrite: whether a folder there may be replaced, as a whole.
        marker: name of a file that the block writes into every folder of this kind; a folder that
            is neither empty nor holds such a file is not replaced.

    Raises:
        InputError: ``path`` must not be replaced or cannot be written; the disk is full; without
            ``overwrite``, something of this name appeared meanwhile.
    """
    check_output(path, overwrite, marker)
    target = _final_place(path)
    temporary = _temporary_name(target)
    try:
        _make_folder(target.parent)
        temporary.mkdir()
        yield temporary
        for folder, _, names in os.walk(temporary, topdown=False):
            for name in names:
                _flush(Path(folder) / name)
            _flush(Path(folder))
        _publish_folder(temporary, target, overwrite)
        _flush(target.parent)
    except OSError as error:
        if _is_about_another_file(error, temporary, target):
            raise
        raise _write_error(path, error) from error
    finally:
        # Holds the new folder after a failure, the replaced one after an exchange.
        shutil.rmtree(temporary, ignore_errors=True)


def write_text(path: Path, text: str, overwrite: bool) -> None:
    """Writes ``text`` as UTF-8, atomically.

    Raises:
        InputError: ``path`` must not be replaced or cannot be written.
    """
    write_bytes(path, text.encode("utf-8"), overwrite)


def write_bytes(path: Path, data: bytes, overwrite: bool) -> None:
    """Writes ``data``, atomically.

    Raises:
        InputError: ``path`` must not be replaced or cannot be written.
    """
    with atomic_file(path, overwrite) as temporary:
        temporary.write_bytes(data)


def _final_place(path: Path) -> Path:
    """Absolute, so that a change of folder meanwhile does no harm; links are written through."""
    return path.resolve() if path.is_symlink() else Path(os.path.abspath(path))


def _temporary_name(target: Path) -> Path:
    # A name can have 255 bytes; 40 characters are at most 160.
    stem = f".{target.stem[:40]}.{secrets.token_hex(6)}.partial"
    return target.with_name(stem + target.suffix[:10])


def _make_folder(folder: Path) -> None:
    """Makes the folder and its parents where they are missing, durably."""
    if folder.is_dir():
        return
    _make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    _flush(folder.parent)


def _flush(path: Path) -> None:
    """Waits until a file or the entries of a folder are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        # Some file systems cannot flush folders; there is nothing else to do about it.
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(descriptor)


def _publish_file(temporary: Path, target: Path, overwrite: bool) -> None:
    if overwrite:
        os.replace(temporary, target)
        return
    try:
        # Unlike a rename, a link never replaces a file that appeared since the check.
        os.link(temporary, target)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS):
            raise
        # A file system without hard links: look again, which leaves a gap of microseconds.
        if os.path.lexists(target):
            raise FileExistsError(errno.EEXIST, "exists", str(target)) from error
        os.replace(temporary, target)


def _publish_folder(temporary: Path, target: Path, overwrite: bool) -> None:
    if not overwrite or not os.path.lexists(target):
        if not _rename_with(temporary, target, _RENAME_NOREPLACE):
            if os.path.lexists(target):
                raise FileExistsError(errno.EEXIST, "exists", str(target))
            os.rename(temporary, target)
        return
    if _rename_with(temporary, target, _RENAME_EXCHANGE):
        return
    aside = _temporary_name(target)
    os.rename(target, aside)
    try:
        os.rename(temporary, target)
    except OSError:
        os.rename(aside, target)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _rename_with(source: Path, target: Path, flag: int) -> bool:
    """Linux's ``renameat2``: the only way to exchange two folders without a gap between.

    Returns:
        False where the system or the file system does not offer it; nothing has changed then.
    """
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    if renameat2(_AT_FDCWD, os.fsencode(source), _AT_FDCWD, os.fsencode(target), flag) == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
        return False
    raise OSError(code, os.strerror(code), str(target))


def _is_about_another_file(error: OSError, temporary: Path, target: Path) -> bool:
    """Whether the block failed over a file that has nothing to do with this one."""
    if isinstance(error, ConnectionError):
        return True
    if error.filename is None:
        return False
    named = Path(os.fsdecode(error.filename)) if not isinstance(error.filename, int) else None
    related = (temporary, target, *target.parents)
    return named is None or (named not in related and temporary not in named.parents)


def _write_error(path: Path, error: OSError) -> InputError:
    if error.errno in (errno.EEXIST, errno.ENOTEMPTY):
        return InputError(path, _EXISTS, _USE_OVERWRITE)
    return InputError(path, f"cannot be written ({_reason(error)})")


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
