"""Pivot of a bar in front of a face: the end at which it is held.

Between bar and face there is a gap.  Rays that pass through the gap show that the bar is free there, rays that end in
it that it is held; a bar with only one free end is held at the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.detect.shared.arithmetic import rising
from perception.detect.shared.bars import Bar
from perception.detect.shared.faces import Face, FaceRays

_ZONE = 0.05
_HUB = 0.02
_BESIDE = 0.005
_FEWEST = 4
_NECK = 0.75
_LEVELS = (0.3, 0.45, 0.6)
_UNSEEN_END = 0.45
_UNSEEN_PIVOT = 0.5
_HUB_OVER_BAR = 1.5
_GAP_OVER_NOISE = (2.0, 3.0)
_ABOUT = 0.08
_ON_FACE = 3.0
_OUTSIDE = (-0.1, -0.05)
_FACE_SHARE = (0.3, 0.6)
_BEYOND_END, _ASIDE = (0.012, 0.06), 0.05
_GOES_ON = (0.2, 0.45)


@dataclass(frozen=True)
class Pivot:
    """Point where a bar is held.

    Attributes:
        along: position of the pivot on the bar's axis, from its centre [m].
        far: position of the free end on the bar's axis [m].
        stand_off: distance of the bar's axis from the face [m].
        confidence: that the bar is held at this end only, 0 to 1.
    """

    along: float
    far: float
    stand_off: float
    confidence: float


def find_pivot(face: Face, seen: FaceRays, bar: Bar) -> Pivot:
    """Return the pivot at the end where rays end in the gap behind the bar and do not pass through it."""
    centre = face.local(bar.centre[None])[0]
    axis = face.frame @ bar.axis
    flat = axis[:2] / max(float(np.hypot(axis[0], axis[1])), 1e-6)
    stand_off = float(centre[2] + 0.5 * (bar.first + bar.last) * axis[2])
    radius = bar.half[0]
    along, side, height = _in_bar(seen.ends, centre, flat)
    bottom = stand_off - radius
    low = max(2.0 * face.sigma, 0.012)
    ended = (np.abs(side) < radius + _HUB) & (height > low) & (height < bottom - 0.5 * face.sigma)
    wider = (np.abs(side) > radius + _BESIDE) & (np.abs(side) < radius + _HUB) & (height >= bottom)
    held = along[ended | wider]
    free = np.concatenate([_passes_behind(face, seen, centre, flat, level * bottom, radius) for level in _LEVELS])
    scores = []
    for end, other in ((bar.first, bar.last), (bar.last, bar.first)):
        mine, far = (_zone(held, free, held_end, bar) for held_end in (end, other))
        seen_free = far[0] * (1.0 - mine[0]) * (_UNSEEN_PIVOT + (1.0 - _UNSEEN_PIVOT) * mine[1])
        unseen = (1.0 - far[0]) * (1.0 - far[1]) * mine[1] * _UNSEEN_END
        scores.append(seen_free + unseen)
    at_first = scores[0] >= scores[1]
    end, far_end = (bar.first, bar.last) if at_first else (bar.last, bar.first)
    at = held[np.abs(held - end) < _ZONE]
    inwards = np.sign(far_end - end)
    pivot = end + inwards * _HUB_OVER_BAR * radius
    if len(at) >= _FEWEST:
        pivot = float(np.clip(np.median(at), *sorted((end + inwards * radius, end + inwards * _ZONE))))
    # In a gap hardly deeper than the noise the ends differ by chance.
    certainty = rising(bottom / face.sigma, *_GAP_OVER_NOISE)
    return Pivot(float(pivot), far_end, stand_off, float(max(scores)) * certainty)


def face_behind(face: Face, seen: FaceRays, place: Float[np.ndarray, "3"]) -> float:
    """Return the confidence, 0 to 1, that the face continues behind ``place``; a face holds nothing beyond its edge.

    The position must be in the face's region, and nearby rays that reach the face's plane must end on it.
    """
    flat = face.local(place[None])[0, :2]
    outside = float(np.linalg.norm(np.maximum(np.maximum(face.low - flat, flat - face.high), 0.0)))
    height = seen.ends[np.linalg.norm(seen.at - flat, axis=1) < _ABOUT, 2]
    height = height[height < _ON_FACE * face.sigma]
    share = float((height > -_ON_FACE * face.sigma).mean()) if len(height) >= _FEWEST else 1.0
    return rising(-outside, *_OUTSIDE) * rising(share, *_FACE_SHARE)


def free_end(face: Face, seen: FaceRays, bar: Bar, pivot: Pivot) -> float:
    """Return the confidence, 0 to 1, that the bar ends at its free end; a rim or a rail continues, straight or bent.

    It falls with the number of points just beyond the end, off the face, over that on the bar just before the end.
    """
    centre, axis = face.local(bar.centre[None])[0], face.frame @ bar.axis
    flat = axis[:2] / max(float(np.hypot(axis[0], axis[1])), 1e-6)
    along, side, height = _in_bar(seen.ends, centre, flat)
    past = np.sign(pivot.far - pivot.along) * (along - pivot.far)
    off_face = (height > max(_ON_FACE * face.sigma, _HUB)) & (height < pivot.stand_off + 2.0 * bar.half[0] + _HUB)
    n_beyond = (off_face & (past > _BEYOND_END[0]) & (past < _BEYOND_END[1]) & (np.abs(side) < _ASIDE)).sum()
    n_before = (off_face & (past > -_ZONE) & (past < 0.0) & (np.abs(side) < bar.half[0] + 2.0 * _BESIDE)).sum()
    return 1.0 - rising(float(n_beyond) / max(float(n_before), 1.0), *_GOES_ON)


def _in_bar(
    local: Float[np.ndarray, "N 3"], centre: Float[np.ndarray, "3"], flat: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """Return each point's position along the bar, offset to its side and height over the face [m]."""
    offset = local[:, :2] - centre[:2]
    return offset @ flat, offset @ np.array([-flat[1], flat[0]]), local[:, 2]


