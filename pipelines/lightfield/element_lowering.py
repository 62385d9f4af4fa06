"""How kernels read and write the elements of arrays: in as few instructions as it takes.

Numba copies an array's description to memory, reads it back number by number, and leaves it to the
optimiser to see that it need not have; that is two thirds of all that it writes for kernels. Here
the numbers that are needed are taken where they are.

In kernels an index counts from the start: none may be negative. Numba asks at each access whether
it is, which takes up to a tenth of a kernel's time. With ``LFNAV_CHECK_INDICES=1`` in the
environment, and ``NUMBA_CACHE_DIR`` naming an empty folder, a process ends at the first index that
lies outside of its array.
"""

import os
from typing import Any

from llvmlite import ir
from numba.core import lowering, types
from numba.core.errors import NumbaError
from numba.core.imputils import impl_ret_borrowed
from numba.np.arrayobj import load_item, store_item

# Numba's parts, of which it tells no types.
_Lower: Any = lowering.Lower
_load: Any = load_item
_store: Any = store_item
_borrowed: Any = impl_ret_borrowed
ARE_INDICES_CHECKED = os.environ.get("LFNAV_CHECK_INDICES") == "1"
_TRAP = ir.FunctionType(ir.VoidType(), [])
# Places in the description of an array.
MEMINFO, PARENT, COUNT, ITEM_SIZE, DATA, SHAPE, STRIDES = range(7)


class KernelLowering(_Lower):  # type: ignore[misc]
    """Numba's translation of a function, but for elements and rows of arrays without gaps."""

    def lower_getitem(self, result: Any, expression: Any, value: Any, index: Any, call: Any) -> Any:
        """The value of an element, or a view of what a few first indices leave."""
        indices = self._indices(value, index)
        if indices is None:
            return super().lower_getitem(result, expression, value, index, call)
        kind, array = self.typeof(value.name), self.loadvar(value.name)
        place = self._place(kind, array, indices)
        if len(indices) == kind.ndim:
            item = _load(self.context, self.builder, kind, place)
            return self.context.cast(self.builder, item, kind.dtype, result)
        rest = self._rest(array, place, len(indices), kind.ndim, call.return_type)
        return self.context.cast(self.builder, rest, call.return_type, result)

    def lower_setitem(self, target: Any, index: Any, value: Any, call: Any) -> Any:
        """Writes an element."""
        indices, kind = self._indices(target, index), self.typeof(target.name)
        item = self.typeof(value.name)
        is_number = isinstance(item, (types.Number, types.Boolean))
        if indices is None or len(indices) < kind.ndim or not is_number:
            return super().lower_setitem(target, index, value, call)
        place = self._place(kind, self.loadvar(target.name), indices)
        written = self.context.cast(self.builder, self.loadvar(value.name), item, kind.dtype)
        return _store(self.context, self.builder, kind, written, place)

    def _indices(self, array: Any, index: Any) -> list[tuple[Any, Any]] | None:
        """Types and values of whole numbers as indices; None for anything else."""
        kind, own = self.typeof(array.name), self.typeof(index.name)
        if not isinstance(kind, types.Array) or kind.layout != "C":
            return None
        if not isinstance(kind.dtype, (types.Number, types.Boolean)):
            return None
        is_tuple = isinstance(own, types.BaseTuple)
        members = list(own.types) if is_tuple else [own]
        if not all(isinstance(member, types.Integer) for member in members):
            return None
        if not 0 < len(members) <= kind.ndim:
            return None
        for member in members:
            if isinstance(member, types.IntegerLiteral) and member.literal_value < 0:
                raise NumbaError("in a kernel an index counts from the start", self.loc)
        value = self.loadvar(index.name)
        numbers = [value]
        if is_tuple:
            numbers = [self.builder.extract_value(value, place) for place in range(len(members))]
        return list(zip(members, numbers, strict=True))

    def _place(self, kind: Any, array: Any, indices: list[tuple[Any, Any]]) -> Any:
        """Where in memory an element lies, or the first one of a view."""
        builder, offset = self.builder, None
        for axis in range(kind.ndim):
            if axis >= len(indices) and offset is not None:
                offset = builder.mul(offset, builder.extract_value(array, [SHAPE, axis]))
                continue
            own, number = indices[axis]
            size = builder.extract_value(array, [SHAPE, axis])
            step = self.context.cast(builder, number, own, types.intp)
            if ARE_INDICES_CHECKED:
                with builder.if_then(builder.icmp_unsigned(">=", step, size), likely=False):
                    builder.call(builder.module.declare_intrinsic("llvm.trap", (), _TRAP), [])
            offset = step if offset is None else builder.add(builder.mul(offset, size), step)
        return builder.gep(builder.extract_value(array, DATA), [offset])

    def _rest(self, array: Any, place: Any, count: int, dimensions: int, kind: Any) -> Any:
        """The description of a view of what ``count`` indices leave of an array."""
        builder = self.builder
        result = self.context.get_constant_undef(kind)
        items = None
        for axis in range(count, dimensions):
            for part in (SHAPE, STRIDES):
                number = builder.extract_value(array, [part, axis])
                result = builder.insert_value(result, number, [part, axis - count])
            size = builder.extract_value(array, [SHAPE, axis])
            items = size if items is None else builder.mul(items, size)
        for part in (MEMINFO, PARENT, ITEM_SIZE):
            result = builder.insert_value(result, builder.extract_value(array, part), part)
        result = builder.insert_value(builder.insert_value(result, items, COUNT), place, DATA)
        return _borrowed(self.context, builder, kind, result)
