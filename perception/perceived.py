"""The whole perception chain: from a cloud to floor, convex pieces and detected objects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from costs.progress import tell
from costs.scene import ConvexPiece, Scene
from costs.stopping import never, poll, stops_when
from perception.cleaning.clean import SELF_MARGIN, Reach, inside_hulls, nearest, voxel_downsample
from perception.cloud import Cloud
from perception.convex.clock import Clock
from perception.convex.piece import Piece
from perception.convex.pieces import Pieces, make_pieces
from perception.convex.room import make_room
from perception.convex.unknown import make_unknown_pieces
from perception.detect.registry import detect_kinds
from perception.detect.shared.detection import CONFIDENT, Detection, Model
from perception.errors import MeshError
from perception.ground.floor import FloorPlane, floor_pieces
from perception.noise import find_noise
from perception.solids.match import KnownMesh, locate
from perception.solids.pieces import make_coacd_pieces
from perception.solids.rating import MeshMatch
from perception.view import View, make_view

Unknown = Literal["free", "occupied"]
_LEAST_SHOWN = 0.25  # smallest span of a scan, as a share of the span of a mesh to be found in it
_MOST_SHOWN = 60_000
_SHOWN_VOXEL = 0.01
FRINGE = 5.0 / 3.0  # distance of the outermost noise, as a multiple of the tolerance (3 standard deviations)
_LONE = 0.03
# Standard deviations of the start of the rays by which free space keeps away from points.
_DOUBTFUL = 1.0
_DEFAULT_REACH = Reach()


@dataclass(frozen=True)
class Perceived:
    """Floor, pieces and objects that a cloud shows.

    Attributes:
        scene: pieces ``floor`` and ``floor/i``, ``plane/i``, ``wall/i``, ``clutter/i`` and, with a valve, ``stem``; the
            wheel itself is not in it.  ``unknown/i`` on request.
        pieces: the scene's pieces that were made from points, with their points and evidence.
        view: the scan they were made from; ``pieces[i].points`` are indices into ``view.obstacles``.
        floor: the floor's plane; None when none was seen.
        detections: objects of the requested kinds, kind by kind, best first.
        matches: pose and confidence of each known mesh, by name.
        timings: seconds by step.
        notes: sentences for the user.
    """

    scene: Scene
    pieces: tuple[Piece, ...]
    view: View
    floor: FloorPlane | None
    detections: tuple[Detection, ...]
    timings: Mapping[str, float]
    notes: tuple[str, ...]
    matches: Mapping[str, MeshMatch] = field(default_factory=dict)

    @property
    def shown(self) -> Float[np.ndarray, "M 3"]:
        """(M, 3) points of ``view.near``, decimated to at most 60,000 for a viewer [m]."""
        points = self.view.near.points
        if not len(points):
            return points
        thinned, _ = voxel_downsample(points, _SHOWN_VOXEL)
        return np.asarray(thinned[:: -(-len(thinned) // _MOST_SHOWN)])


def perceive(
    cloud: Cloud,
    *,
    reach: Reach = _DEFAULT_REACH,
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
    kinds: Sequence[str] = (),
    hint: Float[np.ndarray, "3"] | None = None,
    unknown: Unknown = "free",
    seed: int = 0,
    method: Literal["planes", "coacd"] = "planes",
    known: Sequence[KnownMesh] = (),
    given_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
    should_stop: Callable[[], bool] = never,
) -> Perceived:
    """Find floor, convex pieces and, on request, objects of a cloud in world coordinates (z up).

    Args:
        cloud: the scan; its origin must be the true start of the rays, since free space is computed from them.
        robot_hulls: (V, 3) vertices of the robot's links in the world; points on them are dropped.
        soles: (S, 3) corners of the planted soles; points up to 3 cm above the floor under them count as floor.
        kinds: kinds of objects to detect; points of the best object of each kind, if it has a model, do not become
            pieces.  ``wheel`` are the valves that a plan can turn.
        unknown: ``occupied`` adds pieces ``unknown/i`` for space in reach that no ray has seen, except the robot's
            own volume.
        seed: seed of all random choices; the same input and seed give the same result.
        method: ``planes`` (slabs, then hulls of the rest) or ``coacd`` (cells, then CoACD; slower and coarser).
        known: meshes to find, with unique names; points explained by a mesh that was found with confidence do not
            become pieces, and the mesh itself is not in the scene.
        given_hulls: (V, 3) vertices of solids in the world that the caller knows, and of space that is to count as
            free; points on or inside them do not become pieces.
        should_stop: polled at least every 100 ms, in addition to the caller's ``costs.stopping``.

    Raises:
        MeshError: CoACD crashed or needs too much.
        Stopped: ``should_stop`` was true.
        CloudError: no point of the cloud lies in reach.
    """
    with stops_when(should_stop):
        return _perceive(cloud, reach, robot_hulls, soles, hint, kinds, unknown, seed, method, known, given_hulls)


def _perceive(
    cloud: Cloud,
    reach: Reach,
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]],
    soles: Sequence[Float[np.ndarray, "S 3"]],
    hint: Float[np.ndarray, "3"] | None,
    kinds: Sequence[str],
    unknown: Unknown,
    seed: int,
    method: Literal["planes", "coacd"],
    known: Sequence[KnownMesh],
    given_hulls: Sequence[Float[np.ndarray, "V 3"]],
) -> Perceived:
    """Run ``perceive`` without its stop check."""
    clock = Clock()
    view = make_view(cloud, reach=reach, robot_hulls=robot_hulls, given_hulls=given_hulls, soles=soles, seed=seed)
    clock.lap("view")
    detections = tuple(detect_kinds(kinds, view, hint))
    kept, parts = take_out(detections, view.obstacles)
    clock.lap("valve")
    matches = find_meshes(known, view, clock)
    kept = drop_given(view.obstacles, drop_explained(view.obstacles, kept, matches), given_hulls)
    made = _make_pieces(view, kept, see_past(detections, view.cloud.rays), method)
    made = replace(made, pieces=make_room(made.pieces, list_boxes(detections), view.obstacles))
    clock.lap("pieces")
    hidden: tuple[ConvexPiece, ...] = ()
    if unknown == "occupied":
        tell("fill unknown space")
        hidden = make_unknown_pieces(view.cloud.rays, reach, view.floors, view.robot_hulls, soles)
        clock.lap("unknown")
    scene = Scene((*floor_pieces(view.floors, view.reach), *parts, *(piece.shape for piece in made.pieces), *hidden))
    timings = clock.timings | {f"pieces: {step}": seconds for step, seconds in made.timings.items()}
    return Perceived(scene, made.pieces, view, view.floor, detections, timings, view.notes, matches)


def take_out(
    detections: Sequence[Detection], points: Float[np.ndarray, "N 3"]
) -> tuple[Int[np.ndarray, "K"], tuple[ConvexPiece, ...]]:
    """Return indices of the points that belong to no object, and pieces for object parts that stay in the scene.

    Points belong to an object only if it has a model, is the best of its kind, and was found with confidence.
    """
    parts: tuple[ConvexPiece, ...] = ()
    kept = np.arange(len(points))
    for model in _models(detections):
        is_own, more = model.split_off(points[kept])
        kept, parts = kept[~is_own], (*parts, *more)
    return kept, parts


def see_past(
    detections: Sequence[Detection], rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]]
) -> tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]]:
    """Return starts and ends of rays as if the objects that ``take_out`` removes were not there."""
    starts, ends = rays
    for model in _models(detections):
        ends = model.see_past(starts, ends)
    return starts, ends


def list_boxes(detections: Sequence[Detection]) -> list[Float[np.ndarray, "F 4"]]:
    """Return the half-spaces of the boxes that objects fill which ``take_out`` removes."""
    boxes = [model.list_sides() for model in _models(detections)]
    return [sides for sides in boxes if len(sides)]


def _models(detections: Sequence[Detection]) -> list[Model]:
    """Return the models of the objects to remove from the scene."""
    best: dict[str, Detection] = {}
    for hit in detections:
        best.setdefault(hit.kind, hit)
    return [hit.model for hit in best.values() if hit.model is not None and hit.confidence >= CONFIDENT]


def find_meshes(known: Sequence[KnownMesh], view: View, clock: Clock) -> dict[str, MeshMatch]:
    """Return the match of each known mesh with the scan, by name.

    Raises:
        MeshError: the whole scan is much smaller than one of the meshes.
    """
    matches: dict[str, MeshMatch] = {}
    for mesh in known:
        poll()
        tell(f"look for {mesh.name}")
        _check_span(mesh, view)
        matches[mesh.name] = locate(mesh, view)
        clock.lap("known meshes")
    return matches


def _check_span(known: KnownMesh, view: View) -> None:
    """
    Raises:
        MeshError: the whole scan is much smaller than the mesh to be found in it.
    """
    vertices = np.concatenate([mesh.vertices for mesh in (*known.solid.closed, *known.solid.open)])
    mesh_m, scan_m = (float(np.ptp(points, axis=0).max()) for points in (vertices, view.cloud.points))
    if not known.is_placed and scan_m < _LEAST_SHOWN * mesh_m:
        raise MeshError(
            f"spans only {scan_m:.2g} m, and {known.name}, which it is to show, {mesh_m:.2g} m; is its unit right?"
        )


def _make_pieces(
    view: View,
    kept: Int[np.ndarray, "K"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    method: Literal["planes", "coacd"],
) -> Pieces:
    """Make pieces of the kept obstacle points; ``pieces[i].points`` are indices into ``view.obstacles``."""
    points, starts = view.obstacles[kept], view.starts[kept]
    if method == "coacd":
        made = make_coacd_pieces(points, starts, rays)
    else:
        noise, doubt = find_noise(view.near), _DOUBTFUL * view.cloud.origin_sigma
        made = make_pieces(points, starts, rays, view.seed, noise, doubt)
    return replace(made, pieces=tuple(replace(piece, points=kept[piece.points]) for piece in made.pieces))


def drop_explained(
    points: Float[np.ndarray, "N 3"], kept: Int[np.ndarray, "K"], matches: Mapping[str, MeshMatch]
) -> Int[np.ndarray, "L"]:
    """Return the kept indices without points explained by a mesh that was found with confidence.

    Points slightly beyond its tolerance count as its noise if no other kept point is near.
    """
    for match in matches.values():
        if match.confidence < CONFIDENT:
            continue
        kept = kept[~match.explains(points[kept])]
        kept = _drop_lone(points, kept, match.explains(points[kept], FRINGE))
    return kept


def drop_given(
    points: Float[np.ndarray, "N 3"], kept: Int[np.ndarray, "K"], hulls: Sequence[Float[np.ndarray, "V 3"]]
) -> Int[np.ndarray, "L"]:
    """Return the kept indices without points slightly beyond given solids, if no other kept point is near.

    Those on and inside the solids are not in the view.
    """
    return _drop_lone(points, kept, inside_hulls(points[kept], hulls, FRINGE * SELF_MARGIN))


def _drop_lone(
    points: Float[np.ndarray, "N 3"], kept: Int[np.ndarray, "K"], doubtful: Bool[np.ndarray, "K"]
) -> Int[np.ndarray, "L"]:
    """Return the kept indices without the doubtful ones that no other kept point is near."""
    lone = doubtful.copy()
    if lone.any() and not lone.all():
        lone[lone] = nearest(cKDTree(points[kept[~lone]]), points[kept[lone]], 1)[0] > _LONE
    return np.asarray(kept[~lone])
