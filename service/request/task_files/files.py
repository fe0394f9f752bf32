"""Task files: help, parameters with type, unit, range and default, and the parts of a request that they make."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.errors import RequestError, shown, would_do
from service.request.fields import SECTION, Label, Name, Number, PlainData, Section, at_most
from service.request.plain_file import load_section

SHIPPED = Path(__file__).parent / "shipped"
FOLDERS = "SCOPT_TASKS"
"""Environment variable with folders of task files, separated as in PATH."""

OWN_FOLDER = Path("~/.config/scopt/tasks")
SUFFIX = ".yaml"
ParameterType = Literal["number", "point", "direction", "choice", "text", "names"]
_DIMENSIONS = {"point": 3, "direction": 3}


@dataclass(config=SECTION)
class ParameterRequest(Section):
    """A parameter of a task file.

    Attributes:
        type: a number, a point or a direction of three numbers, one of some choices, a text, or a list of names.
        unit: for people: m, deg, N.
        help: a phrase for people.
        default: value where none is given; without one it is required.
        range: least and largest value of a number, or of each coordinate of a point.
        choices: of a choice.
        detect: kind of object in the scan that gives the value where it is not given, with ``value``.
        value: of the detected object: centre, normal, radius, angle.
    """

    type: ParameterType
    unit: Label | None = None
    help: Annotated[str, Field(max_length=300)] = ""
    default: Any = None
    range: tuple[Number, Number] | None = None
    choices: Annotated[tuple[Name, ...], at_most(20)] = ()
    detect: Name | None = None
    value: Name | None = None

    def __post_init__(self) -> None:
        if (self.type == "choice") != bool(self.choices):
            raise PydanticCustomError("parameter", "choices go with type: choice, which needs them")
        if (self.detect is None) != (self.value is None):
            raise PydanticCustomError("parameter", "detect and value go together")
        if self.default is not None:
            problem = self.find_problem(self.default)
            if problem:
                raise PydanticCustomError("parameter", "default: {problem}", {"problem": problem})

    def find_problem(self, value: Any) -> str:
        """Return what is wrong with a value; empty if nothing is."""
        if self.type == "choice":
            return "" if value in self.choices else f"expected {', '.join(self.choices)}, got {shown(value)}"
        if self.type == "text":
            return "" if isinstance(value, str) else f"expected a text, got {shown(value)}"
        if self.type == "names":
            is_list = isinstance(value, list | tuple) and all(isinstance(own, str) for own in value)
            return "" if is_list else f"expected a list of names, got {shown(value)}"
        count = _DIMENSIONS.get(self.type, 0)
        numbers = list(value) if count and isinstance(value, list | tuple) else [value]
        is_number = all(isinstance(own, int | float) and not isinstance(own, bool) for own in numbers)
        if not is_number or len(numbers) != (count or 1):
            return f"expected {'a number' if not count else '3 numbers'}, got {shown(value)}"
        unit = "" if self.unit is None else f" {self.unit}"
        if self.range is not None and not all(self.range[0] <= own <= self.range[1] for own in numbers):
            return f"expected {self.range[0]:g} to {self.range[1]:g}{unit}, got {shown(value)}"
        return ""


@dataclass(config=SECTION)
class TaskFileData(Section):
    """Content of a task file; ``${name}`` in its parts is replaced by parameters, and by sums and products of them.

    Attributes:
        help: a sentence for people.
        parameters: by name.
        task: of the request.
        attached: bodies that the robot carries, besides those of the request.
        start: of a request that has none.
    """

    help: Annotated[str, Field(min_length=1, max_length=500)]
    task: PlainData
    parameters: Annotated[dict[Name, ParameterRequest], at_most(50)] = field(default_factory=dict)
    attached: Annotated[tuple[PlainData, ...], at_most(20)] = ()
    start: PlainData | None = None

    def __post_init__(self) -> None:
        wrong = [name for name in self.parameters if not name.isidentifier()]
        if wrong:
            words = "parameter {name}: expected letters, digits and _"
            raise PydanticCustomError("task_file", words, {"name": shown(wrong[0])})


@dataclass(config=SECTION)
class TaskFile:
    """A task file with its name.

    Attributes:
        name: of the file without its suffix.
        path: of the file.
        data: its content.
    """

    name: str
    path: Path
    data: TaskFileData

    def take(self, given: Mapping[str, Any], field_name: str = "task.with") -> dict[str, Any]:
        """Return the values of all parameters, given or by default.

        Raises:
            RequestError: one line per unknown or missing parameter, and per value that does not fit.
        """
        problems, values = [], {}
        for name in given:
            if name not in self.data.parameters:
                known = would_do(name, self.data.parameters) or "no parameters"
                problems.append(f"{field_name}.{name}: task '{self.name}' has no such parameter; expected {known}")
        for name, parameter in self.data.parameters.items():
            value = given.get(name, parameter.default)
            if value is None:
                problems.append(f"{field_name}.{name}: is missing; {parameter.help or parameter.type}")
                continue
            problem = parameter.find_problem(value)
            if problem:
                problems.append(f"{field_name}.{name}: {problem}")
            values[name] = value
        if problems:
            raise RequestError(problems)
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


def list_folders(own: Sequence[Path] = ()) -> list[Path]:
    """Return the folders in which task files are looked for, the first that has a name wins; shipped ones come last."""
    named = [Path(part) for part in os.environ.get(FOLDERS, "").split(os.pathsep) if part]
    return [*own, *named, OWN_FOLDER.expanduser(), SHIPPED]


def list_task_paths(own: Sequence[Path] = ()) -> Iterator[Path]:
    """Yield the paths of all task files, each name once."""
    seen: set[str] = set()
    for folder in list_folders(own):
        for path in sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else ():
            if path.stem not in seen:
                seen.add(path.stem)
                yield path


def read_task_file(path: Path) -> TaskFile:
    """Read and check a task file.

    Raises:
        RequestError: it cannot be used.
    """
    return TaskFile(path.stem, path, load_section(TaskFileData, path))


def list_task_files(own: Sequence[Path] = ()) -> Iterator[TaskFile]:
    """Yield all task files, each name once.

    Raises:
        RequestError: a file cannot be used.
    """
    yield from map(read_task_file, list_task_paths(own))


def find_task_file(name: str, own: Sequence[Path] = ()) -> TaskFile:
    """Return the task file of a name.

    Raises:
        RequestError: there is none, or it cannot be used.
    """
    folders = list_folders(own)
    for folder in folders:
        path = folder / f"{name}{SUFFIX}"
        if path.parent == folder and path.is_file():
            return read_task_file(path)
    known = sorted({path.stem for folder in folders if folder.is_dir() for path in folder.glob(f"*{SUFFIX}")})
    raise RequestError(f"task.use: unknown task {shown(name)}; expected {would_do(name, known)}")
