"""Contacts by which a hand pushes a mechanism, found from the shapes of both where the hand holds it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from costs.robot import STOP_ROUNDING, LinkBody, Mechanism, RobotModel
from service.demands.hands import Hand, list_robot_hands
from service.demands.holds.hand_surfaces import find_cap, list_hand_surfaces, list_link_surfaces, place_fingers
from service.demands.phase import AXIS, SAME_VALUE, FrameMotion, TaskPhase, find_rotation_onto
from service.verify import (
    HAND_CAP_N,
    LEAST_SHARE,
    HandContact,
    HandLoad,
    HandPush,
    HeldJoint,
    Meeting,
    describe_failure,
    find_jamming_angle,
    measure_beyond_hull,
    measure_excess,
    meet,
)

MOST_AIM = float(np.deg2rad(25.0))  # of a rod that pushes by its side, from the handle's axis
MOST_LEAN = float(np.deg2rad(30.0))  # of a rod that pushes by its side, from square to the way
MOST_BESIDE = 0.03  # of a hand that comes or goes, beside the face that it presses [m]
LEAST_BESIDE = 8e-3  # of a hand beside the face that it presses, from any other body [m]
ALONG = 0.5  # cosine from which on a force counts as one along the way of a joint
RESERVE = float(np.deg2rad(3.0))  # of the angles that friction permits, for the curve between the waypoints
LITTLE_ACROSS = float(np.cos(np.deg2rad(5.0)))  # cosine from which on a contact pushes along the way alone


@dataclass(frozen=True)
class _HeldAt:
    """A hand at the mechanism.

    Attributes:
        tool: frame of the hand.
        pose: (4, 4) of that frame in the world.
        values: (k,) of the mechanism's joints.
        fingers: pose (4, 4) of each closed finger in the tool's frame; none of a rod, or of fingers that grip.
    """

    tool: str
    pose: Float[np.ndarray, "4 4"]
    values: Float[np.ndarray, "k"]
    fingers: Mapping[str, Float[np.ndarray, "4 4"]] = field(default_factory=dict)


@dataclass(frozen=True)
class NominalPush:
    """A push with its contacts at the pose that a phase's hand aims at.

    Attributes:
        push: joint, sense and contacts.
        met: where each contact meets its body, in the frame of the body's link.
    """

    push: HandPush
    met: tuple[Meeting, ...]

    @property
    def angle(self) -> float:
        """Least angle between a contact's normal and the way; infinite where none touches [rad]."""
        return min((meeting.angle for meeting in self.met if meeting.is_touching), default=float("inf"))


def add_pushes(
    specs: Sequence[TaskPhase], robot: RobotModel, mechanism: Mechanism, friction: tuple[float, float]
) -> tuple[TaskPhase, ...]:
    """Return phases with the contacts of hands that move the mechanism or carry its loads.

    A hand that presses a body at an angle exerts more than the way needs: such a load gets the contact's direction.

    Args:
        specs: phases without pushes.
        robot: augmented by the mechanism.
        mechanism: whose joints are the robot's last coordinates.
        friction: least and largest coefficient.
    """
    return tuple(_add_pushes(spec, robot, mechanism, friction) for spec in specs)


def _add_pushes(spec: TaskPhase, robot: RobotModel, mechanism: Mechanism, friction: tuple[float, float]) -> TaskPhase:
    found = tuple(find_nominal_pushes(spec, robot, mechanism, friction))
    loads = spec.loads
    for nominal in found:
        loads = tuple(_press_along_normal(load, mechanism, spec, nominal) for load in loads)
    pushes = tuple(nominal.push for nominal in found)
    pushing = replace(spec, pushes=pushes, loads=loads)
    return pushing if spec.hand is None else pushing.with_hand(_limit_lean(spec, spec.hand, mechanism, found))


def _limit_lean(
    spec: TaskPhase, motion: FrameMotion, mechanism: Mechanism, found: Sequence[NominalPush]
) -> FrameMotion:
    """Return a phase's hand whose rod leans towards the way of its hardest push no more than friction permits."""
    single = [nominal for nominal in found if len(nominal.met) == 1]
    if not single or motion.rotation is not None:
        return motion
    nominal = max(single, key=lambda nominal: nominal.push.force_n)
    (contact,), (meeting,) = nominal.push.contacts, nominal.met
    turned = np.linalg.inv(mechanism.locate(str(motion.turns_with), spec.first))
    way = (turned @ mechanism.locate(contact.link, spec.first))[:3, :3] @ meeting.way
    lean = float(np.arcsin(min(abs(float(way @ motion.axis)), 1.0)))
    room = -measure_excess(nominal.push, nominal.met) - RESERVE
    if lean > MOST_LEAN or room <= 0.0:
        return motion
    # What the rod leans along a bar makes its lean towards the way weigh more.
    aim = min(motion.aim_rad, MOST_AIM)
    return replace(motion, way=way, way_lean_rad=lean + np.cos(aim) * room, aim_rad=aim)


