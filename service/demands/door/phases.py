"""Demands of a door task: how a hand holds each kind of handle, and the phases."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.allowance import Allowance, BodyRef
from perception.detect.door.bodies import HANDLE_LINK, LEAF_LINK
from perception.detect.door.geometry import UP
from service.demands.door.door import Door
from service.demands.hands import Hand
from service.demands.holds.door_edge import hold_edge, make_edge_load
from service.demands.holds.leaving import LET_GO, may_drag
from service.demands.holds.pressed import add_pressed, find_pressed
from service.demands.phase import FrameMotion, TaskPhase
from service.request.tasks.door import HANDLE_JOINT, LEAF_JOINT
from service.verify import HandLoad

if TYPE_CHECKING:
    pass

TOUCH_DEPTH = 6e-3  # allowed overlap of a contact body and what it touches [m]
LEAST_GRIP = 0.1  # of a lever from its spindle: 20 N for 2 N m [m]
GRIP_FROM_END = 0.02  # [m]
LINE_OUT, LINE_UP = 0.09, 0.04  # of the lines that lead to a handle and away from it [m]
OFF_LEVER = 0.03  # of a hand that leaves a lever upwards before it goes away along the way of its leaf [m]
HELD_TILT, PULL_TILT, PUSH_TILT = np.deg2rad(5.0), np.deg2rad(20.0), np.deg2rad(20.0)
TILT_RESERVE = np.deg2rad(2.0)
PEG_LEAN, LEAN_TILT = np.deg2rad(22.0), np.deg2rad(7.0)  # of the peg behind a lever
ABOVE_LEVER = 1.5e-3  # of the hand's front, which leans [m]
PEG_SPACE = 1e-3  # between a peg and a bar: both are polygons, and the peg leans [m]
PEG_ACROSS = np.deg2rad(30.0)  # between the peg behind a pull handle and the leaf
PLACE_TOLERANCE = 5e-3  # [m]
LEAF, LEAF_NEAR = "leaf", 0.15  # name of the leaf, and distance from a hold within which it is counted [m]
PUSH_SLIDE = 0.1  # of the peg's tip along the leaf [m]
GIVES_WAY = 0.2  # share of the force that releases a handle, for which one at rest hardly moves [-]


@dataclass(frozen=True)
class Push:
    """Where a hand pushes the leaf: the tip of its peg on the face, or the peg's side behind the free edge.

    Attributes:
        hand: the hand.
        along, up: place on the leaf from the hinge axis and from its lower edge [m].
        last: opening angle at the end [rad].
        slant: of a peg behind the free edge: angle by which it points up; None of one whose tip is on the face [rad].
    """

    hand: Hand
    along: float
    up: float
    last: float
    slant: float | None = None


@dataclass(frozen=True)
class DoorChoice:
    """Choices of a plan, among those the task permits.

    Attributes:
        hand: the hand at the handle.
        peg_m: length of its free peg [m].
        grip: place of the hand along the bar, from the spindle or the bar's middle [m].
        sense: of a pull handle: 1 if the peg points to the hinge, -1 if away from it.
        first: opening angle that the hand reaches at the handle; the start's if the leaf is only pushed [rad].
        push: regrasp on the leaf, or None.
        stays: whether the hand stays on the leaf at the end.
    """

    hand: Hand
    peg_m: float
    grip: float
    sense: float
    first: float
    push: Push | None = None
    stays: bool = False


def make_door_phases(door: Door, choice: DoorChoice) -> tuple[TaskPhase, ...]:
    """Return the phases of a plan: at the handle, and on the leaf after a regrasp."""
    phases: list[TaskPhase] = []
    start = door.mechanism.start
    if choice.first > start[0]:
        specs = _open_at_handle(door, choice, start)
        phases += add_pressed(specs, find_pressed(door.seen, door.handle_name, (choice.grip, 0.0)))
    if choice.push is not None:
        at = phases[-1].last if phases else start
        specs = _push_leaf(door, choice, choice.push, at, is_second=bool(phases))
        place = choice.push.along, choice.push.up
        phases += add_pressed(specs, find_pressed(door.seen, LEAF, place, LEAF_NEAR))
    bears = _list_resistances(door)
    return tuple(replace(phase, bears=bears) for phase in phases)


def _list_resistances(door: Door) -> dict[str, tuple[float, float]]:
    """Return by joint the forces of a hand that it bears by itself: the hinge's friction, little of a handle's spring.

    A handle at rest gives way as its spring does, and stays in the hand for a small share of what releases it.  A leaf
    that opens early, while its handle is pressed, goes the way that it is to go.
    """
    gives_way = np.inf if door.has_push_bar else GIVES_WAY * door.lever_nm  # a bar may be pressed further
    return {LEAF_JOINT: (-door.hinge_nm, np.inf), HANDLE_JOINT: (0.0, gives_way)}


def _open_at_handle(door: Door, choice: DoorChoice, start: Float[np.ndarray, "k"]) -> list[TaskPhase]:
    """Return reach, approach, press, open, let the handle go and retract; before it, leave the handle if need be."""
    held = hold_handle(door, choice)
    pressed, opened, released = start.copy(), start.copy(), start.copy()
    presses = door.is_latched
    if presses:
        pressed[1] = opened[1] = max(door.pressed, start[1])
    opened[0] = released[0] = choice.first
    on_leaf = held.on_leaf(float(pressed[1]) if len(pressed) > 1 else 0.0)
    at_rest = held.at_rest(start)
    phases = [
        TaskPhase("reach", start, start),
        TaskPhase("approach", start, start, (held.line(at_rest),), held.touches),
    ]
    if presses:
        name = "turn the handle" if door.handle is not None and door.handle.kind == "lever" else "press the bar"
        phases.append(TaskPhase(name, start, pressed, (at_rest,), held.touches, loads=held.press_loads()))
    loads = held.open_loads(on_leaf, presses=presses)
    phases.append(TaskPhase("open", pressed, opened, (on_leaf,), held.touches, loads=loads))
    if choice.stays and choice.push is None:
        return phases
    if presses:
        name = "let the handle go"
        phases.append(TaskPhase(name, opened, released, (at_rest,), held.touches, loads=held.press_loads()))
    away = replace(held.line(at_rest), leaves=True)
    if presses and held.leaves_along_leaf and _may_close(door, held):
        off = OFF_LEVER * UP
        phases.append(TaskPhase(LET_GO, released, released, (replace(away, offset=off),), held.touches))
        away = replace(away, place=away.place + off, offset=held.offset - (held.offset @ UP) * UP)
    phases.append(TaskPhase("retract", released, released, (away,), held.touches))
    return phases


def _may_close(door: Door, held: HandleHold) -> bool:
    """Return whether a hand that slides off a handle could take the leaf back along."""
    force = max((float(np.linalg.norm(load.force)) for load in held.press_loads()), default=0.0)
    arm = float(np.linalg.norm(np.cross(door.geometry.hinge_axis, held.on_leaf(0.0).place)))
    return may_drag(force, arm, door.hinge_nm)


def _push_leaf(
    door: Door, choice: DoorChoice, push: Push, at: Float[np.ndarray, "k"], *, is_second: bool
) -> list[TaskPhase]:
    """Return reach, touch, push and retract of a hand that pushes the leaf open."""
    geometry = door.geometry
    suffix = " 2" if is_second else ""
    side = -1.0 if door.is_push else 1.0  # a leaf that opens towards the robot is pushed on its back
    face = geometry.face if door.is_push else geometry.face - geometry.thickness
    place = push.along * geometry.along + face * geometry.normal + push.up * UP
    tip = FrameMotion(
        push.hand.tool, LEAF_LINK, place, side * geometry.normal, slide=PUSH_SLIDE * geometry.along,
        tolerance_m=PLACE_TOLERANCE, tilt_rad=float(PUSH_TILT), aim_rad=float(PUSH_TILT - TILT_RESERVE),
    )  # fmt: skip
    touches = (_allow(push.hand.hook, LEAF_LINK, "leaf"),)
    line = replace(tip, offset=-side * LINE_OUT * geometry.normal)
    load = HandLoad(push.hand.tool, LEAF_LINK, place, side * _find_force(door, push) * geometry.normal, tip.slide)
    if push.slant is not None:
        tip, offset, normal = hold_edge(geometry, push)
        line, load = replace(tip, offset=offset), make_edge_load(geometry, tip, normal, door.hinge_nm)
    last = at.copy()
    last[0] = push.last
    phases = [
        TaskPhase(f"reach{suffix}", at, at),
        TaskPhase(f"touch{suffix}", at, at, (line,), touches),
        TaskPhase(f"push{suffix}", at, last, (tip,), touches, loads=(load,)),
    ]
    if not choice.stays:
        away = replace(line, leaves=True)
        phases.append(TaskPhase(f"retract{suffix}", last, last, (away,), touches))
    return phases


def _find_force(door: Door, push: Push) -> float:
    """Return the force of a tip that opens the leaf wherever it slides [N]."""
    return door.hinge_nm / max(push.along - PUSH_SLIDE, 0.05)


@dataclass(frozen=True)
class HandleHold:
    """How a hand holds a handle; places are in the link of the handle, with the leaf shut and the lever at rest.

    Attributes:
        door: the door.
        tool: frame at the contact.
        place: (3,) of the tool from the handle's centre [m].
        contact: (3,) where the hand presses, from the handle's centre [m].
        axis: (3,) unit, of the hand, in the leaf.
        offset: (3,) from which a line leads to the handle [m].
        tilt: largest lean of the hand from ``axis`` [rad].
        touches: pairs that may touch.
        lean: largest angle between the leaf and a peg behind a bar, which draws the hand along the leaf [rad].
        leaves_along_leaf: whether the line leads away along the face that is pressed, the way that the leaf shuts.
    """

    door: Door
    tool: str
    place: Float[np.ndarray, "3"]
    contact: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    offset: Float[np.ndarray, "3"]
    tilt: float
    touches: tuple[Allowance, ...]
    lean: float = 0.0
    leaves_along_leaf: bool = False

    def at_rest(self, start: Float[np.ndarray, "k"]) -> FrameMotion:
        """Return the hold that moves with the handle; with the leaf where the handle has no joint of its own."""
        if len(start) == 1:
            return self.on_leaf(0.0)
        return self._motion(HANDLE_LINK, self.place)

    def on_leaf(self, value: float) -> FrameMotion:
        """Return the hold that moves with the leaf, given the value of the handle's joint."""
        return self._motion(LEAF_LINK, self._in_leaf(self.place, value))

    def line(self, motion: FrameMotion) -> FrameMotion:
        """Return the straight line that ends at a hold."""
        return replace(motion, offset=self.offset)

    def press_loads(self) -> tuple[HandLoad, ...]:
        """Return what turns the lever or presses the bar."""
        door, handle = self.door, self.door.handle
        if handle is None or handle.kind not in ("lever", "push_bar"):
            return ()
        if handle.kind == "push_bar":
            return (HandLoad(self.tool, HANDLE_LINK, self.contact, -door.push_bar_n * door.geometry.normal),)
        arm = float(np.linalg.norm(self.contact))
        moves = np.cross(door.spindle_axis, self.contact) / arm
        return (HandLoad(self.tool, HANDLE_LINK, self.contact, door.lever_nm / arm * moves),)

    def open_loads(self, on_leaf: FrameMotion, *, presses: bool) -> tuple[HandLoad, ...]:
        """Return what moves the leaf, and keeps the handle where it releases if ``presses``.

        What presses a bar pushes the leaf as well: the larger force does both.
        """
        door, place = self.door, on_leaf.place
        flat = place - (place @ UP) * UP
        arm = float(np.linalg.norm(flat))
        moves = np.cross(door.geometry.hinge_axis, flat) / arm
        force = door.hinge_nm / arm
        if presses and door.has_push_bar:
            return (HandLoad(self.tool, LEAF_LINK, place, max(force, door.push_bar_n) * moves),)
        load = HandLoad(self.tool, LEAF_LINK, place, force * moves)
        if not self.lean:
            return (load, *(self.press_loads() if presses else ()))
        # A bar presses square to a peg that leans: what turns the leaf is only a part of the force.
        along = np.cross(moves, door.geometry.hinge_axis)
        along = along * np.sign(along @ self.axis)
        return (load, HandLoad(self.tool, LEAF_LINK, place, force * np.tan(self.lean) * along))

    def _motion(self, link: str, place: Float[np.ndarray, "3"]) -> FrameMotion:
        return FrameMotion(
            self.tool, link, place, self.axis, tolerance_m=PLACE_TOLERANCE, tilt_rad=self.tilt,
            aim_rad=self.tilt - float(TILT_RESERVE), axis_link=LEAF_LINK,
        )  # fmt: skip

    def _in_leaf(self, offset: Float[np.ndarray, "3"], value: float) -> Float[np.ndarray, "3"]:
        """Return a place of the handle in the leaf's frame, given the value of the handle's joint."""
        handle = self.door.handle
        if handle is None:
            raise ValueError("a door without a handle cannot be held at it")
        moved = offset
        if handle.kind == "lever":
            moved = Rotation.from_rotvec(value * self.door.spindle_axis).apply(offset)
        elif handle.kind == "push_bar":
            moved = offset - value * self.door.geometry.normal
        return np.asarray(handle.centre - self.door.geometry.hinge + moved)


