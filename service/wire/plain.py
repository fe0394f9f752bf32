"""Conversion of messages to the plain data of a request file and back, by their descriptors.

An enum's value is the lower-case end of its name (``HAND_LEFT`` is ``left``); its zero means absent. A message whose
only content is called ``value`` stands for that value. Empty lists, maps and texts without presence are absent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import Any, cast

from google.protobuf.descriptor import Descriptor, EnumDescriptor, FieldDescriptor
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
    """Convert a message to mappings, lists and scalars, as YAML of the same request would be read."""
    if isinstance(message, Struct):
        return {key: _value_of_struct(value) for key, value in message.fields.items()}
    data = {}
    for field, value in message.ListFields():
        convert = _converter_of(field)
        data[field.name] = value if convert is None else convert(value)
    if _stands_for_value(message.DESCRIPTOR):
        return data[VALUE] if VALUE in data else next(iter(data.values()), [])
    return data


def fill(message: Message, data: Any, path: str = "") -> None:
    """Write plain data, as ``to_plain`` returns it, into an empty message.

    Raises:
        RequestError: the message has no field for a part of the data.
    """
    if isinstance(message, Struct):
        message.update(data)
    elif _stands_for_value(message.DESCRIPTOR):
        field = _field_for(message, data)
        if field is None:
            raise RequestError(f"{path}: cannot be sent, got {shown(data)}")
        _fill_field(message, field, data, path)
    elif isinstance(data, Mapping):
        fields = cast(Mapping[str, FieldDescriptor], message.DESCRIPTOR.fields_by_name)
        for key, value in data.items():
            inner = f"{path}.{key}" if path else str(key)
            if key not in fields:
                raise RequestError(f"{inner}: cannot be sent; expected {would_do(key, fields)}")
            if value is not None:
                _fill_field(message, fields[key], value, inner)
    else:
        raise RequestError(f"{path}: expected a mapping, got {shown(data)}")


def decode_enum(enum: EnumDescriptor, number: int) -> str:
    """Return an enum's value as a request file writes it; an unknown number stays a number."""
    value = enum.values_by_number.get(number)
    return str(number) if value is None else value.name.removeprefix(_prefix(enum)).lower()


def encode_enum(enum: EnumDescriptor, name: str) -> int | None:
    """Return the number of a value that a request file writes as ``name``."""
    value = enum.values_by_name.get(_prefix(enum) + name.upper())
    return None if value is None else int(value.number)


def _value_of_struct(value: Value) -> Any:
    """Convert JSON data; NaN and infinity stay, for the validator to refuse.

    A ``Struct`` stores all numbers as doubles; whole ones become integers again.
    """
    match value.WhichOneof("kind"):
        case "struct_value":
            return {key: _value_of_struct(entry) for key, entry in value.struct_value.fields.items()}
        case "list_value":
            return [_value_of_struct(entry) for entry in value.list_value.values]
        case "number_value":
            number = value.number_value
            return int(number) if number.is_integer() and abs(number) < 2**53 else number
        case "string_value":
            return value.string_value
        case "bool_value":
            return value.bool_value
        case _:
            return None


@cache
def _prefix(enum: EnumDescriptor) -> str:
    """Return the prefix of an enum's values: ``FREE_AXIS_`` for ``FreeAxis``."""
    words = "".join(f"_{letter}" if letter.isupper() else letter for letter in enum.name)
    return words.strip("_").upper() + "_"


@cache  # a look at a descriptor takes as long as the conversion itself
def _stands_for_value(descriptor: Descriptor) -> bool:
    return [oneof.name for oneof in descriptor.oneofs] == [VALUE] or [field.name for field in descriptor.fields] == [
        VALUE
    ]


def _is_map(field: FieldDescriptor) -> bool:
    kind = field.message_type
    return kind is not None and kind.GetOptions().map_entry


def _map_value(field: FieldDescriptor) -> FieldDescriptor:
    """Return the field of a map's values."""
    return cast(FieldDescriptor, field.message_type.fields_by_name[VALUE])  # type: ignore[union-attr]


@cache
def _converter_of(field: FieldDescriptor) -> Callable[[Any], Any] | None:
    """Return the function that converts a field's value to plain data; None if it is plain already."""
    if _is_map(field):
        return _map_converter(_entry_converter_of(_map_value(field)))
    convert = _entry_converter_of(field)
    return _list_converter(convert) if field.is_repeated else convert


def _map_converter(convert: Callable[[Any], Any] | None) -> Callable[[Any], Any]:
    return dict if convert is None else lambda value: {key: convert(entry) for key, entry in value.items()}


def _list_converter(convert: Callable[[Any], Any] | None) -> Callable[[Any], Any]:
    return list if convert is None else lambda value: [convert(entry) for entry in value]


def _entry_converter_of(field: FieldDescriptor) -> Callable[[Any], Any] | None:
    if field.message_type is not None:
        return to_plain
    enum = field.enum_type
    return None if enum is None else lambda value: decode_enum(enum, value)


def _field_for(message: Message, data: Any) -> FieldDescriptor | None:
    """Return the field for a value's type in a message that stands for a value."""
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
        mapping, kind = getattr(message, field.name), _map_value(field)
        for key, entry in value.items():
            if kind.message_type is not None:
                fill(mapping[key], entry, f"{path}.{key}")
            else:
                mapping[key] = _to_scalar(kind, entry, f"{path}.{key}")
    elif field.is_repeated:
        _fill_repeated(getattr(message, field.name), field, value, path)
    elif field.message_type is not None:
        part = getattr(message, field.name)
        part.SetInParent()
        fill(part, value, path)
    else:
        setattr(message, field.name, _to_scalar(field, value, path))


def _fill_repeated(target: Any, field: FieldDescriptor, values: Iterable[Any], path: str) -> None:
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise RequestError(f"{path}: expected a list, got {shown(values)}")
    if field.message_type is None:
        target.extend([_to_scalar(field, entry, f"{path}[{index}]") for index, entry in enumerate(values)])
        return
    for index, entry in enumerate(values):
        fill(target.add(), entry, f"{path}[{index}]")


def _to_scalar(field: FieldDescriptor, value: Any, path: str) -> Any:
    if field.enum_type is not None:
        number = encode_enum(field.enum_type, str(value))
        if not number:
            known = [decode_enum(field.enum_type, entry.number) for entry in field.enum_type.values if entry.number]
            raise RequestError(f"{path}: expected {would_do(value, known)}, got {shown(value)}")
        return number
    if field.cpp_type in _REAL and isinstance(value, int):
        return float(value)
    return value
