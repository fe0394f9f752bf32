"""The text of a problem file as JSON data: strict JSON, no key twice, neither huge nor deep."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from service.errors import RequestError, shown

MAX_BYTES = 20_000_000
MAX_DEPTH = 20


def read_document(path: Path) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        RequestError: the file cannot be read, or is no JSON object.
    """
    try:
        if not path.is_file():
            raise RequestError(f"{path}: is not a file; a TrajOpt problem (JSON) is needed")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise RequestError(f"{path.name}: is {size} bytes long; expected at most {MAX_BYTES}")
        return parse_document(path.read_text(encoding="utf-8-sig"), path.name)
    except UnicodeDecodeError as error:
        raise RequestError(f"{path.name}: is no UTF-8 text (byte {error.start})") from None
    except OSError as error:
        raise RequestError(f"{path.name}: cannot be read: {error.strerror}") from None


def parse_document(text: str, name: str) -> dict[str, Any]:
    """The object in a JSON text.

    Raises:
        RequestError: it is none; ``name`` begins the line.
    """
    try:
        data = json.loads(text, object_pairs_hook=_without_repetition, parse_constant=_refuse_constant)
    except json.JSONDecodeError as error:
        raise RequestError(f"{name}: line {error.lineno}: no valid JSON: {error.msg}") from None
    except RecursionError:
        raise RequestError(f"{name}: nested deeper than {MAX_DEPTH} levels") from None
    except ValueError as error:
        raise RequestError(f"{name}: {error}") from None
    if not isinstance(data, dict):
        raise RequestError(f"{name}: an object is needed, got {shown(data)}")
    if _depth(data) > MAX_DEPTH:
        raise RequestError(f"{name}: nested deeper than {MAX_DEPTH} levels")
    return data


def _without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"key {shown(twice)} is given twice")
    return found


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number that JSON has")


def _depth(data: object) -> int:
    """Levels of nesting."""
    level, depth = [data], 0
    while level:
        depth += 1
        level = [
            entry
            for each in level
            if isinstance(each, dict | list)
            for entry in (each.values() if isinstance(each, dict) else each)
            if isinstance(entry, dict | list)
        ]
    return depth
