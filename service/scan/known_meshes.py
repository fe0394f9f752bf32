"""Known meshes of ``scopt scene --mesh``: their options, files, and poses in the scene."""

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
from perception.perceived import FRINGE
from perception.solids.match import KnownMesh
from perception.solids.mesh import Solid
from perception.solids.rating import MeshMatch
from service.errors import RequestError
from service.request.object_file import is_object_text, parse_object_text
from service.request.scene import KnownMeshRequest
from service.request.shapes import ObjectRequest
from service.scan.cloud import parse_numbers
from service.scan.given_objects import make_object
from service.scan.json_data import to_json_data
from service.scan.meshes import FORMATS, read_solid, split_convex
from service.scan.scene_file import Placing
from service.trust.folders import UPLOADED

KIND = "object"
UPLOAD_NAME = "mesh"  # name of an uploaded mesh without a name
# Names of pieces made from the scan, which no mesh may have.
_TAKEN = ("floor", "plane", "wall", "clutter", "unknown", "coacd", "stem")
_OPTION = "--mesh"
_SPANS = (1e-3, 100.0)
_FORMS = "FILE, 'FILE near X Y Z', 'FILE near POSE' or 'FILE at POSE', or TYPE NAME=NUMBER ... in place of FILE"
_AFTER = {3: "X Y Z", 6: "X Y Z YAW PITCH ROLL", 7: "X Y Z QW QX QY QZ", 16: "16 numbers"}

# By the scene file's rule (docs/scene-format.md) the name of a value that is not a length shows its unit.
_RESIDUALS = {
    "seen_through": "seen_through_share",
    "missing": "missing_share",
    "hidden": "hidden_share",
    "unexplained": "unexplained_ratio",
    "held": "held_ratio",
    "on_planes": "on_planes_share",
    "rival": "rival_ratio",
    "beside": "beside_ratio",
    "seen": "seen_share",
    "confirmed": "confirmed_share",
    "telling": "telling_ratio",
    "cut": "cut_share",
}
# Values from which a reason for a low confidence is given.
_TELLS, _CUT = 0.12, 0.2


@dataclass(frozen=True)
class MeshInput:
    """A mesh file, and the known or approximate pose of the mesh.

    Attributes:
        file: STL, OBJ, PLY, URDF or object file; the type of an object given by a line of text.
        scale: metres per unit of the file.
        pose_world_mesh: (4, 4) pose; None if the mesh is to be found.
        hint: (3,) point near the mesh if it has no pose [m].
        is_placed: whether the pose is exact; else the mesh is matched to the scan around it.
        name: name of its pieces; empty for the file's name.
        called: name of the file in messages; empty for its path.
        given: the object's parameters, if they are not in a file.
    """

    file: Path
    scale: float = 1.0
    pose_world_mesh: Float[np.ndarray, "4 4"] | None = None
    hint: Float[np.ndarray, "3"] | None = None
    is_placed: bool = False
    name: str = ""
    called: str = ""
    given: ObjectRequest | None = None

    @property
    def file_text(self) -> str:
        """Name of the file for messages."""
        return self.called or str(self.file)


@dataclass(frozen=True)
class PlacedMesh:
    """A known mesh after its match with the scan.

    Attributes:
        known: the mesh and its requested pose.
        file: name of its file in messages.
        placing: ``given`` (at its requested pose), ``found`` (at the pose found in the scan), ``not found`` or ``gone``
            (not in the scene).
        match: its match with the scan.
        pose_world_mesh: (4, 4) pose of the file's frame; None without a match.
        pieces: its convex parts in the world; empty if it is not in the scene.
        notes: repairs of the mesh, and doubts about its pose.
    """

    known: KnownMesh
    file: str
    placing: Placing
    match: MeshMatch
    pose_world_mesh: Float[np.ndarray, "4 4"] | None
    pieces: tuple[ConvexPiece, ...]
    notes: tuple[str, ...]

    def explains(self, points: Float[np.ndarray, "N 3"]) -> Int[np.ndarray, "K"]:
        """Return the indices of the points on or inside the mesh."""
        if not self.pieces or self.match.confidence < CONFIDENT:
            return np.arange(0)
        return np.flatnonzero(self.match.explains(points, FRINGE))

    def to_json(self) -> dict[str, Any]:
        """Return the mesh's entry in a scene file; lengths in metres."""
        return {
            "name": self.known.name,
            "file": self.file,
            "placing": self.placing,
            "confidence": round(self.match.confidence, 4),
            "pose_world_mesh": to_json_data(self.pose_world_mesh),
            "residuals": encode_residuals(self.match),
            "pieces": [piece.name for piece in self.pieces],
        }


def encode_residuals(match: MeshMatch) -> dict[str, float]:
    """Return the residuals of a match by their names in files; those that are not finite are left out."""
    return {_RESIDUALS.get(name, name): float(value) for name, value in match.residuals.items() if np.isfinite(value)}


