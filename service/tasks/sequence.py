"""Solve the phases of a task with a mechanism, outwards from the phase that does the work.

Phases come in groups: a free phase that carries the hand to the next contact, then phases in which the hand moves with
the mechanism or on lines. Of these the anchor is solved first, from a pose at its beginning; the ones before it are
solved backwards from there, the free phase joins the end of the group before to their beginning, and the ones after the
anchor follow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import Mechanism, with_mechanism
from service.body.effort import Effort
from service.body.phases import PhaseSolver
from service.body.poses import Seed, find_pose, name_seeds, random_guesses
from service.body.task_plan import PlannedPhase, Solved, Stuck
from service.demands.holds.pushes import add_pushes
from service.demands.phase import TaskPhase, check_moves
from service.demands.rest.earlier_motion import EarlierMotion
from service.tasks.chain import solve_phases
from service.tasks.hints import Hints, find_anchor, give_no_hints
from service.tasks.phase_compiler import PhaseCompiler

QUICK_SEEDS = 2  # of a pose that is tried with little effort, besides random ones


def add_mechanism(solver: PhaseSolver, mechanism: Mechanism) -> PhaseSolver:
    """Return the solver of the robot augmented by a mechanism, whose joints are at their start."""
    body = solver.body
    robot = with_mechanism(body.robot, mechanism.joints)
    augmented = body.with_robot(robot, np.concatenate([body.nominal, mechanism.start]))
    return replace(solver, body=replace(augmented, releases=mechanism.releases))


@dataclass(frozen=True)
class PhaseSequence:
    """Phases of a task for one body, in the order in which they are executed.

    Attributes:
        solver: of the body augmented by the mechanism.
        mechanism: whose joints are the last coordinates.
        specs: the phases.
        is_held: whether they begin with the hand at its place: the first phases are then solved forwards.
        wants_reserve: whether to try first with a margin of balance for the servos.
        n_random: random configurations from which an anchor's first pose is searched after the robot's postures.
        earlier: what an earlier plan did, from which phases are solved first.
        hints: how to go about each phase.
    """

    solver: PhaseSolver
    mechanism: Mechanism
    specs: tuple[TaskPhase, ...]
    is_held: bool = False
    wants_reserve: bool = False
    n_random: int = 0
    earlier: EarlierMotion = field(default_factory=EarlierMotion)
    hints: Hints = give_no_hints

    def __post_init__(self) -> None:
        check_moves(self.specs)

    @staticmethod
    def of(solver: PhaseSolver, mechanism: Mechanism, specs: Sequence[TaskPhase], **options: Any) -> PhaseSequence:
        """Return the sequence of phases with the contacts by which hands push the mechanism."""
        pushing = add_pushes(specs, solver.body.robot, mechanism, solver.hand_friction)
        return PhaseSequence(solver, mechanism, pushing, **options)

    @property
    def _compiler(self) -> PhaseCompiler:
        return PhaseCompiler(self.solver, self.mechanism, self.earlier, self.hints)

    def plan(self, at: Float[np.ndarray, "n"]) -> tuple[tuple[PlannedPhase, ...], Stuck | None]:
        """Plan all phases from configuration ``at``; return those that were solved, and the step that was not.

        Where the phases fail with a margin of balance for the servos, they are planned without it.
        """
        if not self.wants_reserve:
            return self._plan_all(at)
        careful = replace(self, solver=replace(self.solver, body=replace(self.solver.body, wants_reserve=True)))
        phases, stuck = careful._plan_all(at)
        return (phases, stuck) if stuck is None else self._plan_all(at)

    def _plan_all(self, at: Float[np.ndarray, "n"]) -> tuple[tuple[PlannedPhase, ...], Stuck | None]:
        phases: tuple[PlannedPhase, ...] = ()
        specs, stuck = self.specs, None
        if self.is_held:
            n_held = next((k for k, spec in enumerate(specs) if k > 0 and spec.hand is None), len(specs))
            phases, stuck = self._plan_forwards(specs[:n_held], at)
            if stuck is not None:
                return phases, replace(stuck, order=tuple(spec.name for spec in specs))
            specs, at = specs[n_held:], phases[-1].q[-1]
        for group in split_groups(specs) if specs else ():
            planned, stuck = self._plan_group(group, at)
            phases += planned
            if stuck is not None:
                return phases, replace(stuck, order=tuple(spec.name for spec in self.specs))
            at = phases[-1].q[-1]
        return phases, None

    def take(self, paths: Sequence[Float[np.ndarray, "T n"]]) -> tuple[PlannedPhase, ...]:
        """Return given waypoints of each phase as they are, with the phases' promises."""
        compiler = self._compiler
        specs = zip(self.specs, paths, strict=True)
        return tuple(compiler.promise(spec, q, q[:, compiler.columns]) for spec, q in specs)

    def try_pose(
        self,
        step: str,
        spec: TaskPhase,
        guesses: Sequence[Seed] = (),
        n_random: int = 0,
        effort: Effort = Effort.QUICK_POSE,
    ) -> Solved:
        """Try with little effort whether a phase's first pose exists, whatever comes before it.

        Args:
            step: name of the pose.
            spec: the phase.
            guesses: seeds before the robot's postures.
            n_random: random configurations after them.
            effort: of the optimiser.
        """
        compiler, body = self._compiler, self.solver.body
        light = compiler.with_hints(torque_share=None).pose_problem(step, spec, effort)
        strong = compiler.pose_problem(step, spec, effort)

        def solve(seed: Float[np.ndarray, "n"]) -> Solved:
            solved = light.solve(seed)
            if not solved.is_feasible or compiler.is_strong_enough(spec, solved.x):
                return solved
            return strong.solve(solved.q)

        seeds = [*guesses, *compiler.list_seeds(body.nominal)][:QUICK_SEEDS]
        seeds += name_seeds("random", random_guesses(body, n_random, self.solver.seed))
        return find_pose(replace(light, solve=solve, most=None), seeds)

    def _plan_forwards(
        self, specs: Sequence[TaskPhase], at: Float[np.ndarray, "n"]
    ) -> tuple[tuple[PlannedPhase, ...], Stuck | None]:
        """Plan phases in the order of execution; a free one before them brings the hand to its place."""
        compiler = self._compiler
        poses: dict[int, Float[np.ndarray, "n"]] = {}
        if not specs[0].frames:
            step = f"pose for '{specs[1].name}'"
            pose = find_pose(compiler.pose_problem(step, specs[1], fraction=0.1), [("at hand", at)])
            if not pose.is_feasible:
                return _stop_at(specs[0], step, pose, np.stack([at, pose.q]))
            poses[1] = pose.q
        chain = solve_phases(specs, at, poses, compiler)
        return chain.planned, chain.stuck

    def _plan_group(
        self, group: Sequence[TaskPhase], at: Float[np.ndarray, "n"]
    ) -> tuple[tuple[PlannedPhase, ...], Stuck | None]:
        """Plan a free phase and the held ones after it, outwards from a pose of the one that does the work."""
        compiler = self._compiler
        n_free = sum(not spec.frames for spec in group)
        anchor = n_free + find_anchor(group[n_free:], self.mechanism)
        step = self.hints(group[anchor]).pose_name or f"pose for '{group[anchor].name}'"
        stopped: tuple[tuple[PlannedPhase, ...], Stuck | None] | None = None
        for pose in compiler.list_anchor_poses(step, group[anchor], at, self.n_random):
            if not pose.is_feasible:
                return _stop_at(group[0], step, pose, np.stack([at, pose.q]))
            chain = solve_phases(group, at, {}, compiler, {anchor: compiler.begin(group[anchor], pose.q)})
            failed = chain.failed
            if failed is None or not n_free <= failed <= anchor:  # the others are stuck from any pose
                return chain.planned, chain.stuck
            made = np.concatenate([at[None], chain.q])
            stopped = stopped or ((PlannedPhase(group[failed], made, False),), chain.stuck)
        assert stopped is not None
        return stopped


def split_groups(specs: Sequence[TaskPhase]) -> Iterator[tuple[TaskPhase, ...]]:
    """Yield the groups of phases of one hold, each with its free phase first.

    Raises:
        ValueError: nothing is held in a group.
    """
    begins = [index for index, spec in enumerate(specs) if spec.hand is None]
    begins = begins if begins[:1] == [0] else [0, *begins]
    for first, last in zip(begins, [*begins[1:], len(specs)], strict=True):
        group = tuple(specs[first:last])
        if all(spec.hand is None for spec in group):
            names = ", ".join(spec.name for spec in group)
            raise ValueError(f"expected a phase that leads a hand among {names}")
        yield group


def _stop_at(
    phase: TaskPhase, step: str, result: Solved, q: Float[np.ndarray, "T n"]
) -> tuple[tuple[PlannedPhase, ...], Stuck]:
    """Return the best attempt as a single phase, and the step it is stuck at."""
    return (PlannedPhase(phase, q, False),), Stuck(step, result)
