"""A pose as the numbers that files and messages hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class PoseNumbers:
    """A pose of a robot.

    Attributes:
        base: x y z [m], then qw qx qy qz of a floating base; empty for another.
        positions: of the robot's joints in their order, without a floating base [rad, m].
    """

    base: tuple[float, ...]
    positions: tuple[float, ...]

    def to_state(self, joint_names: Sequence[str]) -> dict[str, Any]:
        """Return the data of a state file, or of the ``start`` of a request.

        Args:
            joint_names: of the positions.
        """
        data: dict[str, Any] = {"joint_names": list(joint_names), "positions": list(self.positions)}
        if self.base:
            data["base"] = {"position": list(self.base[:3]), "quaternion_wxyz": list(self.base[3:])}
        return data

    def to_goal(self, joint_names: Sequence[str]) -> dict[str, Any]:
        """Return the data of a goal of the same joint positions; a floating base follows from the feet."""
        return {"joints": dict(zip(joint_names, self.positions, strict=True))}
