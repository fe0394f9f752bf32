"""A recorded motion held to a request: its promises are made anew, and what the record says otherwise is told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.goals import goal_targets
from service.demands.kept import kept_target
from service.demands.program import ProgramDemand, moved_though_fixed, program_targets
from service.demands.stance import Stance, planted_feet, standing_allowances
from service.request import PlanRequest
from service.start import overlaps
from service.verify import Motion, Phase, Target
from service.verify.certificate import bodies_hash, robot_hash, scene_hash

ESCAPE = "escape"
DEPTH_ROUNDING_M = 1e-4  # by which a pair may be deeper than it was measured at the start
SAME = 1e-6  # numbers of a request and of a record that agree [m, rad]


@dataclass(frozen=True)
class Demands:
    """What a request demands of every motion that answers it.

    Attributes:
        request: as it was asked.
        robot: without what a task moves.
        start: (n,) where it stands at first.
        scene: all pieces, the floor's included.
        program: what the request's TrajOpt problem demands, or None.
    """

    request: PlanRequest
    robot: RobotModel
    start: Float[np.ndarray, "n"]
    scene: Scene
    program: ProgramDemand | None = None

    @property
    def feet(self) -> tuple[str, ...]:
        """Links that are planted."""
        if self.program is not None:
            return self.program.planted
        return planted_feet(self.robot, self.request.options.feet)


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
    differences = [*_world_differences(demands, recorded), *_path_differences(demands, recorded)]
    promises, lines = _promises(demands, recorded)
    phases = tuple(_rebuild(demands, recorded, index, promises) for index in range(len(recorded.phases)))
    differences += lines
    for phase, own in zip(recorded.phases, phases, strict=True):
        differences += _phase_differences(phase, own, is_program=demands.program is not None)
    return Held(replace(recorded, scene=demands.scene, phases=phases), tuple(differences))


@dataclass(frozen=True)
class _Promises:
    """What the phases promise besides standing: targets of the task in the last phase, kept poses in all of them."""

    stance: Stance
    standing: tuple[Allowance, ...]
    escape: tuple[Allowance, ...]
    last: tuple[Target, ...]
    everywhere: tuple[Target, ...]


def _promises(demands: Demands, recorded: Motion) -> tuple[_Promises, tuple[str, ...]]:
    request, robot, start, feet = demands.request, demands.robot, demands.start, demands.feet
    is_balanced = demands.program is None or demands.program.is_balanced
    stance = Stance.of(robot, start, feet, request.options.balance_margin_m, is_balanced)
    leaves = request.options.escape and demands.program is None
    inside = overlaps(robot, start, demands.scene, feet) if leaves else []
    targets: tuple[Target, ...] = ()
    lines: tuple[str, ...] = ()
    knots = recorded.curve.knots
    if request.goal is not None:
        targets = goal_targets(robot, request.goal, float(knots[-1]))
    elif demands.program is not None:
        targets, lines = program_targets(demands.program, robot, knots, recorded.curve.positions[:, : robot.n])
    return _Promises(
        stance,
        standing_allowances(feet, demands.scene),
        tuple(Allowance(*one.pair, one.depth + DEPTH_ROUNDING_M) for one in inside),
        targets,
        tuple(kept_target(robot, start, keep) for keep in request.keep),
    ), lines


def _rebuild(demands: Demands, recorded: Motion, index: int, promises: _Promises) -> Phase:
    """One phase as the request has it."""
    phase = recorded.phases[index]
    first = recorded.curve(np.array([phase.first]))[0, : demands.robot.n]
    escape = promises.escape if phase.name == ESCAPE and index == 0 else ()
    targets = promises.last if index == len(recorded.phases) - 1 else ()
    if demands.program is not None:  # what it holds between its steps is a promise of the planner's own
        targets = (*(one for one in phase.targets if getattr(one, "at", None) is None), *targets)
    return Phase(
        name=phase.name,
        first=phase.first,
        last=phase.last,
        contacts=promises.stance.contacts,
        allowances=(*promises.standing, *escape),
        targets=(*targets, *promises.everywhere),
        support=promises.stance.support(phase.name, first),
    )


def _world_differences(demands: Demands, recorded: Motion) -> Iterator[str]:
    """Robot and scene."""
    robot, n = demands.robot, demands.robot.n
    if recorded.robot.joint_names[:n] != robot.joint_names or robot_hash(recorded.robot) != robot_hash(robot):
        yield "the robot is not the request's"
    elif not recorded.mechanism_links and bodies_hash(recorded.robot) != bodies_hash(robot):
        yield "the robot's bodies or ignored pairs are not the request's"
    if recorded.robot.n != n and demands.request.goal is not None:
        yield "the motion moves more than the robot, which the request does not ask for"
    if scene_hash(recorded.scene) != scene_hash(demands.scene):
        yield _scene_difference(recorded.scene, demands.scene)


def _scene_difference(recorded: Scene, own: Scene) -> str:
    """Which pieces differ."""
    written, wanted = ({piece.name: piece for piece in scene.pieces} for scene in (recorded, own))
    missing, more = sorted(wanted.keys() - written.keys()), sorted(written.keys() - wanted.keys())
    if missing:
        return f"the scene lacks {', '.join(missing[:3])}{' and others' if len(missing) > 3 else ''}"
    if more:
        return f"the scene has {', '.join(more[:3])}, which the request does not"
    changed = [name for name in sorted(wanted) if not _same(wanted[name].vertices, written[name].vertices)]
    kinds = [name for name in sorted(wanted) if wanted[name].kind != written[name].kind]
    return f"{', '.join((changed or kinds or ['a piece'])[:3])} of the scene is not where the request has it"


def _path_differences(demands: Demands, recorded: Motion) -> Iterator[str]:
    """Start, time law, and what a program does not move."""
    q = recorded.curve.positions[:, : demands.robot.n]
    off = np.abs(q[0] - demands.start)
    if off.max(initial=0.0) > SAME:
        joint = demands.robot.joint_names[int(off.argmax())]
        yield f"the motion starts {off.max():.3g} away from the request's start at {joint}"
    if demands.request.options.timed and recorded.law is None:
        yield "the request asks for a timed motion, and this one has no time law"
    if demands.program is not None:
        yield from moved_though_fixed(demands.program, demands.robot, demands.start, q)
    names = [phase.name for phase in recorded.phases]
    if ESCAPE in names[1:]:
        yield "only the first phase may leave what the robot starts in"


def _phase_differences(recorded: Phase, own: Phase, is_program: bool) -> Iterator[str]:
    """What a recorded phase promises otherwise than the request does."""
    for name in (
        ("contacts", "allowances", "support") if is_program else ("contacts", "allowances", "support", "targets")
    ):
        if not _same(getattr(recorded, name), getattr(own, name)):
            yield f"{name} of phase '{recorded.name}' are not those of the request"


def _same(one: object, other: object) -> bool:
    """Whether two values agree, numbers up to rounding; infinities agree with infinities."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        if one is None or other is None:
            return one is other
        a, b = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
        return a.shape == b.shape and bool(np.allclose(a, b, rtol=0.0, atol=SAME))
    if isinstance(one, float | int) and isinstance(other, float | int):
        return bool(np.isclose(one, other, rtol=0.0, atol=SAME))
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(_same(a, b) for a, b in zip(one, other, strict=True))
    if is_dataclass(one) and type(one) is type(other):
        return all(_same(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    return one == other
