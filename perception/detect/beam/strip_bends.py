"""Strips that are two: where faces of two bars in about the same line and plane were taken for one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from perception.detect.beam.strips import Strip, middle_and_half
from perception.detect.shared.vectors import cross

_BIN = 0.04
_FEWEST_BINS, _FEWEST_IN_BIN = 6, 2
# How far a bent strip lies off its one line [m], and what is left of that, squared, off two.
_BENT, _LEFT = 0.006, 0.4


def straight_parts(strip: Strip) -> list[Strip]:
    """The strip, or both its parts where middle line, width or height change along it better explained by a break."""
    side = cross(strip.normal, strip.axis)
    local = (strip.members - strip.place) @ np.stack([strip.axis, side, strip.normal], axis=1)
    number = np.floor((local[:, 0] - strip.first) / _BIN).clip(0).astype(np.int64)
    bins, course = _course(number, local)
    if len(bins) < 2 * _FEWEST_BINS:
        return [strip]
    total = _misfit(bins, course)
    breaks = np.arange(_FEWEST_BINS, len(bins) - _FEWEST_BINS + 1)
    misfits = [_misfit(bins[:k], course[:k]) + _misfit(bins[k:], course[k:]) for k in breaks]
    best = int(np.argmin(misfits))
    if total < len(bins) * _BENT**2 or misfits[best] > _LEFT * total:
        return [strip]
    before = number < bins[breaks[best]]
    return [_refitted(strip, strip.members[part]) for part in (before, ~before)]


def _course(
    number: Int[np.ndarray, "N"], local: Float[np.ndarray, "N 3"]
) -> tuple[Int[np.ndarray, "B"], Float[np.ndarray, "B 3"]]:
    """Bins along a strip that hold points, and the middle, half the width and the height of what they hold [m]."""
    n = np.bincount(number)
    bins = np.flatnonzero(n >= _FEWEST_IN_BIN)
    across, square, over = (np.bincount(number, weight)[bins] / n[bins] for weight in _moments(local))
    spread = np.sqrt(np.maximum(square - across**2, 0.0))
    return bins, np.column_stack([across, np.sqrt(3.0) * spread, over])


def _moments(local: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "N"], ...]:
    return local[:, 1], local[:, 1] ** 2, local[:, 2]


def _misfit(bins: Int[np.ndarray, "B"], course: Float[np.ndarray, "B 3"]) -> float:
    """Squared distance of middle and height from straight lines, and of the width from its mean [m^2]."""
    x = bins - bins.mean()
    off = course - course.mean(axis=0)
    slope = (x @ off) / max(float(x @ x), 1e-9) * np.array([1.0, 0.0, 1.0])
    return float(((off - x[:, None] * slope) ** 2).sum())


def _refitted(strip: Strip, members: Float[np.ndarray, "K 3"]) -> Strip:
    """As long, wide and inclined as these of its points."""
    middle = members.mean(axis=0)
    vectors = np.linalg.eigh(np.cov((members - middle).T))[1]
    axis = vectors[:, 2] * np.sign(vectors[:, 2] @ strip.axis)
    normal = vectors[:, 0] * np.sign(vectors[:, 0] @ strip.normal)
    side = cross(normal, axis)
    off, half = middle_and_half((members - middle) @ side)
    place = middle + off * side
    along = (members - place) @ axis
    share = len(members) / len(strip.members)
    return Strip(place, axis, normal, half, float(along.min()), float(along.max()), members, strip.score * share)
