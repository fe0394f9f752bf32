"""What a door task demands of any motion: the door itself, and the choices that a plan may make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import Mechanism, RobotModel
from costs.scene import ConvexPiece
from perception.detect.door.bodies import LEAF_LINK
from perception.detect.door.geometry import UP, DoorGeometry, HandleGeometry
from perception.detect.door.model import choose_opening
from service.demands.door.door import Door
from service.demands.door.frame import list_free_openings
from service.demands.door.phases import (
    LEAST_GRIP,
    PEG_LEAN,
    PEG_SPACE,
    TOUCH_DEPTH,
    DoorChoice,
    Push,
    hold_handle,
    make_door_phases,
)
from service.demands.figures.travel import measure_door
from service.demands.hands import Hand, list_robot_hands
from service.demands.holds.door_edge import MOST_SLANT, hold_edge
from service.demands.phase import AXIS, DEPTH_RESERVE, TaskPhase
from service.demands.rest.phases import RestTask, check_travel, start_mechanism
from service.errors import RequestError
from service.request.resume import HandleChoice, LeafChoice, ResumeRequest
from service.request.tasks.door import LEAF_JOINT, DoorRequest, HandleRequest
from service.verify import JointTarget, Motion, Phase, RelativePoseTarget

if TYPE_CHECKING:
    from perception import SeenPart

SAME_PLACE_M = 1e-6
SURE = 0.5  # least confidence of a detection that is used
DEFAULT_LENGTHS = {"lever": 0.12, "pull": 0.3, "push_bar": 0.7, "knob": 0.06}


@dataclass(frozen=True)
class SeenDoor:
    """A door that a scan shows.

    Attributes:
        geometry: leaf and handle.
        confidence: 0 to 1.
        knows_hinge: whether the scan shows on which side the hinges are.
    """

    geometry: DoorGeometry
    confidence: float
    knows_hinge: bool = True


def choose_door(
    request: DoorRequest, seen: Sequence[SeenDoor], robot: Float[np.ndarray, "3"], pieces: Sequence[ConvexPiece] = ()
) -> DoorGeometry | str:
    """Return the door to open, or a sentence why there is none.

    Args:
        request: the task.
        seen: doors of the scan, the best first.
        robot: (3,) place of the robot's base in the world [m].
        pieces: of the scene: a way in which the leaf meets its frame at once is not the one in which it opens.
    """
    given = read_given_door(request, robot)
    if given is not None:
        return given
    if not seen:
        return "no door was found in the scan; task.door.hint (a point near it) would help, or leaf and handle"
    geometry, confidence = seen[0].geometry, seen[0].confidence
    place = np.round(geometry.hinge + 0.5 * geometry.width * geometry.along, 2).tolist()
    side = "right" if np.cross(UP, geometry.normal) @ geometry.along < 0.0 else "left"
    if not seen[0].knows_hinge and request.hinge == "auto":
        return (
            f"the scan shows a door at {place}, shut, and not on which side its hinges are; say it in task.door.hinge "
            "(left or right, as seen by the robot)"
        )
    if confidence >= SURE and request.hinge not in ("auto", side):
        return f"the scan shows the hinges of the door at {place} on its {side}; task.door.hinge is {request.hinge}"
    if confidence < SURE:
        return (
            f"no door was found with confidence: the best candidate, at {place}, has {confidence:.2f} of the {SURE} "
            "needed; task.door.hint (a point near it) would help, or leaf and handle"
        )
    if request.opens != "auto":
        return choose_opening(geometry, request.opens)
    if geometry.opens is None:
        free = list_free_openings(geometry, pieces)
        if len(free) == 1:
            return choose_opening(geometry, free[0])
        frame = "" if free else ": either way the leaf would meet what is beside it"
        return f"the scan does not show whether the door opens by a push or a pull{frame}; say it in task.door.opens"
    return geometry


def read_given_door(request: DoorRequest, robot: Float[np.ndarray, "3"]) -> DoorGeometry | None:
    """Return the door that a request gives; None where the scan must show it.

    Args:
        request: the task.
        robot: (3,) place of the robot's base in the world, which tells the sides of the leaf apart [m].
    """
    leaf = request.leaf
    if leaf is None:
        return None
    hinge, edge = np.array(leaf.hinge), np.array(leaf.edge)
    along = (edge - hinge) * [1.0, 1.0, 0.0]
    width = float(np.linalg.norm(along))
    along = along / width
    normal = np.cross(UP, along)
    normal = normal if (robot - hinge) @ normal > 0.0 else -normal
    is_push = request.opens == "push"
    face = leaf.face_m if leaf.face_m is not None else (leaf.thickness_m if is_push else 0.0)
    return DoorGeometry(
        hinge,
        along,
        normal,
        face,
        width,
        leaf.height_m,
        leaf.thickness_m,
        "push" if is_push else "pull",
        float(np.deg2rad(leaf.ajar_deg)),
        None if request.handle is None else _read_handle(request.handle, along),
        0.0 if request.handle is None else float(np.deg2rad(request.handle.turned_deg)),
    )


def _read_handle(handle: HandleRequest, along: Float[np.ndarray, "3"]) -> HandleGeometry:
    default = {"lever": -along, "pull": UP, "push_bar": along, "knob": np.cross(UP, along)}[handle.kind]
    direction = default if handle.direction is None else np.array(handle.direction)
    length = DEFAULT_LENGTHS[handle.kind] if handle.length_m is None else handle.length_m
    direction = direction / np.linalg.norm(direction)
    return HandleGeometry(handle.kind, np.array(handle.centre), direction, length, handle.radius_m)


def make_door(request: DoorRequest, geometry: DoorGeometry, seen: tuple[SeenPart, ...] | None = None) -> Door:
    """Return a door with the request's loads and release.

    Args:
        request, geometry: the task, and leaf and handle.
        seen: parts that the scan shows; None where the request gives the door.
    """
    is_bar = geometry.handle is not None and geometry.handle.kind == "push_bar"
    release = request.press_m if is_bar else float(np.deg2rad(request.release_deg))
    return Door(geometry, release, request.lever_nm, request.hinge_nm, request.push_bar_n, seen)


def measure_peg(robot: RobotModel, hand: Hand) -> float:
    """Return the length of a hand's free rod [m]."""
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    tool, stub = (data.oMf[model.getFrameId(frame)].translation for frame in (hand.tool, hand.stub))
    return float(np.linalg.norm(tool - stub))


