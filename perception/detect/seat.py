"""Vehicle seats: a level cushion with a back behind it and the vehicle's floor before it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from perception.detect.confidence import rising
from perception.detect.detection import Detection
from perception.detect.level import Patch, find_patches, is_inside, split_at_gap
from perception.view import View

_REPORTED = 0.05
_OVER_GROUND = (0.35, 1.15)
_HEIGHT = (0.22, 0.68)  # of a cushion over the vehicle's floor
_WIDTH = (0.36, 1.5)
_DEPTH = (0.3, 0.65)
_BACK = (0.08, 0.6)
_OPEN_CELL = 0.06
_NOT_GROUND = 0.12
_LEAST_FLOOR = 0.04
_MAYBE_CHAIR = 0.45
_HINT_REACH = 0.5
_HINT_TRUST = 0.7
_SHOWN = 2000


@dataclass(frozen=True)
class Seat:
    """A cushion seen as a seat.

    Attributes:
        pose: (4, 4) origin in the middle of the cushion's top, x forward, z up.
        width, depth: of the cushion's top [m].
        floor: world z of the vehicle's floor before it [m]; NaN when not seen.
        back_share: share of what was seen of the place of its back that is solid.
        confidence: 0 to 1.
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
        """In the seat's frame [m]."""
        return np.asarray((points - self.pose[:3, 3]) @ self.pose[:3, :3])


