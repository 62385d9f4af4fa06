"""How the fast path is compiled: one decorator, so that all kernels agree."""

import contextlib
import functools
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile

Function = TypeVar("Function", bound=Callable[..., object])

# What the compiler may do to arithmetic (LLVM's fast-math flags).
EXACT = {"contract"}
REORDERED = {"contract", "reassoc", "nsz"}


def compiled(function: Function) -> Function:
    """Compiles a function to machine code on first use and keeps the result on disk.

    It releases the interpreter lock, divides as the processor does (no exception for zero), and may
    fuse multiplication and addition; infinities and NaN keep their meaning.
    """
    return _compiled(function, EXACT, count_references=True)


def compiled_leaf(function: Function) -> Function:
    """Like ``compiled``, for small functions that neither make arrays nor slice them.

    Numba counts the references to an array in every function that it is passed to, by locked
    operations on memory that all threads share. In a function that is called for every pixel this
    takes several times as long as the work itself; here it is left out. A function that makes an
    array after all does not compile.
    """
    return _compiled(function, EXACT, count_references=False)


def compiled_part(function: Function) -> Function:
    """Like ``compiled_leaf``, for larger functions that are called from several places.

    They are not copied into their callers, where the compiler would work on each of them again.
    """
    return _compiled(function, EXACT, count_references=False, is_copied=False)


def compiled_loop(function: Function) -> Function:
    """Like ``compiled_leaf``, for loops that do the same with many numbers.

    Sums may be added up in any order, so that a processor can work on several terms at once. For
    that, all that is read and written stands in few flat arrays at constant distances: then the
    compiler can prove that nothing it writes is read again.
    """
    return _compiled(function, REORDERED, count_references=False)


def _compiled(
    function: Function,
    arithmetic: set[str],
    count_references: bool,
    is_copied: bool | None = None,
) -> Function:
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": arithmetic,
        "_nrt": count_references,
        # What is called for every pixel belongs into the loop that calls it.
        "forceinline": not count_references if is_copied is None else is_copied,
    }
    dispatcher: Any = njit(**options)(function)
    # Where no folder can be written to, functions are compiled anew in every process.
    with contextlib.suppress(RuntimeError):
        dispatcher._cache = _DependencyCache(function)
    # To callers a compiled function is the function that it was made from.
    return cast("Function", dispatcher)


class _DependencyCache(FunctionCache):
    """Machine code on disk that is used only while no module that went into it has changed.

    Numba's own cache looks at the module of the function alone. A kernel contains the functions
    that it calls: after a change to one of their modules it would go on running their old code.
    """

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._cache_file = IndexDataCacheFile(  # type: ignore[no-untyped-call]
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=source_stamp(Path(function.__code__.co_filename)),
        )


@functools.cache
def source_stamp(path: Path) -> str:
    """Hash of a module's source code and of that of all modules of its package that it names."""
    package = f"pipelines.{path.parent.name}."
    found, pending = {path}, [path]
    while pending:
        source = pending.pop().read_text(encoding="utf-8")
        for name in re.findall(re.escape(package) + r"(\w+)", source):
            module = path.with_name(f"{name}.py")
            if module not in found and module.is_file():
                found.add(module)
                pending.append(module)
    digest = hashlib.sha256()
    for module in sorted(found):
        digest.update(module.name.encode() + b"\0" + module.read_bytes())
    return digest.hexdigest()
