"""A robot on its feet in a scene, led by hand: a drag is a cost; what holds the robot up and apart are constraints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.collision import SweptCollisionChecker
from costs.kinematics import locate_links
from costs.robot import BASE_NAMES, RobotModel
from costs.scene import Scene
from costs.state import MotionState
from costs.terms import FramePose, JointTarget
from scopt import Cost, Iteration, Settings, TrustRegionSQP
from service.body.aims import Aims
from service.body.holds import POSITION, ROTATION, Hold
from service.body.inverse_kinematics import solve_holds
from service.body.whole_body import WholeBody
from service.demands.stance import Stance, make_standing_allowances
from service.errors import RequestError
from service.posing.drag import Drag, DragTarget, LedPose, Move
from service.posing.numbers import PoseNumbers
from service.posing.reading import read_pose, write_pose
from service.posing.stops import list_stops
from service.request.schema import Options
from service.start.configuration import find_unknown_joints, find_unknown_links
from service.verify import Phase, RestingPose, RestingPoses

POSITION_WEIGHT = 2000.0  # of a led link's distance from its target [cost/m^2]
ROTATION_WEIGHT = 100.0  # of its angle from its target [cost/rad^2]
JOINT_WEIGHT = 100.0  # of a led joint [cost/rad^2]
KEPT_WEIGHT = 400.0  # of hands that are not led, from where they are [cost/m^2]
KEPT_TURN_WEIGHT = 20.0  # the same of their angle [cost/rad^2]
DAMPING = 0.3  # of every joint, from where it is [cost/rad^2]
STRIDE_M, STRIDE_RAD = 0.03, 0.1  # that a link is led at once: farther targets pull no harder than constraints hold
MOST_STRIDES = 3  # of one event
STEP_RAD = 0.05  # largest step of a joint while targets move by a centimetre, and where they stay
STEP_PER_M = STEP_RAD / 0.01  # the same of targets that move farther [rad/m]
STEP_PER_RAD = 2.0  # the same of targets that turn, and of led joints
MOST_STEP_RAD = 0.4  # of a joint in one event, however far the targets move
BASE_SHARE = 0.5  # of the step of a joint that a floating base may make [m/rad, rad/rad]
ARRIVED_M, ARRIVED_RAD = 2e-3, 0.01  # from its target at which a link counts as there
STILL_RAD = 1e-4  # step of a joint after which further strides lead nowhere
GAIN = 0.3  # of the merit that a further step of the optimiser has to promise
PREVIEW_STEPS = 2  # of damped least squares
SHARES = (0.5, 0.25, 0.1)  # of a step that the verifier refuses which are tried in its place
OPTIONS = Options()
SETTINGS = Settings(max_iterations=6, penalty=100.0, max_penalty_raises=1, trust_radius=0.1)


@dataclass(frozen=True)
class PoseWorld:
    """A robot on its feet in its surroundings.

    Attributes:
        body: the robot where it stands; its nominal posture is that of the start.
    """

    body: WholeBody

    @staticmethod
    def standing(
        robot: RobotModel, scene: Scene, q: Float[np.ndarray, "n"], feet: Sequence[str], options: Options = OPTIONS
    ) -> PoseWorld:
        """Return a robot that stands on ``feet`` at configuration ``q``; none for a fixed base.

        Margins and clearance are those of ``options``.
        """
        return PoseWorld(WholeBody.standing(robot, scene, q, feet, Aims.of(options, robot, scene)))

    @property
    def robot(self) -> RobotModel:
        """The robot."""
        return self.body.robot

    @cached_property
    def handles(self) -> tuple[str, ...]:
        """Links that are usually led: hands, feet, and those that stay upright (pelvis, torso)."""
        groups = self.robot.link_groups
        named = (link for group in ("hands", "feet", "upright") for link in groups.get(group, ()))
        return tuple(dict.fromkeys(named))

    @cached_property
    def verifier(self) -> RestingPoses:
        """The checks of poses on these feet."""
        body = self.body
        feet = [contact.link for contact in body.planted]
        stance = Stance.of(self.robot, body.nominal, feet, body.aims.balance_margin, self.robot.can_balance)
        phase = Phase(
            "pose",
            0.0,
            1.0,
            contacts=stance.contacts,
            support=stance.support("pose", body.nominal),
            allowances=make_standing_allowances(self.robot, stance.contacts, body.scene),
        )
        demanded = body.aims.distances
        return RestingPoses(self.robot, body.scene, phase, body.nominal, demanded.clearance_m, demanded.padding)

    def find_problems(self, drag: Drag) -> list[str]:
        """Return what of a drag the robot does not have, a sentence each."""
        problem = drag.find_problem()
        if problem is not None:
            return [problem]
        unknown = find_unknown_links(self.robot, drag.links, "drag.targets")
        unknown += find_unknown_joints(self.robot, drag.joints, "drag.joints")
        planted = [link for link in drag.links if link in {contact.link for contact in self.body.planted}]
        stuck = [f"drag.targets: '{link}' stands and carries the robot; it cannot be led" for link in planted]
        return unknown + stuck

    def check(self, numbers: PoseNumbers) -> LedPose:
        """Check a given pose.

        Raises:
            RequestError: it is no pose of the robot, or the verifier finds something against it.
        """
        q = read_pose(self.robot, numbers)
        resting = self.verifier.check(q)
        if resting.failed:
            raise RequestError([f"pose: {check.text}" for check in resting.failed])
        return self._describe(numbers, q, resting, Drag())

    def preview(self, numbers: PoseNumbers, drag: Drag) -> LedPose:
        """Return a pose by damped least squares: feet, targets and joint limits count, nothing else.

        Raises:
            RequestError: the drag names something that the robot does not have.
        """
        self._require_known(drag)
        q = read_pose(self.robot, numbers)
        near = self._approach(q, drag)
        holds = (*self.body.holds(), *(hold for target in near.targets for hold in _make_holds(self.robot, target)))
        fixed = np.zeros(self.robot.n, dtype=bool)
        guess = q.copy()
        for name, value in near.joints.items():
            column = self.robot.joint_names.index(name)
            guess[column], fixed[column] = np.clip(value, self.robot.lower[column], self.robot.upper[column]), True
        moved = solve_holds(self.body, guess[None], holds, fixed, PREVIEW_STEPS)[0][0] if holds else guess
        miss_m, miss_rad = self._measure_misses(moved, drag)
        return LedPose(write_pose(self.robot, moved), False, miss_m, miss_rad)

    def lead(self, numbers: PoseNumbers, drag: Drag, move: Move) -> LedPose:
        """Return the pose nearest to a drag that the verifier finds nothing against, near the pose before.

        Args:
            numbers: the pose before, which was checked.
            drag: where links and joints are led to.
            move: of its targets since the event before; joints move little where targets do.

        Raises:
            RequestError: the drag names something that the robot does not have.
        """
        self._require_known(drag)
        first = q = read_pose(self.robot, numbers)
        most = float(np.clip(STEP_PER_M * move.metres + STEP_PER_RAD * move.radians, STEP_RAD, MOST_STEP_RAD))
        left = SETTINGS.max_iterations
        for _ in range(MOST_STRIDES):
            before = q
            q, used = self._stride(q, drag, (first - most * self._step_scale, first + most * self._step_scale), left)
            left -= used
            if left <= 0 or self._has_arrived(q, drag) or np.abs(q - before).max() < STILL_RAD:
                break
        return self._keep_good(first, q, numbers, drag)

    def _require_known(self, drag: Drag) -> None:
        problems = self.find_problems(drag)
        if problems:
            raise RequestError(problems)

    @cached_property
    def _step_scale(self) -> Float[np.ndarray, "n"]:
        scale = np.ones(self.robot.n)
        if self.robot.is_floating:
            scale[: len(BASE_NAMES)] = BASE_SHARE
        return scale

    @cached_property
    def _checker(self) -> SweptCollisionChecker:
        return self.body.make_checker((), [self.body.nominal])

    def _stride(
        self,
        q: Float[np.ndarray, "n"],
        drag: Drag,
        near_first: tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]],
        most_iterations: int,
    ) -> tuple[Float[np.ndarray, "n"], int]:
        """Return the pose after a stride towards a drag, and the iterations that it took.

        The pose stays where none keeps the constraints.

        Args:
            q: the pose before the stride.
            drag: where it is led to.
            near_first: bounds about the first pose of the event.
            most_iterations: of the optimiser.
        """
        least, most = near_first
        lower, upper = self.body.bounds(1, {})
        lower, upper = np.minimum(np.maximum(lower, least), q), np.maximum(np.minimum(upper, most), q)
        near = self._approach(q, drag)
        problem = self.body.make_problem(lower, upper, self._checker, tuple(self._make_costs(q, near)))
        tolerances = {term.name: term.tolerance for term in problem.constraints}
        latest: list[tuple[Iteration, Float[np.ndarray, "n"]]] = []

        def note(iteration: Iteration, x: Float[np.ndarray, "T n"]) -> None:
            latest[:] = [(iteration, x[0])]

        def is_enough() -> bool:
            """Return whether the latest step keeps all constraints and is near the target, or gained little."""
            if not latest or not latest[0][0].is_accepted:
                return False
            iteration, x = latest[0]
            if any(iteration.violation[name] > tolerance for name, tolerance in tolerances.items()):
                return False
            gained = iteration.merit - iteration.trial_merit
            return gained < GAIN * iteration.merit or self._has_arrived(x, near)

        settings = replace(SETTINGS, max_iterations=most_iterations)
        result = TrustRegionSQP(settings).solve(problem, q[None], note, is_enough)
        return (result.x[0] if result.is_feasible else q), len(result.history)

    def _make_costs(self, q: Float[np.ndarray, "n"], near: Drag) -> Iterator[Cost[MotionState]]:
        """Yield the costs of a stride: led links and joints, hands that stay where they are, and every joint's step."""
        robot = self.robot
        for target in near.targets:
            yield from _make_pose_costs(robot, target, POSITION_WEIGHT, ROTATION_WEIGHT)
        still = [link for link in robot.link_groups.get("hands", ()) if link not in near.links and not near.joints]
        for link, pose in locate_links(self.body.engine, q, still).items():
            yield from _make_pose_costs(robot, _make_target(link, pose), KEPT_WEIGHT, KEPT_TURN_WEIGHT)
        joints = np.arange(len(BASE_NAMES) if robot.is_floating else 0, robot.n)
        yield Cost("step", JointTarget(1, robot.n, np.zeros(1, int), joints, q[joints]), DAMPING)
        if near.joints:
            columns = np.array([robot.joint_names.index(name) for name in near.joints])
            values = np.array(list(near.joints.values()))
            yield Cost("led joints", JointTarget(1, robot.n, np.zeros(1, int), columns, values), JOINT_WEIGHT)

    def _approach(self, q: Float[np.ndarray, "n"], drag: Drag) -> Drag:
        """Return the drag with targets at most a stride from where the links are."""
        here = locate_links(self.body.engine, q, drag.links)
        joints = {}
        for name, value in drag.joints.items():
            own = float(q[self.robot.joint_names.index(name)])
            joints[name] = own + float(np.clip(value - own, -STRIDE_RAD, STRIDE_RAD))
        return Drag(tuple(_shorten(here[target.link], target) for target in drag.targets), joints)

    def _measure_misses(self, q: Float[np.ndarray, "n"], drag: Drag) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return distance and angle of every target's link from its target [m], [rad]."""
        here = locate_links(self.body.engine, q, drag.links)
        misses = [_measure_miss(here[target.link], target) for target in drag.targets]
        return tuple(metres for metres, _ in misses), tuple(radians for _, radians in misses)

    def _has_arrived(self, q: Float[np.ndarray, "n"], drag: Drag) -> bool:
        miss_m, miss_rad = self._measure_misses(q, drag)
        off = [abs(value - q[self.robot.joint_names.index(name)]) for name, value in drag.joints.items()]
        return max(miss_m, default=0.0) < ARRIVED_M and max((*miss_rad, *off), default=0.0) < ARRIVED_RAD

    def _keep_good(
        self, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"], numbers: PoseNumbers, drag: Drag
    ) -> LedPose:
        """Return the last pose if the verifier finds nothing against it, else one on the way to it, else the first."""
        refused: RestingPose | None = None
        for share in (1.0, *SHARES):
            step = first + share * (last - first)
            if share < 1.0:
                step = self.body.project_onto_holds(np.stack([first, step]))[1]
            written = write_pose(self.robot, step)
            try:
                q = read_pose(self.robot, written)
            except RequestError:  # the projection has led a joint beyond its limits
                continue
            resting = self.verifier.check(q)
            if not resting.failed:
                return self._describe(written, q, resting, drag, refused)
            refused = refused or resting
        return self._describe(numbers, first, self.verifier.check(first), drag, refused)

    def _describe(
        self,
        numbers: PoseNumbers,
        q: Float[np.ndarray, "n"],
        resting: RestingPose,
        drag: Drag,
        refused: RestingPose | None = None,
    ) -> LedPose:
        miss_m, miss_rad = self._measure_misses(q, drag)
        stops = () if self._has_arrived(q, drag) else list_stops(self.body, q, resting, drag, miss_m, refused)
        nearest = resting.nearest
        return LedPose(
            numbers,
            not resting.failed,
            miss_m,
            miss_rad,
            stops,
            None if nearest is None else nearest.distance_m,
            resting.balance_margin_m,
            resting.torque_share,
        )


