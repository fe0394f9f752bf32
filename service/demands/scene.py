"""Scene of a request: its obstacles, the pieces of its scan, and a floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel, shapes
from costs.scene import ConvexPiece, Scene
from service.errors import RequestError
from service.request.names import TakenNames, check_scene_file_names, rename_clashing
from service.request.scene import MeshRequest
from service.request.schema import PlanRequest
from service.start.standing import FLOOR_KIND

FLOOR_HALF_WIDTH_M = 10.0
FLOOR_THICKNESS_M = 0.2


def compose_scene(
    request: PlanRequest,
    robot: RobotModel,
    start: Float[np.ndarray, "n"],
    seen: Sequence[ConvexPiece],
    obstacles: Sequence[ConvexPiece],
) -> tuple[Scene, tuple[str, ...]]:
    """Compose the scene: obstacles, then seen pieces, then the floor; the request's floor replaces a seen one.

    Pieces that a scan shows are renamed where a link or an obstacle has their name; a note says so.

    Raises:
        RequestError: a piece of the scene's file, or an obstacle, has the name of something else.
    """
    taken = TakenNames.of(robot, request)
    renamed: tuple[str, ...] = ()
    if request.scene.file is None:
        seen, renamed = rename_clashing(tuple(seen), taken, {piece.name for piece in obstacles})
    else:
        check_scene_file_names(seen, taken)
    pieces: list[ConvexPiece] = list(obstacles)
    floor = request.scene.floor
    pieces += [piece for piece in seen if floor is None or piece.kind != FLOOR_KIND]
    if floor is None:
        floor = robot.is_floating and not any(piece.kind == FLOOR_KIND for piece in pieces)
    if floor is not False:
        height = 0.0 if floor is True else float(floor)
        flat = make_floor(height, start[:2] if robot.is_floating else np.zeros(2))
        pieces += rename_clashing((flat,), taken)[0]
    try:
        return Scene(tuple(pieces)), renamed
    except ValueError as error:
        raise RequestError(
            f"scene.obstacles: {error}; the names 'floor' and those of the pieces that were seen are taken"
        ) from None


def make_floor(height: float, centre_xy: Float[np.ndarray, "2"]) -> ConvexPiece:
    """Return a floor of 20 m by 20 m whose top is at ``height`` [m]."""
    corners = shapes.box(np.array([2.0 * FLOOR_HALF_WIDTH_M, 2.0 * FLOOR_HALF_WIDTH_M, FLOOR_THICKNESS_M]))
    centre = np.array([*centre_xy, height - 0.5 * FLOOR_THICKNESS_M])
    return ConvexPiece("floor", corners + centre, FLOOR_KIND)


def has_scan(request: PlanRequest) -> bool:
    """Return whether the scene comes from a scan, or from a scene file made of one."""
    return request.scene.cloud is not None or request.scene.file is not None


def find_recorded_obstacles(request: PlanRequest, recorded: Scene) -> tuple[ConvexPiece, ...]:
    """Return the pieces of the request's mesh files in a recorded scene: the files may have moved."""
    names = [obstacle.name for obstacle in request.scene.obstacles if isinstance(obstacle, MeshRequest)]
    return tuple(
        piece
        for piece in recorded.pieces
        if piece.kind != FLOOR_KIND and any(piece.name == name or is_part(piece.name, name) for name in names)
    )


def is_part(piece: str, obstacle: str) -> bool:
    """Return whether a piece is named like a part of a mesh."""
    return piece.startswith(f"{obstacle}/") and piece[len(obstacle) + 1 :].isdigit()
