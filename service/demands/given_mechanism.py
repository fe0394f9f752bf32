"""Demands of a task that moves a mechanism of a URDF: the mechanism, how a hand holds it, and the phases."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.allowance import Allowance, BodyRef
from costs.robot import (
    STOP_ROUNDING,
    Mechanism,
    Release,
    RobotError,
    RobotModel,
    UrdfMechanism,
    check_limits,
    read_mechanism,
    with_mechanism,
)
from costs.scene import ConvexPiece
from service.demands.hands import Hand, list_robot_hands
from service.demands.holds.pressed import add_pressed, find_pressed
from service.demands.holds.pushes import find_nominal_pushes
from service.demands.moved_object.loads import LEAST_LOAD, JointLoad, MovedObject, Spring, choose_pace
from service.demands.moved_object.rest import check_rest
from service.demands.phase_spec import LINE_WAYPOINTS, REACH_WAYPOINTS, HandMotion, PhaseSpec
from service.demands.resume import ResumedDemand, check_travel, find_index, start_mechanism
from service.errors import RequestError, shown, would_do
from service.request.fields import HAND_FRICTION
from service.request.mechanism import MechanismRequest, is_urdf_text
from service.request.names import MECHANISM, STILL
from service.request.resume import ResumeRequest
from service.verify import HandLoad, Motion, RelativePoseTarget
from service.verify.forces.hand_contacts import LEAST_APART_M

TOUCH_DEPTH = 6e-3  # allowed overlap of the hand's rod and what it holds [m]
LINE_OUT = 0.1  # of the line that leads to the handle, where the request gives none [m]
TURN_STEP, SLIDE_STEP = float(np.deg2rad(10.0)), 0.05  # between waypoints [rad, m]
TILT_RESERVE = float(np.deg2rad(2.0))
PLACE_TOLERANCE = 5e-3  # [m]
SETTLED_GAP, SETTLED_DIGITS = 5e-4, 6  # between a hand and what it holds, and decimals of its place [m]
STAYS_SHARE = 0.5  # of what keeps a joint still that counts: friction is known roughly, and hands set on too hard [-]
MOST_LOADS = 4  # at a time: the robot is held under every combination of them
LEAST_ARM = 0.01  # of the handle about a joint that it moves [m]
FIGURE_ROUNDING = {"deg": 0.2, "m": 2e-3}
LEAST_TRAVEL = 1e-6  # of a joint that moves [rad, m]
LIMIT_DIGITS = 9  # of limits, which are kept with their rounding


@dataclass(frozen=True)
class Handle:
    """Where a hand holds the mechanism, with all joints at 0 in the frame of a link of the mechanism.

    Attributes:
        link: the mechanism's link.
        joint: that moves the link.
        place, axis, approach: of the tool, its direction (unit), and of the line that leads there [m].
        slide: the tool may be anywhere on ``place`` +- ``slide`` [m], or None.
        tilt: largest lean of the hand [rad].
        bodies: names of the bodies that the rod may touch.
    """

    link: str
    joint: str
    place: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    approach: Float[np.ndarray, "3"]
    slide: Float[np.ndarray, "3"] | None
    tilt: float
    bodies: tuple[str, ...]


@dataclass(frozen=True)
class GivenMechanism:
    """A mechanism that a request gives by its URDF, checked against the request.

    Attributes:
        request: the task.
        read: what the URDF says.
        handle: where a hand holds it.
    """

    request: MechanismRequest
    read: UrdfMechanism
    handle: Handle

    @cached_property
    def moved(self) -> MovedObject:
        """What acts on the joints: the URDF's masses, damping and friction, and the request's springs.

        Friction that the request states for a joint counts instead of the URDF's.
        """
        stated = self.request.joints
        friction = {name: loads.friction for name, loads in stated.items() if loads.friction is not None}
        joints = tuple(replace(joint, friction=friction.get(joint.name, joint.friction)) for joint in self.read.joints)
        springs = {
            name: Spring(loads.preload, loads.stiffness)
            for name, loads in stated.items()
            if loads.preload > 0.0 or loads.stiffness > 0.0
        }
        releases = tuple(
            Release(release.joint, release.latch, release.at, release.free_beyond) for release in self.request.releases
        )
        whole = MovedObject(joints, springs, self.read.stops, releases)
        return replace(whole, joints=tuple(choose_pace(whole, self.list_moves())))

    @cached_property
    def mechanism(self) -> Mechanism:
        """The joints with the request's starts and latches, and the pace that their loads are made for."""
        return Mechanism(MECHANISM, self.moved.joints, self.moved.releases)

    def list_moves(self) -> list[tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]]:
        """Return the values of all joints before and after each move [rad, m]."""
        names = [joint.name for joint in self.read.joints]
        values = np.array([joint.start for joint in self.read.joints])
        ends = []
        for move in self.request.moves:
            last = values.copy()
            last[names.index(move.joint)] = move.to
            ends.append((values, last))
            values = last
        return ends

    def list_pace_notes(self) -> Iterator[str]:
        """Yield a sentence per moved joint with a pace that its loads assume, for motions whose pace nobody proves."""
        moving = {move.joint for move in self.request.moves}
        for joint in self.moved.joints:
            if joint.name in moving and (self.moved.has_masses or joint.damping > 0.0):
                unit = "m" if joint.kind == "prismatic" else "rad"
                yield (
                    f"task.mechanism: the loads of {joint.name} hold up to {joint.velocity:.3g} {unit}/s and "
                    f"{joint.acceleration:.3g} {unit}/s^2, which an untimed motion leaves open"
                )

    def list_joint_loads(self) -> tuple[tuple[JointLoad, ...], ...]:
        """Return per move what the hand must exert along the joints that carry its handle."""
        carriers = self.read.list_carriers(self.handle.joint)
        return tuple(self.moved.list_loads(first, last, carriers) for first, last in self.list_moves())

    @property
    def pieces(self) -> tuple[ConvexPiece, ...]:
        """Bodies that no joint moves, as pieces of the scene."""
        return tuple(ConvexPiece(name, points) for name, points in self.read.still.items())

    def place_bodies(self) -> list[Float[np.ndarray, "V 3"]]:
        """Return the vertices of all bodies in the world at the start [m]."""
        return [*self.read.still.values(), *self.place_moving(self.mechanism.start)]

    def place_moving(self, values: Float[np.ndarray, "k"]) -> list[Float[np.ndarray, "V 3"]]:
        """Return the vertices of all bodies that joints move, with the joints at ``values`` [m]."""
        return [points for _, points in self.place_named(values)]

    def place_named(self, values: Float[np.ndarray, "k"]) -> Iterator[tuple[str, Float[np.ndarray, "V 3"]]]:
        """Yield names and vertices of all bodies that joints move, with the joints at ``values`` [m]."""
        for joint in self.mechanism.joints:
            pose = self.locate(joint.name, values)
            for name, points in joint.bodies.items():
                yield name, (points - joint.origin) @ pose[:3, :3].T + pose[:3, 3]

    def locate(self, joint: str, values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a joint's link in the world, with the joints at ``values`` [rad, m]."""
        return self.mechanism.locate(self.mechanism.joint(joint).link, values)


def read_given_mechanism(request: MechanismRequest) -> GivenMechanism:
    """Read a request's mechanism, whose URDF is given as text.

    Raises:
        RequestError: one line: the URDF cannot be used, a link or joint is unknown, or a value is past its limits.
        ValueError: the URDF is a path.
    """
    if not is_urdf_text(request.urdf):
        raise ValueError("expected the text of the URDF")
    field = "task.mechanism"
    meshes = {name: np.array(mesh.points) for name, mesh in request.meshes.items()}
    starts = {name: joint.start for name, joint in request.joints.items() if joint.start is not None}
    try:
        read = read_mechanism(request.urdf, "urdf", MECHANISM, STILL, _make_pose(request), starts, meshes)
    except RobotError as error:
        raise RequestError(f"{field}.{' '.join(str(error).split())}") from None
    names = [joint.name for joint in read.joints]
    for name in request.joints:
        if name not in names:
            raise RequestError(
                f"{field}.joints: unknown joint {shown(name)}; the mechanism has {would_do(name, names)}"
                f"{_name_stopped(read)}"
            )
    for k, release in enumerate(request.releases):
        for key, name in (("joint", release.joint), ("latch", release.latch)):
            if name not in names:
                where = f"{field}.releases[{k}].{key}"
                raise RequestError(f"{where}: unknown joint {shown(name)}; expected {would_do(name, names)}")
    handle = _read_handle(request, read)
    _check_moves(request, read, handle)
    given = GivenMechanism(request, read, handle)
    moves = [(move.joint, *ends) for move, ends in zip(request.moves, given.list_moves(), strict=True)]
    check_rest(given.moved, moves, read.list_carriers, handle.joint, stays=request.stays)
    return given


def _make_pose(request: MechanismRequest) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(request.quaternion_wxyz, scalar_first=True).as_matrix()
    pose[:3, 3] = request.position
    return pose


def settle_handle(
    given: GivenMechanism, robot: RobotModel, hand: Hand, friction: tuple[float, float]
) -> GivenMechanism:
    """Return the mechanism with the handle's place moved along the contact's normal until the hand just touches.

    A place in a request is off by some millimetres, by which the mechanism would lag behind the hand.

    Args:
        robot: augmented by the mechanism.
        hand: at the handle.
        friction: least and largest coefficient.
    """
    for spec in make_mechanism_phases(given, hand):
        for nominal in find_nominal_pushes(spec, robot, given.mechanism, friction):
            for contact, meeting in zip(nominal.push.contacts, nominal.met, strict=True):
                if contact.link == given.handle.link and meeting.apart >= LEAST_APART_M:
                    shift = np.round((meeting.gap - SETTLED_GAP) * meeting.normal, SETTLED_DIGITS)
                    return replace(given, handle=replace(given.handle, place=given.handle.place + shift))
    return given


def make_mechanism_phases(
    given: GivenMechanism, hand: Hand, reach_waypoints: int = REACH_WAYPOINTS
) -> tuple[PhaseSpec, ...]:
    """Return the phases: reach, approach, one per move, retract unless the hand stays.

    Raises:
        RequestError: a hand at the handle does not move a joint.
    """
    handle, start = given.handle, given.mechanism.start
    tool = select_tool(given, hand)
    held = HandMotion(
        tool, handle.link, handle.place, handle.axis, slide=handle.slide, tolerance_m=PLACE_TOLERANCE,
        tilt_rad=handle.tilt, aim_rad=handle.tilt - TILT_RESERVE,
    )  # fmt: skip
    line = replace(held, offset=handle.approach)
    links = (hand.hook, hand.link) if given.request.handle.tool == "stub" else (hand.hook,)
    touches = tuple(
        Allowance(BodyRef.of_link(link), BodyRef("mechanism", handle.link, body), TOUCH_DEPTH)
        for link in links
        for body in handle.bodies
    )
    phases = [
        PhaseSpec("reach", start, start, n_waypoints=reach_waypoints),
        PhaseSpec("approach", start, start, line, touches, n_waypoints=LINE_WAYPOINTS),
    ]
    ends = given.list_moves()
    values = ends[-1][1]
    joint_loads = given.list_joint_loads()
    loads = [tuple(_make_loads(given, tool, first, each)) for (first, _), each in zip(ends, joint_loads, strict=True)]
    crowded = next((k for k, carried in enumerate(loads) if len(carried) > MOST_LOADS), None)
    if crowded is not None:
        raise RequestError(
            f"task.mechanism.joints: the hand would carry {len(loads[crowded])} loads, one per joint and direction, in "
            f"moves[{crowded}]; expected at most {MOST_LOADS}"
        )
    travels = [measure_travel(given, first, last) for first, last in ends]
    for k, (move, (first, last)) in enumerate(zip(given.request.moves, ends, strict=True)):
        joint = given.mechanism.joint(move.joint)
        step = SLIDE_STEP if joint.kind == "prismatic" else TURN_STEP
        count = max(int(np.ceil(np.abs(last - first).max() / step)) + 1, 4)
        bears = {
            load.joint: (load.low - STAYS_SHARE * load.slack[0], load.high + STAYS_SHARE * load.slack[1])
            for load in joint_loads[k]
            if load.sense == 0.0
        }
        phases.append(
            PhaseSpec(
                _name_phase(given.request, k),
                first, last, held, touches, loads[k], bears=bears,
                is_anchor=k == int(np.argmax(travels)), aims_at_end=True, step="pose at the handle", n_waypoints=count,
            )
        )  # fmt: skip
    if not given.request.stays:  # a line promises nothing but what may touch: the planner may turn it
        away = replace(line, leaves=True)
        phases.append(PhaseSpec("retract", values, values, away, touches, n_waypoints=LINE_WAYPOINTS))
    return add_pressed(phases, find_pressed(None, given.request.handle.link, (0.0, 0.0)))


def select_tool(given: GivenMechanism, hand: Hand) -> str:
    """Return the frame of a hand that is at the handle's place."""
    return {"peg": hand.peg, "tip": hand.tool, "stub": hand.stub}[given.request.handle.tool]


@dataclass(frozen=True)
class GivenMechanismDemand:
    """What the task of moving a given mechanism demands of any motion, and the choice it leaves: the hand.

    Attributes:
        given: the mechanism and the task.
        robot: without the mechanism.
        friction: least and largest coefficient between hand and mechanism.
    """

    given: GivenMechanism
    robot: RobotModel
    friction: tuple[float, float] = HAND_FRICTION

    @property
    def mechanism(self) -> Mechanism:
        """The joints of the URDF."""
        return self.given.mechanism

    def read_choices(self, recorded: Motion) -> tuple[tuple[PhaseSpec, ...], tuple[str, ...]]:
        """Return the phases with the record's hand, or a sentence that no permitted hand holds the handle."""
        hand = self.find_hand(recorded)
        if hand is None:
            return (), ("no hand that the task permits holds the handle",)
        robot = with_mechanism(self.robot, self.given.mechanism.joints)
        return make_mechanism_phases(settle_handle(self.given, robot, hand, self.friction), hand), ()

    def find_hand(self, recorded: Motion) -> Hand | None:
        """Return the hand that holds the handle in a record; None if none does that the task permits."""
        targets = [target for phase in recorded.phases for target in phase.targets]
        tools = {
            target.frame
            for target in targets
            if isinstance(target, RelativePoseTarget) and target.reference == self.given.handle.link
        }
        side = self.given.request.hand
        for hand in list_robot_hands(self.robot):
            if side in ("auto", hand.side) and tools & {hand.peg, hand.tool, hand.stub}:
                return hand
        return None

    def compare_figures(self, figures: Mapping[str, Any]) -> Iterator[str]:
        """Yield a sentence for each joint whose value at the end is not the request's."""
        yield from _compare_ends(find_ends(self.given), figures)


def read_kept_hand(demand: GivenMechanismDemand, resume: ResumeRequest) -> Hand:
    """Return the hand of an earlier plan, which the rest of it keeps.

    Raises:
        RequestError: the request has none, or the task forbids it.
    """
    if resume.hold is None:
        raise RequestError("resume.hold: is missing; a mechanism is moved with the hand of the earlier plan")
    side = demand.given.request.hand
    if side not in ("auto", resume.hold.hand):
        raise RequestError(f"resume.hold.hand: {resume.hold.hand}; task.mechanism.hand permits {side}")
    hand = next((hand for hand in list_robot_hands(demand.robot) if hand.side == resume.hold.hand), None)
    if hand is None:
        raise RequestError(f"resume.hold.hand: the robot has no {resume.hold.hand} hand")
    return hand


def resume_mechanism(
    demand: GivenMechanismDemand, resume: ResumeRequest, reach_waypoints: int = REACH_WAYPOINTS
) -> ResumedDemand:
    """Return what the rest of a task with a given mechanism demands.

    Raises:
        RequestError: its phase, mechanism or hand do not fit the task.
    """
    hand = read_kept_hand(demand, resume)
    robot = with_mechanism(demand.robot, demand.mechanism.joints)
    given = settle_handle(demand.given, robot, hand, demand.friction)
    specs = make_mechanism_phases(given, hand, reach_waypoints)
    mechanism = start_mechanism(given.mechanism, resume.mechanism)
    check_travel(mechanism, specs, resume.phase)
    rest = specs[find_index(specs, resume.phase) :]
    names = [joint.name for joint in mechanism.joints]
    moved = {names[column] for spec in rest for column in spec.moving}
    ends = find_ends(given)
    for name, (_, unit) in ends.items():
        joint = name.removesuffix(f"_{unit}")
        if joint not in moved:
            start = float(mechanism.start[names.index(joint)])
            ends[name] = (float(np.rad2deg(start)) if unit == "deg" else start, unit)
    return ResumedDemand(mechanism, specs, resume.phase, lambda figures: _compare_ends(ends, figures))


def _compare_ends(ends: Mapping[str, tuple[float, str]], figures: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence for each joint whose value at the end is another."""
    for name, (value, unit) in ends.items():
        figure = figures.get(name)
        if not isinstance(figure, float | int) or abs(figure - value) > FIGURE_ROUNDING[unit]:
            yield f"figures.{name} is {figure}, the request moves it to {value:g}"


def find_ends(given: GivenMechanism) -> dict[str, tuple[float, str]]:
    """Return by figure (``JOINT_deg``, ``JOINT_m``) the value of each moved joint at the end, and its unit."""
    ends = {}
    for move in given.request.moves:
        is_slide = given.mechanism.joint(move.joint).kind == "prismatic"
        unit = "m" if is_slide else "deg"
        ends[f"{move.joint}_{unit}"] = (move.to if is_slide else float(np.rad2deg(move.to)), unit)
    return ends


def _read_handle(request: MechanismRequest, read: UrdfMechanism) -> Handle:
    handle, field = request.handle, "task.mechanism.handle"
    if handle.link not in read.links:
        raise RequestError(
            f"{field}.link: unknown link {shown(handle.link)}; the mechanism has {would_do(handle.link, read.links)}"
        )
    place = read.links[handle.link]
    if place.link is None:
        stopped = _name_stopped(read)
        raise RequestError(f"{field}.link: no joint moves {shown(handle.link)}; expected a link that moves{stopped}")
    joint = next(joint.name for joint in read.joints if joint.link == place.link)
    rotation, shift = place.pose[:3, :3], place.pose[:3, 3]
    axis = rotation @ np.array(handle.axis)
    axis = axis / np.linalg.norm(axis)
    approach = -LINE_OUT * axis if handle.approach is None else rotation @ np.array(handle.approach)
    slide = None if handle.slide is None else rotation @ np.array(handle.slide)
    at = rotation @ np.array(handle.place) + shift
    tilt = float(np.deg2rad(handle.tilt_deg))
    return Handle(place.link, joint, at, axis, approach, slide, tilt, place.bodies)


def _name_stopped(read: UrdfMechanism) -> str:
    """Return the notes about joints that the file stops, for messages that miss one; empty if there are none."""
    return "".join(f" ({note})" for note in read.notes if "velocity limit of 0:" in note)


def _check_moves(request: MechanismRequest, read: UrdfMechanism, handle: Handle) -> None:
    """Refuse moves of joints that the hand does not move, that go nowhere, or past a limit."""
    joints = {joint.name: joint for joint in read.joints}
    values = {name: joint.start for name, joint in joints.items()}
    carriers = read.list_carriers(handle.joint)
    for k, move in enumerate(request.moves):
        field = f"task.mechanism.moves[{k}]"
        if move.joint not in joints:
            # A joint that the file stops has a note about it.
            stopped = next((f" ({note})" for note in read.notes if f"joint '{move.joint}'" in note), "")
            known = would_do(move.joint, joints)
            raise RequestError(f"{field}.joint: unknown joint {shown(move.joint)}; the mechanism has {known}{stopped}")
        if move.joint not in carriers:
            raise RequestError(
                f"{field}.joint: {shown(move.joint)} does not move {shown(request.handle.link)}, which the hand holds; "
                f"expected {would_do(move.joint, carriers)}"
            )
        joint = joints[move.joint]
        low, high = (round(limit, LIMIT_DIGITS) for limit in (joint.lower + STOP_ROUNDING, joint.upper - STOP_ROUNDING))
        try:
            check_limits(joint.kind, move.to, low, high, f"{field}.to")
        except RobotError as error:
            raise RequestError(str(error)) from None
        if abs(move.to - values[move.joint]) < LEAST_TRAVEL:
            raise RequestError(f"{field}.to: {move.joint} is at {move.to:g} already; expected another value")
        for release in request.releases:
            is_released = values[release.latch] * np.sign(release.at) >= abs(release.at)
            if release.joint == move.joint and abs(values[move.joint]) <= release.free_beyond and not is_released:
                raise RequestError(
                    f"{field}.joint: {move.joint} is locked while {release.latch} is at {values[release.latch]:g}; "
                    f"expected a move of {release.latch} to {release.at:g} or beyond before it"
                )
        values[move.joint] = move.to


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


def measure_travel(given: GivenMechanism, first: Float[np.ndarray, "k"], last: Float[np.ndarray, "k"]) -> float:
    """Return how far a move of one joint carries the handle [m]."""
    column = int(np.abs(last - first).argmax())
    joint = given.mechanism.joints[column]
    moved = float(abs(last[column] - first[column]))
    if joint.kind == "prismatic":
        return moved
    place, _ = _locate_handle(given, joint.name, first)
    return moved * float(np.linalg.norm(np.cross(joint.axis / np.linalg.norm(joint.axis), place)))


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
