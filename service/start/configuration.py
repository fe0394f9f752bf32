"""Where the robot stands at first: the start configuration of a request, and whether a robot can stand so."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.allowance import BodyRef
from costs.robot import BASE_NAMES, LinkBody, RobotModel
from costs.scene import ConvexPiece, Scene
from costs.support import SupportPolygon
from service.errors import RequestError, would_do
from service.request.schema import StartRequest
from service.start.exact import EXACT_ROUNDING_M, ExactShape
from service.start.footing import FLOOR_KIND, ground_problems
from service.verify.ground import GROUND_TOLERANCE_M

SNAP_TOLERANCE = 1e-3  # rounding in a robot's own report of its joints [rad, m]
STANDING_POSTURE = "stand"
FEET_GROUP = "feet"
LARGEST_PITCH_DEG = 85.0
SOLE_BAND_M = 0.002  # vertices this close to a foot's lowest one are its sole
TOUCH_M = 1e-6


@dataclass(frozen=True)
class Overlap:
    """A link inside a piece or inside another link, by their shapes or by the hulls that stand for them alone.

    Attributes:
        link: the one.
        other: name of the piece or of the other link.
        depth: how far one would have to be moved to be free [m]; negative where only the hulls overlap.
        kind: of the piece; None for a link.
        hull_depth: the same of the hulls that stand for them in planning [m].
    """

    link: str
    other: str
    depth: float
    kind: str | None = None
    hull_depth: float = 0.0

    @property
    def pair(self) -> tuple[BodyRef, BodyRef]:
        """The link, and the piece or the other link."""
        other = BodyRef.of_link(self.other) if self.kind is None else BodyRef.of_piece(self.other)
        return BodyRef.of_link(self.link), other

    @property
    def where(self) -> str:
        """``inside shelf (obstacle)``."""
        return f"inside {self.other}" if self.kind in (None, "", self.other) else f"inside {self.other} ({self.kind})"

    @property
    def nearness(self) -> str:
        """Where only the hulls overlap: ``l2 is 0.4 mm from ball (obstacle), nearer than ... hulls resolve ...``."""
        if self.depth > 0.0:
            return (
                f"{self}, as far as tolerances allow, while the planner's hulls overlap by {_length(self.hull_depth)}"
            )
        kind = "" if self.kind in (None, "", self.other) else f" ({self.kind})"
        return (
            f"{self.link} is {_length(max(-self.depth, 0.0))} from {self.other}{kind}, nearer than the planner's hulls "
            f"resolve, which overlap by {_length(self.hull_depth)}"
        )

    def __str__(self) -> str:
        return f"{self.link} is {_length(self.depth)} {self.where}"


def start_configuration(robot: RobotModel, start: StartRequest) -> tuple[Float[np.ndarray, "n"], tuple[str, ...]]:
    """Configuration of a start request, and notes about what was assumed or snapped.

    Raises:
        RequestError: an unknown posture or joint, or a joint beyond its limits by more than 1e-3.
    """
    q, notes = _posture(robot, start)
    given = start.positions_by_joint
    problems = unknown_joints(robot, given, "start.joints")
    if problems:
        raise RequestError(problems)
    for name, position in given.items():
        q[robot.joint_names.index(name)] = position
    if start.base is not None:
        if not robot.is_floating:
            raise RequestError("start.base: this robot's base is fixed; leave it out, or give robot.root: floating")
        q[:3] = start.base.position
        q[3:6] = _yaw_pitch_roll(start.base.quaternion_wxyz)
    return _snapped(robot, q, notes)


def unknown_joints(robot: RobotModel, names: Mapping[str, float] | Sequence[str], field: str) -> list[str]:
    """One line for each name that is no joint of the robot."""
    joints = robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names
    return [
        f"unknown joint {name!r} in {field}; {robot.name} has {would_do(name, joints)}"
        for name in names
        if name not in joints
    ]


def beyond_limits(robot: RobotModel, positions: Mapping[str, float], field: str, tolerance: float = 0.0) -> list[str]:
    """One line for each joint position that is beyond the joint's limits by more than ``tolerance``."""
    problems = []
    for name, position in positions.items():
        index = robot.joint_names.index(name)
        lower, upper = float(robot.lower[index]), float(robot.upper[index])
        if not lower - tolerance <= position <= upper + tolerance:
            problems.append(
                f"{field}.{name}: {position:.6g} is outside the joint's limits; {lower:.6g} to {upper:.6g} would do"
            )
    return problems


