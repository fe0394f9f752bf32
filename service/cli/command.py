"""Decorator that makes a function a command, and how a command describes itself."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from typing import Any, get_type_hints

import typer
from typer.core import TyperCommand

from service.cli.run import run

_TYPE = re.compile(r"<([^<>]+)>")
_NUMBERS = ("int", "float")


class CommandLine(typer.Typer):
    """Commands whose help names what an option takes in words, and no type of this language."""

    def command(self, name: str | None = None, **settings: Any) -> Any:
        """Return the decorator that registers a command."""
        return super().command(name, cls=_PlainCommand, **settings)


class _PlainCommand(TyperCommand):
    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, each by its name alone, and the options with the kind of their values."""
        parts: dict[str, list[tuple[str, str]]] = {"argument": [], "option": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            is_argument = parameter.param_type_name == "argument"
            name = _TYPE.sub("" if is_argument else _name_kind, record[0]).strip()
            parts[parameter.param_type_name].append((name, record[1]))
        for title, rows in (("Arguments", parts["argument"]), ("Options", parts["option"])):
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def _name_kind(given: re.Match[str]) -> str:
    """Return the word for a type as it stands in the help of an option: <path>, <int range>, <float,float>, <a|b>."""
    kind = given[1].removeprefix("list[").removesuffix("]").split(",")[0].split(" ")[0]
    if kind.startswith(_NUMBERS):
        return "NUMBER"
    return {"str": "TEXT", "Path": "PATH", "path": "PATH"}.get(kind, kind)


def command(has_verdict: bool = False) -> Callable[[Callable[..., str | None]], Callable[..., None]]:
    """Make a function that returns a verdict, or None without one, a command that ends with an exit code.

    A parameter whose type is a dataclass stands for one option per field: the first takes the parameter's place, the
    others follow at the end.

    Args:
        has_verdict: whether the last line on stdout starts with a verdict even if the function fails.
    """

    def decorate(function: Callable[..., str | None]) -> Callable[..., None]:
        parameters = inspect.signature(function, eval_str=True).parameters.values()
        groups = {
            p.name: p.annotation for p in parameters if isinstance(p.annotation, type) and is_dataclass(p.annotation)
        }
        options = {name: _list_options(group) for name, group in groups.items()}
        shared = [option for group in options.values() for option in group[1:]]
        expanded = [*(options[p.name][0] if p.name in groups else p for p in parameters), *shared]

        @wraps(function)
        def end_with_exit_code(**values: Any) -> None:
            for name, group in groups.items():
                values[name] = group(**{option.name: values.pop(option.name) for option in options[name]})
            raise typer.Exit(run(lambda: function(**values), values.get("as_json", False), has_verdict))

        by_name = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in expanded]
        end_with_exit_code.__signature__ = inspect.Signature(by_name)  # type: ignore[attr-defined]
        return end_with_exit_code

    return decorate


def _list_options(group: type[Any]) -> list[inspect.Parameter]:
    """Return the fields of a dataclass as parameters."""
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if field.default is MISSING else field.default,
            annotation=hints[field.name],
        )
        for field in fields(group)
    ]
