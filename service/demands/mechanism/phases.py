"""Phases of a hand that moves a given mechanism: its place at the handle, its loads, and what stays still."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from service.demands.hands import Hand
from service.demands.holds.leaving import LET_GO, SET_ON, STAYS_SHARE, may_drag
from service.demands.holds.pressed import add_pressed, find_pressed
from service.demands.mechanism.given import GivenMechanism
from service.demands.moved_object.loads import LEAST_LOAD, JointLoad
from service.demands.phase import AXIS, DEPTH_RESERVE, FrameMotion, TaskPhase
from service.errors import RequestError
from service.request.tasks.mechanism import MechanismRequest
from service.verify import HAND_DRIFT_M, HandLoad

TOUCH_DEPTH = 6e-3  # allowed overlap of the hand's rod and what it holds [m]
TILT_RESERVE = float(np.deg2rad(2.0))
PLACE_TOLERANCE = 5e-3  # [m]
MOST_LOADS = 4  # at a time: the robot is held under every combination of them
LEAST_ACROSS = 0.5  # sine between a hand and the way on which the side of its fingers pushes
LEAST_ARM = 0.01  # of the handle about a joint that it moves [m]


def make_mechanism_phases(given: GivenMechanism, hand: Hand) -> tuple[TaskPhase, ...]:
    """Return the phases: reach, approach, one per move, retract unless the hand stays.

    Where the hand could drag a joint along that it does not move, it sets on and lets go in phases of their own.

    Raises:
        RequestError: a hand at the handle does not move a joint.
    """
    handle, start = given.handle, given.mechanism.start
    tool, closed = select_tool(given, hand), {joint: (value, value) for joint, value in hand.closed}
    ahead = measure_ahead(given, hand)
    held = FrameMotion(
        tool, handle.link, handle.place - ahead * handle.axis, handle.axis, slide=handle.slide,
        rotation=turn_fingers(given, hand), tolerance_m=PLACE_TOLERANCE, tilt_rad=handle.tilt,
        aim_rad=handle.tilt - TILT_RESERVE,
    )  # fmt: skip
    line = replace(held, offset=handle.approach)
    # What presses lies on the surface; the rod beside a hand that presses by its front comes no further than that.
    rod = hand.fingers if hand.closed else (hand.hook,)
    depths = dict.fromkeys(rod, TOUCH_DEPTH)
    if given.request.handle.tool == "stub":
        front = hand.palm if hand.closed else hand.link
        depths = {front: TOUCH_DEPTH, **dict.fromkeys(rod, TOUCH_DEPTH if hand.closed else DEPTH_RESERVE)}
    touches = tuple(
        Allowance(BodyRef.of_link(link), BodyRef("mechanism", handle.link, body), depth)
        for link, depth in depths.items()
        for body in handle.bodies
    )
    ends = given.list_moves()
    values = ends[-1][1]
    joint_loads = given.list_joint_loads()
    drift = max(HAND_DRIFT_M, PLACE_TOLERANCE + abs(ahead) * float(np.sin(handle.tilt)))
    loads = [
        tuple(replace(load, drift_m=drift) for load in _make_loads(given, tool, first, each))
        for (first, _), each in zip(ends, joint_loads, strict=True)
    ]
    crowded = next((k for k, carried in enumerate(loads) if len(carried) > MOST_LOADS), None)
    if crowded is not None:
        raise RequestError(
            f"task.mechanism.joints: the hand would carry {len(loads[crowded])} loads, one per joint and direction, in "
            f"moves[{crowded}]; expected at most {MOST_LOADS}"
        )
    phases = [TaskPhase("reach", start, start), TaskPhase("approach", start, start, (line,), touches, joints=closed)]
    if drags_along(given, joint_loads[0], loads[0], start):
        phases.append(TaskPhase(SET_ON, start, start, (line,), touches, joints=closed))
    for k, (first, last) in enumerate(ends):
        bears = {
            load.joint: (load.low - STAYS_SHARE * load.slack[0], load.high + STAYS_SHARE * load.slack[1])
            for load in joint_loads[k]
            if load.sense == 0.0
        }
        name = _name_phase(given.request, k)
        phases.append(TaskPhase(name, first, last, (held,), touches, joints=closed, loads=loads[k], bears=bears))
    if not given.request.stays:  # a line promises nothing but what may touch: the planner may turn it
        away = replace(line, leaves=True)
        if drags_along(given, joint_loads[-1], loads[-1], values):
            phases.append(TaskPhase(LET_GO, values, values, (away,), touches, joints=closed))
        phases.append(TaskPhase("retract", values, values, (away,), touches, joints=closed))
    return add_pressed(phases, find_pressed(None, given.request.handle.link, (0.0, 0.0)))


def drags_along(
    given: GivenMechanism, loads: tuple[JointLoad, ...], forces: tuple[HandLoad, ...], values: Float[np.ndarray, "k"]
) -> bool:
    """Return whether a hand that slides off the handle could drag a joint along that it did not move."""
    force = max((float(np.linalg.norm(load.force)) for load in forces), default=0.0)
    for load in loads:
        if load.sense == 0.0:
            joint = given.mechanism.joint(load.joint)
            place, _ = _locate_handle(given, load.joint, values)
            turning = np.cross(joint.axis / np.linalg.norm(joint.axis), place)
            arm = 1.0 if joint.kind == "prismatic" else float(np.linalg.norm(turning))
            if may_drag(force, arm, min(load.slack)):
                return True
    return False


def select_tool(given: GivenMechanism, hand: Hand) -> str:
    """Return the frame of a hand that is at the handle's place, or rigidly behind it."""
    if hand.closed:
        return hand.tool
    return {"peg": hand.peg, "tip": hand.tool, "stub": hand.stub}[given.request.handle.tool]


