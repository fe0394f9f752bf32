"""Numbers in the texts of checks, rounded to the side on which the text stays true."""

from __future__ import annotations

import math

_SLACK = 1e-7  # of the last digit, so that a written decimal stays itself


def round_up(value: float, digits: int) -> str:
    """Return the least decimal with so many digits that is no smaller than the value, for "at most" and "within"."""
    if not math.isfinite(value):
        return str(value)
    scale = 10.0**digits
    return f"{math.ceil(value * scale - _SLACK) / scale + 0.0:.{digits}f}"


def round_down(value: float, digits: int) -> str:
    """Return the largest decimal with so many digits that is no larger than the value, for "at least"."""
    if not math.isfinite(value):
        return str(value)
    scale = 10.0**digits
    return f"{math.floor(value * scale + _SLACK) / scale + 0.0:.{digits}f}"
