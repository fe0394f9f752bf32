"""Problems of a request as google.rpc.BadRequest, with the field names of a request file."""

from __future__ import annotations

import re
from collections.abc import Iterable

from google.rpc.error_details_pb2 import BadRequest

from service.trust.rpc import shorten

# They travel in a header, together with the status; the call fails if its headers exceed 8 KiB.
MAX_BYTES, MAX_PROBLEM_BYTES, MAX_FIELD_BYTES = 2000, 400, 200
_STEP = r"[A-Za-z_][A-Za-z0-9_]*(?:\[\d+\])?"
_SECTION = r"(?:robot|start|scene|goal|task|keep|attached|options)"
_LEADING = re.compile(rf"^({_STEP}(?:\.[^\s.:]+)*): ")
# The key of a map may be any text, also an empty one; the field is the map then.
_ODD_KEY = re.compile(rf"^({_SECTION}(?:\[\d+\])?(?:\.{_STEP})*)\..*: ")
_IN_SENTENCE = re.compile(rf"\bin ({_SECTION}(?:(?:\[\d+\])(?:\.{_STEP})*|(?:\.{_STEP})+))")
_BEGINNINGS = {"start is ": "start", "robot": "robot", "keep belongs ": "keep"}


def make_bad_request(problems: Iterable[str], within: str = "") -> BadRequest:
    """Make one violation per problem, within ``MAX_BYTES``; the last counts those that are left out.

    Args:
        within: field of the message that holds the request.
    """
    bad, lines = BadRequest(), list(problems)
    for index, problem in enumerate(lines):
        violation = make_violation(problem, within)
        is_over = bad.ByteSize() + violation.ByteSize() > MAX_BYTES
        if is_over:
            n_left = len(lines) - index
            violation.description = f"{n_left} more problems are not listed, the first of them in this field"
        bad.field_violations.append(violation)
        if is_over:
            break
    return bad


def make_violation(problem: str, within: str = "") -> BadRequest.FieldViolation:
    """Make the violation of a problem; its field is the whole request if the problem names none."""
    field = ".".join(part for part in (within, _find_field(problem)) if part)
    return BadRequest.FieldViolation(
        field=shorten(field, MAX_FIELD_BYTES), description=shorten(problem, MAX_PROBLEM_BYTES)
    )


def _find_field(problem: str) -> str:
    for match in (_LEADING.match(problem), _ODD_KEY.match(problem), _IN_SENTENCE.search(problem)):
        if match:
            return match[1]
    return next((field for beginning, field in _BEGINNINGS.items() if problem.startswith(beginning)), "")
