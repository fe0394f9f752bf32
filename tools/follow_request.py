"""Follow a plan request through the calls of ``service.planner.plan``.

Starts at ``plan`` and enters, in the order of the code, every function of the project that gets the request, a section
of it, or an object that has one of them as a field (``PlanSetup``). Plain values taken out of the request (numbers,
names, arrays) are not followed. Types come from annotations, so nothing is planned.

What a request's kind does is followed for one kind (``--kind``).

    python tools/follow_request.py            # the figures
    python tools/follow_request.py --list     # and every function on the way
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import importlib
import inspect
import textwrap
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

PACKAGES = ("service", "perception", "costs", "scopt")  # high to low: each imports those behind it
SCHEMA = "service.request."
PARTS: dict[str, Any] = {}  # parts of the kind that is followed, by the function that finds them


@dataclass
class Walk:
    """The functions entered so far, in order, and the calls between them."""

    functions: list[Any] = field(default_factory=list)
    calls: list[tuple[str, str]] = field(default_factory=list)

    def enter(self, function: Any, caller: str | None = None) -> None:
        """Visit a function and, the first time, everything it passes the request to."""
        module = function.__module__
        if caller is not None:
            self.calls.append((caller, module))
        if function in self.functions:
            return
        self.functions.append(function)
        tree = _tree(function)
        if tree is None:
            return
        known = _parameter_types(function)
        for call in _calls(tree, known, vars(importlib.import_module(module))):
            self.enter(call, module)

    @property
    def files(self) -> list[str]:
        """Module of every stay: consecutive functions of one module are one stay."""
        modules = [function.__module__ for function in self.functions]
        return [name for index, name in enumerate(modules) if index == 0 or name != modules[index - 1]]


def _tree(function: Any) -> ast.FunctionDef | None:
    try:
        source = textwrap.dedent(inspect.getsource(function))
    except (OSError, TypeError):
        return None
    body = ast.parse(source).body
    return body[0] if isinstance(body[0], ast.FunctionDef) else None


def _parameter_types(function: Any) -> dict[str, Any]:
    """Annotated types of a function's parameters; ``self`` is the class that defines a method."""
    hints = _hints(function)
    owner = function.__qualname__.rpartition(".")[0]
    if owner and "<locals>" not in owner:
        hints["self"] = getattr(importlib.import_module(function.__module__), owner, None)
    return hints


def _hints(thing: Any) -> dict[str, Any]:
    if not _module_of(thing).startswith(PACKAGES):
        return {}
    module = importlib.import_module(thing.__module__)
    names = dict(vars(module))
    source = ast.parse(inspect.getsource(module))
    for node in ast.walk(source):  # names that only type checkers import
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            for statement in node.body:
                if isinstance(statement, ast.ImportFrom) and statement.module:
                    imported = importlib.import_module(statement.module)
                    names |= {alias.asname or alias.name: getattr(imported, alias.name) for alias in statement.names}
    hints = {}
    for name, annotation in getattr(thing, "__annotations__", {}).items():
        try:
            hints[name] = eval(annotation, names) if isinstance(annotation, str) else annotation
        except (NameError, TypeError, AttributeError):
            continue
    return hints


