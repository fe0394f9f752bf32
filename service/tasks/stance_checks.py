"""Quick checks of one stance for a task with a mechanism: how far a hand moves it, and with which reserves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.allowance import BodyRef
from costs.kinematics import locate_frame, locate_links
from costs.robot import Mechanism, RobotModel
from costs.static_region import StaticRegionError
from service.body.loaded_regions import plan_regions
from service.body.phases import PhaseSolver, random_guesses
from service.body.whole_body import WholeBody
from service.demands.door import Door, DoorChoice, Push, make_door_phases
from service.demands.door_demand import measure_peg
from service.demands.given_mechanism import GivenMechanism, make_mechanism_phases, measure_travel
from service.demands.hands import Hand, list_robot_hands
from service.demands.phase_spec import PhaseSpec
from service.demands.strokes import TurnChoice, find_least_count, list_strokes, list_usable_entries
from service.demands.wheel import Wheel, make_wheel_mechanism
from service.request.schema import ValveRequest
from service.tasks.door import HAND_ROOM, LEAST_FIRST, PUSH_ALONG, PUSH_UP, list_choices
from service.tasks.door_sweep import find_blocked_opening
from service.tasks.handling import list_arm_joints
from service.tasks.mechanism_task import check_hold, find_blocked_move
from service.tasks.sequence import PhaseSequence
from service.tasks.valve import ValveTurn

DOOR_STEP = np.deg2rad(10.0)  # between the angles that are tried
WHEEL_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the turn at which a pose is tried
MOST_PUSHES = 4  # places on the leaf that are tried, the nearest to a shoulder first
MOST_TORQUE = 0.95  # share of a joint's torque at rest
N_RANDOM = 4  # random configurations from which the first pose of a stroke is searched
MOST_NEAR = 3  # poses of a stroke from which one that is missing is guessed
MOVE_SHARES = (0.5, 1.0)  # of each move of a given mechanism at which a pose is tried
MOST_ENTRIES = 2  # of a wheel, the nearest first


@dataclass(frozen=True)
class HeldPose:
    """A pose that exists from a stance.

    Attributes:
        name: of its phase.
        q: (n,) configuration.
        balance_m: how far the centre of mass is inside the region where the feet hold the hand's load.
        reach_m: by how much the arm could be longer stretched.
        torque_share: largest share of a joint's torque above the legs, at rest with the load or without it.
    """

    name: str
    q: Float[np.ndarray, "n"]
    balance_m: float
    reach_m: float
    torque_share: float


@dataclass(frozen=True)
class Outcome:
    """How far a task gets from a stance, as far as single poses show.

    Attributes:
        reached: of the mechanism's first joint, from its start [rad]; for a given mechanism, share of the way that
            its handle goes.
        poses: that exist, in the order of the motion.
        hold: hand and hold, in words.
        missing: the first pose that was not found, in words; empty where the task is done.
    """

    reached: float
    poses: tuple[HeldPose, ...]
    hold: str
    missing: str

    @property
    def balance_m(self) -> float:
        """Least reserve of balance [m]."""
        return min((pose.balance_m for pose in self.poses), default=0.0)

    @property
    def reach_m(self) -> float:
        """Least reserve of reach [m]."""
        return min((pose.reach_m for pose in self.poses), default=0.0)

    @property
    def torque_share(self) -> float:
        """Largest share of a joint's torque."""
        return max((pose.torque_share for pose in self.poses), default=0.0)


