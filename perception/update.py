"""A new scan of a scene that was perceived before: what did not change stays the very same piece."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.scene import ConvexPiece, Scene
from perception.cloud import Cloud
from perception.convex.pieces import updated_pieces
from perception.convex.unknown import unknown_pieces
from perception.perceive import Clock, Perceived, floors_of, unexplained, without_valve
from perception.view import make_view

_SAME = 0.01


def update(
    before: Perceived,
    cloud: Cloud,
    *,
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
) -> Perceived:
    """What a new scan of the same scene shows, in the same reach.

    Pieces that no ray of the new scan passes through stay in the scene as they are: the same objects, the same names.
    What their surfaces do not explain becomes new pieces with new names.  The floor stays while its corners move by
    less than 1 cm.  A valve or known mesh that was found stays where it was, and is not looked for again; unknown space
    is made anew if it was asked for.

    Args:
        before: what the scan before showed.
        cloud: the new scan, in the same frame.
        robot_hulls, soles: of the robot as it stands now, see ``perceive``.

    Raises:
        CloudError: nothing of the cloud lies in reach.
    """
    clock = Clock()
    reach, seed = before.view.reach, before.view.seed
    view = make_view(cloud, reach=reach, robot_hulls=robot_hulls, soles=soles, seed=seed)
    kept = np.arange(len(view.obstacles))
    stem = [piece for piece in before.scene.pieces if piece.kind == "stem"]
    if before.valve is not None:
        is_other, _ = without_valve(view.obstacles, before.valve)
        kept = kept[is_other]
    kept = unexplained(view.obstacles, kept, before.matches)
    clock.lap("view")
    made = updated_pieces(before.pieces, view.obstacles[kept], view.starts[kept], view.cloud.rays, seed)
    pieces = tuple(replace(piece, points=kept[piece.points]) for piece in made.pieces)
    clock.lap("pieces")
    hidden: tuple[ConvexPiece, ...] = ()
    if any(piece.kind == "unknown" for piece in before.scene.pieces):
        hidden = unknown_pieces(view.cloud.rays, reach, view.floors, robot_hulls, soles)
        clock.lap("unknown")
    floors = _steady(before.scene, floors_of(view))
    timings = clock.timings | {f"pieces: {step}": seconds for step, seconds in made.timings.items()}
    scene = Scene((*floors, *stem, *(piece.shape for piece in pieces), *hidden))
    return Perceived(scene, pieces, view, view.floor, before.valves, timings, view.notes, before.matches)


def _steady(before: Scene, pieces: Sequence[ConvexPiece]) -> list[ConvexPiece]:
    """The pieces, those of the scene before in place of the ones of their name that are the same within 1 cm."""
    known = {piece.name: piece for piece in before.pieces}
    steady = []
    for piece in pieces:
        old = known.get(piece.name)
        is_same = (
            old is not None
            and old.vertices.shape == piece.vertices.shape
            and float(np.abs(old.vertices - piece.vertices).max()) <= _SAME
        )
        steady.append(old if old is not None and is_same else piece)
    return steady
