"""Direction in which a door opens, from what the scan shows of its leaf, frame and hinges."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.door.frame import Frame
from perception.detect.door.geometry import Opens
from perception.detect.door.leaf import Leaf
from perception.detect.door.profile import BAND, Rays

_SURELY_AJAR = np.radians(3.0)
_FLUSH = 0.012
_RECESSED, _DEEP = 0.03, 0.05
_STOP, _INSIDE = (0.001, 0.006), (0.03, 0.05)  # columns inside of the leaf's edge with a stop, and without one [m]
_STOP_HEIGHT, _BARE = 0.006, 0.004
_FEWEST = 20
_SURE = 2.5  # two standard errors of a median, in standard deviations over the root of the number of points
_NEAR = 0.06
_KNUCKLE_COLUMNS = (-0.016, 0.008)  # about the leaf's hinge edge, towards its free edge [m]
_KNUCKLE_ZONES = ((0.08, 0.45), (0.8, 1.3), (1.5, 1.97))
_KNUCKLE_HALF = 0.05
_ROW = 0.02
_FEWEST_IN_KNUCKLE = 4
_SURE_KNUCKLES = 8.0


def judge_opening(
    leaf: Leaf, frame: Frame | None, ends: tuple[float, float], rays: Rays, ground: float
) -> tuple[Opens | None, float]:
    """Return the opening direction, None where the scan does not show it, and its certainty.

    An open leaf shows it.  Hinges are seen on the side to which the leaf opens, and there it is mostly flush with the
    wall; on the other side it stands back behind a stop that covers its edges.

    Args:
        ends: positions of the leaf's hinge edge and free edge along its plane [m].
    """
    if frame is None:
        return None, 0.0
    if frame.hinge:
        return ("push" if frame.opens_away else "pull"), 1.0 if frame.ajar > _SURELY_AJAR else 0.8
    local = leaf.plane.local(rays.ends)
    local = local[np.abs(local[:, 2]) < _NEAR]
    shows_hinges = _rate_knuckles(local, ends, ground) > _SURE_KNUCKLES
    if frame.depth > _RECESSED:
        is_behind_stop = all(_has_stop(local, end, other, ground, leaf.rms) for end, other in (ends, ends[::-1]))
        if is_behind_stop and frame.depth > _DEEP and not shows_hinges:
            return "push", 0.9
        return ("pull", 0.8) if shows_hinges and not is_behind_stop else (None, 0.0)
    if abs(frame.depth) < _FLUSH or shows_hinges:
        return "pull", 0.95 if shows_hinges else 0.8
    return None, 0.0


def _has_stop(local: Float[np.ndarray, "N 3"], end: float, other: float, ground: float, rms: float) -> bool:
    """Return whether a narrow strip that stands over the leaf covers its edge at ``end``.

    Args:
        rms: scatter of the leaf's points [m].
    """
    inwards = 1.0 if other > end else -1.0
    along = (local[:, 0] - end) * inwards
    band = (local[:, 1] > ground + BAND[0]) & (local[:, 1] < ground + BAND[1])
    strip, bare = (local[band & (along > low) & (along < high), 2] for low, high in (_STOP, _INSIDE))
    if min(len(strip), len(bare)) < _FEWEST:
        return False
    sure = _SURE * rms / np.sqrt(len(strip))
    return bool(np.median(strip) > _STOP_HEIGHT + sure and abs(np.median(bare)) < _BARE)


def _rate_knuckles(local: Float[np.ndarray, "N 3"], ends: tuple[float, float], ground: float) -> float:
    """Return the sum of standard errors by which hinges stand out of what is above and below them.

    In each of three zones it takes the window of a hinge's height that stands out most.
    """
    inwards = 1.0 if ends[1] > ends[0] else -1.0
    along = (local[:, 0] - ends[0]) * inwards
    mine = (along > _KNUCKLE_COLUMNS[0]) & (along < _KNUCKLE_COLUMNS[1])
    column = np.floor(along[mine] / 0.006).astype(int)
    height, out = local[mine, 1] - ground, local[mine, 2].copy()
    for k in np.unique(column):
        out[column == k] -= np.median(out[column == k])
    if len(out) < _FEWEST:
        return 0.0
    sigma = max(1.4826 * float(np.median(np.abs(out))), 0.004)
    total = 0.0
    for low, high in _KNUCKLE_ZONES:
        best = 0.0
        for middle in np.arange(low + _KNUCKLE_HALF, high - _KNUCKLE_HALF, _ROW):
            inside = out[np.abs(height - middle) < _KNUCKLE_HALF]
            if len(inside) >= _FEWEST_IN_KNUCKLE:
                best = max(best, float(np.clip(inside, -0.03, 0.03).mean()) * np.sqrt(len(inside)) / sigma)
        total += best
    return total
