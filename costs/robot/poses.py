"""Rotations and poses as URDF writes them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from lxml import etree

from costs.robot.errors import RobotError
from costs.robot.xmlfile import parse_numbers

FARTHEST_M = 1000.0  # largest distance of a part from the one that carries it
WHOLE_TURN = 6.3  # larger angles of an origin may be in degrees [rad]


def parse_origin(element: etree._Element, where: str, notes: list[str] | None = None) -> Float[np.ndarray, "4 4"]:
    """Read the pose of an element's <origin>; the identity without one. Add a note about angles beyond a turn."""
    pose = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        pose[:3, 3] = parse_numbers(origin.get("xyz", "0 0 0"), 3, f"{where}: origin xyz")
        farthest = float(np.abs(pose[:3, 3]).max())
        if farthest > FARTHEST_M:
            raise RobotError(
                f"{where}: origin xyz: {farthest:g} m is farther than {FARTHEST_M:g} m; are these millimetres?"
            )
        rpy = parse_numbers(origin.get("rpy", "0 0 0"), 3, f"{where}: origin rpy")
        most = float(rpy[np.abs(rpy).argmax()])
        if abs(most) > WHOLE_TURN and notes is not None:
            notes.append(f"{where}: an origin's rpy of {most:g} rad is read as it is; are these degrees?")
        pose[:3, :3] = rpy_matrix(rpy)
    return pose


def make_origin(pose: Float[np.ndarray, "4 4"]) -> etree._Element:
    """Make the <origin> of a pose."""
    return etree.Element("origin", xyz=format_numbers(pose[:3, 3]), rpy=format_numbers(matrix_rpy(pose[:3, :3])))


def format_numbers(values: Float[np.ndarray, "k"]) -> str:
    """Format numbers exactly, separated by blanks."""
    return " ".join(repr(float(value)) for value in values)


def rpy_matrix(rpy: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of URDF's fixed-axis roll, pitch, yaw [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array([[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                     [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                     [-sp, cp * sr, cp * cr]])  # fmt: skip


def matrix_rpy(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Return fixed-axis roll, pitch, yaw [rad] of a rotation; at pitch +-90 degrees the roll is put to 0."""
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    if abs(rotation[2, 0]) > 1.0 - 1e-12:
        return np.array([0.0, pitch, np.arctan2(-rotation[0, 1], rotation[1, 1])])
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    return np.array([roll, pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])


def axis_rotation(axis: Float[np.ndarray, "3"], angle: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation by ``angle`` [rad] about a unit axis (Rodrigues)."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew)
