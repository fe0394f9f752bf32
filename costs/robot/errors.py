"""Error of the robot loader."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class RobotError(ValueError):
    """A robot file, option or name that cannot be used; one line that names it, the value and what is expected."""


def suggest(name: str, known: Iterable[str]) -> str:
    """Suggest names instead of an unknown one: its closest matches, or the first few known names."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    if close:
        return "did you mean " + " or ".join(repr(match) for match in close) + "?"
    if not names:
        return "there are none"
    return "known: " + ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
