"""Who carries the objects of steps: hands from a grasp to a release, the world before and after."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.robot import RobotModel
from costs.robot.carried import MovableObject, PlacedObject, with_objects
from costs.scene import ConvexPiece, Scene
from service.demands.contacts.contact_task import START_PATCHES
from service.demands.contacts.stances import StanceContact, make_contact_allowances
from service.demands.grasping.gripper import Gripper, list_grippers
from service.demands.grasping.objects import find_object
from service.demands.phase import TaskPhase
from service.errors import RequestError
from service.request.robot_parts import RobotServoRequest
from service.request.scene import ObjectRequest
from service.request.schema import PlanRequest
from service.request.tasks.step_objects import HoldStep, ReleaseStep
from service.request.tasks.steps import StepsSection
from service.start.resting import SUPPORT_DEPTH_M
from service.verify import Carrier, Grip, RelativePoseTarget, measure_rests, place_frames, place_resting

PAD_DEPTH_M = 3e-3  # of a finger in what it holds
CHAIN_M, CHAIN_RAD = 1e-3, 5e-3  # by which the second hand may move against the first
GRASP_M, GRASP_RAD = 5e-3, 0.035  # of a tool from a grasp of the request


@dataclass(frozen=True, eq=False)
class Item:
    """An object that steps take.

    Attributes:
        given: as the request gives it.
        body: at its start.
    """

    given: ObjectRequest
    body: MovableObject

    @property
    def name(self) -> str:
        """Of the object."""
        return self.body.name


@dataclass(frozen=True, eq=False)
class Hold:
    """An object in hands.

    Attributes:
        grippers: the leading one first.
        forces_n: with which each finger of a gripper presses, by gripper [N].
        friction: least coefficient between fingers and object.
        pose: (4, 4) of the object in the link of the leading gripper.
        chain: (4, 4) poses of further tools in the leading tool, by tool.
    """

    grippers: tuple[Gripper, ...]
    forces_n: tuple[float, ...]
    friction: float
    pose: Float[np.ndarray, "4 4"]
    chain: Mapping[str, Float[np.ndarray, "4 4"]]

    @property
    def tools(self) -> tuple[str, ...]:
        """Tool frames of the hands."""
        return tuple(gripper.tool for gripper in self.grippers)

    @property
    def fingers(self) -> tuple[str, ...]:
        """Coordinates of the fingers, which stay."""
        return tuple(dict.fromkeys(joint for gripper in self.grippers for joint in gripper.joints))

    def make_carrier(self, name: str) -> Carrier:
        """Return what carries the object."""
        grips = (
            Grip(own.fingers, min(force, own.force_n), self.friction)
            for own, force in zip(self.grippers, self.forces_n, strict=True)
        )
        return Carrier(name, self.grippers[0].link, tuple(grips))

    def find_stiffness(self, servo: RobotServoRequest) -> tuple[float, float]:
        """Return the stiffness of the hands together against a shift and against a turn [N/m, N m/rad].

        Args:
            servo: of one hand.
        """
        places = np.array([np.zeros(3), *(pose[:3, 3] for pose in self.chain.values())])
        arms = np.linalg.norm(places - places.mean(axis=0), axis=1)
        shift = len(places) * servo.hand_stiffness_n_m
        turn = len(places) * servo.hand_turn_stiffness_n_m_rad + servo.hand_stiffness_n_m * float(arms @ arms)
        return shift, turn

    def list_chain(self) -> tuple[RelativePoseTarget, ...]:
        """Return the promises that further hands keep their poses against the first."""
        leading = self.tools[0]
        return tuple(
            RelativePoseTarget(tool, leading, pose[:3, 3], pose[:3, :3], CHAIN_M, CHAIN_RAD)
            for tool, pose in self.chain.items()
        )


@dataclass(frozen=True, eq=False)
class Holding:
    """Where the objects are at the beginning of a step.

    Attributes:
        robot: without objects and without what hands push.
        scene: the pieces.
        items: that the steps take, by name.
        friction: least coefficient between hands and objects.
        servo: what the request says of hands that meet a surface.
        resting: (4, 4) poses in the world of those that the world carries, by name.
        held: the others, by name.
        fresh: pieces and objects that an object touches which was taken and not moved yet, by its name.
        stands: (n,) configuration at whose feet the robot stands; None for its start.
        braced: all contacts that carry it, where a hand or another link is among them besides its feet.
    """

    robot: RobotModel
    scene: Scene
    items: Mapping[str, Item]
    friction: float
    servo: RobotServoRequest
    resting: Mapping[str, Float[np.ndarray, "4 4"]]
    held: Mapping[str, Hold] = field(default_factory=dict)
    fresh: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    stands: Float[np.ndarray, "n"] | None = None
    braced: tuple[StanceContact, ...] = ()

    @staticmethod
    def of(section: StepsSection, request: PlanRequest, robot: RobotModel, scene: Scene) -> Holding:
        """Return the objects at the start, where the world carries them.

        Raises:
            RequestError: the scene lacks an object of a step.
        """
        items = {}
        for k, step in enumerate(section.steps):
            if step.taken is not None:
                found = find_object(request, step.taken.object, f"task.steps[{k}].{step.kind}.object")
                items[step.taken.object] = Item(*found)
        resting = {name: item.body.start for name, item in items.items()}
        return Holding(robot, scene, items, request.options.hand_friction[0], request.hand_servo, resting)

    @property
    def objects(self) -> tuple[MovableObject, ...]:
        """The objects as bodies."""
        return tuple(item.body for item in self.items.values())

    @cached_property
    def placed(self) -> RobotModel:
        """The robot with the objects."""
        return self.place(self.robot)

    def place(self, robot: RobotModel) -> RobotModel:
        """Return a robot with the objects where they are."""
        placed = []
        for name, item in self.items.items():
            hold = self.held.get(name)
            link, pose = (None, self.resting[name]) if hold is None else (hold.grippers[0].link, hold.pose)
            placed.append(PlacedObject(item.body, link, pose))
        return with_objects(robot, placed)

    @property
    def carriers(self) -> tuple[Carrier, ...]:
        """What carries each object."""
        return tuple(self.held[name].make_carrier(name) if name in self.held else Carrier(name) for name in self.items)

    @property
    def busy(self) -> frozenset[str]:
        """The frames of the hands that hold an object."""
        return frozenset(tool for hold in self.held.values() for tool in hold.tools)

    def list_company(self) -> tuple[frozenset[str], ...]:
        """Return the frames that move as one: an object and the hands that hold it."""
        return tuple(frozenset((name, *hold.tools)) for name, hold in self.held.items())

    def locate(self, name: str, q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "4 4"]:
        """Return pose_world_object at a configuration of the robot."""
        hold = self.held.get(name)
        if hold is None:
            return self.resting[name]
        link = hold.grippers[0].link
        return np.asarray(place_frames(self.robot, q[: self.robot.n], [link])[link] @ hold.pose)

    def take(self, name: str, grippers: tuple[Gripper, ...], force_n: float, q: Float[np.ndarray, "n"]) -> Holding:
        """Return the objects after a grasp that ends at a configuration, by hands besides those that hold it."""
        before = self.held.get(name)
        forces = (force_n,) * len(grippers)
        if before is not None:
            grippers, forces = (*before.grippers, *grippers), (*before.forces_n, *forces)
        hold = self._hold(name, grippers, forces, q)
        resting = {key: pose for key, pose in self.resting.items() if key != name}
        fresh = dict(self.fresh)
        if before is None:
            fresh[name] = self.find_rest(name, self.locate(name, q))[1]
        return replace(self, resting=resting, held={**self.held, name: hold}, fresh=fresh)

    def _hold(
        self, name: str, grippers: tuple[Gripper, ...], forces_n: tuple[float, ...], q: Float[np.ndarray, "n"]
    ) -> Hold:
        """Return an object in hands as they are at a configuration."""
        tools = [gripper.tool for gripper in grippers]
        poses = place_frames(self.robot, q[: self.robot.n], [grippers[0].link, *tools])
        leading = np.linalg.inv(poses[tools[0]])
        own = np.linalg.inv(poses[grippers[0].link]) @ self.locate(name, q)
        chain = {tool: leading @ poses[tool] for tool in tools[1:]}
        return Hold(grippers, forces_n, self.friction, own, chain)

    def let_go(
        self, step: ReleaseStep, field_name: str, q: Float[np.ndarray, "n"]
    ) -> tuple[Holding, tuple[Gripper, ...]]:
        """Return the objects from a release on that begins at a configuration, and the hands that open.

        Raises:
            RequestError: the hand does not hold it.
        """
        hold = self.held[step.object]
        opened = tuple(own for own in hold.grippers if step.hand in ("both", own.side))
        left = [k for k, own in enumerate(hold.grippers) if own not in opened]
        if not opened:
            holder = hold.grippers[0].side
            raise RequestError(f"{field_name}.hand: the {holder} hand holds '{step.object}', not the {step.hand} one")
        if not left:
            return self._put(step.object, q), opened
        grippers, forces = tuple(hold.grippers[k] for k in left), tuple(hold.forces_n[k] for k in left)
        own = self._hold(step.object, grippers, forces, q)
        return replace(self, held={**self.held, step.object: own}), opened

    def begin_with(self, step: HoldStep, field_name: str, q: Float[np.ndarray, "n"]) -> Holding:
        """Return the objects with one in hands at the start.

        Raises:
            RequestError: the robot has no such hand.
        """
        return self.take(step.object, choose_grippers(self.robot, step.hand, f"{field_name}.hand"), step.force_n, q)

    def _put(self, name: str, q: Float[np.ndarray, "n"]) -> Holding:
        """Return the objects with one where the world carries it."""
        held = {key: hold for key, hold in self.held.items() if key != name}
        fresh = {key: pieces for key, pieces in self.fresh.items() if key != name}
        return replace(self, resting={**self.resting, name: self.locate(name, q)}, held=held, fresh=fresh)

    def settle(self, waits: Collection[str] = ()) -> Holding:
        """Return the objects after a step that has moved all of those just taken, but for some, off what bore them."""
        return replace(self, fresh={name: pieces for name, pieces in self.fresh.items() if name in waits})

    def stand(self, q: Float[np.ndarray, "n"], contacts: tuple[StanceContact, ...]) -> Holding:
        """Return the objects after a step that ends at a configuration of the robot, on these contacts."""
        leans = any(contact.patch not in START_PATCHES for contact in contacts)
        return replace(self.settle(), stands=q, braced=contacts if leans else ())

    def list_brace_touches(self) -> tuple[Allowance, ...]:
        """Return the allowances of what carries the robot, where that is more than its feet."""
        return make_contact_allowances(self.braced)

    def find_rest(self, name: str, pose: Float[np.ndarray, "4 4"]) -> tuple[float, tuple[str, ...]]:
        """Return the margin with which an object rests at a pose in the world [m], and on which pieces and objects."""
        places = {**self.resting, name: pose}
        placed = [PlacedObject(self.items[own].body, None, at) for own, at in places.items()]
        robot = with_objects(self.robot, placed)
        rest = measure_rests([place_resting(robot, own.item) for own in placed], self.scene.pieces)[name]
        return rest.margin, rest.names

    def list_resting(self, apart_from: str) -> tuple[ConvexPiece, ...]:
        """Return the objects that the world carries as pieces, but for one of them."""
        names = (name for name in self.resting if name != apart_from)
        return tuple(
            ConvexPiece(name, self.items[name].body.vertices @ pose[:3, :3].T + pose[:3, 3])
            for name, pose in ((name, self.resting[name]) for name in names)
        )

    def list_touches(self) -> Iterator[Allowance]:
        """Yield what touches during the whole step: fingers and what they hold, and what it has rested on."""
        for name, hold in self.held.items():
            yield from list_pad_touches(name, hold.grippers)
        for name, pieces in self.fresh.items():
            yield from self.list_rest_touches(name, pieces)

    def list_rest_touches(self, name: str, others: tuple[str, ...]) -> Iterator[Allowance]:
        """Yield the allowances of an object with the pieces and objects on which it rests."""
        for other in others:
            rest = BodyRef.of_link(other) if other in self.items else BodyRef.of_piece(other)
            yield Allowance(BodyRef.of_link(name), rest, SUPPORT_DEPTH_M)


def carry_along(phase: TaskPhase, holding: Holding) -> TaskPhase:
    """Return a phase of a mechanism or of a walk with the objects where they are, on what carries the robot then."""
    touches = (*phase.touches, *holding.list_touches())
    chains = (target for hold in holding.held.values() for target in hold.list_chain())
    targets = (*phase.targets, *chains)
    own = replace(phase, touches=touches, targets=targets, carriers=holding.carriers, stands=holding.stands)
    if not holding.braced or phase.contacts is not None:
        return own
    return replace(own, touches=(*touches, *holding.list_brace_touches()), contacts=holding.braced)


def list_pad_touches(name: str, grippers: tuple[Gripper, ...]) -> Iterator[Allowance]:
    """Yield the allowances of fingers with an object."""
    for gripper in grippers:
        for finger in gripper.fingers:
            yield Allowance(BodyRef.of_link(finger), BodyRef.of_link(name), PAD_DEPTH_M)


def choose_grippers(robot: RobotModel, hand: str, field_name: str) -> tuple[Gripper, ...]:
    """Return the grippers of a robot that a request permits.

    Raises:
        RequestError: the robot has none.
    """
    grippers = list_grippers(robot, hand)
    if len(grippers) < (2 if hand == "both" else 1):
        wanted = "two hands" if hand == "both" else "a hand"
        raise RequestError(
            f"{field_name}: {hand} needs {wanted} with two fingers that slide, and robot "
            f"'{robot.name}' has {len(grippers)}; robot.hand: gripper gives the bundled robot some, "
            "robot.hands.SIDE.fingers names those of another robot"
        )
    return grippers


def _name_other(hands: tuple[str, ...], hand: str) -> str:
    """Return the hand that still holds an object when one of two lets it go."""
    known = [own for own in hands if own not in (hand, "both", "auto")]
    return known[0] if known else {"left": "right", "right": "left"}[hand]


def list_sequence_problems(section: StepsSection) -> Iterator[str]:
    """Yield a line per step that needs an object which no hand holds then, or a hand that is not free."""
    held: dict[str, tuple[str, ...]] = {}
    taken = set(section.carried)
    if section.steps and all(step.hold is not None for step in section.steps):
        yield "task.steps: nothing moves; expected a step after 'hold'"
    for k, step in enumerate(section.steps):
        field_name = f"task.steps[{k}].{step.kind}"
        if step.hold is not None and any(before.hold is None for before in section.steps[:k]):
            yield f"{field_name}: comes after another step; expected first, since it says what hands hold at the start"
        if step.taken is not None:
            name, hand = step.taken.object, step.taken.hand
            hands = held.get(name, ())
            if name in held and (hand in {"both", *hands} - {"auto"} or "both" in hands or len(hands) == 2):
                yield f"{field_name}.object: '{name}' is in a hand already; expected the other one, or release it first"
                continue
            busy = [other for other, own in held.items() if (hand in own and hand != "auto") or "both" in (*own, hand)]
            if busy or sum(map(len, held.values())) == 2:
                yield f"{field_name}.hand: {hand} holds '{(busy or list(held))[0]}' already; release that first"
                continue
            held[name] = (*hands, hand)
        elif step.release is not None:
            name, hand = step.release.object, step.release.hand
            hands = held.pop(name, ())
            if not hands:
                yield f"{field_name}.object: no hand holds '{name}' then; grasp it before"
            elif hand != "both" and not {hand, "both", "auto"} & set(hands):
                yield f"{field_name}.hand: the {hands[0]} hand holds '{name}' then, not the {hand} one"
            elif hand != "both" and (len(hands) == 2 or "both" in hands):
                held[name] = (_name_other(hands, hand),)
        elif step.fit is not None:
            if step.fit.object not in held:
                yield f"{field_name}.object: no hand holds '{step.fit.object}' then; grasp it before"
        elif step.move is not None or step.screw is not None:
            own = step.move or step.screw
            poses = () if step.move is None else step.move.poses
            assert own is not None
            for frame in (own.frame, *(pose.link for pose in poses)):
                if frame in taken and frame not in held:
                    yield f"{field_name}: no hand holds '{frame}' then; grasp it before"
