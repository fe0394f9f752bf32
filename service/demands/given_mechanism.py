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
)
from costs.scene import ConvexPiece
from service.demands.hands import Hand, list_robot_hands
from service.demands.holds.pressed import add_pressed, find_pressed
from service.demands.phase_spec import LINE_WAYPOINTS, REACH_WAYPOINTS, HandMotion, PhaseSpec
from service.demands.resume import ResumedDemand, check_travel, find_index, start_mechanism
from service.errors import RequestError, shown, would_do
from service.request.mechanism import MechanismRequest, is_urdf_text
from service.request.names import MECHANISM, STILL
from service.request.resume import ResumeRequest
from service.verify import HandLoad, Motion, RelativePoseTarget

TOUCH_DEPTH = 6e-3  # allowed overlap of the hand's rod and what it holds [m]
LINE_OUT = 0.1  # of the line that leads to the handle, where the request gives none [m]
TURN_STEP, SLIDE_STEP = float(np.deg2rad(10.0)), 0.05  # between waypoints [rad, m]
TILT_RESERVE = float(np.deg2rad(2.0))
PLACE_TOLERANCE = 5e-3  # [m]
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
    def mechanism(self) -> Mechanism:
        """The joints with the request's starts and latches."""
        releases = tuple(
            Release(release.joint, release.latch, release.at, release.free_beyond) for release in self.request.releases
        )
        return Mechanism(MECHANISM, self.read.joints, releases)

    @property
    def pieces(self) -> tuple[ConvexPiece, ...]:
        """Bodies that no joint moves, as pieces of the scene."""
        return tuple(ConvexPiece(name, points) for name, points in self.read.still.items())

    def place_bodies(self) -> list[Float[np.ndarray, "V 3"]]:
        """Return the vertices of all bodies in the world at the start [m]."""
        return [*self.read.still.values(), *self.place_moving(self.mechanism.start)]

    def place_moving(self, values: Float[np.ndarray, "k"]) -> list[Float[np.ndarray, "V 3"]]:
        """Return the vertices of all bodies that joints move, with the joints at ``values`` [m]."""
        placed = []
        for joint in self.mechanism.joints:
            pose = self.locate(joint.name, values)
            placed += [(points - joint.origin) @ pose[:3, :3].T + pose[:3, 3] for points in joint.bodies.values()]
        return placed

    def locate(self, joint: str, values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a joint's link in the world, with the joints at ``values`` [rad, m]."""
        names = [known.name for known in self.mechanism.joints]
        pose = np.eye(4)
        origin = np.zeros(3)
        for name in reversed(self.read.list_carriers(joint)):
            known = self.mechanism.joint(name)
            value = float(values[names.index(name)])
            step = np.eye(4)
            step[:3, 3] = known.origin - origin
            axis = known.axis / np.linalg.norm(known.axis)
            if known.kind == "prismatic":
                step[:3, 3] += value * axis
            else:
                step[:3, :3] = Rotation.from_rotvec(value * axis).as_matrix()
            pose, origin = pose @ step, known.origin
        return np.asarray(pose)


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
            )
    for k, release in enumerate(request.releases):
        for key, name in (("joint", release.joint), ("latch", release.latch)):
            if name not in names:
                where = f"{field}.releases[{k}].{key}"
                raise RequestError(f"{where}: unknown joint {shown(name)}; expected {would_do(name, names)}")
    handle = _read_handle(request, read)
    _check_moves(request, read, handle)
    return GivenMechanism(request, read, handle)


def _make_pose(request: MechanismRequest) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(request.quaternion_wxyz, scalar_first=True).as_matrix()
    pose[:3, 3] = request.position
    return pose