def _calls(tree: ast.FunctionDef, known: dict[str, Any], names: dict[str, Any]) -> Iterator[Any]:
    """Project functions that a function passes the request to, in the order of the code."""
    for node in _in_order(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(PACKAGES):
            module = importlib.import_module(node.module)
            names = names | {alias.asname or alias.name: getattr(module, alias.name) for alias in node.names}
        elif isinstance(node, ast.Assign) and len(node.targets) == 1:
            _bind(node.targets[0], _type_of(node.value, known, names), known)
        elif isinstance(node, ast.For | ast.comprehension):
            _bind(node.target, _entry_of(node.iter, known, names), known)
        elif isinstance(node, ast.Call):
            function = _callee(node.func, known, names)
            passed = [*node.args, *(keyword.value for keyword in node.keywords)]
            if isinstance(node.func, ast.Attribute):
                passed.append(node.func.value)
            # partial(f, request): f is called with it later.
            if getattr(function, "__name__", "") == "partial" and node.args:
                function = _callee(node.args[0], known, names)
            if _is_ours(function) and any(_carries(_type_of(value, known, names)) for value in passed):
                yield function


def _in_order(node: ast.AST) -> Iterator[ast.AST]:
    """Nodes before their parents where a value is needed first, otherwise in the order of the source."""
    children = list(ast.iter_child_nodes(node))
    if isinstance(node, ast.ListComp | ast.SetComp | ast.GeneratorExp | ast.DictComp):
        children = [*node.generators, *(child for child in children if child not in node.generators)]
    for child in children:
        if isinstance(child, ast.For | ast.comprehension):
            yield child
        yield from _in_order(child)
        if not isinstance(child, ast.For | ast.comprehension):
            yield child


def _module_of(thing: Any) -> str:
    try:
        return str(thing.__module__)
    except AttributeError:  # as functions of Boost.Python
        return ""


def _callee(node: ast.expr, known: dict[str, Any], names: dict[str, Any]) -> Any:
    if isinstance(node, ast.Name):
        return names.get(node.id)
    if isinstance(node, ast.Attribute):
        owner = _callee(node.value, known, names)
        if owner is None or inspect.ismodule(owner) is inspect.isclass(owner):
            owner = _plain(_type_of(node.value, known, names))
        return inspect.getattr_static(owner, node.attr, None) if owner is not None else None
    return None


def _is_ours(function: Any) -> bool:
    function = getattr(function, "__func__", function)
    return inspect.isfunction(function) and _module_of(function).startswith(PACKAGES)


def _bind(target: ast.expr, value: Any, known: dict[str, Any]) -> None:
    if isinstance(target, ast.Name):
        known[target.id] = value
    elif isinstance(target, ast.Tuple):
        parts = typing.get_args(value) if typing.get_origin(value) is tuple else ()
        for index, element in enumerate(target.elts):
            _bind(element, parts[index] if index < len(parts) else None, known)


def _entry_of(node: ast.expr, known: dict[str, Any], names: dict[str, Any]) -> Any:
    """Type of what a loop over an expression yields."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "enumerate":
        return tuple[int, _entry_of(node.args[0], known, names)]  # type: ignore[misc]
    parts = [part for part in typing.get_args(_type_of(node, known, names)) if part is not Ellipsis]
    return parts[0] if parts else None


def _type_of(node: ast.expr, known: dict[str, Any], names: dict[str, Any]) -> Any:
    if isinstance(node, ast.Name):
        return known.get(node.id)
    if isinstance(node, ast.Attribute):
        owner = _plain(_type_of(node.value, known, names))
        if not inspect.isclass(owner):
            return None
        member = inspect.getattr_static(owner, node.attr, None)
        if isinstance(member, property) and member.fget is not None:
            return _hints(member.fget).get("return")
        return next((_hints(base)[node.attr] for base in owner.__mro__ if _has(base, node.attr)), None)
    if isinstance(node, ast.Call):
        function = _callee(node.func, known, names)
        if inspect.isclass(function):
            return function
        name = getattr(function, "__name__", "")
        if name in PARTS:
            return type(PARTS[name])
        if name == "replace" and node.args:
            return _type_of(node.args[0], known, names)
        return _hints(function).get("return") if _is_ours(function) else None
    if isinstance(node, ast.Tuple | ast.List):
        return tuple[tuple(_type_of(element, known, names) for element in node.elts)]  # type: ignore[misc]
    if isinstance(node, ast.Subscript):
        return _entry_of(node.value, known, names)
    if isinstance(node, ast.IfExp):
        return _type_of(node.body, known, names) or _type_of(node.orelse, known, names)
    if isinstance(node, ast.Lambda):
        return _type_of(node.body, known, names)
    return None


def _has(owner: Any, attribute: str) -> bool:
    return _module_of(owner).startswith(PACKAGES) and attribute in getattr(owner, "__annotations__", {})


def _plain(kind: Any) -> Any:
    """A type without ``Annotated``, ``X | None`` and the like."""
    if typing.get_origin(kind) is typing.Annotated:
        return _plain(typing.get_args(kind)[0])
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        parts = [_plain(part) for part in typing.get_args(kind) if part is not type(None)]
        return parts[0] if parts else None
    return kind


def _carries(kind: Any, depth: int = 0) -> bool:
    """Whether a type is a section of the request, or holds one."""
    if kind is None or depth > 3:
        return False
    if any(_carries(part, depth + 1) for part in typing.get_args(kind) if part is not Ellipsis):
        return True
    kind = _plain(kind)
    if not inspect.isclass(kind) or not _module_of(kind).startswith(PACKAGES):
        return False
    if kind.__module__.startswith(SCHEMA) and dataclasses.is_dataclass(kind):
        return True
    fields = _hints(kind) if dataclasses.is_dataclass(kind) else {}
    return any(_carries(value, depth + 1) for value in fields.values())


def _rank(module: str) -> int:
    return PACKAGES.index(module.partition(".")[0])


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="every function on the way")
    parser.add_argument("--kind", default="valve", help="of the request: reach, valve, door, ...")
    options = parser.parse_args()
    from service.planner import plan
    from service.request.tasks.kind import load_part
    from service.request.tasks.registry import KINDS

    kind = next(kind for kind in KINDS if kind.name == options.kind)
    PARTS.update(find_demand_part=load_part(kind.demand), find_plan_part=load_part(kind.plan))

    walk = Walk()
    walk.enter(plan)
    if options.list:
        for function in walk.functions:
            print(f"{function.__module__}.{function.__qualname__}")
    stays = walk.files
    upwards = [(a, b) for a, b in walk.calls if _rank(b) < _rank(a)]
    print(f"{len(walk.functions)} functions in {len(set(stays))} files")
    print(f"{len(stays) - len(set(stays))} returns to a file already left")
    print(f"{len(upwards)} calls against the direction of imports {sorted(set(upwards)) or ''}")


if __name__ == "__main__":
    main()
