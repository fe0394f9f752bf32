"""Planner of an egress: poses drawn and linked, then the motions between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from costs.stopping import Stopped
from service.body.monitor import Interrupted
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.demands.contacts.contact_task import face_pieces
from service.demands.contacts.stances import ends_with_new_contacts
from service.request.tasks.egress import EgressRequest
from service.setup.prepare import PlanSetup
from service.tasks.contacts.known_poses import KnownPoses
from service.tasks.contacts.motion import plan_contact_motion
from service.tasks.egress.chain import Chain
from service.tasks.egress.plan import PosePlan, StageCount, describe_graph, plan_poses
from service.tasks.egress.poses import ROOM_M

KNOWN_TRIES = 2  # of a change of contacts in one sequence; then the next sequence is planned
POSES_FROM, POSES_TO = 0.05, 0.2  # of the whole plan, for its progress


def plan_egress(setup: PlanSetup, solver: PhaseSolver, request: EgressRequest) -> Iterator[TaskPlan]:
    """Yield the plan of the motion along the cheapest sequence of poses, or why there is none."""
    monitor, folder = solver.monitor, setup.request.folder
    with monitor.step("poses", POSES_FROM):
        poses = plan_poses(
            setup.robot,
            setup.scene,
            request,
            folder,
            seed=solver.seed,
            map=solver.map,
            should_stop=monitor.is_over,
            start=setup.stances[0],
            on_pose=lambda stage, feasible, share: monitor.report(
                f"poses of '{stage}': {feasible} hold", POSES_FROM + share * (POSES_TO - POSES_FROM)
            ),
        )
        monitor.check()
    notes = tuple(_describe(count) for count in poses.counts)
    search, sequence = poses.search, poses.sequence
    if search is None or sequence is None:
        notes += tuple(_suggest_shorter(poses))
        yield TaskPlan(solver.body, (), poses.reasons, notes=notes, pose_graph=describe_graph(poses))
        return
    failed: TaskPlan | None = None
    try:
        while sequence is not None:
            plan = _plan_motion(setup, solver, sequence.chain)
            graph = describe_graph(replace(poses, sequence=sequence))
            plan = replace(plan, notes=(*notes, *plan.notes), pose_graph=graph)
            stuck = None
            if plan.is_feasible:
                yield plan
            else:
                failed = plan if failed is None or len(plan.phases) > len(failed.phases) else failed
                stuck = plan.phases[-1].name.split(": ")[0]
            if not search.drop(sequence, stuck):
                break
            with monitor.step("poses", POSES_TO):
                sequence = search.find_next()
    except (Interrupted, Stopped):
        if failed is None:
            raise
    if failed is not None:
        yield failed


def _plan_motion(setup: PlanSetup, solver: PhaseSolver, chain: Chain) -> TaskPlan:
    """Return the motion along a chain of poses."""
    stances = [
        replace(stance, contacts=tuple(face_pieces(contact, setup.scene) for contact in stance.contacts))
        for stance in chain.stances
    ]
    names = [stance.name for stance in stances[1:]]
    steps = list(zip(names, chain.transitions, strict=True))
    guesses = KnownPoses(
        {name: step.leaving.q for name, step in steps if step.leaving is not None},
        {name: step.arriving.q for name, step in steps if step.arriving is not None},
        {name: pose.q for name, pose in zip(names, chain.poses[1:], strict=True)},
    )
    finish = chain.poses[-1].q if ends_with_new_contacts(stances) else None
    solver = replace(solver, body=replace(solver.body, room_m=ROOM_M))
    return plan_contact_motion(solver, stances, finish, guesses, KNOWN_TRIES)


def _suggest_shorter(poses: PosePlan) -> Iterator[str]:
    """Yield the request's field that plans the phases before the first one without a pose."""
    names = [count.name for count in poses.counts]
    missing = next((k for k, count in enumerate(poses.counts) if not count.feasible), 0)
    if missing > 1:
        yield f"task.egress.until: {names[missing - 1]!r} plans the phases before '{names[missing]}' alone"


def _describe(count: StageCount) -> str:
    text = f"'{count.name}': {count.feasible} of {count.solved} poses hold"
    return text + (f", {count.duplicates} of them alike" if count.duplicates else "")
