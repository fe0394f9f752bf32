"""Objects that a user gives by parameters: an object file (YAML or JSON), or a line of text."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.errors import RequestError, shown
from service.request.file import parse_section, read_plain_request
from service.request.shapes import ObjectRequest

_EXAMPLE = "'wheel radius=0.3 rim_radius=0.02 spokes=5'"


def read_object_file(path: Path) -> ObjectRequest:
    """Read and check an object file.

    Raises:
        RequestError: one line per problem, each beginning with the file's name.
    """
    return parse_object(read_plain_request(path), path.name)


def is_object_text(text: str) -> bool:
    """Return whether a text is a line as for ``parse_object_text``, rather than the name of a file."""
    words = text.split()
    return len(words) > 1 and "=" in words[1] and not Path(words[0]).suffix


def parse_object_text(text: str) -> ObjectRequest:
    """Check an object given as a line: ``wheel radius=0.3 rim_radius=0.02 spokes=5``.

    Raises:
        RequestError: one line per problem.
    """
    kind, *words = text.split()
    data: dict[str, Any] = {"type": kind}
    for word in words:
        key, sign, value = word.partition("=")
        if not sign or not key or not value:
            raise RequestError(f"{shown(word)} is no NAME=NUMBER; expected such as {_EXAMPLE}")
        if key in data:
            raise RequestError(f"{key} is given twice")
        numbers = [_parse_number(number, key) for number in value.split(",")]
        data[key] = numbers[0] if len(numbers) == 1 else numbers
    return parse_object(data, "")


def parse_object(data: Mapping[str, Any], name: str) -> ObjectRequest:
    """Check an object given as plain data: its ``parts``, or the fields of its only part.

    Args:
        name: begins each problem, if it is not empty.

    Raises:
        RequestError: one line per problem.
    """
    is_one = "parts" not in data
    try:
        return parse_section(ObjectRequest, {"parts": [dict(data)]} if is_one else data)
    except RequestError as error:
        problems = [problem.removeprefix("parts[0].").removeprefix("parts[0]: ") if is_one else problem
                    for problem in error.problems]  # fmt: skip
        raise RequestError([f"{name}: {problem}" if name else problem for problem in problems]) from None


def _parse_number(text: str, key: str) -> int | float:
    try:
        return int(text) if text.lstrip("+-").isdigit() else float(text)
    except ValueError:
        raise RequestError(f"{key}: {shown(text)} is no number") from None
