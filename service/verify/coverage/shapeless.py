"""Links without a collision shape, or with a far too small one: place, and reach out of adjacent shapes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from weakref import WeakKeyDictionary
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.verify.certificate import Shapeless
from service.verify.coverage.link_tree import LinkTree
from service.verify.prepared_motion import PreparedMotion
from service.verify.solids import CoalSolid

_STEP_M = 0.02
_TOKEN_SHARE = 0.2  # of the longest side of the drawn shapes; genuine collision shapes cover most of it
# A link lighter than this is a frame with a mass for a simulator; its inertia gives no size [kg].
_LEAST_MASS_KG = 0.01
# So is one up to this mass whose inertia gives a box lighter than air; 10 g with 1e-4 kg m2 is common [kg, kg/m3].
_PLACEHOLDER_KG, _AIR_KG_M3 = 0.05, 1.2
_DISTANCES: WeakKeyDictionary[CoalSolid, dict[bytes, Float[np.ndarray, "P"]]] = WeakKeyDictionary()
_KEPT = 200  # sets of points for each solid
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def find_shapeless_links(prepared: PreparedMotion, tree: LinkTree) -> tuple[Shapeless, ...]:
    """List the robot's links (of no mechanism) that have no collision shape, or one far smaller than the link."""
    elements = _elements(prepared.motion.robot.source.urdf)
    return tuple(
        Shapeless(link, _place(tree, link), _reach(prepared, tree, link, elements.get(link)))
        for link in tree.joint
        if link not in prepared.motion.mechanism_links and (link not in tree.shaped or _has_token(prepared, link))
    )


def list_drawn_links(prepared: PreparedMotion) -> frozenset[str]:
    """Return the robot's links that have a drawn shape."""
    elements = _elements(prepared.motion.robot.source.urdf)
    return frozenset(link for link, element in elements.items() if element.find("visual") is not None)


def _has_token(prepared: PreparedMotion, link: str) -> bool:
    """Return whether a link's collision shapes are far smaller than its drawn shapes.

    A mesh read in the wrong unit, or boxes of a centimetre inside a forearm, would let it pass through walls.
    """
    drawn = _measure_drawn(prepared.motion.robot.source.urdf).get(link)
    if drawn is None:
        return False
    side, mesh_share = drawn
    shapes = [body.vertices for body in prepared.motion.robot.bodies if body.link == link]
    return (side > 0.0 and _side(shapes) < _TOKEN_SHARE * side) or mesh_share < _TOKEN_SHARE


@lru_cache(maxsize=4)
def _measure_drawn(urdf: str) -> Mapping[str, tuple[float, float]]:
    """Return by link the longest side of its drawn shapes [m], 0 without any, and ``_mesh_share``.

    Links whose drawn shapes are no numbers are left out: the loader does not validate them.
    """
    drawn = {}
    for link, element in _elements(urdf).items():
        try:
            side = max((_side([points]) for points in _list_drawn_boxes(element)), default=0.0)
            drawn[link] = side, _mesh_share(element)
        except ValueError:
            continue
    return drawn


def _mesh_share(element: ElementTree.Element) -> float:
    """Return the scale of a collision mesh as a share of its scale when drawn; 1 if no mesh is used for both."""
    drawn = {mesh.get("filename"): _scale_of(mesh) for mesh in element.findall("visual/geometry/mesh")}
    meshes = element.findall("collision/geometry/mesh")
    return min((_scale_of(mesh) / drawn.get(mesh.get("filename"), _scale_of(mesh)) for mesh in meshes), default=1.0)


def _scale_of(mesh: ElementTree.Element) -> float:
    return max(abs(float(value)) for value in mesh.get("scale", "1 1 1").split())


def _side(points: Sequence[Float[np.ndarray, "V 3"]]) -> float:
    """Return the longest side of the box around points [m]."""
    together = np.vstack(points)
    return float((together.max(axis=0) - together.min(axis=0)).max())


def _place(tree: LinkTree, link: str) -> str:
    if tree.mount[link] is None:
        return "root"
    return "between" if tree.first_shaped_below(link) else "end"


