"""Wheels that are no valves: what a vehicle is steered by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perception.detect.valve.ring import Ring
from perception.detect.vehicle.seat import Seat

_RADII = (0.13, 0.28)
# From the middle of the cushion's top: forward, to either side, up [m].
_AHEAD, _ASIDE, _UP = (0.2, 0.75), 0.25, (0.1, 0.65)
_FACING, _SIDEWAYS = 0.3, 0.35
_SURE_SEAT = 0.5


def could_steer(ring: Ring) -> bool:
    """Whether a ring is of a steering wheel's size."""
    return _RADII[0] < ring.radius + ring.half_width < _RADII[1]


def steers(ring: Ring, seats: Sequence[Seat]) -> bool:
    """Whether a ring is before the chest of who sits on one of the seats, and faces them.

    A chair before a valve is no reason to doubt the valve: seats of vehicles alone count, and only sure ones.
    """
    for seat in seats:
        x, y, z = seat.local(ring.centre[None])[0]
        towards, aside, _ = np.abs(seat.pose[:3, :3].T @ ring.axis)
        is_there = _AHEAD[0] < x < _AHEAD[1] and abs(y) < _ASIDE and _UP[0] < z < _UP[1]
        if seat.confidence >= _SURE_SEAT and is_there and towards > _FACING and aside < _SIDEWAYS:
            return True
    return False
