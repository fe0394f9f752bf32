"""Openings to leave a vehicle by: beside a seat, between what stands before and behind it, over a sill."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from perception.detect.confidence import rising
from perception.detect.detection import Detection
from perception.detect.level import is_inside
from perception.detect.seat import Seat, find_seats, ground_of
from perception.view import View

_REPORTED = 0.05
_LEAST_SEAT = 0.25
# A sill with an opening over it speaks for the vehicle as well: what is doubtful about a seat is mostly its back.
_SEAT_TRUST = 0.6
_HINT_TRUST = 0.7
_BESIDE = 0.55  # how far beside the cushion's edge the vehicle may end
_AHEAD = 1.2
_BEHIND = 0.8
_CELL = 0.05
_SIDE_BIN = 0.02
_POST = 0.1  # how far from the vehicle's side its roof's edge may be
_PANEL = 0.045  # and its panels and posts; what stands further in is furniture
_OVER_WHEELS = 0.24
_BEFORE_WHEELS = 0.7
_LEAST_WIDTH = 0.35
_MOST_WIDTH = 1.6
_HEADROOM = (0.9, 1.9)
_WAIST = (0.08, 0.75)
_TALL = 0.1
_SHOWN = 2000


@dataclass(frozen=True)
class _Side:
    """A side of a vehicle in a seat's frame: where it is, the opening in it, and how surely it is one."""

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
    """Openings of vehicles, best first.

    The frame of a hit: origin in the middle of the sill, x outwards, z up.  Sizes: ``width`` between what stands before
    and behind it, ``height`` over the sill to the roof's edge, or as far up as it was seen to be open, and ``sill``,
    height of the vehicle's floor over the ground [m].

    Args:
        view: the scan, made ready.
        hint: (3,) a point near the sill or in the opening [m].
    """
    starts, ends = view.cloud.rays
    sides: list[_Side] = []
    seats = find_seats(view)
    for seat in seats:
        if seat.confidence < _LEAST_SEAT or np.isnan(seat.floor):
            continue
        local, from_seat, to_seat = (seat.local(one) for one in (view.near.points, starts, ends))
        for side in (1.0, -1.0):
            if any(_has_neighbour(seat, side, other) for other in seats if other.confidence >= _LEAST_SEAT):
                continue
            found = _beside(seat, side, local, from_seat, to_seat, view)
            if found is not None and found.confidence >= _REPORTED:
                sides.append(found)
    sides.sort(key=lambda one: -one.confidence)
    out: list[Detection] = []
    for one in sides:
        hit = _detection(one, hint is not None)
        place = hit.pose_world_object[:3, 3]
        if hint is not None and np.linalg.norm((place - hint)[:2]) > 0.5 * hit.sizes["width"] + 0.3:
            continue
        if all(np.linalg.norm(place - other.pose_world_object[:3, 3]) > 0.4 for other in out):
            out.append(hit)
    return out


def _has_neighbour(seat: Seat, side: float, other: Seat) -> bool:
    """Whether the other seat stands between this one and that side of the vehicle."""
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
    """The opening on one side of a seat; None when the vehicle's side was not found there."""
    mirror = np.array([1.0, side, 1.0])
    local, starts, ends = local * mirror, starts * mirror, ends * mirror
    floor = seat.floor - seat.pose[2, 3]
    at = _side_of(seat, local, floor)
    if at is None:
        return None
    rear, front, ends_seen = _ends(local, at, floor, seat.depth)
    if not _LEAST_WIDTH < front - rear < _MOST_WIDTH:
        return None
    top, roof_is_seen = _top(local, at, rear, front, floor)
    open_share, seen_share, highest = _openness(starts, ends, at, rear, front, floor, top)
    if not roof_is_seen:
        top = highest
    sill = seat.floor - ground_of(view)
    confidence = (
        seat.confidence**_SEAT_TRUST
        * (0.4, 0.7, 1.0)[ends_seen]
        * rising(open_share, 0.5, 0.85)
        * rising(seen_share, 0.1, 0.3)
        * rising(front - rear, _LEAST_WIDTH, 0.5)
        * rising(sill, 0.05, 0.15)
    )
    edge = is_inside(
        local, np.array([rear - 0.15, at - _POST, floor - 0.1]), np.array([front + 0.15, at + _POST, top + 0.15])
    )
    world = seat.pose[:3, 3] + (local[edge] * mirror) @ seat.pose[:3, :3].T
    return _Side(seat, side, at, rear, front, top, floor, sill, open_share, float(confidence), world)


def _side_of(seat: Seat, local: Float[np.ndarray, "N 3"], floor: float) -> float | None:
    """How far beside the seat's middle the vehicle ends: the outermost distance at which much of it stands [m]."""
    near, far = 0.5 * seat.width - 0.06, 0.5 * seat.width + _BESIDE
    pan = is_inside(local, np.array([0.0, near, floor - 0.03]), np.array([_BEFORE_WHEELS, far, floor + 0.03]))
    body = is_inside(local, np.array([-0.5, near, floor + _OVER_WHEELS]), np.array([_BEFORE_WHEELS, far, floor + 1.0]))
    found = [_outermost(local[pan], near, far, 3.0), _outermost(local[body], near, far, 6.0)]
    return max((one for one in found if one is not None), default=None)


