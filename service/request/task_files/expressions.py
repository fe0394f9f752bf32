"""Expressions in task files: numbers, lists and texts, sums and products, a few functions, and repeated entries."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

from service.errors import would_do

MAX_LENGTH = 200
MAX_DEPTH = 20
REPEAT, OF, ROUND = "repeat", "of", "round"
MOST_ROUNDS = 20
PLACE = re.compile(r"\$\{([^{}]*)\}")
FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sin": lambda angle_deg: math.sin(math.radians(angle_deg)),
    "cos": lambda angle_deg: math.cos(math.radians(angle_deg)),
    "sqrt": math.sqrt,
    "abs": abs,
    "min": min,
    "max": max,
    "unit": lambda vector: [value / math.sqrt(sum(own * own for own in vector)) for value in vector],
    "cross": lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
}
"""Functions by name; angles are in degrees."""

_NUMBERS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


class ExpressionError(ValueError):
    """An expression that cannot be evaluated; the message says why."""


def fill_in(data: Any, values: Mapping[str, Any]) -> Any:
    """Return plain data with every ``${...}`` replaced; a text that is nothing else becomes the value itself.

    An entry ``{repeat: N, of: [...]}`` of a list stands for its entries N times, in which ``round`` counts from 1.

    Raises:
        ExpressionError: an expression cannot be evaluated, or a number of repetitions is none.
    """
    if isinstance(data, Mapping):
        return {key: fill_in(value, values) for key, value in data.items()}
    if isinstance(data, list | tuple):
        filled: list[Any] = []
        for value in data:
            if isinstance(value, Mapping) and REPEAT in value:
                filled += _repeat(value, values)
            else:
                filled.append(fill_in(value, values))
        return filled
    if not isinstance(data, str):
        return data
    whole = PLACE.fullmatch(data.strip())
    if whole is not None:
        return evaluate(whole[1], values)
    return PLACE.sub(lambda place: _write(evaluate(place[1], values)), data)


def _repeat(entry: Mapping[str, Any], values: Mapping[str, Any]) -> list[Any]:
    """Return the entries that are repeated, once per round."""
    count, entries = fill_in(entry[REPEAT], values), entry.get(OF)
    if set(entry) != {REPEAT, OF} or not isinstance(entries, list):
        raise ExpressionError(
            f"{REPEAT}: expected {{{REPEAT}: a number, {OF}: a list}}, got {', '.join(map(str, entry))}"
        )
    is_whole = isinstance(count, int | float) and not isinstance(count, bool) and count == int(count)
    if not is_whole or not 0 <= count <= MOST_ROUNDS:
        raise ExpressionError(f"{REPEAT}: expected a whole number from 0 to {MOST_ROUNDS}, got {count}")
    rounds = ({**values, ROUND: float(number)} for number in range(1, int(count) + 1))
    return [own for names in rounds for own in fill_in(entries, names)]


def _write(value: Any) -> str:
    """Return a value as text inside another one: lists as numbers with blanks, as URDFs have them."""
    if isinstance(value, list):
        return " ".join(_write(own) for own in value)
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def evaluate(text: str, values: Mapping[str, Any]) -> Any:
    """Return the value of an expression.

    Raises:
        ExpressionError: it is no expression of this kind, or a name in it is unknown.
    """
    if len(text) > MAX_LENGTH:
        raise ExpressionError(f"'{text[:40]}...' has {len(text)} characters; expected at most {MAX_LENGTH}")
    try:
        tree = ast.parse(text.strip(), mode="eval")
        result = _evaluate(tree.body, values, 0)
    except (SyntaxError, TypeError, IndexError, ZeroDivisionError, OverflowError, ValueError, RecursionError) as error:
        if isinstance(error, ExpressionError):
            raise
        raise ExpressionError(f"'{text}' cannot be evaluated: {error}") from None
    if isinstance(result, float) and not math.isfinite(result):
        raise ExpressionError(f"'{text}' is not finite")
    return result


def _evaluate(node: ast.expr, values: Mapping[str, Any], depth: int) -> Any:
    if depth > MAX_DEPTH:
        raise ExpressionError(f"nested deeper than {MAX_DEPTH} levels")
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float | str):
        return node.value
    if isinstance(node, ast.Name):
        if node.id not in values:
            raise ExpressionError(f"unknown parameter '{node.id}'; expected {would_do(node.id, values)}")
        return values[node.id]
    if isinstance(node, ast.List | ast.Tuple):
        return [_evaluate(own, values, depth + 1) for own in node.elts]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return _combine(operator.mul, -1.0, _evaluate(node.operand, values, depth + 1))
    if isinstance(node, ast.BinOp) and type(node.op) in _NUMBERS:
        parts = (_evaluate(own, values, depth + 1) for own in (node.left, node.right))
        return _combine(_NUMBERS[type(node.op)], *parts)
    if isinstance(node, ast.Subscript):
        index = _evaluate(node.slice, values, depth + 1)
        return _evaluate(node.value, values, depth + 1)[index]
    if isinstance(node, ast.Call) and not node.keywords and ast.unparse(node.func) in FUNCTIONS:
        return FUNCTIONS[ast.unparse(node.func)](*(_evaluate(own, values, depth + 1) for own in node.args))
    raise ExpressionError(
        f"'{ast.unparse(node)}' is not evaluated; expected numbers, lists, + - * /, {', '.join(FUNCTIONS)}"
    )


def _combine(operation: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """Return a sum or product of numbers, of lists entry by entry, or of a list and a number."""
    if isinstance(left, list) and isinstance(right, list):
        if len(left) != len(right) or operation not in (operator.add, operator.sub):
            raise ExpressionError("two lists are added or subtracted, and have the same length")
        return [operation(a, b) for a, b in zip(left, right, strict=True)]
    if isinstance(left, list) or isinstance(right, list):
        if operation is operator.mul or (operation is operator.truediv and isinstance(left, list)):
            if isinstance(left, list):
                return [operation(own, right) for own in left]
            return [operation(left, own) for own in right]
        raise ExpressionError("a list and a number are multiplied; expected * or /")
    for value in (left, right):
        if isinstance(value, str | bool) or not isinstance(value, int | float):
            raise ExpressionError(f"{value!r} is no number")
    return operation(left, right)
