"""Where a recorded motion says otherwise than its request: robot, scene, path, pace, and what its phases promise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.demand import Demands
from service.demands.program import moved_though_fixed
from service.request.schema import PlanRequest
from service.verify import Certificate, Motion, Phase
from service.verify.hashes import bodies_hash, robot_hash, scene_hash

ESCAPE = "escape"
PACE_TOLERANCE = 0.01  # share of a speed or an acceleration that may be used in addition
BORDER_ROUNDING = 1e-9  # of path parameters, and of tangents that vanish
SAME = 1e-6  # numbers of a request and of a record that agree [m, rad]


def world_differences(demands: Demands, robot: RobotModel, recorded: Motion) -> Iterator[str]:
    """Robot, what the task moves, and scene."""
    if recorded.robot.joint_names != robot.joint_names:
        yield "the motion's joints are not those of the robot and of what the request moves"
    elif robot_hash(recorded.robot) != robot_hash(robot):
        yield "the robot is not the request's"
    elif bodies_hash(recorded.robot) != bodies_hash(robot):
        yield "the bodies, or the ignored pairs, are not those of the robot and of what the request moves"
    elif not _is_same_joint(recorded.robot, robot):
        yield "what the task moves does not move as the request has it"
    if scene_hash(recorded.scene) != scene_hash(demands.scene):
        yield _scene_difference(recorded.scene, demands.scene)


def path_differences(demands: Demands, recorded: Motion) -> Iterator[str]:
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
    for phase in recorded.phases[1:]:
        if not _rests(recorded, phase.first):
            yield f"phase '{phase.name}' begins where the robot does not rest"
    names = [phase.name for phase in recorded.phases]
    if ESCAPE in names[1:]:
        yield "only the first phase may leave what the robot starts in"


def phase_differences(recorded: Phase, own: Phase, is_program: bool) -> Iterator[str]:
    """What a recorded phase promises otherwise than the request does."""
    for name in (
        ("contacts", "allowances", "support") if is_program else ("contacts", "allowances", "support", "targets")
    ):
        if not _same(getattr(recorded, name), getattr(own, name)):
            yield f"{name} of phase '{recorded.name}' are not those of the request"


def pace_differences(request: PlanRequest, certificate: Certificate) -> Iterator[str]:
    """A sentence where a motion uses more of the robot's speed or acceleration limits than the request lets it."""
    options = request.options
    for name, share in (("speed", options.velocity_scale), ("acceleration", options.acceleration_scale)):
        for check in certificate.checks:
            if check.name == f"limits.{name}" and check.value > share * (1.0 + PACE_TOLERANCE):
                used, most = 100.0 * check.value, 100.0 * share
                yield f"the motion uses {used:.0f} % of the {name} limits, the request at most {most:g} %"


def _is_same_joint(one: RobotModel, other: RobotModel) -> bool:
    """Whether the last joints of two robots of the same URDF have the same place, axis and limits."""
    places = [robot.model.jointPlacements[robot.model.njoints - 1].homogeneous for robot in (one, other)]
    axes = [_axis(robot) for robot in (one, other)]
    limits = [np.stack([robot.lower, robot.upper, robot.velocity, robot.acceleration]) for robot in (one, other)]
    finite = [np.nan_to_num(limit, posinf=1e9, neginf=-1e9) for limit in limits]
    return _same(places[0], places[1]) and _same(axes[0], axes[1]) and _same(finite[0], finite[1])


def _axis(robot: RobotModel) -> Float[np.ndarray, "6"]:
    """How the last joint moves at configuration zero, in its own frame."""
    joint = robot.model.joints[robot.model.njoints - 1]
    data = joint.createData()
    joint.calc(data, np.zeros(robot.n), np.zeros(robot.n))
    return np.asarray(data.S).reshape(6, -1)[:, -1]


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


def _rests(motion: Motion, border: float) -> bool:
    """Whether the curve has a waypoint at a path parameter, and vanishing tangents there."""
    at = int(np.abs(motion.curve.knots - border).argmin())
    is_knot = abs(motion.curve.knots[at] - border) <= BORDER_ROUNDING * max(1.0, abs(border))
    return bool(is_knot and np.abs(motion.curve.tangents[at]).max(initial=0.0) <= BORDER_ROUNDING)


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