def _outermost(mine: Float[np.ndarray, "K 3"], near: float, far: float, least: float) -> float | None:
    """The outermost distance at which points fill several places."""
    if len(mine) < 10:
        return None
    place = np.floor(mine[:, [0, 2]] / _CELL).astype(int)
    layer = np.floor((mine[:, 1] - near) / _SIDE_BIN).astype(int)
    cells = np.unique(np.column_stack([layer, place]), axis=0)[:, 0]
    votes = np.convolve(np.bincount(cells, minlength=int((far - near) / _SIDE_BIN) + 2), [1.0, 1.0, 1.0], mode="same")
    strong = np.flatnonzero(votes >= max(0.3 * votes.max(), least))
    if not len(strong):
        return None
    outer = near + (strong[-1] + 1) * _SIDE_BIN
    return float(np.percentile(mine[(mine[:, 1] > outer - 0.08) & (mine[:, 1] < outer + 0.02), 1], 95.0))


def _ends(local: Float[np.ndarray, "N 3"], at: float, floor: float, depth: float) -> tuple[float, float, int]:
    """Where what stands at the vehicle's side ends behind the seat and begins before it [m], and how many were seen."""
    waist = is_inside(
        local, np.array([-_BEHIND, at - _PANEL, floor + _WAIST[0]]), np.array([_AHEAD, at + _PANEL, floor + _WAIST[1]])
    )
    along = local[waist, 0]
    cell = np.floor((along + _BEHIND) / _SIDE_BIN).astype(int)
    height = local[waist, 2] - floor
    n_cells = round((_BEHIND + _AHEAD) / _SIDE_BIN)
    valid = (cell >= 0) & (cell < n_cells)
    low, high = np.full(n_cells, np.inf), np.full(n_cells, -np.inf)
    np.minimum.at(low, cell[valid], height[valid])
    np.maximum.at(high, cell[valid], height[valid])
    # What is tall about a place is a post or a panel; less is a stray return or a seat's base.
    tall = ndimage.maximum_filter1d(high, 5, mode="nearest") - ndimage.minimum_filter1d(low, 5, mode="nearest")
    stands = np.flatnonzero((tall > _TALL) & (high >= low))
    middle = round(_BEHIND / _SIDE_BIN)
    behind, before = stands[stands < middle], stands[stands >= middle]
    rear = -0.5 * depth - 0.1 if not len(behind) else -_BEHIND + (behind.max() + 1) * _SIDE_BIN
    front = 0.5 * depth + 0.3 if not len(before) else -_BEHIND + before.min() * _SIDE_BIN
    return float(rear), float(front), int(len(behind) > 0) + int(len(before) > 0)


def _top(local: Float[np.ndarray, "N 3"], at: float, rear: float, front: float, floor: float) -> tuple[float, bool]:
    """Where the roof begins over the sill, and whether one was seen [m]."""
    over = local[
        is_inside(
            local,
            np.array([rear + 0.05, at - 2.0 * _POST, floor + _HEADROOM[0]]),
            np.array([0.5 * (rear + front), at + _POST, floor + _HEADROOM[1]]),
        ),
        2,
    ]
    if len(over) < 8:
        return floor + _HEADROOM[0], False
    return float(np.percentile(over, 10.0)), True


def _openness(
    starts: Float[np.ndarray, "R 3"],
    ends: Float[np.ndarray, "R 3"],
    at: float,
    rear: float,
    front: float,
    floor: float,
    top: float,
) -> tuple[float, float, float]:
    """Share of the opening's cells seen in which rays went through, share that was seen, and how high they went."""
    low, high = np.array([rear + 0.04, floor + 0.06]), np.array([front - 0.04, max(top - 0.06, floor + 0.6)])
    shape = np.maximum(np.ceil((high - low) / _CELL).astype(int), 1)
    crosses = (starts[:, 1] - at) * (ends[:, 1] - at) < 0.0
    share = (at - starts[crosses, 1]) / (ends[crosses, 1] - starts[crosses, 1])
    through = starts[crosses] + share[:, None] * (ends[crosses] - starts[crosses])
    opened = _filled(through[:, [0, 2]], low, shape)
    met = _filled(ends[np.abs(ends[:, 1] - at) < 0.05][:, [0, 2]], low, shape)
    seen = opened | met
    rows = np.flatnonzero(opened.mean(axis=0) > 0.2)
    highest = low[1] + (rows.max() + 1) * _CELL if len(rows) else floor + 0.6
    return float(opened.sum() / max(seen.sum(), 1)), float(seen.mean()), float(highest)


def _filled(places: Float[np.ndarray, "K 2"], low: Float[np.ndarray, "2"], shape: np.ndarray) -> np.ndarray:
    grid = np.zeros(tuple(shape), dtype=bool)
    cell = np.floor((places - low) / _CELL).astype(int)
    cell = cell[((cell >= 0) & (cell < shape)).all(axis=1)]
    grid[cell[:, 0], cell[:, 1]] = True
    return grid


def _detection(one: _Side, is_hinted: bool) -> Detection:
    seat = one.seat
    confidence = one.confidence**_HINT_TRUST if is_hinted else one.confidence
    pose = np.eye(4)
    outwards = seat.pose[:3, 1] * one.side
    pose[:3, :3] = np.column_stack([outwards, np.cross([0.0, 0.0, 1.0], outwards), [0.0, 0.0, 1.0]])
    pose[:3, 3] = seat.pose[:3, 3] + seat.pose[:3, :3] @ [0.5 * (one.rear + one.front), one.side * one.at, one.floor]
    sizes = {"width": one.front - one.rear, "height": float(one.top - one.floor), "sill": one.sill}
    step = max(1, len(one.points) // _SHOWN)
    return Detection("opening", pose, sizes, confidence, {"open_seen_share": one.open_share}, one.points[::step])