class StanceTask(Protocol):
    """A task with a mechanism, as the search for a stance sees it."""

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism."""

    @property
    def hands(self) -> tuple[Hand, ...]:
        """Hands that may be used."""

    @property
    def whole(self) -> float:
        """``Outcome.reached`` of the whole task."""

    @property
    def is_angle(self) -> bool:
        """Whether that is an angle [rad]; else a share."""

    @property
    def near(self) -> tuple[tuple[BodyRef, BodyRef, float], ...]:
        """Required clearances of pairs that come near each other [m]."""

    def list_ways(self) -> tuple[tuple[tuple[Hand, Float[np.ndarray, "P 3"]], ...], ...]:
        """Return the ways to do the task: for each the hands, and the places in the world that each holds [m]."""

    def place_parts(self, *, is_end: bool) -> list[Float[np.ndarray, "V 3"]]:
        """Return the vertices of the mechanism's bodies in the world, at the start or at the end [m]."""

    def find_in_the_way(self, body: WholeBody) -> Iterator[str]:
        """Yield a sentence for each link that the mechanism would meet as the robot stands."""

    def try_stance(self, solver: PhaseSolver) -> Outcome:
        """Return how far the task gets from the stance of the solver's body."""


@dataclass(frozen=True)
class DoorStance:
    """A door to open.

    Attributes:
        door: leaf, handle and loads.
        hands: that may be used.
        target: opening angle at the end [rad].
        near: required clearances between hands and door [m].
        pegs: length of each hand's free rod [m].
    """

    door: Door
    hands: tuple[Hand, ...]
    target: float
    near: tuple[tuple[BodyRef, BodyRef, float], ...]
    pegs: tuple[float, ...]

    @staticmethod
    def of(
        robot: RobotModel,
        door: Door,
        hands: tuple[Hand, ...],
        target: float,
        near: tuple[tuple[BodyRef, BodyRef, float], ...],
    ) -> DoorStance:
        """Return the task of a robot."""
        return DoorStance(door, hands, target, near, tuple(measure_peg(robot, hand) for hand in hands))

    @property
    def mechanism(self) -> Mechanism:
        """Leaf and handle."""
        return self.door.mechanism

    @property
    def start(self) -> float:
        """Opening angle at the start [rad]."""
        return self.door.geometry.ajar

    def list_ways(self) -> tuple[tuple[tuple[Hand, Float[np.ndarray, "P 3"]], ...], ...]:
        """Return the ways: at the handle alone, and at the handle first and on the leaf at the end."""
        ways: list[tuple[tuple[Hand, Float[np.ndarray, "P 3"]], ...]] = []
        early = min(self.start + 2.0 * DOOR_STEP, self.target)
        for hand, choice in self._list_choices():
            at_handle = choice.first > self.start
            if at_handle:
                held = self._find_anchor(choice)
                ways.append(((hand, self._place(held, (self.start, 0.5 * (self.start + self.target), self.target))),))
            for push in self._list_pushes(self.target):
                pushed = self._find_anchor(replace(choice, first=early if at_handle else self.start, push=push))
                values = (early, self.target) if self.door.is_push else (self.target,)
                on_leaf = (push.hand, self._place(pushed, values))
                first = ((hand, self._place(self._find_anchor(choice), (self.start, early))),) if at_handle else ()
                ways.append((*first, on_leaf))
        return tuple(ways)

    @property
    def whole(self) -> float:
        """Angle to open by [rad]."""
        return self.target - self.start

    @property
    def is_angle(self) -> bool:
        """Yes."""
        return True

    def place_parts(self, *, is_end: bool) -> list[Float[np.ndarray, "V 3"]]:
        """Return leaf and handle, shut or ajar as at the start, or open."""
        return place_turned(self.mechanism, self.target if is_end else float(self.mechanism.start[0]))

    def find_in_the_way(self, body: WholeBody) -> Iterator[str]:
        """Yield a sentence for the planted link and the link of a leg that the leaf would meet."""
        for met in find_blocked_opening(body, self.door, self.target):
            yield met.describe(self.target)

    def try_stance(self, solver: PhaseSolver) -> Outcome:
        """Return the largest angle to which the leaf opens at the handle, or pushed on from there."""
        best = Outcome(0.0, (), "", "pose at the handle")
        for hand, choice in self._list_choices():
            outcome = self._try_choice(_PoseFinder(solver, self.mechanism), hand, choice)
            if outcome.reached > best.reached or not best.hold:
                best = outcome
            if not outcome.missing:
                break
        return best

    def _try_choice(self, finder: _PoseFinder, hand: Hand, choice: DoorChoice) -> Outcome:
        poses: list[HeldPose] = []
        reached, hold = self.start, f"{hand.side} hand"
        if choice.first > self.start:
            hold += " at the handle"
            specs = make_door_phases(self.door, choice)
            anchor = next(spec for spec in specs if spec.is_anchor)
            for spec in (specs[1], anchor):  # the line to the handle begins in free space
                pose = finder.find(spec, poses)
                if pose is None:
                    return Outcome(0.0, tuple(poses), hold, f"{spec.step or spec.name}: no pose")
                poses.append(pose)
            for angle in self._list_angles(self.start):
                pose = finder.find(replace(anchor, first=self._at(angle)), poses)
                if pose is not None:
                    poses.append(pose)
                    reached = max(reached, angle)
                if (pose is None) == (angle < self.target):
                    break
            if reached >= self.target:
                return Outcome(self.target - self.start, tuple(poses), hold, "")
            if reached < self.start + LEAST_FIRST - 1e-6:
                return Outcome(0.0, tuple(poses), hold, "no pose with the leaf open and the hand at the handle")
            choice = replace(choice, first=reached)
        pushes = self._list_pushes(self.target)
        room = self.door.geometry.width * np.sin(reached)
        missing = f"no pose with the hand at the handle beyond {np.rad2deg(reached):.0f} deg"
        if not self.door.is_push and room < HAND_ROOM:
            return Outcome(reached - self.start, tuple(poses), hold, f"{missing}, and no room behind the leaf")
        body = finder.solver.body
        shoulders = {push.hand.side: find_shoulder(body.robot, body.nominal, push.hand) for push in pushes}

        def distance(push: Push) -> float:
            spec = self._find_anchor(replace(choice, push=push))
            place = self._place(spec, (0.5 * (reached + self.target),))[0]
            return abs(float(np.linalg.norm(place - shoulders[push.hand.side])) - 0.6)

        for push in sorted(pushes, key=distance)[:MOST_PUSHES]:
            spec = self._find_anchor(replace(choice, push=push))
            first = finder.find(spec, poses)
            last = None if first is None else finder.find(replace(spec, first=spec.last), [*poses, first])
            if first is not None and last is not None:
                words = f"{push.hand.side} hand on the leaf"
                hold = words if choice.first <= self.start else f"{hold} to {np.rad2deg(reached):.0f} deg, then {words}"
                return Outcome(self.target - self.start, (*poses, first, last), hold, "")
        return Outcome(reached - self.start, tuple(poses), hold, f"{missing}, nor on the leaf")

    def _list_choices(self) -> list[tuple[Hand, DoorChoice]]:
        """Return one hold of the handle per hand and sense; of the leaf alone where it is ajar."""
        return [
            (hand, choice)
            for hand, peg in zip(self.hands, self.pegs, strict=True)
            for choice in list_choices(self.door, hand, peg, self.target, most_grips=1)
        ]

    def _list_pushes(self, last: float) -> list[Push]:
        geometry = self.door.geometry
        return [
            Push(hand, share * geometry.width, up - float(geometry.hinge[2]), last)
            for hand in self.hands
            for share in PUSH_ALONG
            for up in PUSH_UP[:2]
        ]

    def _list_angles(self, start: float) -> list[float]:
        """Return the opening angles to try, the target first, then from the smallest on [rad]."""
        between = np.arange(start + 2.0 * DOOR_STEP, self.target - 0.5 * DOOR_STEP, 2.0 * DOOR_STEP)
        return [self.target, start + LEAST_FIRST, *between.tolist()]

    def _find_anchor(self, choice: DoorChoice) -> PhaseSpec:
        """Return the phase in which the choice's last hold opens the leaf."""
        return next(spec for spec in reversed(make_door_phases(self.door, choice)) if spec.is_anchor)

    def _at(self, angle: float) -> Float[np.ndarray, "k"]:
        """Return the mechanism's joints with the leaf open by an angle and the handle pressed."""
        values = self.mechanism.start.copy()
        if len(values) > 1 and self.door.is_latched:
            values[1] = max(self.door.pressed, float(values[1]))
        values[0] = angle
        return values

    def _place(self, spec: PhaseSpec, angles: Sequence[float]) -> Float[np.ndarray, "P 3"]:
        return place_on_joint(self.mechanism, spec, angles)


