"""Vehicle seats: a level cushion with a back behind it and the vehicle's floor in front."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from perception.detect.shared.arithmetic import rising
from perception.detect.shared.detection import Detection
from perception.detect.vehicle.cushion import USUAL_WIDTH, Cushion, as_cushion, square_up, surround_of
from perception.detect.vehicle.level import Patch, find_patches, is_inside, split_at_gap
from perception.detect.vehicle.surroundings import SEAT_HEIGHT, back_of, footwell_of
from perception.view import View

_REPORTED = 0.05
_OVER_GROUND = (0.35, 1.15)
_WIDTH = (0.36, 1.5)
_DEPTH = (0.3, 0.65)
# Score of an unseen back, for the seat that the robot sits on and for others.
_UNSEEN_SAT_ON, _UNSEEN = 0.7, 0.3
_HEAD, _HEAD_ABOUT = (0.5, 1.0), 0.35
_NOT_GROUND = 0.12
_MAYBE_CHAIR = 0.45
_UNSEEN_FLOOR = 0.45  # without a visible footwell any ledge in front of an upright surface may be a cushion
_HINT_REACH = 0.5
_HINT_TRUST = 0.7
_GUESSED = 0.95  # factor for each unseen edge
_SPARE = 0.15
# Confidence factor of an unseen seat under the sensor, in a row with a visible one.
_UNDER_THE_SENSOR = 0.4
_SURE = 0.5
_NEXT_SEAT = (0.35, 1.0)
_LOOKED_AT, _FEW = 0.12, 5
_SHOWN = 2000


@dataclass(frozen=True)
class Seat:
    """Cushion as a seat.

    Attributes:
        pose: (4, 4) origin in the middle of the cushion's top, x forward, z up.
        width, depth: of the cushion's top [m].
        floor: world z of the vehicle's floor in front of it [m]; NaN when unseen.
        back_share: share of the seen cells of its back that hold points.
        patch: the cushion's top.
    """

    pose: Float[np.ndarray, "4 4"]
    width: float
    depth: float
    floor: float
    back_share: float
    confidence: float
    patch: Patch

    def local(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Return world points in the seat's frame [m]."""
        return np.asarray((points - self.pose[:3, 3]) @ self.pose[:3, :3])


