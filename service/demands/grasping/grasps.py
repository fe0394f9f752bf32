"""Grasps of an object: where the tool frame of a gripper is, and how far the fingers close; given or generated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.robot.carried import MovableObject
from costs.rotation import pose_matrix
from service.demands.grasping.gripper import Gripper
from service.request.scene import GraspRequest

PALM_SPACE_M = 5e-3  # between an object and the hand's front
BEYOND_M = 2e-3  # by which fingers stay before the far side of an object
N_TURNS = 8  # about the axis of a cylinder


@dataclass(frozen=True)
class Grasp:
    """A gripper's place on an object.

    Attributes:
        gripper: the hand.
        pose_object_tool: (4, 4).
        closed: values of the fingers' joints while they hold [m].
        opened: while they come and go [m].
        number: of a given grasp; None for a generated one.
    """

    gripper: Gripper
    pose_object_tool: Float[np.ndarray, "4 4"]
    closed: dict[str, float]
    opened: dict[str, float]
    number: int | None = None

    @property
    def along(self) -> Float[np.ndarray, "3"]:
        """(3,) unit, in the object: the way on which the hand comes."""
        return np.asarray(self.pose_object_tool[:3, 2])


def list_grasps(
    item: MovableObject, gripper: Gripper, given: Sequence[GraspRequest], opening_m: float
) -> tuple[tuple[Grasp, ...], tuple[str, ...]]:
    """Return the grasps of an object by a gripper, and for each place that does not suit the gripper a phrase why.

    Args:
        item: the object.
        gripper: the hand.
        given: grasps of the request; generated where there are none.
        opening_m: free space between each finger and the object as the hand comes and goes.
    """
    poses = [pose_matrix(grasp.position, grasp.quaternion_wxyz) for grasp in given]
    grasps, refused = [], []
    for number, pose in enumerate(poses or generate_poses(item, gripper)):
        made = close_on(item, gripper, pose, opening_m)
        if isinstance(made, str):
            refused.append(made)
        else:
            grasps.append(Grasp(gripper, pose, *made, number if poses else None))
    return tuple(grasps), tuple(dict.fromkeys(refused))


def generate_poses(item: MovableObject, gripper: Gripper) -> Iterator[Float[np.ndarray, "4 4"]]:
    """Yield poses of the tool in an object: on each face of its box, or about its axis, beside its centre of mass."""
    middle = 0.5 * (item.vertices.min(axis=0) + item.vertices.max(axis=0))
    for closing, along in _list_axes(item):
        extent = 0.5 * float(np.ptp(item.vertices @ along))
        depth = _find_depth(gripper, 2.0 * extent)
        turn = _turn_tool(gripper, closing, along)
        pose = np.eye(4)
        pose[:3, :3] = turn
        centre = item.inertia.centre + ((middle - item.inertia.centre) @ along) * along
        pose[:3, 3] = centre + (depth - extent - gripper.tip) * along
        yield pose


def _list_axes(item: MovableObject) -> Iterator[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:
    """Yield the way on which the first finger opens and that on which the hand comes, in the object."""
    eye = np.eye(3)
    if item.exact is None:
        for i in range(3):
            for j in range(3):
                if i != j:
                    for a in (1.0, -1.0):
                        for b in (-1.0, 1.0):
                            yield a * eye[i], b * eye[j]
        return
    for k in range(N_TURNS):
        angle = 2.0 * np.pi * k / N_TURNS
        radial = np.array([np.cos(angle), np.sin(angle), 0.0])
        across = np.array([-radial[1], radial[0], 0.0])
        for along in (-eye[2], eye[2], across):
            yield radial, along
        yield eye[2], radial
        yield -eye[2], radial


def _find_depth(gripper: Gripper, length: float) -> float:
    """Return how far the fingers' ends are beyond the side of an object on which they come [m]."""
    usable = gripper.tip - gripper.palm - PALM_SPACE_M
    pad = gripper.tip - gripper.pads[0]
    return max(min(usable, length - BEYOND_M, 0.5 * (length + pad)), 0.5 * BEYOND_M)


def _turn_tool(
    gripper: Gripper, closing: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3 3"]:
    """Return rotation_object_tool with z along the way of the hand and the fingers' way along ``closing``."""
    own = np.stack([gripper.closing, np.cross([0.0, 0.0, 1.0], gripper.closing), [0.0, 0.0, 1.0]], axis=1)
    wanted = np.stack([closing, np.cross(along, closing), along], axis=1)
    return np.asarray(wanted @ own.T)


def close_on(
    item: MovableObject, gripper: Gripper, pose: Float[np.ndarray, "4 4"], opening_m: float
) -> tuple[dict[str, float], dict[str, float]] | str:
    """Return the fingers' joints closed on an object and opened beside it, or a phrase why they cannot be there."""
    closing = pose[:3, :3] @ gripper.closing
    high, low = find_sides(item, closing) - pose[:3, 3] @ closing
    if gripper.follows:  # both move alike: the tool has to be in the middle
        high = max(high, -low)
        low = -high
    closed = gripper.find_values(high, low)
    opened = gripper.find_values(high + opening_m, low - opening_m)
    if isinstance(closed, str) or isinstance(opened, str):
        return closed if isinstance(closed, str) else str(opened)
    return closed, opened


def find_sides(item: MovableObject, direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
    """Return the farthest positions of an object along a direction, forwards and backwards [m]."""
    along = item.vertices @ direction
    if item.exact is None:
        return np.array([along.max(), along.min()])
    # The hull is a little larger than the round shape, which a pad touches.
    own = item.exact.pose[:3, :3].T @ direction
    reach = item.exact.radius * np.hypot(own[0], own[1]) + 0.5 * item.exact.length * abs(own[2])
    middle = float(item.exact.pose[:3, 3] @ direction)
    return np.array([middle + reach, middle - reach])
