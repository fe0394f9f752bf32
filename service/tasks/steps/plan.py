"""Plan steps one after the other; a step that cannot be done ends the plan with its best attempt."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.rotation import pose_matrix
from costs.scene import ConvexPiece
from service.body.forces.loaded_regions import plan_contact_region
from service.body.phases import PhaseSolver
from service.body.task_plan import PlannedPhase, Stuck, TaskPlan
from service.body.whole_body import WholeBody
from service.demands.grasping.gripper import Gripper
from service.demands.steps.compile import compile_step
from service.demands.steps.demand import StepsDemand
from service.demands.steps.extent import Extent, NamedStep
from service.demands.steps.frames import list_carriers, map_tools
from service.demands.steps.holding import Holding, Item, carry_along, choose_grippers
from service.demands.steps.objects import Fit, Taking
from service.demands.steps.phases import PhaseMaker
from service.demands.steps.walking import list_walking_phases, read_stances, rename_finish
from service.errors import RequestError
from service.request.tasks.step_objects import FitStep, GraspStep
from service.request.tasks.steps import StepsSection
from service.setup.prepare import PlanSetup
from service.tasks.contacts.motion import plan_contact_motion
from service.tasks.handling import FARTHER, find_collisions
from service.tasks.phase_terms import shrink
from service.tasks.sequence import add_mechanism
from service.tasks.steps.choices import (
    MOST_CHOICES,
    Pick,
    find_blocked,
    list_choices,
    list_holder,
    list_off_middle,
    rank_choices,
)
from service.tasks.steps.pushed import plan_part
from service.tasks.steps.refusals import describe_weight, find_obstacle
from service.tasks.steps.solve import StepSolver, Tried
from service.tasks.steps.weights import limit_own_torques, place_objects

NEAR_M = 0.06  # of a piece from an object, to count as beside it


def plan_steps(section: StepsSection, setup: PlanSetup, plain: PhaseSolver) -> Iterator[TaskPlan]:
    """Yield the plan of all steps up to the first at which it ends, or up to the one that cannot be done.

    Raises:
        RequestError: a hand does not touch what it is to push, or the robot is inside it at the start.
    """
    start = Holding.of(section, setup.request, setup.robot, setup.scene)
    demand, extent = StepsDemand(section, start), Extent.of(section)
    notes = tuple(extent.list_notes())
    if all(named.step.hold is not None for named in extent.done):
        words = f"nothing comes before step '{extent.rest[0].name}'; plan the steps after it"
        yield TaskPlan(plain.body, (), (words,), notes=notes, objects=demand.objects)
        return
    mechanism = demand.moved
    solver = plain if mechanism is None else add_mechanism(plain, mechanism)
    collisions = () if mechanism is None else tuple(find_collisions(solver.body, remedy=FARTHER))
    if collisions:
        raise RequestError(collisions)
    for own in (solver, limit_own_torques(solver)):  # the second where the first asks too much of an arm
        if own is None:
            return
        walk = _Walk(plain, own, setup, demand, extent.done)
        done = walk.run(0, _State(solver.body.nominal, solver.body.nominal[plain.body.robot.n :], start))
        yield _make_plan(solver.body, demand, extent, done)
        if done.tried is not None:
            return


def _make_plan(body: WholeBody, demand: StepsDemand, extent: Extent, done: _Done) -> TaskPlan:
    """Return the phases of steps as a plan, with the reason why it ends before the last one."""
    notes = (*extent.list_notes(), *done.notes)
    plan = TaskPlan(body, tuple(done.phases), notes=notes, measure=demand.measure, objects=demand.objects)
    if done.tried is not None:
        tried, named = done.tried, extent.done[done.failed]
        stuck = None if tried.solved is None else Stuck(tried.name, tried.solved, done.order)
        obstacle = tuple(f"step '{named.name}': {reason}" for reason in tried.reasons)
        plan = replace(plan, obstacle=obstacle, stuck=stuck, is_impossible=tried.is_impossible)
    return plan


@dataclass(frozen=True, eq=False)
class _State:
    """What the steps so far have reached.

    Attributes:
        at: (n,) configuration, with all parts.
        values: (k,) of the parts' joints.
        holding: who carries the objects.
    """

    at: Float[np.ndarray, "n"]
    values: Float[np.ndarray, "k"]
    holding: Holding


@dataclass(frozen=True, eq=False)
class _Done:
    """Phases of steps, the best attempt last.

    Attributes:
        phases: of them.
        order: names of all phases up to the step that was not solved.
        tried: what was not solved; None where all were.
        failed: index of its step.
        after: what the steps have reached.
        notes: choices that were made.
    """

    phases: list[PlannedPhase]
    order: tuple[str, ...]
    tried: Tried | None = None
    failed: int = 0
    after: _State | None = None
    notes: tuple[str, ...] = ()


class _Walk:
    """Steps in their order, from the configuration that the ones before have reached."""

    def __init__(
        self,
        plain: PhaseSolver,
        solver: PhaseSolver,
        setup: PlanSetup,
        demand: StepsDemand,
        steps: tuple[NamedStep, ...],
    ) -> None:
        self._plain, self._solver, self._setup, self._demand, self._steps = plain, solver, setup, demand, steps

    def run(self, index: int, state: _State) -> _Done:
        """Return the phases of all steps from an index on; a grasp that leads nowhere gives way to another."""
        if index == len(self._steps):
            return _Done([], ())
        best: _Done | None = None
        until = self._find_release(index)
        for done in self._list_ways(index, state):
            if done.tried is None:
                assert done.after is not None
                rest = self.run(index + 1, done.after)
                phases, order = [*done.phases, *rest.phases], (*done.order, *rest.order)
                notes = (*done.notes, *rest.notes)
                done = replace(done, phases=phases, order=order, tried=rest.tried, failed=rest.failed, notes=notes)
            if done.tried is None:
                return done
            if best is None or len(done.phases) > len(best.phases):
                best = done
            if done.failed > until:
                break
        assert best is not None
        return best

    def _find_release(self, index: int) -> int:
        """Return the index of the step whose hand lets go of what a step takes; of the step itself where none does.

        A hand that a release does not name is taken for the one that has held the object for longest.
        """
        grasp = self._steps[index].step.taken
        if grasp is None:
            return index
        before = 0
        for named in self._steps[:index]:
            if named.step.taken is not None and named.step.taken.object == grasp.object:
                before += 1
            elif named.step.release is not None and named.step.release.object == grasp.object:
                before = 0 if named.puts_down else before - 1
        for k in range(index + 1, len(self._steps)):
            release = self._steps[k].step.release
            if release is None or release.object != grasp.object:
                continue
            hands = {release.hand, grasp.hand}
            if len(hands) == 1 or "both" in hands or ("auto" in hands and not before):
                return k
            before -= 1
        return len(self._steps)

    def _list_ways(self, index: int, state: _State) -> Iterator[_Done]:
        """Yield ways of doing a step: one, or one for each choice of a grasp."""
        named = self._steps[index]
        if named.index in self._demand.parts.parts:
            yield self._push(index, state)
        elif named.step.hold is not None:
            field_name = f"task.steps[{named.index}].hold"
            holding = state.holding.begin_with(named.step.hold, field_name, state.at)
            yield _Done([], (), None, index, replace(state, holding=holding))
        elif named.step.changes_contacts:
            yield self._walk(index, state)
        elif named.step.grasp is not None:
            yield from self._take(index, named.step.grasp, state)
        else:
            yield self._move(index, state)

    def _push(self, index: int, state: _State) -> _Done:
        named, holding = self._steps[index], state.holding
        n = self._plain.body.robot.n
        plain = self._place(self._plain, holding, state.at[:n])
        own = self._place(self._solver, holding, state.at)
        parts, busy, held = self._demand.parts, holding.busy, list_kept_joints(holding)
        still = tuple(_keep_joints(solver, held, state.at) for solver in (plain, own))
        phases, tried = plan_part(still[0], still[1], parts, named, state.at, state.values, busy)
        if holding.items or holding.stands is not None:
            phases = [replace(phase, phase=carry_along(phase.phase, holding), body=own.body) for phase in phases]
        order = tuple(phase.name for phase in phases)
        values = self._demand.parts.advance(named.index, state.values)
        after = None if tried is not None else _State(phases[-1].q[-1], values, holding.settle())
        return _Done(phases, order, tried, index, after)

    def _walk(self, index: int, state: _State) -> _Done:
        named, holding = self._steps[index], state.holding
        try:
            stances, finish = read_stances(holding, self._setup.scene, named.step, named.name, state.at)
        except RequestError as error:
            return _Done([], (), Tried(named.name, error.problems), index)
        own = self._place(self._solver, holding, state.at)
        moving = own.body.robot
        held = {*moving.joint_names[moving.n - len(state.values) :], *list_kept_joints(holding)}
        own = _keep_joints(own, held, state.at)
        posture = None if finish is None else own.body.robot.postures[finish]
        made = plan_contact_motion(own, stances, posture)
        phases = [_walk_on(phase, named.name, holding, moving) for phase in made.phases]
        order = tuple(phase.name for phase in list_walking_phases(holding, stances, finish, named.name))
        if made.reasons:
            best = None if made.stuck is None else made.stuck.best
            return _Done(phases, order, Tried(named.name, made.reasons, best), index)
        q = phases[-1].q[-1]
        standing = holding.stand(q[: self._setup.robot.n], stances[-1].contacts)
        return _Done(phases, order, None, index, _State(q, state.values, standing))

    def _move(self, index: int, state: _State) -> _Done:
        named, holding, at = self._steps[index], state.holding, state.at
        step = named.step
        released: tuple[Gripper, ...] = ()
        if step.release is not None:
            try:
                holding, released = holding.let_go(step.release, f"task.steps[{named.index}].release", at)
            except RequestError as error:
                return _Done([], (), Tried(named.name, error.problems), index)
        if step.fit is not None:
            reason = _explain_fit(step.fit, holding.items[step.fit.object], holding.locate(step.fit.object, at))
            if reason is not None:
                return _Done([], (), Tried(named.name, (reason,)), index)
        makers = compile_step(holding, named, None, released)
        phases, tried = _plan_step(self._solve(holding, at), makers, at)
        if tried is not None and not tried.reasons and tried.solved is not None:
            q = tried.solved.x[-1]
            lines = [describe_weight(self._solver.body, holding, name, q) for name in holding.held]
            tried = replace(tried, reasons=tuple(line for line in lines if line))
        order = tuple(maker.name for maker in makers)
        reached = None if tried is not None else _State(phases[-1].q[-1], state.values, holding.settle(named.waits))
        return _Done(phases, order, tried, index, reached)

    def _take(self, index: int, step: GraspStep, state: _State) -> Iterator[_Done]:
        named, holding, at = self._steps[index], state.holding, state.at
        grippers = choose_grippers(self._setup.robot, step.hand, f"task.steps[{named.index}].grasp.hand")
        grippers = tuple(gripper for gripper in grippers if gripper.tool not in holding.busy)
        pick, put = self._find_places(index, step, holding, at)
        own = self._solve(holding, at)
        body = own.solver.body

        def refuse(reason: str, *, is_impossible: bool) -> _Done:
            return _Done([], (), Tried(named.name, (reason,), is_impossible=is_impossible), index)

        if isinstance(put, _Done):
            yield put
            return
        is_first = bool(np.allclose(pick.places[0][0], pick.item.body.start))
        reason = find_obstacle(body, holding, pick, put, grippers) if grippers else None
        choices, refused = list_choices(pick, grippers) if reason is None else ([], ())
        if reason is None and not choices:
            reason = f"{step.object} is {refused[0]}" if refused else f"no hand is free to take {step.object}"
        if reason is not None:
            yield refuse(reason, is_impossible=is_first)
            return
        ranked, n_free = [], 0
        for listed in (choices, list_off_middle(pick, grippers)):
            free = [choice for choice in listed if find_blocked(body, pick, choice) is None]
            n_free += len(free)
            own_body = self._solver.body if not holding.items else body
            ranked = rank_choices(own_body, pick, free, holding.friction)
            if ranked:
                break
        if not n_free:
            yield refuse(str(find_blocked(body, pick, choices[0])), is_impossible=is_first)
            return
        if not ranked:
            where = " and ".join(words for _, words in pick.places)
            words = f"no hand reaches any of the {n_free} grasps of {step.object} {where}, in balance"
            yield refuse(words, is_impossible=False)
            return
        for choice in ranked[:MOST_CHOICES]:
            makers = compile_step(holding, named, Taking(choice.grippers, choice.grasps))
            phases, tried = _plan_step(own, makers, at)
            order = tuple(maker.name for maker in makers)
            after = None
            if tried is None:
                q = phases[-1].q[-1]
                taken = holding.settle(named.waits).take(step.object, choice.grippers, step.force_n, q)
                after = _State(q, state.values, taken)
            yield _Done(phases, order, tried, index, after, (f"{step.object} is taken by {choice.describe()}",))

    def _find_places(
        self, index: int, step: GraspStep, holding: Holding, at: Float[np.ndarray, "n"]
    ) -> tuple[Pick, Float[np.ndarray, "4 4"] | _Done | None]:
        """Return where an object is taken and brought, and where it is let go, as far as steps say so in the world.

        Where it would not find into a hole on its way, that step is returned as what cannot be done.
        """
        item = holding.items[step.object]
        here = holding.locate(step.object, at)
        places, pose, is_known, has_walked = [(here, "where it is")], here, True, False
        until = self._find_release(index)
        for number, named in enumerate(self._steps[index + 1 : until], start=index + 1):
            own = named.step
            has_walked = has_walked or own.changes_contacts  # other places are reached from where the feet are then
            led = () if own.move is None else own.move.poses
            wanted = [each for each in led if each.link == step.object and each.is_plain]
            if wanted:
                turned = pose[:3, :3] if wanted[0].quaternion_wxyz is None else None
                pose = pose_matrix(wanted[0].origin, wanted[0].quaternion_wxyz or (1.0, 0.0, 0.0, 0.0))
                if turned is not None:
                    pose[:3, :3] = turned
                is_known = True
                if not has_walked:
                    places.append((pose, f"at {np.round(pose[:3, 3], 3).tolist()} ('{named.name}')"))
            elif own.fit is not None and own.fit.object == step.object:
                reason = _explain_fit(own.fit, item, pose) if is_known else None
                if reason is not None:
                    return Pick(item, step, tuple(places)), _Done([], (), Tried(named.name, (reason,)), number)
                axis = np.asarray(own.fit.axis) / np.linalg.norm(own.fit.axis)
                pose = pose.copy()
                pose[:3, 3] += own.fit.depth_m * axis
            elif own.move is not None and own.move.by is not None and own.move.frame == step.object:
                pose = pose.copy()
                pose[:3, 3] += np.asarray(own.move.by.translation)
                is_known = is_known and own.move.by.axes == "world" and not any(own.move.by.rotation_deg)
            elif own.move is not None or own.screw is not None or own.body is not None:
                is_known = False
        is_put = until < len(self._steps) and self._steps[until].puts_down
        put = pose if is_known and is_put else None
        if put is not None and not has_walked and not np.allclose(put, places[-1][0]):
            places.append((put, "where it is put"))
        return Pick(item, step, tuple(places), tuple(self._list_holders(step.object, holding, at))), put

    def _list_holders(self, name: str, holding: Holding, at: Float[np.ndarray, "n"]) -> Iterator[ConvexPiece]:
        """Yield the bodies of the hands that hold an object, at a configuration."""
        hold, robot = holding.held.get(name), self._setup.robot
        for gripper in () if hold is None else hold.grippers:
            yield from list_holder(robot, gripper, at[: robot.n])

    @cached_property
    def _near(self) -> tuple[str, ...]:
        """Pieces that objects are beside, where they are or are brought."""
        holding = self._demand.start
        names: dict[str, None] = {}
        for index, named in enumerate(self._steps):
            taken = named.step.taken
            if taken is None:
                continue
            grasp = named.step.grasp or GraspStep(taken.object)
            pick, _ = self._find_places(index, grasp, holding, self._solver.body.nominal)
            for pose, _ in (*pick.places, (pick.item.body.start, "")):
                corners = pick.item.body.vertices @ pose[:3, :3].T + pose[:3, 3]
                low, high = corners.min(axis=0) - NEAR_M, corners.max(axis=0) + NEAR_M
                near = (p for p in self._setup.scene.pieces if np.all(p.lower < high) and np.all(p.upper > low))
                names |= dict.fromkeys(piece.name for piece in near)
        return tuple(names)

    def _solve(self, holding: Holding, at: Float[np.ndarray, "n"]) -> StepSolver:
        """Return the solver of a step's phases from a configuration on."""
        return StepSolver(self._place(self._solver, holding, at), holding.placed, self._setup.request)

    def _place(self, solver: PhaseSolver, holding: Holding, at: Float[np.ndarray, "n"]) -> PhaseSolver:
        """Return a solver with the objects and the feet where they are, at a configuration of its robot."""
        solver = place_objects(solver, holding, at, self._near)
        if holding.stands is None:
            return solver
        body, feet = solver.body, tuple(foot.link for foot in self._solver.body.planted)
        if holding.braced:
            planted = tuple(contact.planted for contact in holding.braced)
            touches = shrink(holding.list_brace_touches())
            own = body.on_contacts(planted, touches, plan_contact_region(body.robot, planted))
            return replace(solver, body=own)
        stands = np.concatenate([holding.stands, at[len(holding.stands) :]])
        standing = WholeBody.standing(body.robot, body.scene, stands, feet, body.aims)
        own = replace(body, planted=standing.planted, polygon=standing.polygon, region=standing.region)
        return replace(solver, body=own)