def make_mechanism_phases(
    given: GivenMechanism, hand: Hand, reach_waypoints: int = REACH_WAYPOINTS
) -> tuple[PhaseSpec, ...]:
    """Return the phases: reach, approach, one per move, retract unless the hand stays.

    Raises:
        RequestError: a hand at the handle does not move a joint, or a spring acts on a link below which another moves.
    """
    handle, start = given.handle, given.mechanism.start
    names = [joint.name for joint in given.mechanism.joints]
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
    values, ends = start, []
    for move in given.request.moves:
        last = values.copy()
        last[names.index(move.joint)] = move.to
        ends.append((values, last))
        values = last
    loads = [tuple(_list_loads(given, tool, move.joint, *ends[k])) for k, move in enumerate(given.request.moves)]
    crowded = next((k for k, carried in enumerate(loads) if len(carried) > MOST_LOADS), None)
    if crowded is not None:
        raise RequestError(
            f"task.mechanism.joints: the hand would carry the loads of {len(loads[crowded])} joints in "
            f"moves[{crowded}]; expected at most {MOST_LOADS}"
        )
    travels = [measure_travel(given, first, last) for first, last in ends]
    for k, (move, (first, last)) in enumerate(zip(given.request.moves, ends, strict=True)):
        joint = given.mechanism.joint(move.joint)
        step = SLIDE_STEP if joint.kind == "prismatic" else TURN_STEP
        count = max(int(np.ceil(np.abs(last - first).max() / step)) + 1, 4)
        phases.append(
            PhaseSpec(
                _name_phase(given.request, k),
                first, last, held, touches, loads[k],
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
    """

    given: GivenMechanism
    robot: RobotModel

    @property
    def mechanism(self) -> Mechanism:
        """The joints of the URDF."""
        return self.given.mechanism

    def read_choices(self, recorded: Motion) -> tuple[tuple[PhaseSpec, ...], tuple[str, ...]]:
        """Return the phases with the record's hand, or a sentence that no permitted hand holds the handle."""
        hand = self.find_hand(recorded)
        if hand is None:
            return (), ("no hand that the task permits holds the handle",)
        return make_mechanism_phases(self.given, hand), ()

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
    given = demand.given
    specs = make_mechanism_phases(given, read_kept_hand(demand, resume), reach_waypoints)
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
        raise RequestError(f"{field}.link: no joint moves {shown(handle.link)}; expected a link that moves")
    joint = next(joint.name for joint in read.joints if joint.link == place.link)
    rotation, shift = place.pose[:3, :3], place.pose[:3, 3]
    axis = rotation @ np.array(handle.axis)
    axis = axis / np.linalg.norm(axis)
    approach = -LINE_OUT * axis if handle.approach is None else rotation @ np.array(handle.approach)
    slide = None if handle.slide is None else rotation @ np.array(handle.slide)
    at = rotation @ np.array(handle.place) + shift
    tilt = float(np.deg2rad(handle.tilt_deg))
    return Handle(place.link, joint, at, axis, approach, slide, tilt, place.bodies)


def _check_moves(request: MechanismRequest, read: UrdfMechanism, handle: Handle) -> None:
    """Refuse moves of joints that the hand does not move, that go nowhere, or past a limit."""
    joints = {joint.name: joint for joint in read.joints}
    values = {name: joint.start for name, joint in joints.items()}
    carriers = read.list_carriers(handle.joint)
    for k, move in enumerate(request.moves):
        field = f"task.mechanism.moves[{k}]"
        if move.joint not in joints:
            raise RequestError(
                f"{field}.joint: unknown joint {shown(move.joint)}; the mechanism has {would_do(move.joint, joints)}"
            )
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


def _list_loads(
    given: GivenMechanism, tool: str, moving: str, first: Float[np.ndarray, "k"], last: Float[np.ndarray, "k"]
) -> Iterator[HandLoad]:
    """Yield what the hand carries while a joint moves: its friction, and the springs of all displaced joints."""
    names = [joint.name for joint in given.mechanism.joints]
    start = given.mechanism.start
    for name in given.read.list_carriers(given.handle.joint):
        column = names.index(name)
        loads = given.request.joints.get(name)
        if loads is None:
            continue
        travel = np.array([first[column], last[column]]) - start[column]
        for sense in (1.0, -1.0):
            farthest = float((sense * travel).max())
            size = loads.preload + loads.stiffness * farthest if farthest > LEAST_TRAVEL else 0.0
            if name == moving and sense * (last[column] - first[column]) > 0.0:
                size += loads.friction
            if size <= 0.0:
                continue
            if name != moving and name in given.read.list_carriers(moving):
                raise RequestError(
                    f"task.mechanism.joints.{name}: its spring pulls while the hand moves {moving} below it; expected "
                    f"no preload and stiffness, or {name} moved after {moving}"
                )
            yield _make_load(given, tool, name, first, sense * size)


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


def _name_phase(request: MechanismRequest, index: int) -> str:
    """Return the name of a move's phase, numbered from a joint's second move on."""
    joint = request.moves[index].joint
    count = sum(move.joint == joint for move in request.moves[: index + 1])
    return f"move {joint}" + (f" {count}" if count > 1 else "")
