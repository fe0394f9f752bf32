"""Triangle meshes: repair, and separation into closed and open parts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.spatial import ConvexHull

from perception.errors import MeshError

MAX_TRIANGLES = 500_000
_WELD = 1e-6  # of the mesh's size
_SMALL_HOLE = 0.15  # of the part's size


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes:
        triangles: (F, 3) vertex indices.
    """

    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "F 3"]

    def move(self, rotation: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]) -> Mesh:
        """Return the mesh rotated about the origin, then shifted [m]."""
        return Mesh(self.vertices @ rotation.T + shift, self.triangles)

    def place(self, pose_world_mesh: Float[np.ndarray, "4 4"]) -> Mesh:
        """Return the mesh in the world frame; a pose with a reflection is allowed."""
        return self.move(pose_world_mesh[:3, :3], pose_world_mesh[:3, 3])

    def stretch(self, scale: float | Float[np.ndarray, "3"]) -> Mesh:
        """Return the mesh larger by one factor, or by one for each axis; negative ones mirror it, wound as before."""
        factors = np.broadcast_to(np.asarray(scale, dtype=float), 3)
        is_mirrored = np.prod(np.sign(factors)) < 0.0
        return Mesh(self.vertices * factors, self.triangles[:, ::-1] if is_mirrored else self.triangles)

    @property
    def volume(self) -> float:
        """Volume of a closed mesh, negative when it is wound inside out [m^3]."""
        a, b, c = np.moveaxis(self.vertices[self.triangles] - self.vertices.mean(axis=0), 1, 0)
        return float((a * np.cross(b, c)).sum() / 6.0)


@dataclass(frozen=True)
class Solid:
    """A mesh split into closed and open parts.

    Attributes:
        closed: closed parts, wound outwards.
        open: parts with holes, which have a surface but no volume.
        notes: repairs and defects, one sentence each.
    """

    closed: tuple[Mesh, ...]
    open: tuple[Mesh, ...]
    notes: tuple[str, ...]

    @property
    def hull_share(self) -> float:
        """Share of the convex hull that the closed parts fill; where they overlap counts for each."""
        points = np.concatenate([mesh.vertices for mesh in (*self.closed, *self.open)])
        return sum(mesh.volume for mesh in self.closed) / float(ConvexHull(points).volume)


def make_solid(mesh: Mesh, name: str = "mesh") -> Solid:
    """Return the repaired mesh in parts: vertices welded, parts separated, triangles wound outwards, holes filled.

    Raises:
        MeshError: vertices that are not finite or do not exist, or a flat mesh.
    """
    _check(mesh, name)
    welded = _weld(mesh)
    if len(welded.triangles) < 4 or np.linalg.matrix_rank(welded.vertices - welded.vertices[0], tol=1e-9) < 3:
        raise MeshError(f"{name}: lies in a plane or on a line; expected a solid")
    closed, opened, notes = [], [], []
    n_dropped = len(mesh.triangles) - len(welded.triangles)
    if n_dropped:
        notes.append(f"{name}: left out {n_dropped} triangles without area or given twice")
    n_turned = n_filled = 0
    for part in _split_connected(welded):
        turned, n_wrong = _turn_outward(part)
        filled, n_holes = _fill_holes(turned)
        n_filled += n_holes
        if _is_closed(filled.triangles):
            # The sign of the volume shows which side is inside; it is valid only for a closed part.
            is_inverted = filled.volume < 0.0
            n_turned += len(part.triangles) - n_wrong if is_inverted else n_wrong
            closed.append(Mesh(filled.vertices, filled.triangles[:, ::-1]) if is_inverted else filled)
        else:
            opened.append(turned)
    if n_turned:
        notes.append(f"{name}: turned {n_turned} of {len(welded.triangles)} triangles that were wound inside out")
    if n_filled:
        notes.append(f"{name}: filled {n_filled} small holes")
    if opened:
        n_edges = sum(int((_count_edges(part.triangles)[2] == 1).sum()) for part in opened)
        notes.append(
            f"{name}: {len(opened)} of {len(closed) + len(opened)} parts are not closed ({n_edges} open edges); "
            "their surface is taken for a shell"
        )
    return Solid(tuple(closed), tuple(opened), tuple(notes))


def unite_solids(solids: Iterable[Solid], name: str = "object") -> Solid:
    """Return the parts of several solids as one; they may overlap.

    Raises:
        MeshError: they have more triangles than one mesh file may have.
    """
    closed: list[Mesh] = []
    opened: list[Mesh] = []
    notes: list[str] = []
    for solid in solids:
        closed, opened, notes = [*closed, *solid.closed], [*opened, *solid.open], [*notes, *solid.notes]
        if sum(len(mesh.triangles) for mesh in (*closed, *opened)) > MAX_TRIANGLES:
            raise MeshError(f"{name}: has more than {MAX_TRIANGLES} triangles; simplify its meshes")
    return Solid(tuple(closed), tuple(opened), tuple(notes))


