"""Known meshes of ``scopt scene``: what is asked with ``--mesh``, and what becomes of each."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from costs.scene import ConvexPiece
from perception import CONFIDENT, PerceptionError, rigid_pose
from perception.perceive import FRINGE
from perception.solids.match import KnownMesh, MeshMatch
from perception.solids.mesh import Solid
from service.errors import RequestError
from service.json_data import plain
from service.request.scene import KnownMeshRequest
from service.scan.cloud import numbers
from service.scan.meshes import FORMATS, read_solid, split_convex
from service.scan.scene_file import Placing
from service.trust.folders import UPLOADED

KIND = "object"
UPLOAD_NAME = "mesh"  # of one whose file is an upload, where it is given none
# What no mesh may be called: pieces of these names are made of the scan.
_TAKEN = ("floor", "plane", "wall", "clutter", "unknown", "coacd", "stem")
_OPTION = "--mesh"
_SPANS = (1e-3, 100.0)
_FORMS = "FILE, 'FILE near X Y Z', 'FILE near POSE' or 'FILE at POSE'"
_AFTER = {3: "X Y Z", 6: "X Y Z YAW PITCH ROLL", 7: "X Y Z QW QX QY QZ", 16: "16 numbers"}

# By the scene file's rule (docs/scene-format.md) a name tells what is no length.
_RESIDUALS = {
    "seen_through": "seen_through_share",
    "hidden": "hidden_share",
    "unexplained": "unexplained_ratio",
    "rival": "rival_ratio",
}


@dataclass(frozen=True)
class MeshInput:
    """A mesh file, and what is known of where the mesh stands.

    Attributes:
        file: STL, OBJ, PLY or URDF.
        scale: metres per unit of the file.
        pose_world_mesh: (4, 4); None where it is to be found.
        hint: (3,) a point near it, where there is no pose [m].
        is_placed: whether it stands exactly at its pose; else it is matched to the scan about it.
        name: of its pieces; empty for that of the file.
        called: what the file is called where it is spoken of; empty for its path.
    """

    file: Path
    scale: float = 1.0
    pose_world_mesh: Float[np.ndarray, "4 4"] | None = None
    hint: Float[np.ndarray, "3"] | None = None
    is_placed: bool = False
    name: str = ""
    called: str = ""

    @property
    def words(self) -> str:
        """The file, where it is spoken of."""
        return self.called or str(self.file)


@dataclass(frozen=True)
class PlacedMesh:
    """What became of a known mesh.

    Attributes:
        known: the mesh, and where it was said to be.
        file: that it was read from, as it was named.
        placing: ``given`` (it stands where it was placed), ``found`` (it stands where the scan shows it), ``not found``
            or ``gone`` (it does not stand in the scene).
        match: what the scan says of it.
        pose_world_mesh: (4, 4) of the file's own frame; None where nothing was found at all.
        pieces: its convex parts in the world; none unless it stands there.
        notes: what was repaired in it and what is odd about where it is.
    """

    known: KnownMesh
    file: str
    placing: Placing
    match: MeshMatch
    pose_world_mesh: Float[np.ndarray, "4 4"] | None
    pieces: tuple[ConvexPiece, ...]
    notes: tuple[str, ...]

    def explains(self, points: Float[np.ndarray, "N 3"]) -> Int[np.ndarray, "K"]:
        """Indices of the points that it stands for."""
        if not self.pieces or self.match.confidence < CONFIDENT:
            return np.arange(0)
        return np.flatnonzero(self.match.explains(points, FRINGE))

    def to_json(self) -> dict[str, Any]:
        """As the scene file holds it; lengths in metres."""
        return {
            "name": self.known.name,
            "file": self.file,
            "placing": self.placing,
            "confidence": round(self.match.confidence, 4),
            "pose_world_mesh": plain(self.pose_world_mesh),
            "residuals": {
                _RESIDUALS.get(name, name): float(value)
                for name, value in self.match.residuals.items()
                if np.isfinite(value)
            },
            "pieces": [piece.name for piece in self.pieces],
        }


def parse_mesh_option(text: str, scale: float = 1.0) -> MeshInput:
    """What one ``--mesh`` asks: a file, where it stands (``at``), or about where to look for it (``near``).

    Raises:
        RequestError: there is no such file, or what follows its name is no pose.
    """
    file, how, words = Path(text), "", ""
    said = re.fullmatch(r"(.+)\s+(at|near)(?:\s+(.*))?", text.strip(), re.DOTALL)
    if said is not None and not os.path.isfile(file):
        file, how, words = Path(said[1]), said[2], said[3] or ""
    if not os.path.isfile(file):
        how = "is a folder" if os.path.isdir(file) else "is not there"
        raise RequestError(f"{_OPTION}: {file} {how}; expected {_FORMS}")
    if file.suffix.lower() not in FORMATS:
        known = ", ".join(FORMATS)
        raise RequestError(f"{_OPTION}: {file}: format '{file.suffix}' is not read; expected {known}")
    if not how:
        return MeshInput(file, scale)
    values = numbers(words, f"{_OPTION}: {file} {how}")
    if len(values) not in _AFTER:
        forms = ", ".join(f"'{form}'" for form in _AFTER.values())
        raise RequestError(f"{_OPTION}: {file} {how}: expected {forms}, got '{words}'")
    try:
        pose = rigid_pose((*values, 0.0, 0.0, 0.0) if len(values) == 3 else values)
    except PerceptionError as error:
        raise RequestError(f"{_OPTION}: {file} {how}: {str(error).replace('transform', 'pose', 1)}") from None
    if how == "near" and len(values) == 3:
        return MeshInput(file, scale, hint=pose[:3, 3])
    return MeshInput(file, scale, pose, is_placed=how == "at")


def mesh_from_request(request: KnownMeshRequest, file: Path) -> MeshInput:
    """What a request says of a mesh whose file is kept here."""
    place, turn = request.position, request.quaternion_wxyz
    name = request.name or (UPLOAD_NAME if request.file.startswith(UPLOADED) else "")
    asked = MeshInput(file, request.scale, is_placed=request.is_placed, name=name, called=request.file)
    if place is None:
        return asked
    if turn is None and not request.is_placed:
        return replace(asked, hint=np.array(place))
    return replace(asked, pose_world_mesh=rigid_pose((*place, *(turn or (1.0, 0.0, 0.0, 0.0)))))


def load_known_meshes(asked: Sequence[MeshInput], taken: Collection[str] = ()) -> tuple[KnownMesh, ...]:
    """The meshes read, each named as its file, numbered where that name is taken.

    Raises:
        RequestError: a file that cannot be used, or a scale with which it would be no object of this world.
    """
    names = _names([one.name or one.file.stem for one in asked], {*_TAKEN, *taken})
    return tuple(
        KnownMesh(name, _solid(one), one.pose_world_mesh, one.hint, one.is_placed)
        for name, one in zip(names, asked, strict=True)
    )


def _solid(asked: MeshInput) -> Solid:
    solid = read_solid(asked.file, _OPTION, asked.scale)
    vertices = np.concatenate([mesh.vertices for mesh in (*solid.closed, *solid.open)])
    span = float(np.ptp(vertices, axis=0).max())
    if not _SPANS[0] <= span <= _SPANS[1]:
        raise RequestError(
            f"{_OPTION}: {asked.words} spans {span:.3g} m at --mesh-scale {asked.scale:g}; "
            f"expected {_SPANS[0]:g} to {_SPANS[1]:g} m"
        )
    return solid


def _names(stems: Sequence[str], taken: set[str]) -> Iterator[str]:
    for stem in stems:
        name, number = stem, 1
        while name in taken:
            number += 1
            name = f"{stem}-{number}"
        taken.add(name)
        yield name


def place_meshes(
    known: Sequence[KnownMesh], asked: Sequence[MeshInput], matches: Mapping[str, MeshMatch]
) -> list[PlacedMesh]:
    """What became of each; those that stand in the scene are split into convex parts.

    Raises:
        RequestError: CoACD crashed or needs too much.
    """
    return [_place_mesh(one, mesh.words, matches[one.name]) for one, mesh in zip(known, asked, strict=True)]


def _place_mesh(known: KnownMesh, file: str, match: MeshMatch) -> PlacedMesh:
    notes = list(known.solid.notes)
    is_sure = match.confidence >= CONFIDENT
    reason = explain_low_confidence(match)
    if known.is_placed and not is_sure:
        notes.append(f"{known.name} stands where it was placed, but the scan does not show it there: {reason}")
    if not known.is_placed and not is_sure:
        notes.append(
            f"{known.name} is not in the scene, since the scan does not show it: {reason}; "
            f"if it is there, {_OPTION} '{file} near X Y Z' or '{file} at POSE' may help"
        )
        pose = match.pose_world_mesh if match.residuals["n_points"] else None
        return PlacedMesh(known, file, "not found", match, pose, (), tuple(notes))
    pose = match.pose_world_mesh
    parts = split_convex(known.solid, Path(file).name, _OPTION)
    pieces = tuple(
        ConvexPiece(f"{known.name}/{number}", part @ pose[:3, :3].T + pose[:3, 3], KIND)
        for number, part in enumerate(parts, start=1)
    )
    return PlacedMesh(known, file, "given" if known.is_placed else "found", match, pose, pieces, tuple(notes))


def explain_low_confidence(match: MeshMatch) -> str:
    """Why a mesh's confidence is low, in words."""
    told = match.residuals
    shares = {
        "hidden": "of the rays towards it ended before it",
        "seen_through": "of the rays that reached its place went on",
    }
    reasons = [f"{100.0 * told[name]:.0f} % {words}" for name, words in shares.items() if told.get(name, 0.0) > 0.1]
    if not reasons:
        reasons = [f"{int(told['n_points'])} points lie on it"]
    # Rounded down: what is a little too little must not read as enough.
    return f"confidence {np.floor(100.0 * match.confidence) / 100.0:.2f}, {CONFIDENT} is needed ({', '.join(reasons)})"
