"""How much a message holds: a few megabytes can be millions of empty messages, each of which costs whoever reads it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from google.protobuf.message import Message
from google.protobuf.struct_pb2 import ListValue, Struct, Value

MAX_ENTRIES = 250_000
MAX_MESSAGES = 60_000  # that have fields themselves: each costs as much as a hundred numbers
_JSON = (Struct, Value, ListValue)  # their fields are no names to anybody


def crowding(message: Message, most: int = MAX_ENTRIES, most_messages: int = MAX_MESSAGES) -> str:
    """The problem of a message whose lists and maps have more than ``most`` entries in all; empty if they have not.

    Entries are counted before they are looked into, so that no more than ``most_messages`` ever are.
    """
    n_entries, n_messages, waiting = 0, 0, [("", message)]
    while waiting:
        path, one = waiting.pop()
        for field, value in one.ListFields():
            where = path if isinstance(one, _JSON) else f"{path}.{field.name}" if path else field.name
            if field.is_repeated:
                n_entries += len(value)
                if n_entries > most:
                    return f"{where}: too many entries; all lists of a message together may have {most}"
                n_messages += len(value) if field.message_type is not None else 0
                if n_messages > most_messages:
                    return f"{where}: too many entries; all that have fields of their own may be {most_messages}"
            waiting.extend(_messages(field, value, where))
    return ""


def _messages(field: Any, value: Any, where: str) -> Iterator[tuple[str, Message]]:
    kind = field.message_type
    if kind is None:
        return
    if kind.GetOptions().map_entry:
        if kind.fields_by_name["value"].message_type is not None:
            yield from ((where, one) for one in value.values())
    elif field.is_repeated:
        yield from ((where, one) for one in value)
    else:
        yield where, value