def list_kept_joints(holding: Holding) -> frozenset[str]:
    """Return the joints that stay while objects are carried about: of the fingers that hold them and their arms."""
    joints = {joint for hold in holding.held.values() for joint in hold.fingers}
    arms = {tool: list_carriers(holding.robot, tool) for tool in map_tools(holding.robot).values()}
    for tool in (tool for hold in holding.held.values() for tool in hold.tools):
        others = frozenset[str]().union(*(arm for other, arm in arms.items() if other != tool))
        joints |= arms.get(tool, frozenset()) - others
    return frozenset(joints)


def _keep_joints(solver: PhaseSolver, joints: AbstractSet[str], at: Float[np.ndarray, "k"]) -> PhaseSolver:
    """Return a solver whose robot has joints that cannot move from where they are.

    Args:
        solver: its robot may have fewer coordinates than ``at``, those of a mechanism.
        joints: names.
        at: configuration.
    """
    robot = solver.body.robot
    is_held = np.array([name in joints for name in robot.joint_names])
    if not is_held.any():
        return solver
    here = at[: robot.n]
    lower, upper = (np.where(is_held, here, limits) for limits in (robot.lower, robot.upper))
    postures = {name: np.where(is_held, here, posture) for name, posture in robot.postures.items()}
    kept = replace(robot, lower=lower, upper=upper, postures=postures)
    return replace(solver, body=solver.body.with_robot(kept, here))