def find_nominal_pushes(
    spec: TaskPhase, robot: RobotModel, mechanism: Mechanism, friction: tuple[float, float]
) -> Iterator[NominalPush]:
    """Yield the pushes of a phase: one per sense of each joint that moves or is loaded."""
    motion = spec.hand
    if motion is None or motion.is_line or motion.link is None:
        return
    needs = _list_needs(spec, mechanism)
    if not needs or any(part.source == "assumed" for part in spec.pressed):
        return
    hand = _find_hand(robot, motion)
    contacts = _keep_nearest(list(_list_contacts(robot, hand, spec)), motion, robot)
    if not contacts:
        return
    fingers = place_fingers(robot, hand, spec)
    held = _HeldAt(motion.tool, _place_hand(motion, mechanism, spec.first), spec.first, fingers)
    pushed = frozenset(joint for joint, _, _ in needs)
    for joint, sense, force in needs:
        stays = _list_held(spec, mechanism, contacts[0], pushed)
        joints = (joint, *(other.joint for other in stays))
        met = tuple(_meet(robot, mechanism, contact, held, joints, sense) for contact in contacts)
        yield _choose(HandPush(joint, sense, force, tuple(contacts), friction, stays), met)


def _find_hand(robot: RobotModel, motion: FrameMotion) -> Hand | None:
    """Return the hand that a frame belongs to."""
    hands = list_robot_hands(robot)
    return next((hand for hand in hands if motion.tool in (hand.tool, hand.peg, hand.stub)), None)


def find_side(
    spec: TaskPhase, robot: RobotModel, mechanism: Mechanism, friction: tuple[float, float]
) -> Float[np.ndarray, "3"]:
    """Return how far a hand may be beside the face that it presses before it comes near another body [m].

    In the link that the hand holds, away from the face; zero where it holds none, or where there is no room.
    """
    motion = spec.hand
    if motion is None:
        return np.zeros(3)
    hand = _find_hand(robot, motion)
    for nominal in find_nominal_pushes(spec, robot, mechanism, friction):
        pressed = {contact.body for contact in nominal.push.contacts}
        others = [body for body in robot.bodies if body.link in robot.mechanism_links and body.name not in pressed]
        for contact, meeting in zip(nominal.push.contacts, nominal.met, strict=True):
            if contact.link != motion.link:
                continue
            for distance in np.linspace(MOST_BESIDE, 0.0, 6):
                shift = -distance * meeting.normal
                moved = replace(motion, place=motion.place + shift)
                pose = _place_hand(moved, mechanism, spec.first)
                held = _HeldAt(motion.tool, pose, spec.first, place_fingers(robot, hand, spec))
                gaps = [_measure_gap(robot, mechanism, contact, held, body) for body in others]
                if min(gaps, default=np.inf) >= LEAST_BESIDE:
                    return np.asarray(shift)
    return np.zeros(3)


def _measure_gap(robot: RobotModel, mechanism: Mechanism, contact: HandContact, held: _HeldAt, body: LinkBody) -> float:
    """Return how far a surface of a hand is from any body of the mechanism [m]."""
    met = _meet(robot, mechanism, replace(contact, link=body.link, body=body.name), held, (), 1.0)
    return float("inf") if met is None else met.gap


def explain_refusal(
    specs: Sequence[TaskPhase], robot: RobotModel, mechanism: Mechanism, friction: tuple[float, float]
) -> str | None:
    """Return why a hand cannot push the mechanism, whatever its permitted lean; None if it can."""
    for spec in specs:
        for nominal in find_nominal_pushes(spec, robot, mechanism, friction):
            excess = measure_excess(nominal.push, nominal.met)
            lean = 0.0 if spec.hand is None else spec.hand.tilt_rad
            if nominal.push.contacts and excess > lean:
                return f"{describe_failure(nominal.push, nominal.angle)}, in phase '{spec.name}'"
    return None


