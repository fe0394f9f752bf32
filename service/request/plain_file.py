"""Files and plain data of one section: YAML or JSON, checked against a class of the schema."""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import yaml
from pydantic import TypeAdapter, ValidationError
from pydantic.dataclasses import is_pydantic_dataclass, rebuild_dataclass
from pydantic_core import ErrorDetails

from service.errors import RequestError, shown, would_do
from service.request.attached import AttachedRequest
from service.request.scene import CutRequest, ObjectRequest, ObstacleRequest
from service.request.shapes import PartRequest

MAX_BYTES = 1_000_000
MAX_DEPTH = 20

T = TypeVar("T")
_ADAPTERS: dict[type, TypeAdapter[Any]] = {}
_UNIONS = {"parts": PartRequest, "attached": AttachedRequest, "objects": ObjectRequest, "cuts": CutRequest}
"""Shapes by the part of a location that lists them; others are obstacles."""

# Messages for pydantic's error types, filled in from the error's context; other types keep pydantic's message.
_WORDS = {
    "float_type": "a number is needed",
    "int_type": "a whole number is needed",
    "string_type": "a text is needed",
    "bool_type": "true or false is needed",
    "tuple_type": "a list is needed",
    "dict_type": "a mapping is needed",
    "dataclass_type": "a mapping is needed",
    "model_attributes_type": "a mapping is needed",
    "finite_number": "a finite number is needed",
    "greater_than": "more than {gt:g} is needed",
    "greater_than_equal": "at least {ge:g} is needed",
    "less_than": "less than {lt:g} is needed",
    "less_than_equal": "expected at most {le:g}",
    "too_long": "expected at most {max_length} entries",
    "too_short": "at least {min_length} entries are needed",
    "string_too_long": "expected at most {max_length} characters",
    "string_too_short": "a text with at least {min_length} character is needed",
    "literal_error": "expected {expected}",
}
_SPEAK_FOR_THEMSELVES = {"unknown_key", "exactly_one", "quaternion", "unit"}


class _Loader(yaml.CSafeLoader):
    """YAML loader that refuses repeated keys and reads 1e-3 as a number."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, "a key must be a plain text", key.start_mark)
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key.value!r} is given twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep=deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def load_section(kind: type[T], path: Path) -> T:
    """Read and check a file that holds one section of a request (``StartRequest`` for ``start``).

    Raises:
        RequestError: one line per problem.
    """
    try:
        return parse_section(kind, read_yaml(read_text(path)))
    except RequestError as error:
        raise RequestError([f"{path.name or path}: {problem}" for problem in error.problems]) from None


def parse_section(kind: type[T], data: object) -> T:
    """Check one section of a request, given as plain data.

    Raises:
        RequestError: one line per problem.
    """
    if not isinstance(data, Mapping):
        raise RequestError(f"a mapping is needed, got {shown(data)}; docs/request-format.md lists its keys")
    try:
        section: T = adapter_of(kind).validate_python(dict(data))
    except ValidationError as error:
        raise RequestError([_line(data, detail) for detail in error.errors(include_url=False)]) from None
    except RecursionError:
        raise RequestError(f"nested deeper than {MAX_DEPTH} levels") from None
    return section


def adapter_of(kind: type[T]) -> TypeAdapter[T]:
    """Return the validator and writer of a class of the schema, made once since that takes as long as its use."""
    if kind not in _ADAPTERS:
        _complete(kind)
        _ADAPTERS[kind] = TypeAdapter(kind)
    return _ADAPTERS[kind]


def _complete(kind: Any) -> None:
    """Build a class's own validator, which adapter and constructor share, after those of its default sections."""
    if is_pydantic_dataclass(kind):
        for field in fields(kind):
            _complete(field.default_factory)
        rebuild_dataclass(kind)


def read_text(path: Path) -> str:
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise RequestError("is not a file; a YAML file is needed")
        if size > MAX_BYTES:
            raise RequestError(f"is {size} bytes long; expected at most {MAX_BYTES}")
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise RequestError(f"is no UTF-8 text (byte {error.start}); a YAML file is needed") from None
    except OSError as error:
        raise RequestError(f"cannot be read: {error.strerror}") from None


def read_yaml(text: str) -> object:
    try:
        _refuse_bombs(text)
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}: " if mark else ""
        raise RequestError(f"{where}{_in_plain_words(error)}") from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise RequestError(f"no valid YAML: {shown(str(error))}") from None


def _in_plain_words(error: yaml.MarkedYAMLError) -> str:
    problem = str(error.problem or "no valid YAML")
    if isinstance(error, yaml.constructor.ConstructorError) and "tag" in problem:
        return f"{problem.split(' for ')[-1]} is not read; expected plain values"
    return problem


def _refuse_bombs(text: str) -> None:
    """Refuse YAML aliases, which expand without bound, and deep nesting, which exhausts the stack, before parsing."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        line = event.start_mark.line + 1 if event.start_mark else 0
        if isinstance(event, yaml.AliasEvent):
            raise RequestError(f"line {line}: alias '*{event.anchor}' is not read; write the value out")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_DEPTH:
                raise RequestError(f"line {line}: nested deeper than {MAX_DEPTH} levels")
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


def _line(data: Mapping[str, Any], detail: ErrorDetails) -> str:
    """Return the message line of a pydantic error: ``field: what is needed, got value``."""
    kind, location, value = detail["type"], detail["loc"], detail["input"]
    context = detail.get("ctx", {})
    is_short = kind == "missing" and isinstance(location[-1], int)  # the entry at that index of a list is missing
    field = _field_path(data, location[:-1] if is_short else location, is_missing=kind == "missing")
    if is_short:
        words = f"entry {int(location[-1]) + 1} is missing"
    elif kind == "missing":
        return f"{field}: is missing"
    elif kind.startswith("union_tag"):
        union = next((union for part, union in _UNIONS.items() if part in location), ObstacleRequest)
        known = [get_args(get_type_hints(shape)["type"])[0] for shape in get_args(get_args(union)[0])]
        tag = context.get("tag")
        words = f"a type is needed, got {shown(value)}" if tag is None else f"unknown type {shown(tag)}"
        return f"{field}: {words}; expected {would_do(tag, known)}"
    else:
        words = _WORDS[kind].format(**context) if kind in _WORDS else detail["msg"]
    if kind not in _SPEAK_FOR_THEMSELVES and isinstance(value, str | int | float | list | tuple | None):
        words += f", got {shown(value)}"
    if kind == "string_type" and isinstance(value, bool):
        words += "; YAML reads yes, no, on and off as true and false: put the text in quotes"
    return f"{field}: {words}" if field else words


def _field_path(data: object, location: tuple[int | str, ...], is_missing: bool) -> str:
    """Return ``scene.obstacles[0].size``, without the names of union variants that pydantic inserts."""
    text = ""
    for index, step in enumerate(location):
        is_last = index == len(location) - 1
        if isinstance(step, int):
            text += f"[{step}]"
            data = data[step] if isinstance(data, list | tuple) and step < len(data) else None
        elif isinstance(data, Mapping) and (step in data or (is_last and is_missing)):
            text += f".{step}" if text else step
            data = data.get(step)
    return text
