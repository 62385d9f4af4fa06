"""Records of arrays as compiled functions take them: by one address.

To numba a named tuple is all numbers of all its arrays: with some fifty of these, each function
that takes one and each call of it is hundreds of lines for the compiler, and so is what unpacks
Python's object. A record is made in Python, stands in memory while a compiled function runs, and
does not change meanwhile.
"""

from typing import Any, TypeVar

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import impl_ret_borrowed, lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, models, register_model, typeof_impl, unbox

Class = TypeVar("Class", bound=type[tuple[Any, ...]])

# Numba's parts, of which it tells no types.
_PointerModel: Any = models.PrimitiveModel
_Template: Any = AttributeTemplate
_getattr_of: Any = lower_getattr_generic
_with_attributes: Any = infer_getattr
_reference_of: Any = impl_ret_borrowed
_codegen: Any = cgutils
_Value: Any = NativeValue
_with_model: Any = register_model
_types: Any = typeof_impl
_unboxes: Any = unbox


class RecordType(types.Type):
    """The type of a record in compiled functions.

    Args:
        own: its named tuple.
        members: numba's types of its attributes.
    """

    def __init__(self, own: Any, members: tuple[Any, ...]) -> None:
        self.own, self.members = own, members
        super().__init__(f"{own.__name__}({', '.join(str(member) for member in members)})")

    @property
    def key(self) -> tuple[Any, ...]:
        """What makes two types one."""
        return self.own, self.members

    @property
    def mangling_args(self) -> tuple[str, tuple[Any, ...]]:
        """What stands for it in the names of compiled functions, which are unique anyway."""
        return self.own.__name__, ()


def compiled_record(own: Class) -> Class:
    """Lets compiled functions take a named tuple of arrays, numbers, and such tuples, as a record.

    They cannot make one. The arrays in it must be there until the function ends.
    """

    def type_of(record: Any, context: Any) -> RecordType:
        return RecordType(own, tuple(_types(member, context) for member in record))

    _types.register(own)(type_of)
    return own


@_with_model(RecordType)
class _RecordModel(_PointerModel):  # type: ignore[misc]
    """A pointer to the attributes, one after the other."""

    def __init__(self, manager: Any, own: RecordType) -> None:
        members = [manager.lookup(member).get_value_type() for member in own.members]
        super().__init__(manager, own, ir.LiteralStructType(members).as_pointer())


@_with_attributes
class _RecordAttributes(_Template):  # type: ignore[misc]
    """Which attributes a record has."""

    key = RecordType

    def generic_resolve(self, record: RecordType, name: str) -> Any:
        """The type of an attribute; None where there is none."""
        if name in record.own._fields:
            return record.members[record.own._fields.index(name)]
        return None


@_getattr_of(RecordType)
def _attribute(context: Any, builder: Any, record: RecordType, address: Any, name: str) -> Any:
    index = record.own._fields.index(name)
    value = builder.load(_codegen.gep_inbounds(builder, address, 0, index))
    # So it need not be read again after other memory was written to.
    value.set_metadata("invariant.load", builder.module.add_metadata([]))
    return _reference_of(context, builder, record.members[index], value)


@_unboxes(RecordType)
def _unboxed(record: RecordType, given: Any, context: Any) -> Any:
    """Writes a record's attributes to memory of the function that turns Python's objects over."""
    builder, python = context.builder, context.pyapi
    kind = context.context.get_value_type(record).pointee
    address = _codegen.alloca_once(builder, kind)
    has_failed = _codegen.false_bit
    for index, member in enumerate(record.members):
        place = _codegen.gep_inbounds(builder, address, 0, index)
        item = python.tuple_getitem(given, index)
        if isinstance(member, types.Array):
            status = python.numba_array_adaptor(item, builder.bitcast(place, python.voidptr))
            is_error = _codegen.is_not_null(builder, status)
        else:
            native = context.unbox(member, item)
            builder.store(native.value, place)
            is_error = native.is_error
        has_failed = builder.or_(has_failed, is_error)
    return _Value(address, is_error=has_failed)
