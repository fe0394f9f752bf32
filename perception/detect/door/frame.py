"""Wall in which a leaf hangs: the leaf's angle and depth in it, its hinge edge, and the width of the opening."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.door.leaf import Leaf
from perception.detect.door.profile import BAND, BIN, Profile, Rays, straight_stretches, take_profile
from perception.detect.door.upright import Upright, fit_upright

CLOSED = np.radians(2.0)
_BEHIND = 0.28
_BEFORE = 0.08
_BESIDE = 0.4
_ON_WALL = 0.03
_STEEPEST = np.radians(100.0)


@dataclass(frozen=True)
class Frame:
    """A wall and the opening in it.

    Attributes:
        plane: of the wall, normal towards the sensor.
        ajar: angle between leaf and wall [rad].
        hinge: edge of the leaf at the wall, -1 low, 1 high; 0 when closed.
        depth: distance of the leaf's hinge edge (closed: its middle) behind the wall's face [m].
        sides: share of the observed columns that lie on the wall's plane, beside the hinge edge and beyond the
            opening, 0 to 1 each; NaN where too few were observed.
        opening: width between the wall's ends on both sides [m]; NaN when one was not seen.
        opens_away: whether the leaf's free edge lies deeper than its hinge edge.
        gap_share: share of the opening's columns in which rays went on behind the wall; 0 when closed.
    """

    plane: Upright
    ajar: float
    hinge: int
    depth: float
    sides: tuple[float, float]
    opening: float
    opens_away: bool
    gap_share: float

    @property
    def support(self) -> float:
        """Certainty that a wall surrounds the leaf, 0 to 1."""
        seen = [side for side in self.sides if not np.isnan(side)]
        if not seen:
            return 0.0
        if len(seen) == 1:
            return 0.8 * seen[0]
        return float(0.5 * max(seen) + 0.5 * np.mean(seen))


def find_frame(
    leaf: Leaf,
    points: Float[np.ndarray, "N 3"],
    rays: Rays,
    origin: Float[np.ndarray, "3"],
    ground: float,
    uprights: list[Upright],
) -> Frame | None:
    """Return the wall of greatest support for the leaf; None when no plane has enough."""
    best: tuple[float, Frame] | None = None
    for plane in (*_beside(leaf, points, origin, ground), *uprights):
        frame = _hang(leaf, plane, points, rays, origin, ground)
        if frame is None:
            continue
        # Of walls with equal support, the one at the smallest angle to the leaf.
        score = frame.support - 0.05 * frame.ajar
        if best is None or score > best[0]:
            best = (score, frame)
    return None if best is None or best[1].support < 0.25 else best[1]


def _beside(
    leaf: Leaf, points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"], ground: float
) -> list[Upright]:
    """Return planes fitted to the straight stretches beside the leaf: to both sides together, and to each alone."""
    local = leaf.plane.local(points)
    band = (local[:, 1] > ground + BAND[0]) & (local[:, 1] < ground + BAND[1])
    chosen = []
    for side, edge in ((-1, leaf.low.at), (1, leaf.high.at)):
        best: tuple[float, Bool[np.ndarray, "N"]] | None = None
        for stretch in straight_stretches(leaf.profile):
            low, high = leaf.profile.low + stretch.first * BIN, leaf.profile.low + stretch.last * BIN
            near, far = (low - edge, high - edge) if side > 0 else (edge - high, edge - low)
            if np.isnan(stretch.slope) or abs(stretch.slope) > 0.5 or near < -0.06 or near > 0.5 or high - low < 0.08:
                continue
            off = local[:, 2] - stretch.slope * local[:, 0] - stretch.intercept
            mine = band & (local[:, 0] > low) & (local[:, 0] < high) & (np.abs(off) < _ON_WALL)
            if mine.sum() >= 20 and (best is None or far - near > best[0]):
                best = (far - near, mine)
        if best is not None:
            chosen.append(points[best[1]])
    planes = [fit_upright(members, origin) for members in chosen]
    if len(chosen) == 2:
        both = fit_upright(np.concatenate(chosen), origin)
        planes.insert(0, both)
    return planes


def _hang(
    leaf: Leaf,
    start: Upright,
    points: Float[np.ndarray, "N 3"],
    rays: Rays,
    origin: Float[np.ndarray, "3"],
    ground: float,
) -> Frame | None:
    """Return the frame for this wall, its plane refined; None when the leaf cannot hang in it."""
    frame = _judge(leaf, start, points, rays, ground)
    if frame is None:
        return None
    plane = _refine(leaf, frame, points, origin, ground)
    return frame if plane is None else _judge(leaf, plane, points, rays, ground) or frame


def _judge(leaf: Leaf, plane: Upright, points: Float[np.ndarray, "N 3"], rays: Rays, ground: float) -> Frame | None:
    ends = np.stack([leaf.plane.place(leaf.low.at), leaf.plane.place(leaf.high.at)])
    local = plane.local(ends)
    ajar = float(np.arccos(np.clip(abs(leaf.plane.along @ plane.along), 0.0, 1.0)))
    if leaf.plane.normal @ plane.normal < 0.0 and ajar < np.radians(60.0):
        return None
    is_closed = ajar < CLOSED
    out = local[:, 2]
    hinge = int(np.argmin(np.abs(out)))
    depth = float(-out.mean() if is_closed else -out[hinge])
    if not -_BEFORE < depth < _BEHIND:
        return None
    profile = take_profile(plane, points, rays, ground + BAND[0], ground + BAND[1])
    if not len(profile.depth):
        return None
    along = 1 if local[1 - hinge, 0] > local[hinge, 0] else -1
    first = float(local[hinge, 0])
    last = float(local[1 - hinge, 0]) if is_closed else first + along * leaf.width
    before = _wall_share(profile, first - along * _BESIDE, first - along * 0.02, 0.25)
    after = _wall_share(profile, last + along * 0.02, last + along * _BESIDE, 0.25)
    gap, gap_wall = _gap(profile, first + along * 0.06, last - along * 0.06)
    if not is_closed and gap_wall > 0.35:
        return None
    places = plane.local(points)
    on_wall = (np.abs(places[:, 2]) < 0.02) & (places[:, 1] > ground + BAND[0]) & (places[:, 1] < ground + BAND[1])
    opening = _opening(profile, places[on_wall, 0], 0.5 * (first + last), abs(last - first))
    return Frame(
        plane,
        ajar,
        0 if is_closed else (1 if hinge else -1),
        depth,
        (before, after),
        opening,
        bool(not is_closed and out[1 - hinge] < out[hinge]),
        0.0 if is_closed else gap,
    )


def _columns(profile: Profile, start: float, end: float) -> np.ndarray:
    low, high = sorted((start, end))
    centres = profile.centres
    return np.flatnonzero((centres > low) & (centres < high))


def _wall_share(profile: Profile, start: float, end: float, least: float) -> float:
    """Return the share of the observed columns that lie on the plane; NaN when too few were observed."""
    mine = _columns(profile, start, end)
    seen = profile.is_solid[mine] | (profile.open_storeys[mine] > 0)
    if seen.sum() * BIN < least * abs(end - start):
        return float("nan")
    on = profile.is_solid[mine] & (np.abs(profile.depth[mine]) < _ON_WALL)
    return float(on.sum() / seen.sum())


def _gap(profile: Profile, start: float, end: float) -> tuple[float, float]:
    """Return the share of the opening's columns that are open, and the share on the wall's plane."""
    mine = _columns(profile, start, end)
    if not len(mine):
        return 0.0, 0.0
    on = profile.is_solid[mine] & (np.abs(profile.depth[mine]) < 0.5 * _ON_WALL)
    opened = ~profile.is_solid[mine] & (profile.open_storeys[mine] > 0)
    return float(opened.mean()), float(on.mean())


def _opening(profile: Profile, wall: Float[np.ndarray, "N"], middle: float, width: float) -> float:
    """Return the distance between the wall's ends on both sides of the opening [m]; NaN when one was not seen.

    Args:
        wall: (N,) positions along the plane of the points on the wall [m].
        middle, width: approximate, of the opening [m].
    """
    on = profile.is_solid & (np.abs(profile.depth) < _ON_WALL)
    centres = profile.centres
    low = centres[on & (centres < middle - 0.3 * width)]
    high = centres[on & (centres > middle + 0.3 * width)]
    if not len(low) or not len(high):
        return float("nan")
    ends = []
    for at, side in ((low.max(), 1.0), (high.min(), -1.0)):
        # The outermost columns of the wall also hold its reveal and do not count as wall.
        beside = (wall - at) * side
        beside = beside[(beside > -BIN) & (beside < 2.5 * BIN)]
        ends.append(at + side * (float(np.percentile(beside, 98.0)) if len(beside) > 5 else 0.5 * BIN))
    return float(ends[1] - ends[0])


def _refine(
    leaf: Leaf, frame: Frame, points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"], ground: float
) -> Upright | None:
    """Return the wall's plane fitted to its points within 1.2 m of the opening, without the leaf's points."""
    own = leaf.plane.local(points)
    of_leaf = (own[:, 0] > leaf.low.at - 0.03) & (own[:, 0] < leaf.high.at + 0.03) & (np.abs(own[:, 2]) < 0.05)
    plane = frame.plane
    middle = plane.local(leaf.plane.place(0.5 * (leaf.low.at + leaf.high.at))[None])[0, 0]
    for band in (_ON_WALL, 0.025):
        local = plane.local(points)
        mine = ~of_leaf & (np.abs(local[:, 2]) < band) & (np.abs(local[:, 0] - middle) < 1.2 + 0.5 * leaf.width)
        mine &= (local[:, 1] > ground + BAND[0]) & (local[:, 1] < ground + 2.3)
        if mine.sum() < 30:
            return None
        off = local[mine, 2]
        centre = np.median(off)
        near = np.abs(off - centre) < max(2.5 * 1.4826 * float(np.median(np.abs(off - centre))), 0.008)
        plane = fit_upright(points[mine][near], origin)
    return plane
