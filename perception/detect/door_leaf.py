"""Faces that may be door leaves: flat upright rectangles with edges, as the profile of their plane shows them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.profile import BIN, Profile, Rays, Stretch, straight_stretches, take_profile
from perception.detect.upright import Upright, fit_upright

WIDTHS = (0.6, 1.3)
_LEAST_SEEN = 0.45
_FLAT = 0.007
_STEEPEST = 0.35
_RELIEF = 0.006
_BAND = (0.25, 1.8)
_BESIDE = 0.1
_ROW = 0.02
_WAIST = (0.7, 1.4)
_HIDDEN = 0.25
_BEFORE = 0.25
_STRIP = 0.08
_SHARP = 0.06
_SURE_STOREYS = 6
_STRIP_RELIEF = 0.015


@dataclass(frozen=True)
class Edge:
    """A side edge of a face.

    Attributes:
        at: along the plane [m].
        jump: how far what stands beside it lies out of the face's plane [m]; NaN when nothing does.
        open_share: share of the storeys beside it in which rays went on behind the face's plane.
        is_seen: whether anything is known of what is beside it.
    """

    at: float
    jump: float
    open_share: float
    is_seen: bool

    @property
    def strength(self) -> float:
        """0 where the face goes on, 1 where it ends for certain; in between where nothing was seen."""
        if not self.is_seen:
            return 0.5
        step = 0.0 if np.isnan(self.jump) else min(abs(self.jump) / 0.012, 1.0)
        return float(max(step, min(self.open_share / 0.5, 1.0)))


@dataclass(frozen=True)
class Leaf:
    """A flat upright face with its edges.

    Attributes:
        plane: of the face, towards the sensor.
        low, high: its side edges along the plane.
        bottom: lowest height at which it is seen above the floor [m].
        bottom_is_seen: whether something else was seen below it.
        top: where it ends above the floor [m].
        top_is_seen: whether something else was seen above it.
        rms: scatter of its points about the plane [m].
        sigma: uncertainty of the plane's yaw [rad].
        profile: of its plane.
        points: (K, 3) on it [m].
    """

    plane: Upright
    low: Edge
    high: Edge
    bottom: float
    bottom_is_seen: bool
    top: float
    top_is_seen: bool
    rms: float
    sigma: float
    profile: Profile
    points: Float[np.ndarray, "K 3"]

    @property
    def width(self) -> float:
        """Between the edges [m]."""
        return self.high.at - self.low.at


def find_leaves(
    points: Float[np.ndarray, "N 3"],
    rays: Rays,
    origin: Float[np.ndarray, "3"],
    ground: float,
    uprights: list[Upright],
) -> list[Leaf]:
    """Faces of a leaf's width with their edges, each once, widest seen first.

    Args:
        points: (N, 3) obstacles [m].
        rays: all of the scan.
        origin: (3,) of the rays [m].
        ground: world z of the floor [m].
        uprights: planes to look along.
    """
    leaves: list[Leaf] = []
    for plane in uprights:
        profile = take_profile(plane, points, rays, ground + _BAND[0], ground + _BAND[1])
        for low, high, line in _flat_runs(profile, straight_stretches(profile)):
            middle = plane.place(0.5 * (low + high), 0.0, line[0] * 0.5 * (low + high) + line[1])
            if any(_holds(leaf, middle) for leaf in leaves):
                continue
            start = _on_line(points, plane, low, high, line)
            if len(start) < 30:
                continue
            leaf = _settled_leaf(points[start], points, rays, origin, ground)
            if leaf is not None and not any(_same(leaf, other) for other in leaves):
                leaves.append(leaf)
    return leaves


def _holds(leaf: Leaf, place: Float[np.ndarray, "3"]) -> bool:
    local = leaf.plane.local(place[None])[0]
    return bool(abs(local[2]) < 0.01 and leaf.low.at < local[0] < leaf.high.at)


def _same(one: Leaf, other: Leaf) -> bool:
    ends = [one.plane.place(edge.at) for edge in (one.low, one.high)]
    others = [other.plane.place(edge.at) for edge in (other.low, other.high)]
    return all(np.linalg.norm(a - b) < 0.05 for a, b in zip(ends, others, strict=True))


def _flat_runs(profile: Profile, stretches: list[Stretch]) -> list[tuple[float, float, tuple[float, float]]]:
    """Neighbouring stretches that lie on one line and together are as wide as a leaf: (low, high, line)."""
    centres = profile.centres
    out = []
    for seed in sorted(stretches, key=lambda s: s.first - s.last):
        if np.isnan(seed.slope) or abs(seed.slope) > _STEEPEST or (seed.last - seed.first) * BIN < 0.2:
            continue
        off = np.abs(profile.depth - seed.slope * centres - seed.intercept)
        first, last = _grown(profile, stretches, stretches.index(seed), off, _FLAT)
        if _LEAST_SEEN <= (last - first) * BIN <= WIDTHS[1] + 0.1:
            low = profile.low + first * BIN
            out.append((low, low + (last - first) * BIN, (seed.slope, seed.intercept)))
    return out


def _grown(
    profile: Profile, stretches: list[Stretch], index: int, off: Float[np.ndarray, "B"], tolerance: float
) -> tuple[int, int]:
    """The seed and the stretches beside it that stay within the tolerance of its line; a narrow one may not."""
    first, last = stretches[index].first, stretches[index].last
    for step in (-1, 1):
        at, skipped = index + step, 0
        while 0 <= at < len(stretches):
            mine = stretches[at]
            size = mine.last - mine.first
            fits = not np.isnan(mine.slope) and np.sqrt(np.nanmean(off[mine.first : mine.last] ** 2)) < tolerance
            if fits:
                first, last = min(first, mine.first), max(last, mine.last)
                skipped = 0
            else:
                skipped += size
                if skipped * BIN > 0.05 or np.isnan(mine.slope):
                    break
            at += step
    return first, last


def _with_strips(profile: Profile, stretches: list[Stretch], first: int, last: int) -> tuple[int, int]:
    """With the narrow strips along the edges that stand out little and beyond which nothing like the face goes on.

    Seals, edge bars and mixed returns look so; a casing does not, since the wall beside it is near the plane.
    """
    wide = round(_STRIP / BIN)
    ends = []
    for end, step in ((first, -1), (last, 1)):
        kept = end
        for n in range(1, wide + 1):
            at = end + step * n - (step > 0)
            beyond = at + step * np.arange(1, 4)
            if not 0 <= at < len(profile.depth) or not abs(profile.depth[at]) < _STRIP_RELIEF:
                break
            if profile.open_storeys[at] > 0.35 * profile.storeys[at]:
                break
            beyond = beyond[(beyond >= 0) & (beyond < len(profile.depth))]
            if (~profile.is_solid[beyond] | (np.abs(profile.depth[beyond]) > 2.0 * _STRIP_RELIEF)).all():
                kept = end + step * n
        ends.append(kept)
    return ends[0], ends[1]


def _on_line(
    points: Float[np.ndarray, "N 3"], plane: Upright, low: float, high: float, line: tuple[float, float]
) -> Bool[np.ndarray, "N"]:
    local = plane.local(points)
    inside = (local[:, 0] > low + BIN) & (local[:, 0] < high - BIN)
    return np.flatnonzero(inside & (np.abs(local[:, 2] - line[0] * local[:, 0] - line[1]) < 0.035))


def _settled_leaf(
    start: Float[np.ndarray, "K 3"],
    points: Float[np.ndarray, "N 3"],
    rays: Rays,
    origin: Float[np.ndarray, "3"],
    ground: float,
) -> Leaf | None:
    """The face these points lie on, its plane fitted and its edges sought anew on that plane."""
    middle = np.median(start, axis=0)
    members = start
    plane = fit_upright(members, origin)
    for _ in range(3):
        local = plane.local(members)
        scatter = max(1.4826 * float(np.median(np.abs(local[:, 2]))), 0.004)
        plane = fit_upright(members[np.abs(local[:, 2]) < 2.5 * scatter], origin)
    profile = take_profile(plane, points, rays, ground + _BAND[0], ground + _BAND[1])
    if not len(profile.depth):
        return None
    stretches = straight_stretches(profile)
    column = int(np.clip((plane.local(middle[None])[0, 0] - profile.low) / BIN, 0, len(profile.depth) - 1))
    index = next(i for i, stretch in enumerate(stretches) if stretch.first <= column < stretch.last)
    if np.isnan(stretches[index].slope):
        return None
    first, last = _grown(profile, stretches, index, np.abs(profile.depth), _RELIEF)
    first, last = _with_strips(profile, stretches, first, last)
    if not _LEAST_SEEN <= (last - first) * BIN <= WIDTHS[1] + 0.1:
        return None
    local = plane.local(points)
    low = _edge(profile, first, -1, local, ground)
    high = _edge(profile, last, 1, local, ground)
    inside = (local[:, 0] > low.at + 0.02) & (local[:, 0] < high.at - 0.02)
    inside &= (local[:, 1] > ground + 0.05) & (local[:, 1] < ground + 2.3)
    on = inside & (np.abs(local[:, 2]) < 0.035)
    if on.sum() < 40:
        return None
    bottom, bottom_is_seen, top, top_is_seen = _rows(plane, low.at, high.at, rays, ground)
    members = points[on & (local[:, 1] < ground + top - 0.03)]
    if len(members) < 40:
        return None
    plane = _refitted(plane, members, origin)
    rms = float(np.std(members @ plane.normal - plane.offset))
    spread = float(np.std(members @ plane.along))
    sigma = rms / max(spread, 1e-3) / np.sqrt(len(members))
    return Leaf(plane, low, high, bottom, bottom_is_seen, top, top_is_seen, rms, sigma, profile, members)


def _refitted(plane: Upright, members: Float[np.ndarray, "K 3"], origin: Float[np.ndarray, "3"]) -> Upright:
    """The plane that most of the members lie on; what stands out (handle, seals) pulls at it no more than noise."""
    for _ in range(4):
        off = members @ plane.normal - plane.offset
        scatter = max(1.4826 * float(np.median(np.abs(off - np.median(off)))), 0.004)
        near = np.abs(off - np.median(off)) < 2.5 * scatter
        plane = fit_upright(members[near], origin)
    return plane


def _edge(profile: Profile, end: int, side: int, local: Float[np.ndarray, "N 3"], ground: float) -> Edge:
    """The edge at column ``end``, with what is beside it; ``side`` is where it looks to, -1 or 1."""
    n_beside = round(_BESIDE / BIN)
    beside = np.arange(end, end + n_beside) if side > 0 else np.arange(end - n_beside, end)[::-1]
    beside = beside[(beside >= 0) & (beside < len(profile.depth))]
    at = profile.low + end * BIN
    if not len(beside):
        return Edge(at, np.nan, 0.0, False)
    solid = profile.is_solid[beside]
    seen = profile.storeys[beside] + profile.open_storeys[beside]
    open_share = float(np.sum(profile.open_storeys[beside]) / max(np.sum(seen), 1))
    jump = float("nan")
    if solid[1:].any():
        steps = profile.depth[beside[1:]][solid[1:]]
        jump = float(np.median(steps))
    band = (local[:, 1] > ground + _BAND[0]) & (local[:, 1] < ground + _BAND[1])
    near = local[band & (np.abs(local[:, 0] - at) < _SHARP)]
    wall = _wall_before(profile, end, side)
    if wall is not None:
        at, jump, seen = profile.low + wall * BIN, float(profile.depth[wall - (side < 0)]), np.array([_SURE_STOREYS])
    elif solid[1:].any() and np.ptp(profile.depth[beside[1:]][solid[1:]]) < 0.02 and abs(jump) > 0.005:
        at = _step_at(at, side, jump, near)
    elif not solid[:2].any():
        at = _end_at(at, side, near)
    return Edge(at, jump, open_share, bool(seen.sum() >= _SURE_STOREYS))


def _wall_before(profile: Profile, end: int, side: int) -> int | None:
    """Border of the column where a nearer wall begins that hides the face's edge; None when none does."""
    for n in range(round(_HIDDEN / BIN)):
        at = end + n if side > 0 else end - 1 - n
        if not 0 <= at < len(profile.depth) or profile.open_storeys[at] > 2:
            return None
        if profile.is_solid[at]:
            return (at if side > 0 else at + 1) if n > 0 and profile.depth[at] > 0.02 else None
    return None


