"""Places where a hand pushes a leaf, the most promising first: on its face or its back, or behind its free edge."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from costs.robot import RobotModel
from service.demands.door.door import Door
from service.demands.door.phases import Push
from service.demands.hands import Hand
from service.demands.holds.door_edge import measure_edge_gap, measure_edge_room

PUSH_ALONG = (0.75, 0.6, 0.45)  # shares of the leaf's width
PUSH_UP = (1.05, 1.25, 0.9)  # heights of the peg's tip on the leaf [m]
HAND_ROOM = 0.25  # between the free edge and the frame, for a hand that reaches behind the leaf [m]
EDGE_UP = (1.05, 0.9, 1.2)  # heights of the rod behind the free edge [m]
EDGE_SLANTS = tuple(np.deg2rad([0.0, -35.0, 35.0]).tolist())  # of the rod [rad]
ANGLE_UNKNOWN = float("nan")  # of a place that is not tried at an angle yet [rad]


def list_push_places(door: Door, hands: Sequence[Hand], robot: RobotModel, first: float) -> tuple[Push, ...]:
    """Return the places to try with the leaf open by ``first`` [rad]; none where no hand gets behind a pulled leaf.

    A leaf that is pulled, and that no hand has opened yet, is held behind its edge first: the hand stays before it.
    """
    geometry = door.geometry
    low = float(geometry.hinge[2])
    tips = [
        Push(hand, share * geometry.width, up - low, ANGLE_UNKNOWN)
        for hand in hands
        for share in PUSH_ALONG
        for up in PUSH_UP
    ]
    if door.is_push:
        return tuple(tips)
    edges = [
        Push(hand, geometry.width, up - low, ANGLE_UNKNOWN, slant)
        for hand in hands
        if find_narrow_gap(door, (hand,), robot, first) is None
        for slant in EDGE_SLANTS
        for up in EDGE_UP
        if 0.0 < up - low < geometry.height
    ]
    tips = tips if geometry.width * np.sin(first) >= HAND_ROOM else []
    return (*edges, *tips) if first <= geometry.ajar else (*tips, *edges)


def find_narrow_gap(door: Door, hands: Sequence[Hand], robot: RobotModel, opening: float) -> str | None:
    """Return why no hand gets its rod behind the free edge of a leaf that is open by an angle; None if one does.

    Args:
        door, hands, robot: the door, and the hands of the robot.
        opening: of the leaf [rad].
    """
    gap = measure_edge_gap(door.geometry, opening)
    needed = min(measure_edge_room(robot, hand) for hand in hands)
    if gap >= needed:
        return None
    return (
        f"the gap between the free edge and the frame is {1e3 * gap:.0f} mm; the rod behind the edge, with the hand "
        f"beside it, needs {np.ceil(1e3 * needed):.0f} mm"
    )