@dataclass(frozen=True)
class ValveStance:
    """A wheel to turn.

    Attributes:
        wheel: the wheel.
        hands: that may be used.
        request: the task.
        near: required clearances between hooks and wheel [m].
    """

    wheel: Wheel
    hands: tuple[Hand, ...]
    request: ValveRequest
    near: tuple[tuple[BodyRef, BodyRef, float], ...]

    @property
    def mechanism(self) -> Mechanism:
        """The wheel as a mechanism."""
        return make_wheel_mechanism(self.wheel, self.target)

    @property
    def target(self) -> float:
        """Angle to turn by [rad]."""
        return float(np.deg2rad(self.request.turn_deg))

    def list_ways(self) -> tuple[tuple[tuple[Hand, Float[np.ndarray, "P 3"]], ...], ...]:
        """Return the ways: either hand, all round the rim."""
        rim = np.array([self.wheel.rim_point(angle) for angle in np.linspace(0.0, 2.0 * np.pi, 4, endpoint=False)])
        return tuple(((hand, rim),) for hand in self.hands)

    @property
    def whole(self) -> float:
        """Size of the angle to turn by [rad]."""
        return abs(self.target)

    @property
    def is_angle(self) -> bool:
        """Yes."""
        return True

    def place_parts(self, *, is_end: bool) -> list[Float[np.ndarray, "V 3"]]:
        """Return the wheel."""
        return place_turned(self.mechanism, self.target if is_end else float(self.mechanism.start[0]))

    def find_in_the_way(self, body: WholeBody) -> Iterator[str]:
        """Yield nothing: a wheel turns in its place."""
        yield from ()

    def try_stance(self, solver: PhaseSolver) -> Outcome:
        """Return the largest part of the turn along which poses exist, with the better hand and entry."""
        best = Outcome(0.0, (), "", "pose at the wheel")
        finder = _PoseFinder(solver, self.mechanism)
        for hand in self.hands:
            tool = locate_links(solver.body.engine, solver.body.nominal, [hand.tool])[hand.tool][:3, 3]

            def distance(angle: float, tool: Float[np.ndarray, "3"] = tool) -> float:
                return float(np.linalg.norm(self.wheel.rim_point(angle) - tool))

            sense = list_strokes(self.request, 1)[0].sense
            entries = list_usable_entries(self.wheel, hand, self.request.mode, sense)
            for entry in sorted(entries, key=distance)[:MOST_ENTRIES]:
                outcome = self._try_entry(finder, hand, entry)
                if outcome.reached > best.reached or not best.hold:
                    best = outcome
                if not outcome.missing:
                    return outcome
        return best

    def _try_entry(self, finder: _PoseFinder, hand: Hand, entry: float) -> Outcome:
        hold = f"{hand.side} hand in {self.request.mode} mode"
        choice = TurnChoice(hand, entry, find_least_count(self.request))
        turn = ValveTurn(finder.solver, self.wheel, self.request, choice)
        poses: list[HeldPose] = []
        missing: list[str] = []
        done = total = 0.0
        for stroke in _split_strokes(turn.list_phases()):
            anchor = next(spec for spec in stroke if spec.is_anchor)
            weight = abs(float(anchor.last[0] - anchor.first[0])) / len(WHEEL_SHARES)
            values = [anchor.first + share * (anchor.last - anchor.first) for share in WHEEL_SHARES]
            before = {spec.name: finder.find(spec, poses) for spec in stroke[: stroke.index(anchor)]}
            known = [*poses, *(pose for pose in before.values() if pose is not None)]
            held = self._follow(finder, [replace(anchor, first=value) for value in values], known)
            total += weight * len(held)
            done += weight * sum(pose is not None for pose in held)
            missing += [
                f"{np.rad2deg(abs(float(value[0]))):.0f} deg"
                for value, pose in zip(values, held, strict=True)
                if pose is None
            ]
            found = [pose for pose in held if pose is not None]
            if missing and self.request.mode == "grasp":
                return Outcome(done, (*poses, *found), hold, f"no pose at {missing[0]} of the turn")
            for spec in stroke:
                begun = held[0]
                if spec is anchor or begun is None:
                    continue
                pose = before.get(spec.name) or finder.find(spec, (begun,))
                if pose is None:
                    words = f"no pose before the hold at {np.rad2deg(abs(float(spec.first[0]))):.0f} deg of the turn"
                    return Outcome(0.0, (*poses, *found), hold, words)
                poses.append(pose)
            poses += found
        words = f"no pose at {', '.join(missing)} of the turn" if missing else ""
        return Outcome(abs(self.target) * (done / total), tuple(poses), hold, words)

    def _follow(
        self, finder: _PoseFinder, specs: Sequence[PhaseSpec], before: Sequence[HeldPose]
    ) -> list[HeldPose | None]:
        """Return poses along a stroke, each guessed from its neighbour; None where there is none.

        Where the first is not found from the poses before, random configurations are guessed as well.
        """
        held: list[HeldPose | None] = []
        known = list(before)
        for spec in specs:
            pose = finder.find(spec, known, 0 if any(held) else N_RANDOM)
            held.append(pose)
            known += [] if pose is None else [pose]
        for index in range(len(specs) - 1, -1, -1):  # what was not found forwards may be found backwards, or from afar
            near = sorted((abs(index - at), at) for at, pose in enumerate(held) if pose is not None)
            for _, at in [] if held[index] is not None else near[:MOST_NEAR]:
                held[index] = held[index] or finder.find(specs[index], [pose for pose in held[at : at + 1] if pose])
        return held


