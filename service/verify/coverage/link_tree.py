"""Tree of the robot's links, and which of them are joint neighbours, from the model alone."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot.model import RobotModel

# A body fixed to a link belongs to a joint of the link when all of it is this near to the joint [m].
JOINT_SIZE_M = 0.25


class LinkTree:
    """Tree of a robot's links by name.

    Attributes:
        joint: the pinocchio joint that carries each link (0: fixed to the world).
        origin: origin of each link in the frame of that joint [m].
        carrier: the link that carries each link, None for the root.
        shaped: links with a collision shape.
    """

    def __init__(self, robot: RobotModel) -> None:
        """Read the tree from the model's frames; a body whose link has no frame counts as its joint's own link."""
        self._model, self._robot = robot.model, robot
        self.joint: dict[str, int] = {}
        self.origin: dict[str, np.ndarray] = {}
        self.carrier: dict[str, str | None] = {}
        frames = robot.model.frames
        for frame in frames:
            if frame.type != pin.FrameType.BODY or frame.name == "universe":
                continue
            self.joint[frame.name] = int(frame.parentJoint)
            self.origin[frame.name] = np.array(frame.placement.translation)
            above = frames[frame.parentFrame]
            while above.name != "universe" and above.type != pin.FrameType.BODY:
                above = frames[above.parentFrame]
            self.carrier[frame.name] = None if above.name == "universe" else str(above.name)
        self._frameless = {body.link for body in robot.bodies} - set(self.joint)
        for body in robot.bodies:
            if body.link in self._frameless:
                self.joint[body.link], self.origin[body.link] = body.joint, np.zeros(3)
                self.carrier[body.link] = None
        self.shaped = frozenset(body.link for body in robot.bodies)

    @cached_property
    def mount(self) -> dict[str, str | None]:
        """Nearest link with a shape above each link."""
        return {link: self._first_shaped_above(link) for link in self.joint}

    @cached_property
    def children(self) -> dict[str, tuple[str, ...]]:
        """Links that each link carries."""
        carried: dict[str, list[str]] = {link: [] for link in self.joint}
        for link, carrier in self.carrier.items():
            if carrier is not None:
                carried[carrier].append(link)
        return {link: tuple(below) for link, below in carried.items()}

    def first_shaped_below(self, link: str) -> set[str]:
        """Return the nearest links with a shape below a link, at most one per branch."""
        nearest: set[str] = set()
        todo = list(self.children[link])
        while todo:
            below = todo.pop()
            if below in self.shaped:
                nearest.add(below)
            else:
                todo += self.children[below]
        return nearest

    def are_neighbours(self, a: str, b: str) -> bool:
        """Return whether two links with shapes are joined by one joint, or by several with no shape between them.

        Links fixed to one of the two count only if they are near the joint; a link fixed to the world is a neighbour
        only of the links it carries.
        """
        if self.mount[a] == b or self.mount[b] == a:
            return True
        return self._meet_at_a_joint(a, b) or self._meet_at_a_joint(b, a)

    def path(self, a: str, b: str) -> tuple[int, ...]:
        """Return the joints that move one link against another."""
        return tuple(sorted(self._above(self.joint[a]) ^ self._above(self.joint[b])))

    def _first_shaped_above(self, link: str) -> str | None:
        above = self.carrier[link]
        while above is not None and above not in self.shaped:
            above = self.carrier[above]
        return above

    def _meet_at_a_joint(self, upper: str, lower: str) -> bool:
        """Return whether a joint connects these two links, or links fixed to them, and both are near it."""
        hinge = joint = self.joint[lower]
        shaped_joints = {self.joint[link] for link in self.shaped}
        if joint == 0:
            return False
        above = int(self._model.parents[joint])
        while above > 0 and above not in shaped_joints:
            hinge, above = above, int(self._model.parents[above])
        if above != self.joint[upper]:
            return False
        heads = {link for link in self.shaped if self.joint[link] == joint and self._joint_of_mount(link) == above}
        mounts = {self.mount[head] for head in heads}
        is_upper = upper in mounts or upper in self._frameless
        is_lower = lower in heads or lower in self._frameless
        if above == 0:
            return is_upper and is_lower
        place = np.array(self._model.jointPlacements[hinge].translation)
        return (is_upper or self._is_near(upper, place)) and (is_lower or self._is_near(lower, np.zeros(3)))

    def _joint_of_mount(self, link: str) -> int | None:
        mount = self.mount[link]
        return None if mount is None else self.joint[mount]

    def _is_near(self, link: str, point: Float[np.ndarray, "3"]) -> bool:
        bodies = [body for body in self._robot.bodies if body.link == link]
        return all(float(np.linalg.norm(b.vertices - point, axis=1).max()) <= JOINT_SIZE_M for b in bodies)

    def _above(self, joint: int) -> set[int]:
        ancestors = set()
        while joint > 0:
            ancestors.add(joint)
            joint = int(self._model.parents[joint])
        return ancestors