def _step_at(at: float, side: int, jump: float, local: Float[np.ndarray, "N 3"]) -> float:
    """Where points change from lying on the face to lying ``jump`` out of it."""
    place, off = (local[:, 0] - at) * side, local[:, 2]
    mine = np.abs(off) < abs(jump) + 0.04
    if mine.sum() < 10:
        return at
    place, off = place[mine], off[mine]
    # How much rather the point lies on the face than on what is beside it.
    vote = np.clip(((off - jump) ** 2 - off**2) / (2.0 * 0.01**2), -3.0, 3.0)
    order = np.argsort(place, kind="stable")
    place, total = place[order], np.cumsum(vote[order])
    best = int(np.argmax(total))
    inner = float(place[best])
    outer = float(place[best + 1]) if best + 1 < len(place) else inner
    return at + side * 0.5 * (inner + outer)


def _end_at(at: float, side: int, local: Float[np.ndarray, "N 3"]) -> float:
    """Where the points on the face end, a stray one not counted."""
    place = (local[np.abs(local[:, 2]) < 0.025, 0] - at) * side
    place = place[np.abs(place) < 0.5 * _SHARP]
    if len(place) < 10:
        return at
    return at + side * float(np.percentile(place, 98.0))


def _rows(plane: Upright, low: float, high: float, rays: Rays, ground: float) -> tuple[float, bool, float, bool]:
    """Lowest and highest height to which the face goes without a break, and whether anything else lies beyond each."""
    at, end, heading = rays.crossing(plane)
    # Rays that stopped far before the face tell nothing of it.
    mine = heading & (at[:, 0] > low + 0.03) & (at[:, 0] < high - 0.03) & (end < _BEFORE)
    height, off = at[mine, 1] - ground, end[mine]
    n_rows = round(2.6 / _ROW)
    row = np.floor(height / _ROW).astype(int)
    valid = (row >= 0) & (row < n_rows)
    row, off = row[valid], off[valid]
    on = np.abs(off) < 0.035
    total = np.bincount(row, minlength=n_rows)
    count = np.bincount(row, on, n_rows)
    share = count / np.maximum(total, 1)
    # A lintel that stands out by little is told by the mean of its row.
    mean = np.bincount(row[on], off[on], n_rows) / np.maximum(count, 1)
    aside = np.abs(mean) > np.maximum(0.008, 0.03 / np.sqrt(np.maximum(count, 1)))
    full = np.flatnonzero((total >= 2) & (share > 0.6) & ~aside)
    if not len(full):
        return 0.0, False, 0.0, False
    middle = int(full[np.argmin(np.abs(full - round(1.2 / _ROW)))])
    is_full = np.isin(np.arange(n_rows), full)
    is_broken = (total >= 3) & ((share < 0.4) | aside)
    # A bar or rail across a face is no end of it.
    is_waist = (np.arange(n_rows) * _ROW > _WAIST[0]) & (np.arange(n_rows) * _ROW < _WAIST[1])
    is_broken &= ~is_waist
    n_up, top_is_seen = _run(is_full[middle:], is_broken[middle:])
    n_down, bottom_is_seen = _run(is_full[middle::-1], is_broken[middle::-1])
    return float((middle - n_down) * _ROW), bottom_is_seen, float((middle + n_up + 1) * _ROW), top_is_seen


def _run(is_full: Bool[np.ndarray, "R"], is_broken: Bool[np.ndarray, "R"]) -> tuple[int, bool]:
    """How many rows the face goes on, and whether something else follows."""
    n_broken = np.cumsum(is_broken)
    last = 0
    for row in np.flatnonzero(is_full):
        if n_broken[row] - n_broken[last] >= 2:
            break
        last = int(row)
    return last, bool(n_broken[-1] - n_broken[last] >= 2)
