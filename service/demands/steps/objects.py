"""Steps that take objects, let go of them, and bring them into holes or out of them, as phases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.allowance import Allowance, BodyRef
from costs.guide import Guide
from costs.robot.carried import MovableObject
from costs.rotation import pose_matrix
from service.demands.grasping.grasps import Grasp
from service.demands.grasping.gripper import Gripper
from service.demands.steps.holding import GRASP_M, GRASP_RAD, Holding, Item, list_pad_touches
from service.demands.steps.phases import Led, PhaseMaker, StepPhase
from service.demands.targets import make_pose_goal
from service.request.tasks.reach import GoalRequest
from service.request.tasks.step_objects import FitStep, GraspStep, ReleaseStep
from service.request.tasks.steps import StepRequest
from service.verify import WORLD, HandLoad, HoleTarget, RelativePoseTarget, Target, place_frames

REACH, ENTER, CLOSE, OPEN, LEAVE = "reach", "enter", "close", "open", "leave"
BEFORE_M, BEFORE_DEG = 1e-4, 0.1  # of a tool before an object
FIT_DEPTH_M = 5e-4  # of an object in the walls of its hole, beyond its play


@dataclass(frozen=True, eq=False)
class Taking:
    """Hands that take an object.

    Attributes:
        grippers: the leading one first.
        grasps: how they take it, as the planner has chosen; None for a record, which shows it.
    """

    grippers: tuple[Gripper, ...]
    grasps: tuple[Grasp, ...] | None = None


def list_grasp(holding: Holding, step: GraspStep, name: str, taking: Taking) -> Iterator[PhaseMaker]:
    """Yield the phases of taking an object: to before it, on a line to it, and the fingers' closing.

    Nobody but the planner demands which grasp it is; the grip and the object's rest are what the certificate proves.
    """
    item, tools = holding.items[step.object], [gripper.tool for gripper in taking.grippers]
    grasps = taking.grasps or ()

    def reach(q: Float[np.ndarray, "n"]) -> StepPhase:
        pose = holding.locate(step.object, q)
        goals, fingers = [], dict[str, float]()
        for grasp in grasps:
            tool = pose @ grasp.pose_object_tool
            tool[:3, 3] -= step.approach_m * tool[:3, 2]
            goals.append(make_pose_goal(grasp.gripper.tool, tool, BEFORE_M, BEFORE_DEG))
            fingers |= grasp.opened
        goal = GoalRequest(poses=tuple(goals)) if goals else None
        return StepPhase(f"{name}: {REACH}", goal=goal, fingers=fingers, is_chosen=True)

    def enter(q: Float[np.ndarray, "n"]) -> StepPhase:
        return StepPhase(f"{name}: {ENTER}", _lead_along(holding, tools, step.approach_m, q), locked=_fingers(taking))

    def close(q: Float[np.ndarray, "n"]) -> StepPhase:
        names = holding.robot.joint_names
        fingers = {joint: float(q[names.index(joint)]) for joint in _fingers(taking)}  # where a record shows how far
        fingers |= {joint: value for grasp in grasps for joint, value in grasp.closed.items()}
        touches = tuple(list_pad_touches(step.object, taking.grippers))
        targets = tuple(_hold_grasps(holding, item, step, tools, q))
        return StepPhase(f"{name}: {CLOSE}", straight=fingers, touches=touches, targets=targets, is_chosen=True)

    for part, make in ((REACH, reach), (ENTER, enter), (CLOSE, close)):
        yield PhaseMaker(f"{name}: {part}", make)


def list_release(holding: Holding, step: ReleaseStep, name: str, grippers: tuple[Gripper, ...]) -> Iterator[PhaseMaker]:
    """Yield the phases of letting go of an object: the fingers' opening, and the line on which the hands go.

    Args:
        holding: with the object carried by the world already.
        grippers: that have held it.
    """
    tools = [gripper.tool for gripper in grippers]

    def open_fingers(q: Float[np.ndarray, "n"]) -> StepPhase:
        values: dict[str, float] = {}
        for gripper in grippers:
            for joint, most in zip(gripper.joints, gripper.most, strict=True):
                values[joint] = min(float(q[holding.robot.joint_names.index(joint)]) + step.opening_m, most)
        touches = tuple(list_pad_touches(step.object, grippers))
        return StepPhase(f"{name}: {OPEN}", straight=values, touches=touches, is_chosen=True)

    def leave(q: Float[np.ndarray, "n"]) -> StepPhase:
        fingers = _fingers(Taking(grippers))
        return StepPhase(f"{name}: {LEAVE}", _lead_along(holding, tools, -step.retreat_m, q), locked=fingers)

    yield PhaseMaker(f"{name}: {OPEN}", open_fingers)
    yield PhaseMaker(f"{name}: {LEAVE}", leave)


def _fingers(taking: Taking) -> tuple[str, ...]:
    return tuple(dict.fromkeys(joint for gripper in taking.grippers for joint in gripper.joints))


def _lead_along(holding: Holding, tools: list[str], way_m: float, q: Float[np.ndarray, "n"]) -> tuple[Led, ...]:
    """Return tools on lines along their own axes."""
    poses = place_frames(holding.robot, q, tools)
    return tuple(Led(t, Guide.line(poses[t][:3, 3], poses[t][:3, :3], way_m * poses[t][:3, 2])) for t in tools)


def _hold_grasps(
    holding: Holding, item: Item, step: GraspStep, tools: list[str], q: Float[np.ndarray, "n"]
) -> Iterator[RelativePoseTarget]:
    """Yield the promises that tools are at grasps that the request gives, the nearest to where they are."""
    given = [pose_matrix(grasp.position, grasp.quaternion_wxyz) for grasp in item.given.grasps]
    if step.grasp is not None:
        given = given[step.grasp : step.grasp + 1]
    if not given:
        return
    poses, back = place_frames(holding.robot, q, tools), np.linalg.inv(holding.locate(step.object, q))
    for tool in tools:
        own = back @ poses[tool]
        pose = min(given, key=lambda each: float(np.abs(each - own).max()))
        yield RelativePoseTarget(tool, item.name, pose[:3, 3], pose[:3, :3], GRASP_M, GRASP_RAD)


def make_fit(holding: Holding, given: StepRequest, name: str, q: Float[np.ndarray, "n"]) -> StepPhase:
    """Return the straight way of an object into a hole or out of it, from where it is beside the hole's axis.

    The object's own axis that is nearest to the hole's is brought along it, its origin onto it.
    """
    step = given.fit
    assert step is not None
    pose, item = holding.locate(step.object, q), holding.items[step.object].body
    fit = Fit.of(step, item, pose)
    begin = pose.copy()
    begin[:3, :3] = fit.turn @ pose[:3, :3]
    begin[:3, 3] -= fit.off
    led = Led(step.object, Guide.line(begin[:3, 3], begin[:3, :3], step.depth_m * fit.axis), speed_m_s=step.speed_m_s)
    depth = step.chamfer_m + 0.5 * step.clearance_m + FIT_DEPTH_M
    touches = tuple(Allowance(BodyRef.of_link(step.object), BodyRef.of_piece(piece), depth) for piece in step.pieces)
    loads: tuple[HandLoad, ...] = ()
    if step.force_n:
        half = 0.5 * led.guide.shift
        push = step.force_n * fit.axis
        loads = (HandLoad(step.object, WORLD, led.guide.position + half, push, half, led.tolerance_m),)
    targets: tuple[Target, ...] = (fit.make_target(step.object, led.guide),)
    if given.insert is not None:
        targets = (*targets, fit.make_hole(holding, step, led.guide))
    return StepPhase(name, (led,), touches=touches, loads=loads, targets=targets)


@dataclass(frozen=True, eq=False)
class Fit:
    """An object beside the axis of a hole.

    Attributes:
        axis: (3,) unit, of the hole, the way on which the object moves.
        own: (3,) unit, in the object: its axis nearest to the hole's.
        off: (3,) of its origin off the hole's axis [m].
        turn: (3, 3) that brings its axis along the hole's.
        lateral_m: largest distance from the axis with which it still finds into the hole.
        tilt_rad: largest angle with which it does not wedge.
        width_m: of the hole.
        length_m: of the object along its own axis.
    """

    axis: Float[np.ndarray, "3"]
    own: Float[np.ndarray, "3"]
    off: Float[np.ndarray, "3"]
    turn: Float[np.ndarray, "3 3"]
    lateral_m: float
    tilt_rad: float
    width_m: float
    length_m: float

    @staticmethod
    def of(step: FitStep, item: MovableObject, pose: Float[np.ndarray, "4 4"]) -> Fit:
        """Measure an object at a pose in the world."""
        axis = np.asarray(step.axis, dtype=float)
        axis = axis / np.linalg.norm(axis)
        along = pose[:3, :3].T @ axis
        k = int(np.abs(along).argmax())
        own = np.sign(along[k]) * np.eye(3)[k]
        off = np.zeros(3)
        if step.at is not None:
            beside = pose[:3, 3] - np.asarray(step.at)
            off = beside - (beside @ axis) * axis
        here = pose[:3, :3] @ own
        turn, _ = Rotation.align_vectors(axis[None], here[None])
        size = np.ptp(item.vertices, axis=0)
        width = float(np.delete(size, k).max()) + step.clearance_m
        tilt = step.clearance_m / (step.friction * width)
        lateral = step.chamfer_m + 0.5 * step.clearance_m
        return Fit(axis, own, off, turn.as_matrix(), lateral, tilt, width, float(size[k]))

    @property
    def tilted_rad(self) -> float:
        """Angle between the object's axis and the hole's."""
        return float(Rotation.from_matrix(self.turn).magnitude())

    def make_target(self, name: str, guide: Guide) -> RelativePoseTarget:
        """Return the promise that the object finds into the hole and does not wedge, during the whole way."""
        half = 0.5 * guide.shift
        place, turned = guide.position + half, guide.rotation
        return RelativePoseTarget(name, None, place, turned, self.lateral_m, self.tilt_rad, self.own, half)

    def make_hole(self, holding: Holding, step: FitStep, guide: Guide) -> HoleTarget:
        """Return the promise that the object does not jam under what the stiffness of its hands exerts."""
        shift, turn = holding.held[step.object].find_stiffness(holding.servo)
        return HoleTarget(
            step.object,
            guide.position,
            self.axis,
            self.own,
            step.depth_m,
            0.5 * self.width_m,
            self.length_m,
            step.clearance_m,
            step.friction,
            step.force_n,
            shift,
            turn,
        )