def _rotation(quaternion_wxyz: tuple[float, float, float, float]) -> Rotation:
    return Rotation.from_quat(quaternion_wxyz, scalar_first=True)


def _make_target(link: str, pose: Float[np.ndarray, "4 4"]) -> DragTarget:
    x, y, z = pose[:3, 3].tolist()
    qw, qx, qy, qz = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True).tolist()
    return DragTarget(link, (x, y, z), (qw, qx, qy, qz))


def _make_matrix(target: DragTarget) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, 3] = target.position
    if target.quaternion_wxyz is not None:
        pose[:3, :3] = _rotation(target.quaternion_wxyz).as_matrix()
    return pose


def _make_pose_costs(
    robot: RobotModel, target: DragTarget, weight: float, turn_weight: float
) -> Iterator[Cost[MotionState]]:
    pose = _make_matrix(target)
    yield Cost(f"position of {target.link}", FramePose(robot, target.link, [0], pose, POSITION), weight)
    if target.quaternion_wxyz is not None:
        yield Cost(f"orientation of {target.link}", FramePose(robot, target.link, [0], pose, ROTATION), turn_weight)


def _make_holds(robot: RobotModel, target: DragTarget) -> Iterator[Hold]:
    pose = _make_matrix(target)
    axes = POSITION if target.quaternion_wxyz is None else (True,) * 6
    yield lambda waypoints: FramePose(robot, target.link, waypoints, pose, axes)


