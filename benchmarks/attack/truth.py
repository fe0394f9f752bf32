"""Independent check of a motion without code of scopt: dense samples, pinocchio, coal's exact shapes.

The robot is read from an honest URDF by this module alone (collision shapes, or visual ones where a lie is about the
former); links that one joint connects may touch, all else must keep clear.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import coal
import numpy as np
import pinocchio as pin
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

SAMPLES = 400


@dataclass(frozen=True)
class Solid:
    """A shape of a link or of the world, placed in the frame of its joint."""

    name: str
    joint: int
    shape: Any
    placement: pin.SE3


@dataclass(frozen=True)
class Depth:
    """Overlap of two shapes [m]; negative if they are apart."""

    metres: float
    pair: tuple[str, str]


class Truth:
    """The correct robot among the obstacles of a request."""

    def __init__(self, urdf: str, folder: Path, tag: str = "collision") -> None:
        root = ET.fromstring(urdf)
        self.model = pin.buildModelFromXML(_without_shapes(root))
        self.neighbours = _neighbours(root)
        self.solids = [
            Solid(name, joint, _shape(shape, folder), self._in_joint(name, _origin(shape)))
            for link in root.findall("link")
            for name, joint in [self._carrier(link.get("name", ""))]
            for shape in link.findall(tag)
        ]

    def deepest(
        self,
        names: Iterable[str],
        positions: np.ndarray,
        obstacles: Iterable[Mapping[str, Any]],
        may_touch: Iterable[tuple[str, str]] = (),
    ) -> Depth:
        """Return the deepest overlap of a motion; ``positions`` has a column for each of ``names``.

        Args:
            names: of joints.
            positions: (S, n) [rad, m].
            obstacles: of a request.
            may_touch: further pairs that are ignored.
        """
        world = [Solid(str(o["name"]), 0, _primitive(o), _pose(o)) for o in obstacles]
        columns = [int(self.model.joints[self.model.getJointId(name)].idx_q) for name in names]
        free = self.neighbours | {frozenset(pair) for pair in may_touch}
        own = [(a, b) for a, b in itertools.combinations(self.solids, 2) if a.joint != b.joint]
        pairs = [(a, b) for a, b in own if frozenset((a.name, b.name)) not in free]
        pairs += [(a, b) for a in self.solids for b in world if frozenset((a.name, b.name)) not in free]
        data, q, worst = self.model.createData(), pin.neutral(self.model), Depth(-np.inf, ("", ""))
        for row in positions:
            q[columns] = row
            pin.forwardKinematics(self.model, data, q)
            for a, b in pairs:
                depth = -_distance(a, data.oMi[a.joint] * a.placement, b, data.oMi[b.joint] * b.placement)
                if depth > worst.metres:
                    worst = Depth(depth, (a.name, b.name))
        return worst

    def _carrier(self, link: str) -> tuple[str, int]:
        return link, int(self.model.frames[self.model.getFrameId(link, pin.FrameType.BODY)].parentJoint)

    def _in_joint(self, link: str, placement: pin.SE3) -> pin.SE3:
        return self.model.frames[self.model.getFrameId(link, pin.FrameType.BODY)].placement * placement


def _without_shapes(root: ET.Element) -> str:
    copy = ET.fromstring(ET.tostring(root))
    for link in copy.findall("link"):
        for tag in ("visual", "collision"):
            for shape in link.findall(tag):
                link.remove(shape)
    return ET.tostring(copy, encoding="unicode")


def _neighbours(root: ET.Element) -> set[frozenset[str]]:
    """Return pairs of links connected by one joint; links fixed to each other count as one."""
    joints = [
        (j.find("parent").get("link"), j.find("child").get("link"), j.get("type"))  # type: ignore[union-attr]
        for j in root.findall("joint")
    ]
    return {frozenset((str(a), str(b))) for a, b, kind in joints if kind != "fixed"}


def _origin(element: ET.Element) -> pin.SE3:
    origin = element.find("origin")
    given = {} if origin is None else origin.attrib
    xyz, rpy = (np.array([float(v) for v in given.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
    return pin.SE3(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)


def _shape(element: ET.Element, folder: Path) -> Any:
    shape = element.find("geometry")[0]  # type: ignore[index]
    if shape.tag == "mesh":
        mesh = trimesh.load(folder / str(shape.get("filename")), force="mesh")
        scale = np.array([float(v) for v in shape.get("scale", "1 1 1").split()])
        return _hull(np.asarray(mesh.vertices) * scale)
    numbers = {key: float(value) for key, value in shape.attrib.items() if key != "size"}
    size = [float(v) for v in shape.get("size", "").split()]
    return _solid(shape.tag, size, numbers.get("radius", 0.0), numbers.get("length", 0.0))


def _primitive(obstacle: Mapping[str, Any]) -> Any:
    if obstacle["type"] == "convex":
        return _hull(np.array(obstacle["points"], dtype=float))
    radius, height = float(obstacle.get("radius", 0.0)), float(obstacle.get("height", 0.0))
    return _solid(obstacle["type"], obstacle.get("size", []), radius, height)


def _solid(kind: str, size: list[float], radius: float, height: float) -> Any:
    match kind:
        case "box":
            return coal.Box(*size)
        case "sphere":
            return coal.Sphere(radius)
        case "cylinder":
            return coal.Cylinder(radius, height)
        case "capsule":
            return coal.Capsule(radius, height)
    raise ValueError(f"no solid is called {kind!r}")


def _hull(points: np.ndarray) -> Any:
    hull = ConvexHull(points)
    a, b, c = points[hull.simplices].transpose(1, 0, 2)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    corners.extend(list(points))
    triangles.extend([coal.Triangle(*face) for face in faces.tolist()])
    return coal.Convex(corners, triangles)


def _pose(obstacle: Mapping[str, Any]) -> pin.SE3:
    turn = Rotation.from_quat(obstacle.get("quaternion_wxyz", [1.0, 0.0, 0.0, 0.0]), scalar_first=True)
    return pin.SE3(turn.as_matrix(), np.array(obstacle["position"], dtype=float))


def _distance(a: Solid, at_a: pin.SE3, b: Solid, at_b: pin.SE3) -> float:
    poses = [coal.Transform3s(at.rotation, at.translation) for at in (at_a, at_b)]
    return float(coal.distance(a.shape, poses[0], b.shape, poses[1], coal.DistanceRequest(), coal.DistanceResult()))


def dense(curve: Any) -> np.ndarray:
    """Return dense configurations along a curve."""
    return np.asarray(curve(np.linspace(curve.knots[0], curve.knots[-1], SAMPLES)))