def measure_lever_room(robot: RobotModel, hand: Hand, radius: float) -> float:
    """Return how far a pulled lever's middle has to be off its leaf for the peg behind it and the hand above it [m].

    The hand may turn about its axis; the peg may be as deep in the leaf as the waypoints allow it.

    Args:
        robot: the robot.
        hand: the hand.
        radius: half the lever's thickness [m].
    """
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    stub = data.oMf[model.getFrameId(hand.stub)]
    behind = (radius + hand.peg_radius + PEG_SPACE) / np.cos(PEG_LEAN)
    turns = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    sides = np.stack([np.cos(turns), np.sin(turns)])
    room = 0.0
    for body in robot.bodies:
        if body.link in (hand.link, hand.hook):
            pose = data.oMi[body.joint]
            points = (body.vertices @ pose.rotation.T + pose.translation - stub.translation) @ stub.rotation
            reach = points[:, :2] @ sides * np.cos(PEG_LEAN) + points[:, 2:] * np.sin(PEG_LEAN)
            allowed = TOUCH_DEPTH - DEPTH_RESERVE if body.link == hand.hook else 0.0
            room = max(room, behind + float(reach.max(axis=0).min()) - allowed)
    return room


@dataclass(frozen=True)
class DoorDemand:
    """What the task of opening a door demands, and the choices it leaves: hand, grip, and how far it stays there.

    Attributes:
        door: leaf, handle and loads.
        request: the task.
        robot: without the door.
    """

    door: Door
    request: DoorRequest
    robot: RobotModel

    @property
    def mechanism(self) -> Mechanism:
        """Leaf and handle."""
        return self.door.mechanism

    def read_choices(self, recorded: Motion) -> tuple[tuple[TaskPhase, ...], tuple[str, ...]]:
        """Return the phases with the record's choices, and a sentence for each that the task forbids."""
        choice, problems = self.read_choice(recorded)
        return (() if choice is None else make_door_phases(self.door, choice)), problems

    def read_choice(self, recorded: Motion) -> tuple[DoorChoice | None, tuple[str, ...]]:
        """Return the record's choice, and a sentence for each part of it that the task forbids."""
        phases = {phase.name: phase for phase in recorded.phases}
        opened, pushed = phases.get("open"), phases.get("push 2", phases.get("push"))
        if opened is None and pushed is None:
            return None, ("no phase opens the door",)
        last = _read_leaf_angle(pushed if pushed is not None else opened)
        target = float(np.deg2rad(self.request.open_deg))
        loose = self.door.explain_loose(target)
        problems = [] if loose is None else [loose]
        if last is None or abs(last - target) > 1e-6:
            problems.append(f"the leaf is not opened to the {self.request.open_deg:g} deg of the request")
        push = None if pushed is None else self._read_push(pushed)
        if isinstance(push, str):
            return None, (*problems, push)
        choice: DoorChoice | str
        if opened is None:
            if push is None:
                return None, (*problems, "no phase opens the door")
            peg = measure_peg(self.robot, push.hand)
            choice = DoorChoice(push.hand, peg, 0.0, 1.0, self.door.geometry.ajar, push, self.request.stays)
        else:
            choice = self._read_hold(opened, push)
        if isinstance(choice, str):
            return None, (*problems, choice)
        return choice, tuple(problems)

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure what the motion does to the door: angles, the free width, and loads it could hold."""
        return measure_door(self.door, motion)

    def keep_choices(self, recorded: Motion) -> dict[str, Any] | str:
        """Return the sections ``handle`` and ``leaf`` of ``resume``, or a sentence why a record has none."""
        choice, problems = self.read_choice(recorded)
        return "; ".join(problems) if choice is None or problems else dict(keep_door_choice(choice, self.door))

    def _list_hands(self) -> list[Hand]:
        return [hand for hand in list_robot_hands(self.robot) if self.request.hand in ("auto", hand.side)]

    def _read_push(self, phase: Phase) -> Push | str:
        """Return hand, place and angle of a phase that pushes the leaf."""
        geometry, last = self.door.geometry, _read_leaf_angle(phase)
        if last is not None and not self.door.is_push:
            edge = self._read_edge(phase, last)
            if edge is not None:
                return edge
        for hand in self._list_hands():
            for hold in _list_holds(phase, hand.tool, LEAF_LINK):
                along, up = float(hold.position @ geometry.along), float(hold.position @ UP)
                if last is None or not (0.0 < along < geometry.width and 0.0 < up < geometry.height):
                    return f"the hand is not on the leaf in phase '{phase.name}'"
                return Push(hand, along, up, last)
        return f"no hand that the task permits is on the leaf in phase '{phase.name}'"

    def _read_edge(self, phase: Phase, last: float) -> Push | None:
        """Return how a phase pulls the leaf by its free edge; None where it does not."""
        geometry = self.door.geometry
        for hand in self._list_hands():
            for target in _list_holds(phase, hand.peg, LEAF_LINK):
                slant = float(np.arcsin(np.clip(target.rotation @ AXIS @ UP, -1.0, 1.0)))
                push = Push(hand, geometry.width, float(target.position @ UP), last, slant)
                hold = hold_edge(geometry, push)[0]
                is_there = np.linalg.norm(hold.place - target.position) <= SAME_PLACE_M
                if is_there and abs(slant) <= MOST_SLANT + SAME_PLACE_M and 0.0 < push.up < geometry.height:
                    return push
        return None

    def _read_hold(self, phase: Phase, push: Push | None) -> DoorChoice | str:
        """Return the choice whose hold a phase that opens the leaf promises."""
        last, handle = _read_leaf_angle(phase), self.door.handle
        if last is None or handle is None or handle.kind == "knob":
            return f"phase '{phase.name}' does not open the leaf by a handle"
        pressed = self.door.pressed if self.door.is_latched else 0.0
        pressed = max(pressed, self.door.geometry.handle_turn) if handle.kind == "lever" else pressed
        for hand in self._list_hands():
            for sense in (1.0, -1.0) if handle.kind == "pull" else (1.0,):
                centred = DoorChoice(
                    hand, measure_peg(self.robot, hand), 0.0, sense, last, push, self.request.stays and push is None
                )
                hold = hold_handle(self.door, centred)
                middle = hold.on_leaf(pressed).place
                bar = hold_handle(self.door, replace(centred, grip=1.0)).on_leaf(pressed).place - middle
                for target in _list_holds(phase, hold.tool, LEAF_LINK):
                    grip = float((target.position - middle) @ bar)
                    if np.linalg.norm(target.position - middle - grip * bar) <= SAME_PLACE_M:
                        low, high = (LEAST_GRIP, handle.length) if handle.kind == "lever" else (
                            -0.5 * handle.length, 0.5 * handle.length
                        )  # fmt: skip
                        if not low - SAME_PLACE_M <= grip <= high + SAME_PLACE_M:
                            return f"the hand is {grip:.3f} m along the handle, beyond what the task permits"
                        return replace(centred, grip=grip, stays=self.request.stays)
        return f"no hand that the task permits holds the handle in phase '{phase.name}'"


def keep_door_choice(choice: DoorChoice, door: Door) -> dict[str, HandleChoice | LeafChoice]:
    """Return the sections ``handle`` and ``leaf`` of ``resume`` for a plan's choice."""
    push, hand = choice.push, choice.hand
    kept: dict[str, HandleChoice | LeafChoice] = {
        "handle": HandleChoice(
            hand.side, choice.grip, choice.first, choice.sense > 0.0, door.geometry.ajar, door.geometry.handle_turn
        )
    }
    if push is not None:
        kept["leaf"] = LeafChoice(push.hand.side, push.along, push.up, push.last, push.slant)
    return kept


