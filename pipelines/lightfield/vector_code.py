"""Vectors in LLVM's code, as the intrinsics of kernels write them.

LLVM translates them to what each processor has (AVX, SSE, NEON).
"""

from typing import Any

from llvmlite import ir
from numba.core import cgutils

# Numbers, pixels or points that are worked on together.
LANES = 16
FLOAT, BYTE, INDEX, LANE = ir.FloatType(), ir.IntType(8), ir.IntType(64), ir.IntType(32)
_CONTRACT = ("contract",)
_declared: Any = cgutils.get_or_insert_function


def vector(lanes: int) -> ir.VectorType:
    """The type of so many floats."""
    return ir.VectorType(FLOAT, lanes)


def data_of(context: Any, builder: Any, signature: Any, arguments: Any, number: int) -> Any:
    """Where the elements of the array begin that is an intrinsic's ``number``-th argument."""
    return context.make_array(signature.args[number])(context, builder, arguments[number]).data


def lanes_at(builder: Any, data: Any, index: Any, kind: ir.Type = FLOAT) -> Any:
    """Where ``LANES`` elements stand that begin at an index, as the address of a vector."""
    place = builder.gep(data, [index])
    return builder.bitcast(place, ir.VectorType(kind, LANES).as_pointer())


def repeated(builder: Any, value: Any, lanes: int, kind: ir.Type = FLOAT) -> Any:
    """A vector of equal numbers."""
    undefined = ir.Constant(ir.VectorType(kind, lanes), ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(LANE, 0))
    zeros = ir.Constant(ir.VectorType(LANE, lanes), [0] * lanes)
    return builder.shuffle_vector(first, undefined, zeros)


def constant(value: float) -> Any:
    """A vector of ``LANES`` times the same number."""
    return ir.Constant(vector(LANES), [value] * LANES)


def marked(builder: Any, lanes: Any) -> Any:
    """A truth value for each of ``LANES`` bits."""
    bits = builder.trunc(lanes, ir.IntType(LANES))
    return builder.bitcast(bits, ir.VectorType(ir.IntType(1), LANES))


def gathered(builder: Any, data: Any, indices: Any) -> Any:
    """``LANES`` floats from different places, by one instruction where the processor is fast at it.

    Which are, the compiler knows; for others it makes sixteen loads of it.
    """
    pointers = ir.VectorType(FLOAT.as_pointer(), LANES)
    places = builder.gep(data, [indices], source_etype=FLOAT)
    # One address and many indices give many addresses, which llvmlite does not know.
    places.type = pointers
    every = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [1] * LANES)
    kind = ir.FunctionType(vector(LANES), [pointers, LANE, every.type, vector(LANES)])
    name = f"llvm.masked.gather.v{LANES}f32.v{LANES}p0"
    gather = _declared(builder.module, kind, name)
    return builder.call(gather, [places, ir.Constant(LANE, 4), every, constant(0.0)])


def multiply_add(builder: Any, a: Any, b: Any, c: Any) -> Any:
    """``a b + c``, rounded once where the processor can."""
    return builder.fadd(builder.fmul(a, b, flags=_CONTRACT), c, flags=_CONTRACT)
