"""Convex parts of the meshes of a robot's links."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import LinkSplit, RobotError, RobotModel, Triangles, read_triangles

CONCAVE_SHARE = 0.9


def split_links(links: Sequence[str]) -> LinkSplit | None:
    """Return how a robot's links are split by CoACD (Wei et al., SIGGRAPH 2022); None where none are.

    Parts are kept in the user's cache folder. They contain the surface to a millimetre and follow it to about 1 cm.
    """
    return LinkSplit(tuple(links), _split_mesh) if links else None


def _split_mesh(mesh: Triangles, name: str) -> Sequence[Float[np.ndarray, "V 3"]]:
    from perception import PerceptionError  # takes a while, and most robots need none
    from perception.solids.decompose import split_solid
    from perception.solids.mesh import Mesh, make_solid

    try:
        return split_solid(make_solid(Mesh(mesh.vertices, mesh.faces), name), name=name)
    except PerceptionError as error:
        raise RobotError(f"decompose: {error}") from None


def suggest_split(robot: RobotModel, split: Collection[str], links: Iterable[str]) -> tuple[str, ...]:
    """Return a sentence that names the field by which concave links count as they are; nothing where none is concave.

    Args:
        robot: the robot.
        split: links that are split already.
        links: those that overlap with something.
    """
    concave = [link for link in dict.fromkeys(links) if link not in split and _is_concave(robot, link)]
    if not concave:
        return ()
    names = ", ".join(concave)
    meshes = f"the mesh of {names} is" if len(concave) == 1 else f"the meshes of {names} are"
    whose = "its convex hull counts" if len(concave) == 1 else "their convex hulls count"
    return (f"{meshes} concave, and {whose}; robot.decompose: [{names}] takes convex parts instead",)


def _is_concave(robot: RobotModel, link: str) -> bool:
    """Return whether a collision mesh of a link fills its hull to less than ``CONCAVE_SHARE``."""
    from lxml import etree
    from scipy.spatial import ConvexHull, QhullError

    root = etree.fromstring(robot.source.urdf.encode(), etree.XMLParser(resolve_entities=False, no_network=True))
    for element in root.iterfind("link"):
        if element.get("name") != link:
            continue
        for mesh in element.iterfind("collision/geometry/mesh"):
            uri = str(mesh.get("filename"))
            path = next(
                (path for key, path in robot.source.files.items() if uri == key or uri.endswith(f"/{key}")), None
            )
            if path is None:
                continue
            try:
                read = read_triangles(path, path.name)
                hull = float(ConvexHull(read.vertices).volume)
            except (RobotError, QhullError):
                continue
            a, b, c = np.moveaxis(read.vertices[read.faces] - read.vertices.mean(axis=0), 1, 0)
            if abs(float((a * np.cross(b, c)).sum())) / 6.0 < CONCAVE_SHARE * hull:
                return True
    return False
