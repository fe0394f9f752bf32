"""Robots with concave links: a URDF whose meshes of some links are split into convex parts."""

from __future__ import annotations

import copy
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from costs.robot import RobotModel
from service.errors import RequestError, shown, would_do
from service.scan.meshes import read_solid, split_convex

URDF_NAME = "robot.urdf"


def write_split_robot(robot: RobotModel, links: Sequence[str], folder: Path) -> dict[str, int]:
    """Write a robot's URDF and meshes to a folder, with convex parts in place of the meshes of some links.

    Its SRDF names the same links and stays as it is. Parts contain the surface to a millimetre.

    Returns:
        the number of parts by link.

    Raises:
        RequestError: a link that the robot does not have or whose shapes are no meshes, a mesh that cannot be split, or
            files that cannot be written.
    """
    from lxml import etree

    root = etree.fromstring(robot.source.urdf.encode(), etree.XMLParser(resolve_entities=False, no_network=True))
    known = {str(link.get("name")): link for link in root.iterfind("link")}
    problems = [
        f"--decompose: no link {shown(name)}; {would_do(name, list(known))}" for name in links if name not in known
    ]
    meshes = {name: [c for c in known[name].iterfind("collision") if c.find("geometry/mesh") is not None]
              for name in links if name in known}  # fmt: skip
    problems += [f"--decompose: {name} has no collision mesh" for name, own in meshes.items() if not own]
    if problems:
        raise RequestError(problems)
    parts = {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for key, source in robot.source.files.items():
            target = (folder / key).resolve()
            if not target.is_relative_to(folder.resolve()):
                raise RequestError(f"mesh path {shown(key)} leads out of {folder}")
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
        for name, collisions in meshes.items():
            parts[name] = sum(_split(collision, k, name, robot, folder) for k, collision in enumerate(collisions))
        (folder / URDF_NAME).write_bytes(etree.tostring(root, xml_declaration=True, encoding="utf-8"))
    except OSError as error:
        raise RequestError(f"{folder}: cannot be written ({error.strerror})") from None
    return parts


def _split(collision, number: int, link: str, robot: RobotModel, folder: Path) -> int:  # type: ignore[no-untyped-def]
    """Replace a collision element by one for each convex part of its mesh; return how many."""
    mesh = collision.find("geometry/mesh")
    uri = str(mesh.get("filename"))
    key = next((key for key in robot.source.files if uri == key or uri.endswith(f"/{key}")), None)
    if key is None:
        raise RequestError(f"--decompose: {link}: mesh {shown(uri)} is not found")
    solid = read_solid(folder / key, f"--decompose: {link}")
    found = split_convex(solid, link, f"--decompose: {link}")
    parent, place = collision.getparent(), collision.getparent().index(collision)
    parent.remove(collision)
    for k, vertices in enumerate(found):
        part = copy.deepcopy(collision)
        part.attrib.pop("name", None)
        file = f"parts/{link}_{number}_{k}.stl"
        part.find("geometry/mesh").set("filename", file)
        (folder / file).parent.mkdir(exist_ok=True)
        _write_hull(folder / file, vertices)
        parent.insert(place + k, part)
    return len(found)


def _write_hull(path: Path, vertices: Float[np.ndarray, "V 3"]) -> None:
    """Write the hull of points as a binary STL."""
    triangles = vertices[ConvexHull(vertices).simplices].astype("<f4")
    rows = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    rows["corners"] = triangles
    path.write_bytes(b"\0" * 80 + np.uint32(len(triangles)).tobytes() + rows.tobytes())
