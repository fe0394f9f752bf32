"""Openings in a vehicle's side for getting out: beside a seat, over a sill, between the posts or panels at its ends.

The vehicle's side is given in the seat's frame, mirrored so that the side is at positive y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from perception.detect.shared.arithmetic import rising, sum_about
from perception.detect.shared.detection import Detection
from perception.detect.vehicle.level import filled_cells, is_inside
from perception.detect.vehicle.seat import Seat, find_seats, ground_of
from perception.view import View

_REPORTED = 0.05
_LEAST_SEAT = 0.25
# A sill below an opening is evidence for a vehicle too, and the doubt about a seat is mostly about its back.
_SEAT_TRUST = 0.6
_ROOF_UNSEEN = 0.45  # the height is then a guess, and a hit without a hint is not sure
_HINT_TRUST = 0.7
_LEAST_WIDTH = 0.35
_MOST_WIDTH = 1.6
_SHOWN = 2000
# Largest distance of the roof's edge from the vehicle's side [m].
POST = 0.1
HEADROOM = (0.9, 1.9)
_BESIDE = 0.55  # largest distance of the vehicle's side from the cushion's edge [m]
_GOES_ON = 0.1
_AHEAD = 1.2
_BEHIND = 0.8
_CELL = 0.05
_SIDE_BIN = 0.02
_PANEL = 0.045  # largest distance of panels and posts from the side; objects further in are furniture [m]
_THROUGH = 0.065
_OVER_WHEELS = 0.24
_BEFORE_WHEELS = 0.7
_WAIST = (0.08, 0.75)
_TALL = 0.1
_MOSTLY = 0.5
_NEXT, _SOME = 8, 0.2  # cells beside an edge, and the share of them that rays must pass


@dataclass(frozen=True)
class _Side:
    """Side of a vehicle in a seat's frame: its y ``at``, the bounds of its opening [m] and the confidence."""

    seat: Seat
    side: float
    at: float
    rear: float
    front: float
    top: float
    floor: float
    sill: float
    open_share: float
    confidence: float
    points: Float[np.ndarray, "K 3"]