def parse_mesh_option(text: str, scale: float = 1.0, option: str = _OPTION) -> MeshInput:
    """Parse one ``--mesh``: a file or an object's parameters, and its pose (``at``) or where to search (``near``).

    Raises:
        RequestError: the file does not exist, a parameter is wrong, or the text after it is not a pose.
    """
    file, how, words = Path(text), "", ""
    parts = re.fullmatch(r"(.+)\s+(at|near)(?:\s+(.*))?", text.strip(), re.DOTALL)
    if parts is not None and not os.path.isfile(file):
        file, how, words = Path(parts[1]), parts[2], parts[3] or ""
    mesh = _choose_mesh(file, scale, option)
    if not how:
        return mesh
    values = parse_numbers(words, f"{option}: {file} {how}")
    if len(values) not in _AFTER:
        forms = ", ".join(f"'{form}'" for form in _AFTER.values())
        raise RequestError(f"{option}: {file} {how}: expected {forms}, got '{words}'")
    try:
        pose = rigid_pose((*values, 0.0, 0.0, 0.0) if len(values) == 3 else values)
    except PerceptionError as error:
        raise RequestError(f"{option}: {file} {how}: {str(error).replace('transform', 'pose', 1)}") from None
    if how == "near" and len(values) == 3:
        return replace(mesh, hint=pose[:3, 3])
    return replace(mesh, pose_world_mesh=pose, is_placed=how == "at")


def _choose_mesh(file: Path, scale: float, option: str) -> MeshInput:
    """Return the mesh of a file, or of an object's parameters that stand in its place."""
    if is_object_text(str(file)) and not os.path.isfile(file):
        try:
            given = parse_object_text(str(file))
        except RequestError as error:
            raise RequestError([f"{option}: {problem}" for problem in error.problems]) from None
        return MeshInput(Path(given.parts[0].type), scale, called=str(file), given=given)
    if not os.path.isfile(file):
        how = "is a folder" if os.path.isdir(file) else "is not there"
        raise RequestError(f"{option}: {file} {how}; expected {_FORMS}")
    if file.suffix.lower() not in FORMATS:
        known = ", ".join(FORMATS)
        raise RequestError(f"{option}: {file}: format '{file.suffix}' is not read; expected {known}")
    return MeshInput(file, scale)


def mesh_from_request(request: KnownMeshRequest, file: Path | None) -> MeshInput:
    """Convert a request's mesh.

    Args:
        file: its file on this server; None for an object given by its parts.
    """
    place, turn = request.position, request.quaternion_wxyz
    name = request.name or (UPLOAD_NAME if request.file is not None and request.file.startswith(UPLOADED) else "")
    if file is None:
        called = name or request.parts[0].type
        mesh = MeshInput(Path(request.parts[0].type), request.scale, given=ObjectRequest(request.parts))
    else:
        called = str(request.file)
        mesh = MeshInput(file, request.scale)
    mesh = replace(mesh, is_placed=request.is_placed, name=name, called=called)
    if place is None:
        return mesh
    if turn is None and not request.is_placed:
        return replace(mesh, hint=np.array(place))
    return replace(mesh, pose_world_mesh=rigid_pose((*place, *(turn or (1.0, 0.0, 0.0, 0.0)))))


def load_known_meshes(
    meshes: Sequence[MeshInput], taken: Collection[str] = (), option: str = _OPTION
) -> tuple[KnownMesh, ...]:
    """Read the meshes; each gets its requested or its file's name, numbered if that name is taken.

    Raises:
        RequestError: a file cannot be used, or a scale gives an implausible size.
    """
    names = _make_names([mesh.name or mesh.file.stem for mesh in meshes], {*_TAKEN, *taken})
    return tuple(
        KnownMesh(name, _read_mesh(mesh, option), mesh.pose_world_mesh, mesh.hint, mesh.is_placed)
        for name, mesh in zip(names, meshes, strict=True)
    )


def _read_mesh(mesh: MeshInput, option: str) -> Solid:
    if mesh.given is None:
        solid = read_solid(mesh.file, option, mesh.scale)
    else:
        try:
            solid = make_object(mesh.given, mesh.file.name, mesh.scale)
        except RequestError as error:
            raise RequestError(f"{option}: {error}") from None
    vertices = np.concatenate([part.vertices for part in (*solid.closed, *solid.open)])
    span = float(np.ptp(vertices, axis=0).max())
    if not _SPANS[0] <= span <= _SPANS[1]:
        raise RequestError(
            f"{option}: {mesh.file_text} spans {span:.3g} m at --mesh-scale {mesh.scale:g}; "
            f"expected {_SPANS[0]:g} to {_SPANS[1]:g} m"
        )
    return solid


def _make_names(stems: Sequence[str], taken: set[str]) -> Iterator[str]:
    for stem in stems:
        name, number = stem, 1
        while name in taken:
            number += 1
            name = f"{stem}-{number}"
        taken.add(name)
        yield name


def place_meshes(
    known: Sequence[KnownMesh], meshes: Sequence[MeshInput], matches: Mapping[str, MeshMatch]
) -> list[PlacedMesh]:
    """Return the meshes at their poses, split into convex parts if they are in the scene.

    Raises:
        RequestError: CoACD crashed or needs too much.
    """
    return [_place_mesh(item, mesh.file_text, matches[item.name]) for item, mesh in zip(known, meshes, strict=True)]


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
    """Return the reasons for a low confidence, in words."""
    residuals = match.residuals
    shares = {
        "hidden": "of the rays towards it ended before it",
        "seen_through": "of the rays that reached its place went on",
    }
    reasons = [
        f"{100.0 * residuals[name]:.0f} % {words}" for name, words in shares.items() if residuals.get(name, 0.0) > 0.1
    ]
    if residuals.get("telling", 1.0) < _TELLS:
        reasons.append("what is seen may be a block of its outline as well")
    if residuals.get("cut", 0.0) > _CUT:
        reasons.append("it ends at the edge of the field of view")
    if not reasons:
        reasons = [f"{int(residuals['n_points'])} points lie on it"]
    # Rounded down, so that a value slightly below its threshold is not printed as sufficient.
    return f"confidence {np.floor(100.0 * match.confidence) / 100.0:.2f}, {CONFIDENT} is needed ({', '.join(reasons)})"
