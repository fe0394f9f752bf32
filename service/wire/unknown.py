"""Fields that a message has and this version does not know: refused, since what they ask for would not be done."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from google.protobuf.message import Message
from google.protobuf.struct_pb2 import Struct
from google.protobuf.unknown_fields import UnknownFieldSet


def unknown_fields(message: Message, path: str = "") -> Iterator[str]:
    """One problem for every field number that is not known, anywhere in the message; it is called ``field_NUMBER``."""
    for field in UnknownFieldSet(message):  # type: ignore[attr-defined]
        number = field.field_number
        where = f"{path}.field_{number}".removeprefix(".")
        name = f"field number {number} of {message.DESCRIPTOR.name}"
        yield f"{where}: {name} is unknown here; is the client newer than the server?"
    for field, value in message.ListFields():
        if field.message_type is None or isinstance(value, Struct):
            continue
        inner = f"{path}.{field.name}" if path else field.name
        for step, one in _messages(field, value):
            yield from unknown_fields(one, inner + step)


def _messages(field: Any, value: Any) -> Iterator[tuple[str, Message]]:
    if field.message_type.GetOptions().map_entry:
        return
    if field.is_repeated:
        yield from ((f"[{index}]", one) for index, one in enumerate(value))
    else:
        yield "", value
