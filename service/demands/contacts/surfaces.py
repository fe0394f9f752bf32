"""Surfaces of a request: faces of the scene's pieces, polygons given by their corners, and the floor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from costs.robot import RobotModel
from costs.scene import ConvexPiece, Scene
from service.demands.contacts.stances import Surface
from service.errors import RequestError, would_do
from service.request.tasks.contacts import SurfaceRequest
from service.start.standing import FLOOR_KIND

FLOOR = "floor"
FLAT_M = 1e-3  # height of what belongs to one side of a piece
STRIP_M = 4e-3  # width of the surface on a piece's edge


def make_surfaces(requests: Mapping[str, SurfaceRequest], scene: Scene, path: str) -> dict[str, Surface]:
    """Return the surfaces of a request and the floor, by name.

    Args:
        requests: by name.
        scene: all pieces.
        path: of the surfaces in the request, for messages.

    Raises:
        RequestError: one line per unknown piece, side that is not flat, or polygon that is none.
    """
    pieces = {piece.name: piece for piece in scene.pieces}
    surfaces, problems = dict[str, Surface](), list[str]()
    floors = [piece for piece in scene.pieces if piece.kind == FLOOR_KIND]
    if floors:
        top = _find_side(floors[0], np.array([0.0, 0.0, 1.0]))
        if top is not None:
            surfaces[FLOOR] = Surface.on_pieces(FLOOR, *top, 1.0, floors)
    for name, request in requests.items():
        field = f"{path}.{name}"
        behind = request.pieces if request.piece is None else (request.piece,)
        unknown = [piece for piece in behind if piece not in pieces]
        if unknown:
            problems.append(
                f"{field}: no piece {unknown[0]!r} in the scene, which has {would_do(unknown[0], sorted(pieces))}"
            )
            continue
        normal = np.array(request.normal) / np.linalg.norm(request.normal)
        if request.piece is not None:
            side = _find_side(pieces[request.piece], normal)
        else:
            side = _order_corners(np.array(request.corners), normal, may_be_edge=False)
        if side is None:
            problems.append(f"{field}: {request.piece or 'the polygon'} has no flat side along {list(request.normal)}")
            continue
        surfaces[name] = Surface.on_pieces(name, *side, request.friction, [pieces[piece] for piece in behind])
    if problems:
        raise RequestError(problems)
    return surfaces


def find_unknown(
    robot: RobotModel, surfaces: Mapping[str, Surface], patch: str, surface: str, field: str
) -> str | None:
    """Return a problem where the robot has no such patch, or the request no such surface; None where both are there.

    Args:
        robot: with contact patches.
        surfaces: by name.
        patch, surface: names in the request.
        field: of the request that has the patch as key, for the message.
    """
    if patch not in robot.contacts:
        known = would_do(patch, sorted(robot.contacts)) or "no contact patches; give robot.contacts"
        return f"{field}: unknown contact patch {patch!r}; {robot.name} has {known}"
    if surface not in surfaces:
        return f"{field}.{patch}: unknown surface {surface!r}; expected {would_do(surface, sorted(surfaces))}"
    return None


def _find_side(
    piece: ConvexPiece, normal: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "3"]] | None:
    """Return corners and normal of the side of a piece that faces along a direction; None without a flat one."""
    height = piece.vertices @ normal
    return _order_corners(piece.vertices[height >= height.max() - FLAT_M], normal)


def _order_corners(
    points: Float[np.ndarray, "N 3"], direction: Float[np.ndarray, "3"], *, may_be_edge: bool = True
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "3"]] | None:
    """Return the hull of points in their plane, counter-clockwise about its normal; None where they have none."""
    middle = points.mean(axis=0)
    if len(points) < 2:
        return None
    _, sizes, axes = np.linalg.svd(points - middle)
    if may_be_edge and sizes[0] > FLAT_M and (len(points) == 2 or sizes[1] < FLAT_M):
        return _make_strip(points, axes[0], direction)
    if sizes[1] < FLAT_M or (len(sizes) > 2 and sizes[2] > FLAT_M * np.sqrt(len(points))):
        return None
    normal = axes[2] if axes[2] @ direction >= 0.0 else -axes[2]
    u = axes[0]
    v = np.cross(normal, u)
    flat = np.stack([(points - middle) @ u, (points - middle) @ v], axis=1)
    try:
        around = ConvexHull(flat).vertices  # counter-clockwise
    except QhullError:
        return None
    return middle + flat[around, :1] * u + flat[around, 1:] * v, normal


def _make_strip(
    points: Float[np.ndarray, "N 3"], along: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "3"]] | None:
    """Return corners and normal of a narrow strip on the edge of a piece, as on a rail that is round."""
    normal = direction - (direction @ along) * along
    if np.linalg.norm(normal) < 0.5:
        return None
    normal /= np.linalg.norm(normal)
    side = np.cross(normal, along)
    reach = points @ along
    first, last = points[int(reach.argmin())], points[int(reach.argmax())]
    half = 0.5 * STRIP_M * side
    return np.stack([first - half, last - half, last + half, first + half]), normal
