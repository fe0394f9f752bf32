"""Update of a perceived scene by a new scan: pieces that did not change stay the same objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.scene import ConvexPiece, Scene
from perception.cleaning.clean import Reach
from perception.cleaning.locally import LocalJudge
from perception.cloud import Cloud
from perception.convex.clock import Clock
from perception.convex.hulls import make_hull
from perception.convex.piece import Piece
from perception.convex.room import make_room
from perception.convex.standing import Ground
from perception.convex.unknown import make_unknown_pieces
from perception.convex.updated import Judge, Updated, update_pieces
from perception.detect.shared.detection import Detection
from perception.ground.floor import FloorPlane, floor_pieces
from perception.ground.levels_again import may_be_level
from perception.perceived import Perceived, drop_explained, find_meshes, list_boxes, see_past, take_out
from perception.solids.match import KnownMesh
from perception.solids.rating import MeshMatch
from perception.view import Cropped, View, crop, view_of

_SAME = 0.01


@dataclass(frozen=True)
class Earlier:
    """Result of the earlier scan as far as an update needs it; without that scan's points.

    Attributes:
        scene: all pieces of the earlier scan, without detected objects.
        pieces: its pieces that were made from points; indices of their points are not used.
        reach, seed: settings of the earlier scan.
        detections: objects, best first within each kind.
        matches: poses of the known meshes that were found, by name.
        floors: levels of the floor; if empty they are searched again, which takes longer.
    """

    scene: Scene
    pieces: tuple[Piece, ...]
    reach: Reach
    seed: int
    detections: tuple[Detection, ...] = ()
    matches: Mapping[str, MeshMatch] = field(default_factory=dict)
    floors: tuple[FloorPlane, ...] = ()

    @classmethod
    def of(cls, seen: Perceived) -> Earlier:
        """Take the parts that an update needs from a scan's result."""
        view = seen.view
        return cls(seen.scene, seen.pieces, view.reach, view.seed, seen.detections, seen.matches, view.floors)


def update(
    before: Perceived | Earlier,
    cloud: Cloud,
    *,
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
    known: Sequence[KnownMesh] = (),
) -> Perceived:
    """Perceive a new scan of the same scene, in the same reach.

    Pieces that no ray of the new scan passes through stay in the scene unchanged: the same objects, the same names.
    Points that their surfaces do not explain are cleaned and become new pieces (slabs and hulls) with new names.  The
    floor is kept if its corners move by at most 1 cm.  Detected objects and known meshes keep their poses and are not
    searched again, except meshes in ``known``.  Unknown space is recomputed if the earlier scene had any.

    Args:
        before: result of the earlier scan.
        cloud: the new scan, in the same frame.
        robot_hulls, soles: hulls and soles of the robot at the new scan, see ``perceive``.
        known: meshes to find; each replaces an earlier mesh of the same name.

    Raises:
        CloudError: no point of the cloud lies in reach.
    """
    clock = Clock()
    earlier = before if isinstance(before, Earlier) else Earlier.of(before)
    cropped = crop(cloud, earlier.reach, robot_hulls)
    seen = _hold_against(earlier, cropped, soles, known, earlier.floors, clock)
    if seen.is_left_off:
        seen = _hold_against(earlier, cropped, soles, known, (), clock)
    view, pieces = seen.view, seen.pieces
    hidden: tuple[ConvexPiece, ...] = ()
    if any(piece.kind == "unknown" for piece in earlier.scene.pieces):
        hidden = make_unknown_pieces(view.cloud.rays, earlier.reach, view.floors, robot_hulls, soles)
        clock.lap("unknown")
    stem = [piece for piece in earlier.scene.pieces if piece.kind == "stem"]
    timings = clock.timings | {f"pieces: {step}": seconds for step, seconds in seen.timings.items()}
    scene = Scene((*seen.floors, *stem, *(piece.shape for piece in pieces), *hidden))
    return Perceived(scene, pieces, view, view.floor, earlier.detections, timings, view.notes, seen.matches)


