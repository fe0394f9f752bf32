"""Random two-handed problems that have a solution: boxes crowd around a motion that is certified among them.

As in ``crowded_scenes``, a motion is drawn first and boxes are thrown around it.  Either both palms have a goal of
their own, or they grip something: a random relative pose that holds from the start to the goal of one palm, which the
other follows; with a beam in this grip, or without.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from benchmarks.planning.crowded_scenes import (
    ACROSS,
    AWAY,
    BALANCE_MARGIN,
    HALF,
    IN_THE_WAY,
    LEAST_TRAVEL,
    MARGIN,
    OPTIONS,
    POSITION_TOLERANCE,
    ROOM,
    ROTATION_TOLERANCE_DEG,
    SIDES,
    STRAY,
    THROWS,
    TIMING,
    CrowdedScene,
    arm_of,
    boxes_near,
    random_posture,
    standing_near,
    thrown_box,
)
from costs.kinematics import locate_links
from costs.robot import RobotModel
from costs.terms import FramePose
from scopt import Constraint, Sense, Settings, TrustRegionSQP
from service.body.aims import Aims
from service.body.holds import KeptPose, relative_pose
from service.body.paths import straight_path
from service.body.task_plan import PlannedPhase, TaskPlan
from service.body.whole_body import WholeBody
from service.demands.phase import TaskPhase
from service.errors import RequestError
from service.motion.execute import make_motion
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.result.motion_json import file_columns, file_positions
from service.setup.prepare import prepare
from service.verify import Motion, PoseTarget, Status, verify

Task = Literal["places", "poses", "grip", "beam"]
TASKS: tuple[Task, ...] = get_args(Task)
GRIPPING: frozenset[Task] = frozenset({"grip", "beam"})
START = "reach_ready"
PALMS = ("l_tool", "r_tool")
BEAM_LENGTHS = (0.3, 0.8)  # between the palms [m]
BEAM_TURN = 0.4  # of the palms against each other and of the beam on its way, standard deviation about each axis [rad]
BEAM_TRAVEL, BEAM_DETOUR = (0.25, 0.6), (0.25, 0.5)  # from start to goal, and from the middle between them [m]
MOST_BATCHES = 4  # of drawn boxes, to find boxes that block the straight line
BEAM_WIDTH, BEAM_OVERHANG, BEAM_MASS_KG = 0.04, 0.3, 3.0  # [m, m, kg]
LARGEST_STEP = 0.6  # of a joint between waypoints; a longer step changes how the beam is held [rad]


def two_handed_scenes(robot: RobotModel, n_boxes: int, task: Task, seed: int = 0) -> Iterator[CrowdedScene]:
    """Yield problems without end, the same for the same arguments.

    Args:
        robot: the bundled Atlas.
        n_boxes: of each scene.
        task: ``places`` or ``poses`` for both palms, or a ``grip`` or a ``beam`` carried to the place of one.
        seed: of all draws.
    """
    rng = np.random.default_rng([seed, n_boxes, TASKS.index(task)])
    drawn = 0
    while True:
        drawn += 1
        scene = _scene(robot, f"{task} {n_boxes}/{drawn}", rng, n_boxes, task)
        if scene is not None:
            yield scene


def _scene(robot: RobotModel, name: str, rng: np.random.Generator, n_boxes: int, task: Task) -> CrowdedScene | None:
    """Return a problem, or None if the draw failed."""
    body = _body(robot, _request(robot, robot.postures[START]))
    if task in GRIPPING:
        grasp = _grasped(body, rng, task)
        if grasp is None:
            return None
        body = grasp
    path = _drawn_path(body, rng)
    if path is None:
        return None
    first, last = (locate_links(body.engine, q, PALMS) for q in (path[0], path[-1]))
    if min(np.linalg.norm(last[palm][:3, 3] - first[palm][:3, 3]) for palm in PALMS) < LEAST_TRAVEL:
        return None
    boxes = _boxes(body, rng, path, n_boxes)
    if boxes is None:
        return None
    goals = {PALMS[rng.integers(2)]: False} if task in GRIPPING else dict.fromkeys(PALMS, task == "poses")
    asked = [_goal(palm, last[palm], is_pose) for palm, is_pose in goals.items()]
    request = _request(robot, path[0], boxes, asked, task)
    crowded = _body(robot, request, BALANCE_MARGIN)
    targets = tuple(_target(palm, last[palm], is_pose) for palm, is_pose in goals.items())
    witness = _motion(crowded, path, targets)
    if verify(witness).status is not Status.CERTIFIED:
        return None
    direct = _motion(crowded, straight_path(path[0], path[-1], len(path)), targets)
    return CrowdedScene(name, request, witness, verify(direct).status is Status.CERTIFIED)


def _request(
    robot: RobotModel,
    start: Float[np.ndarray, "n"],
    boxes: list[dict[str, Any]] | None = None,
    poses: list[dict[str, Any]] | None = None,
    task: Task = "places",
) -> PlanRequest:
    columns, (values,) = file_columns(robot), file_positions(robot, start[None]).tolist()
    return parse_request(
        {
            "robot": {"name": "atlas"},
            "start": {
                "base": {"position": values[:3], "quaternion_wxyz": values[3:7]},
                "joints": dict(zip(columns[7:], values[7:], strict=True)),
            },
            "scene": {"floor": True, "obstacles": boxes or []},
            "goal": {"poses": poses} if poses else {"posture": START},
            "keep": [{"link": PALMS[1], "relative_to": PALMS[0]}] if task in GRIPPING else [],
            "attached": [_beam(robot, start)] if task == "beam" else [],
            "options": dict(OPTIONS),
        }
    )


def _beam(robot: RobotModel, start: Float[np.ndarray, "n"]) -> dict[str, Any]:
    """Return a beam through both palms."""
    across = relative_pose(robot, start, PALMS[1], PALMS[0])[:3, 3]
    length = float(np.linalg.norm(across))
    turn, _ = Rotation.align_vectors(across[None] / length, [[0.0, 1.0, 0.0]])
    return {
        "name": "beam",
        "link": PALMS[0],
        "type": "box",
        "size": [BEAM_WIDTH, length + BEAM_OVERHANG, BEAM_WIDTH],
        "position": (0.5 * across).tolist(),
        "quaternion_wxyz": turn.as_quat(scalar_first=True).tolist(),
        "touches": ["r_hand", "r_hook"],
        "mass_kg": BEAM_MASS_KG,
    }


def _goal(palm: str, place: Float[np.ndarray, "4 4"], is_pose: bool) -> dict[str, Any]:
    goal = {"link": palm, "position": place[:3, 3].tolist(), "position_tolerance_m": POSITION_TOLERANCE}
    if is_pose:
        goal["quaternion_wxyz"] = Rotation.from_matrix(place[:3, :3]).as_quat(scalar_first=True).tolist()
        goal["rotation_tolerance_deg"] = ROTATION_TOLERANCE_DEG
    return goal


def _target(palm: str, place: Float[np.ndarray, "4 4"], is_pose: bool) -> PoseTarget:
    turn = np.full(3, np.deg2rad(ROTATION_TOLERANCE_DEG))
    rotation = place[:3, :3] if is_pose else None
    return PoseTarget(palm, place[:3, 3], rotation, np.full(3, POSITION_TOLERANCE), turn)


def _body(robot: RobotModel, request: PlanRequest, balance_margin: float = BALANCE_MARGIN + 0.01) -> WholeBody:
    """Return the body of a request's robot on its feet, with its kept poses."""
    setup = prepare(request, robot=robot)
    body = WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, Aims(MARGIN, balance_margin))
    return replace(body, kept=setup.kept)


