"""Random whole-body problems that have a solution: boxes crowd around a motion that is certified among them.

A motion is drawn first: from a named posture through a random posture to another, feet planted and balanced, made
smooth in an empty scene.  Boxes are then thrown close to the robot along that motion, some in the way of the straight
line between its ends; those that leave the motion its room stay, and the verifier certifies the motion among them.
The planner gets only the goal of one palm, not the motion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.collision import PairMargins, SweptCollisionChecker
from costs.kinematics import Kinematics, locate_links
from costs.robot import RobotModel
from costs.robot.shapes import box
from costs.scene import ConvexPiece, Scene
from scopt import TrustRegionSQP
from service.body.aims import Aims
from service.body.paths import straight_path
from service.body.task_plan import PlannedPhase, TaskPlan
from service.body.whole_body import WholeBody
from service.demands.phase import TaskPhase
from service.motion.execute import make_motion
from service.motion.timing import TimingSettings
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.setup.prepare import prepare
from service.verify import Motion, PoseTarget, Status, verify

MARGIN, BALANCE_MARGIN = 0.02, 0.05  # options of the request [m]; the second leaves 16 x 30 cm between the feet
ROOM = 0.03  # clearance of the known motion from the boxes [m]
POSITION_TOLERANCE, ROTATION_TOLERANCE_DEG = 0.005, 2.0  # of the palm's goal [m]
LEAST_TRAVEL = 0.25  # of the palm from start to goal [m]
HALF = 10  # intervals of the known motion before and after its random posture
STRAY = 0.7  # of the reaching arm's joints from the middle between start and goal, standard deviation [rad]
SIZES = (0.05, 0.4)  # of a box's edges [m]
AWAY = (0.05, 0.45)  # of a box's centre from a point of the robot [m]
ACROSS = (0.0, 0.25)  # the same for a box that shall block the straight line [m]
IN_THE_WAY = 5  # number of boxes that block the straight line
THROWS = 150  # boxes drawn at a time
OPTIONS: Mapping[str, Any] = {"margin_m": MARGIN, "balance_margin_m": BALANCE_MARGIN, "time_limit_s": 60.0}
TIMING = TimingSettings(0.5, 0.3)  # the planner's own
SIDES = ("l", "r")
STARTS = ("reach_ready", "stand")


@dataclass(frozen=True)
class CrowdedScene:
    """A problem with a known solution.

    Attributes:
        name: encodes how it was drawn.
        request: for the planner.
        witness: a motion that solves it, certified.
        is_straight_enough: whether the straight line in the joints to the end of ``witness`` is certified too.
    """

    name: str
    request: PlanRequest
    witness: Motion
    is_straight_enough: bool


def crowded_scenes(robot: RobotModel, n_boxes: int, *, is_pose: bool, seed: int = 0) -> Iterator[CrowdedScene]:
    """Yield problems without end, the same for the same arguments.

    Args:
        robot: the bundled Atlas.
        n_boxes: of each scene.
        is_pose: whether the palm's orientation is a goal as well as its position.
        seed: of all draws.
    """
    rng = np.random.default_rng([seed, n_boxes, is_pose])
    drawn = 0
    while True:
        side, start = SIDES[rng.integers(2)], STARTS[rng.integers(2)]
        drawn += 1
        scene = _crowded(robot, f"{n_boxes}/{drawn}", rng, side, start, n_boxes, is_pose)
        if scene is not None:
            yield scene


def _crowded(
    robot: RobotModel, name: str, rng: np.random.Generator, side: str, start: str, n_boxes: int, is_pose: bool
) -> CrowdedScene | None:
    """Return a problem, or None if the draw failed."""
    palm = f"{side}_tool"
    body = _body(robot, _request(start, []), BALANCE_MARGIN + 0.01)
    path = _drawn_path(body, rng, side)
    if path is None:
        return None
    place = locate_links(body.engine, path[-1], [palm])[palm]
    if np.linalg.norm(place[:3, 3] - locate_links(body.engine, path[0], [palm])[palm][:3, 3]) < LEAST_TRAVEL:
        return None
    arm = {robot.model.getJointId(joint) for joint in robot.groups[arm_of(side)]}
    boxes = _boxes(body, rng, path, n_boxes, arm)
    if boxes is None:
        return None
    request = _request(start, boxes, _goal(palm, place, is_pose))
    crowded = _body(robot, request, BALANCE_MARGIN)
    witness = _motion(crowded, path, palm, place, is_pose)
    if verify(witness).status is not Status.CERTIFIED:
        return None
    direct = _motion(crowded, straight_path(path[0], path[-1], len(path)), palm, place, is_pose)
    return CrowdedScene(name, request, witness, verify(direct).status is Status.CERTIFIED)


def _request(start: str, boxes: list[dict[str, Any]], goal: Mapping[str, Any] | None = None) -> PlanRequest:
    return parse_request({
        "robot": {"name": "atlas"},
        "start": {"posture": start},
        "scene": {"floor": True, "obstacles": boxes},
        "goal": goal or {"posture": start},
        "options": dict(OPTIONS),
    })  # fmt: skip


def _goal(palm: str, place: Float[np.ndarray, "4 4"], is_pose: bool) -> Mapping[str, Any]:
    goal = {"link": palm, "position": place[:3, 3].tolist(), "position_tolerance_m": POSITION_TOLERANCE}
    if is_pose:
        goal["quaternion_wxyz"] = Rotation.from_matrix(place[:3, :3]).as_quat(scalar_first=True).tolist()
        goal["rotation_tolerance_deg"] = ROTATION_TOLERANCE_DEG
    return {"poses": [goal]}


def _body(robot: RobotModel, request: PlanRequest, balance_margin: float) -> WholeBody:
    """Return the body of a request's robot on its feet."""
    setup = prepare(request, robot=robot)
    return WholeBody.standing(robot, setup.scene, setup.start, setup.contacts, Aims(MARGIN, balance_margin))