def _reach(prepared: PreparedMotion, tree: LinkTree, link: str, element: ElementTree.Element | None) -> float:
    """Return the size of a link, or how far it reaches out of the adjacent shapes if that is less [m]."""
    points = [np.zeros((0, 3))]
    # A fixed root is the world's frame: the line to its joints is no body.
    if tree.joint[link] > 0:
        points += list(_lines(prepared, tree, link))
    if element is not None:
        if _has_unknown_size(element):
            return float("nan")
        try:
            points += [*_list_drawn_boxes(element), *_mass_box(element)]
        except ValueError:  # the loader does not validate drawn shapes
            return float("nan")
    in_link = np.vstack(points)
    if not len(in_link):
        return 0.0
    mount = tree.mount[link]
    near = tree.first_shaped_below(link) | ({mount} if mount else set())
    near |= {other for other in tree.shaped if tree.joint[other] == tree.joint[link]}
    placed, rows = prepared.at(prepared.motion.curve.knots[:1])
    frame = prepared.motion.robot.model.frames[prepared.motion.robot.model.getFrameId(link, pin.FrameType.BODY)]
    in_joint = in_link @ np.array(frame.placement.rotation).T + np.array(frame.placement.translation)
    distance = np.full(len(in_link), np.inf)
    for solid in (CoalSolid.of_body(body) for body in prepared.motion.robot.bodies if body.link in near):
        rotation, translation = placed.relative(solid.joint, tree.joint[link], rows)
        distance = np.minimum(distance, _measure(solid, in_joint @ rotation[0].T + translation[0]))
    size = float((in_link.max(axis=0) - in_link.min(axis=0)).max())
    return min(size, float(distance.max()))


def _measure(solid: CoalSolid, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P"]:
    """Return distances of points from a solid, known from other motions that begin in the same pose [m]."""
    known = _DISTANCES.setdefault(solid, {})
    key = points.tobytes()
    if key not in known:
        if len(known) >= _KEPT:
            known.clear()
        known[key] = solid.distances(points)
    return known[key]


def _lines(prepared: PreparedMotion, tree: LinkTree, link: str) -> Iterator[Float[np.ndarray, "P 3"]]:
    """Yield points on the lines from a link's origin to the moving joints that it carries, in its own frame [m]."""
    model = prepared.motion.robot.model
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    for below in tree.children[link]:
        joint = tree.joint[below]
        if joint == tree.joint[link]:
            continue
        end = frame.placement.actInv(model.jointPlacements[joint]).translation
        count = 2 + int(np.linalg.norm(end) / _STEP_M)
        yield np.linspace(0.0, 1.0, count)[:, None] * np.asarray(end)


@lru_cache(maxsize=4)
def _elements(urdf: str) -> Mapping[str, ElementTree.Element]:
    if not urdf:
        return {}
    return {str(element.get("name")): element for element in ElementTree.fromstring(urdf).findall("link")}


def _mass_of(element: ElementTree.Element) -> float:
    mass = element.find("inertial/mass")
    return 0.0 if mass is None else float(mass.get("value", "0"))


def _has_unknown_size(element: ElementTree.Element) -> bool:
    """Return whether the link is drawn as a mesh, which is not loaded, and has no mass to give its size."""
    return element.find("visual/geometry/mesh") is not None and not _mass_of(element) >= _LEAST_MASS_KG


def _list_drawn_boxes(element: ElementTree.Element) -> Iterator[Float[np.ndarray, "8 3"]]:
    """Yield corners of boxes around the link's drawn shapes, in its frame [m]."""
    for visual in element.findall("visual"):
        for shape in visual.findall("geometry/*"):
            size = _box_of(shape)
            if size is not None:
                yield _place_points(_CORNERS * size, visual)


def _box_of(shape: ElementTree.Element) -> Float[np.ndarray, "3"] | None:
    if shape.tag == "box":
        return np.array([float(value) for value in shape.get("size", "0 0 0").split()])
    if shape.tag in ("sphere", "cylinder", "capsule"):
        across = 2.0 * float(shape.get("radius", "0"))
        caps = across if shape.tag != "cylinder" else 0.0
        return np.array([across, across, float(shape.get("length", "0")) + caps])
    return None


def _mass_box(element: ElementTree.Element) -> Iterator[Float[np.ndarray, "8 3"]]:
    """Yield corners of the uniform box that has the link's mass and moments of inertia, in its frame [m].

    Nothing where mass and inertia are those of a frame.
    """
    inertial, mass = element.find("inertial"), _mass_of(element)
    inertia = element.find("inertial/inertia")
    if inertial is None or inertia is None or not mass >= _LEAST_MASS_KG:
        return
    xx, yy, zz = (float(inertia.get(key, "0")) for key in ("ixx", "iyy", "izz"))
    squares = 6.0 / mass * np.array([yy + zz - xx, xx + zz - yy, xx + yy - zz])
    sides = np.sqrt(np.maximum(squares, 0.0))
    if mass > _PLACEHOLDER_KG or mass >= _AIR_KG_M3 * np.prod(sides):
        yield _place_points(_CORNERS * sides, inertial)


def _place_points(points: Float[np.ndarray, "V 3"], element: ElementTree.Element) -> Float[np.ndarray, "V 3"]:
    origin = element.find("origin")
    if origin is None:
        return points
    xyz, rpy = (np.array([float(v) for v in origin.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
    return np.asarray(points @ pin.rpy.rpyToMatrix(*rpy).T + xyz)
