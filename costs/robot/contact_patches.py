"""Contact patches of a robot: where its links may carry force, checked against the surfaces of its bodies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import yaml
from jaxtyping import Float

from costs.contact import Contact
from costs.names import would_do
from costs.primitive import Primitive
from costs.robot.errors import RobotError
from costs.robot.model import LinkBody, RobotModel

PatchKind = Literal["foot", "trunk", "arm"]

SURFACE_TOLERANCE_M = 2e-3
NORMAL_TOLERANCE_DEG = 15.0


@dataclass(frozen=True)
class PatchDefaults:
    """Defaults of a kind of patch.

    Attributes:
        friction: coefficient.
        force_cap_n: largest normal force of each point [N].
    """

    friction: float
    force_cap_n: float


# A foot's corner may carry all of Atlas (1556 N). An arm's cap keeps elbow and shoulder within about 80 % of their
# torque where the forearm presses at the wrist, 0.3 m from the elbow.
PATCH_DEFAULTS: Mapping[PatchKind, PatchDefaults] = {
    "foot": PatchDefaults(0.6, 1600.0),
    "trunk": PatchDefaults(0.4, 400.0),
    "arm": PatchDefaults(0.4, 150.0),
}


@dataclass(frozen=True)
class PatchData:
    """A patch as it is written; what is None comes from the robot's own patch of that name, else from the kind.

    Attributes:
        link: a link of the robot with a body.
        points: points in the link's frame [m].
        normal: direction of any length, for all points, in which the surroundings push on the link.
        kind: gives the defaults of friction and cap; without a kind and a patch of that name those of ``arm``.
        friction: coefficient.
        force_cap_n: largest normal force of each point [N].
    """

    link: str | None = None
    points: Sequence[Sequence[float]] | None = None
    normal: Sequence[float] | None = None
    kind: PatchKind | None = None
    friction: float | None = None
    force_cap_n: float | None = None


def read_patches(path: Path) -> dict[str, Contact]:
    """Read the patches by name of a bundled robot's YAML file; their surfaces are not checked."""
    data = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
    return {name: make_patch(PatchData(**fields)) for name, fields in data.items()}


def make_patch(data: PatchData, known: Contact | None = None) -> Contact:
    """Make a contact of what is written, completed by the robot's own patch of that name, if any.

    Raises:
        RobotError: one line that begins with the field: a field is missing, or a value cannot be used.
    """
    if data.kind is not None and data.kind not in PATCH_DEFAULTS:
        raise RobotError(f"kind: unknown kind '{data.kind}'; expected {would_do(data.kind, get_args(PatchKind))}")
    if known is None:
        for field in ("link", "points", "normal"):
            if getattr(data, field) is None:
                raise RobotError(f"{field}: is missing; the robot has no patch of that name to take it from")
    defaults = PATCH_DEFAULTS[data.kind or "arm"]
    friction, cap = data.friction, data.force_cap_n
    if known is not None and data.kind is None:
        friction = known.friction if friction is None else friction
        cap = known.force_cap_n if cap is None else cap
    points = np.array(data.points, dtype=float) if data.points is not None or known is None else known.points
    if data.normal is not None or known is None:
        normal = np.array(data.normal, dtype=float)
        length = np.linalg.norm(normal)
        if normal.shape != (3,) or not np.isfinite(length) or length < 1e-6:
            raise RobotError(f"normal: expected three numbers of a direction, got {data.normal}")
        normals = np.tile(normal / length, (len(points), 1))
    else:
        normals = np.resize(known.normals, (len(points), 3))
    link = data.link if data.link is not None or known is None else known.link
    friction = defaults.friction if friction is None else friction
    cap = defaults.force_cap_n if cap is None else cap
    try:
        return Contact(str(link), points, normals, friction, cap)
    except ValueError as error:
        raise RobotError(str(error)) from None


def with_contacts(robot: RobotModel, patches: Mapping[str, PatchData]) -> RobotModel:
    """Return the robot with further contact patches; one of a known name replaces it, field by field.

    Raises:
        RobotError: one line that names the patch (``NAME.points[2]: ...``): a field is missing or cannot be used, the
            link is unknown or has no body, a point is farther than ``SURFACE_TOLERANCE_M`` from the surface of the
            link's bodies, or the normal differs from the surface's by more than ``NORMAL_TOLERANCE_DEG``.
    """
    contacts = dict(robot.contacts)
    for name, data in patches.items():
        try:
            contacts[name] = make_patch(data, robot.contacts.get(name))
        except RobotError as error:
            raise RobotError(f"{name}.{error}") from None
        problem = next(find_surface_problems(robot, contacts[name]), None)
        if problem is not None:
            raise RobotError(f"{name}.{problem}")
    return replace(robot, contacts=contacts)