def _list_needs(spec: TaskPhase, mechanism: Mechanism) -> list[tuple[str, float, float]]:
    """Return joint, sense and force [N] of every push that a phase needs."""
    needs: dict[tuple[str, float], float] = {}
    for load in spec.loads:
        along = _measure_along(load, mechanism)
        if abs(along) > ALONG * float(np.linalg.norm(load.force)):
            joint = next(joint for joint in mechanism.joints if joint.link == load.link)
            key = (joint.name, float(np.sign(along)))
            needs[key] = needs.get(key, 0.0) + abs(along)
    loaded = {name for name, _ in needs}
    for column in spec.moving:
        name = mechanism.joints[column].name
        if name not in loaded:
            needs[name, float(np.sign(spec.last[column] - spec.first[column]))] = 0.0
    return [(joint, sense, force) for (joint, sense), force in needs.items()]


def _list_contacts(robot: RobotModel, hand: Hand | None, spec: TaskPhase) -> Iterator[HandContact]:
    """Yield the contacts that a phase's allowances permit to a hand, or without one to any link, such as a forearm."""
    for touch in spec.touches:
        for own, other in ((touch.first, touch.second), (touch.second, touch.first)):
            if own.owner != "robot" or other.owner != "mechanism":
                continue
            link = str(own.link)
            surfaces = list(list_link_surfaces(robot, link)) if hand is None else list_hand_surfaces(robot, hand, link)
            cap = HAND_CAP_N if hand is None else find_cap(robot, hand, link)
            for frame, words, core, radius in surfaces:
                for body in robot.bodies:
                    if body.link == other.link and other.body in (None, body.name):
                        yield HandContact(frame, words, core, radius, body.link, body.name, cap)


def _keep_nearest(contacts: Sequence[HandContact], motion: FrameMotion, robot: RobotModel) -> tuple[HandContact, ...]:
    """Return the contacts of what pushes; those of fingers that grip only with the bodies nearest to their place."""
    if not motion.grips:
        return tuple(contacts)
    bodies = {body.name: body for body in robot.bodies}
    names = dict.fromkeys(contact.body for contact in contacts)
    beyond = {name: measure_beyond_hull(motion.place[None], bodies[name].vertices) for name in names}
    nearest = min(beyond.values(), default=0.0)
    return tuple(contact for contact in contacts if beyond[contact.body] <= max(nearest, 0.0))


