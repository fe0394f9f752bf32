"""A recorded motion held to a request: its promises are made anew from the request, and differences are listed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from costs.allowance import Allowance
from service.demands.demand import Demands
from service.demands.differences import ESCAPE, compare_path, compare_phase, compare_world
from service.demands.program import make_program_targets
from service.demands.recorded_turn import RecordedTurn
from service.demands.stance import Stance, make_escape_allowances, make_standing_allowances
from service.demands.targets import make_goal_targets, make_kept_target
from service.demands.wheel import add_wheel_joint
from service.start.overlaps import find_hull_overlaps
from service.verify import Motion, Phase, Target
from service.verify.coverage.required import list_waived_checks


@dataclass(frozen=True)
class HeldMotion:
    """Recorded motion with the promises of a request.

    Attributes:
        motion: the recorded curve, time law, samples and phases' borders; everything else from the request.
        differences: one sentence for each statement of the record that is not the request's.
    """

    motion: Motion
    differences: tuple[str, ...]


def hold_to_request(demands: Demands, recorded: Motion) -> HeldMotion:
    """Make a recorded motion's promises anew from a request.

    Only choices are kept from the record: curve, time law, samples, and where phases begin and end.

    Raises:
        ValueError: the request's feet do not span a polygon.
    """
    robot = demands.robot if demands.wheel is None else add_wheel_joint(demands.robot, demands.wheel)
    differences = list(compare_world(demands, robot, recorded))
    if recorded.robot.joint_names != robot.joint_names:
        return HeldMotion(recorded, tuple(differences))
    differences += compare_path(demands, recorded)
    promises, lines = _promises(demands, recorded)
    phases = tuple(_rebuild(demands, recorded, index, promises) for index in range(len(recorded.phases)))
    differences += lines
    for phase, own in zip(recorded.phases, phases, strict=True):
        differences += compare_phase(phase, own, is_program=demands.program is not None)
    waived = list_waived_checks(
        is_timed=demands.request.options.timed,
        is_balanced=promises.stance.hull is not None or not demands.robot.is_floating,
    )
    if recorded.waived != waived:
        differences.append("the record waives other checks than the request")
    motion = replace(
        recorded,
        robot=robot,
        scene=demands.scene,
        phases=phases,
        mechanism_links=robot.mechanism_links,
        waived=waived,
    )
    return HeldMotion(motion, tuple(differences))


@dataclass(frozen=True)
class _Promises:
    """Promises of the phases, made from the request.

    Attributes:
        stance: planted feet and support polygon.
        standing: allowances of planted links on floors.
        escape: allowances of the overlaps at the start.
        last: targets of the last phase.
        everywhere: targets of all phases.
        turning: strokes of a valve task, or None.
    """

    stance: Stance
    standing: tuple[Allowance, ...]
    escape: tuple[Allowance, ...]
    last: tuple[Target, ...]
    everywhere: tuple[Target, ...]
    turning: RecordedTurn | None


def _promises(demands: Demands, recorded: Motion) -> tuple[_Promises, tuple[str, ...]]:
    request, robot, start, feet = demands.request, demands.robot, demands.start, demands.feet
    is_balanced = demands.program is None or demands.program.is_balanced
    stance = Stance.of(robot, start, feet, request.options.balance_margin_m, is_balanced)
    leaves = request.options.escape and demands.program is None
    inside = find_hull_overlaps(robot, start, demands.scene, feet) if leaves else []
    targets: tuple[Target, ...] = ()
    lines: tuple[str, ...] = ()
    knots = recorded.curve.knots
    if request.goal is not None:
        targets = make_goal_targets(robot, request.goal, float(knots[-1]))
    elif demands.program is not None:
        targets, lines = make_program_targets(demands.program, robot, knots, recorded.curve.positions[:, : robot.n])
    turning = None
    if demands.wheel is not None and request.task is not None and request.task.valve is not None:
        turning = RecordedTurn.of(demands.wheel, request.task.valve, recorded)
        lines = turning.problems
    return _Promises(
        stance,
        make_standing_allowances(feet, demands.scene),
        make_escape_allowances(inside),
        targets,
        tuple(make_kept_target(robot, start, keep) for keep in request.keep),
        turning,
    ), lines


def _rebuild(demands: Demands, recorded: Motion, index: int, promises: _Promises) -> Phase:
    """Return one phase with the promises of the request."""
    phase = recorded.phases[index]
    first = recorded.curve(np.array([phase.first]))[0, : demands.robot.n]
    escape = promises.escape if phase.name == ESCAPE and index == 0 else ()
    targets = promises.last if index == len(recorded.phases) - 1 else ()
    touching: tuple[Allowance, ...] = ()
    if promises.turning is not None:
        targets = promises.turning.targets(index, phase.last)
        touching = promises.turning.allowances(index, phase)
    if demands.program is not None:  # the planner itself promises targets between its steps
        targets = (*(target for target in phase.targets if getattr(target, "at", None) is None), *targets)
    return Phase(
        name=phase.name,
        first=phase.first,
        last=phase.last,
        contacts=promises.stance.contacts,
        allowances=(*promises.standing, *escape, *touching),
        targets=(*targets, *promises.everywhere),
        support=promises.stance.support(phase.name, first),
    )
