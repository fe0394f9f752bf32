"""Concave meshes of a robot's links, replaced by convex parts in its URDF."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from lxml import etree

from costs.names import would_do
from costs.robot.errors import RobotError
from costs.robot.mesh.kept import keep_triangles
from costs.robot.mesh.locate import resolve_mesh
from costs.robot.mesh.read import Mesh, read_mesh
from costs.robot.xmlfile import parse_numbers, read_attribute

MeshSplit = Callable[[Mesh, str], Sequence[Float[np.ndarray, "V 3"]]]
"""Return the vertices of convex parts that contain a mesh of the given name [m]; one part where it is convex."""


@dataclass(frozen=True)
class LinkSplit:
    """Links whose collision meshes are split into convex parts.

    Attributes:
        links: their names.
        split: splits a mesh in metres.
    """

    links: tuple[str, ...]
    split: MeshSplit

    def apply(
        self, elements: Mapping[str, etree._Element], roots: Sequence[Path], where: str, notes: list[str]
    ) -> None:
        """Put convex parts in the place of the links' collision meshes, in place; those that are convex stay.

        Args:
            elements: <link> elements by name.
            roots: folders that meshes are read from.
            where: names the URDF in messages.
            notes: get a line for each link.

        Raises:
            RobotError: a link is unknown or has no collision mesh, or a mesh cannot be read or split.
        """
        for link in self.links:
            if link not in elements:
                raise RobotError(f"{where}: decompose: unknown link '{link}'; expected {would_do(link, elements)}")
            shapes = [c for c in elements[link].findall("collision") if c.find("geometry/mesh") is not None]
            if not shapes:
                raise RobotError(
                    f"{where}: decompose: link '{link}' has no collision mesh; other shapes are convex, leave it out"
                )
            count = sum(self._replace(shape, f"{link}_{k}", roots, f"{where}: link '{link}'")
                        for k, shape in enumerate(shapes))  # fmt: skip
            notes.append(f"link '{link}': its collision meshes are split into {count} convex parts, to a millimetre")

    def _replace(self, collision: etree._Element, name: str, roots: Sequence[Path], where: str) -> int:
        """Replace a collision element by one for each convex part of its mesh; return how many."""
        from scipy.spatial import ConvexHull  # slow to import

        element = collision.find("geometry/mesh")
        parent = collision.getparent()
        if element is None or parent is None:
            return 0
        path = resolve_mesh(read_attribute(element, "filename", where), roots, where)[1]
        scale = parse_numbers(element.get("scale", "1 1 1"), 3, f"{where}: mesh scale")
        mesh = read_mesh(path, where)
        parts = self.split(Mesh(mesh.vertices * scale, mesh.faces), name)
        if len(parts) < 2:
            return 1
        place = parent.index(collision)
        parent.remove(collision)
        for k, vertices in enumerate(parts):
            part = copy.deepcopy(collision)
            part.attrib.pop("name", None)
            file = keep_triangles(vertices[ConvexHull(vertices).simplices])
            geometry = part.find("geometry")
            if geometry is not None:
                geometry[:] = [etree.Element("mesh", filename=file)]
            parent.insert(place + k, part)
        return len(parts)