def detect_opening(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Find openings of vehicles, best first.

    The frame of a hit: origin in the middle of the sill, x outwards, z up.  Sizes: ``width`` between the posts or
    panels before and behind it, ``height`` from the sill to the roof's edge or, if unseen, to the highest open cells,
    and ``sill``, height of the vehicle's floor over the ground [m].

    Args:
        hint: (3,) a point near the sill or in the opening [m].
    """
    starts, ends = view.cloud.rays
    sides: list[_Side] = []
    seats = find_seats(view)
    for seat in seats:
        if seat.confidence < _LEAST_SEAT or np.isnan(seat.floor):
            continue
        local, from_seat, to_seat = (seat.local(places) for places in (view.near.points, starts, ends))
        for side in (1.0, -1.0):
            if any(_has_neighbour(seat, side, other) for other in seats if other.confidence >= _LEAST_SEAT):
                continue
            opening = _beside(seat, side, local, from_seat, to_seat, view)
            if opening is not None and opening.confidence >= _REPORTED:
                sides.append(opening)
    sides.sort(key=lambda opening: -opening.confidence)
    out: list[Detection] = []
    for opening in sides:
        hit = _detection(opening, hint is not None)
        place = hit.pose_world_object[:3, 3]
        if hint is not None and np.linalg.norm((place - hint)[:2]) > 0.5 * hit.sizes["width"] + 0.3:
            continue
        if all(np.linalg.norm(place - other.pose_world_object[:3, 3]) > 0.4 for other in out):
            out.append(hit)
    return out


def _has_neighbour(seat: Seat, side: float, other: Seat) -> bool:
    """Return whether the other seat is between this seat and that side of the vehicle."""
    place = seat.local(other.pose[None, :3, 3])[0]
    return bool(0.3 < place[1] * side < 1.3 and abs(place[0]) < 0.4 and abs(place[2]) < 0.2)


def _beside(
    seat: Seat,
    side: float,
    local: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "R 3"],
    ends: Float[np.ndarray, "R 3"],
    view: View,
) -> _Side | None:
    """Return the opening on one side of a seat; None when no side was found or the width does not fit."""
    mirror = np.array([1.0, side, 1.0])
    local, starts, ends = local * mirror, starts * mirror, ends * mirror
    floor = seat.floor - seat.pose[2, 3]
    at = side_of(seat.width, local, floor)
    if at is None:
        return None
    through = crossings(starts, ends, at)
    rear, front, ends_seen = edges_of(local, through, at, floor, seat.depth)
    if not _LEAST_WIDTH < front - rear < _MOST_WIDTH:
        return None
    top, roof_is_seen = top_of(local, at, rear, front, floor)
    open_share, seen_share, highest = openness(ends, through, at, (rear, front), floor, top)
    if not roof_is_seen:
        top = highest
    sill = seat.floor - ground_of(view)
    confidence = (
        seat.confidence**_SEAT_TRUST
        * (0.4, 0.7, 1.0)[ends_seen]
        * (1.0 if roof_is_seen else _ROOF_UNSEEN)
        * rising(open_share, 0.5, 0.85)
        * rising(seen_share, 0.1, 0.3)
        * rising(front - rear, _LEAST_WIDTH, 0.5)
        * rising(sill, 0.05, 0.15)
    )
    edge = is_inside(
        local, np.array([rear - 0.15, at - POST, floor - 0.1]), np.array([front + 0.15, at + POST, top + 0.15])
    )
    world = seat.pose[:3, 3] + (local[edge] * mirror) @ seat.pose[:3, :3].T
    return _Side(seat, side, at, rear, front, top, floor, sill, open_share, float(confidence), world)


def _detection(opening: _Side, is_hinted: bool) -> Detection:
    seat = opening.seat
    confidence = opening.confidence**_HINT_TRUST if is_hinted else opening.confidence
    pose = np.eye(4)
    outwards = seat.pose[:3, 1] * opening.side
    pose[:3, :3] = np.column_stack([outwards, np.cross([0.0, 0.0, 1.0], outwards), [0.0, 0.0, 1.0]])
    pose[:3, 3] = seat.pose[:3, 3] + seat.pose[:3, :3] @ [
        0.5 * (opening.rear + opening.front),
        opening.side * opening.at,
        opening.floor,
    ]
    sizes = {"width": opening.front - opening.rear, "height": float(opening.top - opening.floor), "sill": opening.sill}
    step = max(1, len(opening.points) // _SHOWN)
    return Detection(
        "opening", pose, sizes, confidence, {"open_seen_share": opening.open_share}, opening.points[::step]
    )


def side_of(width: float, local: Float[np.ndarray, "N 3"], floor: float) -> float | None:
    """Return the distance of the vehicle's side from the seat's middle: the outermost with many points [m].

    None when no points are there, or when the floor extends beyond the largest possible distance.

    Args:
        width: of the seat's cushion [m].
    """
    near, far = 0.5 * width - 0.06, 0.5 * width + _BESIDE
    beyond = far + _GOES_ON
    pan = is_inside(local, np.array([0.0, near, floor - 0.03]), np.array([_BEFORE_WHEELS, beyond, floor + 0.03]))
    body = is_inside(
        local, np.array([-0.5, near, floor + _OVER_WHEELS]), np.array([_BEFORE_WHEELS, beyond, floor + 1.0])
    )
    sill, panels = _outermost(local[pan], near, beyond, 3.0), _outermost(local[body], near, beyond, 6.0)
    if sill is not None and sill > far:
        return None
    return max((edge for edge in (sill, panels) if edge is not None and edge <= far), default=None)


def _outermost(mine: Float[np.ndarray, "K 3"], near: float, far: float, least: float) -> float | None:
    """Return the outermost distance at which points fill several cells in x and z [m]; None: too few."""
    if len(mine) < 10:
        return None
    place = np.floor(mine[:, [0, 2]] / _CELL).astype(int)
    layer = np.floor((mine[:, 1] - near) / _SIDE_BIN).astype(int)
    cells = np.unique(np.column_stack([layer, place]), axis=0)[:, 0]
    votes = sum_about(np.bincount(cells, minlength=int((far - near) / _SIDE_BIN) + 2), (1.0, 1.0, 1.0))
    strong = np.flatnonzero(votes >= max(0.3 * votes.max(), least))
    if not len(strong):
        return None
    outer = near + (strong[-1] + 1) * _SIDE_BIN
    return float(np.percentile(mine[(mine[:, 1] > outer - 0.08) & (mine[:, 1] < outer + 0.02), 1], 95.0))


def crossings(starts: Float[np.ndarray, "R 3"], ends: Float[np.ndarray, "R 3"], at: float) -> Float[np.ndarray, "K 2"]:
    """Return x and z where rays cross the vehicle's side and end clear of it [m]."""
    crosses = ((starts[:, 1] - at) * (ends[:, 1] - at) < 0.0) & (np.abs(ends[:, 1] - at) > _THROUGH)
    share = (at - starts[crosses, 1]) / (ends[crosses, 1] - starts[crosses, 1])
    return np.asarray((starts[crosses] + share[:, None] * (ends[crosses] - starts[crosses]))[:, [0, 2]])


def edges_of(
    local: Float[np.ndarray, "N 3"], through: Float[np.ndarray, "K 2"], at: float, floor: float, depth: float
) -> tuple[float, float, int]:
    """Return x of the opening's rear and front edge [m], and how many of the two were seen.

    Args:
        through: (K, 2) x and z where rays crossed the side [m].
        at: y of the side [m].
        depth: of the seat's cushion [m].
    """
    low, high = np.array([-_BEHIND, floor + _WAIST[0]]), np.array([_AHEAD, floor + _WAIST[1]])
    cell = np.array([_SIDE_BIN, _CELL])
    shape = np.round((high - low) / cell).astype(int)
    beside = local[np.abs(local[:, 1] - at) < _PANEL][:, [0, 2]]
    met, passed = (filled_cells(places, low, shape, cell) for places in (beside, through))
    height = np.where(_inside(beside, low, high), beside[:, 1], np.nan)
    column = np.floor((beside[:, 0] - low[0]) / _SIDE_BIN).astype(int).clip(0, shape[0] - 1)
    lowest, highest = np.full(shape[0], np.inf), np.full(shape[0], -np.inf)
    np.fmin.at(lowest, column, height)
    np.fmax.at(highest, column, height)
    # A tall column is a post or a panel, a low one a stray return or a seat's base.  A column is open, not shut, where
    # rays pass at as many heights as hold points and at half of all heights.
    tall = ndimage.maximum_filter1d(highest, 5, mode="nearest") - ndimage.minimum_filter1d(lowest, 5, mode="nearest")
    n_met = ndimage.maximum_filter1d(met, 5, axis=0, mode="nearest").sum(axis=1)
    is_shut = passed.sum(axis=1) < np.maximum(n_met, _MOSTLY * shape[1])
    stands = np.flatnonzero((tall > _TALL) & is_shut & met.any(axis=1))
    middle = round(_BEHIND / _SIDE_BIN)
    behind, before = stands[stands < middle], stands[stands >= middle]
    # A post or panel is the opening's edge only if rays passed the side next to it.
    is_open = np.asarray(passed.any(axis=1))
    rear_seen = len(behind) > 0 and is_open[behind.max() + 1 :][:_NEXT].mean() > _SOME
    front_seen = len(before) > 0 and is_open[: before.min()][-_NEXT:].mean() > _SOME
    rear = -_BEHIND + (behind.max() + 1) * _SIDE_BIN if rear_seen else -0.5 * depth - 0.1
    front = -_BEHIND + before.min() * _SIDE_BIN if front_seen else 0.5 * depth + 0.3
    return float(rear), float(front), int(rear_seen) + int(front_seen)


def top_of(local: Float[np.ndarray, "N 3"], at: float, rear: float, front: float, floor: float) -> tuple[float, bool]:
    """Return z of the roof's lower edge [m], and whether a roof was seen."""
    over = local[
        is_inside(
            local,
            np.array([rear + 0.05, at - 2.0 * POST, floor + HEADROOM[0]]),
            np.array([0.5 * (rear + front), at + POST, floor + HEADROOM[1]]),
        ),
        2,
    ]
    if len(over) < 8:
        return floor + HEADROOM[0], False
    return float(np.percentile(over, 10.0)), True


def openness(
    ends: Float[np.ndarray, "R 3"],
    through: Float[np.ndarray, "K 2"],
    at: float,
    edges: tuple[float, float],
    floor: float,
    top: float,
) -> tuple[float, float, float]:
    """Return the share of seen cells that rays crossed, the share of cells seen, and z of the highest open row [m].

    Args:
        ends: (R, 3) of all rays [m].
        through: (K, 2) x and z where rays crossed the side [m].
        at: y of the side [m].
        edges: x of the opening's rear and front edge [m].
        floor, top: z of the sill and of the roof's edge [m].
    """
    low, high = np.array([edges[0] + 0.04, floor + 0.06]), np.array([edges[1] - 0.04, max(top - 0.06, floor + 0.6)])
    cell = np.array([_CELL, _CELL])
    shape = np.maximum(np.ceil((high - low) / cell).astype(int), 1)
    opened = filled_cells(through, low, shape, cell)
    met = filled_cells(ends[np.abs(ends[:, 1] - at) < 0.05][:, [0, 2]], low, shape, cell)
    seen = opened | met
    rows = np.flatnonzero(opened.mean(axis=0) > 0.2)
    highest = low[1] + (rows.max() + 1) * _CELL if len(rows) else floor + 0.6
    return float(opened.sum() / max(seen.sum(), 1)), float(seen.mean()), float(highest)


def _inside(
    places: Float[np.ndarray, "K 2"], low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]
) -> Bool[np.ndarray, "K"]:
    return np.asarray(((places > low) & (places < high)).all(axis=1))
