"""Fewer pieces for a whole scene: small bodies are merged while they contain little more free space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from costs.progress import tell
from perception.convex.body import Body
from perception.convex.freespace import FreeSpace
from perception.convex.hulls import limit_vertices, make_hull
from perception.convex.split import SplitAllowance, merge

MOST_BODIES = 240
# Allowances for free space in merged bodies, in turn, as multiples of that of other hulls.
_FACTORS = (1.0, 2.0, 4.0, 8.0)
# Larger slabs and hulls stay as they are: longest side [m].
_SMALL = 0.6
_GAP = 0.06


def reduce_bodies(bodies: Sequence[Body], free: FreeSpace, most: int = MOST_BODIES) -> list[Body]:
    """Return at most ``most`` bodies, more if they contain too much free space together.

    Those are merged first that add least volume.  The tightest allowance that gives few enough is used, so that scenes
    of few bodies stay as they are.
    """
    bodies = list(bodies)
    for factor in _FACTORS:
        if len(bodies) <= most:
            break
        tell("merge pieces")
        allowed = SplitAllowance(SplitAllowance.volume * factor, SplitAllowance.share * factor)
        bodies = _merge_small(bodies, free, allowed, most)
    return bodies


def _merge_small(bodies: list[Body], free: FreeSpace, allowed: SplitAllowance, most: int) -> list[Body]:
    small = [i for i, body in enumerate(bodies) if np.ptp(body.vertices, axis=0).max() <= _SMALL]
    hulls = [make_hull(bodies[i].vertices, np.array([i])) for i in small]
    kept = [body for i, body in enumerate(bodies) if i not in set(small)]
    joint = merge(hulls, free, _GAP, allowed, most_left=most - len(kept))
    return [
        *kept,
        *(
            bodies[int(hull.members[0])]
            if len(hull.members) == 1
            else Body("clutter", limit_vertices(hull.vertices), None)
            for hull in joint
        ),
    ]
