"""Masses and moments of inertia of a URDF's links: read, checked, and joined where links move together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from lxml import etree

from costs.robot.errors import RobotError
from costs.robot.poses import parse_origin
from costs.robot.xmlfile import parse_number, read_attribute

INERTIA_ROUNDING = 1e-2  # of files that write few digits: principal moments this far below zero, of the largest
LEAST_INERTIA = 1e-6  # moments smaller than this count as zero [kg m^2]
PLAIN_EXCESS = 1.1  # of the largest principal moment over the sum of the others, from which a note says so
PLAIN_INERTIA, PLAIN_MASS = 1e-3, 0.2  # less of it cannot matter, so that no note speaks of it [kg m^2, kg]
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True)
class LinkInertia:
    """Mass of a rigid body in some frame.

    Attributes:
        mass: [kg].
        centre: (3,) of mass [m].
        moments: (3, 3) moments of inertia about the centre of mass, along the frame's axes [kg m^2].
    """

    mass: float
    centre: Float[np.ndarray, "3"]
    moments: Float[np.ndarray, "3 3"]

    def make(self, what: str) -> pin.Inertia:
        """Return it as pinocchio has it.

        Args:
            what: has it, in messages.

        Raises:
            RobotError: no body has it: a negative mass or moment, moments that are not symmetric, or wrong shapes.
        """
        shapes = (np.shape(self.centre), np.shape(self.moments))
        if shapes != ((3,), (3, 3)):
            raise RobotError(f"{what}: centre and moments have the shapes {shapes}; expected (3,) and (3, 3)")
        if self.mass < 0.0:
            raise RobotError(f"{what}: mass {self.mass:g} is negative")
        try:
            return pin.Inertia(self.mass, self.centre, self.moments)
        except RuntimeError as error:
            raise RobotError(f"{what}: no body of {self.mass:g} kg has its moments of inertia: {error}") from None

    def move(self, pose: Float[np.ndarray, "4 4"]) -> LinkInertia:
        """Return the body in the frame that ``pose`` leads to."""
        turn = pose[:3, :3]
        return LinkInertia(self.mass, turn @ self.centre + pose[:3, 3], turn @ self.moments @ turn.T)

    def join(self, other: LinkInertia) -> LinkInertia:
        """Return both bodies of the same frame as one (parallel axes)."""
        mass = self.mass + other.mass
        if mass == 0.0:
            return LinkInertia(0.0, self.centre, self.moments + other.moments)
        centre = (self.mass * self.centre + other.mass * other.centre) / mass
        moments = np.zeros((3, 3))
        for body in (self, other):
            off = body.centre - centre
            moments += body.moments + body.mass * (float(off @ off) * np.eye(3) - np.outer(off, off))
        return LinkInertia(mass, centre, moments)


def spread_mass(parts: Sequence[Float[np.ndarray, "V 3"]], mass: float) -> LinkInertia:
    """Return the inertia of hulls of one even density: the sum of the tetrahedra over their triangles."""
    from scipy.spatial import ConvexHull  # slow to import

    tetrahedra, insides = [], []
    for vertices in parts:
        inside = vertices.mean(axis=0)
        corners = vertices[ConvexHull(vertices).simplices] - inside
        tetrahedra.append(corners)
        insides.append(np.broadcast_to(inside, (len(corners), 3)))
    corners, inside = np.concatenate(tetrahedra), np.concatenate(insides)
    volumes = np.abs(np.linalg.det(corners)) / 6.0
    share = mass * volumes / volumes.sum()
    centres = inside + corners.sum(axis=1) / 4.0
    centre = share @ centres / mass
    # Second moments of a tetrahedron of four corners: (sum x)(sum x)^T + sum x x^T over 20.
    corners = np.concatenate([corners, np.zeros((len(corners), 1, 3))], axis=1) + (inside - centre)[:, None]
    sums = corners.sum(axis=1)
    second = np.einsum("t,ti,tj->ij", share, sums, sums) + np.einsum("t,tki,tkj->ij", share, corners, corners)
    second = second / 20.0
    return LinkInertia(mass, centre, np.trace(second) * np.eye(3) - second)


def parse_inertial(
    element: etree._Element, where: str, notes: list[str], *, is_robot: bool = True
) -> LinkInertia | None:
    """Read and check the <inertial> of a <link>; remove one that lacks mass or inertia, with a note.

    The weight of a mechanism counts without moments of inertia, too.

    Raises:
        RobotError: a number is missing or not finite, or a mass or a principal moment is negative.
    """
    inertial = element.find("inertial")
    if inertial is None:
        return None
    pose = parse_origin(inertial, f"{where}: inertial", notes)
    mass_element, inertia = inertial.find("mass"), inertial.find("inertia")
    if inertia is None and mass_element is not None and not is_robot:
        inertia = etree.Element("inertia", dict.fromkeys(_MOMENTS, "0"))
    if mass_element is None or inertia is None:
        lacking = "mass" if mass_element is None else "inertia"
        notes.append(f"{where}: <inertial> lacks <{lacking}>; the link counts as massless")
        element.remove(inertial)
        return None
    mass = parse_number(read_attribute(mass_element, "value", where), f"{where}: mass")
    if mass < 0.0:
        raise RobotError(f"{where}: mass {mass_element.get('value')} is negative")
    ixx, ixy, ixz, iyy, iyz, izz = (
        parse_number(read_attribute(inertia, key, where), f"{where}: inertia {key}") for key in _MOMENTS
    )
    for key, value in (("ixx", ixx), ("iyy", iyy), ("izz", izz)):
        if value < -LEAST_INERTIA:
            raise RobotError(f"{where}: inertia {key} is {value:g}; a moment of inertia is never negative")
    moments = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    _check_principal(moments, mass, where, notes)
    return LinkInertia(mass, np.zeros(3), moments).move(pose)


def _check_principal(moments: Float[np.ndarray, "3 3"], mass: float, where: str, notes: list[str]) -> None:
    """Refuse negative principal moments; add a note about moments that no body has."""
    least, middle, most = np.linalg.eigvalsh(moments).tolist()
    if least < -max(INERTIA_ROUNDING * most, LEAST_INERTIA):
        raise RobotError(
            f"{where}: inertia has the principal moments {least:.3g} to {most:.3g}; none may be negative: "
            "ixy, ixz or iyz is too large"
        )
    if most > PLAIN_EXCESS * (least + middle) and most > PLAIN_INERTIA:
        notes.append(
            f"{where}: no body has its <inertia>, whose largest principal moment exceeds the sum of the others"
        )
    if not moments.any() and mass >= PLAIN_MASS:
        notes.append(f"{where}: its mass has no moments of inertia; it counts as a point at its centre of mass")
