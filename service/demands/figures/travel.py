"""How far a motion moves the object of its task, and the loads up to which it could hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from costs.robot import Mechanism
from costs.rotation import make_tangent_basis
from perception.detect.door.bodies import HANDLE_LINK, LEAF_LINK
from service.demands.door.door import Door
from service.demands.figures.held_load import find_held_shares
from service.demands.valve.strokes import TURN
from service.demands.valve.wheel import Wheel
from service.request.tasks.valve import VALVE_LINK
from service.verify import Motion, trace_frame

TURN_SAMPLES = 400  # of a turn
DOOR_SAMPLES = 1000  # of a whole motion


def measure_turn(wheel: Wheel, torque_nm: float, frame: str, motion: Motion) -> dict[str, float]:
    """Measure the angle by which a tool travels about a wheel's axis in the turns [deg], and the torque it could hold.

    Args:
        wheel: the wheel.
        torque_nm: its stated torque [N m].
        frame: the tool that moves with the wheel.
        motion: the motion.
    """
    total = 0.0
    first, second = make_tangent_basis(np.asarray(wheel.axis))
    for phase in motion.phases:
        if phase.name.split(" ")[0] == TURN:
            s = np.linspace(phase.first, phase.last, TURN_SAMPLES)
            offset = trace_frame(motion.robot.model, frame, motion.curve(s))[1] - wheel.centre
            angle = np.unwrap(np.arctan2(offset @ second, offset @ first))
            total += float(angle[-1] - angle[0])
    return {"turned_deg": float(np.rad2deg(total))} | _find_holds(motion, {"holds_torque_nm": (VALVE_LINK, torque_nm)})


def measure_door(door: Door, motion: Motion) -> dict[str, float]:
    """Measure angles [deg], the free width of the doorway at the end [m], and loads that the motion could hold."""
    geometry, k = door.geometry, len(door.mechanism.joints)
    samples = motion.curve(np.linspace(motion.curve.knots[0], motion.curve.knots[-1], DOOR_SAMPLES))[:, -k:]
    opening = float(samples[-1, 0])
    width = geometry.width
    free = width - (width * np.cos(opening) if opening < np.pi / 2.0 else 0.0)
    figures = {"opening_deg": float(np.rad2deg(opening)), "free_width_m": float(free)}
    is_bar = door.has_push_bar
    if k > 1:
        largest = float(samples[:, 1].max())
        figures["pressed_m" if is_bar else "lever_deg"] = largest if is_bar else float(np.rad2deg(largest))
    handle = ("holds_push_bar_n", door.push_bar_n) if is_bar else ("holds_lever_nm", door.lever_nm)
    return figures | _find_holds(
        motion, {"holds_hinge_nm": (LEAF_LINK, door.hinge_nm), handle[0]: (HANDLE_LINK, handle[1])}
    )


def measure_ends(mechanism: Mechanism, moved: Iterable[str], motion: Motion) -> dict[str, float]:
    """Measure the values of moved joints at the end of a motion, by ``JOINT_deg`` or ``JOINT_m`` [deg, m].

    Args:
        mechanism: whose coordinates are the motion's last.
        moved: names of its joints that the task moves.
        motion: the motion.
    """
    names = [joint.name for joint in mechanism.joints]
    last = motion.curve(motion.curve.knots[-1:])[0, -len(names) :].tolist()
    figures = {}
    for name in dict.fromkeys(moved):
        value = last[names.index(name)]
        is_slide = mechanism.joint(name).kind == "prismatic"
        figures[f"{name}_m" if is_slide else f"{name}_deg"] = value if is_slide else float(np.rad2deg(value))
    return figures


def _find_holds(motion: Motion, stated: Mapping[str, tuple[str, float]]) -> dict[str, float]:
    """Return the loads up to which a motion could hold, by figure, for those that are stated on links [N m, N]."""
    if not any(load > 0.0 for _, load in stated.values()):
        return {}
    shares = find_held_shares(motion)
    return {name: shares[link] * load for name, (link, load) in stated.items() if load > 0.0 and link in shares}
