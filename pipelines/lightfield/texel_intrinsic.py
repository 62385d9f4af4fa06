"""What reads texels and loads pixels in a handful of instructions, for compiled code.

Numba turns a loop over the four channels of a texel into four scalar loops. What a processor can
do is read two neighbouring texels at once and work on their eight channels together. And before a
short loop over several arrays the compiler puts a check whether any two of them overlap, which
takes longer than the loop. So this is written in LLVM's vector types.
"""

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pipelines.lightfield.vector_code import (
    BYTE,
    FLOAT,
    INDEX,
    LANE,
    LANES,
    data_of,
    lanes_at,
    multiply_add,
    repeated,
    vector,
)

CHANNELS = 4


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
        data, target = (data_of(context, builder, signature, arguments, i) for i in (0, 6))
        rows = [_two_texels(builder, data, index) for index in arguments[1:3]]
        weights = [repeated(builder, weight, 2 * CHANNELS) for weight in arguments[4:6]]
        column = builder.fmul(rows[0], weights[0])
        column = multiply_add(builder, rows[1], weights[1], column)
        left, right = (_part(builder, column, start) for start in (0, CHANNELS))
        place = _at_pixel(builder, target, arguments[7])
        total = builder.fadd(builder.load(place, align=4), left)
        step = builder.fsub(right, left)
        across = repeated(builder, arguments[3], CHANNELS)
        builder.store(multiply_add(builder, step, across, total), place, align=4)
        return context.get_dummy_value()

    return signature, generate


# To compiled code it is a function of all arguments but the first.
add_texels = cast("Callable[..., None]", _add_texels)


@intrinsic
def _load_lanes(
    _typing_context: Any,
    columns: Any,
    rows: Any,
    surface: Any,
    pixels: Any,
    first: Any,
    place: Any,
    coefficients: Any,
    scratch: Any,
    row_length: Any,
    targets: Any,
) -> Any:
    """Copies ``LANES`` pixels into a chunk, and works out their weights.

    Args:
        _typing_context: numba's.
        columns: (P,) float32, and
        rows: likewise, and
        surface: likewise; and
        pixels: (P,) int32.
        first: of the pixels in these.
        place: of the first in the chunk.
        coefficients: six float32: x0, y0, a, b, c, d. Columns and rows become relative to the first
            two, and with these the weights are a x + b y + c + d x y.
        scratch: float32; its first four rows receive columns, rows, surface and weights.
        row_length: of the scratch.
        targets: (row_length,) int32 receives the pixels.
    """
    signature = types.void(
        columns,
        rows,
        surface,
        pixels,
        first,
        place,
        coefficients,
        scratch,
        row_length,
        targets,
    )

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def address(number: int, index: Any, kind: ir.Type) -> Any:
            data = data_of(context, builder, signature, arguments, number)
            return lanes_at(builder, data, index, kind)

        first, place = (builder.sext(arguments[i], INDEX) for i in (4, 5))
        x0, y0, a, b, c, d = (
            repeated(builder, builder.extract_value(arguments[6], i), LANES) for i in range(6)
        )
        columns, rows, surface = (builder.load(address(i, first, FLOAT), align=4) for i in range(3))
        x, y = builder.fsub(columns, x0), builder.fsub(rows, y0)
        # a x + c + y (b + d x)
        slope = multiply_add(builder, d, x, b)
        weight = multiply_add(builder, slope, y, multiply_add(builder, a, x, c))
        for row, values in enumerate((x, y, surface, weight)):
            offset = builder.mul(arguments[8], ir.Constant(arguments[8].type, row))
            place_in_row = builder.add(place, builder.sext(offset, INDEX))
            builder.store(values, address(7, place_in_row, FLOAT), align=4)
        builder.store(
            builder.load(address(3, first, LANE), align=4), address(9, place, LANE), align=4
        )
        return context.get_dummy_value()

    return signature, generate


load_lanes = cast("Callable[..., None]", _load_lanes)


def _two_texels(builder: Any, data: Any, index: Any) -> Any:
    """The eight channels of a texel and the next one, as floats."""
    offset = builder.mul(builder.sext(index, INDEX), ir.Constant(INDEX, CHANNELS))
    place = builder.gep(builder.bitcast(data, BYTE.as_pointer()), [offset])
    pair = builder.bitcast(place, ir.VectorType(BYTE, 2 * CHANNELS).as_pointer())
    return builder.uitofp(builder.load(pair, align=CHANNELS), vector(2 * CHANNELS))


def _at_pixel(builder: Any, target: Any, pixel: Any) -> Any:
    """Where the four sums of a pixel stand."""
    offset = builder.mul(builder.sext(pixel, INDEX), ir.Constant(INDEX, CHANNELS))
    return builder.bitcast(builder.gep(target, [offset]), vector(CHANNELS).as_pointer())


def _part(builder: Any, column: Any, start: int) -> Any:
    """Four of the eight lanes."""
    lanes = ir.Constant(ir.VectorType(LANE, CHANNELS), list(range(start, start + CHANNELS)))
    return builder.shuffle_vector(column, ir.Constant(column.type, ir.Undefined), lanes)