def _split_strokes(specs: Sequence[PhaseSpec]) -> list[list[PhaseSpec]]:
    """Return the phases of each stroke in which the hand holds the wheel and does not leave."""
    strokes: list[list[PhaseSpec]] = []
    for spec in specs:
        if spec.hand is None:
            strokes.append([])
        elif not spec.hand.leaves:
            strokes[-1].append(spec)
    return strokes


@dataclass(frozen=True)
class MechanismStance:
    """A given mechanism to move.

    Attributes:
        given: the mechanism and the task.
        hands: that may be used.
        near: required clearances between hands and mechanism [m].
    """

    given: GivenMechanism
    hands: tuple[Hand, ...]
    near: tuple[tuple[BodyRef, BodyRef, float], ...]

    @property
    def mechanism(self) -> Mechanism:
        """The joints of the URDF."""
        return self.given.mechanism

    @property
    def whole(self) -> float:
        """All of the way."""
        return 1.0

    @property
    def is_angle(self) -> bool:
        """No: several joints may move."""
        return False

    def list_ways(self) -> tuple[tuple[tuple[Hand, Float[np.ndarray, "P 3"]], ...], ...]:
        """Return the ways: either hand, at the handle before and after every move."""
        specs = [spec for spec in make_mechanism_phases(self.given, self.hands[0]) if spec.moving]
        places = []
        for values in (specs[0].first, *(spec.last for spec in specs)):
            pose = self.given.locate(self.given.handle.joint, values)
            places.append(pose[:3, :3] @ self.given.handle.place + pose[:3, 3])
        return tuple(((hand, np.array(places)),) for hand in self.hands)

    def place_parts(self, *, is_end: bool) -> list[Float[np.ndarray, "V 3"]]:
        """Return the bodies that joints move."""
        last = make_mechanism_phases(self.given, self.hands[0])[-1].last
        return self.given.place_moving(last if is_end else self.mechanism.start)

    def find_in_the_way(self, body: WholeBody) -> Iterator[str]:
        """Yield a sentence for the planted link that the mechanism would meet."""
        blocked = find_blocked_move(body, self.given)
        yield from () if blocked is None else blocked.obstacle

    def try_stance(self, solver: PhaseSolver) -> Outcome:
        """Return the largest part of the moves for which poses exist, with the better hand.

        Raises:
            RequestError: a hand does not touch what it is to hold.
        """
        check_hold(solver, self.hands, self.given)
        outcomes = []
        for hand in self.hands:
            outcomes.append(self._try_hand(_PoseFinder(solver, self.mechanism), hand))
            if not outcomes[-1].missing:
                break
        return max(outcomes, key=lambda outcome: outcome.reached)

    def _try_hand(self, finder: _PoseFinder, hand: Hand) -> Outcome:
        hold = f"{hand.side} hand at {self.given.request.handle.link}"
        specs = make_mechanism_phases(self.given, hand)
        moves = [spec for spec in specs if spec.moving]
        travels = [measure_travel(self.given, spec.first, spec.last) for spec in moves]
        first = finder.find(moves[0], (), N_RANDOM)
        before = None if first is None else finder.find(specs[1], (first,))
        if first is None or before is None:
            return Outcome(0.0, () if first is None else (first,), hold, "pose at the handle: no pose")
        poses, done = [before, first], 0.0
        for spec, travel in zip(moves, travels, strict=True):
            for share in MOVE_SHARES:
                pose = finder.find(replace(spec, first=spec.first + share * (spec.last - spec.first)), poses)
                if pose is None:
                    words = f"no pose in '{spec.name}' at {100.0 * share:.0f} % of its way"
                    return Outcome(done / sum(travels), tuple(poses), hold, words)
                poses.append(pose)
                done += travel / len(MOVE_SHARES)
        return Outcome(1.0, tuple(poses), hold, "")