def _walk_on(planned: PlannedPhase, name: str, holding: Holding, robot: RobotModel) -> PlannedPhase:
    """Return a phase of a walk as one of a list of steps.

    Args:
        planned: of a robot whose parts cannot move.
        name: of the step.
        holding: who carries the objects.
        robot: whose parts can move.
    """
    body = planned.body
    if body is not None and body.robot is not robot:
        body = body.with_robot(robot, body.nominal)
    return replace(planned, phase=carry_along(rename_finish(planned.phase, name), holding), body=body)


def _plan_step(
    own: StepSolver, makers: Sequence[PhaseMaker], at: Float[np.ndarray, "n"]
) -> tuple[list[PlannedPhase], Tried | None]:
    """Return the phases of a step that were solved, the best attempt last, and the one that was not."""
    first = own.make(makers[0], at)
    if first.goal is None or len(makers) == 1:
        return own.solve_chain(makers, at)
    # A free motion that leads to a path: the pose between them is one from which the whole path can be followed.
    best: tuple[list[PlannedPhase], Tried | None] | None = None
    for pose in own.list_begins(first, makers[1], at):
        path, tried = own.solve_chain(makers[1:], pose)
        lead, missed = own.solve_free(first, at, pose)
        if tried is None and missed is None:
            return [*lead, *path], None
        if missed is None:
            lead = [*lead, *path]
        if best is None or len(lead) > len(best[0]):
            best = lead, missed or tried
    return own.solve_chain(makers[:1], at) if best is None else best


def _explain_fit(step: FitStep, item: Item, pose: Float[np.ndarray, "4 4"]) -> str | None:
    """Return why an object does not find into its hole, or wedges, from a pose in the world; None where it goes in."""
    fit = Fit.of(step, item.body, pose)
    if fit.tilted_rad > fit.tilt_rad:
        return (
            f"{step.object} is turned by {np.rad2deg(fit.tilted_rad):.1f} deg against the axis; beyond "
            f"{np.rad2deg(fit.tilt_rad):.1f} deg it wedges at a friction of {step.friction:g}"
        )
    off = float(np.linalg.norm(fit.off))
    if off > fit.lateral_m:
        return (
            f"{step.object} is {1e3 * off:.1f} mm beside the hole's axis; within {1e3 * fit.lateral_m:.1f} mm "
            "(chamfer_m and half of clearance_m) it finds into it"
        )
    return None
