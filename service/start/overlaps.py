"""Collisions at one configuration: overlaps of the robot's bodies with pieces or each other, and their depths."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.allowance import BodyRef
from costs.primitive import Primitive
from costs.robot import LinkBody, RobotModel
from costs.scene import ConvexPiece, Scene
from costs.work_space import borrow_data
from service.start.standing import (
    FLOOR_KIND,
    WHEEL_DEPTH_M,
    find_sole,
    list_carrying_pieces,
    list_links_on_wheels,
)
from service.verify import GROUND_TOLERANCE_M, make_coal_convex

TOUCH_M = 1e-6
EXACT_ROUNDING_M = 1e-5
"""Upper bound of the error of coal's distances between round shapes [m]."""


@dataclass(frozen=True)
class Overlap:
    """Overlap of a link with a piece or another link, of their exact shapes or only of their planning hulls.

    Attributes:
        link: the link.
        other: name of the piece or of the other link.
        depth: penetration depth [m]; negative if only the hulls overlap.
        kind: kind of the piece; None for a link.
        hull_depth: penetration depth of their hulls in planning [m].
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
        """Text such as ``inside shelf (obstacle)``."""
        return f"inside {self.other}" if self.kind in (None, "", self.other) else f"inside {self.other} ({self.kind})"

    @property
    def nearness(self) -> str:
        """Text for overlapping hulls: ``l2 is 0.4 mm from ball (obstacle), nearer than ... hulls resolve ...``."""
        hull_depth = _format_length(self.hull_depth)
        if self.depth > 0.0:
            return f"{self}, as far as tolerances allow, while the planner's hulls overlap by {hull_depth}"
        kind = "" if self.kind in (None, "", self.other) else f" ({self.kind})"
        return (
            f"{self.link} is {_format_length(max(-self.depth, 0.0))} from {self.other}{kind}, nearer than the "
            f"planner's hulls resolve, which overlap by {hull_depth}"
        )

    def __str__(self) -> str:
        return f"{self.link} is {_format_length(self.depth)} {self.where}"


def describe_collisions(
    robot: RobotModel, q: Float[np.ndarray, "n"], scene: Scene, planted: Sequence[str]
) -> list[str]:
    """Return one line per pair in collision at ``q``, the deepest first; planted feet may touch what carries them."""
    return [str(overlap) for overlap in find_overlaps(robot, q, scene, planted)]


def find_overlaps(robot: RobotModel, q: Float[np.ndarray, "n"], scene: Scene, planted: Sequence[str]) -> list[Overlap]:
    """Return the pairs whose shapes collide at ``q``, the deepest first; planted feet may touch what carries them."""
    return find_overlaps_and_unresolved(robot, q, scene, planted)[0]


def find_overlaps_and_unresolved(
    robot: RobotModel,
    q: Float[np.ndarray, "n"],
    scene: Scene,
    planted: Sequence[str],
    rests: Collection[tuple[str, str]] = (),
) -> tuple[list[Overlap], list[Overlap]]:
    """Return the pairs whose shapes collide, and the pairs of which only the hulls overlap; the deepest first.

    Args:
        robot: the robot.
        q: the configuration.
        scene: of pieces.
        planted: links that may touch what carries them.
        rests: links and pieces that are left out.
    """
    overlaps = _find_hull_overlaps(robot, q, scene, planted)
    overlaps = [(overlap, is_inside) for overlap, is_inside in overlaps if (overlap.link, overlap.other) not in rests]
    inside = _keep_deepest([overlap for overlap, is_inside in overlaps if is_inside])
    pairs = {frozenset(overlap.pair) for overlap in inside}
    return inside, _keep_deepest([overlap for overlap, _ in overlaps if frozenset(overlap.pair) not in pairs])


def find_hull_overlaps(
    robot: RobotModel,
    q: Float[np.ndarray, "n"],
    scene: Scene,
    planted: Sequence[str],
    rests: Collection[tuple[str, str]] = (),
) -> list[Overlap]:
    """Return the pairs whose hulls overlap at ``q``, with the depths of the hulls, the deepest first; as above."""
    overlaps = [overlap for overlap, _ in _find_hull_overlaps(robot, q, scene, planted)]
    left = [overlap for overlap in overlaps if (overlap.link, overlap.other) not in rests]
    return _keep_deepest([replace(overlap, depth=overlap.hull_depth) for overlap in left])


def _find_hull_overlaps(
    robot: RobotModel, q: Float[np.ndarray, "n"], scene: Scene, planted: Sequence[str]
) -> list[tuple[Overlap, bool]]:
    """Return each overlap of hulls beyond the allowed depth, and whether the shapes overlap too."""
    things: list[LinkBody | ConvexPiece] = [*robot.bodies, *scene.pieces]
    data = borrow_data(robot.model)
    pin.forwardKinematics(robot.model, data, q)
    here = np.eye(4)
    poses = [data.oMi[body.joint].homogeneous for body in robot.bodies] + [here] * len(scene.pieces)
    vertices = [
        body.vertices @ pose[:3, :3].T + pose[:3, 3] for body, pose in zip(robot.bodies, poses, strict=False)
    ]  # pieces follow
    overlaps: list[tuple[Overlap, bool]] = []
    of_link: dict[str, list[Float[np.ndarray, "V 3"]]] = {}
    for body, points in zip(robot.bodies, vertices, strict=True):
        of_link.setdefault(body.link, []).append(points)
    resting = {
        (link, name)
        for link in planted
        if link in of_link
        for name in list_carrying_pieces(find_sole(of_link[link]), scene.pieces)
    }
    for k, j in _find_box_pairs(vertices, scene.pieces):
        body, other = robot.bodies[k], things[j]
        allowed = _allowed_depth(robot, body, other, resting)
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
        overlaps.append((Overlap(body.link, name, depth, kind, hull_depth), depth > allowed))
    return overlaps


def _keep_deepest(overlaps: Sequence[Overlap]) -> list[Overlap]:
    """Return the deepest overlap of each pair, the deepest pair first."""
    deepest: dict[frozenset[BodyRef], Overlap] = {}
    for overlap in sorted(overlaps, key=lambda overlap: (-overlap.depth, -overlap.hull_depth)):
        deepest.setdefault(frozenset(overlap.pair), overlap)
    return list(deepest.values())


def _format_length(metres: float) -> str:
    """Format a length: ``7.6 mm``, ``23 mm``, ``1.250 m``."""
    if metres >= 1.0:
        return f"{metres:.3f} m"
    if metres < 5e-5:
        return "less than 0.1 mm"
    return f"{1e3 * metres:.1f} mm" if metres < 9.95e-3 else f"{1e3 * metres:.0f} mm"


def describe_dead_end(overlap: Overlap, planted: Sequence[str]) -> str:
    """Return the reason why no motion can resolve an overlap; empty if one can."""
    names = [overlap.link, overlap.other] if overlap.kind is None else [overlap.link]
    if all(name in planted for name in names):
        return f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} planted and cannot leave"
    return ""


def _find_box_pairs(
    vertices: Sequence[Float[np.ndarray, "V 3"]], pieces: Sequence[ConvexPiece]
) -> list[tuple[int, int]]:
    """Return index pairs (body, later body or piece) whose axis-aligned bounding boxes intersect.

    Args:
        vertices: of the bodies in the world.
        pieces: whose indices follow those of the bodies.
    """
    n_bodies = len(vertices)
    low = [*(points.min(axis=0) for points in vertices), *(piece.lower for piece in pieces)]
    high = [*(points.max(axis=0) for points in vertices), *(piece.upper for piece in pieces)]
    lower, upper = np.array(low).reshape(-1, 3), np.array(high).reshape(-1, 3)
    meets = np.all((lower[:n_bodies, None] <= upper) & (lower <= upper[:n_bodies, None]), axis=2)
    return [(k, j) for k, j in np.argwhere(meets).tolist() if k < j]


def _allowed_depth(
    robot: RobotModel, body: LinkBody, other: LinkBody | ConvexPiece, resting: Collection[tuple[str, str]]
) -> float:
    """Return the allowed penetration depth at the start [m]; infinite for a pair that is not checked."""
    if isinstance(other, LinkBody):
        pair = (min(body.link, other.link), max(body.link, other.link))
        return np.inf if body.joint == other.joint or pair in robot.ignored_pairs else TOUCH_M
    if body.link in robot.fixed_links:
        return np.inf
    if other.kind == FLOOR_KIND and body.link in list_links_on_wheels(robot):
        return WHEEL_DEPTH_M
    return GROUND_TOLERANCE_M if (body.link, other.name) in resting else TOUCH_M


@dataclass(frozen=True)
class ExactShape:
    """Collision shape for coal in the frame of its body or piece.

    Attributes:
        geometry: the shape.
        pose: (4, 4) pose in the frame of the body's joint, or in the world for a piece.
        is_round: whether it differs from its hull in planning.
    """

    geometry: coal.CollisionGeometry
    pose: Float[np.ndarray, "4 4"]
    is_round: bool

    @staticmethod
    def of(thing: LinkBody | ConvexPiece) -> ExactShape:
        """Make the exact shape of a body or a piece."""
        if thing.exact is None:
            return ExactShape.of_hull(thing)
        return ExactShape(_geometry(thing.exact), thing.exact.pose, True)

    @staticmethod
    def of_hull(thing: LinkBody | ConvexPiece) -> ExactShape:
        """Make the hull of a body or a piece that planning and certificate use."""
        return ExactShape(make_coal_convex(thing.vertices), np.eye(4), False)

    def depth_in(
        self, other: ExactShape, pose: Float[np.ndarray, "4 4"] | None = None, pose_other: np.ndarray | None = None
    ) -> float:
        """Return the penetration depth, negative when apart [m]; without a pose the shape's frame is the world."""
        return penetration_depth(self.geometry, other.geometry, _at(pose, self.pose), _at(pose_other, other.pose))


def penetration_depth(
    first: coal.CollisionGeometry,
    second: coal.CollisionGeometry,
    pose_first: coal.Transform3s | None = None,
    pose_second: coal.Transform3s | None = None,
) -> float:
    """Return the penetration depth of two shapes in the world, negative when apart [m]."""
    result, here = coal.DistanceResult(), coal.Transform3s()
    poses = (pose_first or here, pose_second or here)
    return -float(coal.distance(first, poses[0], second, poses[1], coal.DistanceRequest(), result))


def _geometry(exact: Primitive) -> coal.CollisionGeometry:
    match exact.kind:
        case "sphere":
            # The distance of coal.Sphere to a cylinder is wrong by metres if the sphere's centre is inside.
            return coal.Capsule(exact.radius, 0.0)
        case "cylinder":
            return coal.Cylinder(exact.radius, exact.length)
        case "capsule":
            return coal.Capsule(exact.radius, exact.length)


def _at(pose: Float[np.ndarray, "4 4"] | None, pose_inside: Float[np.ndarray, "4 4"]) -> coal.Transform3s:
    placed = pose_inside if pose is None else pose @ pose_inside
    return coal.Transform3s(placed[:3, :3], placed[:3, 3])
