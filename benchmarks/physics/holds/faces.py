"""Geometry of a planned hold: the normal of the rod at the object, and the friction with which one force would do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from costs.robot import RobotModel
from service.demands.hands import list_robot_hands
from service.verify import HandLoad, Motion, Phase

SAMPLES = 5  # of a phase with loads
WEIGHT = 1e3  # of the sums of barycentric coordinates against millimetres
MOST_FRICTION, FRICTION_STEP, DIRECTIONS = 3.0, 0.02, 72


@dataclass(frozen=True)
class Face:
    """Contact of a rod at one sample of a phase.

    Attributes:
        phase, tool, link: of the load.
        angle: between the normal into the object and the sum of the phase's loads [deg].
        friction: least coefficient with which one force at the contact turns the joint that moves and asks of no other
            joint more than its friction; inf where there is none below 3.
    """

    phase: str
    tool: str
    link: str
    angle: float
    friction: float


def list_faces(motion: Motion, frictions: dict[str, float]) -> Iterator[Face]:
    """Yield the contact of every tool in every phase with loads, at some samples.

    Args:
        motion: of the plan.
        frictions: of the mechanism's joints [N m, N].
    """
    robot = motion.robot
    data = robot.model.createData()
    for phase in motion.phases:
        for tool in dict.fromkeys(load.tool for load in phase.loads):
            own = [load for load in phase.loads if load.tool == tool]
            begin, end = motion.curve(np.array([phase.first, phase.last]))
            for s in np.linspace(phase.first, phase.last, SAMPLES):
                q = motion.curve(np.array([s]))[0]
                pin.forwardKinematics(robot.model, data, q)
                pin.updateFramePlacements(robot.model, data)
                found = _find_contact(robot, data, phase, tool)
                if found is None:
                    continue
                point, normal, link = found
                load = np.sum([_turn_load(robot, data, part) for part in own], axis=0)
                cosine = normal @ load / max(float(np.linalg.norm(load)), 1e-12)
                friction = _need_friction(robot, data, link, point, normal, end - begin, frictions)
                yield Face(phase.name, tool, link, float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))), friction)


def _turn_load(robot: RobotModel, data: pin.Data, load: HandLoad) -> Float[np.ndarray, "3"]:
    return np.asarray(data.oMf[robot.model.getFrameId(load.link)].rotation @ load.force)


def _find_contact(
    robot: RobotModel, data: pin.Data, phase: Phase, tool: str
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], str] | None:
    """Return point and unit normal of the rod's axis at the nearest body that it may touch, and the body's link."""
    model: pin.Model = robot.model
    hand = next((hand for hand in list_robot_hands(robot) if tool in (hand.peg, hand.tool, hand.stub)), None)
    if hand is None or not model.existFrame(hand.peg or hand.tool):
        return None
    ends = [data.oMf[model.getFrameId(name)].translation for name in (hand.stub, hand.tool) if model.existFrame(name)]
    allowed = {
        (ref.link, ref.body)
        for allowance in phase.allowances
        for ref in (allowance.first, allowance.second)
        if ref.owner == "mechanism"
    }
    best: tuple[float, np.ndarray, np.ndarray, str] | None = None
    for body in robot.bodies:
        if body.link not in robot.mechanism_links or not any(
            link in (None, body.link) and name in (None, body.name) for link, name in allowed
        ):
            continue
        pose = data.oMi[body.joint]
        vertices = body.vertices @ pose.rotation.T + pose.translation
        if tool == hand.tool:
            point = data.oMf[model.getFrameId(tool)].translation
            return (point, _find_face(vertices, point), body.link)
        on_rod, on_body = find_closest(np.array(ends), vertices)
        gap = float(np.linalg.norm(on_body - on_rod))
        if gap > 1e-6 and (best is None or gap < best[0]):
            best = (gap, on_body, (on_body - on_rod) / gap, body.link)
    return None if best is None else best[1:]


def _find_face(vertices: Float[np.ndarray, "V 3"], point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the unit normal into a hull of the face that is nearest to a point."""
    faces = ConvexHull(vertices).equations
    return np.asarray(-faces[np.abs(faces[:, :3] @ point + faces[:, 3]).argmin(), :3])


def find_closest(
    first: Float[np.ndarray, "V 3"], second: Float[np.ndarray, "W 3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the closest points of the hulls of two sets of points [m]."""
    middle = first.mean(axis=0)
    table = np.zeros((5, len(first) + len(second)))
    table[:3] = np.concatenate([first - middle, middle - second]).T
    table[3, : len(first)] = table[4, len(first) :] = WEIGHT
    weights, _ = nnls(table, np.array([0.0, 0.0, 0.0, WEIGHT, WEIGHT]))
    a, b = weights[: len(first)], weights[len(first) :]
    return a @ first / a.sum(), b @ second / b.sum()


def _need_friction(
    robot: RobotModel,
    data: pin.Data,
    link: str,
    point: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
    travel: Float[np.ndarray, "n"],
    frictions: dict[str, float],
) -> float:
    """Return the least tangential share of a force at the contact that moves the mechanism as planned."""
    model: pin.Model = robot.model
    rows: dict[str, np.ndarray] = {}
    joint = int(model.frames[model.getFrameId(link)].parentJoint)
    first = robot.n - sum(name in frictions for name in robot.joint_names)
    while joint > 0 and int(model.joints[joint].idx_q) >= first:
        motion = model.joints[joint].createData()
        model.joints[joint].calc(motion, np.zeros(model.nq), np.zeros(model.nv))
        axis = np.asarray(motion.S).reshape(6, -1)[:, -1]
        turn, origin = data.oMi[joint].rotation, data.oMi[joint].translation
        rows[model.names[joint]] = turn @ axis[:3] + np.cross(turn @ axis[3:], point - origin)
        joint = int(model.parents[joint])
    travels = {name: travel[robot.joint_names.index(name)] for name in rows}
    moving = max(travels, key=lambda name: abs(travels[name]))
    across = np.linalg.svd(normal[None])[2][1:]
    turns = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    sizes = np.arange(0.0, MOST_FRICTION + FRICTION_STEP, FRICTION_STEP)
    forces = normal + sizes[:, None, None] * (np.stack([np.cos(turns), np.sin(turns)], axis=1) @ across)
    work = np.sign(travels[moving]) * (forces @ rows[moving])
    size = np.where(work > 1e-6, frictions[moving] / np.maximum(work, 1e-6), np.inf)  # of the normal force
    holds = work > 1e-6
    for name, row in rows.items():
        if name != moving:
            with np.errstate(invalid="ignore"):
                holds &= size * np.abs(forces @ row) <= frictions[name] + 1e-9
    enough = sizes[holds.any(axis=1)]
    return float(enough[0]) if len(enough) else float("inf")
