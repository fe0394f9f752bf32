"""What is wrong with clouds, in the words of the client's message rather than of a command line and this disk."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from service.errors import RequestError
from service.request_file import parse_robot, parse_start
from service.wire.violations import violation

# What perception says of its options, and the fields that stand for them.
FIELDS: Mapping[str, str] = {
    "KIND": "kind",
    "--detect": "detect",
    "--robot": "clouds.robot",
    "--transform": "clouds.clouds",
    "--sensor": "clouds.sensor",
    "--unit": "clouds.unit",
}


def as_sent(problems: Iterable[str], files: Iterable[Path], names: Iterable[str]) -> tuple[str, ...]:
    """Problems that begin with the field of the message they speak of.

    Args:
        files: where the clouds lie here; names: as the client named them.
    """
    clouds = list(zip(map(str, files), names, strict=True))
    return tuple(_as_sent(problem, clouds) for problem in problems)


def robot_problems(name: str | None) -> tuple[str, ...]:
    """What is wrong with the name of a robot, beginning with the field; none: it is one, or None."""
    try:
        if name is not None:
            parse_robot({"name": name})
    except RequestError as error:
        return tuple(f"robot: {violation(problem).description}" for problem in error.problems)
    return ()


def start_problems(data: object) -> tuple[str, ...]:
    """What is wrong with where the robot stands, each beginning with the field; none: it can be used."""
    try:
        parse_start(data)
    except RequestError as error:
        return tuple(f"start{'.' if violation(problem).field else ': '}{problem}" for problem in error.problems)
    return ()


def _as_sent(problem: str, clouds: list[tuple[str, str]]) -> str:
    for index, (path, name) in enumerate(clouds):
        if path in problem:
            return f"clouds.clouds[{index}].file: {problem.replace(path, name)}"
    option, colon, words = problem.partition(": ")
    if colon and option in FIELDS:
        return f"{FIELDS[option]}: {words}"
    return f"clouds.{violation(problem).field or 'clouds'}: {problem}"
