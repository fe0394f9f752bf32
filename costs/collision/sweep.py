"""Vertices of the bodies at all waypoints, and the shares of a swept hull's two poses in its gradient."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from costs.kinematics import Kinematics
from costs.native import find_library, share_swept_gradient
from costs.robot.model import LinkBody, RobotModel
from costs.stopping import poll

SUPPORT_BAND = 1e-3  # vertices within this of the support plane are averaged, as in TrajOpt [m]

_KEPT = 8  # robots, with or without a mechanism or what they carry


@dataclass(frozen=True)
class BodyVertices:
    """The outer hulls of all bodies in one padded array.

    Attributes:
        local: (B, V, 3) vertices in the joint's frame; the last vertex repeats up to V [m].
        count: (B,) number of vertices without repetitions.
        joint: (B,) joint that carries each body.
        lower, upper: (B, 3) bounding box in the joint's frame [m].
        centre: (B, 3) centre of the bounding sphere in the joint's frame.
        radius: (B,) its radius [m].
    """

    local: Float[np.ndarray, "B V 3"]
    count: Int[np.ndarray, "B"]
    joint: Int[np.ndarray, "B"]
    lower: Float[np.ndarray, "B 3"]
    upper: Float[np.ndarray, "B 3"]
    centre: Float[np.ndarray, "B 3"]
    radius: Float[np.ndarray, "B"]

    @staticmethod
    def of(robot: RobotModel) -> BodyVertices:
        """Return the bodies of a robot, read once."""
        return _read_vertices(robot.bodies)

    def in_world(self, kinematics: Kinematics) -> Float[np.ndarray, "T B V 3"]:
        """Return the world coordinates of all vertices at all waypoints."""
        poll()
        rotation = kinematics.rotation[:, self.joint]
        return np.asarray(
            np.matmul(self.local, rotation.transpose(0, 1, 3, 2)) + kinematics.position[:, self.joint, None]
        )

    def centres_in_world(self, kinematics: Kinematics) -> Float[np.ndarray, "T B 3"]:
        """Return the world coordinates of the bounding spheres' centres."""
        rotation = kinematics.rotation[:, self.joint]
        return np.asarray((rotation @ self.centre[:, :, None])[..., 0] + kinematics.position[:, self.joint])


@lru_cache(maxsize=_KEPT)
def _read_vertices(bodies: tuple[LinkBody, ...]) -> BodyVertices:
    count = np.array([len(body.outer) for body in bodies], dtype=int)
    longest = int(count.max(initial=1))
    local = np.empty((len(bodies), longest, 3))
    for row, body in zip(local, bodies, strict=True):
        row[: len(body.outer)], row[len(body.outer) :] = body.outer, body.outer[-1]
    lower, upper = find_extent(local)
    centre = 0.5 * (lower + upper)
    radius = np.linalg.norm(local - centre[:, None], axis=2).max(axis=1)
    joint = np.array([body.joint for body in bodies], dtype=int)
    return BodyVertices(local, count, joint, lower, upper, centre, radius)


def find_extent(points: Float[np.ndarray, "*m V 3"]) -> tuple[Float[np.ndarray, "*m 3"], Float[np.ndarray, "*m 3"]]:
    """Find the lower and upper corners of the bounding boxes of many point sets."""
    axes = (points.ndim - 2, *range(points.ndim - 2), points.ndim - 1)
    first = np.ascontiguousarray(points.transpose(axes))  # reduced over its first axis: eight times as fast
    return first.min(axis=0), first.max(axis=0)


def share_gradient(
    at_first: Float[np.ndarray, "m V 3"],
    at_second: Float[np.ndarray, "m V 3"],
    normal: Float[np.ndarray, "m 3"],
    witness: Float[np.ndarray, "m 3"],
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
    """Locate a witness point on the sweep: return the weight of the second pose and its point at each pose.

    The pose whose support along ``-normal`` is nearer the witness gets the larger share (Schulman et al., IJRR 2014,
    sec. V.B); a pose that lies further off by more than the band has no share.  The gradient is exact for a single
    pose, where one pose alone supports and where one vertex does; elsewhere the share is an estimate.

    Args:
        at_first, at_second: the body's vertices at both poses, in one frame.
        normal: towards the body.
        witness: nearest point of the swept hull.
    """
    library = find_library()
    if library is not None:
        return share_swept_gradient(library, at_first, at_second, normal, witness, SUPPORT_BAND)
    low_first, point_first = _support(at_first, normal)
    low_second, point_second = _support(at_second, normal)
    to_first = np.linalg.norm(witness - point_first, axis=1)
    to_second = np.linalg.norm(witness - point_second, axis=1)
    total = to_first + to_second
    share = np.where(total < SUPPORT_BAND, 0.5, to_first / np.where(total < SUPPORT_BAND, 1.0, total))
    apart = 10.0 * SUPPORT_BAND
    share = np.where(low_second - low_first > apart, 0.0, np.where(low_first - low_second > apart, 1.0, share))
    # Both points are moved alike so that they share out to the witness itself: the mean of a supporting edge or face
    # lies far from it, and with it the rotations' lever arms.
    offset = witness - (1.0 - share)[:, None] * point_first - share[:, None] * point_second
    return share, point_first + offset, point_second + offset


def _support(
    vertices: Float[np.ndarray, "m V 3"], normal: Float[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m 3"]]:
    """Return the lowest height along the normal, and the mean of the vertices that reach it."""
    height = np.einsum("mvk,mk->mv", vertices, normal)
    lowest = height.min(axis=1)
    weight = (height < lowest[:, None] + SUPPORT_BAND).astype(float)
    return lowest, np.einsum("mv,mvk->mk", weight, vertices) / weight.sum(axis=1, keepdims=True)
