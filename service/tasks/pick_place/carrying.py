"""Phases of taking an object and putting it down by one choice of grasps, each with the body of its carriers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.allowance import BodyRef
from costs.kinematics import locate_frame
from costs.robot import RobotModel
from costs.state import MotionState
from costs.terms import HeldTorque
from scopt import Constraint, Cost
from service.body.holds import KeptPose
from service.body.ladder import Path, find_motion
from service.body.phases import PhaseSolver
from service.body.poses import find_pose
from service.body.starts import Way
from service.body.task_plan import PlannedPhase, Solved, Stuck
from service.body.whole_body import WholeBody
from service.demands.grasping.grasps import Grasp
from service.demands.phase import FrameMotion, TaskPhase
from service.demands.pick_place.hands import CHAIN_M, CHAIN_RAD, hold_grasp
from service.demands.pick_place.work import (
    APPROACH,
    CARRY,
    ENTER,
    GRASP,
    HELD,
    LIFT,
    LOWER,
    PHASES,
    RELEASE,
    RETREAT,
    PickPlace,
    place_object,
)
from service.tasks.chain import PhaseMotion, solve_phases
from service.tasks.hints import PhaseHints
from service.tasks.phase_compiler import PhaseCompiler
from service.tasks.pick_place.over import lead_in_balance, list_ways_over
from service.tasks.rest.earlier_motion import EarlierMotion
from service.verify import GRAVITY, Target

COME_M = 0.1  # of the line on which a hand comes and goes
HAND_MARGIN_M = 4e-3  # between a hand and what it takes, or what that rests on
BETWEEN_M = 4e-3  # between the object and what it passes close by as it is lifted and put down
AIM_RAD = 2e-3  # of a tool at a grasp
TORQUE_SHARE, TORQUE_TOLERANCE = 0.93, 0.01  # of the limits at rest while the object is carried
RESERVE_M = 1e-3  # of the depths of what may touch, for the curve between waypoints


def _give_hints(phase: TaskPhase) -> PhaseHints:
    return PhaseHints(depth_reserve_m=RESERVE_M)


@dataclass(frozen=True)
class CarrySequence:
    """A work with a choice of grasps, and a solver of each set of carriers.

    Attributes:
        work: the object and its places.
        grasps: of the hands, the leading one first.
        before, held, after: solvers with the object at its start, in the hands, and where it is put.
        is_patient: whether straight phases are tried in more than one way, and sampled paths on feet.
    """

    work: PickPlace
    grasps: tuple[Grasp, ...]
    before: PhaseSolver
    held: PhaseSolver
    after: PhaseSolver
    is_patient: bool = False

    @staticmethod
    def of(solver: PhaseSolver, work: PickPlace, grasps: tuple[Grasp, ...]) -> CarrySequence:
        """Make the solvers of a choice."""
        body, item = solver.body, work.item
        kept = _keep_chain(grasps)
        beside = {*work.supports, *work.ends_on}
        near = tuple(
            (BodyRef.of_link(link), ref, HAND_MARGIN_M)
            for grasp in grasps
            for link in (grasp.gripper.link, grasp.gripper.front, *grasp.gripper.fingers)
            for ref in (BodyRef.of_link(item.name), *map(BodyRef.of_piece, beside))
        )
        between = tuple((BodyRef.of_link(item.name), BodyRef.of_piece(name), BETWEEN_M) for name in beside)

        def carry(link: str | None, pose: Float[np.ndarray, "4 4"]) -> PhaseSolver:
            robot = place_object(body.robot, item, link, pose)
            placed = replace(body.with_robot(robot, body.nominal), kept=(*body.kept, *kept))
            return replace(solver, body=placed, overrides=(*solver.overrides, *near, *between))

        leading = grasps[0].gripper
        pose = _find_pose_in_link(body.robot, leading.link, leading.tool) @ np.linalg.inv(grasps[0].pose_object_tool)
        held = _share_weight(carry(leading.link, pose), work, grasps)
        return CarrySequence(work, grasps, carry(None, item.start), held, carry(None, work.place))

    def plan(
        self, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]
    ) -> tuple[tuple[PlannedPhase, ...], Stuck | None]:
        """Plan all phases; return those that were solved, and the step that was not.

        Args:
            first, last: configurations near those with the object taken, and put down.
        """
        taken = self._find_rest("pose to take it", LIFT, self.work.item.start, [first])
        if not taken.is_feasible:
            return self._stop("pose to take it", taken)
        put = self._find_rest("pose to put it down", LOWER, self.work.place, [last, taken.q])
        if not put.is_feasible:
            return self._stop("pose to put it down", put)
        numbers = {name: k for k, name in enumerate(PHASES)}
        poses = {
            numbers[GRASP]: self._set_fingers(taken.q, is_open=True),
            numbers[LIFT]: self._set_fingers(taken.q, is_open=False),
            numbers[RELEASE]: self._set_fingers(put.q, is_open=False),
            numbers[RETREAT]: self._set_fingers(put.q, is_open=True),
        }
        phases = [self._make_phase(name) for name in PHASES]
        chain = solve_phases(phases, self.before.body.nominal, poses, self)
        stuck = chain.stuck
        return chain.planned, None if stuck is None else replace(stuck, order=PHASES)

    def lead(
        self, phase: TaskPhase, first: Float[np.ndarray, "n"] | None, last: Float[np.ndarray, "n"] | None
    ) -> PhaseMotion:
        """Solve a phase that leads hands from its first configuration, backwards from its last, or between both."""
        compiler, hand = self._compile(phase), phase.frames[0]
        body, known = compiler.solver.body, first if first is not None else last
        if body.polygon is not None and hand.is_line and known is not None:
            count = compiler.count_waypoints(phase)
            led = lead_in_balance(body, hand, known, count, is_backwards=first is None)
            solver = compiler.solver if self.is_patient else replace(compiler.solver, most_starts=1)
            compiler = replace(compiler, solver=solver, earlier=EarlierMotion({phase.name: led}))
        return self._promise(compiler.lead(phase, first, last if not hand.is_line or first is None else None), body)

    def join(self, phase: TaskPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]) -> PhaseMotion:
        """Solve a phase between two configurations; an object is led over what is between them first."""
        compiler = self._compile(phase)
        body, tool = compiler.solver.body, self.grasps[0].gripper.tool
        moved = [locate_frame(body.robot, grasp.gripper.tool)[0] for grasp in self.grasps]
        search, vias = compiler.search_free(phase, first, last), compiler.search_free(phase, first, last).vias
        ways: dict[Way, Callable[[], Iterable[tuple[str, Path]]]] = {}
        if phase.name == CARRY:
            ways[Way.LED] = lambda: list_ways_over(body, tool, first, last, compiler.count_waypoints(phase))
        search = replace(
            search,
            paths={**search.paths, **ways},
            vias=lambda: [(name, self._keep_fingers(q, first)) for name, q in (vias or list)()],
            drawn=np.flatnonzero(body.engine.topology.supports[moved].any(axis=0)),
            is_sampled=self.is_patient or body.polygon is None,  # a standing robot needs trees seldom
        )
        solved = find_motion(search)
        made = PhaseMotion(solved.x, lambda: compiler.finish(phase, solved), Stuck.at(phase.name, solved))
        return self._promise(made, body)

    def _compile(self, phase: TaskPhase) -> PhaseCompiler:
        """Return the compiler of a phase, with what carries the object in it."""
        solver = self.held if phase.name in HELD else self.before
        solver = self.after if phase.name in (RELEASE, RETREAT) else solver
        if phase.name == APPROACH:  # the hands move freely against each other
            solver = replace(solver, body=replace(solver.body, kept=()))
        return PhaseCompiler(solver, hints=_give_hints)

    def _promise(self, attempt: PhaseMotion, body: WholeBody) -> PhaseMotion:
        """Return an attempt whose phase promises what the task demands of it, not how the planner went about it."""

        def plan() -> PlannedPhase:
            planned = attempt.plan()
            place = self.work.make_place_target
            return replace(
                planned,
                phase=self._demand(planned.name),
                at_waypoints=(lambda s: (place(float(s[-1])),)) if planned.name == LOWER else None,
                body=body,
            )

        return replace(attempt, plan=plan)

    def _demand(self, name: str) -> TaskPhase:
        """Return what the task demands of a phase."""
        targets: tuple[Target, ...] = ()
        if name == LIFT and self.work.given.grasps:
            targets = tuple(hold_grasp(self.work, grasp.gripper, grasp.pose_object_tool) for grasp in self.grasps)
        return self.work.make_phase(name, tuple(grasp.gripper for grasp in self.grasps), targets)

    def _make_phase(self, name: str) -> TaskPhase:
        """Return a phase as it is planned: with the ways of hands and fingers."""
        start, place = self.work.item.start, self.work.place
        up = np.array([0.0, 0.0, self.work.request.lift_m])
        along = self.grasps[0].along
        opened, closed = (True, True), (False, False)
        demand = self._demand(name)
        come = -COME_M * (start[:3, :3] @ along)
        go = -COME_M * (place[:3, :3] @ along)
        if name == APPROACH:
            names, nominal = self.before.body.robot.joint_names, self.before.body.nominal
            ends = self._list_values(opened)
            return replace(demand, joints={j: (float(nominal[names.index(j)]), v[1]) for j, v in ends.items()})
        if name == CARRY:
            return replace(demand, joints=self._list_values(closed))
        ways = {
            ENTER: (self._hand(start, come), opened),
            GRASP: (self._hand(start), (True, False)),
            LIFT: (replace(self._hand(start, up), leaves=True), closed),
            LOWER: (self._hand(place, up), closed),
            RELEASE: (self._hand(place), (False, True)),
            RETREAT: (replace(self._hand(place, go), leaves=True), opened),
        }
        hand, fingers = ways[name]
        return replace(demand, frames=(hand,), joints=self._list_values(fingers))

    def _find_rest(
        self, step: str, phase: str, pose_world_item: Float[np.ndarray, "4 4"], seeds: Sequence[Float[np.ndarray, "n"]]
    ) -> Solved:
        """Return a pose in which the hands hold the object where it rests."""
        rest = replace(
            self._demand(phase),
            name=step,
            frames=(self._hand(pose_world_item),),
            joints=self._list_values((False, False)),
        )
        compiler = PhaseCompiler(self.held, hints=_give_hints)
        return find_pose(compiler.pose_problem(step, rest, fraction=0.1), [("at hand", seed) for seed in seeds])

    def _stop(self, step: str, solved: Solved) -> tuple[tuple[PlannedPhase, ...], Stuck]:
        """Return the best attempt as a single phase, and the step it is stuck at."""
        q = np.concatenate([self.before.body.nominal[None], solved.x])
        return (PlannedPhase(self._demand(APPROACH), q, False),), Stuck(step, solved, PHASES)

    def _hand(
        self, pose_world_item: Float[np.ndarray, "4 4"], offset: Float[np.ndarray, "3"] | None = None
    ) -> FrameMotion:
        pose = pose_world_item @ self.grasps[0].pose_object_tool
        turn, tool = pose[:3, :3], self.grasps[0].gripper.tool
        return FrameMotion(tool, None, pose[:3, 3], turn[:, 2], offset, rotation=turn, aim_rad=AIM_RAD)

    def _list_values(self, is_open: tuple[bool, bool]) -> dict[str, tuple[float, float]]:
        """Return the fingers' joints at the beginning and at the end of a phase [m]."""
        values: dict[str, tuple[float, float]] = {}
        for grasp in self.grasps:
            first, last = (grasp.opened if opened else grasp.closed for opened in is_open)
            values |= {joint: (first[joint], last[joint]) for joint in first}
        return values

    def _set_fingers(self, q: Float[np.ndarray, "n"], *, is_open: bool) -> Float[np.ndarray, "n"]:
        """Return a configuration with the fingers open or closed."""
        out, names = q.copy(), self.before.body.robot.joint_names
        for joint, (value, _) in self._list_values((is_open, is_open)).items():
            out[names.index(joint)] = value
        return out

    def _keep_fingers(self, q: Float[np.ndarray, "n"], at: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return a configuration with the fingers as in another one."""
        out, names = q.copy(), self.before.body.robot.joint_names
        columns = [names.index(joint) for grasp in self.grasps for joint in grasp.closed]
        out[columns] = at[columns]
        return out


def _find_pose_in_link(robot: RobotModel, link: str, tool: str) -> Float[np.ndarray, "4 4"]:
    """Return ``pose_link_tool`` of a tool that is fixed to a link."""
    place, own = (locate_frame(robot, name)[1] for name in (link, tool))
    return np.asarray(np.linalg.inv(place) @ own)


def _keep_chain(grasps: Sequence[Grasp]) -> tuple[KeptPose, ...]:
    """Return the poses of further hands against the leading one."""
    kept = []
    for grasp in grasps[1:]:
        pose = np.linalg.inv(grasps[0].pose_object_tool) @ grasp.pose_object_tool
        kept.append(KeptPose(grasp.gripper.tool, grasps[0].gripper.tool, pose, pose, CHAIN_M, CHAIN_RAD))
    return tuple(kept)


def _share_weight(solver: PhaseSolver, work: PickPlace, grasps: Sequence[Grasp]) -> PhaseSolver:
    """Return the solver of the robot that carries the object, with the torques at rest of its arms limited."""
    body, item = solver.body, work.item
    loads = [(grasps[0].gripper.tool, 0.0)]
    if len(grasps) > 1:
        places = [grasp.pose_object_tool[:3, 3] for grasp in grasps[:2]]
        along = places[1] - places[0]
        share = float(np.clip((item.inertia.centre - places[0]) @ along / (along @ along), 0.0, 1.0))
        weight = share * GRAVITY * item.inertia.mass
        model = body.robot.model
        frame = model.frames[model.getFrameId(item.name)]
        spot = frame.placement * pin.SE3(np.eye(3), places[1])
        name = f"{item.name}/shared"
        model.addFrame(pin.Frame(name, frame.parentJoint, spot, pin.FrameType.OP_FRAME))
        loads = [(name, weight), (grasps[1].gripper.tool, -weight)]
    others = solver.terms

    def add(phase: str, robot: RobotModel, count: int) -> Sequence[Cost[MotionState] | Constraint[MotionState]]:
        own = []
        for name, force in loads:
            forces = np.tile([0.0, 0.0, force], (count, 1))
            limit = HeldTorque(robot, name, np.arange(count), forces, TORQUE_SHARE)
            if len(limit.limited):
                own.append(Constraint(f"torque of {name}", limit, tolerance=TORQUE_TOLERANCE, unit="1"))
        return (*others(phase, robot, count), *own)

    return replace(solver, terms=add)
