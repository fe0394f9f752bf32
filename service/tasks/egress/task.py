"""Planner of an egress: poses drawn and linked, then the motions between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.demands.contacts.contact_task import face_pieces
from service.request.egress import EgressRequest
from service.setup.prepare import PlanSetup
from service.tasks.contact_motion import PoseGuesses, plan_contact_motion
from service.tasks.egress.plan import StageCount, plan_poses


def plan_egress(setup: PlanSetup, solver: PhaseSolver, request: EgressRequest) -> Iterator[TaskPlan]:
    """Yield the plan of the motion along the cheapest sequence of poses, or why there is none."""
    monitor, folder = solver.monitor, setup.request.folder
    with monitor.step("poses", 0.05):
        poses = plan_poses(
            setup.robot,
            setup.scene,
            request,
            folder,
            seed=solver.seed,
            should_stop=monitor.is_over,
            start=setup.stances[0],
        )
        monitor.check()
    notes = tuple(_describe(count) for count in poses.counts)
    if poses.sequence is None:
        yield TaskPlan(solver.body, (), poses.reasons, notes=notes)
        return
    chain = poses.sequence.chain
    stances = [
        replace(stance, contacts=tuple(face_pieces(contact, setup.scene) for contact in stance.contacts))
        for stance in chain.stances
    ]
    names = [stance.name for stance in stances[1:]]
    steps = list(zip(names, chain.transitions, strict=True))
    guesses = PoseGuesses(
        {name: step.leaving.q for name, step in steps if step.leaving is not None},
        {name: step.arriving.q for name, step in steps if step.arriving is not None},
    )
    plan = plan_contact_motion(solver, stances, chain.poses[-1].q, guesses)
    yield replace(plan, notes=(*notes, *plan.notes))


def _describe(count: StageCount) -> str:
    text = f"'{count.name}': {count.feasible} of {count.solved} poses hold"
    return text + (f", {count.duplicates} of them alike" if count.duplicates else "")
