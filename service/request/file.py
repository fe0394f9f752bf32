"""Request files: YAML or JSON text to a ``PlanRequest``, and back to the canonical JSON that is hashed."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from service.errors import RequestError, shown, would_do
from service.request.scene import KnownRequest, SceneRequest
from service.request.schema import PlanRequest, RobotRequest, StartRequest

MAX_BYTES = 1_000_000
MAX_DEPTH = 20

T = TypeVar("T")
_ADAPTER = TypeAdapter(PlanRequest)
_START_ADAPTER = TypeAdapter(StartRequest)
_ROBOT_ADAPTER = TypeAdapter(RobotRequest)
_SCENE_ADAPTER = TypeAdapter(SceneRequest)
_KNOWN_ADAPTER = TypeAdapter(KnownRequest)
# Our words for pydantic's error types, filled in from the error's context; the rest keep pydantic's own.
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
    "less_than_equal": "at most {le:g} would do",
    "too_long": "at most {max_length} entries would do",
    "too_short": "at least {min_length} entries are needed",
    "string_too_long": "at most {max_length} characters would do",
    "string_too_short": "a text with at least {min_length} character is needed",
    "literal_error": "{expected} would do",
}
_SPEAK_FOR_THEMSELVES = {"unknown_key", "exactly_one", "quaternion", "unit"}


class _Loader(yaml.CSafeLoader):
    """YAML without repeated keys, and with 1e-3 read as a number as everybody expects."""

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
    """Read and check a request file; its relative paths start at the file's folder.

    Raises:
        RequestError: one line per problem.
    """
    path = Path(path)
    return _from_file(path, lambda data: parse_request(data, path.parent))


def load_start(path: str | Path) -> StartRequest:
    """Read and check a file that holds what a request's ``start`` holds.

    Raises:
        RequestError: one line per problem.
    """
    return _from_file(Path(path), parse_start)


def load_scene(path: str | Path) -> SceneRequest:
    """Read and check a file that holds what a request's ``scene`` holds.

    Raises:
        RequestError: one line per problem.
    """
    return _from_file(Path(path), parse_scene)


def parse_request(data: object, folder: str | Path = ".") -> PlanRequest:
    """Check a request given as plain mappings, lists and scalars; relative paths start at ``folder``.

    Raises:
        RequestError: one line per problem.
    """
    return dataclasses.replace(_validated(data, _ADAPTER), folder=Path(folder))


def parse_start(data: object) -> StartRequest:
    """Check what a request's ``start`` holds, given as ``parse_request`` takes it.

    Raises:
        RequestError: one line per problem.
    """
    return _validated(data, _START_ADAPTER)


def parse_robot(data: object) -> RobotRequest:
    """Check what a request's ``robot`` holds, given as ``parse_request`` takes it.

    Raises:
        RequestError: one line per problem.
    """
    return _validated(data, _ROBOT_ADAPTER)


def parse_scene(data: object) -> SceneRequest:
    """Check what a request's ``scene`` holds, given as ``parse_request`` takes it.

    Raises:
        RequestError: one line per problem.
    """
    return _validated(data, _SCENE_ADAPTER)


def parse_known(data: object) -> KnownRequest:
    """Check known meshes and the scene to update, given as ``parse_request`` takes them.

    Raises:
        RequestError: one line per problem.
    """
    return _validated(data, _KNOWN_ADAPTER)


def replace_cloud(request: PlanRequest, cloud: Path) -> PlanRequest:
    """The request with another cloud file, given relative to the working directory."""
    path = os.path.relpath(cloud.absolute(), request.folder.absolute())
    return dataclasses.replace(request, scene=dataclasses.replace(request.scene, cloud=path))


def replace_clouds(request: PlanRequest, clouds: Sequence[Path]) -> PlanRequest:
    """The request with its own cloud files, or its scene's file, at other places relative to the working directory.

    Raises:
        RequestError: the request names another number of files.
    """
    paths = [os.path.relpath(path.absolute(), request.folder.absolute()) for path in clouds]
    scene = request.scene
    names = [scene.file] if scene.file is not None else [one.file for one in scene.cloud_files]
    if len(paths) != len(names):
        listed = ", ".join(shown(name) for name in names) or "no scan"
        raise RequestError(f"--cloud: {len(paths)} files given; the request's scene has {listed}")
    if scene.file is not None:
        return dataclasses.replace(request, scene=dataclasses.replace(scene, file=paths[0]))
    if isinstance(scene.cloud, str):
        return dataclasses.replace(request, scene=dataclasses.replace(scene, cloud=paths[0]))
    files = tuple(dataclasses.replace(one, file=path) for one, path in zip(scene.cloud_files, paths, strict=True))
    return dataclasses.replace(request, scene=dataclasses.replace(scene, cloud=files))


def to_json(request: PlanRequest) -> dict[str, Any]:
    """The request as plain JSON data, defaults filled in, without the folder."""
    return dict(_ADAPTER.dump_python(request, mode="json"))


def request_hash(request: PlanRequest) -> str:
    """``sha256:`` of the canonical JSON: sorted keys, no blanks."""
    text = json.dumps(to_json(request), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


def _from_file(path: Path, parse: Callable[[object], T]) -> T:
    try:
        return parse(_read_yaml(_read_text(path)))
    except RequestError as error:
        raise RequestError([f"{path.name}: {problem}" for problem in error.problems]) from None


def _validated(data: object, adapter: TypeAdapter[T]) -> T:
    if not isinstance(data, Mapping):
        raise RequestError(f"a mapping is needed, got {shown(data)}; docs/request-format.md lists its keys")
    try:
        return adapter.validate_python(dict(data))
    except ValidationError as error:
        raise RequestError([_line(data, detail) for detail in error.errors(include_url=False)]) from None
    except RecursionError:
        raise RequestError(f"nested deeper than {MAX_DEPTH} levels") from None


def _read_text(path: Path) -> str:
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise RequestError("is not a file; a YAML file is needed")
        if size > MAX_BYTES:
            raise RequestError(f"is {size} bytes long; at most {MAX_BYTES} would do")
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
        return f"{problem.split(' for ')[-1]} is not read; plain values would do"
    return problem


def _refuse_bombs(text: str) -> None:
    """Refuse, before anything is built, aliases (they expand without bound) and depth (it exhausts the stack)."""
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
    """One line of ours for one error of pydantic's: ``field: what is needed, got value``."""
    kind, location, value = detail["type"], detail["loc"], detail["input"]
    context = detail.get("ctx", {})
    is_short = kind == "missing" and isinstance(location[-1], int)  # of a list, the entry at that index is missing
    field = _field_path(data, location[:-1] if is_short else location, is_missing=kind == "missing")
    if is_short:
        words = f"entry {int(location[-1]) + 1} is missing"
    elif kind == "missing":
        return f"{field}: is missing"
    elif kind.startswith("union_tag"):
        return f"{field}: {_union_problem(value, context)}"
    else:
        words = _WORDS[kind].format(**context) if kind in _WORDS else detail["msg"]
    if kind not in _SPEAK_FOR_THEMSELVES and isinstance(value, str | int | float | list | tuple | None):
        words += f", got {shown(value)}"
    return f"{field}: {words}" if field else words


def _union_problem(value: object, context: Mapping[str, Any]) -> str:
    expected = [tag.strip("'") for tag in str(context.get("expected_tags", "")).split(", ")]
    if not context.get("expected_tags"):
        return f"a type is needed, got {shown(value)}; box, sphere, cylinder, capsule, convex or mesh would do"
    return f"unknown type {shown(context.get('tag'))}; {would_do(context.get('tag'), expected)} would do"


def _field_path(data: object, location: tuple[int | str, ...], is_missing: bool) -> str:
    """``scene.obstacles[0].size``; the name of a union's variant, which pydantic inserts, is left out."""
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