def detect_seat(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Seats of vehicles, best first.

    The frame of a hit: origin in the middle of the cushion's top, x forward, z up.  Sizes: ``width``, ``depth`` of the
    cushion, and ``height`` of its top over the vehicle's floor where that was seen [m].  A chair on the ground is none.

    Args:
        view: the scan, made ready.
        hint: (3,) a point near the cushion [m].
    """
    return [_detection(seat) for seat in find_seats(view, hint)]


def find_seats(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Seat]:
    """Seats, best first; see :func:`detect_seat`."""
    ground = ground_of(view)
    points = view.obstacles
    seats = []
    wholes = find_patches(points, ground + _OVER_GROUND[0], ground + _OVER_GROUND[1])
    for patch in [part for whole in wholes for part in split_at_gap(whole, _WIDTH[0])]:
        if hint is not None and np.linalg.norm(patch.centre - hint) > _HINT_REACH:
            continue
        best = max((_seen_as_seat(patch, turn, points, view, ground) for turn in range(4)), key=lambda s: s.confidence)
        if hint is not None:
            best = replace(best, confidence=best.confidence**_HINT_TRUST)
        if best.confidence >= _REPORTED:
            seats.append(best)
    return sorted(seats, key=lambda seat: -seat.confidence)


def ground_of(view: View) -> float:
    """World z of the ground a vehicle stands on: below its floor, which may be the one the view took for the floor."""
    lowest = float(np.percentile(view.near.points[:, 2], 2.0))
    if view.floor is None:
        return lowest
    floor = float(view.floor.height(np.array([[view.reach.x, view.reach.y]]))[0])
    return lowest if lowest < floor - _NOT_GROUND else floor


def _seen_as_seat(patch: Patch, turn: int, points: Float[np.ndarray, "N 3"], view: View, ground: float) -> Seat:
    """The patch as a cushion that looks along its rectangle, turned by quarter turns."""
    yaw = patch.yaw + 0.5 * np.pi * turn
    depth, width = patch.size if turn % 2 == 0 else patch.size[::-1]
    c, s = np.cos(yaw), np.sin(yaw)
    pose = np.eye(4)
    pose[:3, :3] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    pose[:3, 3] = patch.centre
    seat = Seat(pose, float(width), float(depth), np.nan, 0.0, 0.0, patch)
    if not _WIDTH[0] < width < _WIDTH[1] or not _DEPTH[0] < depth < _DEPTH[1]:
        return seat
    local = seat.local(points)
    back_share, n_back, reach_up = _back(seat, local, view)
    floor, free = _front(seat, local, seat.local(view.near.points))
    above = is_inside(
        local,
        np.array([0.15 - 0.5 * depth, 0.06 - 0.5 * width, 0.07]),
        np.array([0.5 * depth, 0.5 * width - 0.06, 0.4]),
    )
    confidence = (
        rising(width, _WIDTH[0], 0.42)
        * (1.0 - (0.55 if patch.filled > 0.85 else 0.9) * rising(width, 0.7, 1.0))
        * rising(depth, _DEPTH[0], 0.38)
        * rising(-depth, -_DEPTH[1], -0.58)
        * rising(patch.filled, 0.4, 0.65)
        * rising(-patch.rms, -0.024, -0.016)
        * rising(back_share, 0.3, 0.6)
        * rising(n_back, 3.0, 10.0)
        * rising(reach_up, 0.35, 0.5)
        * (1.0 - 0.8 * rising(reach_up, 1.15, 1.4))
        * rising(-above.sum() / len(patch.points), -0.4, -0.15)
        * free
        * _floor_share(floor, ground, pose[2, 3])
    )
    return Seat(pose, float(width), float(depth), floor, back_share, float(confidence), patch)


def _back(seat: Seat, local: Float[np.ndarray, "N 3"], view: View) -> tuple[float, float, float]:
    """Share of the places behind the cushion that are solid among those seen, how many are, and how high it goes."""
    n_across = max(round((seat.width - 0.04) / _OPEN_CELL), 1)
    n_up = round((_BACK[1] - _BACK[0]) / _OPEN_CELL)
    low = np.array([-0.5 * seat.depth - 0.3, -0.5 * n_across * _OPEN_CELL, _BACK[0]])
    high = np.array([-0.5 * seat.depth + 0.12, 0.5 * n_across * _OPEN_CELL, _BACK[0] + n_up * _OPEN_CELL])
    solid = np.zeros((n_across, n_up), dtype=bool)
    mine = local[is_inside(local, low, high)]
    cell = np.floor((mine[:, 1:] - low[1:]) / _OPEN_CELL).astype(int)
    solid[cell[:, 0], cell[:, 1]] = True
    starts, ends = (seat.local(side) for side in view.cloud.rays)
    # Rays that cross the middle of the back's place from one side of it to the other.
    at = -0.5 * seat.depth - 0.1
    through = (starts[:, 0] - low[0]) * (ends[:, 0] - low[0]) < 0.0
    through &= np.maximum(starts[:, 0], ends[:, 0]) > high[0]
    share = (at - starts[through, 0]) / (ends[through, 0] - starts[through, 0])
    crossing = starts[through, 1:] + share[:, None] * (ends[through, 1:] - starts[through, 1:])
    cell = np.floor((crossing - low[1:]) / _OPEN_CELL).astype(int)
    cell = cell[((cell >= 0) & (cell < solid.shape)).all(axis=1)]
    opened = np.zeros_like(solid)
    opened[cell[:, 0], cell[:, 1]] = True
    seen = solid | opened
    return float(solid.sum() / max(seen.sum(), 1)), float(solid.sum()), _reach_up(local, low, high)


def _reach_up(local: Float[np.ndarray, "N 3"], low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> float:
    """How high what is behind the cushion goes on without a gap: a wall goes on far above where seats end [m]."""
    tall = local[is_inside(local, np.array([low[0], low[1], 0.3]), np.array([high[0], high[1], 1.6])), 2]
    steps = np.bincount(np.floor((tall - 0.3) / 0.1).astype(int), minlength=14) >= 5
    return 0.3 + 0.1 * float(np.argmin(np.concatenate([steps, [False]])))


def _front(seat: Seat, local: Float[np.ndarray, "N 3"], all_local: Float[np.ndarray, "A 3"]) -> tuple[float, float]:
    """World z of the floor before the cushion (NaN: not seen), and 1 where the cushion ends in front."""
    half = 0.5 * seat.depth
    beyond = is_inside(
        local, np.array([half + 0.04, -0.4 * seat.width, -0.06]), np.array([half + 0.2, 0.4 * seat.width, 0.06])
    )
    free = 1.0 - rising(float(beyond.sum()) / len(seat.patch.points), 0.05, 0.25)
    down = is_inside(
        all_local,
        np.array([half - 0.1, -0.5 * seat.width - 0.1, -_HEIGHT[1]]),
        np.array([half + 0.6, 0.5 * seat.width + 0.1, -_HEIGHT[0]]),
    )
    height, flat = all_local[down, 2], all_local[down, :2]
    if len(height) < 20:
        return np.nan, free
    # The height at which most of the ground plan is covered; what stands up covers little of it.
    layer = np.floor((height + _HEIGHT[1]) / 0.02).astype(int)
    cell = np.floor(flat / 0.04).astype(int)
    places = np.unique(np.column_stack([layer, cell]), axis=0)[:, 0]
    votes = np.convolve(np.bincount(places, minlength=int(layer.max()) + 2), [1.0, 1.0, 1.0], mode="same")
    best = int(np.argmax(votes))
    if votes[best] * 0.04**2 < _LEAST_FLOOR:
        return np.nan, free
    middle = (best + 0.5) * 0.02 - _HEIGHT[1]
    return float(np.median(height[np.abs(height - middle) < 0.03]) + seat.pose[2, 3]), free


def _floor_share(floor: float, ground: float, top: float) -> float:
    """How much the floor before it speaks for a vehicle: a cushion at seat height over a floor over the ground."""
    maybe_chair = _MAYBE_CHAIR * rising(top - ground, _HEIGHT[0], 0.3) * rising(ground - top, -_HEIGHT[1], -0.6)
    if np.isnan(floor):
        return max(0.7 * rising(top - ground, 0.6, 0.7), maybe_chair)
    over_ground = rising(floor - ground, _NOT_GROUND - 0.05, _NOT_GROUND + 0.03)
    # The floor that was found may be the vehicle's own; at a chair's height over it, it may as well be a chair.
    return max(over_ground * rising(top - floor, _HEIGHT[0], 0.3), maybe_chair)


def _detection(seat: Seat) -> Detection:
    sizes = {"width": seat.width, "depth": seat.depth}
    if not np.isnan(seat.floor):
        sizes["height"] = float(seat.pose[2, 3] - seat.floor)
    step = max(1, len(seat.patch.points) // _SHOWN)
    residuals = {"rms": seat.patch.rms, "back_seen_share": seat.back_share}
    return Detection("seat", seat.pose, sizes, seat.confidence, residuals, seat.patch.points[::step])
