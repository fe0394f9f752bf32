"""Openings to leave a vehicle by: beside a seat, between what stands before and behind it, over a sill."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.detect.shared.confidence import rising
from perception.detect.shared.detection import Detection
from perception.detect.vehicle.level import is_inside
from perception.detect.vehicle.opening_side import POST, crossings, edges_of, openness, side_of, top_of
from perception.detect.vehicle.seat import Seat, find_seats, ground_of
from perception.view import View

_REPORTED = 0.05
_LEAST_SEAT = 0.25
# A sill with an opening over it speaks for the vehicle as well: what is doubtful about a seat is mostly its back.
_SEAT_TRUST = 0.6
_HINT_TRUST = 0.7
_LEAST_WIDTH = 0.35
_MOST_WIDTH = 1.6
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
