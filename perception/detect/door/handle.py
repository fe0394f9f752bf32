"""Handle on a face: a bar or knob that stands out of the face, rated by the end of each ray towards it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.door.bump import JAMB, Bump, DoorFace, find_bumps, rays_towards
from perception.detect.door.profile import Rays
from perception.detect.door.upright import Upright

_ABOUT = 0.015
_OUT = (0.025, 0.1)  # standoffs a handle can have [m]
_FEWEST, _MANY = 3, 40  # rays
_RING = 0.04
_MOST_SLACK = 0.12
_PULL_END = 0.1
_FRONT = 0.75  # mean distance of a bar's returns in front of its centre line, in radii
_THIN, _BAR, _KNOB = 0.005, 0.012, 0.016  # least and largest radii [m]


@dataclass(frozen=True)
class Handle:
    """Bar or knob that stands out of a face.

    Attributes:
        low, high: (2,) corners along the plane and up [m].
        out: distance of its bar's centre line from the face [m].
        is_lever: wider than high.
        is_pull: a bar much higher than wide.
        is_panic: a bar across most of the face.
        evidence: log odds of its rays against the bare face, minus those that noise alone reaches.
        purity: share of the rays through its rectangle that met it.
        alone: share of the rays just beside it that met the face behind; of a pull, also above and below it.
        pivot_side: end of a lever, -1 or 1, near which a neck or rose was seen; else 0.
        slack: (2,) length by which it may extend unseen beyond its low and high end along the plane [m].
    """

    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]
    out: float
    is_lever: bool
    is_pull: bool
    is_panic: bool
    evidence: float
    purity: float
    alone: float
    pivot_side: int
    slack: tuple[float, float]

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        """(2,) centre of its rectangle along the plane and up [m]."""
        return np.asarray(0.5 * (self.low + self.high))

    @property
    def quality(self) -> float:
        """Certainty that it is a handle, 0 to 1."""
        return float(
            np.clip(self.evidence / 30.0, 0.0, 1.0)
            * np.clip((self.purity - 0.4) / 0.25, 0.0, 1.0)
            * np.clip((self.alone - 0.5) / 0.25, 0.0, 1.0)
            * np.clip((self.out - 0.022) / 0.008, 0.0, 1.0)
            * np.clip((0.094 - self.out) / 0.006, 0.0, 1.0)
        )


def find_handle(
    plane: Upright, low: float, high: float, rms: float, ground: float, rays: Rays, prefer: int = 0
) -> Handle | None:
    """Return the best handle near a side edge of a face, or a bar across it; None when nothing stands out.

    Args:
        low, high: side edges of the face along the plane [m].
        rms: scatter of the face's points [m].
        prefer: side edge to search (-1 low, 1 high); 0 both.
    """
    face = DoorFace(plane, low, high, ground, float(np.clip(rms, 0.006, 0.02)))
    seen = [_measure(face, rays, bump) for bump in find_bumps(face, rays, prefer)]
    return max(seen, key=lambda handle: (handle.quality, handle.evidence), default=None)


@dataclass(frozen=True)
class _Seen:
    """The K rays that are evidence for a bump, and the rectangle of those that met it.

    Attributes:
        mine: (R,) mask of these rays among all.
        at: (K, 2) crossing with the plane of the bump's near side [m].
        depth: (K,) distance of the ray's end out of the face [m].
        vote: (K,) log odds that the ray met the bump, against the face.
        met: (K,) rays that met the bump.
        out: standoff of the bump [m].
        low, high: (2,) corners of the rectangle [m].
    """

    mine: Bool[np.ndarray, "R"]
    at: Float[np.ndarray, "K 2"]
    depth: Float[np.ndarray, "K"]
    vote: Float[np.ndarray, "K"]
    met: Bool[np.ndarray, "K"]
    out: float
    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]

    @property
    def size(self) -> Float[np.ndarray, "2"]:
        """(2,) size of the rectangle along the face and up [m]."""
        return np.asarray(self.high - self.low)

    def within(self, margin: float) -> Bool[np.ndarray, "K"]:
        """Return (K,) rays that cross inside the rectangle grown by ``margin`` [m] on each side."""
        return np.asarray(((self.at >= self.low - margin) & (self.at <= self.high + margin)).all(axis=1))


def _measure(face: DoorFace, rays: Rays, bump: Bump) -> Handle:
    """Return the handle at a bump: its extent, standoff and surroundings, measured by the rays towards it."""
    seen = _look_at(face, rays, bump)
    width, height = seen.size
    is_panic = bool(width > 0.4 * face.width)
    is_lever = bool(not is_panic and width > 0.065 and width > 1.6 * height)
    is_pull = bool(height > 0.12 and height > 2.0 * width)
    radius = float(np.clip(0.5 * seen.size.min(), _THIN, _BAR if is_panic or is_lever or is_pull else _KNOB))
    middle = seen.out - _FRONT * radius
    low, high = _ends(seen, rays.crossing(face.plane, middle)[0])
    inside = seen.within(0.0)
    return Handle(
        low,
        high,
        middle,
        is_lever,
        is_pull,
        is_panic,
        bump.evidence,
        float(np.mean(seen.vote[inside] > 0.0)) if inside.any() else 0.0,
        _free_share(face, seen, is_pull),
        _neck_side(face, seen) if is_lever else 0,
        _slack(face, seen),
    )


def _look_at(face: DoorFace, rays: Rays, bump: Bump) -> _Seen:
    """Return the rays towards a bump with its measured standoff and the rectangle of those that met it."""
    out = bump.out
    for _ in range(2):
        seen = rays_towards(rays, face, out)
        core = seen.mine & ((seen.at > bump.low - _ABOUT) & (seen.at < bump.high + _ABOUT)).all(axis=1)
        core &= seen.depth > 0.6 * out
        if core.sum() < _FEWEST:
            break
        out = float(np.clip(np.median(seen.depth[core]), *_OUT))
    seen = rays_towards(rays, face, out)
    at, depth = seen.at[seen.mine], seen.depth[seen.mine]
    vote = face.votes(depth, out)
    met = ((at > bump.low - 0.02) & (at < bump.high + 0.02)).all(axis=1) & (vote > 0.0)
    low, high = _corners(at[met]) if met.sum() >= _FEWEST else (bump.low, bump.high)
    return _Seen(seen.mine, at, depth, vote, met, out, low, high)


def _corners(places: Float[np.ndarray, "K 2"]) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return low and high corner of the points' bounding rectangle; of many points, 2 % at each end are ignored [m]."""
    trim = 2.0 if len(places) > _MANY else 0.0
    low, high = np.percentile(places, [trim, 100.0 - trim], axis=0)
    return low, high


