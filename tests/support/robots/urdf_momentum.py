"""Wrench from the ground by another road: momentum of a URDF's links, differentiated twice by differences.

Nothing of pinocchio: links, joints and masses are read from the URDF's text.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class Link:
    """A link, what it hangs on, and its mass.

    Attributes:
        parent: index of the link that carries it; -1 for the root.
        rotation, translation: of the joint in the parent's frame, at 0.
        joint, axis, slides: its joint's name, axis in its frame, and whether it is prismatic; "" where it is fixed.
        mass, centre, inertia: in the link's frame, the inertia about the centre.
        name: of the link.
    """

    parent: int
    rotation: np.ndarray
    translation: np.ndarray
    joint: str
    axis: np.ndarray
    slides: bool
    mass: float
    centre: np.ndarray
    inertia: np.ndarray
    name: str = ""


def read_links(urdf: str) -> list[Link]:
    """Links in an order in which parents come first."""
    root = ET.fromstring(urdf)
    joints = {joint.find("child").get("link"): joint for joint in root.findall("joint")}  # type: ignore[union-attr]
    elements = {link.get("name"): link for link in root.findall("link")}
    order: list[str | None] = []

    def visit(name: str | None) -> None:
        if name not in order:
            if name in joints:
                visit(joints[name].find("parent").get("link"))  # type: ignore[union-attr]
            order.append(name)

    for name in elements:
        visit(name)
    return [replace(_link(elements[name], joints.get(name), order), name=str(name)) for name in order]


def wrench_about_origin(
    links: list[Link], pose: Callable[[float], tuple[np.ndarray, np.ndarray, Mapping[str, float]]], step: float = 2e-4
) -> np.ndarray:
    """Force and moment about the world's origin that the ground gives at time 0 [N, Nm].

    Args:
        links: of the robot.
        pose: smooth in time: rotation and translation of the root link, and joint values by name.
        step: of the differences [s].
    """
    frames = [_place_centres(links, *pose(k * step)) for k in (-2, -1, 0, 1, 2)]
    masses = np.array([link.mass for link in links])
    # Momentum half a step before and after each time, then its change: second-order differences twice.
    momenta = []
    for k in (0, 1, 2, 3):
        (r0, c0), (r1, c1) = frames[k], frames[k + 1]
        middle, velocity = 0.5 * (c0 + c1), (c1 - c0) / step
        linear = masses[:, None] * velocity
        angular = np.cross(middle, linear)
        for i, link in enumerate(links):
            turn = r1[i] @ r0[i].T
            sine = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            halfway = 0.5 * (r0[i] + r1[i])
            angular[i] += halfway @ link.inertia @ halfway.T @ sine / step
        momenta.append(np.concatenate([linear.sum(axis=0), angular.sum(axis=0)]))
    near, far = (momenta[2] - momenta[1]) / step, (momenta[3] - momenta[0]) / (3.0 * step)
    change = near + (near - far) / 8.0
    centre = frames[2][1]
    weight = masses[:, None] * GRAVITY
    return np.asarray(change - np.concatenate([weight.sum(axis=0), np.cross(centre, weight).sum(axis=0)]))


def zmp_of(wrench: np.ndarray, height: float) -> np.ndarray:
    """Where on the plane the ground's force acts without a horizontal moment: p with (p x f)_xy = m_xy."""
    fx, fy, fz, mx, my, _ = wrench
    # p x f = (p_y f_z - h f_y, h f_x - p_x f_z, ...)
    rows = np.array([[0.0, fz], [-fz, 0.0]])
    return np.asarray(np.linalg.solve(rows, np.array([mx + height * fy, my - height * fx])))


def euler(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    turns = (
        np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]]),
        np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]]),
        np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]]),
    )
    return np.asarray(turns[0] @ turns[1] @ turns[2])


def place_frames(
    links: list[Link], rotation: np.ndarray, translation: np.ndarray, joints: Mapping[str, float]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Rotations and translations of all links in the world; those of the root are given."""
    turned: list[np.ndarray] = []
    moved: list[np.ndarray] = []
    for link in links:
        if link.parent < 0:
            turned.append(rotation)
            moved.append(translation)
            continue
        value = joints.get(link.joint, 0.0)
        place = link.translation + (link.rotation @ link.axis * value if link.slides else 0.0)
        turn = np.eye(3) if link.slides or not link.joint else _about(link.axis, value)
        moved.append(turned[link.parent] @ place + moved[link.parent])
        turned.append(turned[link.parent] @ link.rotation @ turn)
    return turned, moved


def _place_centres(
    links: list[Link], rotation: np.ndarray, translation: np.ndarray, joints: Mapping[str, float]
) -> tuple[list[np.ndarray], np.ndarray]:
    """Rotations of all links in the world, and (L, 3) centres of mass."""
    turned, moved = place_frames(links, rotation, translation, joints)
    return turned, np.array([r @ link.centre + t for r, t, link in zip(turned, moved, links, strict=True)])


def _about(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def _link(element: ET.Element, joint: ET.Element | None, order: list[str | None]) -> Link:
    parent, rotation, translation, name, axis, slides = -1, np.eye(3), np.zeros(3), "", np.zeros(3), False
    if joint is not None:
        parent = order.index(joint.find("parent").get("link"))  # type: ignore[union-attr]
        rotation, translation = _origin(joint)
        if joint.get("type") != "fixed":
            name, slides = str(joint.get("name")), joint.get("type") == "prismatic"
            axis = _numbers(joint.find("axis"), "xyz", "1 0 0")
            axis = axis / np.linalg.norm(axis)
    inertial = element.find("inertial")
    if inertial is None:
        return Link(parent, rotation, translation, name, axis, slides, 0.0, np.zeros(3), np.zeros((3, 3)))
    turn, centre = _origin(inertial)
    entries = inertial.find("inertia")
    assert entries is not None
    xx, xy, xz, yy, yz, zz = (float(entries.get(key, "0")) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    inertia = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    mass = float(inertial.find("mass").get("value"))  # type: ignore[union-attr, arg-type]
    return Link(parent, rotation, translation, name, axis, slides, mass, centre, inertia)


def _origin(element: ET.Element) -> tuple[np.ndarray, np.ndarray]:
    origin = element.find("origin")
    return euler(*_numbers(origin, "rpy", "0 0 0")), _numbers(origin, "xyz", "0 0 0")


def _numbers(element: ET.Element | None, key: str, default: str) -> np.ndarray:
    return np.array([float(word) for word in (default if element is None else element.get(key, default)).split()])
