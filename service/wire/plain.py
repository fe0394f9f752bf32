"""Messages as the plain data of a request file, and back, by what their descriptors say.

An enum's value is the lower-case end of its name (``HAND_LEFT`` is ``left``); its zero means that nothing is said. A
message whose only content is called ``value`` stands for that value. Empty lists, maps and texts without presence are
absent.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

from google.protobuf.descriptor import EnumDescriptor, FieldDescriptor
from google.protobuf.message import Message
from google.protobuf.struct_pb2 import Struct, Value

from service.errors import RequestError, shown, would_do

VALUE = "value"
_WHOLE = {
    FieldDescriptor.CPPTYPE_INT32,
    FieldDescriptor.CPPTYPE_INT64,
    FieldDescriptor.CPPTYPE_UINT32,
    FieldDescriptor.CPPTYPE_UINT64,
}
_REAL = {FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT}


def to_plain(message: Message) -> Any:
    """Mappings, lists and scalars: what a request file that says the same would be read to."""
    if isinstance(message, Struct):
        return {key: _of_struct(value) for key, value in message.fields.items()}
    data = {field.name: _value_to_plain(field, value) for field, value in message.ListFields()}
    if _stands_for_value(message):
        return data[VALUE] if VALUE in data else next(iter(data.values()), [])
    return data


def fill(message: Message, data: Any, path: str = "") -> None:
    """Write plain data, as ``to_plain`` makes it, into an empty message.

    Raises:
        RequestError: the message has no place for something in the data.
    """
    if isinstance(message, Struct):
        message.update(data)
    elif _stands_for_value(message):
        field = _field_for(message, data)
        if field is None:
            raise RequestError(f"{path}: cannot be sent, got {shown(data)}")
        _fill_field(message, field, data, path)
    elif isinstance(data, Mapping):
        fields = cast(Mapping[str, FieldDescriptor], message.DESCRIPTOR.fields_by_name)
        for key, value in data.items():
            where = f"{path}.{key}" if path else str(key)
            if key not in fields:
                raise RequestError(f"{where}: cannot be sent; {would_do(key, fields)} would do")
            if value is not None:
                _fill_field(message, fields[key], value, where)
    else:
        raise RequestError(f"{path}: a mapping is needed, got {shown(data)}")


def enum_name(enum: EnumDescriptor, number: int) -> str:
    """How a request file writes an enum's value; a number that the enum lacks as the number it is."""
    value = enum.values_by_number.get(number)
    return str(number) if value is None else value.name.removeprefix(_prefix(enum)).lower()


def enum_number(enum: EnumDescriptor, name: str) -> int | None:
    """The value that a request file writes as ``name``."""
    value = enum.values_by_name.get(_prefix(enum) + name.upper())
    return None if value is None else int(value.number)


def _of_struct(value: Value) -> Any:
    """JSON data, and what it has no word for: NaN and infinity stay, for whoever checks the data to refuse.

    Whole numbers, all of which a ``Struct`` keeps as doubles, are whole again.
    """
    match value.WhichOneof("kind"):
        case "struct_value":
            return {key: _of_struct(one) for key, one in value.struct_value.fields.items()}
        case "list_value":
            return [_of_struct(one) for one in value.list_value.values]
        case "number_value":
            number = value.number_value
            return int(number) if number.is_integer() and abs(number) < 2**53 else number
        case "string_value":
            return value.string_value
        case "bool_value":
            return value.bool_value
        case _:
            return None


def _prefix(enum: EnumDescriptor) -> str:
    """``FreeAxis`` is ``FREE_AXIS_``."""
    words = "".join(f"_{letter}" if letter.isupper() else letter for letter in enum.name)
    return words.strip("_").upper() + "_"


def _stands_for_value(message: Message) -> bool:
    descriptor = message.DESCRIPTOR
    return [one.name for one in descriptor.oneofs] == [VALUE] or [field.name for field in descriptor.fields] == [VALUE]


def _is_map(field: FieldDescriptor) -> bool:
    kind = field.message_type
    return kind is not None and kind.GetOptions().map_entry


def _entry(field: FieldDescriptor) -> FieldDescriptor:
    """What a map's entries hold."""
    return cast(FieldDescriptor, field.message_type.fields_by_name[VALUE])  # type: ignore[union-attr]


def _value_to_plain(field: FieldDescriptor, value: Any) -> Any:
    if _is_map(field):
        return dict(value)
    if field.is_repeated:
        return [_one_to_plain(field, one) for one in value]
    return _one_to_plain(field, value)


def _one_to_plain(field: FieldDescriptor, value: Any) -> Any:
    if field.message_type is not None:
        return to_plain(value)
    return enum_name(field.enum_type, value) if field.enum_type is not None else value


def _field_for(message: Message, data: Any) -> FieldDescriptor | None:
    """The field of a message that stands for a value, by the value's type."""
    for field in cast(Sequence[FieldDescriptor], message.DESCRIPTOR.fields):
        if field.is_repeated or field.message_type is not None:
            fits = isinstance(data, list | tuple)
        elif field.cpp_type == FieldDescriptor.CPPTYPE_BOOL:
            fits = isinstance(data, bool)
        elif field.cpp_type == FieldDescriptor.CPPTYPE_STRING:
            fits = isinstance(data, str)
        elif field.cpp_type in _WHOLE:
            fits = isinstance(data, int) and not isinstance(data, bool)
        else:
            fits = isinstance(data, int | float) and not isinstance(data, bool)
        if fits:
            return field
    return None


def _fill_field(message: Message, field: FieldDescriptor, value: Any, path: str) -> None:
    if _is_map(field):
        mapping = getattr(message, field.name)
        for key, one in value.items():
            mapping[key] = _scalar(_entry(field), one, f"{path}.{key}")
    elif field.is_repeated:
        _fill_repeated(getattr(message, field.name), field, value, path)
    elif field.message_type is not None:
        part = getattr(message, field.name)
        part.SetInParent()
        fill(part, value, path)
    else:
        setattr(message, field.name, _scalar(field, value, path))


def _fill_repeated(target: Any, field: FieldDescriptor, values: Iterable[Any], path: str) -> None:
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise RequestError(f"{path}: a list is needed, got {shown(values)}")
    if field.message_type is None:
        target.extend([_scalar(field, one, f"{path}[{index}]") for index, one in enumerate(values)])
        return
    for index, one in enumerate(values):
        fill(target.add(), one, f"{path}[{index}]")


def _scalar(field: FieldDescriptor, value: Any, path: str) -> Any:
    if field.enum_type is not None:
        number = enum_number(field.enum_type, str(value))
        if not number:
            known = [enum_name(field.enum_type, one.number) for one in field.enum_type.values if one.number]
            raise RequestError(f"{path}: {would_do(value, known)} would do, got {shown(value)}")
        return number
    if field.cpp_type in _REAL and isinstance(value, int):
        return float(value)
    return value
