"""Candidate door leaves: flat upright rectangles with edges, found in the profile along their plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.door.edges import Edge, face_rows, row_error, side_edge, unevenness
from perception.detect.door.profile import BAND, BIN, Profile, Rays, Stretch, straight_stretches, take_profile
from perception.detect.door.upright import Upright, fit_upright

WIDTHS = (0.6, 1.3)
_LEAST_SEEN = 0.45
_FLAT = 0.007
_STEEPEST = 0.35
_RELIEF = 0.006
_NOISY = 1.0  # standard errors of its columns by which a stretch of a leaf may be off its plane
_STRIP = 0.08
_STRIP_RELIEF = 0.015
_OPEN_BEYOND = 2  # columns between a strip of the leaf and its frame; a strip of the frame is fixed to it


@dataclass(frozen=True)
class Leaf:
    """A flat upright face with its edges.

    Attributes:
        plane: of the face, normal towards the sensor.
        low, high: its side edges along the plane.
        bottom: height of its lowest seen row above the floor [m].
        bottom_is_seen: whether it was seen to end there.
        top: height of its upper end above the floor [m].
        top_is_seen: whether it was seen to end there.
        rms: scatter of its points about the plane [m].
        sigma: uncertainty of the plane's yaw [rad].
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
        """Distance between the side edges [m]."""
        return self.high.at - self.low.at


def find_leaves(
    points: Float[np.ndarray, "N 3"],
    rays: Rays,
    origin: Float[np.ndarray, "3"],
    ground: float,
    uprights: list[Upright],
) -> list[Leaf]:
    """Return flat faces of a leaf's width with their edges, without duplicates, in the order of the planes.

    Args:
        uprights: planes whose profiles are searched.
    """
    leaves: list[Leaf] = []
    for plane in uprights:
        profile = take_profile(plane, points, rays, ground + BAND[0], ground + BAND[1])
        for low, high, line in _flat_runs(profile, straight_stretches(profile)):
            middle = plane.place(0.5 * (low + high), 0.0, line[0] * 0.5 * (low + high) + line[1])
            if any(_holds(leaf, middle) for leaf in leaves):
                continue
            start = _on_line(points, plane, low, high, line)
            if len(start) < 30:
                continue
            leaf = _settle_leaf(points[start], points, rays, origin, ground)
            if leaf is not None and not any(_same(leaf, other) for other in leaves):
                leaves.append(leaf)
    return leaves


def _holds(leaf: Leaf, place: Float[np.ndarray, "3"]) -> bool:
    local = leaf.plane.local(place[None])[0]
    return bool(abs(local[2]) < 0.01 and leaf.low.at < local[0] < leaf.high.at)


def _same(leaf: Leaf, other: Leaf) -> bool:
    ends = [leaf.plane.place(edge.at) for edge in (leaf.low, leaf.high)]
    others = [other.plane.place(edge.at) for edge in (other.low, other.high)]
    return all(np.linalg.norm(a - b) < 0.05 for a, b in zip(ends, others, strict=True))


def _flat_runs(profile: Profile, stretches: list[Stretch]) -> list[tuple[float, float, tuple[float, float]]]:
    """Return runs of stretches on one line that together are as wide as a leaf: (low, high, line) [m]."""
    centres = profile.centres
    out = []
    for seed in sorted(stretches, key=lambda s: s.first - s.last):
        if np.isnan(seed.slope) or abs(seed.slope) > _STEEPEST or (seed.last - seed.first) * BIN < 0.2:
            continue
        off = np.abs(profile.depth - seed.slope * centres - seed.intercept)
        first, last = _grow(profile, stretches, stretches.index(seed), off, _FLAT)
        if _LEAST_SEEN <= (last - first) * BIN <= WIDTHS[1] + 0.1:
            low = profile.low + first * BIN
            out.append((low, low + (last - first) * BIN, (seed.slope, seed.intercept)))
    return out


