"""How numba compiles kernels and their steps: no more than what is needed, and without detours.

Numba optimises every function, turns it into machine code, and then does both again with the
functions that it has been copied into. Here the optimiser sees a step for the first time in the
kernel that Python calls, and only that becomes machine code. So nested steps cost no more than one
that does all, and the result is as fast.
"""

import gc
from collections.abc import Callable
from typing import Any

from numba.core import codegen, compiler, compiler_machinery, typed_passes, types
from numba.extending import models, register_model

from pipelines.lightfield.element_lowering import KernelLowering

# Numba's parts, of which it tells no types.
_Library: Any = codegen.JITCodeLibrary
_Compiler: Any = compiler.CompilerBase
_Flags: Any = compiler.Flags
_Lowering: Any = typed_passes.NativeLowering
_Passes: Any = compiler_machinery.PassManager
_register: Any = compiler_machinery.register_pass
_usual_passes: Any = compiler.DefaultPassBuilder.define_nopython_pipeline
_general_type: Any = types.unliteral
# Python's calls nest in memory of pieces of 16 kB. A piece is given back as soon as it is empty:
# where many calls go to and fro across a border, the system makes and clears a piece for each. One
# call with room for so many references takes a piece that numba's nested calls fit into.
ROOM = 1 << 17


class KernelFlags(_Flags):  # type: ignore[misc]
    """Numba's flags of a function, compared by what is set.

    Numba compares them at each read of an array, and makes lists of all there are for it.
    """

    __slots__ = ()

    def __hash__(self) -> int:
        return hash(frozenset(self._values))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, KernelFlags) and bool(self._values == other._values)


class _KernelCompiler(_Compiler):  # type: ignore[misc]
    """Numba's compiler with these flags."""

    def __init__(self, *arguments: Any) -> None:
        typing, target, library, types_of, result, flags, variables = arguments
        flags = KernelFlags(flags)
        super().__init__(typing, target, library, types_of, result, flags, variables)


class KernelCompiler(_KernelCompiler):
    """Numba's usual passes, in one large piece of memory, without looking for unused objects.

    So many objects are made that stay that looking for those that do not, in cycles, would take a
    seventh of the time.
    """

    def compile_extra(self, function: Callable[..., object]) -> Any:
        """Compiles a function and, on the way, the steps that it calls."""
        was_on = gc.isenabled()
        gc.disable()
        try:
            return _call_with_room(super().compile_extra, function)
        finally:
            if was_on:
                gc.enable()

    def define_pipelines(self) -> list[Any]:
        """The passes in their order."""
        return _passes_with(self.state, "kernel", _KernelLowering)


def _call_with_room(work: Callable[..., object], argument: object) -> object:
    return work(argument)


_call_with_room.__code__ = _call_with_room.__code__.replace(co_stacksize=ROOM)


class StepCompiler(_KernelCompiler):
    """Numba's usual passes, but for the one that makes machine code.

    A step may not raise anything.
    """

    def define_pipelines(self) -> list[Any]:
        """The passes in their order."""
        return _passes_with(self.state, "step", _StepLowering)


class StepType(types.Dispatcher):
    """The type of a step in compiled functions: compiled once, be numbers constants or not."""

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """The signature of the version for some types, which is compiled where there is none."""
        return super().get_call_type(context, tuple(_general_type(own) for own in args), kws)


register_model(StepType)(models.OpaqueModel)


class _StepLibrary(_Library):  # type: ignore[misc]
    """The code of a step, of which callers take their copy as it is."""

    def _optimize_final_module(self) -> None:
        """Leaves that to the callers."""

    def _finalize_final_module(self) -> None:
        """Ends without machine code."""
        self._finalized = True


def _passes_with(state: Any, name: str, lowering: type[Any]) -> list[Any]:
    """The usual passes but for one."""
    passes = _Passes(name)
    for own, description in _usual_passes(state).passes:
        passes.add_pass(lowering if own is _Lowering else own, description)
    passes.finalize()
    return [passes]


@_register(mutates_CFG=True, analysis_only=False)
class _KernelLowering(_Lowering):  # type: ignore[misc]
    """Numba's last pass but one, with elements of arrays in few instructions."""

    _name = "kernel_lowering"

    @property
    def lowering_class(self) -> type[Any]:
        """What translates."""
        return KernelLowering


@_register(mutates_CFG=True, analysis_only=False)
class _StepLowering(_KernelLowering):
    """The same into a library of the kind above."""

    _name = "step_lowering"

    def run_pass(self, state: Any) -> bool:
        """Writes the function's code and says to callers where it is."""
        state.library = _StepLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        # By this callers know the version for some types: any function in C that is no other's.
        key = list[object]().append
        lowered = state["cr"]
        state["cr"] = lowered._replace(cfunc=key)
        state.targetctx.insert_user_function(key, lowered.fndesc, [state.library])
        return True