def set_back(door: Door, resume: ResumeRequest | None) -> Door:
    """Return the door as the earlier plan found it; a new scan shows it as it is now."""
    if resume is None or resume.handle is None:
        return door
    kept = resume.handle
    return replace(door, geometry=replace(door.geometry, ajar=kept.ajar_rad, handle_turn=kept.turned_rad))


def read_kept_choice(door: Door, request: DoorRequest, resume: ResumeRequest, robot: RobotModel) -> DoorChoice:
    """Return the choice of an earlier plan that the rest of it keeps.

    Raises:
        RequestError: the request has none, or the task forbids it.
    """
    handle, leaf = resume.handle, resume.leaf
    if handle is None:
        raise RequestError("resume.handle: is missing; a door is opened as the earlier plan chose to")
    target = float(np.deg2rad(request.open_deg))
    last = handle.until_rad if leaf is None else leaf.until_rad
    problems = []
    for field, kept in (("handle", handle), ("leaf", leaf)):
        if kept is not None and request.hand not in ("auto", kept.hand):
            problems.append(f"resume.{field}.hand: {kept.hand}; task.door.hand permits {request.hand}")
    if abs(last - target) > 1e-6:
        field = "handle" if leaf is None else "leaf"
        problems.append(
            f"resume.{field}.until_rad: {last:.6g} opens the leaf by {np.rad2deg(last):.1f} deg; "
            f"expected the {request.open_deg:g} deg of the task"
        )
    size = door.geometry
    if leaf is not None and not _is_on_leaf(leaf, door):
        problems.append("resume.leaf: the place is not on the leaf")
    bar = door.handle
    is_held = handle.until_rad > size.ajar
    if is_held and (bar is None or bar.kind == "knob"):
        problems.append("resume.handle: the door has no handle that can be held")
    elif is_held and bar is not None:
        low, high = (LEAST_GRIP, bar.length) if bar.kind == "lever" else (-0.5 * bar.length, 0.5 * bar.length)
        if not low - SAME_PLACE_M <= handle.grip_m <= high + SAME_PLACE_M:
            problems.append(f"resume.handle.grip_m: {handle.grip_m:.3f}; expected {low:.3f} to {high:.3f}")
    if problems:
        raise RequestError(problems)
    hands = {hand.side: hand for hand in list_robot_hands(robot)}
    missing = [kept.hand for kept in (handle, leaf) if kept is not None and kept.hand not in hands]
    if missing:
        raise RequestError(f"resume: the robot has no {missing[0]} hand")
    push = None if leaf is None else Push(hands[leaf.hand], leaf.along_m, leaf.up_m, leaf.until_rad, leaf.slant_rad)
    hand = hands[handle.hand]
    sense = 1.0 if handle.is_towards_hinge else -1.0
    return DoorChoice(hand, measure_peg(robot, hand), handle.grip_m, sense, handle.until_rad, push, request.stays)