def _grow(
    profile: Profile, stretches: list[Stretch], index: int, off: Float[np.ndarray, "B"], tolerance: float
) -> tuple[int, int]:
    """Return first and last column of the stretches on the seed's line; narrow ones off the line are skipped."""
    first, last = stretches[index].first, stretches[index].last
    for step in (-1, 1):
        at, skipped = index + step, 0
        while 0 <= at < len(stretches):
            mine = stretches[at]
            size = mine.last - mine.first
            most = np.hypot(tolerance, _NOISY * np.nanmedian(profile.sigma[mine.first : mine.last]))
            fits = not np.isnan(mine.slope) and np.sqrt(np.nanmean(off[mine.first : mine.last] ** 2)) < most
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
    """Return the columns grown by narrow strips at the edges that lie near the plane and beyond which no surface does.

    Such strips are seals, edge bars and mixed returns; a casing is none, since the wall beside it is near the plane.
    """
    wide = round(_STRIP / BIN)
    ends = []
    for end, step in ((first, -1), (last, 1)):
        kept = end
        for n in range(1, wide + 1):
            at = end + step * n - (step > 0)
            beyond = at + step * np.arange(1, _OPEN_BEYOND + 1)
            if not 0 <= at < len(profile.depth) or not abs(profile.depth[at]) < _STRIP_RELIEF:
                break
            is_open = profile.open_storeys > 0.35 * profile.storeys
            if is_open[at]:
                break
            beyond = beyond[(beyond >= 0) & (beyond < len(profile.depth))]
            is_off = ~profile.is_solid | is_open | (np.abs(profile.depth) > 2.0 * _STRIP_RELIEF)
            if is_off[beyond].all():
                kept = end + step * n
        ends.append(kept)
    return ends[0], ends[1]


def _on_line(
    points: Float[np.ndarray, "N 3"], plane: Upright, low: float, high: float, line: tuple[float, float]
) -> Bool[np.ndarray, "N"]:
    local = plane.local(points)
    inside = (local[:, 0] > low + BIN) & (local[:, 0] < high - BIN)
    return np.flatnonzero(inside & (np.abs(local[:, 2] - line[0] * local[:, 0] - line[1]) < 0.035))


def _settle_leaf(
    start: Float[np.ndarray, "K 3"],
    points: Float[np.ndarray, "N 3"],
    rays: Rays,
    origin: Float[np.ndarray, "3"],
    ground: float,
) -> Leaf | None:
    """Return the leaf through these points, with plane and edges refitted; None when it has no leaf's width."""
    middle = np.median(start, axis=0)
    members = start
    plane = fit_upright(members, origin)
    for _ in range(3):
        local = plane.local(members)
        scatter = max(1.4826 * float(np.median(np.abs(local[:, 2]))), 0.004)
        plane = fit_upright(members[np.abs(local[:, 2]) < 2.5 * scatter], origin)
    profile = take_profile(plane, points, rays, ground + BAND[0], ground + BAND[1])
    if not len(profile.depth):
        return None
    stretches = straight_stretches(profile)
    column = int(np.clip((plane.local(middle[None])[0, 0] - profile.low) / BIN, 0, len(profile.depth) - 1))
    index = next(i for i, stretch in enumerate(stretches) if stretch.first <= column < stretch.last)
    if np.isnan(stretches[index].slope):
        return None
    first, last = _grow(profile, stretches, index, np.abs(profile.depth), _RELIEF)
    first, last = _with_strips(profile, stretches, first, last)
    if not _LEAST_SEEN <= (last - first) * BIN <= WIDTHS[1] + 0.1:
        return None
    local = plane.local(points)
    uneven = unevenness(profile, first, last)
    low = side_edge(profile, first, -1, local, ground, uneven)
    high = side_edge(profile, last, 1, local, ground, uneven)
    inside = (local[:, 0] > low.at + 0.02) & (local[:, 0] < high.at - 0.02)
    inside &= (local[:, 1] > ground + 0.05) & (local[:, 1] < ground + 2.3)
    on = inside & (np.abs(local[:, 2]) < 0.035)
    if on.sum() < 40:
        return None
    error = row_error(profile, first, last)
    bottom, bottom_is_seen, top, top_is_seen = face_rows(plane, low.at, high.at, rays, ground, error)
    members = points[on & (local[:, 1] < ground + top - 0.03)]
    if len(members) < 40:
        return None
    plane = _refit(plane, members, origin)
    rms = float(np.std(members @ plane.normal - plane.offset))
    spread = float(np.std(members @ plane.along))
    sigma = rms / max(spread, 1e-3) / np.sqrt(len(members))
    return Leaf(plane, low, high, bottom, bottom_is_seen, top, top_is_seen, rms, sigma, profile, members)


def _refit(plane: Upright, members: Float[np.ndarray, "K 3"], origin: Float[np.ndarray, "3"]) -> Upright:
    """Return the plane fitted to the inliers among the members; handle and seals are outliers."""
    for _ in range(4):
        off = members @ plane.normal - plane.offset
        scatter = max(1.4826 * float(np.median(np.abs(off - np.median(off)))), 0.004)
        near = np.abs(off - np.median(off)) < 2.5 * scatter
        plane = fit_upright(members[near], origin)
    return plane
