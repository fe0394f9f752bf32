"""A recorded motion held to a request: its promises are made anew, and what the record says otherwise is told."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from costs.allowance import Allowance
from service.demands.demand import Demands
from service.demands.differences import ESCAPE, path_differences, phase_differences, world_differences
from service.demands.goals import goal_targets
from service.demands.kept import kept_target
from service.demands.program import program_targets
from service.demands.stance import Stance, leaving_allowances, standing_allowances
from service.demands.turning import Turning
from service.demands.wheel import robot_with_wheel
from service.start.overlaps import find_hull_overlaps
from service.verify import Motion, Phase, Target
from service.verify.coverage.required import waived_checks


@dataclass(frozen=True)
class Held:
    """A motion whose promises are a request's own.

    Attributes:
        motion: the recorded curve, time law, samples and phases' borders; everything else from the request.
        differences: one sentence for everything the record says that the request does not.
    """

    motion: Motion
    differences: tuple[str, ...]


def hold_to_request(demands: Demands, recorded: Motion) -> Held:
    """Make a recorded motion's promises anew from a request.

    Of the record only choices are kept: curve, time law, samples, and where the phases begin and end.

    Raises:
        ValueError: the request's feet do not span a polygon.
    """
    robot = demands.robot if demands.wheel is None else robot_with_wheel(demands.robot, demands.wheel)
    differences = list(world_differences(demands, robot, recorded))
    if recorded.robot.joint_names != robot.joint_names:
        return Held(recorded, tuple(differences))
    differences += path_differences(demands, recorded)
    promises, lines = _promises(demands, recorded)
    phases = tuple(_rebuild(demands, recorded, index, promises) for index in range(len(recorded.phases)))
    differences += lines
    for phase, own in zip(recorded.phases, phases, strict=True):
        differences += phase_differences(phase, own, is_program=demands.program is not None)
    waived = waived_checks(
        is_timed=demands.request.options.timed,
        is_balanced=promises.stance.hull is not None or not demands.robot.is_floating,
    )
    if recorded.waived != waived:
        differences.append("the checks that the record waives are not those that the request does not ask for")
    motion = replace(
        recorded,
        robot=robot,
        scene=demands.scene,
        phases=phases,
        mechanism_links=robot.mechanism_links,
        waived=waived,
    )
    return Held(motion, tuple(differences))


@dataclass(frozen=True)
class _Promises:
    """What the phases promise besides standing: targets of the task in the last phase, kept poses in all of them."""

    stance: Stance
    standing: tuple[Allowance, ...]
    escape: tuple[Allowance, ...]
    last: tuple[Target, ...]
    everywhere: tuple[Target, ...]
    turning: Turning | None


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
        targets = goal_targets(robot, request.goal, float(knots[-1]))
    elif demands.program is not None:
        targets, lines = program_targets(demands.program, robot, knots, recorded.curve.positions[:, : robot.n])
    turning = None
    if demands.wheel is not None and request.task is not None and request.task.valve is not None:
        turning = Turning.of(demands.wheel, request.task.valve, recorded)
        lines = turning.problems
    return _Promises(
        stance,
        standing_allowances(feet, demands.scene),
        leaving_allowances(inside),
        targets,
        tuple(kept_target(robot, start, keep) for keep in request.keep),
        turning,
    ), lines


def _rebuild(demands: Demands, recorded: Motion, index: int, promises: _Promises) -> Phase:
    """One phase as the request has it."""
    phase = recorded.phases[index]
    first = recorded.curve(np.array([phase.first]))[0, : demands.robot.n]
    escape = promises.escape if phase.name == ESCAPE and index == 0 else ()
    targets = promises.last if index == len(recorded.phases) - 1 else ()
    touching: tuple[Allowance, ...] = ()
    if promises.turning is not None:
        targets = promises.turning.targets(index, phase.last)
        touching = promises.turning.allowances(index, phase)
    if demands.program is not None:  # what it holds between its steps is a promise of the planner's own
        targets = (*(one for one in phase.targets if getattr(one, "at", None) is None), *targets)
    return Phase(
        name=phase.name,
        first=phase.first,
        last=phase.last,
        contacts=promises.stance.contacts,
        allowances=(*promises.standing, *escape, *touching),
        targets=(*targets, *promises.everywhere),
        support=promises.stance.support(phase.name, first),
    )
