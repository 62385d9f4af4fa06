"""One bilinear sample of an RGBA photo in a handful of instructions, for compiled code.

Numba turns a loop over the four channels of a texel into four scalar loops. What a processor can
do is read two neighbouring texels at once and work on their eight channels together; that is
written here in LLVM's vector types, which every processor that numba knows gets translated to its
own (AVX, SSE, NEON).
"""

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

CHANNELS = 4
_FLOAT, _BYTE, _INDEX, _LANE = ir.FloatType(), ir.IntType(8), ir.IntType(64), ir.IntType(32)
_CONTRACT = ("contract",)


@intrinsic
def _add_texels(
    _typing_context: Any,
    texels: Any,
    upper: Any,
    lower: Any,
    fraction: Any,
    upper_weight: Any,
    lower_weight: Any,
    sums: Any,
    pixel: Any,
) -> Any:
    """Adds the weighted colour between four texels to a pixel.

    Args:
        _typing_context: numba's.
        texels: (T, 4) uint8; at least one texel follows each that is named.
        upper: index of the upper left texel; the upper right one is the next.
        lower: index of the lower left texel.
        fraction: float32, how far the place is from the left texels to the right ones, 0 to 1.
        upper_weight: float32, of the upper texels.
        lower_weight: float32, of the lower texels.
        sums: (P, 4) float32, changed.
        pixel: index of the pixel in it.
    """
    signature = types.void(texels, upper, lower, fraction, upper_weight, lower_weight, sums, pixel)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        texel_array, sum_array = signature.args[0], signature.args[6]
        data = context.make_array(texel_array)(context, builder, arguments[0]).data
        target = context.make_array(sum_array)(context, builder, arguments[6]).data
        rows = [_two_texels(builder, data, index) for index in arguments[1:3]]
        weights = [_repeated(builder, weight, 2 * CHANNELS) for weight in arguments[4:6]]
        column = builder.fmul(rows[0], weights[0])
        column = _multiply_add(builder, rows[1], weights[1], column)
        left, right = (_part(builder, column, start) for start in (0, CHANNELS))
        place = _at_pixel(builder, target, arguments[7])
        total = builder.fadd(builder.load(place, align=4), left)
        step = builder.fsub(right, left)
        across = _repeated(builder, arguments[3], CHANNELS)
        builder.store(_multiply_add(builder, step, across, total), place, align=4)
        return context.get_dummy_value()

    return signature, generate


# To compiled code it is a function of all arguments but the first.
add_texels = cast("Callable[..., None]", _add_texels)


def _vector(lanes: int) -> ir.VectorType:
    return ir.VectorType(_FLOAT, lanes)


def _two_texels(builder: Any, data: Any, index: Any) -> Any:
    """The eight channels of a texel and the next one, as floats."""
    offset = builder.mul(builder.sext(index, _INDEX), ir.Constant(_INDEX, CHANNELS))
    place = builder.gep(builder.bitcast(data, _BYTE.as_pointer()), [offset])
    pair = builder.bitcast(place, ir.VectorType(_BYTE, 2 * CHANNELS).as_pointer())
    return builder.uitofp(builder.load(pair, align=CHANNELS), _vector(2 * CHANNELS))


def _at_pixel(builder: Any, target: Any, pixel: Any) -> Any:
    """Where the four sums of a pixel stand."""
    offset = builder.mul(builder.sext(pixel, _INDEX), ir.Constant(_INDEX, CHANNELS))
    return builder.bitcast(builder.gep(target, [offset]), _vector(CHANNELS).as_pointer())


def _repeated(builder: Any, value: Any, lanes: int) -> Any:
    """A vector of equal numbers."""
    undefined = ir.Constant(_vector(lanes), ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(_LANE, 0))
    zeros = ir.Constant(ir.VectorType(_LANE, lanes), [0] * lanes)
    return builder.shuffle_vector(first, undefined, zeros)


def _part(builder: Any, column: Any, start: int) -> Any:
    """Four of the eight lanes."""
    lanes = ir.Constant(ir.VectorType(_LANE, CHANNELS), list(range(start, start + CHANNELS)))
    return builder.shuffle_vector(column, ir.Constant(column.type, ir.Undefined), lanes)


def _multiply_add(builder: Any, a: Any, b: Any, c: Any) -> Any:
    """``a b + c``, rounded once where the processor can."""
    return builder.fadd(builder.fmul(a, b, flags=_CONTRACT), c, flags=_CONTRACT)