def _is_on_leaf(leaf: LeafChoice, door: Door) -> bool:
    """Return whether a hand is on the leaf's face, or behind the free edge of a leaf that is pulled."""
    size = door.geometry
    if leaf.slant_rad is None:
        return 0.0 < leaf.along_m < size.width and 0.0 < leaf.up_m < size.height
    is_at_edge = abs(leaf.along_m - size.width) <= SAME_PLACE_M and abs(leaf.slant_rad) <= MOST_SLANT + SAME_PLACE_M
    return is_at_edge and 0.0 < leaf.up_m < size.height and not door.is_push


def make_door_rest(demand: DoorDemand, resume: ResumeRequest) -> RestTask:
    """Return what the rest of a door task demands.

    Raises:
        RequestError: its phase, mechanism or choices do not fit the task.
    """
    choice = read_kept_choice(demand.door, demand.request, resume, demand.robot)
    specs = make_door_phases(demand.door, choice)
    mechanism = start_mechanism(demand.mechanism, resume.mechanism)
    check_travel(mechanism, specs, resume.phase)
    return RestTask(mechanism, specs, resume.phase, demand.measure)


def _list_holds(phase: Phase, tool: str, link: str) -> list[RelativePoseTarget]:
    return [
        target
        for target in phase.targets
        if isinstance(target, RelativePoseTarget)
        and (target.frame, target.reference) == (tool, link)
        and target.position_tolerance_m < 1.0
    ]


def _read_leaf_angle(phase: Phase | None) -> float | None:
    """Return the angle that a phase opens the leaf to [rad]."""
    targets = () if phase is None else phase.targets
    return next((t.value for t in targets if isinstance(t, JointTarget) and t.joint == LEAF_JOINT), None)