def _measure_miss(here: Float[np.ndarray, "4 4"], target: DragTarget) -> tuple[float, float]:
    metres = float(np.linalg.norm(here[:3, 3] - target.position))
    if target.quaternion_wxyz is None:
        return metres, 0.0
    return metres, float((Rotation.from_matrix(here[:3, :3]).inv() * _rotation(target.quaternion_wxyz)).magnitude())


def _shorten(here: Float[np.ndarray, "4 4"], target: DragTarget) -> DragTarget:
    """Return a target at most a stride from where its link is."""
    metres, radians = _measure_miss(here, target)
    x, y, z = (here[:3, 3] + min(1.0, STRIDE_M / max(metres, STRIDE_M)) * (target.position - here[:3, 3])).tolist()
    near = replace(target, position=(x, y, z))
    if target.quaternion_wxyz is None or radians <= STRIDE_RAD:
        return near
    own = Rotation.from_matrix(here[:3, :3])
    way = (own.inv() * _rotation(target.quaternion_wxyz)).as_rotvec()
    turned = own * Rotation.from_rotvec(way * (STRIDE_RAD / radians))
    qw, qx, qy, qz = turned.as_quat(scalar_first=True).tolist()
    return replace(near, quaternion_wxyz=(qw, qx, qy, qz))
