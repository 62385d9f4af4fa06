"""What compiled code needs in a handful of instructions: bilinear samples, comparisons of numbers.

Numba turns a loop over the four channels of a texel into four scalar loops. What a processor can
do is read two neighbouring texels at once and work on their eight channels together. And before a
short loop over several arrays the compiler puts a check whether any two of them overlap, which
takes longer than the loop. And where it makes a branch of a choice that nobody can foresee, the
processor guesses wrong and starts again. All this is written here in LLVM's vector types and
choices, which are translated to what each processor has (AVX, SSE, NEON).
"""

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

CHANNELS = 4
# Pixels that are loaded together.
LANES = 16
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
        kinds = signature.args

        def address(number: int, index: Any, kind: ir.Type) -> Any:
            data = context.make_array(kinds[number])(context, builder, arguments[number]).data
            pointer = builder.gep(data, [index])
            return builder.bitcast(pointer, ir.VectorType(kind, LANES).as_pointer())

        first, place = (builder.sext(arguments[i], _INDEX) for i in (4, 5))
        x0, y0, a, b, c, d = (
            _repeated(builder, builder.extract_value(arguments[6], i), LANES) for i in range(6)
        )
        columns, rows, surface = (
            builder.load(address(i, first, _FLOAT), align=4) for i in range(3)
        )
        x, y = builder.fsub(columns, x0), builder.fsub(rows, y0)
        # a x + c + y (b + d x)
        slope = _multiply_add(builder, d, x, b)
        weight = _multiply_add(builder, slope, y, _multiply_add(builder, a, x, c))
        for row, values in enumerate((x, y, surface, weight)):
            offset = builder.mul(arguments[8], ir.Constant(arguments[8].type, row))
            place_in_row = builder.add(place, builder.sext(offset, _INDEX))
            builder.store(values, address(7, place_in_row, _FLOAT), align=4)
        builder.store(
            builder.load(address(3, first, _LANE), align=4), address(9, place, _LANE), align=4
        )
        return context.get_dummy_value()

    return signature, generate


load_lanes = cast("Callable[..., None]", _load_lanes)


@intrinsic
def _find_hidden_lanes(
    _typing_context: Any,
    wanted: Any,
    table: Any,
    start: Any,
    across: Any,
    scale_x: Any,
    scale_y: Any,
    last_x: Any,
    last_y: Any,
    factor: Any,
    scratch: Any,
    places: Any,
) -> Any:
    """Finds which of ``LANES`` points something in a table of inverse depths hides.

    Args:
        _typing_context: numba's.
        wanted: a bit for each point, 1 where it is looked up.
        table: (T,) float32.
        start: of the part of it that counts.
        across: int32, its row length.
        scale_x: float32, how many of the table's columns one of the points' is, and
        scale_y: of its rows.
        last_x: float32, the table's last column, and
        last_y: its last row.
        factor: float32, by which something has to be nearer than a point.
        scratch: float32.
        places: where in it the points' columns, their rows and their inverse depths begin.

    Returns:
        A bit for each point, 1 where it is hidden.
    """
    signature = types.int64(
        wanted,
        table,
        start,
        across,
        scale_x,
        scale_y,
        last_x,
        last_y,
        factor,
        scratch,
        places,
    )

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        table, data = (
            context.make_array(signature.args[i])(context, builder, arguments[i]).data
            for i in (1, 9)
        )
        zero, nowhere = _constant(0.0), ir.Constant(ir.VectorType(_LANE, LANES), [0] * LANES)
        is_wanted = _marked(builder, arguments[0])

        def repeated(number: int) -> Any:
            return _repeated(builder, arguments[number], LANES)

        def values(number: int) -> Any:
            pointer = builder.gep(data, [builder.extract_value(arguments[10], number)])
            return builder.load(builder.bitcast(pointer, _vector(LANES).as_pointer()), align=4)

        def place(number: int, scale: Any, last: Any) -> Any:
            value = values(number)
            value = builder.fmul(builder.fadd(value, _constant(0.5)), scale)
            value = builder.select(builder.fcmp_ordered("<", value, last), value, last)
            value = builder.select(builder.fcmp_ordered(">", value, zero), value, zero)
            return builder.fptosi(value, nowhere.type)

        x, y = place(0, repeated(4), repeated(6)), place(1, repeated(5), repeated(7))
        indices = builder.add(x, builder.mul(y, _repeated(builder, arguments[3], LANES, _LANE)))
        # What nobody asks for is looked up where it costs nothing.
        indices = builder.select(is_wanted, indices, nowhere)
        seen = _gathered(builder, builder.gep(table, [arguments[2]]), indices)
        own = builder.fmul(values(2), repeated(8))
        hides = builder.and_(is_wanted, builder.fcmp_ordered(">", seen, own))
        return builder.zext(builder.bitcast(hides, ir.IntType(LANES)), _INDEX)

    return signature, generate


