"""Proof that contact forces hold the robot wherever its centre of mass is in a recorded region: sums and dot products.

A recorded region is a polygon in (x, y) with contact forces (witnesses) for each of its vertices and each of some
wrenches.  Friction cones, force caps and balances are convex: a centre of mass that is a combination of vertices, under
a combination of wrenches, is held by the same combination of witnesses (Bretl and Lall, T-RO 2008).  Nothing of the
code that finds regions is used here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Forces may be off by this share of the weight, moments by the same share times 1 m.
TOLERANCE = 1e-6
_SHORTEST_EDGE_M = 1e-6
_OVERHANG_M = 1e-7  # rounding of recorded corners
_LARGEST = 1e9  # of any number; sums of larger ones would overflow or lose the digits that matter
_LONGEST_ARC = np.pi / 3.0


@dataclass(frozen=True)
class RecordedRegion:
    """Region as recorded; nothing in it is believed.

    Attributes:
        points: (C, 3) contact points in the world [m].
        normals: (C, 3) unit vectors: directions in which the world pushes on the robot.
        friction: (C,) coefficients.
        caps: (C,) largest normal forces [N].
        wrenches: (W, 6) force and moment about the world origin that the world puts on the robot besides the contacts
            [N, Nm].
        vertices: (V, 2) places of the centre of mass, counter-clockwise [m].
        witnesses: (V, W, C, 3) forces of the world on the robot [N].
    """

    points: Float[np.ndarray, "C 3"]
    normals: Float[np.ndarray, "C 3"]
    friction: Float[np.ndarray, "C"]
    caps: Float[np.ndarray, "C"]
    wrenches: Float[np.ndarray, "W 6"]
    vertices: Float[np.ndarray, "V 2"]
    witnesses: Float[np.ndarray, "V W C 3"]


@dataclass(frozen=True)
class EquilibriumProof:
    """Largest defect of each kind, and whether all are within their tolerance.

    Attributes:
        is_proven: contact forces hold the robot under every load, with its centre of mass anywhere in the region.
        text: the proof in one sentence, or the first defect with its vertex, wrench and contact point.
        cone_n: tangential force beyond friction, or pull of a contact [N]; negative inside.
        cap_n: normal force beyond its cap [N]; negative below.
        force_n: sum of all forces [N].
        moment_nm: sum of all moments about the middle of the contact points [Nm].
        overhang_m: distance of a vertex outside an edge's line; positive where the polygon is not convex or not
            counter-clockwise.
        uncovered: distance of a load, with the yaw moments of drift, from the combinations of recorded wrenches
            [N, Nm].
        shift_m: what drift of the contact points takes off the margin.
    """

    is_proven: bool
    text: str
    cone_n: float = np.inf
    cap_n: float = np.inf
    force_n: float = np.inf
    moment_nm: float = np.inf
    overhang_m: float = np.inf
    uncovered: float = np.inf
    shift_m: float = np.inf


class _Defect(NamedTuple):
    """Largest defect of one kind: size, tolerance, and a sentence about the worst place."""

    size: float
    tolerance: float
    text: str


@dataclass(frozen=True)
class _Given:
    """What the request demands of the region."""

    weight: float
    loads: Float[np.ndarray, "G 6"]
    drift_m: float
    tilt_rad: Float[np.ndarray, "#C"]
    tolerance: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "tolerance", TOLERANCE * self.weight)


def prove_equilibrium(
    region: RecordedRegion,
    mass: float,
    loads: Float[np.ndarray, "G 6"],
    gravity: float = 9.81,
    drift_m: float = 0.0,
    tilt_rad: Float[np.ndarray, "#C"] | float = 0.0,
) -> EquilibriumProof:
    """Prove or refute that the robot is held anywhere in a recorded region under every combination of loads.

    Contact points that are off by up to ``drift_m`` make moments of at most ``drift_m * sum |f|``: the margin of the
    centre of mass must be larger than ``shift_m``, and each load must be held with the yaw moments
    ``+-drift_m * sum |f_xy|`` added.

    Args:
        region: as recorded.
        mass: of the robot with what it carries [kg].
        loads: (G, 6) wrenches that must be held, about the world origin [N, Nm]; a zero row for no load.
        gravity: downwards [m/s^2].
        drift_m: farthest that a contact point may be from its place.
        tilt_rad: largest angle of a contact's normal off its direction; one for all points, or (C,).

    Raises:
        ValueError: mass, loads, gravity, drift or tilt make no sense. What is recorded never raises: it is refuted.
    """
    given = _check_given(mass, loads, gravity, drift_m, tilt_rad)
    malformed = _find_malformed(region)
    if malformed is not None:
        return EquilibriumProof(False, malformed)
    cone, cap = _judge_contacts(region, given)
    force, moment = _judge_balance(region, given)
    overhang = _judge_polygon(region.vertices)
    uncovered = _judge_loads(region, given)
    defects = (cone, cap, force, moment, overhang, uncovered)
    shift = drift_m * float(np.linalg.norm(region.witnesses, axis=3).sum(axis=2).max()) / given.weight
    refuted = [defect for defect in defects if not defect.size <= defect.tolerance]
    if refuted:
        text = max(refuted, key=lambda defect: defect.size / defect.tolerance).text
    else:
        text = (
            f"contact forces hold the robot at all {len(region.vertices)} vertices of the region under all "
            f"{len(region.wrenches)} wrenches, to {force.size:.1e} N and {moment.size:.1e} Nm"
        )
    return EquilibriumProof(
        is_proven=not refuted,
        text=text,
        cone_n=cone.size,
        cap_n=cap.size,
        force_n=force.size,
        moment_nm=moment.size,
        overhang_m=overhang.size,
        uncovered=uncovered.size,
        shift_m=shift,
    )


def list_turned_loads(
    force: Float[np.ndarray, "3"],
    point: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    origin: Float[np.ndarray, "3"],
    first_rad: float,
    last_rad: float,
) -> Float[np.ndarray, "W 6"]:
    """Return wrenches whose convex hull contains those of a load that turns with a link between two angles.

    The wrench runs along an arc of an ellipse. Each part of at most 60 degrees lies in the triangle of its ends and the
    point where the tangents at both meet: ``w + tan(half the part) dw/dangle``, from its first end.

    Args:
        force: on the robot, in the world at angle zero [N].
        point: where it acts, in the world at angle zero [m].
        axis: unit vector of the joint, in the world.
        origin: a point on the axis [m].
        first_rad, last_rad: ends of the arc.

    Returns:
        (W, 6) force and moment about the world origin [N, Nm]: all ends of parts and all meeting points.

    Raises:
        ValueError: a value is not finite, or the axis is not of unit length.
    """
    from scipy.spatial.transform import Rotation  # slow to import

    _check_unit(axis)
    if not (np.isfinite([first_rad, last_rad]).all() and all(np.isfinite(v).all() for v in (force, point, origin))):
        raise ValueError("force, point, origin and both angles of a load must be finite")
    n_parts = max(1, int(np.ceil(abs(last_rad - first_rad) / _LONGEST_ARC)))
    angles = np.linspace(first_rad, last_rad, n_parts + 1)
    rotation = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
    acting, arm = rotation @ force, rotation @ (point - origin)
    place = origin + arm
    wrench = np.concatenate([acting, np.cross(place, acting)], axis=1)
    turning = np.cross(axis, acting)
    rate = np.concatenate([turning, np.cross(np.cross(axis, arm), acting) + np.cross(place, turning)], axis=1)
    half = 0.5 * (last_rad - first_rad) / n_parts
    return np.concatenate([wrench, (wrench + np.tan(half) * rate)[:-1]])


def list_slid_loads(
    force: Float[np.ndarray, "3"],
    point: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    first_m: float,
    last_m: float,
) -> Float[np.ndarray, "2 6"]:
    """Return the wrenches at both ends of a slide, whose convex hull contains those between.

    Args:
        force: on the robot, in the world; it keeps its direction [N].
        point: where it acts, in the world at travel zero [m].
        axis: unit vector of the travel, in the world.
        first_m, last_m: ends of the travel.

    Raises:
        ValueError: a value is not finite, or the axis is not of unit length.
    """
    _check_unit(axis)
    if not (np.isfinite([first_m, last_m]).all() and np.isfinite(force).all() and np.isfinite(point).all()):
        raise ValueError("force, point and both ends of a load must be finite")
    return np.array([[*force, *np.cross(point + travel * axis, force)] for travel in (first_m, last_m)])


def _check_unit(axis: Float[np.ndarray, "3"]) -> None:
    if not abs(float(np.linalg.norm(axis)) - 1.0) <= 1e-6:
        raise ValueError(f"the axis of a load must be a unit vector, got {np.asarray(axis).tolist()}")


def _check_given(
    mass: float,
    loads: Float[np.ndarray, "G 6"],
    gravity: float,
    drift_m: float,
    tilt_rad: Float[np.ndarray, "#C"] | float,
) -> _Given:
    """Check the arguments that are not recorded."""
    loads = np.asarray(loads, dtype=float)
    for name, value in (("mass", mass), ("gravity", gravity)):
        if not 0.0 < value < np.inf:
            raise ValueError(f"{name} must be positive and finite, got {value:g}")
    tilts = np.atleast_1d(np.asarray(tilt_rad, dtype=float))
    for name, value in (("drift_m", drift_m), *(("tilt_rad", tilt) for tilt in tilts.tolist())):
        if not 0.0 <= value < np.inf:
            raise ValueError(f"{name} must be finite and not negative, got {value:g}")
    if loads.ndim != 2 or loads.shape[1] != 6 or not len(loads) or not np.isfinite(loads).all():
        raise ValueError(f"loads must be finite with shape (G, 6) and G at least 1, got shape {loads.shape}")
    return _Given(mass * gravity, loads, drift_m, tilts)


def _find_malformed(region: RecordedRegion) -> str | None:
    """Return what makes no sense in the recorded arrays, or None."""
    if region.points.ndim != 2 or region.witnesses.ndim != 4:
        return f"points must have shape (C, 3) and witnesses (V, W, C, 3), got {region.points.shape}, " + str(
            region.witnesses.shape
        )
    count, (n_vertices, n_wrenches) = len(region.points), region.witnesses.shape[:2]
    shapes = {
        "points": (count, 3),
        "normals": (count, 3),
        "friction": (count,),
        "caps": (count,),
        "wrenches": (n_wrenches, 6),
        "vertices": (n_vertices, 2),
        "witnesses": (n_vertices, n_wrenches, count, 3),
    }
    for name, shape in shapes.items():
        values = getattr(region, name)
        if values.shape != shape:
            return f"{name} has shape {values.shape}; expected {shape}"
        bad = ~(np.abs(values) <= _LARGEST)
        if bad.any():
            at = np.argwhere(bad)[0]
            return f"{name}{at.tolist()} is {values[tuple(at)]:g}; expected a finite number of at most {_LARGEST:g}"
    if not (count and n_wrenches and n_vertices >= 3):
        return (
            f"a region needs a contact point, a wrench and three vertices, got {count}, {n_wrenches} and {n_vertices}"
        )
    off = np.abs(np.linalg.norm(region.normals, axis=1) - 1.0)
    if off.max() > 1e-6:
        return f"the normal of contact point {int(off.argmax())} is not a unit vector: {region.normals[off.argmax()]}"
    for name, least in (("friction", region.friction), ("caps", region.caps)):
        if least.min() < 0.0:
            return f"{name} of contact point {int(least.argmin())} is negative: {least.min():g}"
    return None


def _judge_contacts(region: RecordedRegion, given: _Given) -> tuple[_Defect, _Defect]:
    """Return the worst force outside the friction cone and the worst over its cap, for every normal within the tilt.

    A force is in all tilted cones if its angle to the normal is at most ``atan(mu) - tilt``. It presses most along the
    tilted normal that is nearest to it.
    """
    pressing = np.einsum("vwci,ci->vwc", region.witnesses, region.normals)
    sideways = np.linalg.norm(np.cross(region.witnesses, region.normals), axis=3)
    allowed = np.arctan(region.friction) - given.tilt_rad
    # Distance from a cone narrower than friction by the tilt; where nothing is left of it, every force is outside.
    outside = np.where(
        allowed >= 0.0,
        np.cos(allowed) * sideways - np.sin(allowed) * pressing,
        np.linalg.norm(region.witnesses, axis=3),
    )
    outside = np.maximum(outside, -pressing)
    length = np.linalg.norm(region.witnesses, axis=3)
    most = length * np.cos(np.maximum(np.arctan2(sideways, pressing) - given.tilt_rad, 0.0))
    over = most - region.caps
    v, w, c = np.unravel_index(int(outside.argmax()), outside.shape)
    cone = _Defect(
        float(outside.max()),
        given.tolerance,
        f"the force at contact point {c}, for vertex {v} and wrench {w}, is {outside.max():.3g} N outside its friction "
        f"cone: {sideways[v, w, c]:.3g} N along the surface and {pressing[v, w, c]:.3g} N against it",
    )
    v, w, c = np.unravel_index(int(over.argmax()), over.shape)
    cap = _Defect(
        float(over.max()),
        given.tolerance,
        f"the force at contact point {c}, for vertex {v} and wrench {w}, presses with {most[v, w, c]:.4g} N, "
        f"{over.max():.3g} N over its cap of {region.caps[c]:.4g} N",
    )
    return cone, cap


def _judge_balance(region: RecordedRegion, given: _Given) -> tuple[_Defect, _Defect]:
    """Return the largest sum of forces, and of moments about the middle of the contact points."""
    middle = region.points.mean(axis=0)
    down = np.array([0.0, 0.0, -given.weight])
    places = np.column_stack([region.vertices, np.full(len(region.vertices), middle[2])])
    forces = region.witnesses.sum(axis=2) + region.wrenches[:, :3] + down
    moments = (
        np.cross(region.points - middle, region.witnesses).sum(axis=2)
        + (region.wrenches[:, 3:] - np.cross(middle, region.wrenches[:, :3]))
        + np.cross(places - middle, down)[:, None]
    )
    defects = []
    for sums, kind, unit in ((forces, "forces", "N"), (moments, "moments", "Nm")):
        sizes = np.linalg.norm(sums, axis=2)
        v, w = np.unravel_index(int(sizes.argmax()), sizes.shape)
        text = f"the {kind} at vertex {v} under wrench {w} sum to {sizes.max():.3g} {unit} instead of zero"
        defects.append(_Defect(float(sizes.max()), given.tolerance, text))
    return defects[0], defects[1]


def _judge_polygon(vertices: Float[np.ndarray, "V 2"]) -> _Defect:
    """Return how far a vertex is outside the line of an edge.

    A closed chain of edges that all have a point on their left runs around it, and the point is in the hull of the
    vertices: what is inside all edges is held even where rounding has dented the polygon.
    """
    edges = np.roll(vertices, -1, axis=0) - vertices
    lengths = np.linalg.norm(edges, axis=1)
    if lengths.min() < _SHORTEST_EDGE_M:
        return _Defect(np.inf, _OVERHANG_M, f"vertices {int(lengths.argmin())} and the next are one point")
    apart = vertices[None] - vertices[:, None]
    left = (edges[:, None, 0] * apart[..., 1] - edges[:, None, 1] * apart[..., 0]) / lengths[:, None]
    if np.abs(left).max() < _SHORTEST_EDGE_M:
        return _Defect(np.inf, _OVERHANG_M, "all vertices are on one line")
    e, v = np.unravel_index(int(left.argmin()), left.shape)
    text = (
        f"the polygon is not convex and counter-clockwise: vertex {v} is {-1e3 * left.min():.3g} mm outside the edge "
        f"that begins at vertex {e}"
    )
    return _Defect(float(-left.min()), _OVERHANG_M, text)


def _judge_loads(region: RecordedRegion, given: _Given) -> _Defect:
    """Return how far a load is from the combinations of wrenches that are held, drift included."""
    tangential = np.linalg.norm(region.witnesses[..., :2], axis=3).sum(axis=2).max(axis=0)
    worst = _Defect(0.0, given.tolerance, "")
    for k, load in enumerate(given.loads):
        missing = _measure_load(load, region.wrenches, given.drift_m * tangential, given.tolerance)
        if not missing <= worst.size:
            drift = f" with what a drift of {1e3 * given.drift_m:g} mm adds" if given.drift_m > 0.0 else ""
            text = (
                f"load {k}{drift} is {missing:.3g} N or Nm away from everything that the {len(region.wrenches)} "
                "recorded wrenches hold"
            )
            worst = _Defect(missing, given.tolerance, text)
    return worst


def _measure_load(
    load: Float[np.ndarray, "6"], wrenches: Float[np.ndarray, "W 6"], yaw: Float[np.ndarray, "W"], tolerance: float
) -> float:
    """Return how far a load is from being held, where drift makes the yaw moments ``yaw`` of each wrench's witnesses.

    The load lies on the line between two wrenches that differ from it in yaw alone, or in the hull of all. Either way
    the hull must contain it with the largest yaw moment of the wrenches used, of both signs.
    """
    same = np.abs(wrenches[:, :5] - load[:5]).max(axis=1) <= 0.1 * tolerance
    if same.any():
        rows = np.flatnonzero(same)
        ends = rows[[int(wrenches[rows, 5].argmin()), int(wrenches[rows, 5].argmax())]]
        reach = float(yaw[ends].max())
        short = max(wrenches[ends[0], 5] - (load[5] - reach), load[5] + reach - wrenches[ends[1], 5])
        if short <= tolerance:
            return max(float(short), 0.0)
    turned = load + np.array([[-1.0], [1.0]]) * np.array([0.0, 0.0, 0.0, 0.0, 0.0, float(yaw.max())])
    return max(_distance_to_hull(wrench, wrenches) for wrench in turned)


def _distance_to_hull(wrench: Float[np.ndarray, "6"], corners: Float[np.ndarray, "W 6"]) -> float:
    """Return the least sum of absolute differences between a wrench and a convex combination of the corners."""
    from scipy.optimize import linprog  # slow to import, and rarely needed

    scale = max(float(np.abs(corners).max()), float(np.abs(wrench).max()), 1.0)
    rows = np.hstack([(corners - wrench).T / scale, np.eye(6), -np.eye(6)])
    total = np.concatenate([np.ones(len(corners)), np.zeros(12)])
    cost = 1.0 - total
    solution = linprog(cost, A_eq=np.vstack([rows, total]), b_eq=[0.0] * 6 + [1.0], method="highs")
    if solution.status != 0 or solution.x is None:
        return np.inf
    # Measured on the combination itself, not believed from the solver.
    shares = np.maximum(solution.x[: len(corners)], 0.0)
    return float(np.abs(shares @ corners / shares.sum() - wrench).sum())
