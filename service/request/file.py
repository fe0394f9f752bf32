"""Request files: parsing of YAML or JSON into a ``PlanRequest``, and its canonical JSON for hashing."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import yaml
from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from service.errors import RequestError, shown, would_do
from service.request.formats import FORMAT
from service.request.scene import ObstacleRequest
from service.request.schema import AttachedRequest, PlanRequest
from service.request.shapes import PartRequest
from service.request.versions import find_first_format, write_as

MAX_BYTES = 1_000_000
MAX_DEPTH = 20

T = TypeVar("T")
_ADAPTERS: dict[type, TypeAdapter[Any]] = {}
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


def load_request(path: str | Path) -> PlanRequest:
    """Read and check a request file; its paths are relative to the file's folder.

    Raises:
        RequestError: one line per problem.
    """
    path = Path(path)
    return dataclasses.replace(load_section(PlanRequest, path), folder=path.parent)


def read_plain_request(path: Path) -> dict[str, Any]:
    """Return a request file as the plain data that it holds, of which only the form is checked.

    Raises:
        RequestError: the file cannot be read, or holds no mapping.
    """
    try:
        data = _read_yaml(_read_text(path))
    except RequestError as error:
        raise RequestError([f"{path.name or path}: {problem}" for problem in error.problems]) from None
    if not isinstance(data, Mapping):
        raise RequestError(f"{path.name}: a mapping is needed, got {shown(data)}")
    return dict(data)


def load_section(kind: type[T], path: Path) -> T:
    """Read and check a file that holds one section of a request (``StartRequest`` for ``start``).

    Raises:
        RequestError: one line per problem.
    """
    try:
        return parse_section(kind, _read_yaml(_read_text(path)))
    except RequestError as error:
        raise RequestError([f"{path.name or path}: {problem}" for problem in error.problems]) from None


def parse_request(data: object, folder: str | Path = ".") -> PlanRequest:
    """Check a request given as plain mappings, lists and scalars; its paths are relative to ``folder``.

    Raises:
        RequestError: one line per problem.
    """
    request, path = parse_section(PlanRequest, data), Path(folder)
    return request if request.folder == path else dataclasses.replace(request, folder=path)  # which checks it again


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


def replace_cloud(request: PlanRequest, cloud: Path) -> PlanRequest:
    """Return the request with another cloud file, whose path is relative to the working directory."""
    return _with_scene(request, cloud=_relative(request, cloud))


def replace_clouds(request: PlanRequest, clouds: Sequence[Path]) -> PlanRequest:
    """Return the request with other paths of its cloud files or its scene file, relative to the working directory.

    Raises:
        RequestError: the number of paths differs from the request's number of files.
    """
    paths = [_relative(request, path) for path in clouds]
    scene = request.scene
    names = [scene.file] if scene.file is not None else [file.file for file in scene.cloud_files]
    if len(paths) != len(names):
        listed = ", ".join(shown(name) for name in names) or "no scan"
        raise RequestError(f"--cloud: {len(paths)} files given; the request's scene has {listed}")
    if scene.file is not None:
        return _with_scene(request, file=paths[0])
    if isinstance(scene.cloud, str):
        return _with_scene(request, cloud=paths[0])
    files = tuple(dataclasses.replace(file, file=path) for file, path in zip(scene.cloud_files, paths, strict=True))
    return _with_scene(request, cloud=files)


def _relative(request: PlanRequest, path: Path) -> str:
    return os.path.relpath(path.absolute(), request.folder.absolute())


def _with_scene(request: PlanRequest, **changes: Any) -> PlanRequest:
    return dataclasses.replace(request, scene=dataclasses.replace(request.scene, **changes))


def adapter_of(kind: type[T]) -> TypeAdapter[T]:
    """Return the validator and writer of a class of the schema, made once since that takes as long as its use."""
    if kind not in _ADAPTERS:
        _ADAPTERS[kind] = TypeAdapter(kind)
    return _ADAPTERS[kind]


def to_json(request: PlanRequest) -> dict[str, Any]:
    """Return the request as plain JSON data, without the folder and the defaults of later fields.

    Which these are, ``service.request.versions`` says.
    """
    return write_as(request, FORMAT)


def request_hash(request: PlanRequest) -> str:
    """Return the hash of the request's data (``to_json``)."""
    return hash_request_data(to_json(request))


def has_hash(request: PlanRequest, sha256: str) -> bool:
    """Return whether this version, or an earlier one, gives the same request this hash."""
    if request_hash(request) == sha256:
        return True
    earlier = range(FORMAT - 1, find_first_format(request) - 1, -1)
    return any(hash_request_data(write_as(request, version)) == sha256 for version in earlier)


def hash_request_data(data: object) -> str:
    """Return ``sha256:`` and the hash of a request's data as canonical JSON (sorted keys, no blanks)."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


def _read_text(path: Path) -> str:
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


def _read_yaml(text: str) -> object:
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
        union = PartRequest if "parts" in location else AttachedRequest if "attached" in location else ObstacleRequest
        known = [get_args(get_type_hints(shape)["type"])[0] for shape in get_args(get_args(union)[0])]
        tag = context.get("tag")
        words = f"a type is needed, got {shown(value)}" if tag is None else f"unknown type {shown(tag)}"
        return f"{field}: {words}; expected {would_do(tag, known)}"
    else:
        words = _WORDS[kind].format(**context) if kind in _WORDS else detail["msg"]
    if kind not in _SPEAK_FOR_THEMSELVES and isinstance(value, str | int | float | list | tuple | None):
        words += f", got {shown(value)}"
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
