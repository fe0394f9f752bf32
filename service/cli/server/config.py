"""Configuration file of ``scopt serve``: TOML whose keys are the names of the options."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

from service.cli.run import run
from service.errors import RequestError, shown, would_do

MAX_BYTES = 100_000
CONFIG = "config"


def read_config_option(context: typer.Context, path: Path | None) -> Path | None:
    """Make the values of a configuration file the defaults of the command's options.

    Raises:
        typer.Exit: the file cannot be used; each problem is one line on stderr.
    """
    if path is not None and not context.resilient_parsing:
        values: dict[str, Any] = {}
        function: Any = context.command.callback
        code = run(lambda: values.update(read_config(path, list_options(function))))
        if code:
            raise typer.Exit(code)
        context.default_map = values
    return path


@dataclass(frozen=True)
class FileOption:
    """An option that a configuration file may set.

    Attributes:
        parameter: name of the command's parameter.
        kind: type of its values.
        least: smallest value; None without.
        is_repeated: whether it may be given several times, and is a list in the file.
    """

    parameter: str
    kind: type[Any]
    least: float | None = None
    is_repeated: bool = False


def list_options(function: Callable[..., Any]) -> dict[str, FileOption]:
    """Return the options of a command by name."""
    options = {}
    for parameter, hint in get_type_hints(function, include_extras=True).items():
        settings = next((entry for entry in getattr(hint, "__metadata__", ()) if hasattr(entry, "min")), None)
        if settings is None or parameter == CONFIG:
            continue
        kinds = _find_types(hint)
        options[parameter.replace("_", "-")] = FileOption(parameter, kinds[-1], settings.min, list in kinds)
    return options


def read_config(path: Path, options: Mapping[str, FileOption]) -> dict[str, Any]:
    """Return the values of a configuration file by parameter; relative paths start at the file's folder.

    Args:
        path: TOML file with the names of options as keys.
        options: as from ``list_options``.

    Raises:
        RequestError: one line per key that is unknown or has a wrong value.
    """
    from pydantic import ConfigDict, Field, ValidationError, create_model

    fields: dict[str, Any] = {}
    for name, option in options.items():
        value: Any = str if option.kind is Path else option.kind
        if option.least is not None:
            value = Annotated[value, Field(ge=option.least)]
        fields[option.parameter] = (list[value] if option.is_repeated else value, Field(default=None, alias=name))
    model = create_model("ServerConfig", __config__=ConfigDict(extra="forbid", strict=True), **fields)
    try:
        given = model.model_validate(_read_toml(path)).model_dump(exclude_unset=True)
    except ValidationError as error:
        raise RequestError([_describe(path, problem, list(options)) for problem in error.errors()]) from None
    paths = {option.parameter for option in options.values() if option.kind is Path}
    return {name: _place(value, path.parent.absolute()) if name in paths else value for name, value in given.items()}


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            return tomllib.loads(file.read(MAX_BYTES).decode())
    except OSError as error:
        raise RequestError(f"--config {path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RequestError(f"{path}: is no TOML file ({error})") from None


def _describe(path: Path, problem: Any, names: list[str]) -> str:
    """Return one line for a problem that pydantic found."""
    key = str(problem["loc"][0])
    if problem["type"] == "extra_forbidden":
        return f"{path}: unknown key {shown(key)}; expected {would_do(key, names)}"
    expected = problem["msg"].replace("Input should be", "expected")
    return f"{path}: {key}: {expected}, got {shown(problem['input'])}"


def _find_types(hint: Any) -> list[type[Any]]:
    """Return the types in ``list[T] | None`` and the like, the type of a value last."""
    if not get_args(hint):
        return [hint]
    inner = [argument for argument in get_args(hint) if isinstance(argument, type) or get_args(argument)]
    here = [list] if get_origin(hint) is list else []
    return [*here, *(kind for argument in inner for kind in _find_types(argument) if kind is not type(None))]


def _place(value: str | list[str], folder: Path) -> str | list[str]:
    return [str(folder / entry) for entry in value] if isinstance(value, list) else str(folder / value)
