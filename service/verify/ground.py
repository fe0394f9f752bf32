"""Ground below planted feet: distance of the surface below each corner of a sole."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.primitive import find_round_normals, measure_outside_round
from costs.robot.model import RobotModel
from costs.scene import ConvexPiece
from service.verify.certificate import Basis, Check, Where
from service.verify.forces.loaded_balance import find_normals
from service.verify.motion import Motion, Phase, PlantedContact, VerifyError, VerifySettings
from service.verify.prepared_motion import PreparedMotion
from service.verify.solids import CoalSolid
from service.verify.timeline import edges_within, find_time

# Farthest that a supporting surface may be from a planted sole, above or below [m].
GROUND_TOLERANCE_M = 3e-3
# Allowed depth of a planted link in the floor: this distance and the allowed drift of its sole [m].
STANDING_DEPTH_M = GROUND_TOLERANCE_M + PlantedContact.tolerance_m
# Allowed depth of a link that may turn about one or two contact points [m].
TURNING_DEPTH_M = 6e-3
# Largest angle between a link's face and the surface that it presses on, besides the surface's own tilt.
MOST_LEAN_RAD = float(np.deg2rad(15.0))
UNSEEN_KIND = "unknown"  # of pieces that stand for space that no scan has seen
_TOUCH_M = 1e-9
_SAME_ANGLE = 1e-6  # [rad]
_FEET_GROUP = "feet"


def check_ground(prepared: PreparedMotion, phase: Phase, settings: VerifySettings) -> Iterator[Check]:
    """Check each link that stands in a phase: every corner of its sole is on a surface and on the link's shapes.

    A contact with a normal is held to surfaces that it faces, whose normals are within its tilt. The link is in front
    of the surface, which pushes and never pulls. Space that no scan has seen carries nothing.
    """
    motion = prepared.motion
    pieces = [piece for piece in motion.scene.pieces if piece.kind != UNSEEN_KIND]
    for contact in find_standing_contacts(motion, phase):
        corners = contact.points
        tilt = 0.0
        if contact.normal is None:
            gaps = find_ground_gaps(corners, pieces)
        else:
            gaps, tilt = find_surface_gaps(corners, contact.normal, pieces)
        worst = int(np.abs(gaps).argmax())
        value = float(abs(gaps[worst]))
        surface = "the ground" if contact.normal is None else "the surface"
        text = f"{describe_gap(float(gaps[worst]), contact.link, surface)} during {phase.name}"
        if tilt > contact.tilt_rad + _SAME_ANGLE:
            value = np.inf
            text = (
                f"the surface under {contact.link} leans {np.rad2deg(tilt):.1f} deg off its stated normal during "
                f"{phase.name}, {np.rad2deg(contact.tilt_rad):.1f} deg are stated"
            )
        off = outside_link(motion.robot, contact)
        if off > GROUND_TOLERANCE_M:
            value, text = off, f"a corner of the sole of {contact.link} is {1e3 * off:.1f} mm off the link's shapes"
        behind = _measure_behind(prepared, phase, contact)
        if behind > GROUND_TOLERANCE_M:
            value = behind
            text = f"{contact.link} is {1e3 * behind:.0f} mm behind the surface that it presses on during {phase.name}"
        point = (float(corners[worst, 0]), float(corners[worst, 1]), float(corners[worst, 2]))
        where = Where(phase.first, find_time(motion.law, phase.first), point, (contact.link,))
        name, is_ok = f"ground.{phase.name}.{contact.link}", value <= GROUND_TOLERANCE_M
        yield Check(name, is_ok, value, GROUND_TOLERANCE_M, "m", text, where, Basis.PROOF)


def _measure_behind(prepared: PreparedMotion, phase: Phase, contact: PlantedContact) -> float:
    """Return how far bodies at contact points reach behind the surface at the phase's knots, beyond what lean allows.

    A plane through each point is tilted by as much as link and surface may lean. Bodies of the link that do not touch
    the point do not count: links are not convex.
    """
    frame = prepared.motion.robot.model.frames[prepared.motion.robot.model.getFrameId(contact.link)]
    points = contact.sole @ np.array(frame.placement.rotation).T + np.array(frame.placement.translation)
    normals = find_normals((contact,))
    placed, rows = prepared.at(edges_within(prepared.edges, phase))
    worst = -np.inf
    for body in prepared.motion.robot.bodies:
        if body.link != contact.link:
            continue
        touching = np.flatnonzero(CoalSolid.of_body(body).distances(points) <= GROUND_TOLERANCE_M)
        rotation, _ = placed.relative(0, body.joint, rows)
        for index in touching.tolist():
            offsets = (body.vertices - points[index]) @ np.swapaxes(rotation, -1, -2)
            worst = max(worst, measure_behind(offsets, normals[index], contact.tilt_rad) - TURNING_DEPTH_M)
    return worst


def measure_behind(
    offsets: Float[np.ndarray, "*a V 3"], normal: Float[np.ndarray, "3"], tilt_rad: float = 0.0
) -> float:
    """Return how far vertices reach behind a surface that leans as much as link and surface may [m].

    Args:
        offsets: (..., V, 3) of the vertices from a point on the surface [m].
        normal: (3,) unit, of the surface.
        tilt_rad: by which the surface may lean off it.
    """
    lean = np.sin(min(MOST_LEAN_RAD + tilt_rad, 0.5 * np.pi))
    return float((-offsets @ normal - lean * np.linalg.norm(offsets, axis=-1)).max())


def find_standing_contacts(motion: Motion, phase: Phase) -> tuple[PlantedContact, ...]:
    """Return planted links that must be on the ground: all where balance is promised, else the feet.

    Without balance a planted hand need not rest on a surface; a robot with a fixed base needs no ground.
    """
    if not motion.robot.is_floating:
        return ()
    feet = motion.robot.link_groups.get(_FEET_GROUP, ())
    is_balanced = phase.support is not None or phase.region_margin_m is not None
    return tuple(contact for contact in phase.contacts if is_balanced or contact.link in feet)


def describe_gap(gap: float, link: str, surface: str = "the ground") -> str:
    """Return ``the ground is 12.0 mm below the sole of l_foot``."""
    if surface != "the ground":
        if not np.isfinite(gap):
            return f"no surface is behind a contact point of {link}"
        return f"a contact point of {link} is {1e3 * abs(gap):.1f} mm {'off' if gap >= 0.0 else 'inside'} the surface"
    if not np.isfinite(gap):
        return f"nothing is below a corner of the sole of {link}"
    side = "below" if gap >= 0.0 else "above"
    return f"the ground is {1e3 * abs(gap):.1f} mm {side} the sole of {link}"


def find_surface_gaps(
    points: Float[np.ndarray, "C 3"], normal: Float[np.ndarray, "3"], pieces: Sequence[ConvexPiece]
) -> tuple[Float[np.ndarray, "C"], float]:
    """Return how far points are in front of the nearest surface along a normal, and how much the surfaces lean.

    Returns:
        Distances (C,), negative inside a piece and infinite without a surface [m]; and the largest angle between the
        normal and those of the surfaces that the points are nearest to [rad].
    """
    gaps, lean = np.full(len(points), np.inf), np.zeros(len(points))
    for piece in pieces:
        planes = _planes(np.ascontiguousarray(piece.vertices, dtype=float).tobytes())
        if not len(planes):
            continue
        facing = planes[:, :3] @ normal
        beyond = -(points @ planes[:, :3].T + planes[:, 3])  # >= 0 behind each face
        is_front, is_back = facing > 1e-9, facing < -1e-9
        # A point moved by t along -normal is behind face f when t facing_f >= -beyond_f.
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = -beyond / facing
        enter = reach[:, is_front].max(axis=1, initial=-np.inf)
        leave = reach[:, is_back].min(axis=1, initial=np.inf)
        beside = np.abs(facing) <= 1e-9
        is_hit = np.all(beyond[:, beside] >= -_TOUCH_M, axis=1) & (enter <= leave + _TOUCH_M) & np.isfinite(enter)
        if not is_hit.any():
            continue
        face = np.flatnonzero(is_front)[reach[:, is_front].argmax(axis=1)]
        angle = np.arccos(np.clip(facing[face], -1.0, 1.0))
        if piece.exact is not None:  # its polytope contains it, and touches it along lines only
            enter = np.maximum(enter, measure_outside_round(points, piece.exact))
            angle = np.arccos(np.clip(find_round_normals(points, piece.exact) @ normal, -1.0, 1.0))
        nearer = is_hit & (np.abs(enter) < np.abs(gaps))
        gaps, lean = np.where(nearer, enter, gaps), np.where(nearer, angle, lean)
    return gaps, float(lean.max(initial=0.0))


def find_ground_gaps(corners: Float[np.ndarray, "C 3"], pieces: Sequence[ConvexPiece]) -> Float[np.ndarray, "C"]:
    """Return the height of each corner above the nearest surface on its vertical [m]; infinite without one.

    A surface is the upper side of a piece; where a corner is inside a piece, its height is negative.
    """
    gaps = np.full(len(corners), np.inf)
    lowest, highest = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    for piece in pieces:
        if (highest < piece.lower[:2]).any() or (lowest > piece.upper[:2]).any():
            continue
        gap = corners[:, 2] - find_top(piece.vertices, corners[:, :2])
        gaps = np.where(np.abs(gap) < np.abs(gaps), gap, gaps)
    return gaps


def find_top(vertices: Float[np.ndarray, "V 3"], places: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, "P"]:
    """Return the height of a hull's upper side over each place [m]; negative infinity beside the hull."""
    planes = _planes(np.ascontiguousarray(vertices, dtype=float).tobytes())
    if not len(planes):
        return np.full(len(places), -np.inf)
    up = planes[:, 2]
    # a x + b y + c z + d <= 0 bounds z from above where c > 0, from below where c < 0, and the place where c is 0.
    level = -(places @ planes[:, :2].T + planes[:, 3])
    is_up, is_down, is_wall = up > 1e-9, up < -1e-9, np.abs(up) <= 1e-9
    top = (level[:, is_up] / up[is_up]).min(axis=1, initial=np.inf)
    bottom = (level[:, is_down] / up[is_down]).max(axis=1, initial=-np.inf)
    is_inside = np.all(level[:, is_wall] >= -_TOUCH_M, axis=1) & (bottom <= top + _TOUCH_M)
    return np.where(is_inside, top, -np.inf)


@lru_cache(maxsize=64)
def _planes(points: bytes) -> Float[np.ndarray, "F 4"]:
    """Return the faces of a hull, outward normals and offsets; none for a flat hull."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        return np.unique(np.round(ConvexHull(np.frombuffer(points).reshape(-1, 3)).equations, 12), axis=0)
    except QhullError:
        return np.zeros((0, 4))


def outside_link(robot: RobotModel, contact: PlantedContact) -> float:
    """Return the largest distance of a sole's corner from all shapes of its link [m]; infinite without a shape."""
    model = robot.model
    if not model.existFrame(contact.link):
        raise VerifyError(f"unknown frame '{contact.link}'; the robot has {', '.join(f.name for f in model.frames)}")
    placement: pin.SE3 = model.frames[model.getFrameId(contact.link)].placement
    corners = contact.sole @ np.array(placement.rotation).T + np.array(placement.translation)
    distance = np.full(len(corners), np.inf)
    for solid in (CoalSolid.of_body(body) for body in robot.bodies if body.link == contact.link):
        distance = np.minimum(distance, solid.distances(corners))
    return float(distance.max())
