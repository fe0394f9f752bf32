"""Bounds of numbers in the validator of requests stand in the comments of the schema's fields."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from google.protobuf.descriptor import Descriptor

import service.proto.planner.v1
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.file import adapter_of
from service.request.schema import PlanRequest

SCHEMA = Path(service.proto.planner.v1.__file__).with_name("request.proto")
BOUNDS = ("minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum")
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")

Field = tuple[str, str]


def _comments() -> dict[Field, str]:
    """Return the comment of each field by names of message and field."""
    found: dict[Field, str] = {}
    messages: list[str] = []
    comment: list[str] = []
    for line in map(str.strip, SCHEMA.read_text().splitlines()):
        if line.startswith("//"):
            comment.append(line)
            continue
        if opening := re.match(r"(message|enum|oneof) (\w+) {", line):
            messages.append("" if opening[1] == "oneof" else opening[2])
        elif line.startswith("}"):
            messages.pop()
        elif messages and (field := re.match(r"(?:optional |repeated )?(?:map<.+>|[\w.]+) (\w+) = \d+", line)):
            found[".".join(filter(None, messages)), field[1]] = " ".join(comment)
        comment = []
    return found


def _resolve(node: Mapping[str, Any], definitions: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the alternatives of a node of a JSON schema."""
    if "$ref" in node:
        return _resolve(definitions[node["$ref"].rpartition("/")[2]], definitions)
    parts = [part for key in ("anyOf", "oneOf", "allOf") for part in node.get(key, ())]
    return [found for part in parts for found in _resolve(part, definitions)] if parts else [node]


def _bounds(
    message: Descriptor, nodes: list[Mapping[str, Any]], definitions: Mapping[str, Any], seen: set[str]
) -> Iterator[tuple[Field, float]]:
    """Yield each bound of a number in a message and in those it holds."""
    if message.full_name in seen:
        return
    seen.add(message.full_name)
    for field in message.fields:
        own = [part for node in nodes for part in _resolve(node.get("properties", {}).get(field.name, {}), definitions)]
        entries = [entry for part in own for entry in (part.get("items"), part.get("additionalProperties"))]
        inner = [part for entry in entries if isinstance(entry, Mapping) for part in _resolve(entry, definitions)]
        for part in (*own, *inner):
            for key in BOUNDS:
                if key in part:
                    step = 1 if key == "exclusiveMaximum" else 0  # of whole numbers, whose largest value is named
                    yield (message.full_name.removeprefix("planner.v1."), field.name), float(part[key] - step)
        kind = field.message_type
        if kind is not None and kind.GetOptions().map_entry:
            kind = kind.fields_by_name["value"].message_type
        if kind is not None:
            yield from _bounds(kind, inner or own, definitions, seen)


def test_comments_of_the_schema_have_the_bounds_of_the_validator() -> None:
    comments, schema = _comments(), adapter_of(PlanRequest).json_schema()
    bounds = list(_bounds(MotionRequest.DESCRIPTOR, [schema], schema["$defs"], set()))
    assert len({field for field, _ in bounds}) > 70
    missing = [
        (field, bound)
        for field, bound in bounds
        if bound not in map(float, NUMBER.findall(comments[field]))
        and not (bound == 0.0 and re.search("positive|above zero", comments[field]))
    ]
    assert missing == []