def _drawn_path(body: WholeBody, rng: np.random.Generator, side: str) -> Float[np.ndarray, "T n"] | None:
    """Draw a motion without obstacles to a random posture through another one; None if none is found."""
    start = body.nominal
    goal = standing_near(body, random_posture(body, rng, side))
    if goal is None:
        return None
    between = 0.5 * (start + goal)
    arm = [body.robot.joint_names.index(joint) for joint in body.robot.groups[arm_of(side)]]
    between[arm] += rng.normal(0.0, STRAY, len(arm))
    middle = standing_near(body, np.clip(between, body.robot.lower, body.robot.upper))
    if middle is None:
        return None
    lower, upper = body.bounds(2 * HALF + 1, {0: start, HALF: middle, 2 * HALF: goal})
    problem = body.make_problem(lower, upper, body.make_checker(ends=[start, middle, goal]))
    first = np.concatenate([straight_path(start, middle, HALF + 1)[:-1], straight_path(middle, goal, HALF + 1)])
    result = TrustRegionSQP().solve(problem, first)
    return result.x if result.is_feasible else None


def random_posture(body: WholeBody, rng: np.random.Generator, side: str) -> Float[np.ndarray, "n"]:
    """Return the start with one arm, back and knees bent at random; the feet are not yet on the ground."""
    robot, q = body.robot, body.nominal.copy()
    shoulder_and_elbow, wrist = robot.groups[arm_of(side)][:4], robot.groups[arm_of(side)][4:]
    for joints, share in ((shoulder_and_elbow, 0.8), (wrist, 0.3), (robot.groups["back"], 0.5)):
        for joint in joints:
            i = robot.joint_names.index(joint)
            middle, half = 0.5 * (robot.lower[i] + robot.upper[i]), 0.5 * share * (robot.upper[i] - robot.lower[i])
            q[i] = middle + half * rng.uniform(-1.0, 1.0)
    bend = rng.uniform(-0.2, 0.6)
    for leg in SIDES:
        for joint, part in (("hpy", -0.5), ("kny", 1.0), ("aky", -0.5)):
            q[robot.joint_names.index(f"{leg}_leg_{joint}")] += part * bend
    return q


