"""Strokes of a valve task, and their phases: how often a hand takes hold of the wheel, and how it turns it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from service.demands.hands import Hand
from service.demands.holds.pressed import add_pressed, find_pressed
from service.demands.phase import AXIS, FrameMotion, TaskPhase
from service.demands.valve.grip import make_finger_targets, make_grip_allowances, place_grip
from service.demands.valve.peg import PegPlace, make_peg_allowances, place_peg
from service.demands.valve.wheel import Mode, Wheel, wrap_angle
from service.request.fields import HAND_FRICTION
from service.request.tasks.valve import VALVE_LINK, ValveRequest
from service.verify import CircleTarget, HandLoad, PressedPart

TURN = "turn"
LARGEST_STROKES: Mapping[Mode, float] = {"hook": np.deg2rad(360.0), "grasp": np.deg2rad(120.0)}
PROBE = np.deg2rad(10.0)  # to either side, where the sense of the turn is not known
ROCK = np.deg2rad(5.0)  # to either side, before a stuck wheel is turned
RIM, RIM_NEAR = "rim", 0.06  # name of a wheel's rim, and distance from a hold within which it is counted [m]
STUCK_FACTOR = 2.0  # of the torque that a stuck wheel may take
PEG_TOLERANCE = 1e-3  # largest distance of the peg's middle from its place in the wheel [m]
GRIP_TOLERANCE = 1.5e-3  # the same of a gripper [m]
AXIS_TOLERANCE = np.deg2rad(3.0)  # largest angle between the hand axis and the valve's
ROUNDING = 1e-9


@dataclass(frozen=True)
class Stroke:
    """A part of the turn with one hold of the wheel.

    Attributes:
        first, last: angles of the wheel at its ends [rad].
        torque_nm: that turns the wheel.
    """

    first: float
    last: float
    torque_nm: float

    @property
    def sense(self) -> float:
        """1 if the wheel turns right-handed about its axis, else -1."""
        return 1.0 if self.last > self.first else -1.0


@dataclass(frozen=True)
class TurnChoice:
    """Choices of a plan, among those that the task permits.

    Attributes:
        hand: the hand.
        entry: of the first stroke: the spoke that is pressed, or the gap that is entered, in the wheel [rad].
        count: number of strokes of the turn itself.
        is_flipped: whether a gripper is turned by half a turn, with its first finger inside the rim.
    """

    hand: Hand
    entry: float
    count: int
    is_flipped: bool = False


def list_strokes(request: ValveRequest, count: int) -> tuple[Stroke, ...]:
    """Return the strokes of a task, whose turn is divided into ``count`` equal ones.

    A turn of unknown sense is a small stroke each way, that of ``turn_deg`` first.  A stuck wheel is first rocked
    against the turn and back, with twice the torque.
    """
    turn, torque = float(np.deg2rad(request.turn_deg)), request.torque_nm
    sense = float(np.sign(turn))
    loose = STUCK_FACTOR * torque if request.stuck else torque
    if request.sense == "unknown":
        probe = sense * float(PROBE)
        return Stroke(0.0, probe, loose), Stroke(probe, -probe, loose)
    rock = sense * float(ROCK) if request.stuck else 0.0
    edges = np.linspace(rock, turn, count + 1).tolist()
    rocking = (Stroke(0.0, -rock, loose), Stroke(-rock, rock, loose)) if request.stuck else ()
    return (*rocking, *(Stroke(*ends, torque) for ends in pairwise(edges)))


def find_least_count(request: ValveRequest) -> int:
    """Return the least number of strokes of the turn itself."""
    if request.sense == "unknown":
        return 1
    return max(1, int(np.ceil(np.deg2rad(abs(request.turn_deg)) / LARGEST_STROKES[request.mode] - ROUNDING)))


def find_count(request: ValveRequest, n_phases: int) -> int:
    """Return the number of strokes of the turn itself, given the number of all phases that turn the wheel."""
    if request.sense == "unknown":
        return 1
    return max(1, n_phases - 2) if request.stuck else n_phases


def find_net_turn(request: ValveRequest) -> float:
    """Return the angle by which the wheel has turned at the end [deg]."""
    return float(np.rad2deg(list_strokes(request, 1)[-1].last))


def list_usable_entries(wheel: Wheel, hand: Hand, mode: Mode, sense: float) -> tuple[float, ...]:
    """Return the entries at which a hand can turn a wheel in a sense [rad]."""
    return tuple(entry for entry in wheel.list_entries(mode) if find_fault(wheel, hand, mode, entry, sense) is None)


def find_fault(wheel: Wheel, hand: Hand, mode: Mode, entry: float, sense: float) -> str | None:
    """Return why a hand cannot turn a wheel from an entry; None if it can."""
    held = place_peg(wheel, hand, entry, sense) if mode == "hook" else place_grip(wheel, entry, is_flipped=False)
    return held if isinstance(held, str) else None


def find_hold(wheel: Wheel, choice: TurnChoice, mode: Mode, sense: float) -> FrameMotion:
    """Return how a hand holds a wheel at its entry.

    Raises:
        ValueError: the hand cannot enter there.
    """
    if mode == "hook":
        peg = place_peg(wheel, choice.hand, choice.entry, sense)
        if isinstance(peg, str):
            raise ValueError(peg)
        return FrameMotion(
            choice.hand.peg, VALVE_LINK, peg.place, -wheel.axis, offset=peg.offset, tolerance_m=PEG_TOLERANCE,
            tilt_rad=float(AXIS_TOLERANCE),
        )  # fmt: skip
    grip = place_grip(wheel, choice.entry, choice.is_flipped)
    if isinstance(grip, str):
        raise ValueError(grip)
    return FrameMotion(
        choice.hand.tool, VALVE_LINK, grip.place, -wheel.axis, offset=grip.offset, tolerance_m=GRIP_TOLERANCE,
        tilt_rad=float(AXIS_TOLERANCE), rotation=grip.rotation, grips=True,
    )  # fmt: skip


def make_turn_phases(
    wheel: Wheel, request: ValveRequest, choice: TurnChoice, friction: float = HAND_FRICTION[1]
) -> tuple[TaskPhase, ...]:
    """Return the phases of all strokes; after the first one each enters where it is nearest to the first entry.

    ``friction`` is the largest coefficient between a peg and the wheel.

    Raises:
        ValueError: the hand cannot enter for a stroke.
    """
    strokes = list_strokes(request, choice.count)
    phases: list[TaskPhase] = []
    for number, stroke in enumerate(strokes):
        suffix = "" if len(strokes) == 1 else f" {number + 1}"
        entry = choice.entry if number == 0 else _find_next_entry(wheel, request.mode, choice, stroke)
        held = replace(choice, entry=entry)
        if request.mode == "hook":
            specs = _make_peg_stroke(wheel, held, stroke, suffix, friction)
        else:
            specs = _make_grip_stroke(wheel, held, stroke, suffix)
        phases += add_pressed(specs, find_pressed_part(wheel, held, request.mode, stroke.sense))
    return tuple(phases)


def find_pressed_part(wheel: Wheel, choice: TurnChoice, mode: Mode, sense: float) -> PressedPart:
    """Return the part of a wheel that a hand presses at its entry, with what the scan shows of it there.

    Raises:
        ValueError: the hand cannot enter there.
    """
    if mode == "grasp":
        place = wheel.radius * np.array([np.cos(choice.entry), np.sin(choice.entry)])
        return find_pressed(wheel.seen, RIM, (float(place[0]), float(place[1])), RIM_NEAR)
    held = place_peg(wheel, choice.hand, choice.entry, sense)
    if isinstance(held, str):
        raise ValueError(held)
    if held.spoke is None:
        source = "the request gives" if wheel.seen is None else "the scan shows"
        remedy = (
            f"{source} no spokes: give the wheel's spokes_deg (with centre, axis and radius), or turn it with "
            "mode: grasp"
        )
        return PressedPart("spoke", "assumed", remedy=remedy)
    name = held.spoke.body.removeprefix(f"{VALVE_LINK}/")
    if wheel.grip > 0.0:  # a short grip counts whole: of one that points at the sensor only the end is seen
        return find_pressed(wheel.seen, name, (0.5 * wheel.grip, 0.0), wheel.grip)
    return find_pressed(wheel.seen, name, (held.arm, 0.0))


def _find_next_entry(wheel: Wheel, mode: Mode, choice: TurnChoice, stroke: Stroke) -> float:
    """Return the usable entry nearest, in the world, to where the first stroke entered."""
    usable = list_usable_entries(wheel, choice.hand, mode, stroke.sense)
    if not usable:
        raise ValueError("no entry for a stroke")
    return min(usable, key=lambda entry: abs(wrap_angle(entry + stroke.first - choice.entry)))


def _make_peg_stroke(
    wheel: Wheel, choice: TurnChoice, stroke: Stroke, suffix: str, friction: float
) -> tuple[TaskPhase, ...]:
    """Return the phases of a stroke of the hook: reach, insert, turn, retract."""
    hand = choice.hand
    held = place_peg(wheel, hand, choice.entry, stroke.sense)
    if isinstance(held, str):
        raise ValueError(held)
    first, last = np.array([stroke.first]), np.array([stroke.last])
    touches = make_peg_allowances(wheel, hand, held)
    line = find_hold(wheel, choice, "hook", stroke.sense)
    motion = replace(line, offset=None)
    loads = list_peg_loads(wheel, hand, held, stroke.torque_nm, friction)
    return (
        TaskPhase(f"reach{suffix}", first, first),
        TaskPhase(f"insert{suffix}", first, first, (line,), touches),
        TaskPhase(
            f"{TURN}{suffix}", first, last, (motion,), touches, targets=(make_circle(wheel, motion),), loads=loads
        ),
        TaskPhase(f"retract{suffix}", last, last, (replace(line, leaves=True),), touches),
    )


def list_peg_loads(
    wheel: Wheel, hand: Hand, held: PegPlace, torque_nm: float, friction: float = HAND_FRICTION[1]
) -> tuple[HandLoad, ...]:
    """Return what a peg exerts on a wheel that it turns: its pressure, and the largest friction beside it.

    The hand does not turn with the wheel, so that the peg's side slides on the spoke, by its radius times the angle.
    What touches moves outwards on the wheel whatever the sense of the turn; so does the friction on it, and the hand is
    drawn towards the hub.  The pressure is at the peg's side, and the friction acts along the spoke's face: where the
    peg's own middle is beyond that face, friction takes some of the torque.
    """
    against = friction * hand.peg_radius if held.spoke is None else 0.0
    pressure = torque_nm / (held.arm - against)
    out = np.cross(held.push, np.cross(held.place, held.push))
    out = out - (out @ wheel.axis) * wheel.axis
    beside = friction * pressure / np.linalg.norm(out) * out
    return tuple(HandLoad(hand.peg, VALVE_LINK, held.place, force) for force in (pressure * held.push, beside))


def _make_grip_stroke(wheel: Wheel, choice: TurnChoice, stroke: Stroke, suffix: str) -> tuple[TaskPhase, ...]:
    """Return the phases of a stroke of a gripper: reach, insert, close, turn, open, retract."""
    hand = choice.hand
    held = place_grip(wheel, choice.entry, choice.is_flipped)
    if isinstance(held, str):
        raise ValueError(held)
    first, last = np.array([stroke.first]), np.array([stroke.last])
    touches = make_grip_allowances(wheel, hand)
    line = find_hold(wheel, choice, "grasp", stroke.sense)
    motion = replace(line, offset=None)
    load = HandLoad(hand.tool, VALVE_LINK, held.place, stroke.sense * stroke.torque_nm / held.arm * held.push)
    opened, closed = (dict.fromkeys(hand.grips, (value, value)) for value in (held.opened, held.closed))
    closes, opens = (
        dict.fromkeys(hand.grips, ends) for ends in ((held.opened, held.closed), (held.closed, held.opened))
    )
    stays_open, stays_closed = (make_finger_targets(hand, value) for value in (held.opened, held.closed))
    return (
        TaskPhase(f"reach{suffix}", first, first),
        TaskPhase(f"insert{suffix}", first, first, (line,), targets=stays_open, joints=opened),
        TaskPhase(f"close{suffix}", first, first, (motion,), touches, joints=closes),
        TaskPhase(
            f"{TURN}{suffix}",
            first,
            last,
            (motion,),
            touches,
            targets=(make_circle(wheel, motion), *stays_closed),
            joints=closed,
            loads=(load,),
        ),
        TaskPhase(f"open{suffix}", last, last, (motion,), touches, joints=opens),
        TaskPhase(f"retract{suffix}", last, last, (replace(line, leaves=True),), targets=stays_open, joints=opened),
    )


def make_circle(wheel: Wheel, motion: FrameMotion) -> CircleTarget:
    """Return the promise that a hand's frame moves on a circle about the wheel's axis, its own axis against it."""
    height = float(motion.place @ wheel.axis)
    radius = float(np.linalg.norm(motion.place - height * wheel.axis))
    centre = wheel.centre + height * wheel.axis
    return CircleTarget(motion.tool, centre, wheel.axis, radius, motion.tolerance_m, -AXIS, motion.tilt_rad)