find_hidden_lanes = cast("Callable[..., int]", _find_hidden_lanes)


@intrinsic
def _set_lanes(_typing_context: Any, lanes: Any, values: Any, first: Any, new: Any) -> Any:
    """Sets some of ``LANES`` numbers.

    Args:
        _typing_context: numba's.
        lanes: a bit for each, 1 where it is set.
        values: (n,) float32, changed; the numbers begin at
        first: there.
        new: float32, what they become.
    """
    signature = types.void(lanes, values, first, new)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[1])(context, builder, arguments[1]).data
        place = builder.gep(data, [arguments[2]])
        pointer = builder.bitcast(place, _vector(LANES).as_pointer())
        new = _repeated(builder, arguments[3], LANES)
        kept = builder.load(pointer, align=4)
        changed = builder.select(_marked(builder, arguments[0]), new, kept)
        builder.store(changed, pointer, align=4)
        return context.get_dummy_value()

    return signature, generate


set_lanes = cast("Callable[..., None]", _set_lanes)


def _marked(builder: Any, lanes: Any) -> Any:
    """A truth value for each of ``LANES`` bits."""
    bits = builder.trunc(lanes, ir.IntType(LANES))
    return builder.bitcast(bits, ir.VectorType(ir.IntType(1), LANES))


def _constant(value: Any) -> Any:
    """A vector of ``LANES`` times the same number."""
    kind = _vector(LANES)
    return ir.Constant(kind, value if value is ir.Undefined else [value] * LANES)


@intrinsic
def _either(_typing_context: Any, condition: Any, first: Any, second: Any) -> Any:
    """The first of two numbers of one type if the condition holds, else the second."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.select(*arguments)

    return first(condition, first, second), generate


either = cast("Callable[..., Any]", _either)


@intrinsic
def _lanes_within(
    _typing_context: Any, values: Any, first: Any, limits: Any, first_limit: Any
) -> Any:
    """Which of ``LANES`` numbers are at most as large as their limits: a bit for each.

    Args:
        _typing_context: numba's.
        values: (n,) float32; those that are compared begin at
        first: index, unsigned.
        limits: (m,) float32, theirs begin at
        first_limit: index, unsigned.
    """
    signature = types.int64(values, first, limits, first_limit)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = []
        for number in (0, 2):
            kind = signature.args[number]
            data = context.make_array(kind)(context, builder, arguments[number]).data
            place = builder.gep(data, [arguments[number + 1]])
            pointer = builder.bitcast(place, _vector(LANES).as_pointer())
            lanes.append(builder.load(pointer, align=4))
        found = builder.fcmp_ordered("<=", *lanes)
        return builder.zext(builder.bitcast(found, ir.IntType(LANES)), _INDEX)

    return signature, generate


lanes_within = cast("Callable[..., int]", _lanes_within)


@intrinsic
def _first_lane(_typing_context: Any, lanes: Any) -> Any:
    """The first of some lanes, given as ``lanes_within`` does; there is at least one."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return lanes(lanes), generate


first_lane = cast("Callable[[int], int]", _first_lane)


def _vector(lanes: int) -> ir.VectorType:
    return ir.VectorType(_FLOAT, lanes)


def _gathered(builder: Any, data: Any, indices: Any) -> Any:
    """``LANES`` floats from different places, loaded in whichever way the processor does best."""
    pointers = ir.VectorType(_FLOAT.as_pointer(), LANES)
    place = ir.instructions.GEPInstr(builder.block, data, [indices], False, "", _FLOAT)
    place.type = pointers
    builder._insert(place)
    every = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [1] * LANES)
    kind = ir.FunctionType(_vector(LANES), [pointers, _LANE, every.type, _vector(LANES)])
    name = f"llvm.masked.gather.v{LANES}f32.v{LANES}p0"
    gather = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
    return builder.call(gather, [place, ir.Constant(_LANE, 4), every, _constant(0.0)])


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


def _repeated(builder: Any, value: Any, lanes: int, kind: ir.Type = _FLOAT) -> Any:
    """A vector of equal numbers."""
    undefined = ir.Constant(ir.VectorType(kind, lanes), ir.Undefined)
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