def standing_near(body: WholeBody, q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"] | None:
    """Return a posture near ``q`` with planted feet, balanced and free of self-collision; None if none is found."""
    lower, upper = body.bounds(1, {})
    checker = body.make_checker(ends=[body.nominal])
    result = TrustRegionSQP().solve(replace(body, nominal=q).make_problem(lower, upper, checker), q[None])
    return result.x[0] if result.is_feasible else None


def _motion(
    body: WholeBody, path: Float[np.ndarray, "T n"], palm: str, place: Float[np.ndarray, "4 4"], is_pose: bool
) -> Motion:
    """Return the timed curve through the waypoints as a reach of the goal, for the verifier."""
    rotation = place[:3, :3] if is_pose else None
    turn = np.full(3, np.deg2rad(ROTATION_TOLERANCE_DEG))
    goal = (PoseTarget(palm, place[:3, 3], rotation, np.full(3, POSITION_TOLERANCE), turn),)
    return make_motion(TaskPlan(body, (PlannedPhase(TaskPhase("reach", goal=goal), path, True),)), TIMING)


def _boxes(
    body: WholeBody, rng: np.random.Generator, path: Float[np.ndarray, "T n"], n_boxes: int, arm: Collection[int]
) -> list[dict[str, Any]] | None:
    """Return boxes close to the robot that do not block a motion, as obstacles of a request.

    Some are in the way of the straight line between the motion's ends; None where too few such
    boxes are found.

    Args:
        body: the robot.
        rng: of the draws.
        path: waypoints of the motion that stays clear.
        n_boxes: how many.
        arm: joints of the reaching arm.
    """
    known, direct = body.engine(path), body.engine(straight_path(path[0], path[-1], len(path)))
    everywhere = list(range(len(body.robot.bodies)))
    moving = [b for b in everywhere if body.robot.bodies[b].joint in arm]
    thrown = [thrown_box(body, rng, direct, moving, ACROSS) for _ in range(THROWS)]
    hits = boxes_near(body, thrown, direct, 0.0) - boxes_near(body, thrown, known, ROOM)
    if len(hits) < IN_THE_WAY:
        return None
    kept = [thrown[k] for k in sorted(hits)[:IN_THE_WAY]]
    while len(kept) < n_boxes:
        thrown = [thrown_box(body, rng, known, everywhere, AWAY) for _ in range(THROWS)]
        near = boxes_near(body, thrown, known, ROOM)
        kept += [one for k, one in enumerate(thrown) if k not in near]
    return [{"name": f"box{k}", "type": "box", **one} for k, one in enumerate(kept[:n_boxes])]


def boxes_near(body: WholeBody, boxes: Sequence[Mapping[str, Any]], sweep: Kinematics, room: float) -> set[int]:
    """Return which boxes come nearer to the robot than ``room`` along the path [m]."""
    scene = Scene(tuple(_piece(k, one) for k, one in enumerate(boxes)))
    contacts = SweptCollisionChecker(body.robot, scene, PairMargins.of(body.robot, scene, 0.0), buffer=room)(sweep)
    return set(contacts.other[~contacts.is_self].tolist())


def thrown_box(
    body: WholeBody, rng: np.random.Generator, sweep: Kinematics, bodies: Sequence[int], away: tuple[float, float]
) -> dict[str, Any]:
    """Return a box near a random point of a random body of the robot somewhere along the path."""
    waypoint = int(rng.integers(len(sweep.q)))
    part = body.robot.bodies[bodies[int(rng.integers(len(bodies)))]]
    local = part.vertices[rng.integers(len(part.vertices))]
    point = sweep.rotation[waypoint, part.joint] @ local + sweep.position[waypoint, part.joint]
    direction = rng.normal(size=3)
    centre = point + rng.uniform(*away) * direction / np.linalg.norm(direction)
    quaternion = rng.normal(size=4)
    return {
        "size": rng.uniform(*SIZES, 3).tolist(),
        "position": centre.tolist(),
        "quaternion_wxyz": (quaternion / np.linalg.norm(quaternion)).tolist(),
    }


def _piece(number: int, thrown: Mapping[str, Any]) -> ConvexPiece:
    turn = Rotation.from_quat(thrown["quaternion_wxyz"], scalar_first=True).as_matrix()
    return ConvexPiece(f"box{number}", box(np.array(thrown["size"])) @ turn.T + np.array(thrown["position"]))


def arm_of(side: str) -> str:
    return {"l": "left_arm", "r": "right_arm"}[side]