def _passes_behind(
    face: Face,
    seen: FaceRays,
    centre: Float[np.ndarray, "3"],
    flat: Float[np.ndarray, "2"],
    level: float,
    radius: float,
) -> Float[np.ndarray, "K"]:
    """Return positions along the bar of rays through the gap behind it, at height ``level`` over the face [m]."""
    slope = seen.rays.direction @ face.frame[2]
    start = face.local(seen.rays.start)
    depth = (level - start[:, 2]) / slope
    there = start + depth[:, None] * (seen.rays.direction @ face.frame.T)
    along, side, _ = _in_bar(there, centre, flat)
    through = (np.abs(side) < radius) & (seen.ends[:, 2] < level - 1.5 * face.sigma)
    return np.asarray(along[through])


def _zone(held: Float[np.ndarray, "K"], free: Float[np.ndarray, "M"], end: float, bar: Bar) -> tuple[float, float]:
    """Return the confidences, 0 to 1, that the bar is free and that it is held at ``end``.

    Where hardly any ray passes further inwards than the held points, the bar has a neck; rays that pass nearer to the
    end, for example over the neck's top, are then not counted.
    """
    depths = [np.abs(x[(np.abs(x - end) < _ZONE) & (x > bar.first) & (x < bar.last)] - end) for x in (held, free)]
    n_held, n_free = float(len(depths[0])), len(depths[1]) / len(_LEVELS)
    if len(depths[0]) >= _FEWEST:
        n_inwards = float((depths[1] >= np.median(depths[0])).sum()) / len(_LEVELS)
        n_free = n_inwards if n_held > _NECK * (n_held + n_inwards) else n_free
    share = n_held / max(n_held + n_free, 1.0)
    is_free = rising(n_free, 1.0, 4.0) * rising(-share, -0.5, -0.25)
    return is_free, rising(n_held, 2.0, 8.0) * rising(share, 0.3, 0.6)
