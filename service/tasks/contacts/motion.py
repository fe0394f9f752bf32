"""Motions from stance to stance; places are moved within their slack where a pose on the way is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from service.body.phases import PhaseSolver
from service.body.task_plan import PlannedPhase, TaskPlan
from service.demands.contacts.moved_places import list_movable, move_place
from service.demands.contacts.phases import list_contact_phases
from service.demands.contacts.stances import ContactStance
from service.demands.phase import TaskPhase
from service.tasks.contacts.known_poses import KnownPoses
from service.tasks.contacts.pose_finder import MissingPose, PoseFinder, StuckError
from service.tasks.contacts.walker import N_TRIES, PLAIN_TRIES, Walker

MOST_MOVES = 4  # of places, until a missing pose counts as impossible
LEAST_MOVE_M = 1e-3  # by which a place is moved


def plan_contact_motion(
    solver: PhaseSolver,
    stances: Sequence[ContactStance],
    finish: Float[np.ndarray, "n"] | None = None,
    guesses: KnownPoses | None = None,
    n_tries: int = N_TRIES,
) -> TaskPlan:
    """Plan the motion from the solver's nominal configuration, in the first stance, through all others.

    Args:
        solver: of the robot at its start.
        stances: with every place fixed.
        finish: posture to end in, on the last stance.
        guesses: poses and ways that are known already.
        n_tries: of each change of contacts, from other guesses.
    """
    if guesses is not None:
        solver = replace(solver, body=replace(solver.body, is_comfortable=False))
    finder = PoseFinder(solver, guesses or KnownPoses(), np.zeros(solver.body.robot.n))
    walker = Walker(finder, n_tries)
    course = _Course(walker, tuple(stances), finish is not None)
    first = finder.stand_on(stances[0].contacts) if stances else None
    try:
        course.go_through()
        if finish is not None:
            course.add(walker.end_in(course.specs[-1], course.at, finish))
    except StuckError as error:
        order = tuple(spec.name for spec in course.specs)
        stuck = None if error.stuck is None else replace(error.stuck, order=order)
        body = course.phases[-1].body if course.phases else first
        attempt = PlannedPhase(TaskPhase(error.step), np.stack([course.at, error.q]), False, body=body)
        obstacle = () if stuck is not None else error.reasons
        return TaskPlan(solver.body, (*course.phases, attempt), obstacle, stuck, notes=tuple(course.notes))
    return TaskPlan(solver.body, tuple(course.phases), notes=tuple(course.notes))


class _Course:
    """Plans one change of contacts after the other.

    Where a pose is missing that would exist with a contact elsewhere within its slack, the contact is moved, and the
    changes from the one on that makes it are planned again.

    Attributes:
        stances: with the places that are chosen so far.
        notes: about places that were moved.
    """

    def __init__(self, walker: Walker, stances: tuple[ContactStance, ...], has_finish: bool) -> None:
        self._walker, self.stances, self._has_finish = walker, stances, has_finish
        self._changes: list[Sequence[PlannedPhase]] = []
        self._n_moves = 0
        self.notes: list[str] = []

    @property
    def specs(self) -> tuple[TaskPhase, ...]:
        """All phases in their order."""
        return list_contact_phases(self.stances, has_finish=self._has_finish)

    @property
    def phases(self) -> list[PlannedPhase]:
        """Those that are planned."""
        return [phase for change in self._changes for phase in change]

    @property
    def at(self) -> Float[np.ndarray, "n"]:
        """(n,) configuration in which they end."""
        phases = self.phases
        return phases[-1].q[-1] if phases else self._walker.start.nominal

    def add(self, phase: PlannedPhase) -> None:
        """Append a planned phase."""
        self._changes.append((phase,))

    def go_through(self) -> None:
        """Plan all changes of contacts.

        Raises:
            StuckError: one of them cannot be made.
        """
        while (k := len(self._changes) + 1) < len(self.stances):
            before, after = self.stances[k - 1 : k + 1]
            try:
                self._changes.append(self._walker.try_change(before, after, self.at, range(PLAIN_TRIES)))
            except StuckError as error:
                made = self._move_places(k, error.missing)
                if made is not None:
                    del self._changes[made - 1 :]
                    continue
                further = range(PLAIN_TRIES, self._walker.most_tries)
                if not further:
                    raise
                self._changes.append(self._walker.try_change(before, after, self.at, further, error))

    def _move_places(self, k: int, missing: MissingPose | None) -> int | None:
        """Move contacts so that a missing pose exists; return the first stance that makes one of them, or None.

        Args:
            k: stance that was not reached.
            missing: on the way there.
        """
        if missing is None or self._n_moves == MOST_MOVES:
            return None
        movable = {patch: made for made, patch in list_movable(self.stances) if made <= k}
        slides = missing.held.only_sliding(movable).find_slides([self.at, missing.near], missing.near) or {}
        slides = {patch: by for patch, by in slides.items() if abs(by) > LEAST_MOVE_M}
        if not slides:
            return None
        self._n_moves += 1
        for patch, by in slides.items():
            self.stances = move_place(self.stances, movable[patch], patch, by, self._walker.start.scene)
            self.notes.append(f"{patch} is moved by {1e3 * by:.0f} mm in '{self.stances[movable[patch]].name}'")
        return min(movable[patch] for patch in slides)