def _ends(seen: _Seen, at: Float[np.ndarray, "R 2"]) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return low and high corner on the plane of the bump's centre line, which the rays cross ``at`` [m].

    Rays from above meet a bar's near side higher up than that plane.
    """
    return _corners(at[seen.mine][seen.met]) if seen.met.sum() >= _FEWEST else (seen.low, seen.high)


def _free_share(face: DoorFace, seen: _Seen, is_pull: bool) -> float:
    """Return the share of the rays beside a bump that met the face; low for a pipe, which continues up and down."""
    on_face = np.abs(seen.depth) < max(2.5 * face.sigma, 0.02)
    beside = [seen.within(_RING) & ~seen.within(_ABOUT)]
    if is_pull:
        column = (seen.at[:, 0] > seen.low[0]) & (seen.at[:, 0] < seen.high[0])
        beside += [
            column & (seen.at[:, 1] > end) & (seen.at[:, 1] < end + _PULL_END)
            for end in (seen.low[1] - _ABOUT - _PULL_END, seen.high[1] + _ABOUT)
        ]
    return min(float(np.mean(on_face[side])) if side.any() else 0.0 for side in beside)


def _slack(face: DoorFace, seen: _Seen) -> tuple[float, float]:
    """Return the gap from the low and the high end to the first ray past it, or to the face's edge [m]."""
    middle, half = 0.5 * (seen.low[1] + seen.high[1]), max(0.35 * seen.size[1], 0.005)
    past = seen.at[(seen.vote < 0.0) & (np.abs(seen.at[:, 1] - middle) < half), 0]
    below, above = seen.low[0] - past[past < seen.low[0]], past[past > seen.high[0]] - seen.high[0]
    most = np.clip([seen.low[0] - face.low - JAMB, face.high - seen.high[0] - JAMB], 0.0, _MOST_SLACK)
    return (
        float(min(below.min(initial=_MOST_SLACK), most[0])),
        float(min(above.min(initial=_MOST_SLACK), most[1])),
    )


def _neck_side(face: DoorFace, seen: _Seen) -> int:
    """Return the end, -1 or 1, near which more rays ended between bar and face (the neck); 0 when unclear."""
    middle = 0.5 * (seen.low + seen.high)
    along, up = seen.at.T
    about = (np.abs(up - middle[1]) < 0.035) & (along > seen.low[0] - 0.03) & (along < seen.high[0] + 0.03)
    between = about & (seen.depth > 2.0 * face.sigma) & (seen.depth < seen.out - 1.5 * face.sigma)
    side = np.sign(along - middle[0])
    right, left = int((between & (side > 0)).sum()), int((between & (side < 0)).sum())
    if max(left, right) < 5 or max(left, right) < 2.5 * min(left, right):
        return 0
    return 1 if right > left else -1
