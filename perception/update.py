"""A new scan of a scene that was perceived before: what did not change stays the very same piece."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from costs.scene import ConvexPiece, Scene
from perception.clean import Reach
from perception.cloud import Cloud
from perception.convex.piece import Piece
from perception.convex.pieces import updated_pieces
from perception.convex.unknown import unknown_pieces
from perception.detect.valve import ValveDetection
from perception.perceive import Clock, Perceived, floors_of, matched, unexplained, without_best
from perception.solids.known import KnownMesh
from perception.solids.match import MeshMatch
from perception.view import make_view

_SAME = 0.01


@dataclass(frozen=True)
class Earlier:
    """What an update needs of the scan before; that scan's points are not among it.

    Attributes:
        scene: all that stood for the scan before, objects that were found aside.
        pieces: those of its pieces that were made of points; indices of points are not asked for.
        reach, seed: of the scan before.
        valves: detections, best first.
        matches: by name where known meshes were found.
    """

    scene: Scene
    pieces: tuple[Piece, ...]
    reach: Reach
    seed: int
    valves: tuple[ValveDetection, ...] = ()
    matches: Mapping[str, MeshMatch] = field(default_factory=dict)

    @classmethod
    def of(cls, seen: Perceived) -> Earlier:
        """Of what a scan showed."""
        return cls(seen.scene, seen.pieces, seen.view.reach, seen.view.seed, seen.valves, seen.matches)


def update(
    before: Perceived | Earlier,
    cloud: Cloud,
    *,
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
    known: Sequence[KnownMesh] = (),
) -> Perceived:
    """What a new scan of the same scene shows, in the same reach.

    Pieces that no ray of the new scan passes through stay in the scene as they are: the same objects, the same names.
    What their surfaces do not explain becomes new pieces (slabs and hulls) with new names.  The floor stays while its
    corners move by less than 1 cm.  A valve or known mesh that was found stays where it was, and is not looked for
    again unless it is among ``known``; unknown space is made anew if it was asked for.

    Args:
        before: what the scan before showed.
        cloud: the new scan, in the same frame.
        robot_hulls, soles: of the robot as it stands now, see ``perceive``.
        known: objects to look for; one that was known before by the same name is forgotten.

    Raises:
        CloudError: nothing of the cloud lies in reach.
    """
    clock = Clock()
    earlier = before if isinstance(before, Earlier) else Earlier.of(before)
    view = make_view(cloud, reach=earlier.reach, robot_hulls=robot_hulls, soles=soles, seed=earlier.seed)
    kept, _ = without_best(earlier.valves, view)
    clock.lap("view")
    matches = {**earlier.matches, **matched(known, view, clock)}
    kept = unexplained(view.obstacles, kept, matches)
    made = updated_pieces(earlier.pieces, view.obstacles[kept], view.starts[kept], view.cloud.rays, earlier.seed)
    pieces = tuple(replace(piece, points=kept[piece.points]) for piece in made.pieces)
    clock.lap("pieces")
    hidden: tuple[ConvexPiece, ...] = ()
    if any(piece.kind == "unknown" for piece in earlier.scene.pieces):
        hidden = unknown_pieces(view.cloud.rays, earlier.reach, view.floors, robot_hulls, soles)
        clock.lap("unknown")
    floors = _steady(earlier.scene, floors_of(view))
    stem = [piece for piece in earlier.scene.pieces if piece.kind == "stem"]
    timings = clock.timings | {f"pieces: {step}": seconds for step, seconds in made.timings.items()}
    scene = Scene((*floors, *stem, *(piece.shape for piece in pieces), *hidden))
    return Perceived(scene, pieces, view, view.floor, earlier.valves, timings, view.notes, matches)


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
