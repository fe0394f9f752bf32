"""How far before or behind a rim the rays that ended on it did so: by chance, and all about one place of it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from perception.detect.valve.ring import CLOSE, Passage, Ring, rim_hits
from perception.sightlines import Sightlines

_PARTS, _FEWEST = 12, 4


def depth_error(rays: Sightlines, passage: Passage, hit: Bool[np.ndarray, "N"]) -> float:
    """Root of the mean square over all [m]; infinite where there are none."""
    return float(np.sqrt(np.mean((rays.length - passage.depth)[hit] ** 2))) if hit.any() else np.inf


def axis_error(rays: Sightlines, ring: Ring, passage: Passage) -> float:
    """Standard deviation of the axis that follows from the depths it was fitted to [rad]."""
    close = rim_hits(rays, ring, passage, CLOSE)
    return depth_error(rays, passage, close) / ring.radius * float(np.sqrt(2.0 / max(int(close.sum()), 1)))


def unevenness(rays: Sightlines, passage: Passage, hit: Bool[np.ndarray, "N"]) -> float:
    """How far the rays on each twelfth of the rim do so in the mean, beyond what their scatter explains [m].

    A rim lies where its rays end all round; a ring laid through parts of other things is before some and behind others.
    """
    off = (rays.length - passage.depth)[hit]
    angle = np.arctan2(passage.place[hit, 1], passage.place[hit, 0])
    part = np.floor(angle / (2.0 * np.pi) * _PARTS).astype(int) % _PARTS
    count = np.bincount(part, minlength=_PARTS)
    known = count >= _FEWEST
    if not known.any():
        return 0.0
    mean = np.bincount(part, off, _PARTS) / np.maximum(count, 1)
    scatter = float(((off - mean[part]) ** 2)[known[part]].sum()) / max(int((count[known] - 1).sum()), 1)
    beyond = float(np.mean(mean[known] ** 2 - scatter / count[known]))
    return float(np.sqrt(max(0.0, beyond)))