def measure_ahead(given: GivenMechanism, hand: Hand) -> float:
    """Return how far before its frame a hand is at the handle's place: fingers' ends, pads, or the front [m]."""
    if not hand.closed:
        return 0.0
    return {"peg": 0.0, "tip": hand.tip_m, "stub": hand.palm_m}[given.request.handle.tool]


def turn_fingers(given: GivenMechanism, hand: Hand) -> Float[np.ndarray, "3 3"] | None:
    """Return rotation_link_tool of closed fingers whose side faces the first move's way; None of ends and of rods.

    Raises:
        RequestError: the handle moves along the hand, whose sides then push nothing.
    """
    handle, start = given.handle, given.mechanism.start
    if not hand.closed or given.request.handle.tool == "tip":
        return None
    name = given.request.moves[0].joint
    joint = given.mechanism.joint(name)
    place, turned = _locate_handle(given, name, start)
    axis = joint.axis / np.linalg.norm(joint.axis)
    way = turned.T @ (axis if joint.kind == "prismatic" else np.cross(axis, place))
    across = way - (way @ handle.axis) * handle.axis
    size = float(np.linalg.norm(across))
    if size <= LEAST_ACROSS * float(np.linalg.norm(way)):
        raise RequestError(
            f"task.mechanism.handle.axis: points along the way of {name}; expected a hand across it, whose closed "
            "fingers push by their side, or handle.tool: tip"
        )
    flank = np.array(hand.flank)
    own = np.stack([np.cross(flank, AXIS), flank, AXIS], axis=1)
    return np.asarray(np.stack([np.cross(across / size, handle.axis), across / size, handle.axis], axis=1) @ own.T)


def _make_loads(
    given: GivenMechanism, tool: str, values: Float[np.ndarray, "k"], loads: tuple[JointLoad, ...]
) -> Iterator[HandLoad]:
    """Yield the forces at the handle of a move's loads, one per joint and direction."""
    for load in loads:
        for size in (max(load.high, 0.0), min(load.low, 0.0)):
            if abs(size) > LEAST_LOAD:
                yield _make_load(given, tool, load.joint, values, size)


def _make_load(given: GivenMechanism, tool: str, name: str, values: Float[np.ndarray, "k"], size: float) -> HandLoad:
    """Return the force at the handle that exerts a signed torque or force along a joint [N m, N]."""
    handle, joint = given.handle, given.mechanism.joint(name)
    place, turned = _locate_handle(given, name, values)
    axis = joint.axis / np.linalg.norm(joint.axis)
    slide = None if handle.slide is None else turned @ handle.slide
    force = size * axis
    if joint.kind == "revolute":
        ends = [place] if slide is None else [place - slide, place, place + slide]
        arm = min(float(np.linalg.norm(np.cross(axis, end))) for end in ends)
        if arm < LEAST_ARM:
            raise RequestError(
                f"task.mechanism.handle.place: {1e3 * arm:.1f} mm from the axis of {name}; expected at least "
                f"{1e3 * LEAST_ARM:g} mm, so that the hand can turn it"
            )
        tangent = np.cross(axis, place)
        force = size / arm * tangent / np.linalg.norm(tangent)
    return HandLoad(tool, joint.link, place, force, slide)


def _locate_handle(
    given: GivenMechanism, name: str, values: Float[np.ndarray, "k"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Return the handle's place in the link of a joint that carries it, and the rotation of its link in that link."""
    pose = np.linalg.inv(given.locate(name, values)) @ given.locate(given.handle.joint, values)
    return pose[:3, :3] @ given.handle.place + pose[:3, 3], pose[:3, :3]


def list_opposite_places(given: GivenMechanism) -> list[Float[np.ndarray, "3"]]:
    """Return the places on the other side of each body that the hand may touch, along the way of each move [m]."""
    handle, places = given.handle, []
    bodies = {name: points for joint in given.mechanism.joints for name, points in joint.bodies.items()}
    own = given.mechanism.joint(handle.joint)
    for move in given.request.moves:
        start = given.mechanism.start
        carrier = given.mechanism.joint(move.joint)
        place, _ = _locate_handle(given, move.joint, start)
        axis = carrier.axis / np.linalg.norm(carrier.axis)
        way = axis if carrier.kind == "prismatic" else np.cross(axis, place)
        way = way / max(float(np.linalg.norm(way)), 1e-12)
        for name in handle.bodies:
            middle = bodies[name].mean(axis=0) - own.origin
            places.append(handle.place - 2.0 * float((handle.place - middle) @ way) * way)
    return places


def _name_phase(request: MechanismRequest, index: int) -> str:
    """Return the name of a move's phase, numbered from a joint's second move on."""
    joint = request.moves[index].joint
    count = sum(move.joint == joint for move in request.moves[: index + 1])
    return f"move {joint}" + (f" {count}" if count > 1 else "")