@dataclass(frozen=True)
class _Held:
    """Comparison of a new scan with the earlier result.

    Attributes:
        pieces: pieces whose points are indices into the view's obstacles.
        timings: seconds by step of making pieces.
        is_left_off: whether it stopped without pieces because floor levels must be searched first.
    """

    view: View
    floors: list[ConvexPiece]
    pieces: tuple[Piece, ...]
    matches: Mapping[str, MeshMatch]
    timings: Mapping[str, float]
    is_left_off: bool = False


def _hold_against(
    earlier: Earlier,
    cropped: Cropped,
    soles: Sequence[Float[np.ndarray, "S 3"]],
    known: Sequence[KnownMesh],
    levels: Sequence[FloorPlane],
    clock: Clock,
) -> _Held:
    """Compare the new scan with the earlier pieces and floor levels; stop if the scan may show another level."""
    # Points that kept pieces explain need no cleaning, but a mesh search needs all points cleaned.
    cleaned = len(known) > 0
    view = view_of(cropped, reach=earlier.reach, soles=soles, seed=earlier.seed, cleaned=cleaned, floors=levels)
    ground = view.near.points[view.is_floor]
    is_level = partial(may_be_level, floors=view.floors if view.floors is levels else (), ground=ground)
    # Most new levels are found before pieces are made; others, such as one on an earlier object, only meanwhile.
    if is_level(view.obstacles, known=[piece.hull for piece in earlier.pieces]):
        clock.lap("view")
        return _Held(view, [], (), {}, {}, is_left_off=True)
    floors = _keep_steady(earlier.scene, floor_pieces(view.floors, view.reach))
    kept, _ = take_out(earlier.detections, view.obstacles)
    clock.lap("view")
    matches = {**earlier.matches, **find_meshes(known, view, clock)}
    kept = drop_explained(view.obstacles, kept, matches)
    hulls = tuple(make_hull(piece.vertices, kept[:0]).simplified for piece in floors)
    judge = None if cleaned else _judge(view.near, ~view.is_floor, kept)
    made = update_pieces(
        earlier.pieces,
        view.obstacles[kept],
        view.starts[kept],
        see_past(earlier.detections, view.cloud.rays),
        earlier.seed,
        Ground(hulls, ground, view.near.starts[view.is_floor]),
        judge,
        is_level,
    )
    clock.lap("pieces")
    view, pieces = _drop_strays(view, made, kept)
    pieces = make_room(pieces, list_boxes(earlier.detections), view.obstacles)
    return _Held(view, floors, pieces, matches, made.timings, made.is_left_off)


def _judge(near: Cloud, is_obstacle: Bool[np.ndarray, "N"], kept: Int[np.ndarray, "K"]) -> Judge:
    """Make a function that maps indices into ``kept`` to a mask of the points that lie on a surface."""
    scan, index = LocalJudge.of(near.points, near.starts, is_obstacle), np.flatnonzero(is_obstacle)[kept]
    return lambda queries: scan.surface_among(index[queries])


def _drop_strays(view: View, made: Updated, kept: Int[np.ndarray, "K"]) -> tuple[View, tuple[Piece, ...]]:
    """Return the view without points found to be strays, and the pieces with indices into its obstacles."""
    is_obstacle = np.ones(len(view.obstacles), dtype=bool)
    is_obstacle[kept[~made.is_surface]] = False
    index = np.cumsum(is_obstacle) - 1
    pieces = tuple(replace(piece, points=index[kept[piece.points]]) for piece in made.pieces)
    return replace(view, obstacles=view.obstacles[is_obstacle], starts=view.starts[is_obstacle]), pieces


def _keep_steady(before: Scene, pieces: Sequence[ConvexPiece]) -> list[ConvexPiece]:
    """Return the pieces, each replaced by the earlier piece of the same name if their vertices agree within 1 cm."""
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
