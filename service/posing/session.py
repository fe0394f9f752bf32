"""A session in which an operator leads a pose in one process."""

from __future__ import annotations

from service.posing.drag import Drag, LedPose
from service.posing.history import PoseHistory
from service.posing.numbers import PoseNumbers
from service.posing.world import PoseWorld


class PoseSession:
    """Leads a pose in one process.

    Args:
        world: the robot where it stands.
        start: the first pose.

    Attributes:
        history: the poses of the session.

    Raises:
        RequestError: the verifier finds something against the first pose.
    """

    def __init__(self, world: PoseWorld, start: PoseNumbers) -> None:
        self.world = world
        self.history = PoseHistory(world.check(start))

    @property
    def pose(self) -> LedPose:
        """The current pose."""
        return self.history.pose

    def drag(self, drag: Drag, *, is_last: bool = False) -> LedPose:
        """Lead the pose; ``is_last`` ends the drag.

        Raises:
            RequestError: the drag names something that the robot does not have; the pose stays.
        """
        pose = self.world.lead(self.pose.numbers, drag, self.history.measure_move(drag))
        self.history.take(drag, pose, is_last=is_last)
        return pose

    def set(self, numbers: PoseNumbers) -> LedPose:
        """Take a given pose.

        Raises:
            RequestError: the verifier finds something against it; the pose stays.
        """
        self.history.set(self.world.check(numbers))
        return self.pose
