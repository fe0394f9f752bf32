"""Checks of a received message before it is read: its number of entries, and fields unknown to this version."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from google.protobuf.message import Message
from google.protobuf.struct_pb2 import ListValue, Struct, Value
from google.protobuf.unknown_fields import UnknownFieldSet

MAX_ENTRIES = 250_000  # a few megabytes can hold millions of empty messages, each of which takes time to read
MAX_MESSAGES = 60_000  # each takes as long to read as a hundred numbers
_JSON = (Struct, Value, ListValue)  # messages whose field names mean nothing to a client


def find_excess(message: Message, max_entries: int = MAX_ENTRIES, max_messages: int = MAX_MESSAGES) -> str:
    """Return the problem of a message whose lists and maps have too many entries in all; empty if there is none.

    Entries are counted before they are read, so that no more than ``max_messages`` messages are ever read.
    """
    n_entries, n_messages, waiting = 0, 0, [("", message)]
    while waiting:
        path, part = waiting.pop()
        for field, value in part.ListFields():
            inner = path if isinstance(part, _JSON) else f"{path}.{field.name}" if path else field.name
            if field.is_repeated:
                n_entries += len(value)
                if n_entries > max_entries:
                    return f"{inner}: too many entries; expected at most {max_entries} in all lists of a message"
                n_messages += len(value) if field.message_type is not None else 0
                if n_messages > max_messages:
                    return f"{inner}: too many entries; expected at most {max_messages} that have fields"
            waiting.extend((inner, nested) for _, nested in _nested_messages(field, value))
    return ""


def has_unknown_fields(message: Message) -> bool:
    """Return whether there is an unknown field anywhere in a message; much faster than to name it."""
    known = type(message)()
    known.CopyFrom(message)
    known.DiscardUnknownFields()
    return known.ByteSize() != message.ByteSize()


def find_unknown_fields(message: Message, path: str = "") -> Iterator[str]:
    """Yield a warning for every unknown field number in a message, whose field is called ``field_NUMBER``."""
    for field in UnknownFieldSet(message):  # type: ignore[attr-defined]
        number = field.field_number
        name = f"field number {number} of {message.DESCRIPTOR.name}"
        inner = f"{path}.field_{number}".removeprefix(".")
        yield f"{inner}: {name} is unknown to this server and was ignored; the client is newer than the server"
    for field, value in message.ListFields():
        if field.message_type is None or field.message_type.GetOptions().map_entry or isinstance(value, Struct):
            continue
        inner = f"{path}.{field.name}" if path else field.name
        for step, nested in _nested_messages(field, value):
            yield from find_unknown_fields(nested, inner + step)


def _nested_messages(field: Any, value: Any) -> Iterator[tuple[str, Message]]:
    """Yield step of the path and message for each message in a field."""
    kind = field.message_type
    if kind is None:
        return
    if kind.GetOptions().map_entry:
        if kind.fields_by_name["value"].message_type is not None:
            yield from (("", entry) for entry in value.values())
    elif field.is_repeated:
        yield from ((f"[{index}]", entry) for index, entry in enumerate(value))
    else:
        yield "", value
