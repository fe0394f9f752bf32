"""An earlier ``scene.json`` as what a new scan of the same scene is held against."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked

from costs.scene import ConvexPiece, Scene
from perception import Earlier, Evidence, Perceived, Piece, Reach
from perception.convex.hulls import hull_of
from perception.solids.closed import Solid
from perception.solids.match import KnownMesh
from service.errors import RequestError, shown
from service.request.choices import Method, Unknown
from service.scan.known_meshes import KIND, PlacedMesh, Placing, explain_low_confidence
from service.scan.meshes import hull_mesh
from service.scan.scene_file import Number, scene_data

_OPTION = "--update"
_GONE = 0.5  # of the rays that should have met a mesh went on

Name = Annotated[str, Field(min_length=1)]


@checked(frozen=True)
class SceneSettings:
    """What a scene was made with, apart from its clouds."""

    reach_m: Annotated[Number, Field(gt=0.0)]
    top_m: Number
    bottom_m: Number
    seed: Annotated[int, Field(ge=0)]
    unknown: Unknown
    method: Method


@checked(frozen=True)
class _Seen:
    free_cells: Annotated[int, Field(ge=0)]
    free_share: Number
    open_share: Number
    plane: tuple[Number, Number, Number, Number] | None = None


@checked(frozen=True)
class _Piece:
    name: Name
    kind: str
    vertices: Annotated[list[tuple[Number, Number, Number]], Field(min_length=4)]
    seen: _Seen | None = None


@checked(frozen=True)
class _Mesh:
    name: Name
    file: str
    placing: Placing
    pose_world_mesh: list[list[Number]] | None
    pieces: list[str]


@checked(frozen=True)
class _File:
    settings: SceneSettings
    pieces: list[_Piece]
    meshes: list[_Mesh]


_READER = TypeAdapter(_File)


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
    meshes: tuple[_Mesh, ...]

    def without(self, names: Collection[str]) -> tuple[_Mesh, ...]:
        """The meshes that are not asked for anew."""
        return tuple(one for one in self.meshes if one.name not in names)

    @property
    def earlier(self) -> Earlier:
        """What an update is made from; known meshes are told of apart."""
        reach = Reach(radius=self.settings.reach_m, top=self.settings.top_m, bottom=self.settings.bottom_m)
        return Earlier(self.scene, self.pieces, reach, self.settings.seed)

    def known(self, mesh: _Mesh) -> KnownMesh:
        """A mesh as its pieces, which are in the world already."""
        parts = [piece.vertices for piece in self._parts(mesh)]
        return KnownMesh(mesh.name, Solid(tuple(hull_mesh(part) for part in parts), (), ()), np.eye(4), None, True)

    def placed(self, mesh: _Mesh, seen: Perceived) -> PlacedMesh:
        """What became of a mesh: it stays, unless it was found by a scan and most rays now go through it."""
        known, match = self.known(mesh), seen.matches[mesh.name]
        pose = None if mesh.pose_world_mesh is None else np.array(mesh.pose_world_mesh)
        if mesh.placing == "found" and match.residuals["seen_through"] > _GONE:
            reason = explain_low_confidence(match)
            note = f"{mesh.name} is gone: {reason}; {_OPTION} with --mesh '{mesh.file}' looks for it again"
            return PlacedMesh(known, mesh.file, "gone", match, pose, (), (note,))
        return PlacedMesh(known, mesh.file, mesh.placing, match, pose, self._parts(mesh), ())

    def _parts(self, mesh: _Mesh) -> tuple[ConvexPiece, ...]:
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
    data = scene_data(path, _OPTION)
    if "settings" not in data:
        raise RequestError(f"{_OPTION}: {path} does not say what it was made with; make it anew with 'scopt scene'")
    try:
        return _before(path, _READER.validate_python(data))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise RequestError(f"{_OPTION}: {path}: {where}: {first['msg']}; make it anew with 'scopt scene'") from None
    except ValueError as error:
        raise RequestError(f"{_OPTION}: {path}: {error}; make it anew with 'scopt scene'") from None


def _before(path: Path, file: _File) -> EarlierScene:
    shapes = {one.name: ConvexPiece(one.name, np.array(one.vertices), one.kind) for one in file.pieces}
    scene = Scene(tuple(ConvexPiece(one.name, np.array(one.vertices), one.kind) for one in file.pieces))
    pieces = tuple(_piece(shapes[one.name], one.seen) for one in file.pieces if one.seen is not None)
    standing = {piece.name for piece in scene.pieces if piece.kind == KIND}
    meshes = tuple(one for one in file.meshes if one.pieces)
    for mesh in meshes:
        if not standing.issuperset(mesh.pieces):
            raise ValueError(f"meshes: {shown(mesh.name)} names pieces that are not there")
    return EarlierScene(path, file.settings, scene, pieces, meshes)


def _piece(shape: ConvexPiece, seen: _Seen) -> Piece:
    if not shape.name.rpartition("/")[2].isdecimal():
        raise ValueError(f"pieces: {shown(shape.name)} is no name of a piece made of points")
    evidence = Evidence(seen.free_cells, seen.free_share, seen.open_share)
    plane: Float[np.ndarray, "4"] | None = None if seen.plane is None else np.array(seen.plane)
    hull = hull_of(shape.vertices, np.arange(0))
    return Piece(shape, np.arange(0), evidence, hull.simplified, plane)
