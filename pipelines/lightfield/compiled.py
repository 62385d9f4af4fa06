"""How the fast path is compiled: a few decorators, so that all kernels agree.

Compiling is slow, and each step of it is paid for by everybody who starts for the first time. So
only what Python calls gets what Python needs to call it (``compiled``): turning Python's objects
into numbers takes as much code as many a kernel. What compiled functions call is compiled without.
"""

import contextlib
import functools
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile

from pipelines.lightfield.kernel_compiler import KernelCompiler, StepCompiler, StepType

Function = TypeVar("Function", bound=Callable[..., object])

# Where modules are that kernels may name.
PACKAGES = Path(__file__).parents[1]
# What the compiler may do to arithmetic (LLVM's fast-math flags).
EXACT = {"contract"}
REORDERED = {"contract", "reassoc", "nsz"}


def compiled(function: Function) -> Function:
    """Compiles a function to machine code on first use and keeps the result on disk.

    It releases the interpreter lock, divides as the processor does (no exception for zero), and may
    fuse multiplication and addition; infinities and NaN keep their meaning.

    It can make no arrays, nor can what it calls: they are given what they write to. Numba counts
    the references to an array in every function that it is passed to, by locked operations on
    memory that all threads share. In a function that is called for every pixel this takes several
    times as long as the work itself; here it is left out. Slices are no new arrays.
    """
    dispatcher: Any = njit(pipeline_class=KernelCompiler, **_options(EXACT, False))(function)
    # Where no folder can be written to, functions are compiled anew in every process.
    with contextlib.suppress(RuntimeError):
        dispatcher._cache = _DependencyCache(function)
    # To callers a compiled function is the function that it was made from.
    return cast("Function", dispatcher)


def compiled_leaf(function: Function) -> Function:
    """Like ``compiled``, for small functions that only compiled ones call.

    They are compiled and kept along with their callers. From Python it is the plain function.
    """
    return _compiled_inside(function, EXACT, is_copied=True)


def compiled_part(function: Function) -> Function:
    """Like ``compiled_leaf``, for larger functions that are called from several places.

    They are not copied into their callers, where the compiler would work on each of them again.
    """
    return _compiled_inside(function, EXACT, is_copied=False)


def compiled_loop(function: Function) -> Function:
    """Like ``compiled_leaf``, for loops that do the same with many numbers.

    Sums may be added up in any order, so that a processor can work on several terms at once. For
    that, all that is read and written stands in few flat arrays at constant distances: then the
    compiler can prove that nothing it writes is read again.
    """
    return _compiled_inside(function, REORDERED, is_copied=True)


def _compiled_inside(function: Function, arithmetic: set[str], is_copied: bool) -> Function:
    options = _options(arithmetic, is_copied) | {"no_cpython_wrapper": True}
    dispatcher: Any = njit(pipeline_class=StepCompiler, **options)(function)
    # In compiled functions it stands for its machine code, which Python could not call.
    inside: Any = function
    inside._numba_type_ = StepType(dispatcher)
    # The type alone does not keep it.
    inside.dispatcher = dispatcher
    return function


def _options(arithmetic: set[str], is_copied: bool) -> dict[str, Any]:
    return {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": arithmetic,
        # No counting of references.
        "_nrt": False,
        # What is called for every pixel belongs into the loop that calls it.
        "forceinline": is_copied,
        # It is not called by C.
        "no_cfunc_wrapper": True,
    }


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
def source_stamp(path: Path, packages: Path = PACKAGES) -> str:
    """Hash of a module's source code and of that of all modules of the packages that it names."""
    found, pending = {path}, [path]
    while pending:
        source = pending.pop().read_text(encoding="utf-8")
        for package, name in re.findall(r"\bpipelines\.(\w+)\.(\w+)", source):
            module = packages / package / f"{name}.py"
            if module not in found and module.is_file():
                found.add(module)
                pending.append(module)
    digest = hashlib.sha256()
    for module in sorted(found):
        digest.update(module.name.encode() + b"\0" + module.read_bytes())
    return digest.hexdigest()
