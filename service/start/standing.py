"""Balance at the start: soles of planted feet, the ground below them, and masses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import PLANAR_NAMES, LinkBody, RobotModel
from costs.scene import ConvexPiece
from costs.support import SupportPolygon
from costs.work_space import borrow_data
from service.errors import RequestError
from service.verify import GROUND_TOLERANCE_M, UNSEEN_KIND, describe_gap, find_ground_gaps

FEET_GROUP = "feet"
SOLE_BAND_M = (
    0.002  # height above a foot's lowest vertex, or off its lower face, up to which vertices belong to its sole
)
LEVEL_M = 2.0 * SOLE_BAND_M  # difference of height between the corners of a level sole
MOST_SLOPE_RAD = float(np.deg2rad(20.0))  # of a sole
LEAST_SHARE = 0.5  # of a foot's lower face that is lowest where it is level
LOWEST_BAND_M = 0.01  # above the robot's lowest vertex: links there could be feet
FLOOR_KIND = "floor"
WHEEL_DEPTH_M = 0.02
"""By which what a base on wheels carries may be in the floor: files draw wheels, and markers of the base, into it."""

LARGEST_SHIFT_M = 0.03  # uncertainty of a scanned floor's height


def list_links_on_wheels(robot: RobotModel) -> tuple[str, ...]:
    """Return the links that a base on a plane carries at a height that no motion changes; none for other bases."""
    if not robot.is_planar:
        return ()
    joint = int(robot.model.getJointId(PLANAR_NAMES[-1]))
    return tuple(dict.fromkeys(body.link for body in robot.bodies if body.joint == joint))


def sole_corners(robot: RobotModel, q: Float[np.ndarray, "n"], link: str) -> Float[np.ndarray, "C 3"]:
    """Return the corners of a foot's sole in the world at ``q`` [m], see ``find_sole``."""
    return find_sole([vertices for _, vertices in place_bodies(robot, q, link)])


def find_sole(placed: Sequence[Float[np.ndarray, "V 3"]]) -> Float[np.ndarray, "C 3"]:
    """Return the sole of a link's bodies, placed in the world [m].

    It is what lies within 2 mm of the lowest vertex or, where that is little of a larger face that leans up to 20 deg,
    of that face: a foot on a slope stands on all of its sole.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    vertices = np.vstack(placed)
    lowest = _take_band(vertices, np.array([0.0, 0.0, -1.0]))
    try:
        planes = np.unique(np.round(ConvexHull(vertices).equations[:, :3], 6), axis=0)
    except QhullError:
        return lowest
    downwards = planes[planes[:, 2] <= -np.cos(MOST_SLOPE_RAD)]
    faces = [_take_band(vertices, normal) for normal in downwards]
    areas = [_measure_area(face) for face in faces]
    if not faces or _measure_area(lowest) >= LEAST_SHARE * max(areas):
        return lowest
    return faces[int(np.argmax(areas))]


def is_level(corners: Float[np.ndarray, "C 3"]) -> bool:
    """Return whether a sole is level, up to its own unevenness."""
    return float(np.ptp(corners[:, 2])) <= LEVEL_M


def _take_band(vertices: Float[np.ndarray, "V 3"], outwards: Float[np.ndarray, "3"]) -> Float[np.ndarray, "C 3"]:
    """Return the vertices within 2 mm of the one that is farthest along a direction."""
    along = vertices @ outwards
    return np.asarray(vertices[along >= along.max() - SOLE_BAND_M])


def _measure_area(points: Float[np.ndarray, "C 3"]) -> float:
    """Return the area of the hull of points seen from above [m^2]; 0 for points on a line."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        return float(ConvexHull(points[:, :2]).volume)
    except (QhullError, ValueError):
        return 0.0


def list_carrying_pieces(corners: Float[np.ndarray, "C 3"], pieces: Sequence[ConvexPiece]) -> tuple[str, ...]:
    """Return the pieces on which a planted sole may rest: floors, and those whose upper side a corner is on.

    Space that no scan has seen carries nothing.
    """
    lower = np.array([piece.lower for piece in pieces]).reshape(-1, 3) - GROUND_TOLERANCE_M
    upper = np.array([piece.upper for piece in pieces]).reshape(-1, 3) + GROUND_TOLERANCE_M
    is_near = np.all((corners.min(axis=0) <= upper) & (lower <= corners.max(axis=0)), axis=1)
    return tuple(
        piece.name
        for piece, near in zip(pieces, is_near.tolist(), strict=True)
        if piece.kind == FLOOR_KIND
        or (
            near
            and piece.kind != UNSEEN_KIND
            and np.abs(find_ground_gaps(corners, [piece])).min() <= GROUND_TOLERANCE_M
        )
    )


def find_lowest_links(robot: RobotModel, q: Float[np.ndarray, "n"]) -> tuple[str, ...]:
    """Return the links whose lowest vertices are within 1 cm of the robot's lowest at ``q``, in the robot's order."""
    heights: dict[str, float] = {}
    for body, vertices in place_bodies(robot, q):
        heights[body.link] = min(float(vertices[:, 2].min()), heights.get(body.link, np.inf))
    return tuple(link for link, height in heights.items() if height <= min(heights.values()) + LOWEST_BAND_M)