@dataclass(frozen=True)
class _PoseFinder:
    """Finds single poses of a body, with little effort."""

    solver: PhaseSolver
    mechanism: Mechanism

    def find(self, spec: PhaseSpec, before: Sequence[HeldPose], n_random: int = 0) -> HeldPose | None:
        """Return the first pose of a phase, guessed from those before; None if none that is strong enough was found.

        Random configurations are guessed where that and the robot's postures lead to none.
        """
        sequence = PhaseSequence(self.solver, self.mechanism, (spec,))
        guesses = [pose.q for pose in before[-1:]]
        try:
            solved = sequence.try_pose(spec.name, spec, guesses)
            if not solved.is_feasible and n_random:
                guesses = random_guesses(self.solver.body, n_random, self.solver.seed)
                solved = sequence.try_pose(spec.name, spec, guesses, n_random)
            if not solved.is_feasible:
                return None
            q = solved.x[0]
            torque = measure_torque(self.solver.body, spec, q)
            if torque > MOST_TORQUE:
                return None
            return HeldPose(spec.name, q, self._measure_balance(spec, q), self._measure_reach(spec, q), torque)
        except StaticRegionError:
            return None

    def _measure_balance(self, spec: PhaseSpec, q: Float[np.ndarray, "n"]) -> float:
        """Return how far the centre of mass is inside the region that holds the phase's loads [m]."""
        body = self.solver.body
        model = body.robot.model
        data = model.createData()
        pin.centerOfMass(model, data, q)
        com = data.com[0][None, :2]
        if spec.loads and body.polygon is not None:
            contacts = list(body.planted)
            (region, *_) = plan_regions(body.engine, contacts, spec.loads, spec.first[None], body.nominal)
            return float(region.region.polygon.margin(com)[0]) - region.shift_m
        return float("inf") if body.polygon is None else float(body.polygon.margin(com)[0])

    def _measure_reach(self, spec: PhaseSpec, q: Float[np.ndarray, "n"]) -> float:
        """Return by how much the arm could be longer stretched [m]."""
        hand = spec.hand
        if hand is None:
            return float("inf")
        robot = self.solver.body.robot
        used = next(known for known in list_robot_hands(robot) if hand.tool in (known.tool, known.peg, known.stub))
        shoulder = find_shoulder(robot, q, used)
        tool = locate_links(self.solver.body.engine, q, [hand.tool])[hand.tool][:3, 3]
        return measure_arm(robot, used, hand.tool) - float(np.linalg.norm(tool - shoulder))


