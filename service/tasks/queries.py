"""Questions about one robot in one scene: inverse kinematics, clearance of a pose, and clearance along a line."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from costs.curve import Curve
from costs.robot import RobotModel
from costs.scene import ConvexPiece, Scene
from scopt import Settings
from service.body.aims import Aims
from service.body.monitor import Interrupted, Monitor
from service.body.phases import PhaseSolver
from service.body.whole_body import WholeBody
from service.demands import list_planted_feet
from service.errors import RequestError, would_do
from service.request.tasks.reach import GoalRequest, PoseGoalRequest
from service.start.configuration import STANDING_POSTURE
from service.tasks.reach.goal import Goal
from service.tasks.reach.goal_poses import GoalEnds
from service.verify import Basis, DistanceQuery, Motion, PreparedMotion, VerifySettings, collect_pairs, verify

HORIZON_M = 0.1
IK_EFFORT_S = 5.0


@dataclass(frozen=True)
class PoseClearance:
    """Smallest distance at one configuration.

    Attributes:
        distance_m: signed; negative where a pair overlaps [m]. ``horizon_m`` or more where nothing is near.
        pair: links, or link and piece; None where nothing is nearer than the horizon.
    """

    distance_m: float
    pair: tuple[str, str] | None


@dataclass(frozen=True)
class SweepClearance:
    """Proven clearance along a straight line in joint space.

    Attributes:
        lower_m: no pair comes nearer than this anywhere on the line [m]; negative after a collision.
        pair: the pair that limits it; None beyond the horizon of 0.1 m.
        is_clear: whether the whole line is proven to be free of collisions.
        at: where it collides, as a share of the line; None where it does not.
    """

    lower_m: float
    pair: tuple[str, str] | None
    is_clear: bool
    at: float | None


@dataclass(frozen=True)
class IkSolution:
    """A configuration at a goal.

    Attributes:
        q: (n,) in the order of ``robot.joint_names`` [rad, m].
        clearance: at that configuration.
    """

    q: Float[np.ndarray, "n"]
    clearance: PoseClearance


def clearance(
    robot: RobotModel, q: ArrayLike, scene: Scene | Sequence[ConvexPiece] = (), horizon_m: float = HORIZON_M
) -> PoseClearance:
    """Return the smallest distance between the robot's links, and to the pieces of a scene, at one configuration.

    Pairs that the robot's SRDF, or sampling, leaves out are not looked at; bodies count as their convex hulls.

    Args:
        robot: as ``costs.robot.load_robot`` reads it.
        q: (n,) in the order of ``robot.joint_names`` [rad, m].
        scene: obstacles.
        horizon_m: pairs beyond it are not measured [m].

    Raises:
        RequestError: ``q`` is not n finite numbers.
    """
    pose = _check_configuration(robot, q, "q")
    motion = _make_line(robot, pose, pose, scene)
    prepared = PreparedMotion(motion)
    table = collect_pairs(motion, prepared.tree)
    placed, rows = prepared.at(np.zeros(1))
    spheres = [solid.sphere for solid in table.solids]
    centres = np.array(
        [
            placed.rotation[rows[0], solid.joint] @ centre + placed.translation[rows[0], solid.joint]
            for solid, (centre, _) in zip(table.solids, spheres, strict=True)
        ]
    )
    radii = np.array([radius for _, radius in spheres])
    least = np.linalg.norm(centres[table.mover] - centres[table.holder], axis=1)
    least -= radii[table.mover] + radii[table.holder]
    query, nearest, pair = DistanceQuery(), float(horizon_m), None
    for row in np.argsort(least, kind="stable").tolist():
        if least[row] >= nearest:
            break
        mover, holder = table.solids[table.mover[row]], table.solids[table.holder[row]]
        distances, _ = query.closest([mover.convex], *placed.relative(holder.joint, mover.joint, rows), [holder.convex])
        if float(distances[0]) < nearest:
            nearest, pair = float(distances[0]), table.names(row)
    return PoseClearance(nearest, pair)


def sweep_clearance(
    robot: RobotModel, first: ArrayLike, last: ArrayLike, scene: Scene | Sequence[ConvexPiece] = ()
) -> SweepClearance:
    """Bound the clearance along the straight line between two configurations, by the verifier's proof.

    Args:
        robot: as ``costs.robot.load_robot`` reads it.
        first, last: (n,) ends of the line in joint space [rad, m].
        scene: obstacles.

    Raises:
        RequestError: an end is not n finite numbers.
    """
    ends = _check_configuration(robot, first, "first"), _check_configuration(robot, last, "last")
    if np.array_equal(*ends):
        pose = clearance(robot, ends[0], scene)
        is_clear = pose.distance_m >= 0.0
        return SweepClearance(pose.distance_m, pose.pair, is_clear, None if is_clear else 0.0)
    certificate = verify(_make_line(robot, *ends, scene), VerifySettings(clearance_horizon_m=HORIZON_M))
    hits = [check for check in certificate.failed() if check.name == "clearance"]
    is_open = any(check.name == "clearance" and check.basis is Basis.UNPROVEN for check in certificate.checks)
    where = None if not hits else hits[0].where
    return SweepClearance(
        certificate.min_clearance_m,
        certificate.min_clearance_pair if where is None else (where.names[0], where.names[1]),
        not hits and not is_open,
        None if where is None else where.s,
    )


def solve_ik(
    robot: RobotModel,
    poses: Sequence[PoseGoalRequest],
    scene: Scene | Sequence[ConvexPiece] = (),
    nominal: ArrayLike | None = None,
    *,
    margin_m: float = 0.0,
    count: int = 1,
    time_limit_s: float | None = None,
    seed: int = 0,
) -> tuple[IkSolution, ...]:
    """Return configurations at which links have poses, within joint limits and free of collisions.

    A floating base stands on its feet as at ``nominal`` and keeps its balance.

    Args:
        robot: as ``costs.robot.load_robot`` reads it.
        poses: of links or frames, each as in ``goal.poses`` of a request.
        scene: obstacles.
        nominal: (n,) configuration to stay near; by default the posture ``stand``, or zero within the limits.
        margin_m: clearance that is aimed at [m].
        count: largest number of different configurations.
        time_limit_s: wall time; by default ``IK_EFFORT_S`` of processor time.
        seed: of the random guesses.

    Returns:
        At most ``count`` configurations, the nearest to ``nominal`` first; none where none was found.

    Raises:
        RequestError: an unknown link, or a configuration of a wrong length.
    """
    goal_request = GoalRequest(poses=tuple(poses))
    frames = [frame.name for frame in robot.model.frames if frame.name != "universe"]
    for pose in goal_request.poses:
        if pose.link not in frames:
            raise RequestError(f"unknown link {pose.link!r}; {robot.name} has {would_do(pose.link, frames)}")
    start = _choose_nominal(robot) if nominal is None else _check_configuration(robot, nominal, "nominal")
    feet = list_planted_feet(robot, None)
    body = WholeBody.standing(robot, _as_scene(scene), start, feet, Aims(margin_m))
    monitor = Monitor(IK_EFFORT_S) if time_limit_s is None else Monitor(time_limit_s, clock=time.monotonic)
    solver = PhaseSolver(body, monitor, Settings(), seed=seed)
    found: list[np.ndarray] = []
    try:
        for solved in GoalEnds(solver, Goal.of(body, goal_request)).find_all():
            if clearance(robot, solved, scene).distance_m > 0.0 or feet:
                found.append(solved)
            if len(found) >= count:
                break
    except Interrupted:
        pass
    found.sort(key=lambda q: float(np.abs(q - start).max()))
    return tuple(IkSolution(q, clearance(robot, q, scene)) for q in found)


def _check_configuration(robot: RobotModel, q: ArrayLike, name: str) -> Float[np.ndarray, "n"]:
    values = np.asarray(q, dtype=float)
    if values.shape != (robot.n,) or not np.all(np.isfinite(values)):
        raise RequestError(f"{name} must be {robot.n} finite numbers ({robot.name}), got the shape {values.shape}")
    return values


def _choose_nominal(robot: RobotModel) -> Float[np.ndarray, "n"]:
    if STANDING_POSTURE in robot.postures:
        return np.array(robot.postures[STANDING_POSTURE])
    return np.clip(np.zeros(robot.n), robot.lower, robot.upper)


def _as_scene(scene: Scene | Sequence[ConvexPiece]) -> Scene:
    return scene if isinstance(scene, Scene) else Scene(tuple(scene))


def _make_line(
    robot: RobotModel,
    first: Float[np.ndarray, "n"],
    last: Float[np.ndarray, "n"],
    scene: Scene | Sequence[ConvexPiece],
) -> Motion:
    slope = last - first
    curve = Curve(np.array([0.0, 1.0]), np.stack([first, last]), np.stack([slope, slope]))
    return Motion(robot, _as_scene(scene), curve)
