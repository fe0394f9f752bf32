"""What is wrong with clouds, in the words of the client's message rather than of a command line and this disk."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from service.errors import RequestError
from service.request.file import parse_robot, parse_start
from service.wire.violations import violation

MESH, UPDATE = "--mesh", "--update"
# What perception says of its options, and the fields that stand for them.
FIELDS: Mapping[str, str] = {
    "KIND": "kind",
    "--detect": "detect",
    "--robot": "clouds.robot",
    "--transform": "clouds.clouds",
    "--sensor": "clouds.sensor",
    "--unit": "clouds.unit",
    MESH: "meshes",
    UPDATE: "update",
}
# Settings that an earlier scene has decided, by the field that says otherwise.
OF_BEFORE: Mapping[str, str] = {
    "reach_m": "clouds.reach_m",
    "top_m": "clouds.top_m",
    "bottom_m": "clouds.bottom_m",
    "seed": "clouds.seed",
    "unknown": "unknown",
    "method": "method",
}
BESIDE = frozenset(OF_BEFORE.values())


@dataclass(frozen=True)
class Kept:
    """A file that a client named: the field that says so, its name there, and where it is kept here."""

    field: str
    name: str
    path: Path


def as_sent(problems: Iterable[str], files: Sequence[Kept]) -> tuple[str, ...]:
    """Problems that begin with the field of the message they speak of."""
    return tuple(_as_sent(problem, files) for problem in problems)


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


def _as_sent(problem: str, files: Sequence[Kept]) -> str:
    option, colon, words = problem.partition(": ")
    if colon and option in (MESH, UPDATE):
        problem = words.replace("--mesh-scale", "scale")
    about = [one for one in files if str(one.path) in problem] or [one for one in files if one.path.name in problem]
    for one in about[:1]:
        return f"{one.field}: {problem.replace(str(one.path), one.name)}"
    if colon and option in FIELDS:
        return f"{FIELDS[option]}: {words}"
    if colon and option in BESIDE:
        return problem
    return f"clouds.{violation(problem).field or 'clouds'}: {problem}"
