"""A URDF's collision shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from lxml import etree

from costs.robot.errors import RobotError
from costs.robot.poses import format_numbers, parse_origin
from costs.robot.xmlfile import parse_number, parse_numbers, read_attribute

LONG_M = 20.0  # sizes beyond it may be in another unit [m]


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


def parse_shape(element: etree._Element, where: str, notes: list[str]) -> Shape | None:
    """Read and check one <collision>; return None for a shape without extent, and add a note."""
    geometry = element.find("geometry")
    if geometry is None or len(geometry) != 1:
        raise RobotError(f"{where}: <{element.tag}> needs a <geometry> with one shape in it")
    shape = geometry[0]
    kind, uri = str(shape.tag), ""
    if kind == "box":
        size = parse_numbers(read_attribute(shape, "size", where), 3, f"{where}: box size")
    elif kind == "sphere":
        size = parse_numbers(read_attribute(shape, "radius", where), 1, f"{where}: sphere radius")
    elif kind in ("cylinder", "capsule"):
        text = f"{read_attribute(shape, 'radius', where)} {read_attribute(shape, 'length', where)}"
        size = parse_numbers(text, 2, f"{where}: {kind} radius and length")
    elif kind == "ellipsoid":
        axes = [parse_number(read_attribute(shape, key, where), f"{where}: ellipsoid {key}") for key in "abc"]
        kind, size = "box", 2.0 * np.array(axes)
        notes.append(f"{where}: an ellipsoid is taken as the box around it")
        parent = shape.getparent()
        made = etree.SubElement(parent, "box", size=format_numbers(size))
        parent.remove(shape)
        shape = made
    elif kind == "mesh":
        uri = read_attribute(shape, "filename", where)
        size = parse_numbers(shape.get("scale", "1 1 1"), 3, f"{where}: mesh scale")
    else:
        raise RobotError(f"{where}: shape <{kind}> is not known; use box, sphere, cylinder, capsule or mesh")
    if kind != "mesh" and size.max() > LONG_M:
        notes.append(f"{where}: a {kind} of {size.max():g} m is read as it is; are these millimetres?")
    if kind == "mesh" and np.any(size == 0.0):
        raise RobotError(f"{where}: mesh scale {shape.get('scale')!r} flattens the mesh; no factor may be 0")
    if kind != "mesh" and np.all(size >= 0.0) and not np.any(size > 0.0):
        notes.append(f"{where}: a {kind} of size 0 is left out")
        return None
    if kind != "mesh" and np.any(size <= 0.0):
        raise RobotError(f"{where}: {kind} of size {format_numbers(size)}; every length must be positive")
    return Shape(kind, size, uri, parse_origin(element, where, notes), shape)