def _grasped(body: WholeBody, rng: np.random.Generator, task: Task) -> WholeBody | None:
    """Return the robot with a random kept pose between its palms; None if it cannot stand so."""
    wanted = relative_pose(body.robot, body.nominal, PALMS[1], PALMS[0])
    apart = wanted[:3, 3] / np.linalg.norm(wanted[:3, 3])
    wanted[:3, 3] = rng.uniform(*BEAM_LENGTHS) * apart
    wanted[:3, :3] = wanted[:3, :3] @ Rotation.from_rotvec(rng.normal(0.0, BEAM_TURN, 3)).as_matrix()
    grasp = KeptPose(PALMS[1], PALMS[0], wanted, wanted, 0.005, float(np.deg2rad(1.0)))
    start = standing_near(replace(body, kept=(grasp,)), body.nominal)
    if start is None:
        return None
    try:
        return _body(body.robot, _request(body.robot, start, task=task))
    except RequestError:  # the beam overlaps the robot
        return None


def _drawn_path(body: WholeBody, rng: np.random.Generator) -> Float[np.ndarray, "T n"] | None:
    """Draw a motion without obstacles to a random posture through another one; None if none is found."""
    start = body.nominal
    goal = _carrying(body, start, rng, BEAM_TRAVEL) if body.kept else _both_arms_moved(body, rng)
    if goal is None:
        return None
    between = 0.5 * (start + goal)
    middle = _carrying(body, between, rng, BEAM_DETOUR) if body.kept else _strayed(body, between, rng)
    if middle is None:
        return None
    lower, upper = body.bounds(2 * HALF + 1, {0: start, HALF: middle, 2 * HALF: goal})
    problem = body.make_problem(lower, upper, body.make_checker(ends=[start, middle, goal]))
    first = np.concatenate([straight_path(start, middle, HALF + 1)[:-1], straight_path(middle, goal, HALF + 1)])
    result = TrustRegionSQP().solve(problem, first)
    is_one_way = np.abs(np.diff(result.x, axis=0)).max() < LARGEST_STEP
    return result.x if result.is_feasible and is_one_way else None


