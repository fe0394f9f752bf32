"""Best attempt at a request during planning, from which a result can be made at any time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from service.body.task_plan import TaskPlan
from service.explain.conflict import Conflict
from service.result.result import PlanResult, Verdict
from service.setup.prepare import PlanSetup
from service.start.split_links import suggest_split
from service.verify import Basis, Certificate, Motion, Status

MOST_SHORTFALLS = 3  # of a certificate that are named where a plan ends early
_RANK = {Status.VIOLATED: 0, Status.FEASIBLE_AT_SAMPLES: 1, Status.CERTIFIED: 2}
_VERDICT_OF_STATUS = {
    Status.CERTIFIED: Verdict.CERTIFIED,
    Status.FEASIBLE_AT_SAMPLES: Verdict.FEASIBLE_AT_SAMPLES,
    Status.VIOLATED: Verdict.NOT_FOUND,
}


@dataclass
class Attempt:
    """Best attempt at a request so far.

    Attributes:
        verdict, explanation: those of a result at this moment.
        task: the task plan that the verdict is about.
        motion, certificate: the best verified motion.
        conflict: constraints that exclude each other at the step without a solution.
        unverified: the newest plan with a motion that has no certificate yet.
        uncovered: what the newest certificate does not cover, where nothing else is open.
        is_repeated: whether the motion before was not covered in the same way.
        meeting: pairs of links that the robot's files leave out and that meet in the newest motion.
    """

    verdict: Verdict = Verdict.NOT_FOUND
    explanation: tuple[str, ...] = ()
    task: TaskPlan | None = None
    motion: Motion | None = None
    certificate: Certificate | None = None
    conflict: Conflict | None = None
    unverified: tuple[TaskPlan, Motion] | None = None
    uncovered: frozenset[str] = frozenset()
    is_repeated: bool = False
    meeting: frozenset[tuple[str, str]] = frozenset()

    def begin(self, task: TaskPlan) -> None:
        """Take another task plan, which is returned until a motion is verified."""
        if self.certificate is None:
            self.task, self.explanation = task, task.reasons
            self.verdict = Verdict.INFEASIBLE if task.is_impossible else Verdict.NOT_FOUND

    def keep_better(self, task: TaskPlan, motion: Motion, certificate: Certificate) -> None:
        """Keep a verified motion unless an earlier one has the better certificate."""
        uncovered = certificate.list_uncovered()
        self.meeting = certificate.list_meeting()
        self.is_repeated, self.uncovered = bool(uncovered) and uncovered == self.uncovered, uncovered
        known = None if self.task is None or self.certificate is None else _rank(self.task, self.certificate)
        if known is not None and _rank(task, certificate) <= known:
            return
        self.task, self.motion, self.certificate = task, motion, certificate
        if task.is_feasible:
            self.verdict = _VERDICT_OF_STATUS[certificate.status]
            self.explanation = list_shortfalls(certificate)
        else:
            self.explanation = task.reasons

    def is_final(self, task: TaskPlan) -> bool:
        """Return whether no plan after ``task`` would get a better certificate."""
        if self.verdict is Verdict.CERTIFIED:
            return True
        if not task.is_feasible or self.certificate is None:
            return False
        return self.certificate.fails_by_description() or self.is_repeated

    def interrupt(self, verdict: Verdict, reason: str, delay: tuple[str, ...] = ()) -> None:
        """End with TIME_LIMIT or CANCELLED; the reasons of the task, of the certificate or of the delay follow."""
        known = () if self.task is None else self.task.reasons
        if not known and self.certificate is not None:
            known = list_shortfalls(self.certificate)[:MOST_SHORTFALLS]
        self.verdict, self.explanation = verdict, (reason, *(known or delay))

    def take_unverified(self, make_motion: Callable[[TaskPlan], Motion]) -> None:
        """Take the best motion without a certificate if none is verified."""
        if self.motion is None and self.unverified is not None:
            self.task, self.motion = self.unverified
        if self.motion is None and self.task is not None and self.task.phases:
            self.motion = make_motion(self.task)

    def explain(self, conflict: Conflict) -> None:
        """Replace the explanation by a conflict."""
        self.conflict = conflict
        self.explanation = (*conflict.sentences(), *(() if self.task is None else self.task.obstacle))

    def to_result(self, setup: PlanSetup, timings: dict[str, float]) -> PlanResult:
        """Return the attempt as the plan's result."""
        task = self.task
        meeting = () if self.certificate is None else sorted(self.certificate.list_meeting())
        hulls = suggest_split(setup.robot, setup.request.robot.decompose, (link for pair in meeting for link in pair))
        return PlanResult(
            request=setup.request,
            verdict=self.verdict,
            robot=setup.robot,
            scene=setup.scene if task is None else task.body.scene,
            start=setup.start,
            motion=self.motion,
            certificate=self.certificate,
            unsolved=() if task is None else tuple(phase.name for phase in task.phases if not phase.is_feasible),
            task_phases=() if task is None or task.stuck is None else task.stuck.order,
            explanation=(*self.explanation, *hulls),
            conflict=self.conflict,
            found_from="" if task is None else task.found_from,
            notes=(*setup.notes, *(() if task is None else task.notes)),
            pose_graph=None if task is None else task.pose_graph,
            timings=timings,
            figures={} if task is None or self.motion is None else task.measure(self.motion),
            detections=setup.surroundings.list_hits(),
            obstruction=self._describe_obstruction(setup),
            cloud=setup.surroundings.points,
        )

    def _describe_obstruction(self, setup: PlanSetup) -> dict[str, Any] | None:
        """Return the goal to draw if the search ended without a motion."""
        if self.motion is not None or self.verdict not in (Verdict.INFEASIBLE, Verdict.NOT_FOUND):
            return None
        from service.result.obstruction import describe_obstruction  # few results need it

        return describe_obstruction(setup)


def _rank(task: TaskPlan, certificate: Certificate) -> tuple[bool, int, float]:
    """Return the order of a verified motion: plans of the whole task last, then by certificate, then by violation."""
    return task.is_feasible, _RANK[certificate.status], -task.shortfall


def list_shortfalls(certificate: Certificate) -> tuple[str, ...]:
    """Return the texts of failed checks or, if there are none, of unproven ones, each with its time."""
    checks = certificate.failed() or tuple(c for c in certificate.checks if c.basis is Basis.UNPROVEN)
    return tuple(
        check.text
        if check.where is None or check.where.time_s is None
        else f"{check.text} (at {check.where.time_s:.2f} s)"
        for check in checks
    )
