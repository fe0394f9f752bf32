"""A URDF's collision shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from lxml import etree

from costs.robot.errors import RobotError
from costs.robot.poses import joined, parse_origin
from costs.robot.xmlfile import numbers, required


@dataclass(frozen=True)
class Shape:
    """One <collision> element.

    Attributes:
        kind: ``box``, ``sphere``, ``cylinder``, ``capsule`` or ``mesh``.
        size: box: full edge lengths (3,); sphere: radius; cylinder and capsule: radius, length along z (a capsule's
            without its caps); mesh: scale (3,) [m, -].
        uri: the mesh as the URDF names it ("" otherwise).
        pose_link_shape: (4, 4).
        element: the <geometry> child it came from.
    """

    kind: str
    size: Float[np.ndarray, "k"]
    uri: str
    pose_link_shape: Float[np.ndarray, "4 4"]
    element: etree._Element


def parse_shape(element: etree._Element, where: str) -> Shape:
    """Read and check one <collision>."""
    geometry = element.find("geometry")
    if geometry is None or len(geometry) != 1:
        raise RobotError(f"{where}: <collision> needs a <geometry> with one shape in it")
    shape = geometry[0]
    kind, uri = str(shape.tag), ""
    if kind == "box":
        size = numbers(required(shape, "size", where), 3, f"{where}: box size")
    elif kind == "sphere":
        size = numbers(required(shape, "radius", where), 1, f"{where}: sphere radius")
    elif kind in ("cylinder", "capsule"):
        text = f"{required(shape, 'radius', where)} {required(shape, 'length', where)}"
        size = numbers(text, 2, f"{where}: {kind} radius and length")
    elif kind == "mesh":
        uri = required(shape, "filename", where)
        size = numbers(shape.get("scale", "1 1 1"), 3, f"{where}: mesh scale")
    else:
        raise RobotError(f"{where}: shape <{kind}> is not known; use box, sphere, cylinder, capsule or mesh")
    if kind == "mesh" and np.any(size == 0.0):
        raise RobotError(f"{where}: mesh scale {shape.get('scale')!r} flattens the mesh; no factor may be 0")
    if kind != "mesh" and np.any(size <= 0.0):
        raise RobotError(f"{where}: {kind} of size {joined(size)}; every length must be positive")
    return Shape(kind, size, uri, parse_origin(element, where), shape)