def detect_seat(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Find seats of vehicles, best first.

    The frame of a hit: origin in the middle of the cushion's top, x forward, z up.  Sizes: ``width``, ``depth`` of the
    cushion, and ``height`` of its top over the vehicle's floor if that was seen [m].  Unseen edges are set by the usual
    width and depth.  The seat under the sensor, in a row with a visible one, has a low confidence and no points.  A
    chair on the ground is not a seat; without a hint, a cushion without a visible floor in front is below the
    confidence to act on.

    Args:
        hint: (3,) a point near the cushion [m].
    """
    seats = find_seats(view)
    seats += _beside_the_seen(seats, view)
    if hint is not None:
        near = [seat for seat in seats if np.linalg.norm(seat.pose[:3, 3] - hint) < _HINT_REACH]
        seats = [replace(seat, confidence=seat.confidence**_HINT_TRUST) for seat in near]
    return [_detection(seat) for seat in sorted(seats, key=lambda seat: -seat.confidence)]


def find_seats(view: View) -> list[Seat]:
    """Find seats with a visible cushion, best first; see :func:`detect_seat`."""
    ground, points, head = ground_of(view), view.obstacles, _head_of(view)
    starts, ends = view.cloud.rays
    seats = []
    wholes = find_patches(points, ground + _OVER_GROUND[0], ground + _OVER_GROUND[1])
    for patch in [part for whole in wholes for part in split_at_gap(whole, _WIDTH[0])]:
        if patch.size.min() > _DEPTH[1] + _SPARE or patch.size.max() > _WIDTH[1] + _SPARE:
            continue
        about = surround_of(patch, points, starts, ends)
        patch = square_up(patch, about)
        cushions = [as_cushion(patch, about, turn) for turn in range(4)]
        best = max(
            (_seen_as_seat(patch, cushion, points, view, ground, head) for cushion in cushions),
            key=lambda s: s.confidence,
        )
        if best.confidence >= _REPORTED:
            seats.append(best)
    return sorted(seats, key=lambda seat: -seat.confidence)


def _beside_the_seen(seats: list[Seat], view: View) -> list[Seat]:
    """Return the seat under the robot, if the sensor is over the unseen continuation of a row of seats."""
    head, starts_ends = _head_of(view), view.cloud.rays
    for seat in seats:
        x, y, z = seat.local(head[None])[0]
        is_in_row = abs(x) < _HEAD_ABOUT and _NEXT_SEAT[0] < abs(y) < _NEXT_SEAT[1] and _HEAD[0] < z < _HEAD[1]
        if seat.confidence < _SURE or not is_in_row:
            continue
        pose = seat.pose.copy()
        pose[:3, 3] += y * pose[:3, 1]
        unseen = Seat(pose, USUAL_WIDTH, seat.depth, seat.floor, 0.0, _UNDER_THE_SENSOR * seat.confidence, seat.patch)
        if any(np.linalg.norm(pose[:3, 3] - other.pose[:3, 3]) < _NEXT_SEAT[0] for other in seats):
            continue
        starts, ends = (unseen.local(side) for side in starts_ends)
        down = (starts[:, 2] > 0.0) & (ends[:, 2] < 0.05)
        share = np.clip(starts[down, 2] / np.maximum(starts[down, 2] - ends[down, 2], 1e-6), 0.0, 1.0)
        place = starts[down, :2] + share[:, None] * (ends[down] - starts[down])[:, :2]
        if (np.abs(place) < _LOOKED_AT).all(axis=1).sum() < _FEW:
            return [replace(unseen, patch=replace(seat.patch, points=seat.patch.points[:0]))]
    return []


def _head_of(view: View) -> Float[np.ndarray, "3"]:
    """Return the sensor's position: median of the rays' starts [m]."""
    return np.asarray(np.median(view.cloud.starts[:: max(1, len(view.cloud.starts) // 1000)], axis=0))


def ground_of(view: View) -> float:
    """Return world z of the ground below the vehicle; the view's floor may be the vehicle's.

    Without visible ground the result is at most 0, the height of the ground under a robot.
    """
    lowest = float(np.percentile(view.near.points[:, 2], 2.0))
    if view.floor is None:
        return min(lowest, 0.0)
    floor = float(view.floor.height(np.array([[view.reach.x, view.reach.y]]))[0])
    if lowest < floor - _NOT_GROUND:
        return lowest
    return floor if floor < _NOT_GROUND else 0.0


def _seen_as_seat(
    patch: Patch,
    cushion: Cushion,
    points: Float[np.ndarray, "N 3"],
    view: View,
    ground: float,
    head: Float[np.ndarray, "3"],
) -> Seat:
    """Return the cushion as a seat with its confidence, which is 0 when width or depth does not fit."""
    pose, width, depth = cushion.pose, cushion.width, cushion.depth
    seat = Seat(pose, width, depth, np.nan, 0.0, 0.0, patch)
    if not _WIDTH[0] < width < _WIDTH[1] or not _DEPTH[0] < depth < _DEPTH[1]:
        return seat
    local = seat.local(points)
    starts, ends = (seat.local(side) for side in view.cloud.rays)
    back = back_of(width, depth, local, starts, ends)
    well = footwell_of(width, depth, seat.local(view.near.points), starts, ends)
    floor = well.height + float(pose[2, 3])
    above = is_inside(
        local,
        np.array([0.15 - 0.5 * depth, 0.06 - 0.5 * width, 0.07]),
        np.array([0.5 * depth, 0.5 * width - 0.06, 0.4]),
    )
    confidence = (
        rising(width, _WIDTH[0], 0.42)
        * (1.0 - (0.55 if cushion.filled > 0.85 else 0.9) * rising(width, 0.7, 1.0))
        * rising(depth, _DEPTH[0], 0.38)
        * rising(-depth, -_DEPTH[1], -0.58)
        * rising(cushion.filled, 0.4, 0.65)
        * _GUESSED**cushion.n_guessed
        * rising(-patch.rms, -0.024, -0.016)
        * back.evidence(_UNSEEN_SAT_ON if _is_sat_on(seat, head) else _UNSEEN)
        * rising(-above.sum() / len(patch.points), -0.4, -0.15)
        * _ends_ahead(seat, local)
        * _floor_share(floor, ground, pose[2, 3])
        * well.evidence
        * (rising(patch.filled, 0.4, 0.65) if np.isnan(floor) else 1.0)
    )
    return Seat(pose, width, depth, floor, back.solid, float(confidence), patch)


def _is_sat_on(seat: Seat, head: Float[np.ndarray, "3"]) -> bool:
    """Return whether the sensor is at the head position of a person on the seat."""
    x, y, z = seat.local(head[None])[0]
    return bool(abs(x) < _HEAD_ABOUT and abs(y) < _HEAD_ABOUT and _HEAD[0] < z < _HEAD[1])


def _ends_ahead(seat: Seat, local: Float[np.ndarray, "N 3"]) -> float:
    """Return the score, 0 to 1, that the cushion ends at its front edge: few points just beyond it."""
    half = 0.5 * seat.depth
    beyond = is_inside(
        local, np.array([half + 0.04, -0.4 * seat.width, -0.06]), np.array([half + 0.2, 0.4 * seat.width, 0.06])
    )
    return 1.0 - rising(float(beyond.sum()) / len(seat.patch.points), 0.05, 0.25)


def _floor_share(floor: float, ground: float, top: float) -> float:
    """Return the score, 0 to 1, of the floor's height: the seat's top over it, and the floor over the ground."""
    maybe_chair = _MAYBE_CHAIR * rising(top - ground, SEAT_HEIGHT[0], 0.3) * rising(ground - top, -SEAT_HEIGHT[1], -0.6)
    if np.isnan(floor):
        return max(_UNSEEN_FLOOR * rising(top - ground, 0.6, 0.7), maybe_chair)
    over_ground = rising(floor - ground, _NOT_GROUND - 0.05, _NOT_GROUND + 0.03)
    # The ground found may be the vehicle's own floor; at a chair's height over it the seat may also be a chair.
    return max(over_ground * rising(top - floor, SEAT_HEIGHT[0], 0.3), maybe_chair)


def _detection(seat: Seat) -> Detection:
    sizes = {"width": seat.width, "depth": seat.depth}
    if not np.isnan(seat.floor):
        sizes["height"] = float(seat.pose[2, 3] - seat.floor)
    step = max(1, len(seat.patch.points) // _SHOWN)
    residuals = {"rms": seat.patch.rms, "back_seen_share": seat.back_share}
    return Detection("seat", seat.pose, sizes, seat.confidence, residuals, seat.patch.points[::step])