def _place_hand(motion: FrameMotion, mechanism: Mechanism, values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the frame at the hand's place in the world, its axis as the phase aims at."""
    held = mechanism.locate(str(motion.link), values)
    turned = held if motion.turns_with is None else mechanism.locate(motion.turns_with, values)
    pose = np.eye(4)
    pose[:3, :3] = turned[:3, :3] @ (
        find_rotation_onto(AXIS, motion.axis) if motion.rotation is None else motion.rotation
    )
    pose[:3, 3] = held[:3, :3] @ motion.place + held[:3, 3]
    return pose


def _meet(
    robot: RobotModel,
    mechanism: Mechanism,
    contact: HandContact,
    held: _HeldAt,
    joints: Sequence[str],
    sense: float,
) -> Meeting | None:
    """Return where a contact meets its body; None for a surface that is not carried rigidly by the hand's frame."""
    model = robot.model
    tool, frame = (model.frames[model.getFrameId(name)] for name in (held.tool, contact.frame))
    if contact.frame in held.fingers:
        own = held.fingers[contact.frame]
    elif int(tool.parentJoint) == int(frame.parentJoint):
        own = (tool.placement.inverse() * frame.placement).homogeneous
    else:
        return None
    body = next(body for body in robot.bodies if body.name == contact.body)
    link = mechanism.locate(contact.link, held.values)
    pose = np.linalg.inv(link) @ held.pose @ own
    ways = [_find_way(mechanism, name, link, held.values) for name in joints]
    return meet(contact, body, (pose[:3, :3], pose[:3, 3]), sense, ways)


def _find_way(
    mechanism: Mechanism, joint: str, link: Float[np.ndarray, "4 4"], values: Float[np.ndarray, "k"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return how a joint moves the origin of a link, and turns it, per unit of its coordinate, in the link's frame."""
    moved = mechanism.joint(joint)
    carrier = np.linalg.inv(link) @ mechanism.locate(moved.link, values)
    axis = carrier[:3, :3] @ moved.axis / np.linalg.norm(moved.axis)
    if moved.kind == "prismatic":
        return axis, np.zeros(3)
    return -np.cross(axis, carrier[:3, 3]), axis


def _list_held(
    spec: TaskPhase, mechanism: Mechanism, contact: HandContact, pushed: frozenset[str]
) -> tuple[HeldJoint, ...]:
    """Return the joints that carry what a contact presses and that stay still, with what they bear by themselves."""
    held, above = list[HeldJoint](), str(contact.link)
    columns = {joint.link: column for column, joint in enumerate(mechanism.joints)}
    while True:
        column = columns[above]
        joint = mechanism.joints[column]
        if joint.name not in pushed and column not in spec.moving:
            low, high = spec.bears.get(joint.name, (0.0, 0.0))
            value, is_locked = float(spec.first[column]), _is_locked(spec, mechanism, joint.name)
            if is_locked or value <= joint.lower + STOP_ROUNDING + SAME_VALUE:
                low = -np.inf
            if is_locked or value >= joint.upper - STOP_ROUNDING - SAME_VALUE:
                high = np.inf
            held.append(HeldJoint(joint.name, low, high))
        if joint.parent is None:
            return tuple(held)
        above = joint.parent


def _is_locked(spec: TaskPhase, mechanism: Mechanism, joint: str) -> bool:
    """Return whether a latch holds a joint during a whole phase."""
    names = [known.name for known in mechanism.joints]
    for release in mechanism.releases:
        if release.joint == joint and spec.first[names.index(joint)] <= SAME_VALUE:
            latch = np.array([spec.first, spec.last])[:, names.index(release.latch)]
            return bool((latch * np.sign(release.latch_at)).max() < abs(release.latch_at))
    return False


def _choose(push: HandPush, met: Sequence[Meeting | None]) -> NominalPush:
    """Return the push by the contact that is best alone, if it suffices; else by all that touch."""
    rigid = [(contact, meeting) for contact, meeting in zip(push.contacts, met, strict=True) if meeting is not None]
    if not rigid:
        return NominalPush(push, ())
    touching = [pair for pair in rigid if pair[1].is_touching] or [min(rigid, key=lambda pair: pair[1].gap)]
    contact, meeting = max(touching, key=lambda pair: float(pair[1].normal @ pair[1].way))
    alone = NominalPush(replace(push, contacts=(contact,)), (meeting,))
    if len(touching) == 1 or measure_excess(alone.push, alone.met) <= -RESERVE:
        return alone
    contacts, meetings = zip(*touching, strict=True)
    together = NominalPush(replace(push, contacts=contacts), meetings)
    is_better = measure_excess(together.push, together.met) < measure_excess(alone.push, alone.met)
    return together if is_better else alone


def _press_along_normal(load: HandLoad, mechanism: Mechanism, spec: TaskPhase, nominal: NominalPush) -> HandLoad:
    """Return a load of a push as what a single contact exerts for it: along its normal, as large as the way needs."""
    push = nominal.push
    if len(nominal.met) != 1 or not _is_load_of(load, push, mechanism):
        return load
    (meeting,), (contact,) = nominal.met, push.contacts
    turn = np.linalg.inv(mechanism.locate(load.link, spec.first)) @ mechanism.locate(contact.link, spec.first)
    normal = turn[:3, :3] @ meeting.normal
    share = push.sense * _measure_along(replace(load, force=normal), mechanism)
    if nominal.angle > find_jamming_angle(push) or not LEAST_SHARE <= share <= LITTLE_ACROSS:
        return load
    return replace(load, force=abs(_measure_along(load, mechanism)) / share * normal)


def _is_load_of(load: HandLoad, push: HandPush, mechanism: Mechanism) -> bool:
    """Return whether a load is what a push is for."""
    along = _measure_along(load, mechanism)
    is_along = abs(along) > ALONG * float(np.linalg.norm(load.force))
    return is_along and mechanism.joint(push.joint).link == load.link and np.sign(along) == push.sense


def _measure_along(load: HandLoad, mechanism: Mechanism) -> float:
    """Return the part of a load along the way on which its link's joint moves its place, towards greater values [N]."""
    joint = next(joint for joint in mechanism.joints if joint.link == load.link)
    axis = joint.axis / np.linalg.norm(joint.axis)
    way = axis if joint.kind == "prismatic" else np.cross(axis, load.place)
    return float(way @ load.force) / max(float(np.linalg.norm(way)), 1e-12)