def placed_bodies(robot: RobotModel, q: Float[np.ndarray, "n"]) -> list[tuple[LinkBody, Float[np.ndarray, "V 3"]]]:
    """Every body with its vertices in the world at ``q`` [m]."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return [(b, b.vertices @ data.oMi[b.joint].rotation.T + data.oMi[b.joint].translation) for b in robot.bodies]


def sole(robot: RobotModel, q: Float[np.ndarray, "n"], link: str) -> Float[np.ndarray, "C 3"]:
    """Corners of a foot's sole in the world [m]: the link's vertices within 2 mm of its lowest one at ``q``."""
    vertices = np.vstack([v for body, v in placed_bodies(robot, q) if body.link == link])
    return np.asarray(vertices[vertices[:, 2] <= vertices[:, 2].min() + SOLE_BAND_M])


def collisions(robot: RobotModel, q: Float[np.ndarray, "n"], scene: Scene, planted: Sequence[str]) -> list[str]:
    """One line for each pair that is in collision at ``q``, the deepest first; planted feet may touch the floor."""
    return [str(overlap) for overlap in overlaps(robot, q, scene, planted)]


def overlaps(robot: RobotModel, q: Float[np.ndarray, "n"], scene: Scene, planted: Sequence[str]) -> list[Overlap]:
    """Every pair that is in collision at ``q`` by its shapes, the deepest first; planted feet may touch the floor."""
    return overlaps_and_unresolved(robot, q, scene, planted)[0]


def overlaps_and_unresolved(
    robot: RobotModel, q: Float[np.ndarray, "n"], scene: Scene, planted: Sequence[str]
) -> tuple[list[Overlap], list[Overlap]]:
    """Pairs in collision by their shapes, and pairs of which only the hulls overlap; the deepest first."""
    found = _hull_overlaps(robot, q, scene, planted)
    inside = _deepest([one for one, is_inside in found if is_inside])
    met = {frozenset(one.pair) for one in inside}
    return inside, _deepest([one for one, _ in found if frozenset(one.pair) not in met])


def hull_overlaps(robot: RobotModel, q: Float[np.ndarray, "n"], scene: Scene, planted: Sequence[str]) -> list[Overlap]:
    """Every pair whose hulls overlap at ``q``, with the hulls' depths, the deepest first."""
    found = _hull_overlaps(robot, q, scene, planted)
    return _deepest([replace(one, depth=one.hull_depth) for one, _ in found])


def _hull_overlaps(
    robot: RobotModel, q: Float[np.ndarray, "n"], scene: Scene, planted: Sequence[str]
) -> list[tuple[Overlap, bool]]:
    """Bodies and what their hulls are deeper in than they may be, and whether that is so by their shapes too."""
    things: list[LinkBody | ConvexPiece] = [*robot.bodies, *scene.pieces]
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    here = np.eye(4)
    poses = [data.oMi[one.joint].homogeneous if isinstance(one, LinkBody) else here for one in things]
    vertices = [one.vertices @ pose[:3, :3].T + pose[:3, 3] for one, pose in zip(things, poses, strict=True)]
    found: list[tuple[Overlap, bool]] = []
    for k, j in _whose_boxes_meet(vertices, len(robot.bodies)):
        body, other = robot.bodies[k], things[j]
        allowed = _allowed_depth(robot, body, other, planted)
        if not np.isfinite(allowed):
            continue
        hull_depth = ExactShape.of_hull(body).depth_in(ExactShape.of_hull(other), poses[k], poses[j])
        if hull_depth <= allowed:
            continue
        depth = hull_depth
        if body.exact is not None or other.exact is not None:
            allowed = max(allowed, EXACT_ROUNDING_M)
            depth = min(ExactShape.of(body).depth_in(ExactShape.of(other), poses[k], poses[j]), hull_depth)
        name, kind = (other.link, None) if isinstance(other, LinkBody) else (other.name, other.kind)
        found.append((Overlap(body.link, name, depth, kind, hull_depth), depth > allowed))
    return found


def _deepest(found: Sequence[Overlap]) -> list[Overlap]:
    """Of each pair the bodies that are deepest, the deepest pair first."""
    deepest: dict[frozenset[BodyRef], Overlap] = {}
    for overlap in sorted(found, key=lambda one: (-one.depth, -one.hull_depth)):
        deepest.setdefault(frozenset(overlap.pair), overlap)
    return list(deepest.values())


def _length(metres: float) -> str:
    """A length as it is told: ``7.6 mm``, ``23 mm``, ``1.250 m``."""
    if metres >= 1.0:
        return f"{metres:.3f} m"
    if metres < 5e-5:
        return "less than 0.1 mm"
    return f"{1e3 * metres:.1f} mm" if metres < 9.95e-3 else f"{1e3 * metres:.0f} mm"


def no_way_out(overlap: Overlap, planted: Sequence[str]) -> str:
    """Why an overlap cannot be left; empty when it can."""
    names = [overlap.link, overlap.other] if overlap.kind is None else [overlap.link]
    if all(name in planted for name in names):
        return f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} planted and cannot leave"
    return ""


