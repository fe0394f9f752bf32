"""The ground of a session: what its world is made of, so that any process can make it without looking at the scan."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from costs.robot import RobotModel
from costs.scene import Scene
from service.posing.numbers import PoseNumbers
from service.posing.reading import read_pose, write_pose
from service.posing.world import PoseWorld
from service.request.schema import PlanRequest, StartRequest
from service.setup.prepare import prepare
from service.start.configuration import make_start_configuration
from service.start.robot import attach_bodies


@dataclass(frozen=True)
class PoseGround:
    """What a session's world is made of.

    Attributes:
        key: of the session.
        request: robot and options.
        scene: all pieces.
        start: the pose in which the robot stands on its feet.
        feet: planted links.
        notes: what was assumed, in sentences.
    """

    key: str
    request: PlanRequest
    scene: Scene
    start: PoseNumbers
    feet: tuple[str, ...]
    notes: tuple[str, ...]

    @staticmethod
    def of(
        request: PlanRequest, robot: RobotModel, should_stop: Callable[[], bool], see: Callable[..., Any] | None = None
    ) -> PoseGround | None:
        """Return the ground of a request; None once ``should_stop`` returned True.

        Args:
            request: its goal or task does not matter.
            robot: of the request, without what it carries.
            should_stop: polled while the scene is made.
            see: as for ``prepare``.

        Raises:
            RequestError: the request cannot be prepared.
        """
        setup = prepare(request, robot=robot, should_stop=should_stop, see=see)
        if setup.is_stopped:
            return None
        start = write_pose(setup.robot, setup.start)
        return PoseGround(secrets.token_hex(16), setup.request, setup.scene, start, setup.contacts, setup.notes)

    def make_world(self, robot: RobotModel) -> PoseWorld:
        """Return the world with the request's robot.

        Raises:
            RequestError: the robot is not the one that the ground was made of.
        """
        robot = attach_bodies(robot, self.request)
        q = read_pose(robot, self.start)
        return PoseWorld.standing(robot, self.scene, q, self.feet, self.request.options)


def read_start(robot: RobotModel, start: StartRequest) -> PoseNumbers:
    """Return the numbers of a pose that is given as the start of a request; a given base is kept bit by bit.

    Raises:
        RequestError: an unknown posture or joint, or a joint beyond its limits.
    """
    numbers = write_pose(robot, make_start_configuration(robot, start)[0])
    if start.base is None or not numbers.base:
        return numbers
    return PoseNumbers((*start.base.position, *start.base.quaternion_wxyz), numbers.positions)
