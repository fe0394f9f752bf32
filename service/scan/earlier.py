"""An earlier ``scene.json`` as what a new scan of the same scene is held against."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from costs.scene import ConvexPiece, Scene
from perception import Earlier, Evidence, Perceived, Piece, Reach
from perception.convex.hulls import make_hull
from perception.solids.match import KnownMesh
from perception.solids.mesh import Solid
from service.errors import RequestError, shown
from service.scan.known_meshes import KIND, PlacedMesh, explain_low_confidence
from service.scan.meshes import hull_mesh
from service.scan.scene_file import EvidenceRecord, MeshRecord, SceneSettings, UpdatableRecord, read_record

_OPTION = "--update"
_GONE = 0.5  # of the rays that should have met a mesh went on

_AGAIN = "; make it anew with 'scopt scene'"


@dataclass(frozen=True)
class EarlierScene:
    """A scene as its file tells it.

    Attributes:
        path: of the file.
        settings: it was made with.
        scene: all its pieces.
        pieces: those made of points.
        meshes: known meshes that stood in it.
    """

    path: Path
    settings: SceneSettings
    scene: Scene
    pieces: tuple[Piece, ...]
    meshes: tuple[MeshRecord, ...]

    def without(self, names: Collection[str]) -> tuple[MeshRecord, ...]:
        """The meshes that are not asked for anew."""
        return tuple(one for one in self.meshes if one.name not in names)

    @property
    def earlier(self) -> Earlier:
        """What an update is made from; known meshes are told of apart."""
        reach = Reach(radius=self.settings.reach_m, top=self.settings.top_m, bottom=self.settings.bottom_m)
        return Earlier(self.scene, self.pieces, reach, self.settings.seed)

    def known(self, mesh: MeshRecord) -> KnownMesh:
        """A mesh as its pieces, which are in the world already."""
        parts = [piece.vertices for piece in self._parts(mesh)]
        return KnownMesh(mesh.name, Solid(tuple(hull_mesh(part) for part in parts), (), ()), np.eye(4), None, True)

    def placed(self, mesh: MeshRecord, seen: Perceived) -> PlacedMesh:
        """What became of a mesh: it stays, unless it was found by a scan and most rays now go through it."""
        known, match = self.known(mesh), seen.matches[mesh.name]
        pose = None if mesh.pose_world_mesh is None else np.array(mesh.pose_world_mesh)
        if mesh.placing == "found" and match.residuals["seen_through"] > _GONE:
            reason = explain_low_confidence(match)
            note = f"{mesh.name} is gone: {reason}; {_OPTION} with --mesh '{mesh.file}' looks for it again"
            return PlacedMesh(known, mesh.file, "gone", match, pose, (), (note,))
        return PlacedMesh(known, mesh.file, mesh.placing, match, pose, self._parts(mesh), ())

    def _parts(self, mesh: MeshRecord) -> tuple[ConvexPiece, ...]:
        return tuple(piece for piece in self.scene.pieces if piece.name in mesh.pieces)

    def changes(self, pieces: Sequence[ConvexPiece]) -> dict[str, list[str]]:
        """Names of the pieces that stayed as they were, changed, are new, and are gone."""
        earlier = {piece.name: piece.vertices for piece in self.scene.pieces}
        names = {piece.name for piece in pieces}
        known = [piece for piece in pieces if piece.name in earlier]
        is_same = {piece.name: np.array_equal(earlier[piece.name], piece.vertices) for piece in known}
        return {
            "stayed": [name for name, same in is_same.items() if same],
            "changed": [name for name, same in is_same.items() if not same],
            "new": [piece.name for piece in pieces if piece.name not in earlier],
            "gone": [name for name in earlier if name not in names],
        }


def read_earlier_scene(path: Path) -> EarlierScene:
    """Read a scene that ``scopt scene`` wrote.

    Raises:
        RequestError: it is not there, no scene, or from a release that did not yet write what is needed.
    """
    record = read_record(path, _OPTION, UpdatableRecord, advice=_AGAIN)
    try:
        return _to_scene(path, record)
    except ValueError as error:
        raise RequestError(f"{_OPTION}: {path}: {error}{_AGAIN}") from None


def _to_scene(path: Path, record: UpdatableRecord) -> EarlierScene:
    scene = Scene(tuple(entry.piece for entry in record.pieces))
    pieces = tuple(_to_piece(entry.piece, entry.seen) for entry in record.pieces if entry.seen is not None)
    standing = {piece.name for piece in scene.pieces if piece.kind == KIND}
    meshes = tuple(mesh for mesh in record.meshes if mesh.pieces)
    for mesh in meshes:
        if not standing.issuperset(mesh.pieces):
            raise ValueError(f"meshes: {shown(mesh.name)} names pieces that are not there")
    return EarlierScene(path, record.settings, scene, pieces, meshes)


def _to_piece(shape: ConvexPiece, seen: EvidenceRecord) -> Piece:
    if not shape.name.rpartition("/")[2].isdecimal():
        raise ValueError(f"pieces: {shown(shape.name)} is no name of a piece made of points")
    evidence = Evidence(seen.free_cells, seen.free_share, seen.open_share)
    plane: Float[np.ndarray, "4"] | None = None if seen.plane is None else np.array(seen.plane)
    hull = make_hull(shape.vertices)
    return Piece(shape, np.arange(0), evidence, hull.simplified, plane)
