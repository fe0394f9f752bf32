"""Poses in equilibrium on a stance's contacts, with the shape and geometry costs of a phase."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import islice
from typing import Any

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from costs.allowance import Allowance, BodyRef
from costs.contact import Contact
from costs.contact_points import ContactPoints
from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import BASE_NAMES, RobotModel
from costs.scene import Scene
from costs.state import LoadedState, MotionState
from costs.static_region import StaticRegionError
from costs.stopping import poll
from costs.terms import AxisDirection, ContactForce, FramePose, FrictionPyramid, JointTarget, PointHalfSpace, Positive
from scopt import Cost, Residual, Settings, Status
from service.body.aims import Aims
from service.body.comfort import RESERVE_M, keep_in_region, reserve_balance
from service.body.effort import FORCE_SETTINGS
from service.body.facing import FLAT_POINTS
from service.body.forces.equilibrium_pose import EquilibriumPose, ForceLimits, solve_equilibrium_pose
from service.body.forces.loaded_regions import plan_contact_region
from service.body.paths import straight_path
from service.body.poses import PoseProblem, Poses
from service.body.whole_body import WholeBody
from service.request.tasks.egress import SideRequest, WeightsRequest
from service.tasks.egress.aims import ContactAim

TOUCHING_DEPTH_M = 3.3e-3  # aimed at in poses; less than what is allowed, for the motions between them [m]
MARGIN_M = 0.01  # clearance from the world; half of it between the robot's own links
STRICT = 100.0  # factor of the first penalty where a solve ended with violations that are merely acceptable
TURNS = (False,) * 3 + (True,) * 3  # rows of a frame's pose that are its orientation
UPRIGHT_GROUP, FEET_GROUP, ARM_GROUPS = "upright", "feet", ("left_arm", "right_arm")
ROOM_M = 0.015  # beyond it, kept where it is worth it: surfaces are rarely where a scan has them to the centimetre
THROUGH_M = 0.04  # how deep a straight way between two poses may lead through something
RESERVE_SHARE = 0.2  # of the mean force of the points of feet that are alone: error that each of them should bear
RESERVE_WEIGHT = 2000.0  # of what is missing of it [cost/weight^2]
LARGEST_LIMB = 10  # joints of a group that is a limb, not the whole body
WAY_WAYPOINTS = 8  # at which that is measured
TRIES = 8  # starts of a solve that has to succeed: the given ones, then these moved at random
BASE_SPREAD_M, JOINT_SPREAD = 0.05, 0.1  # standard deviations of moved starts [m, rad]


@dataclass(frozen=True)
class Shape:
    """What a pose should look like.

    Attributes:
        nominal: (n,) configuration to stay near; its pelvis and torso are the wanted orientations.
        weights: of the costs.
        sides: planes that points should not cross.
    """

    nominal: Float[np.ndarray, "n"]
    weights: WeightsRequest
    sides: tuple[SideRequest, ...] = ()

    def make_costs(self, body: WholeBody, aims: Sequence[ContactAim] = ()) -> list[Cost[MotionState]]:
        """Return the costs of a configuration at waypoint 0; feet count whose contacts may turn on their surfaces."""
        robot, weights = body.robot, self.weights
        joints = np.arange(len(BASE_NAMES), robot.n)
        posture = JointTarget(1, robot.n, np.arange(1), joints, self.nominal[joints])
        terms: list[tuple[str, Residual[MotionState], float]] = [("nominal posture", posture, weights.posture)]
        wanted = locate_links(body.engine, self.nominal, robot.link_groups.get(UPRIGHT_GROUP, ()))
        turning = {robot.contacts[aim.patch].link for aim in aims if aim.yaw_rad is None and aim.fixed is None}
        feet = [link for link in robot.link_groups.get(FEET_GROUP, ()) if link in turning]
        wanted |= locate_links(body.engine, self.nominal, feet)
        each = [weights.pelvis, weights.torso][: len(wanted) - len(feet)] + [weights.feet] * len(feet)
        for link, weight in zip(wanted, each, strict=True):
            terms.append((f"orientation of {link}", FramePose(robot, link, [0], wanted[link], TURNS), weight))
        for k, side in enumerate(self.sides):
            beyond = PointHalfSpace(robot, side.link, [0], np.array(side.normal), side.limit, np.array(side.point))
            terms.append((f"side {k} of {side.link}", Positive(beyond), side.weight))
        return [Cost(name, term, weight) for name, term, weight in terms if weight > 0.0]


@dataclass(frozen=True)
class PoseSolver:
    """Solver of poses of one robot in one scene.

    Attributes:
        body: the robot without planted links.
        torque_share: of each joint's limit that a pose may need; None for any torque.
        margin_n: error that the force at every contact point may have without leaving friction and cap [N].
        settings: of the optimiser.
        seed: of starts that are moved at random.
        should_stop: polled before every trial step.
    """

    body: WholeBody
    torque_share: float | None = 1.0
    margin_n: float = 0.0
    settings: Settings = FORCE_SETTINGS
    seed: int = 0
    should_stop: Callable[[], bool] | None = None

    @staticmethod
    def of(robot: RobotModel, scene: Scene, torque_share: float | None = 1.0, margin_n: float = 0.0) -> PoseSolver:
        """Return a solver for a robot in a scene.

        Raises:
            KeyError: the robot has no posture ``stand``.
        """
        body = WholeBody.standing(robot, scene, robot.postures["stand"], (), Aims(MARGIN_M))
        return PoseSolver(replace(body, has_default_costs=False, room_m=ROOM_M), torque_share, margin_n)

    def __reduce__(self) -> tuple[Callable[..., PoseSolver], tuple[object, ...]]:
        # The engine's data and model do not survive pickling together; another process makes its own.
        body = {field.name: getattr(self.body, field.name) for field in fields(self.body) if field.name != "engine"}
        return _restore_solver, (body, self.torque_share, self.margin_n, self.settings, self.seed)

    def solve(
        self,
        aims: Sequence[ContactAim],
        shape: Shape,
        guess: Float[np.ndarray, "n"] | None = None,
        loaded: Sequence[str] | None = None,
    ) -> EquilibriumPose:
        """Solve for a pose with all contacts in their places.

        Args:
            aims: the contacts.
            shape: what the pose should look like.
            guess: to start from; the nominal pose by default.
            loaded: patches that carry force; all by default.  The others touch and carry nothing.

        Raises:
            KeyError: the robot has no such patch.
            Stopped: within ``costs.stopping.stops_when``.
        """
        poll()
        robot = self.body.robot
        bearing = [aim for aim in aims if loaded is None or aim.patch in loaded]
        contacts = [_make_contact(robot, aim) for aim in bearing]
        normals = {k: aim.normal for k, aim in enumerate(bearing)}
        places = [term for aim in aims for term in aim.make_constraints(robot)]
        costs = [*shape.make_costs(self.body, aims), *_face_surfaces(robot, aims, shape.weights.facing)]
        costs += _keep_balanced(robot, bearing)
        relief = _relieve_arms(robot, contacts, normals, shape.weights.hand_forces)
        reserve = _keep_reserve(robot, contacts, normals)
        start = shape.nominal if guess is None else guess

        def solve(
            start: Float[np.ndarray, "n"], settings: Settings, force_terms: Sequence[Cost[LoadedState]]
        ) -> EquilibriumPose:
            return solve_equilibrium_pose(
                self.body,
                contacts,
                start,
                ForceLimits(self.torque_share, self.margin_n, world_normals=normals),
                costs,
                places,
                force_terms=force_terms,
                allowances=make_allowances(robot, aims),
                settings=settings,
                should_stop=self.should_stop,
            )

        pose = solve(start, self.settings, relief)
        if not pose.is_feasible and pose.result.status is Status.ACCEPTABLE:
            pose = solve(pose.q, replace(self.settings, penalty=STRICT * self.settings.penalty), relief)
        if not (pose.is_feasible and reserve):
            return pose
        better = solve(pose.q, replace(self.settings, penalty=STRICT * self.settings.penalty), [*relief, *reserve])
        return better if better.is_feasible else pose

    def solve_from(
        self,
        aims: Sequence[ContactAim],
        shapes: Sequence[Shape],
        guesses: Sequence[Float[np.ndarray, "n"]] = (),
        loaded: Sequence[str] | None = None,
        tries: int = TRIES,
        since: Float[np.ndarray, "n"] | None = None,
        swinging: Sequence[str] = (),
        n_compared: int = 1,
    ) -> EquilibriumPose:
        """Solve from one start after the other until a pose is feasible; the one with the largest reserve if none is.

        A pose counts as feasible only if a straight way leads to it from ``since``, unless there is no such pose.

        Args:
            aims: the contacts.
            shapes: what the pose may look like; the first is used with the guesses.
            guesses: starts to try before the shapes' nominal poses.
            loaded: patches that carry force; all by default.
            tries: largest number of starts.
            since: (n,) configuration from which the robot moves to the pose.
            swinging: patches that are not in contact on the way; their limbs may go around things.
            n_compared: number of feasible poses, the cheapest of which is returned; the nominal poses are then tried
                right after the first guess.
        """
        given, nominal = [(shapes[0], guess) for guess in guesses], [(shape, shape.nominal) for shape in shapes]
        starts = [*given, *nominal] if n_compared == 1 else [*given[:1], *nominal, *given[1:]]

        def leads_there(pose: EquilibriumPose) -> bool:
            return pose.is_feasible and (since is None or self.measure_way(since, pose.q, aims, swinging) <= THROUGH_M)

        problem = PoseProblem(
            "pose",
            lambda start: self.solve(aims, start[0], start[1], loaded),
            accepts=leads_there,
            miss=lambda pose: (not pose.is_feasible, -pose.reserve_n),
        )
        poses = Poses(problem)
        found = list(islice(poses.find(self._vary(starts, tries)), n_compared))
        if found:
            return min(found, key=measure_cost)
        assert poses.best is not None
        return poses.best

    def measure_way(
        self,
        first: Float[np.ndarray, "n"],
        last: Float[np.ndarray, "n"],
        aims: Sequence[ContactAim],
        swinging: Sequence[str] = (),
    ) -> float:
        """Return how deep the straight way between two poses leads through the robot itself or the scene [m].

        Limbs with swinging patches are left out.
        """
        robot = self.body.robot
        check = self.body.make_checker(make_allowances(robot, aims))
        contacts = check(self.body.engine(straight_path(first, last, WAY_WAYPOINTS)))
        free = find_limb_bodies(robot, swinging)
        counted = ~np.isin(contacts.body, free) & ~(contacts.is_self & np.isin(contacts.other, free))
        return float(-contacts.distance[counted].min(initial=0.0))

    def _vary(
        self, starts: Sequence[tuple[Shape, Float[np.ndarray, "n"]]], count: int
    ) -> Iterator[tuple[str, tuple[Shape, Float[np.ndarray, "n"]]]]:
        """Yield the starts by name, then the same moved at random."""
        robot, rng = self.body.robot, np.random.default_rng(self.seed)
        spread = np.full(robot.n, JOINT_SPREAD)
        spread[:3] = BASE_SPREAD_M
        for k in range(count):
            shape, guess = starts[k % len(starts)]
            if k >= len(starts):
                guess = np.clip(guess + spread * rng.normal(size=robot.n), robot.lower, robot.upper)
            yield f"start {k + 1}", (shape, guess)


def _restore_solver(
    body: dict[str, Any], torque_share: float | None, margin_n: float, settings: Settings, seed: int
) -> PoseSolver:
    """Return a solver sent by another process, which cannot stop it."""
    threadpool_limits(1, "blas")  # the matrices are small, and other processes use the other cores
    return PoseSolver(WholeBody(engine=KinematicsEngine(body["robot"]), **body), torque_share, margin_n, settings, seed)


def measure_cost(pose: EquilibriumPose) -> float:
    """Return ``C_p`` of Liu et al., Humanoids 2015: the sum of all costs of a pose."""
    return float(sum(pose.result.cost.values()))


def find_limb_bodies(robot: RobotModel, patches: Sequence[str]) -> list[int]:
    """Return the indices of the bodies of limbs (groups of the robot) that carry patches."""
    model = robot.model

    def find_joint(link: str) -> int:
        return int(model.frames[model.getFrameId(link)].parentJoint)

    tips = {find_joint(robot.contacts[patch].link) for patch in patches}
    limbs = [{int(model.getJointId(name)) for name in names} for names in robot.groups.values()]
    moved = set[int]().union(*(limb for limb in limbs if limb & tips and len(limb) <= LARGEST_LIMB))
    return [k for k, body in enumerate(robot.bodies) if find_joint(body.link) in moved]


def make_allowances(robot: RobotModel, aims: Sequence[ContactAim]) -> tuple[Allowance, ...]:
    """Return the allowances of links that touch the pieces behind their surfaces."""
    return tuple(
        Allowance(BodyRef.of_link(robot.contacts[aim.patch].link), BodyRef.of_piece(piece), TOUCHING_DEPTH_M)
        for aim in aims
        for piece in aim.surface.pieces
    )


def _make_contact(robot: RobotModel, aim: ContactAim) -> Contact:
    """Return the patch with the lower friction of patch and surface."""
    patch = robot.contacts[aim.patch]
    return replace(patch, friction=min(patch.friction, aim.surface.friction))


def _face_surfaces(robot: RobotModel, aims: Sequence[ContactAim], weight: float) -> list[Cost[MotionState]]:
    """Return costs that turn patches of few points towards their surfaces."""
    costs: list[Cost[MotionState]] = []
    for aim in aims:
        patch = robot.contacts[aim.patch]
        if weight > 0.0 and len(patch.points) < FLAT_POINTS:
            term = AxisDirection(robot, patch.link, [0], patch.normals.mean(axis=0), aim.normal)
            costs.append(Cost(f"{aim.patch} faces {aim.surface.name}", term, weight))
    return costs


def _relieve_arms(
    robot: RobotModel, contacts: Sequence[Contact], normals: dict[int, Float[np.ndarray, "3"]], weight: float
) -> list[Cost[LoadedState]]:
    """Return a cost of the forces on links of the arms."""
    joints = {robot.model.getJointId(name) for group in ARM_GROUPS for name in robot.groups.get(group, ())}
    is_arm = [robot.model.frames[robot.model.getFrameId(contact.link)].parentJoint in joints for contact in contacts]
    if weight <= 0.0 or not any(is_arm):
        return []
    gain = np.repeat(np.array(is_arm, dtype=float), [len(contact.points) for contact in contacts])
    points = ContactPoints.of(robot, contacts, normals)
    return [Cost("forces on the arms", ContactForce(points, [0], gain=gain), weight)]


def _keep_balanced(robot: RobotModel, bearing: Sequence[ContactAim]) -> list[Cost[MotionState]]:
    """Return a cost of a centre of mass near the edge of where contacts hold the robot, once their places are known."""
    contacts = [aim.fixed.planted for aim in bearing if aim.fixed is not None]
    if len(contacts) < len(bearing):
        return []
    try:
        region = plan_contact_region(robot, contacts)
    except StaticRegionError:
        return []
    return [reserve_balance(keep_in_region(region, np.arange(1), RESERVE_M), 1)]


def _keep_reserve(
    robot: RobotModel, contacts: Sequence[Contact], normals: dict[int, Float[np.ndarray, "3"]]
) -> list[Cost[LoadedState]]:
    """Return a cost of forces of feet near the edges of friction and caps, where nothing but feet carries the robot.

    All points of both feet are then loaded, so that a robot that sags in its servos, or whose surfaces are a little
    elsewhere, does not tip.  Hands or trunk in contact hold it anyway.
    """
    if not {contact.link for contact in contacts} <= set(robot.link_groups.get(FEET_GROUP, ())):
        return []
    points = ContactPoints.of(robot, contacts, normals)
    pyramid = FrictionPyramid(points, [0], RESERVE_SHARE / len(points))
    return [Cost("reserve of the feet", Positive(pyramid), RESERVE_WEIGHT)]
