"""Open a door: hand to the handle, release the latch, open as far as the stance allows, then push the leaf."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from costs.static_region import StaticRegionError
from service.body.effort import Effort
from service.body.phases import PhaseSolver
from service.body.poses import Seed
from service.body.task_plan import PlannedPhase, Solved, Stuck, TaskPlan
from service.demands.door.demand import measure_peg
from service.demands.door.door import Door
from service.demands.door.phases import GRIP_FROM_END, LEAST_GRIP, DoorChoice, Push, make_door_phases
from service.demands.figures.travel import measure_door
from service.demands.hands import Hand
from service.demands.holds.leaving import LET_GO
from service.demands.phase import TaskPhase
from service.tasks.door.hints import LEAF
from service.tasks.door.places import find_narrow_gap, list_push_places
from service.tasks.hints import Hints
from service.tasks.sequence import PhaseSequence

ANGLE_STEP = np.deg2rad(10.0)  # between the angles that are tried
LEAST_FIRST = np.deg2rad(10.0)  # opening at the handle that is worth a regrasp
AT_HANDLE_ALONE = np.deg2rad(35.0)  # openings up to it are tried at the handle alone first
EARLY_FIRST = np.deg2rad(20.0)  # opening at the handle of a door that is then pushed, tried before larger ones
MOST_EARLIER = 2  # plans that leave the handle earlier, where a plan could not be certified
FEW_ANGLES = 2  # are tried from the largest on
MOST_TRIES = 3  # of smaller angles at the handle
HOW_FAR = "how far it opens"
SMALLER_MAY_HELP = (
    "open",
    "pose at the handle",
    "let the handle go",
    LET_GO,
    "retract",
)  # steps that depend on the angle
AMPLE_ROOM = 0.4  # between the free edge and the frame, for a hand that reaches behind the leaf [m]
PULL_PLACES = (0.0, 0.08, -0.08)  # of the hand along a pull handle, from its middle [m]
BAR_SHARES = (0.3, 0.1, 0.4)  # of the hand along a push bar, from its middle towards the free edge


def list_choices(
    door: Door, hand: Hand, peg_m: float, target: float, stays: bool = False, most_grips: int | None = None
) -> Iterator[DoorChoice]:
    """Yield ways to hold a door's handle with a hand, the most promising first; the leaf alone where it is ajar.

    Args:
        door: leaf and handle.
        hand: the hand.
        peg_m: length of its free peg [m].
        target: opening angle that the hand is to reach at the handle [rad].
        stays: whether the hand stays on the leaf at the end.
        most_grips: places along the handle; all that are worth a try by default.
    """
    handle = door.handle
    if door.is_push and not door.is_latched:
        yield DoorChoice(hand, peg_m, 0.0, 1.0, door.geometry.ajar, stays=stays)
        return
    if handle is None or handle.kind == "knob":
        return
    senses: tuple[float, ...] = (1.0,)
    if handle.kind == "lever":
        grips: tuple[float, ...] = (max(handle.length - GRIP_FROM_END, LEAST_GRIP),)
    elif handle.kind == "push_bar":
        towards_edge = float(np.sign(handle.direction @ door.geometry.along))
        grips = tuple(share * handle.length * towards_edge for share in BAR_SHARES)
    else:
        grips, senses = PULL_PLACES, (1.0, -1.0)
    for grip in grips[:most_grips]:
        for sense in senses:
            yield DoorChoice(hand, peg_m, grip, sense, target, stays=stays)


AtHandle = tuple[tuple[PlannedPhase, ...], Stuck | None, float]
"""Phases at the handle, the step that has no solution, and the opening angle that they reach [rad]."""

PlaceKey = tuple[str, float, float, float | None]
"""Side of the hand, place on the leaf [m], and slant of a rod behind its edge [rad]."""


@dataclass(frozen=True)
class PushesTried:
    """Places on the leaf that were tried already: they are the same, however the hand held the handle before.

    Attributes:
        farthest: index of the largest angle that a pose was found for, or None, by place and angles.
        failed: number of a place, angle at which the push begins, and at which it ends, where it has no solution.
    """

    farthest: dict[tuple[PlaceKey, tuple[float, ...]], int | None] = field(default_factory=dict)
    failed: set[tuple[PlaceKey, float, float]] = field(default_factory=set)


@dataclass(frozen=True)
class DoorOpening:
    """A door to open from one stance.

    Attributes:
        solver: of the body augmented by the door.
        door: leaf, handle and loads.
        hands: hands to try, in order.
        target: opening angle at the end [rad].
        stays: whether the hand stays on the leaf.
        hints: how to go about the phases.
        most_at_handle: largest opening angle at which the hand is still at the handle [rad].
        is_patient: whether the hand stays at the handle as long as it can, also where the leaf is pushed afterwards.
    """

    solver: PhaseSolver
    door: Door
    hands: tuple[Hand, ...]
    target: float
    stays: bool
    hints: Hints
    most_at_handle: float = np.inf
    is_patient: bool = False

    def plans(self) -> Iterator[TaskPlan]:
        """Yield the plan that opens the leaf farthest, then plans that leave the handle later, and earlier."""
        plan = self.plan()
        yield plan
        is_early = self.door.is_push and self.target > self.door.geometry.ajar + AT_HANDLE_ALONE
        if plan.is_feasible and is_early and self.door.is_latched and not self.is_patient:
            plan = replace(self, is_patient=True).plan()
            yield plan
        for _ in range(MOST_EARLIER):
            opened = [phase.q[-1, -len(self.door.mechanism.joints)] for phase in plan.phases if phase.name == "open"]
            if not plan.is_feasible or not opened or opened[0] - ANGLE_STEP < self.door.geometry.ajar + LEAST_FIRST:
                return
            plan = replace(self, is_patient=True, most_at_handle=float(opened[0] - ANGLE_STEP)).plan()
            yield plan

    def plan(self) -> TaskPlan:
        """Return the plan that opens the leaf farthest.

        Raises:
            StaticRegionError: wherever a hand could be, the ground does not hold the robot under the loads.
        """
        best: TaskPlan | None = None
        best_angle = -1.0
        unheld: StaticRegionError | None = None
        tried = PushesTried()
        for choice, at_handle in self._list_choices():
            try:
                plan, angle = self._plan_choice(choice, at_handle, tried)
            except StaticRegionError as error:  # held elsewhere the loads may be smaller
                unheld = error
                continue
            if best is None or angle > best_angle or (angle == best_angle and len(plan.phases) > len(best.phases)):
                best, best_angle = plan, angle
            if plan.is_feasible:
                return plan
        if best is None:
            raise unheld or ValueError("a door needs a hand")
        return best

    def _list_choices(self) -> Iterator[tuple[DoorChoice, AtHandle | None]]:
        """Yield the holds of the handle, with what they reach there where that is known.

        A pulled leaf that is hardly open when the hand lets go is pushed only after all other holds were tried at the
        handle alone, and from the largest opening first; so is one that opens little in all.
        """
        geometry = self.door.geometry
        choices = [
            choice
            for hand in self.hands
            for choice in list_choices(
                self.door, hand, measure_peg(self.solver.body.robot, hand), self.target, self.stays
            )
        ]
        if self.door.is_push:
            yield from ((choice, None) for choice in choices)
            return
        at_edge = self._list_edge_choices()
        has_bar = self.door.handle is not None and self.door.handle.kind == "pull"
        if not has_bar:  # a bar is held more easily than the edge
            yield from at_edge
        opens_little = self.target <= geometry.ajar + AT_HANDLE_ALONE
        later: list[tuple[DoorChoice, AtHandle]] = []
        unheld = list[DoorChoice]()
        for choice in choices:
            try:
                opened = self._open_at_handle(choice)
            except StaticRegionError:
                unheld.append(choice)
                continue
            reached = opened[2]
            has_room = geometry.width * np.sin(reached) >= AMPLE_ROOM and not opens_little
            if reached >= self.target - 1e-6 or has_room:
                yield choice, opened
            else:
                later.append((choice, opened))
        yield from sorted(later, key=lambda pair: -pair[1][2])
        yield from ((choice, None) for choice in unheld)
        if has_bar:
            yield from at_edge

    def _list_edge_choices(self) -> list[tuple[DoorChoice, AtHandle | None]]:
        """Return the choice to pull an ajar leaf by its free edge, whatever the hand, where a hand fits behind it."""
        robot, ajar = self.solver.body.robot, self.door.geometry.ajar
        if self.door.is_latched or find_narrow_gap(self.door, self.hands, robot, ajar) is not None:
            return []
        return [(DoorChoice(self.hands[0], measure_peg(robot, self.hands[0]), 0.0, 1.0, ajar, stays=self.stays), None)]

    def _plan_choice(
        self, choice: DoorChoice, at_handle: AtHandle | None, tried: PushesTried
    ) -> tuple[TaskPlan, float]:
        """Plan with one hold of the handle, and a regrasp if that does not open the leaf far enough.

        Args:
            choice: the hold.
            at_handle: phases up to the largest angle at the handle, if they are known.
            tried: pushes of the leaf that were tried with other holds.
        """
        body, start = self.solver.body, self.door.geometry.ajar
        phases: tuple[PlannedPhase, ...] = ()
        stuck: Stuck | None = None
        reached = start
        if self.door.is_push and choice.first > start + AT_HANDLE_ALONE and not self.is_patient:
            early = replace(self, is_patient=True, most_at_handle=start + EARLY_FIRST)
            with suppress(StaticRegionError):  # a larger opening may be held elsewhere
                plan, reached = early._plan_choice(choice, None, tried)
                if plan.is_feasible:
                    return plan, reached
        if choice.first > start:
            phases, stuck, reached = self._open_at_handle(choice) if at_handle is None else at_handle
            choice = replace(choice, first=reached)
            if stuck is not None:
                return TaskPlan(body, phases, stuck=stuck, measure=partial(measure_door, self.door)), start
        if reached < self.target - 1e-6:
            at = phases[-1].q[-1] if phases else body.nominal
            pushed = self._push(choice, at, tried)
            if pushed is not None:
                choice, more, reached = pushed
                phases += more
        notes = (f"{choice.hand.side} hand, {self._describe(choice)}",)
        obstacle: tuple[str, ...] = ()
        if reached < self.target - 1e-6:
            obstacle = (
                f"from this stance the leaf opens to {np.rad2deg(reached):.0f} deg of the "
                f"{np.rad2deg(self.target):.0f} asked for",
            )
        return TaskPlan(body, phases, obstacle, measure=partial(measure_door, self.door), notes=notes), reached

    def _open_at_handle(self, choice: DoorChoice) -> AtHandle:
        """Open as far as the hand can stay at the handle; the angle is tried in steps of ten degrees."""
        start = self.door.geometry.ajar
        angles = [angle for angle in self._angles(start) if angle <= self.most_at_handle + 1e-6]
        farthest = self._find_farthest(angles, lambda angle: replace(choice, first=angle))
        if farthest is None:
            farthest = len(angles) - 1
        result: tuple[tuple[PlannedPhase, ...], Stuck | None] = ((), None)
        for tried, angle in enumerate(angles[farthest:], start=1):
            stays = choice.stays and angle >= self.target - 1e-6  # else the leaf is pushed from elsewhere afterwards
            sequence = self._sequence(make_door_phases(self.door, replace(choice, first=angle, push=None, stays=stays)))
            result = sequence.plan(self.solver.body.nominal)
            if result[1] is None:
                return *result, angle
            if tried >= MOST_TRIES or result[1].step not in SMALLER_MAY_HELP:
                break
        return *result, start

    def _push(
        self, choice: DoorChoice, at: Float[np.ndarray, "n"], tried: PushesTried
    ) -> tuple[DoorChoice, tuple[PlannedPhase, ...], float] | None:
        """Push the leaf from where it is with the peg, as far as this stance allows; None if nowhere."""
        best: tuple[DoorChoice, tuple[PlannedPhase, ...], float] | None = None
        angles = self._angles(choice.first)
        places = list_push_places(self.door, self.hands, self.solver.body.robot, choice.first)
        held: dict[int, float] = {}  # largest angle that a pose was found for, by place
        for candidates in (angles[:1], angles[1:]):
            for index, place in enumerate(places):
                if index in held or not candidates:
                    continue
                if best is not None and candidates[0] <= best[2]:
                    return best

                def at_angle(angle: float, place: Push = place) -> DoorChoice:
                    return replace(choice, push=replace(place, last=angle))

                key = place.hand.side, place.along, place.up, place.slant
                asked = key, tuple(candidates)
                if asked not in tried.farthest:
                    tried.farthest[asked] = self._find_farthest(candidates, at_angle)
                farthest = tried.farthest[asked]
                if farthest is None:
                    continue
                held[index] = candidates[farthest]
                if (key, choice.first, held[index]) in tried.failed:
                    continue
                pushed = self._plan_push(at_angle(held[index]), at)
                if pushed is None:
                    tried.failed.add((key, choice.first, held[index]))
                if pushed is not None and (best is None or held[index] > best[2]):
                    best = at_angle(held[index]), pushed, held[index]
                    if held[index] >= self.target:
                        return best
        return best

    def _plan_push(self, choice: DoorChoice, at: Float[np.ndarray, "n"]) -> tuple[PlannedPhase, ...] | None:
        """Plan the phases after the regrasp; None if they have no solution."""
        at_handle = replace(choice, push=None, stays=False)
        n_before = len(make_door_phases(self.door, at_handle))
        phases, stuck = self._sequence(make_door_phases(self.door, choice)[n_before:]).plan(at)
        return None if stuck is not None else phases

    def _angles(self, start: float) -> list[float]:
        """Return the opening angles to try, the target first [rad]."""
        below = np.arange(self.target - ANGLE_STEP, start + 0.5 * LEAST_FIRST, -ANGLE_STEP)
        return [self.target, *below.tolist()]

    def _find_farthest(self, angles: Sequence[float], choose: Callable[[float], DoorChoice]) -> int | None:
        """Return the index of the largest angle whose last pose can be held; None if none can.

        Poses at smaller angles are taken to be easier.
        """
        if len(angles) <= FEW_ANGLES:
            return next(
                (k for k, angle in enumerate(angles) if self._solve_last_pose(choose(angle), ()).is_feasible), None
            )
        low, high = 0, len(angles)
        guess: tuple[Seed, ...] = ()
        middle = high - 1
        while low < high:
            solved = self._solve_last_pose(choose(angles[middle]), guess)
            if solved.is_feasible:
                guess = (("at a larger angle", solved.q),)
                high = middle
            else:
                low = middle + 1
            middle = (low + high) // 2
        return low if low < len(angles) else None

    def _solve_last_pose(self, choice: DoorChoice, guesses: tuple[Seed, ...]) -> Solved:
        """Solve for the pose at the end of the choice's last opening."""
        spec = next(spec for spec in reversed(make_door_phases(self.door, choice)) if LEAF in spec.moving)
        sequence = self._sequence((spec,))
        with self.solver.monitor.step(HOW_FAR, 0.05):
            (spec,) = sequence.specs
            return sequence.try_pose(HOW_FAR, replace(spec, first=spec.last), guesses, effort=Effort.ANY_POSE)

    def _sequence(self, specs: Sequence[TaskPhase]) -> PhaseSequence:
        return PhaseSequence.of(self.solver, self.door.mechanism, specs, wants_reserve=True, hints=self.hints)

    def _describe(self, choice: DoorChoice) -> str:
        parts = []
        if choice.first > self.door.geometry.ajar and self.door.handle is not None:
            kind = self.door.handle.kind.replace("_", " ")
            parts.append(f"at the {kind} to {np.rad2deg(choice.first):.0f} deg")
        if choice.push is not None:
            push = choice.push
            where = "behind its free edge" if push.slant is not None else f"{push.along:.2f} m from the hinge"
            parts.append(f"on the leaf {where} to {np.rad2deg(push.last):.0f} deg")
        return ", then ".join(parts) or "no hold found"