def find_standing_problems(
    robot: RobotModel, q: Float[np.ndarray, "n"], soles: Mapping[str, Float[np.ndarray, "C 3"]], off_ground: list[str]
) -> list[str]:
    """Return the lines about planted feet off the ground, and one if the centre of mass is outside the soles."""
    problems = list(off_ground)
    weightless = _weightless_links(robot)
    if weightless:
        return [*problems, f"{', '.join(weightless)} of {robot.name} have shapes and no mass; balance needs all masses"]
    com = pin.centerOfMass(robot.model, borrow_data(robot.model), q)
    try:
        margin = float(SupportPolygon.of_soles(list(soles.values())).margin(com[None, :2])[0])
    except ValueError:
        return [*problems, f"the soles of {', '.join(soles)} touch in a line; expected a foot flat on the floor"]
    if margin < 0.0:
        problems.append(
            f"the centre of mass ({com[0]:.3f}, {com[1]:.3f}) is {-margin:.3f} m outside the support polygon of "
            f"{', '.join(soles)}; move the base or lean the torso"
        )
    return problems


def _weightless_links(robot: RobotModel) -> list[str]:
    """Return one link per joint that moves shapes but no mass."""
    links = {b.joint: b.link for b in reversed(robot.bodies) if b.link not in robot.mechanism_links}
    return [link for joint, link in sorted(links.items()) if joint and not robot.model.inertias[joint].mass > 0.0]


def move_floor_to_soles(
    seen: Sequence[ConvexPiece], soles: Mapping[str, Float[np.ndarray, "C 3"]]
) -> tuple[tuple[ConvexPiece, ...], tuple[str, ...]]:
    """Return the pieces with the scan's floor shifted in height to the planted soles if it is near them, and a note.

    Args:
        seen: pieces of a scan.
        soles: corners of each planted link's sole in the world [m].
    """
    floors = [piece for piece in seen if piece.kind == FLOOR_KIND]
    if not floors or not soles:
        return tuple(seen), ()
    gaps = find_ground_gaps(np.vstack(list(soles.values())), floors)
    shift = 0.5 * float(gaps.min() + gaps.max())
    if np.abs(gaps).max() <= GROUND_TOLERANCE_M or not np.abs(gaps).max() <= LARGEST_SHIFT_M:
        return tuple(seen), ()
    moved = tuple(
        replace(piece, vertices=piece.vertices + np.array([0.0, 0.0, shift])) if piece.kind == FLOOR_KIND else piece
        for piece in seen
    )
    way = "up" if shift > 0.0 else "down"
    note = (
        f"the scanned floor was moved {way} by {1e3 * abs(shift):.1f} mm to the soles of {', '.join(soles)}; "
        f"at most {1e3 * LARGEST_SHIFT_M:.0f} mm"
    )
    return moved, (note,)


def find_ground_problems(
    pieces: Sequence[ConvexPiece], soles: Mapping[str, Float[np.ndarray, "C 3"]]
) -> Iterator[tuple[str, str]]:
    """Yield each planted link that is off the ground, with the problem."""
    for link, corners in soles.items():
        gaps = find_ground_gaps(corners, pieces)
        worst = float(gaps[np.abs(gaps).argmax()])
        if not np.isfinite(worst):
            yield link, f"{describe_gap(worst, link)}; expected scene.floor or an obstacle there"
        elif abs(worst) > GROUND_TOLERANCE_M:
            most = f"expected at most {1e3 * GROUND_TOLERANCE_M:.0f} mm"
            yield link, f"{describe_gap(worst, link)}; {most}: move start.base, or leave it out"


def check_masses(robot: RobotModel, *, holds_something: bool) -> tuple[str, ...]:
    """Return a note where a floating robot has no mass, so that its balance is not checked.

    Raises:
        RequestError: such a robot is to carry loads or to change its contacts (``holds_something``).
    """
    if not robot.is_floating or robot.can_balance:
        return ()
    mass = float(pin.computeTotalMass(robot.model))
    line = f"the links of {robot.name} have {mass:g} kg in all"
    if holds_something:
        raise RequestError(
            f"robot.urdf: {line}, and this task keeps the balance of a floating robot by their masses; give the links "
            "<inertial>"
        )
    return (f"{line}: its balance and its torques are not checked; the feet stay where they are",)


def place_bodies(
    robot: RobotModel, q: Float[np.ndarray, "n"], link: str | None = None
) -> list[tuple[LinkBody, Float[np.ndarray, "V 3"]]]:
    """Return every body, or those of a link, with its vertices in the world at ``q`` [m]."""
    data = borrow_data(robot.model)
    pin.forwardKinematics(robot.model, data, q)
    chosen = [body for body in robot.bodies if link is None or body.link == link]
    return [(b, b.vertices @ data.oMi[b.joint].rotation.T + data.oMi[b.joint].translation) for b in chosen]