def hold_handle(door: Door, choice: DoorChoice) -> HandleHold:
    """Return how the chosen hand holds the door's handle.

    Raises:
        ValueError: the door has no handle, or a knob.
    """
    handle, geometry, hand = door.handle, door.geometry, choice.hand
    if handle is None or handle.kind == "knob":
        raise ValueError("no hand of this robot holds a knob")
    normal, radius = geometry.normal, handle.radius
    peg = radius + hand.peg_radius + PEG_SPACE
    stands_out = float((handle.centre - geometry.hinge) @ normal) - geometry.face
    at_grip = choice.grip * handle.direction
    kind = handle.kind
    if kind == "push_bar":
        up = 0.0
        place = at_grip + radius * normal + up * UP
        pressed = (_allow(hand.hook, HANDLE_LINK, "bar"),)
        return HandleHold(door, hand.tool, place, place, -normal, LINE_OUT * normal, float(PUSH_TILT), pressed)
    if kind == "pull":
        towards = -choice.sense * geometry.along
        axis = np.cos(PEG_ACROSS) * towards - np.sin(PEG_ACROSS) * normal
        behind = -np.cos(PEG_ACROSS) * normal - np.sin(PEG_ACROSS) * towards
        place = at_grip + peg * behind
        hooked = (_allow(hand.hook, LEAF_LINK, "bar"),)
        lean = float(PEG_ACROSS + PULL_TILT)
        return HandleHold(door, hand.peg, place, place, axis, -LINE_OUT * axis, float(PULL_TILT), hooked, lean)
    touches: tuple[Allowance, ...] = (
        _allow(hand.hook, HANDLE_LINK, "lever"),
        _allow(hand.link, HANDLE_LINK, "lever"),
        _allow(hand.hook, LEAF_LINK, "leaf"),
    )
    if door.is_push:  # the peg lies on the lever, the hand's front or the peg's tip pushes
        front = max(radius, choice.peg_m - stands_out)
        place = at_grip + peg * UP + front * normal
        offset = LINE_OUT * normal + LINE_UP * UP
        return HandleHold(
            door, hand.stub, place, at_grip + radius * UP, -normal, offset, float(HELD_TILT), touches,
            leaves_along_leaf=True,
        )  # fmt: skip
    # The peg hangs behind the lever, leaning so that the hand keeps off the leaf; its front rests on the lever.
    axis = -np.cos(PEG_LEAN) * UP - np.sin(PEG_LEAN) * normal
    above = (radius + ABOVE_LEVER) * np.cos(PEG_LEAN) + peg * np.sin(PEG_LEAN)
    place = at_grip - (peg / np.cos(PEG_LEAN) - above * np.tan(PEG_LEAN)) * normal + above * UP
    offset = -(LINE_OUT + choice.peg_m) * axis
    return HandleHold(door, hand.stub, place, at_grip, axis, offset, float(LEAN_TILT), touches)


def _allow(link: str, mechanism_link: str, body: str) -> Allowance:
    other = BodyRef("mechanism", mechanism_link, f"{mechanism_link}/{body}")
    return Allowance(BodyRef.of_link(link), other, TOUCH_DEPTH)