def place_turned(mechanism: Mechanism, value: float) -> list[Float[np.ndarray, "V 3"]]:
    """Return the vertices of a mechanism's bodies in the world, its first joint, a revolute one, at a value [m]."""
    joint = mechanism.joints[0]
    turn = Rotation.from_rotvec(value * joint.axis / np.linalg.norm(joint.axis))
    return [
        turn.apply(points - joint.origin) + joint.origin
        for moved in mechanism.joints
        for points in moved.bodies.values()
    ]


def place_on_joint(mechanism: Mechanism, spec: PhaseSpec, values: Sequence[float]) -> Float[np.ndarray, "P 3"]:
    """Return a hold's places in the world at values of the mechanism's first joint, which is revolute [m]."""
    joint = mechanism.joints[0]
    if spec.hand is None:
        raise ValueError(f"no hand holds anything in phase '{spec.name}'")
    axis = joint.axis / np.linalg.norm(joint.axis)
    return np.array([joint.origin + Rotation.from_rotvec(value * axis).apply(spec.hand.place) for value in values])


def measure_torque(body: WholeBody, spec: PhaseSpec, q: Float[np.ndarray, "n"]) -> float:
    """Return the largest share of a joint's torque at rest, with a phase's loads or without them.

    Joints of legs are left out: their torques depend on how the feet share the forces of the ground.
    """
    robot = body.robot
    model, data = robot.model, robot.model.createData()
    weight = np.array(pin.computeGeneralizedGravity(model, data, q))
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    held = np.zeros(model.nv)
    for load in spec.loads:
        link, tool = (data.oMf[model.getFrameId(frame)] for frame in (load.link, load.tool))
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.getFrameJacobian(model, data, model.getFrameId(load.tool), aligned)
        force = -link.rotation @ load.force
        arm = link.act(load.place) - tool.translation
        held += jacobian[:3].T @ force + jacobian[3:].T @ np.cross(arm, force)
    torque = np.maximum(np.abs(weight), np.abs(weight - held))
    for foot in body.planted:
        for joint in list(model.supports[locate_frame(robot, foot.link)[0]])[1:]:
            column = int(model.joints[joint].idx_v)
            torque[column : column + int(model.joints[joint].nv)] = 0.0
    limited = np.isfinite(robot.effort) & (robot.effort > 0.0)
    return float((torque[limited] / robot.effort[limited]).max(initial=0.0))


def find_shoulder(robot: RobotModel, q: Float[np.ndarray, "n"], hand: Hand) -> Float[np.ndarray, "3"]:
    """Return (3,) the place of a hand's shoulder in the world [m]."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return np.array(data.oMi[list_arm_joints(robot, hand.tool)[0]].translation)


def measure_arm(robot: RobotModel, hand: Hand, frame: str) -> float:
    """Return the length of the chain from the shoulder to a frame of the hand [m]; the arm is never longer."""
    inner = [robot.model.jointPlacements[joint].translation for joint in list_arm_joints(robot, hand.tool)[1:]]
    _, pose_joint_frame = locate_frame(robot, frame)
    return float(sum(np.linalg.norm(step) for step in (*inner, pose_joint_frame[:3, 3])))
