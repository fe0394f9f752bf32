"""Turn the phases of a task into problems of the optimiser, with paths to start from, and solve them one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import chain, islice
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.collision import Contacts
from costs.robot import Mechanism, RobotModel
from costs.state import MotionState
from scopt import Constraint
from service.body.effort import Effort
from service.body.forces.loaded_regions import PlannedRegion, plan_regions
from service.body.ladder import GivenEnd, MotionSearch, NoEnd, Path, find_motion
from service.body.paths import straight_path
from service.body.phases import PhaseSolver
from service.body.poses import PoseProblem, Poses, Seed, find_pose, name_seeds, posture_guesses, random_guesses
from service.body.starts import Way
from service.body.task_plan import KeptCurve, PlannedPhase, Solved, Stuck
from service.demands.phase import FrameMotion, TaskPhase
from service.demands.rest.earlier_motion import EarlierMotion
from service.tasks.chain import PhaseMotion
from service.tasks.contacts.held_pose import SAME_STATE, keep_sides
from service.tasks.held_phase import HeldPhase
from service.tasks.held_tool import (
    bring_tool,
    follow_tool,
    make_hold,
    place_tool,
)
from service.tasks.hints import NOTHING, Hints, count_waypoints, give_no_hints
from service.tasks.phase_terms import TORQUE_TOLERANCE, keep_contacts_and_frames, limit_torques, shrink

MOST_VIAS = 4  # postures of a free phase, the nominal one among them
OTHER_POSE = 0.3  # least difference of a joint between two poses that are tried [rad]


@dataclass(frozen=True)
class PhaseCompiler:
    """Turns single phases into problems of one body.

    Attributes:
        solver: of the body augmented by the mechanism.
        mechanism: whose joints are the last coordinates; by default none.
        earlier: what an earlier plan did, from which phases are solved first.
        hints: how to go about each phase.
    """

    solver: PhaseSolver
    mechanism: Mechanism = NOTHING
    earlier: EarlierMotion = field(default_factory=EarlierMotion)
    hints: Hints = give_no_hints

    @property
    def robot(self) -> RobotModel:
        return self.solver.body.robot

    @property
    def columns(self) -> Int[np.ndarray, "k"]:
        """(k,) coordinates of the mechanism."""
        return np.arange(self.robot.n - len(self.mechanism.joints), self.robot.n)

    def count_waypoints(self, spec: TaskPhase) -> int:
        """Return the number of waypoints of a phase."""
        return count_waypoints(spec, self.mechanism, self.hints(spec))

    def with_hints(self, **changes: Any) -> PhaseCompiler:
        """Return the compiler with some hints of all phases changed."""
        own = self.hints
        return replace(self, hints=lambda spec: replace(own(spec), **changes))

    def list_anchor_poses(
        self, step: str, spec: TaskPhase, at: Float[np.ndarray, "n"], n_random: int
    ) -> Iterator[Solved]:
        """Yield different poses to begin an anchor with; where none is found, the one that missed least.

        Seeds are where the earlier motion begins it, if there is one, ``at``, postures, and random configurations.
        """
        poses = Poses(self.pose_problem(step, spec, fraction=0.1), OTHER_POSE)
        earlier = self.resample_earlier(spec)
        first = self.list_seeds(at) if earlier is None else [(Way.KNOWN.value, earlier[0]), *self.list_seeds(at)]
        yield from islice(poses.find(first), 1)
        guesses = random_guesses(self.solver.body, n_random, self.solver.seed)
        yield from poses.find(name_seeds("random", guesses))
        if not poses.found and poses.best is not None:
            yield poses.best

    def list_seeds(self, at: Float[np.ndarray, "n"]) -> list[Seed]:
        """Return configurations from which a pose is solved: ``at``, then the robot's postures."""
        return [("at hand", at), *posture_guesses(self.solver.body)[1:]]

    def resample_earlier(
        self, spec: TaskPhase, ends: Mapping[int, Float[np.ndarray, "n"]] = MappingProxyType({})
    ) -> Float[np.ndarray, "T n"] | None:
        """Return the earlier waypoints of a phase, as many as it has now, or None.

        Where the phase moves the mechanism they are where the mechanism is now; what they are off at the given ``ends``
        (configuration by waypoint) is taken back along the phase.
        """
        known = self.earlier.ways.get(spec.name)
        if known is None:
            return None
        count = self.count_waypoints(spec)
        values, shares = spec.values(count), np.linspace(0.0, 1.0, count)
        at, wanted = np.linspace(0.0, 1.0, len(known)), shares
        if len(spec.moving):
            column = int(spec.moving[0])
            at, wanted = known[:, self.columns[column]], values[:, column]
            if at[-1] < at[0]:
                at, wanted = -at, -wanted
        q = np.stack([np.interp(wanted, at, known[:, column]) for column in range(known.shape[1])], axis=1)
        q[:, self.columns] = values
        for name, joint_ends in spec.joints.items():
            q[:, self.robot.joint_names.index(name)] = np.linspace(*joint_ends, count)
        first, last = (ends[k] - q[k] if k in ends else np.zeros(q.shape[1]) for k in (0, count - 1))
        if len(ends) == 1:  # the other end is free, and goes along
            first, last = first + last, first + last
        return np.asarray(q + (1.0 - shares)[:, None] * first + shares[:, None] * last)

    def pose_problem(
        self, step: str, spec: TaskPhase, effort: Effort = Effort.POSE, fraction: float | None = None
    ) -> PoseProblem[Solved]:
        """Return the problem of the first pose of a phase.

        What the hand passes between would push it to the wrong side of a poor seed: a pose that may be in it is first.
        """
        fixed, hints = self._find_fixed(spec), self.hints(spec)
        loose: PoseProblem[Solved] | None = None
        if hints.passes:
            wider = replace(spec, touches=(*spec.touches, *hints.passes))
            loose = self.with_hints(passes=(), torque_share=None).pose_problem(step, wider, effort)
        # Made once it is needed: where the feet hold the loads takes as long as some steps of the optimiser.
        make = cache(lambda: self._make_pose_problem(step, spec, fixed, effort))

        def solve(seed: Float[np.ndarray, "n"]) -> Solved:
            if loose is None:
                return make().solve(self._bring_hand(spec, seed, fixed))
            guess = loose.solve(seed)
            return make().solve(self._bring_hand(spec, guess.q, fixed)) if guess.is_feasible else guess

        return PoseProblem(step, solve, self.solver.monitor, fraction, self.solver.most_seeds)

    def _make_pose_problem(
        self, step: str, spec: TaskPhase, fixed: Mapping[int, float], effort: Effort
    ) -> PoseProblem[Solved]:
        """Return the problem of the first pose of a phase from a seed with the hand at its place."""
        first = np.zeros(1, dtype=int)
        constraints = self._list_constraints(spec, first, spec.first[None])
        regions = self.find_regions(spec, spec.first[None])
        touches = shrink(spec.touches, self.hints(spec).depth_reserve_m)
        return self.solver.pose_problem(step, constraints, touches, fixed, regions, effort)

    def _find_fixed(self, spec: TaskPhase) -> dict[int, float]:
        """Return values by coordinate index of a phase's first pose."""
        names = self.robot.joint_names
        fixed = dict(zip(self.columns.tolist(), spec.first.tolist(), strict=True))
        return fixed | {names.index(name): ends[0] for name, ends in spec.joints.items()}

    def _bring_hand(
        self, spec: TaskPhase, guess: Float[np.ndarray, "n"], fixed: Mapping[int, float]
    ) -> Float[np.ndarray, "n"]:
        """Return a guess for the first pose with the hand at its place, as far as it comes near it."""
        if not spec.frames:
            return guess
        prescribed = np.zeros(self.robot.n, dtype=bool)
        prescribed[list(fixed)] = True
        placed = guess.copy()
        placed[list(fixed)] = list(fixed.values())
        return np.asarray(bring_tool(self.solver.body, spec.frames, placed[None], prescribed)[0])

    def find_regions(self, spec: TaskPhase, values: Float[np.ndarray, "T k"]) -> tuple[PlannedRegion, ...]:
        """Return where the feet hold the robot under a phase's loads; none without loads or balance."""
        body = self.solver.body
        if not spec.loads or not body.is_balanced:
            return ()
        contacts = list(body.planted)
        return plan_regions(body.engine, contacts, spec.loads, values, body.nominal)

    def solve_held(
        self,
        spec: TaskPhase,
        q: Float[np.ndarray, "n"],
        fraction: float,
        *,
        is_anchor: bool = False,
        is_backwards: bool = False,
        last: Float[np.ndarray, "n"] | None = None,
    ) -> Solved:
        """Solve a phase that leads frames from its first configuration, or backwards from its last.

        The first configuration of an anchor is free; ``last`` is where the phase ends, where that is known as well.
        """
        count = self.count_waypoints(spec)
        values = spec.values(count)
        fixed = {} if is_anchor else {count - 1 if is_backwards else 0: q}
        fixed |= {} if last is None else {count - 1: last}
        earlier = self.resample_earlier(spec, fixed or {0: q})
        held = HeldPhase(self, spec, fixed, values)
        led = self._lead_hand(held, q, last, is_anchor=is_anchor, is_backwards=is_backwards)
        paths: dict[Way, Callable[[], Iterable[tuple[str, Path]]]] = {Way.LED: lambda: islice(led, 1)}
        if earlier is not None:
            paths[Way.KNOWN] = lambda: ((Way.KNOWN.value, earlier),)

        def solve(solver: PhaseSolver, path: Path) -> Solved:
            return held.solve(solver, chain([path], (other for _, other in led)))

        return find_motion(
            MotionSearch(spec.name, self.solver, solve, q, NoEnd(), paths=paths, fraction=fraction, repair=held.repair)
        )

    def _lead_hand(
        self,
        held: HeldPhase,
        q: Float[np.ndarray, "n"],
        last: Float[np.ndarray, "n"] | None,
        *,
        is_anchor: bool,
        is_backwards: bool,
    ) -> Iterator[tuple[str, Path]]:
        """Yield paths of a phase with a held hand.

        The straight line to its end comes first, or to a pose there where the phase aims at one, then the path on
        which the hand is at its place, then the first configuration with what is prescribed.
        """
        spec, count, values = held.spec, len(held.values), held.values
        hints = self.hints(spec)
        if last is not None:
            straight = straight_path(q, last, count)
            straight[:, self.columns] = values
            yield "straight line", straight
        elif hints.aims_at_end and not is_backwards:
            end_spec = replace(spec, first=spec.last)
            guess = np.concatenate([q[: self.columns[0]], spec.last])
            end = find_pose(self.pose_problem(spec.name, end_spec, Effort.QUICK_POSE), [("at hand", guess)])
            if end.is_feasible:
                straight = straight_path(q, end.q, count)
                straight[:, self.columns] = values
                yield "straight line to a pose at its end", straight
        start = np.tile(q, (count, 1))
        start[:, self.columns] = values
        for name, rate in hints.rates.items():
            (moving,) = spec.moving
            start[:, self.robot.joint_names.index(name)] += rate * (values[:, moving] - values[0, moving])
        for name, ends in spec.joints.items():
            column = self.robot.joint_names.index(name)
            start[:, column] = np.linspace(ends[0] if is_anchor or is_backwards else q[column], ends[1], count)
        if spec.frames:
            prescribed = self.find_prescribed(spec)
            followed = follow_tool(self.solver.body, spec.frames, start, prescribed, is_backwards=is_backwards)
            if followed is not None:
                yield "led by the hand" if spec.contacts is None else "along its line", followed
        yield "standing still", start

    def find_prescribed(self, spec: TaskPhase) -> Bool[np.ndarray, "n"]:
        """Return the mask of coordinates whose way a phase prescribes: the mechanism's and its own joints."""
        prescribed = np.zeros(self.robot.n, dtype=bool)
        prescribed[self.columns] = True
        prescribed[[self.robot.joint_names.index(name) for name in spec.joints]] = True
        return prescribed

    def _list_constraints(
        self, spec: TaskPhase, waypoints: Int[np.ndarray, "S"], values: Float[np.ndarray, "T k"]
    ) -> tuple[Constraint[MotionState], ...]:
        """Return the constraints of a phase at waypoints, given the mechanism's joints at all of them."""
        kept = keep_contacts_and_frames(self.solver.body, spec, waypoints, len(values))
        return (*kept, *self._limit_torques(spec, waypoints, values))

    def _limit_torques(
        self, spec: TaskPhase, waypoints: Int[np.ndarray, "S"], values: Float[np.ndarray, "T k"]
    ) -> tuple[Constraint[MotionState], ...]:
        share = self.hints(spec).torque_share
        return tuple(limit_torques(self.solver.body, spec.loads, share, waypoints, values))

    def is_strong_enough(self, spec: TaskPhase, q: Float[np.ndarray, "T n"]) -> bool:
        """Return whether a phase's loads cost no more torque at its waypoints than it may use."""
        state = MotionState(self.solver.body.engine(q), Contacts.none())
        limits = self._limit_torques(spec, np.arange(len(q)), q[:, self.columns])
        return all(limit.residual.value(state).max() <= TORQUE_TOLERANCE for limit in limits)

    def begin(self, spec: TaskPhase, near: Float[np.ndarray, "n"]) -> PhaseMotion:
        """Solve a phase that leads frames from a pose near a configuration."""
        return self._attempt(spec, self.solve_held(spec, near, 0.3, is_anchor=True))

    def lead(
        self, spec: TaskPhase, first: Float[np.ndarray, "n"] | None, last: Float[np.ndarray, "n"] | None
    ) -> PhaseMotion:
        """Solve a phase that leads frames from its first configuration, backwards from its last, or between both."""
        if first is not None:
            return self._attempt(spec, self.solve_held(spec, first, 0.6, last=last))
        assert last is not None
        return self._attempt(spec, self.solve_held(spec, last, 0.3, is_backwards=True))

    def join(self, spec: TaskPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]) -> PhaseMotion:
        """Solve a phase that leads nothing between two configurations."""
        return self._attempt(spec, self.solve_free(spec, first, last, 0.55))

    def _attempt(self, spec: TaskPhase, solved: Solved) -> PhaseMotion:
        return PhaseMotion(solved.x, lambda: self.finish(spec, solved), Stuck.at(spec.name, solved))

    def solve_free(
        self, spec: TaskPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"], fraction: float
    ) -> Solved:
        """Solve a phase without demands on the hand between two configurations."""
        return find_motion(replace(self.search_free(spec, first, last), is_sampled=False, fraction=fraction))

    def search_free(self, spec: TaskPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]) -> MotionSearch:
        """Return the search for the motion of a phase between two configurations."""
        count = self.count_waypoints(spec)
        earlier = self.resample_earlier(spec, {0: first, count - 1: last})
        known = () if earlier is None else ((Way.KNOWN.value, earlier),)
        postures = posture_guesses(self.solver.body)[1:MOST_VIAS]
        return MotionSearch(
            spec.name,
            self.solver,
            lambda solver, path: replace(self, solver=solver).solve_between(spec, path),
            first,
            GivenEnd(last),
            paths={Way.KNOWN: lambda: known},
            n_waypoints=count,
            vias=lambda: [(name, self._keep_mechanism(q, first)) for name, q in postures],
        )

    def _keep_mechanism(self, q: Float[np.ndarray, "n"], at: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return a configuration with the mechanism as in another."""
        out = q.copy()
        out[self.columns] = at[self.columns]
        return out

    def solve_between(self, spec: TaskPhase, path: Path) -> Solved:
        """Solve a phase between the ends of a path, which may be denser than usual."""
        values, last = path[:, self.columns], len(path) - 1
        fixed = {0: path[0], last: path[last]}
        return self.solve(spec, [path], fixed, values, self.find_regions(spec, values))

    def solve(
        self,
        spec: TaskPhase,
        paths: Iterable[Path],
        fixed: Mapping[int, Float[np.ndarray, "n"]],
        values: Float[np.ndarray, "T k"],
        regions: tuple[PlannedRegion, ...],
    ) -> Solved:
        """Solve a phase with the mechanism's joints prescribed."""
        count = len(values)
        free = np.setdiff1d(np.arange(count), list(fixed))
        paths = iter(paths)
        first = next(paths)

        def narrow(lower: np.ndarray, upper: np.ndarray) -> None:
            lower[:, self.columns] = upper[:, self.columns] = values
            for name in spec.joints:
                column = self.robot.joint_names.index(name)
                lower[:, column] = upper[:, column] = first[:, column]

        def solve_from(path: Path) -> Solved:
            return self.solver.solve_trajectory(
                spec.name,
                path,
                fixed,
                constraints=self._list_constraints(spec, free, values),
                allowances=shrink(spec.touches, self.hints(spec).depth_reserve_m),
                bounds=narrow,
                balanced=[count - 1] if self.hints(spec).settles else None,
                regions=regions,
            )

        # A path without a cost is the last resort: a solution from another path is the better motion.
        problem = PoseProblem(spec.name, solve_from, most=self.solver.most_seeds)
        solved = find_pose(problem, (("path", path) for path in chain([first], paths)))
        if solved.is_feasible or solved.shortfall >= self.hints(spec).restorable:
            return solved
        return self.solver.restore_feasibility(spec.name, solved)

    def finish(self, spec: TaskPhase, solved: Solved) -> PlannedPhase:
        """Return the solved phase with its promises."""
        return replace(self.keep(spec, solved.x), is_feasible=solved.is_feasible)

    def take(self, spec: TaskPhase, ends: Mapping[int, Float[np.ndarray, "n"]]) -> PlannedPhase | None:
        """Return a phase as the earlier motion has it; None where that does not lead through its ends any more.

        Args:
            spec: the phase.
            ends: configuration by index of the first or the last waypoint.
        """
        known = KeptCurve.of(self.earlier, spec.name)
        if known is None:
            return None
        q = known.curve.positions.copy()
        for k, end in ends.items():
            if np.abs(q[k] - end).max() > SAME_STATE:
                return None
            q[k] = end
        sides = keep_sides(self.solver.body, spec.contacts or (), np.arange(1, len(q) - 1))
        if not self.solver.is_feasible(q, sides):
            return None
        return replace(self.keep(spec, q), kept=replace(known, curve=replace(known.curve, positions=q)))

    def keep(self, spec: TaskPhase, q: Float[np.ndarray, "T n"]) -> PlannedPhase:
        """Return waypoints with the promises of a phase, which can be solved again between the same ends."""
        phase = self.promise(spec, q, spec.values(self.count_waypoints(spec)))
        return replace(phase, resolve=lambda again: self.solve_between(self._keep_shares(spec, again), again))

    def _keep_shares(self, spec: TaskPhase, q: Float[np.ndarray, "T n"]) -> TaskPhase:
        """Return a phase whose tool is as far along its line at each waypoint as it is in a path."""
        return replace(spec, frames=tuple(self._share_line(frame, q) for frame in spec.frames))

    def _share_line(self, frame: FrameMotion, q: Float[np.ndarray, "T n"]) -> FrameMotion:
        if frame.offset is None:
            return frame
        line = replace(frame, slide=None, rotation=None, point=np.zeros(3))
        off = place_tool(self.robot, line, np.arange(len(q)), frame.place[None])
        places = off.value(MotionState(self.solver.body.engine(q), Contacts.none())).reshape(len(q), 3)
        return replace(frame, shares=places @ frame.offset / (frame.offset @ frame.offset))

    def promise(self, spec: TaskPhase, q: Float[np.ndarray, "T n"], values: Float[np.ndarray, "S k"]) -> PlannedPhase:
        """Return waypoints with the promises of a phase; its regions are found for the mechanism at ``values``."""
        return PlannedPhase(
            spec,
            q,
            is_feasible=True,
            holds=tuple(make_hold(self.robot, frame) for frame in spec.frames if not frame.is_line),
            regions=self.find_regions(spec, values),
            values=values if spec.loads else None,
            body=None if spec.contacts is None else self.solver.body,
        )
