"""What is wrong with a request as google.rpc.BadRequest, whose field violations name fields as a request file does."""

from __future__ import annotations

import re
from collections.abc import Iterable

from google.rpc.error_details_pb2 import BadRequest

from service.trust.rpc import shorten

# They travel in a header, together with the status: a call whose headers exceed 8 KiB ends in something else.
MAX_BYTES, MAX_PROBLEM_BYTES, MAX_FIELD_BYTES = 2000, 400, 200
_STEP = r"[A-Za-z_][A-Za-z0-9_]*(?:\[\d+\])?"
_SECTION = r"(?:robot|start|scene|goal|task|keep|attached|options)"
_LEADING = re.compile(rf"^({_STEP}(?:\.[^\s.:]+)*): ")
# A map's key may be any text, or none: the map is named then.
_ODD_KEY = re.compile(rf"^({_SECTION}(?:\[\d+\])?(?:\.{_STEP})*)\..*: ")
_WITHIN = re.compile(rf"\bin ({_SECTION}(?:(?:\[\d+\])(?:\.{_STEP})*|(?:\.{_STEP})+))")
_BEGINNINGS = {"start is ": "start", "robot": "robot", "keep belongs ": "keep"}


def bad_request(problems: Iterable[str], within: str = "") -> BadRequest:
    """One violation per problem, as many as there is room for; the last says how many there was none for.

    Args:
        within: the field of the message that holds the request.
    """
    bad, lines = BadRequest(), list(problems)
    for index, problem in enumerate(lines):
        one = violation(problem, within)
        if bad.ByteSize() + one.ByteSize() > MAX_BYTES:
            one.description = f"{len(lines) - index} more problems, this field's the first; they are not listed"
            bad.field_violations.append(one)
            break
        bad.field_violations.append(one)
    return bad


def violation(problem: str, within: str = "") -> BadRequest.FieldViolation:
    """The field a problem speaks of (the whole request where it names none), and the problem."""
    field = ".".join(part for part in (within, _field(problem)) if part)
    return BadRequest.FieldViolation(
        field=shorten(field, MAX_FIELD_BYTES), description=shorten(problem, MAX_PROBLEM_BYTES)
    )


def _field(problem: str) -> str:
    for where in (_LEADING.match(problem), _ODD_KEY.match(problem), _WITHIN.search(problem)):
        if where:
            return where[1]
    return next((field for words, field in _BEGINNINGS.items() if problem.startswith(words)), "")
