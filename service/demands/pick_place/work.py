"""What taking an object and putting it down needs: the object, its grippers, where it rests before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.robot import RobotModel
from costs.robot.carried import MovableObject, PlacedObject, with_objects
from costs.rotation import pose_matrix
from costs.scene import Scene
from service.demands.grasping.gripper import Gripper, list_grippers
from service.demands.grasping.objects import find_object
from service.demands.phase import TaskPhase
from service.errors import RequestError
from service.request.scene import ObjectRequest
from service.request.schema import PlanRequest
from service.request.tasks.pick_place import PickRequest
from service.start.resting import SUPPORT_DEPTH_M
from service.verify import Carrier, Grip, PoseTarget, Target, measure_rest_margin

PAD_DEPTH_M = 3e-3  # of a finger in what it holds
PLACE_TOLERANCE_M, PLACE_TOLERANCE_RAD = 5e-3, float(np.deg2rad(2.0))
APPROACH, ENTER, GRASP, LIFT, CARRY, LOWER, RELEASE, RETREAT = PHASES = (
    "approach", "enter", "grasp", "lift", "carry", "lower", "release", "retreat"
)  # fmt: skip
HELD = (LIFT, CARRY, LOWER)  # phases in which a hand carries the object
TOUCHED = (GRASP, *HELD, RELEASE)  # in which fingers touch it
TOGETHER = PHASES[1:]  # in which two hands keep their places against each other
FIELD = "task.pick_place"


@dataclass(frozen=True)
class PickPlace:
    """The work of a request.

    Attributes:
        request: section of the request.
        given: the object as the request gives it.
        item: the object as a body, at its start.
        place: (4, 4) pose where it is put.
        supports: names of the pieces on which it rests at its start.
        ends_on: names of those on which it rests where it is put.
        margins: how far its centre of mass may be off where it rests, at the start and where it is put [m].
        friction: least coefficient between hands and objects.
    """

    request: PickRequest
    given: ObjectRequest
    item: MovableObject
    place: Float[np.ndarray, "4 4"]
    supports: tuple[str, ...]
    ends_on: tuple[str, ...]
    margins: tuple[float, float]
    friction: float

    @staticmethod
    def of(section: PickRequest, request: PlanRequest, robot: RobotModel, scene: Scene) -> PickPlace:
        """Read the work of a request.

        Raises:
            RequestError: there is no such object.
        """
        given, item = find_object(request, section.object, f"{FIELD}.object")
        turned = section.to.quaternion_wxyz or given.quaternion_wxyz
        place = pose_matrix(section.to.position, turned)
        rests = [_rest(robot, scene, item, pose) for pose in (item.start, place)]
        return PickPlace(
            section, given, item, place, rests[0][1], rests[1][1], (rests[0][0], rests[1][0]),
            request.options.hand_friction[0],
        )  # fmt: skip

    def make_grip(self, gripper: Gripper) -> Grip:
        """Return how a gripper holds the object."""
        return Grip(gripper.fingers, min(self.request.grip_n, gripper.force_n), self.friction)

    def list_carriers(self, phase: str, grippers: Sequence[Gripper]) -> tuple[Carrier, ...]:
        """Return what carries the object in a phase, held by grippers of which the first one leads."""
        if phase not in HELD:
            return (Carrier(self.item.name),)
        return (Carrier(self.item.name, grippers[0].link, tuple(map(self.make_grip, grippers))),)

    def list_touches(self, phase: str, grippers: Sequence[Gripper]) -> tuple[Allowance, ...]:
        """Return the pairs that may touch in a phase."""
        item = BodyRef.of_link(self.item.name)
        touches = []
        if phase in TOUCHED:
            fingers = [finger for gripper in grippers for finger in gripper.fingers]
            touches += [Allowance(BodyRef.of_link(finger), item, PAD_DEPTH_M) for finger in fingers]
        below = {LIFT: self.supports, LOWER: self.ends_on}.get(phase, ())
        return (*touches, *(Allowance(item, BodyRef.of_piece(name), SUPPORT_DEPTH_M) for name in below))

    def make_phase(self, phase: str, grippers: Sequence[Gripper], targets: tuple[Target, ...] = ()) -> TaskPhase:
        """Return what the task demands of a phase, with targets of its own."""
        touches, carriers = self.list_touches(phase, grippers), self.list_carriers(phase, grippers)
        return TaskPhase(phase, touches=touches, targets=targets, carriers=carriers)

    def make_place_target(self, at: float) -> PoseTarget:
        """Return the promise that the object is at its place at a path parameter."""
        position, rotation = np.full(3, PLACE_TOLERANCE_M), np.full(3, PLACE_TOLERANCE_RAD)
        return PoseTarget(self.item.name, self.place[:3, 3], self.place[:3, :3], position, rotation, at)


def choose_grippers(robot: RobotModel, section: PickRequest) -> tuple[Gripper, ...]:
    """Return the grippers of a robot that a request permits.

    Raises:
        RequestError: the robot has none.
    """
    grippers = list_grippers(robot, section.hand)
    if len(grippers) < (2 if section.hand == "both" else 1):
        wanted = "two hands" if section.hand == "both" else "a hand"
        raise RequestError(
            f"{FIELD}.hand: {section.hand} needs {wanted} with two fingers that slide, and robot "
            f"'{robot.name}' has {len(grippers)}; robot.hand: gripper gives the bundled robot some, "
            "robot.hands.SIDE.fingers names those of another robot"
        )
    return grippers


def place_object(
    robot: RobotModel, item: MovableObject, link: str | None, pose: Float[np.ndarray, "4 4"]
) -> RobotModel:
    """Return the robot with the object carried by one of its links, or by the world (None)."""
    return with_objects(robot, [PlacedObject(item, link, pose)])


def _rest(
    robot: RobotModel, scene: Scene, item: MovableObject, pose: Float[np.ndarray, "4 4"]
) -> tuple[float, tuple[str, ...]]:
    """Return the margin with which an object rests at a pose [m], and on which pieces."""
    body = place_object(robot, item, None, pose).bodies[-1]
    centre = pose[:3, :3] @ item.inertia.centre + pose[:3, 3]
    return measure_rest_margin(body, centre, scene.pieces)