def standing_problems(
    robot: RobotModel, q: Float[np.ndarray, "n"], scene: Scene, soles: Mapping[str, Float[np.ndarray, "C 3"]]
) -> list[str]:
    """One line for each planted foot that stands on nothing, and one when the centre of mass is outside the soles."""
    problems = [line for _, line in ground_problems(scene.pieces, soles)]
    weightless = _weightless_links(robot)
    if weightless:
        return [*problems, f"{', '.join(weightless)} of {robot.name} have shapes and no mass; balance needs all masses"]
    com = pin.centerOfMass(robot.model, robot.model.createData(), q)
    try:
        margin = float(SupportPolygon.of_soles(list(soles.values())).margin(com[None, :2])[0])
    except ValueError:
        return [*problems, f"the soles of {', '.join(soles)} touch in a line; a foot flat on the floor would do"]
    if margin < 0.0:
        problems.append(
            f"the centre of mass ({com[0]:.3f}, {com[1]:.3f}) is {-margin:.3f} m outside the support polygon of "
            f"{', '.join(soles)}; move the base or lean the torso"
        )
    return problems


def _weightless_links(robot: RobotModel) -> list[str]:
    """A link with a shape for each joint that moves shapes without any mass."""
    found = {b.joint: b.link for b in reversed(robot.bodies) if b.link not in robot.mechanism_links}
    return [link for joint, link in sorted(found.items()) if joint and not robot.model.inertias[joint].mass > 0.0]


def _posture(robot: RobotModel, start: StartRequest) -> tuple[Float[np.ndarray, "n"], tuple[str, ...]]:
    if start.posture is not None:
        if start.posture not in robot.postures:
            known = would_do(start.posture, robot.postures) or "no postures; give start.joints"
            raise RequestError(f"unknown posture {start.posture!r} in start.posture; {robot.name} has {known}")
        return robot.postures[start.posture].copy(), ()
    if STANDING_POSTURE in robot.postures:
        return robot.postures[STANDING_POSTURE].copy(), ()
    q = np.clip(np.zeros(robot.n), robot.lower, robot.upper)
    given = set(start.positions_by_joint)
    joints = robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names
    assumed = [name for name in joints if name not in given]
    if not assumed:
        return q, ()
    return q, (f"{len(assumed)} joints without a start position start at 0 or at the nearest limit",)


def _yaw_pitch_roll(quaternion_wxyz: tuple[float, float, float, float]) -> Float[np.ndarray, "3"]:
    """The base's coordinates are intrinsic z-y-x angles, which have no unique value at a pitch of 90 degrees."""
    rotation = Rotation.from_quat(quaternion_wxyz, scalar_first=True)
    pitch_deg = math.degrees(math.asin(np.clip(-rotation.as_matrix()[2, 0], -1.0, 1.0)))
    if abs(pitch_deg) > LARGEST_PITCH_DEG:
        raise RequestError(
            f"start.base.quaternion_wxyz: a pitch of {pitch_deg:.0f} deg is too near to 90; "
            f"at most {LARGEST_PITCH_DEG:.0f} would do"
        )
    return np.asarray(rotation.as_euler("ZYX"))


def _snapped(
    robot: RobotModel, q: Float[np.ndarray, "n"], notes: tuple[str, ...]
) -> tuple[Float[np.ndarray, "n"], tuple[str, ...]]:
    problems = beyond_limits(robot, dict(zip(robot.joint_names, q, strict=True)), "start.joints", SNAP_TOLERANCE)
    if problems:
        raise RequestError(problems)
    inside = np.clip(q, robot.lower, robot.upper)
    for index in np.flatnonzero(inside != q):
        notes += (f"start: {robot.joint_names[index]} snapped from {q[index]:.6g} to its limit {inside[index]:.6g}",)
    return inside, notes


def _whose_boxes_meet(vertices: Sequence[Float[np.ndarray, "V 3"]], n_bodies: int) -> list[tuple[int, int]]:
    """Bodies (the first sets) with a later set whose bounding box meets theirs."""
    low, high = (np.array([end(points, axis=0) for points in vertices]).reshape(-1, 3) for end in (np.min, np.max))
    meets = np.all((low[:n_bodies, None] <= high) & (low <= high[:n_bodies, None]), axis=2)
    return [(k, j) for k, j in np.argwhere(meets).tolist() if k < j]


def _allowed_depth(robot: RobotModel, body: LinkBody, other: LinkBody | ConvexPiece, planted: Sequence[str]) -> float:
    """How deep a body may be in something at the start [m]; infinite for a pair that is not checked."""
    if isinstance(other, LinkBody):
        pair = (min(body.link, other.link), max(body.link, other.link))
        return np.inf if body.joint == other.joint or pair in robot.ignored_pairs else TOUCH_M
    if body.link in robot.fixed_links:
        return np.inf
    return GROUND_TOLERANCE_M if body.link in planted and other.kind == FLOOR_KIND else TOUCH_M
