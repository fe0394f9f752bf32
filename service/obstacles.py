"""The obstacles of a request as convex pieces in the world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from costs.robot import shapes
from costs.scene import ConvexPiece
from service.errors import RequestError
from service.mesh import convex_parts, found_pose
from service.request import PlanRequest
from service.request_scene import (
    BoxRequest,
    CapsuleRequest,
    ConvexRequest,
    CylinderRequest,
    MeshRequest,
    ObstacleRequest,
    SphereRequest,
)

if TYPE_CHECKING:
    from perception import View

FLOOR_HALF_WIDTH_M = 10.0
FLOOR_THICKNESS_M = 0.2


def obstacle_pieces(request: PlanRequest, view: View | None = None) -> tuple[ConvexPiece, ...]:
    """All obstacles of a request; round shapes as polytopes around them, meshes as several pieces.

    Args:
        request: the request.
        view: its scan, made ready, in which meshes are looked for that ask for it.

    Raises:
        RequestError: a mesh file that cannot be used or is not found in the scan, or points without a volume.
    """
    pieces: list[ConvexPiece] = []
    for index, obstacle in enumerate(request.scene.obstacles):
        field = f"scene.obstacles[{index}]"
        pose = _pose(obstacle)
        if isinstance(obstacle, MeshRequest) and obstacle.match and view is not None:
            pose = found_pose(request.resolve(obstacle.file), obstacle.scale, pose, view, f"{field}.match")
        parts = _parts(request, obstacle, field)
        for number, vertices in enumerate(parts, start=1):
            name = obstacle.name if len(parts) == 1 else f"{obstacle.name}/{number}"
            pieces.append(ConvexPiece(name, vertices @ pose[:3, :3].T + pose[:3, 3]))
    return tuple(pieces)


def _pose(obstacle: ObstacleRequest) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(obstacle.quaternion_wxyz, scalar_first=True).as_matrix()
    pose[:3, 3] = obstacle.position
    return pose


def flat_floor(height: float, centre_xy: Float[np.ndarray, "2"]) -> ConvexPiece:
    """A floor of 20 m by 20 m whose top is at ``height`` [m]."""
    corners = shapes.box(np.array([2.0 * FLOOR_HALF_WIDTH_M, 2.0 * FLOOR_HALF_WIDTH_M, FLOOR_THICKNESS_M]))
    centre = np.array([*centre_xy, height - 0.5 * FLOOR_THICKNESS_M])
    return ConvexPiece("floor", corners + centre, "floor")


def _parts(request: PlanRequest, obstacle: ObstacleRequest, field: str) -> Sequence[Float[np.ndarray, "V 3"]]:
    """Vertices of the obstacle's convex parts in its own frame."""
    match obstacle:
        case BoxRequest():
            return [shapes.box(np.array(obstacle.size))]
        case SphereRequest():
            return [shapes.sphere(obstacle.radius)]
        case CylinderRequest():
            return [shapes.cylinder(obstacle.radius, obstacle.height)]
        case CapsuleRequest():
            return [shapes.capsule(obstacle.radius, obstacle.height)]
        case ConvexRequest():
            return [_hull(np.array(obstacle.points), f"{field}.points")]
        case MeshRequest():
            return convex_parts(
                request.resolve(obstacle.file), f"{field}.file", obstacle.scale, decompose=obstacle.decompose
            )


def _hull(points: Float[np.ndarray, "V 3"], field: str) -> Float[np.ndarray, "W 3"]:
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        raise RequestError(
            f"{field}: the {len(points)} points lie in a plane; four that span a volume would do"
        ) from None
