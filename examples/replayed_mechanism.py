"""Latches of the mechanism of a result: a leaf stays shut until its lever or push bar releases it.

A part of `check_certificate.py`; imports only numpy.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from replayed_motion import Replay

TOLERANCE = 1e-3  # of the values of both joints, besides rounding [rad, m]
ROUNDING = 1e-6


def release(replay: Replay, rule: dict[str, Any]) -> tuple[bool, str]:
    """Check that a joint leaves 0 only with its latch released, until it is past the angle that sets it free.

    A joint that starts ajar may stay as it is.  An interval of the curve is halved until bounds of both joints decide.
    """
    joint, latch = (replay.names.index(rule[key]) for key in ("joint", "latch"))
    sign, shut, free = np.sign(rule["latch_at"]), TOLERANCE + ROUNDING, rule["free_beyond"]
    needed, start, is_free = abs(rule["latch_at"]) - shut, replay.q(replay.knots[0])[joint], False
    for piece, (first, last) in enumerate(itertools.pairwise(replay.knots.tolist())):
        todo, least = [(first, last)], 1e-6 * (last - first)
        while todo:
            a, b = todo.pop()
            ends, bend = (replay.q(a, 0, piece), replay.q(b, 0, piece)), replay.rates(a, b, piece)[1]
            leaves = (b - a) ** 2 / 8 * bend  # by which a joint leaves the line between its values at the ends
            low, high = (f(ends[0][joint], ends[1][joint]) for f in (min, max))
            low, high = low - leaves[joint], high + leaves[joint]
            is_shut, is_open = -shut <= low and high <= shut, low >= free
            is_free = (is_free or is_open) and not is_shut
            is_held = start - shut <= low and high <= start + shut
            is_released = min(sign * ends[0][latch], sign * ends[1][latch]) - leaves[latch] >= needed
            if is_shut or is_held or is_released or (is_free and low > shut):
                continue
            if b - a > least:
                todo += [(0.5 * (a + b), b), (a, 0.5 * (a + b))]
                continue
            # Too short to be halved: it holds the place where the joint gets free, or where it is shut again.
            middle = replay.q(0.5 * (a + b), 0, piece)[joint]
            is_free = (is_free or middle >= free) and abs(middle) > shut
            if not is_free and abs(middle) > shut:
                return False, f"{rule['joint']} is at {middle:.4f} while {rule['latch']} does not release it"
    return True, f"{rule['joint']} is shut, or {rule['latch']} at {rule['latch_at']:.3f}, or it is free"
