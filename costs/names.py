"""Suggestion of known names in place of an unknown one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def would_do(name: object, known: Iterable[str], at_most: int = 6) -> str:
    """The known names that ``name`` may have meant, the closest first; all of them when there are few."""
    names = sorted(known) if isinstance(known, set | frozenset) else list(known)
    if len(names) <= at_most:
        return ", ".join(names)
    close = difflib.get_close_matches(str(name), names, n=3, cutoff=0.6)
    return ", ".join(close or names[:at_most]) + ", …"
