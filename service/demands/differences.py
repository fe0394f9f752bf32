"""Differences between a recorded motion and its request: robot, scene, path, speed, and promises of its phases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.demand import Demands
from service.demands.program import report_fixed_joints_that_move
from service.request.schema import PlanRequest
from service.verify import Certificate, Motion, Phase
from service.verify.hashes import bodies_hash, robot_hash, scene_hash

ESCAPE = "escape"
PACE_TOLERANCE = 0.01  # share of a speed or an acceleration that may be used in addition
BORDER_ROUNDING = 1e-9  # of path parameters, and of tangents that vanish
SAME = 1e-6  # numbers of a request and of a record that agree [m, rad]


def compare_world(demands: Demands, robot: RobotModel, recorded: Motion) -> Iterator[str]:
    """Yield a sentence for each difference in robot, mechanism and scene."""
    if recorded.robot.joint_names != robot.joint_names:
        yield "the motion's joints are not those of the robot and the task's mechanism"
    elif robot_hash(recorded.robot) != robot_hash(robot):
        yield "the robot is not the request's"
    elif bodies_hash(recorded.robot) != bodies_hash(robot):
        yield "the bodies, or the ignored pairs, are not those of the robot and the task's mechanism"
    elif not _is_same_joint(recorded.robot, robot):
        yield "the task's mechanism does not move as the request demands"
    if scene_hash(recorded.scene) != scene_hash(demands.scene):
        yield _scene_difference(recorded.scene, demands.scene)


def compare_path(demands: Demands, recorded: Motion) -> Iterator[str]:
    """Yield a sentence for each difference in start, time law, fixed joints and phase borders."""
    q = recorded.curve.positions[:, : demands.robot.n]
    off = np.abs(q[0] - demands.start)
    if off.max(initial=0.0) > SAME:
        joint = demands.robot.joint_names[int(off.argmax())]
        yield f"the motion starts {off.max():.3g} away from the request's start at {joint}"
    if demands.request.options.timed and recorded.law is None:
        yield "the request demands a timed motion, and the record has no time law"
    if demands.program is not None:
        yield from report_fixed_joints_that_move(demands.program, demands.robot, demands.start, q)
    for phase in recorded.phases[1:]:
        if not _rests(recorded, phase.first):
            yield f"phase '{phase.name}' begins while the robot moves; it must rest there"
    names = [phase.name for phase in recorded.phases]
    if ESCAPE in names[1:]:
        yield "only the first phase may escape from an overlap at the start"


def compare_phase(recorded: Phase, own: Phase, is_program: bool) -> Iterator[str]:
    """Yield a sentence for each promise of a recorded phase that is not the request's."""
    for name in (
        ("contacts", "allowances", "support") if is_program else ("contacts", "allowances", "support", "targets")
    ):
        if not _same(getattr(recorded, name), getattr(own, name)):
            yield f"{name} of phase '{recorded.name}' are not those of the request"


def compare_pace(request: PlanRequest, certificate: Certificate) -> Iterator[str]:
    """Yield a sentence where a motion uses more of the robot's speed or acceleration limits than the request allows."""
    options = request.options
    for name, share in (("speed", options.velocity_scale), ("acceleration", options.acceleration_scale)):
        for check in certificate.checks:
            if check.name == f"limits.{name}" and check.value > share * (1.0 + PACE_TOLERANCE):
                used, most = 100.0 * check.value, 100.0 * share
                yield f"the motion uses {used:.0f} % of the {name} limits, the request at most {most:g} %"


def _is_same_joint(first: RobotModel, second: RobotModel) -> bool:
    """Whether the last joints of two robots of the same URDF have the same place, axis and limits."""
    places = [robot.model.jointPlacements[robot.model.njoints - 1].homogeneous for robot in (first, second)]
    axes = [_axis(robot) for robot in (first, second)]
    limits = [np.stack([robot.lower, robot.upper, robot.velocity, robot.acceleration]) for robot in (first, second)]
    finite = [np.nan_to_num(limit, posinf=1e9, neginf=-1e9) for limit in limits]
    return _same(places[0], places[1]) and _same(axes[0], axes[1]) and _same(finite[0], finite[1])


def _axis(robot: RobotModel) -> Float[np.ndarray, "6"]:
    """Return the motion axis of the last joint at configuration zero, in its own frame."""
    joint = robot.model.joints[robot.model.njoints - 1]
    data = joint.createData()
    joint.calc(data, np.zeros(robot.n), np.zeros(robot.n))
    return np.asarray(data.S).reshape(6, -1)[:, -1]


def _scene_difference(recorded: Scene, own: Scene) -> str:
    """Return a sentence that names the pieces that differ."""
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


def _same(first: object, second: object) -> bool:
    """Whether two values agree, numbers up to rounding; infinities agree with infinities."""
    if isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        if first is None or second is None:
            return first is second
        a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
        return a.shape == b.shape and bool(np.allclose(a, b, rtol=0.0, atol=SAME))
    if isinstance(first, float | int) and isinstance(second, float | int):
        return bool(np.isclose(first, second, rtol=0.0, atol=SAME))
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(_same(a, b) for a, b in zip(first, second, strict=True))
    if is_dataclass(first) and type(first) is type(second):
        return all(_same(getattr(first, field.name), getattr(second, field.name)) for field in fields(first))
    return first == second