def hull_mesh(points: Float[np.ndarray, "N 3"]) -> Mesh:
    """Return the convex hull of points as triangles with outward normals."""
    hull = ConvexHull(points)
    a, b, c = np.moveaxis(points[hull.simplices], 1, 0)
    is_inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0.0
    triangles = np.where(is_inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return Mesh(points, triangles.astype(np.int64))


def _check(mesh: Mesh, name: str) -> None:
    if not len(mesh.triangles):
        raise MeshError(f"{name}: has no triangles; expected a solid")
    if not np.isfinite(mesh.vertices).all():
        n_bad = int((~np.isfinite(mesh.vertices).all(axis=1)).sum())
        raise MeshError(f"{name}: {n_bad} of {len(mesh.vertices)} vertices are not finite; repair it")
    if mesh.triangles.min() < 0 or mesh.triangles.max() >= len(mesh.vertices):
        named = int(mesh.triangles.max())
        raise MeshError(f"{name}: a triangle names vertex {named}, and there are {len(mesh.vertices)}; repair it")


def _weld(mesh: Mesh) -> Mesh:
    """Merge vertices at the same position, and drop repeated triangles and triangles without area."""
    size = float(np.ptp(mesh.vertices, axis=0).max()) or 1.0
    cells = np.rint((mesh.vertices - mesh.vertices.min(axis=0)) / (_WELD * size)).astype(np.int64)
    _, first, number = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    vertices, triangles = mesh.vertices[first], number.reshape(-1)[mesh.triangles]
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    has_area = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-14 * size**2
    triangles = triangles[has_area]
    _, kept = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return _drop_unused(Mesh(vertices, triangles[np.sort(kept)]))


def _drop_unused(mesh: Mesh) -> Mesh:
    used, number = np.unique(mesh.triangles, return_inverse=True)
    return Mesh(mesh.vertices[used], number.reshape(-1, 3))


def _count_edges(
    triangles: Int[np.ndarray, "F 3"],
) -> tuple[Int[np.ndarray, "E"], Bool[np.ndarray, "E"], Int[np.ndarray, "K"]]:
    """Return, per directed edge (3 F), its undirected edge number and whether its indices rise; and counts per number.

    Directed edge ``3 f + i`` runs from corner i of triangle f to corner i + 1.
    """
    start, end = triangles.reshape(-1), np.roll(triangles, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * (int(triangles.max(initial=0)) + 1) + np.maximum(start, end)
    _, number, counts = np.unique(key, return_inverse=True, return_counts=True)
    return number.reshape(-1), start < end, counts


def _pair_edges(number: Int[np.ndarray, "E"], counts: Int[np.ndarray, "K"]) -> Int[np.ndarray, "P 2"]:
    """Return pairs (P, 2) of directed edges that are the only two on their undirected edge."""
    two = np.flatnonzero(counts[number] == 2)
    return two[np.argsort(number[two], kind="stable")].reshape(-1, 2)


def _split_connected(mesh: Mesh) -> list[Mesh]:
    """Split the mesh into parts connected by edges that exactly two triangles share."""
    number, _, counts = _count_edges(mesh.triangles)
    a, b = _pair_edges(number, counts).T // 3
    n = len(mesh.triangles)
    graph = sparse.coo_matrix((np.ones(len(a), dtype=bool), (a, b)), shape=(n, n))
    n_parts, label = sparse.csgraph.connected_components(graph, directed=False)
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.searchsorted(label[order], np.arange(1, n_parts)))
    return [_drop_unused(Mesh(mesh.vertices, mesh.triangles[group])) for group in groups]


def _turn_outward(part: Mesh) -> tuple[Mesh, int]:
    """Return the part with all triangles wound like the majority, and the number of triangles turned.

    A graph contains each triangle twice, unchanged and turned; edges connect the consistent states of neighbours.
    """
    number, upwards, counts = _count_edges(part.triangles)
    pairs = _pair_edges(number, counts)
    first, second = pairs.T // 3
    agree = upwards[pairs[:, 0]] != upwards[pairs[:, 1]]
    n = len(part.triangles)
    rows, columns = (
        np.concatenate([first, first + n]),
        np.concatenate([np.where(agree, second, second + n), np.where(agree, second + n, second)]),
    )
    graph = sparse.coo_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(2 * n, 2 * n))
    _, label = sparse.csgraph.connected_components(graph, directed=False)
    is_turned = label[:n] != label[0]
    if is_turned.sum() > n / 2:
        is_turned = ~is_turned
    triangles = part.triangles.copy()
    triangles[is_turned] = triangles[is_turned][:, ::-1]
    return Mesh(part.vertices, triangles), int(is_turned.sum())


def _is_closed(triangles: Int[np.ndarray, "F 3"]) -> bool:
    """Return whether each edge occurs exactly once in each direction."""
    number, upwards, counts = _count_edges(triangles)
    return bool((counts == 2).all() and (np.bincount(number, weights=upwards) == 1).all())


def is_closed(mesh: Mesh) -> bool:
    """Return whether every edge of the mesh has exactly two triangles, wound consistently."""
    return len(mesh.triangles) > 0 and _is_closed(mesh.triangles)


def _fill_holes(part: Mesh) -> tuple[Mesh, int]:
    """Return the part with small holes closed by triangle fans, and the number of holes."""
    number, _, counts = _count_edges(part.triangles)
    lone = np.flatnonzero(counts[number] == 1)
    start, end = part.triangles.reshape(-1)[lone], np.roll(part.triangles, -1, axis=1).reshape(-1)[lone]
    if not len(lone) or len(np.unique(start)) < len(start):
        return part, 0
    following = dict(zip(start.tolist(), end.tolist(), strict=True))
    limit = _SMALL_HOLE * float(np.ptp(part.vertices, axis=0).max())
    vertices, triangles, n_holes = [part.vertices], [part.triangles], 0
    while following:
        loop = [next(iter(following))]
        while (after := following.pop(loop[-1], None)) is not None and after != loop[0]:
            loop.append(after)
        if after is None or np.ptp(part.vertices[loop], axis=0).max() > limit:
            continue
        middle = len(part.vertices) + n_holes
        vertices.append(part.vertices[loop].mean(axis=0, keepdims=True))
        triangles.append(np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), middle)]))
        n_holes += 1
    return Mesh(np.concatenate(vertices), np.concatenate(triangles)), n_holes