def _both_arms_moved(body: WholeBody, rng: np.random.Generator) -> Float[np.ndarray, "n"] | None:
    """Return a posture near the start with arms, back and knees bent at random; None if none is found."""
    one = replace(body, nominal=random_posture(body, rng, SIDES[0]))
    return standing_near(body, random_posture(one, rng, SIDES[1]))


def _strayed(body: WholeBody, q: Float[np.ndarray, "n"], rng: np.random.Generator) -> Float[np.ndarray, "n"] | None:
    """Return a posture near ``q`` with both arms moved; None if none is found."""
    robot, q = body.robot, q.copy()
    arms = [robot.joint_names.index(joint) for side in SIDES for joint in robot.groups[arm_of(side)]]
    q[arms] += rng.normal(0.0, STRAY, len(arms))
    return standing_near(body, np.clip(q, robot.lower, robot.upper))


def _carrying(
    body: WholeBody, q: Float[np.ndarray, "n"], rng: np.random.Generator, travel: tuple[float, float]
) -> Float[np.ndarray, "n"] | None:
    """Return a posture near ``q`` with the beam moved and turned at random; None if none is found."""
    place = locate_links(body.engine, q, PALMS)[PALMS[0]]
    step = rng.normal(size=3)
    place[:3, 3] += rng.uniform(*travel) * step / np.linalg.norm(step)
    place[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, BEAM_TURN, 3)).as_matrix() @ place[:3, :3]
    lower, upper = body.bounds(1, {})
    there = FramePose(body.robot, PALMS[0], [0], place)
    problem = replace(body, nominal=q).make_problem(
        lower,
        upper,
        body.make_checker(ends=[body.nominal]),
        constraints=[Constraint("beam", there, Sense.EQUAL_ZERO, tolerance=1e-3)],
    )
    result = TrustRegionSQP(Settings(max_iterations=40, max_penalty_raises=3)).solve(problem, q[None])
    return result.x[0] if result.is_feasible else None


def _boxes(
    body: WholeBody, rng: np.random.Generator, path: Float[np.ndarray, "T n"], n_boxes: int
) -> list[dict[str, Any]] | None:
    """Return boxes close to the robot that do not block a motion; some block the straight line of the hands.

    None if too few of the latter are found.
    """
    robot = body.robot
    known, direct = body.engine(path), body.engine(straight_path(path[0], path[-1], len(path)))
    hands = {robot.model.getJointId(joint) for side in SIDES for joint in robot.groups[arm_of(side)][-3:]}
    outer = [index for index, one in enumerate(robot.bodies) if one.joint in hands]
    kept: list[dict[str, Any]] = []
    for _ in range(MOST_BATCHES):
        thrown = [thrown_box(body, rng, direct, outer, ACROSS) for _ in range(THROWS)]
        kept += [
            thrown[k] for k in sorted(boxes_near(body, thrown, direct, 0.0) - boxes_near(body, thrown, known, ROOM))
        ]
        if len(kept) >= IN_THE_WAY:
            break
    else:
        return None
    kept = kept[:IN_THE_WAY]
    while len(kept) < n_boxes:
        thrown = [thrown_box(body, rng, known, range(len(robot.bodies)), AWAY) for _ in range(THROWS)]
        near = boxes_near(body, thrown, known, ROOM)
        kept += [one for k, one in enumerate(thrown) if k not in near]
    return [{"name": f"box{k}", "type": "box", **one} for k, one in enumerate(kept[:n_boxes])]


def _motion(body: WholeBody, path: Float[np.ndarray, "T n"], targets: tuple[PoseTarget, ...]) -> Motion:
    """Return the timed curve through the waypoints as a reach of the goals, for the verifier."""
    phase = PlannedPhase(TaskPhase("reach", goal=targets), path, True)
    return make_motion(TaskPlan(body, (phase,)), TIMING)
