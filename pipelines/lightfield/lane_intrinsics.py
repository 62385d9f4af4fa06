"""Questions and choices that compiled code asks and makes for sixteen numbers at once.

Where the compiler makes a branch of a choice that nobody can foresee, the processor guesses wrong
and starts again; and short loops it unrolls before it sees that a vector could do. So these are
written in LLVM's vector types. Sixteen answers are the bits of one number.
"""

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pipelines.lightfield.vector_code import (
    INDEX,
    LANE,
    LANES,
    constant,
    data_of,
    gathered,
    lanes_at,
    marked,
    repeated,
)


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
        table, data = (data_of(context, builder, signature, arguments, i) for i in (1, 9))
        zero, nowhere = constant(0.0), ir.Constant(ir.VectorType(LANE, LANES), [0] * LANES)
        is_wanted = marked(builder, arguments[0])

        def everywhere(number: int) -> Any:
            return repeated(builder, arguments[number], LANES)

        def values(number: int) -> Any:
            first = builder.extract_value(arguments[10], number)
            return builder.load(lanes_at(builder, data, first), align=4)

        def place(number: int, scale: Any, last: Any) -> Any:
            value = values(number)
            value = builder.fmul(builder.fadd(value, constant(0.5)), scale)
            value = builder.select(builder.fcmp_ordered("<", value, last), value, last)
            value = builder.select(builder.fcmp_ordered(">", value, zero), value, zero)
            return builder.fptosi(value, nowhere.type)

        x, y = place(0, everywhere(4), everywhere(6)), place(1, everywhere(5), everywhere(7))
        indices = builder.add(x, builder.mul(y, repeated(builder, arguments[3], LANES, LANE)))
        # What nobody asks for is looked up where it costs nothing.
        indices = builder.select(is_wanted, indices, nowhere)
        seen = gathered(builder, builder.gep(table, [arguments[2]]), indices)
        own = builder.fmul(values(2), everywhere(8))
        hides = builder.and_(is_wanted, builder.fcmp_ordered(">", seen, own))
        return builder.zext(builder.bitcast(hides, ir.IntType(LANES)), INDEX)

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
        data = data_of(context, builder, signature, arguments, 1)
        pointer = lanes_at(builder, data, arguments[2])
        new = repeated(builder, arguments[3], LANES)
        kept = builder.load(pointer, align=4)
        changed = builder.select(marked(builder, arguments[0]), new, kept)
        builder.store(changed, pointer, align=4)
        return context.get_dummy_value()

    return signature, generate


set_lanes = cast("Callable[..., None]", _set_lanes)


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
            data = data_of(context, builder, signature, arguments, number)
            pointer = lanes_at(builder, data, arguments[number + 1])
            lanes.append(builder.load(pointer, align=4))
        found = builder.fcmp_ordered("<=", *lanes)
        return builder.zext(builder.bitcast(found, ir.IntType(LANES)), INDEX)

    return signature, generate


lanes_within = cast("Callable[..., int]", _lanes_within)


@intrinsic
def _first_lane(_typing_context: Any, lanes: Any) -> Any:
    """The first of some lanes, given as ``lanes_within`` does; there is at least one."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return lanes(lanes), generate


first_lane = cast("Callable[[int], int]", _first_lane)


@intrinsic
def _either(_typing_context: Any, condition: Any, first: Any, second: Any) -> Any:
    """The first of two numbers of one type if the condition holds, else the second."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.select(*arguments)

    return first(condition, first, second), generate


either = cast("Callable[..., Any]", _either)
