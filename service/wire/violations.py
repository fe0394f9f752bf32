"""What is wrong with a request as google.rpc.BadRequest, whose field violations name fields as a request file does."""

from __future__ import annotations

import re
from collections.abc import Iterable

from google.rpc.error_details_pb2 import BadRequest

_STEP = r"[A-Za-z_][A-Za-z0-9_]*(?:\[\d+\])?"
_LEADING = re.compile(rf"^({_STEP}(?:\.[^\s.:]+)*): ")
_WITHIN = re.compile(rf"\bin ((?:robot|start|scene|goal|task|keep|attached|options)(?:\.{_STEP})+)")
_BEGINNINGS = {"start is ": "start", "robot": "robot"}


def bad_request(problems: Iterable[str], within: str = "") -> BadRequest:
    """One violation per problem; ``within`` is the field of the message that holds the request."""
    return BadRequest(field_violations=[violation(problem, within) for problem in problems])


def violation(problem: str, within: str = "") -> BadRequest.FieldViolation:
    """The field a problem speaks of (the whole request where it names none), and the problem."""
    field = _field(problem)
    return BadRequest.FieldViolation(field=".".join(part for part in (within, field) if part), description=problem)


def _field(problem: str) -> str:
    leading = _LEADING.match(problem)
    if leading:
        return leading[1]
    inside = _WITHIN.search(problem)
    if inside:
        return inside[1]
    return next((field for words, field in _BEGINNINGS.items() if problem.startswith(words)), "")