def find_surface_problems(robot: RobotModel, contact: Contact) -> Iterator[str]:
    """Yield one line per point of a contact that is not on the surface of its link's bodies, or per wrong normal.

    The surface is that of the union of the link's convex bodies; round shapes count as they are, not as the polytopes
    around them.
    """
    bodies = [body for body in robot.bodies if body.link == contact.link]
    if not bodies:
        links = sorted({body.link for body in robot.bodies} - robot.mechanism_links)
        is_link = robot.model.existFrame(contact.link)
        words = f"'{contact.link}' has no body to touch with" if is_link else f"unknown link '{contact.link}'"
        yield f"link: {words}; {robot.name} has {would_do(contact.link, links)}"
        return
    placement = robot.model.frames[int(robot.model.getFrameId(contact.link))].placement
    for k, (point, normal) in enumerate(zip(contact.points, contact.normals, strict=True)):
        at, outward = placement.act(point), -placement.rotation @ normal
        surfaces = [_find_surface(body, at) for body in bodies]
        signed, cone = min(surfaces, key=lambda surface: surface[0])
        if abs(signed) > SURFACE_TOLERANCE_M:
            side = "outside" if signed > 0.0 else "inside"
            yield (
                f"points[{k}]: lies {1e3 * abs(signed):.1f} mm {side} the bodies of {contact.link}; "
                f"expected on the surface within {1e3 * SURFACE_TOLERANCE_M:g} mm"
            )
            continue
        angle = _measure_angle(cone, outward)
        if angle > NORMAL_TOLERANCE_DEG:
            # The face that is meant, also where the sign is wrong.
            expected = placement.rotation.T @ -cone[np.abs(cone @ outward).argmax()]
            words = ", ".join(f"{value:.2f}" for value in expected + 0.0)
            yield (
                f"normal: is {angle:.0f} deg off the surface of {contact.link} at points[{k}]; the surroundings push "
                f"into the link, expected [{words}] within {NORMAL_TOLERANCE_DEG:g} deg"
            )


def measure_surface_distance(body: LinkBody, point: Float[np.ndarray, "3"]) -> float:
    """Return the signed distance of a point from a body's surface, in the frame of its joint [m]; negative inside."""
    return _find_surface(body, point)[0]


def _find_surface(body: LinkBody, point: Float[np.ndarray, "3"]) -> tuple[float, Float[np.ndarray, "K 3"]]:
    """Return the signed distance from a body's surface [m], negative inside, and the outward normals near the point."""
    return _find_hull_surface(body.vertices, point) if body.exact is None else _find_round_surface(body.exact, point)


def _find_hull_surface(
    vertices: Float[np.ndarray, "V 3"], point: Float[np.ndarray, "3"]
) -> tuple[float, Float[np.ndarray, "K 3"]]:
    from scipy.spatial import ConvexHull  # slow to import

    hull = ConvexHull(vertices)
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    is_inside = bool((normals @ point + offsets).max() <= 0.0)
    corners = vertices[hull.simplices]
    distances = np.linalg.norm(_find_nearest_on_triangles(corners, point) - point, axis=1)
    nearest = float(distances.min())
    return -nearest if is_inside else nearest, normals[distances <= nearest + 0.1 * SURFACE_TOLERANCE_M]


def _find_nearest_on_triangles(
    corners: Float[np.ndarray, "F 3 3"], point: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "F 3"]:
    """Return the nearest point of each triangle: the foot of the perpendicular if it is inside, else on an edge."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    uu, uv, vv = (np.einsum("fi,fi->f", x, y) for x, y in ((u, u), (u, v), (v, v)))
    du, dv = np.einsum("fi,fi->f", u, point - a), np.einsum("fi,fi->f", v, point - a)
    area = np.maximum(uu * vv - uv * uv, 1e-30)
    s, t = (vv * du - uv * dv) / area, (uu * dv - uv * du) / area
    best = a + s[:, None] * u + t[:, None] * v
    is_outside = (s < 0.0) | (t < 0.0) | (s + t > 1.0)
    best[is_outside] = np.inf
    for first, second in ((0, 1), (1, 2), (2, 0)):
        start, along = corners[:, first], corners[:, second] - corners[:, first]
        share = np.einsum("fi,fi->f", point - start, along) / np.einsum("fi,fi->f", along, along)
        on_edge = start + np.clip(share, 0.0, 1.0)[:, None] * along
        is_nearer = np.linalg.norm(on_edge - point, axis=1) < np.linalg.norm(best - point, axis=1)
        best[is_nearer] = on_edge[is_nearer]
    return np.asarray(best)


def _find_round_surface(shape: Primitive, point: Float[np.ndarray, "3"]) -> tuple[float, Float[np.ndarray, "K 3"]]:
    rotation = shape.pose[:3, :3]
    x, y, z = rotation.T @ (point - shape.pose[:3, 3])
    half = 0.5 * shape.length
    if shape.kind != "cylinder":  # distance from the capsule's axis, or from the sphere's centre
        offset = np.array([x, y, z - np.clip(z, -half, half)])
        reach = float(np.linalg.norm(offset))
        normal = offset / reach if reach > 0.0 else np.array([0.0, 0.0, 1.0])
        return reach - shape.radius, (rotation @ normal)[None]
    across = float(np.hypot(x, y))
    side, end = across - shape.radius, abs(z) - half
    signed = min(max(side, end), 0.0) + float(np.hypot(max(side, 0.0), max(end, 0.0)))
    cone = []
    if side >= -SURFACE_TOLERANCE_M and across > 0.0:
        cone.append([x / across, y / across, 0.0])
    if end >= -SURFACE_TOLERANCE_M or not cone:
        cone.append([0.0, 0.0, np.sign(z) or 1.0])
    return signed, np.array(cone) @ rotation.T


def _measure_angle(cone: Float[np.ndarray, "K 3"], direction: Float[np.ndarray, "3"]) -> float:
    """Return the angle of a unit vector from the cone that unit vectors span [deg], 90 where it points away from it."""
    from scipy.optimize import nnls  # slow to import, and rarely needed

    _, rest = nnls(cone.T, direction)
    return float(np.rad2deg(np.arcsin(min(rest, 1.0))))
