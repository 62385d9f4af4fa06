"""How the fast path is compiled: one decorator, so that all kernels agree."""

import contextlib
import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compiles a function to machine code on first use and keeps the result on disk.

    It releases the interpreter lock, divides as the processor does (no exception for zero), and may
    fuse multiplication and addition; infinities and NaN keep their meaning.
    """
    dispatcher: Any = njit(nogil=True, error_model="numpy", fastmath={"contract"})(function)
    # Where no folder can be written to, functions are compiled anew in every process.
    with contextlib.suppress(RuntimeError):
        dispatcher._cache = _PackageCache(function)
    # To callers a compiled function is the function that it was made from.
    return cast("Function", dispatcher)


class _PackageCache(FunctionCache):
    """Machine code on disk that is used only as long as no module of this package has changed.

    Numba's own cache looks at the module of the function alone. A kernel contains the functions
    that it calls: after a change to one of their modules it would go on running their old code.
    """

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._cache_file = IndexDataCacheFile(  # type: ignore[no-untyped-call]
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=package_stamp(),
        )


@functools.cache
def package_stamp() -> str:
    """Hash of the source code of all modules of this package."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
