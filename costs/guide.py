"""Way of a frame through the world: a line, an arc, a screw, or a turn on the spot, by the share that is done."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

SHORTEST_M, SMALLEST_RAD = 1e-6, 1e-6  # of a way and of a turn that count
TURN_ARM_M = 0.1  # at which a turn counts as a length beside distances, where turns of an arc have to be told apart
NEWTON_STEPS = 3  # from the angle about a screw's axis to its nearest point


@dataclass(frozen=True)
class Guide:
    """A way on which a frame is led in equal shares: carried about an axis, shifted, and turned.

    Attributes:
        position: (3,) of the frame's origin at its beginning, in the world [m].
        rotation: (3, 3) rotation_world_frame at its beginning.
        centre, axis: (3,) point and unit direction of the axis about which the origin is carried, in the world [m].
        angle: by which it is carried about the axis on the whole way [rad].
        shift: (3,) by which it moves besides, in the world; along ``axis`` where ``angle`` is not 0 [m].
        turn: (3,) rotation vector in the world by which the frame turns on the whole way [rad].
    """

    position: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    angle: float
    shift: Float[np.ndarray, "3"]
    turn: Float[np.ndarray, "3"]

    @staticmethod
    def line(
        position: Float[np.ndarray, "3"],
        rotation: Float[np.ndarray, "3 3"],
        shift: Float[np.ndarray, "3"],
        turn: Float[np.ndarray, "3"] | None = None,
    ) -> Guide:
        """Return a straight way, on which the frame may turn."""
        own = np.zeros(3) if turn is None else np.asarray(turn, dtype=float)
        return Guide(position, rotation, position, np.array([0.0, 0.0, 1.0]), 0.0, np.asarray(shift, dtype=float), own)

    @staticmethod
    def screw(
        position: Float[np.ndarray, "3"],
        rotation: Float[np.ndarray, "3 3"],
        centre: Float[np.ndarray, "3"],
        axis: Float[np.ndarray, "3"],
        angle: float,
        lead: float = 0.0,
        *,
        turns: bool = True,
    ) -> Guide:
        """Return an arc about an axis, with a shift along it; the frame turns along unless ``turns`` is false."""
        unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        return Guide(position, rotation, centre, unit, angle, lead * unit, (angle if turns else 0.0) * unit)

    @cached_property
    def arm(self) -> Float[np.ndarray, "3"]:
        """(3,) from the axis to the origin at the beginning [m]."""
        offset = self.position - self.centre
        return np.asarray(offset - (offset @ self.axis) * self.axis)

    @property
    def radius(self) -> float:
        """Distance of the origin from the axis; 0 where it is not carried about it [m]."""
        return float(np.linalg.norm(self.arm)) if self.angle else 0.0

    @property
    def length(self) -> float:
        """Length of the origin's way [m]."""
        return float(np.hypot(self.angle * self.radius, np.linalg.norm(self.shift)))

    @property
    def turned(self) -> float:
        """Angle by which the frame turns [rad]."""
        return float(np.linalg.norm(self.turn))

    @property
    def has_length(self) -> bool:
        """Whether the origin moves, so that its place says how much is done."""
        return self.length > SHORTEST_M

    @property
    def bend(self) -> float:
        """Largest second derivative of the origin's place by the share [m]."""
        return self.angle**2 * self.radius

    def positions(self, share: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S 3"]:
        """Return the origin's places [m]."""
        from scipy.spatial.transform import Rotation  # slow to import

        carried = Rotation.from_rotvec(np.outer(share * self.angle, self.axis)).apply(self.position - self.centre)
        return np.asarray(self.centre + carried + np.outer(share, self.shift))

    def rotations(self, share: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S 3 3"]:
        """Return rotation_world_frame."""
        from scipy.spatial.transform import Rotation  # slow to import

        return np.asarray(Rotation.from_rotvec(np.outer(share, self.turn)).as_matrix() @ self.rotation)

    def tangents(self, share: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S 3"]:
        """Return the derivatives of the origin's place by the share [m]."""
        from scipy.spatial.transform import Rotation  # slow to import

        arms = Rotation.from_rotvec(np.outer(share * self.angle, self.axis)).apply(self.arm)
        return np.asarray(self.angle * np.cross(self.axis, arms) + self.shift)

    def poses(self, share: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S 4 4"]:
        """Return pose_world_frame."""
        poses = np.tile(np.eye(4), (len(share), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = self.rotations(share), self.positions(share)
        return poses

    def find_shares(
        self,
        position: Float[np.ndarray, "S 3"],
        rotation: Float[np.ndarray, "S 3 3"],
        near: Float[np.ndarray, "S"] | None = None,
    ) -> Float[np.ndarray, "S"]:
        """Return the shares of the nearest points of the way, unlimited by its ends.

        A point of an arc has one share for each turn: the one nearest to ``near`` is returned; by default the one
        between the ends at which place and turn of the frame fit best.
        """
        from scipy.spatial.transform import Rotation  # slow to import

        if not self.has_length:
            if self.turned < SMALLEST_RAD:
                return np.zeros(len(position)) if near is None else np.asarray(near, dtype=float)
            axis = self.turn / self.turned
            off = Rotation.from_matrix(rotation @ self.rotation.T).as_quat()  # x, y, z, w
            share = 2.0 * np.arctan2(off[:, :3] @ axis, off[:, 3]) / self.turned
            return self._choose_turn(share, 2.0 * np.pi / self.turned, position, rotation, near)
        if not self.angle or self.radius < SHORTEST_M:
            return np.asarray((position - self.position) @ self.shift / (self.shift @ self.shift))
        offset = position - self.centre
        flat = offset - np.outer(offset @ self.axis, self.axis)
        across = np.cross(self.axis, self.arm)
        share = np.arctan2(flat @ across, flat @ self.arm) / self.angle
        share = self._choose_turn(share, 2.0 * np.pi / abs(self.angle), position, rotation, near)
        if np.any(self.shift):
            for _ in range(NEWTON_STEPS):
                missing = position - self.positions(share)
                share = share + np.einsum("sk,sk->s", missing, self.tangents(share)) / self.length**2
        return np.asarray(share)

    def _choose_turn(
        self,
        share: Float[np.ndarray, "S"],
        period: float,
        position: Float[np.ndarray, "S 3"],
        rotation: Float[np.ndarray, "S 3 3"],
        near: Float[np.ndarray, "S"] | None,
    ) -> Float[np.ndarray, "S"]:
        """Return each share plus the multiple of a period that fits best."""
        if near is not None:
            return np.asarray(share + period * np.round((near - share) / period))
        count = int(np.ceil(0.5 + 1.0 / period)) if period < 2.0 else 1
        tried = share[:, None] + period * np.arange(-count, count + 1)
        flat = tried.ravel()
        repeat = tried.shape[1]
        off = np.linalg.norm(np.repeat(position, repeat, axis=0) - self.positions(flat), axis=1)
        turned = np.repeat(rotation, repeat, axis=0).transpose(0, 2, 1) @ self.rotations(flat)
        cosine = 0.5 * (np.trace(turned, axis1=1, axis2=2) - 1.0)
        beyond = np.maximum(np.maximum(-flat, flat - 1.0), 0.0)
        miss = off + TURN_ARM_M * (np.arccos(np.clip(cosine, -1.0, 1.0)) + beyond)
        best = miss.reshape(tried.shape).argmin(axis=1)
        return np.asarray(tried[np.arange(len(share)), best])
