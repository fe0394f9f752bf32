"""Convex decomposition of meshes: the hull of a convex mesh, CoACD for others; the parts contain the mesh."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from costs.array_cache import Parts
from perception.convex.hulls import MAX_VERTICES, limit_vertices
from perception.errors import MeshError
from perception.sandbox import ProcessLimits
from perception.solids.cache import PartsCache
from perception.solids.mesh import Mesh, Solid
from perception.solids.process import COACD_LIMITS, run_coacd
from perception.solids.voxels import simplify_mesh, wrap_mesh

CONVEX_SHARE = 0.98  # a closed mesh that fills its hull to this share is convex
ENOUGH_TRIANGLES = 1500  # per part; more cost time and add no detail at these thresholds
_OUTSIDE = 0.0005  # [m]


@dataclass(frozen=True)
class CoacdSettings:
    """Accuracy and search effort of CoACD (Wei et al., SIGGRAPH 2022).

    The search is shallower than CoACD's default, which takes a table from 18 s to 4 s.

    Attributes:
        threshold_m: largest depth of a hollow that a part may bridge [m].
        iterations, nodes, depth: limits of the tree search.
        seed: seed of the sampling.
    """

    threshold_m: float = 0.01
    iterations: int = 60
    nodes: int = 10
    depth: int = 2
    seed: int = 0

    def options(self) -> dict[str, object]:
        """Return the keyword arguments of ``coacd.run_coacd``."""
        return {
            "threshold": self.threshold_m,
            "real_metric": True,
            "preprocess_mode": "off",  # input meshes are closed; CoACD's preprocessing takes minutes
            "mcts_iterations": self.iterations,
            "mcts_nodes": self.nodes,
            "mcts_max_depth": self.depth,
            "decimate": True,
            "max_ch_vertex": MAX_VERTICES,
            "seed": self.seed,
        }


@dataclass(frozen=True)
class CoacdResources:
    """Cache of results, and limits of the CoACD process.

    Attributes:
        cache: cache of results; None for no cache.
    """

    cache: PartsCache | None = field(default_factory=PartsCache.of_user)
    limits: ProcessLimits = COACD_LIMITS


def split_solid(
    solid: Solid, settings: CoacdSettings | None = None, resources: CoacdResources | None = None, name: str = "mesh"
) -> Parts:
    """Return vertices of convex parts, at most 64 each, that together contain the solid's surface to a millimetre [m].

    Args:
        solid: closed parts are split directly, open parts as thin shells.

    Raises:
        MeshError: CoACD crashed or exceeded its memory or time limit.
        Stopped: the caller cancelled.
    """
    stray = (settings or CoacdSettings()).threshold_m / 10.0
    whole = [simplify_mesh(mesh, ENOUGH_TRIANGLES, stray) for mesh in solid.closed]
    split = decompose([*whole, *(wrap_mesh(mesh) for mesh in solid.open)], settings, resources, name)
    meshes = (*solid.closed, *solid.open)
    parts = [part for parts, mesh in zip(split, meshes, strict=True) for part in _grow_to_contain(parts, mesh)]
    if not parts:
        raise MeshError(f"{name}: nothing of it spans a volume; expected a solid")
    return tuple(parts)


def make_hull_part(solid: Solid) -> Float[np.ndarray, "V 3"]:
    """Return at most 64 vertices of a convex hull that contains the whole solid [m]."""
    return limit_vertices(np.concatenate([mesh.vertices for mesh in (*solid.closed, *solid.open)]))


def decompose(
    meshes: Sequence[Mesh],
    settings: CoacdSettings | None = None,
    resources: CoacdResources | None = None,
    name: str = "mesh",
) -> list[Parts]:
    """Return convex parts of each closed mesh; one process splits all meshes that are not in the cache.

    Raises:
        MeshError, Stopped: as ``split_solid``.
    """
    settings, resources = settings or CoacdSettings(), resources or CoacdResources()
    answers: list[Parts | None] = [_take_if_convex(mesh) for mesh in meshes]
    keys = [hash_mesh(mesh, settings) if answer is None else "" for mesh, answer in zip(meshes, answers, strict=True)]
    if resources.cache is not None:
        answers = [
            resources.cache.get(key) if answer is None else answer for key, answer in zip(keys, answers, strict=True)
        ]
    missing = [i for i, answer in enumerate(answers) if answer is None]
    if missing:
        fresh = run_coacd([meshes[i] for i in missing], settings.options(), resources.limits, name)
        for i, parts in zip(missing, fresh, strict=True):
            answers[i] = parts = _drop_slivers(parts)
            if resources.cache is not None and parts:
                resources.cache.put(keys[i], parts)
    return [parts for parts in answers if parts is not None]


def hash_mesh(mesh: Mesh, settings: CoacdSettings) -> str:
    """Return the SHA-256 of vertices, triangles, settings and the version of CoACD."""
    digest = hashlib.sha256(json.dumps([version("coacd"), asdict(settings), settings.options()]).encode())
    digest.update(np.array(mesh.vertices.shape + mesh.triangles.shape).tobytes())
    digest.update(np.ascontiguousarray(mesh.vertices, dtype="<f8").tobytes())
    digest.update(np.ascontiguousarray(mesh.triangles, dtype="<i8").tobytes())
    return digest.hexdigest()


def _take_if_convex(mesh: Mesh) -> Parts | None:
    hull = ConvexHull(mesh.vertices)
    return (limit_vertices(mesh.vertices),) if mesh.volume >= CONVEX_SHARE * hull.volume else None


def _drop_slivers(parts: Parts) -> Parts:
    """Return the parts without those of zero volume, which CoACD sometimes makes."""
    kept = []
    for part in parts:
        try:
            ConvexHull(part)
        except QhullError:
            continue
        kept.append(part)
    return tuple(kept)


def _grow_to_contain(parts: Parts, mesh: Mesh) -> Parts:
    """Return the parts grown to contain all vertices, edge midpoints and face centres of the mesh, within 0.5 mm."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    surface = np.concatenate([mesh.vertices, (a + b + c) / 3.0, (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0])
    if not parts:
        return ()
    hulls = [ConvexHull(part).equations for part in parts]
    outside = np.stack([(surface @ faces[:, :3].T + faces[:, 3]).max(axis=1) for faces in hulls])
    nearest, left = outside.argmin(axis=0), outside.min(axis=0) > _OUTSIDE
    return tuple(
        limit_vertices(np.concatenate([part, surface[left & (nearest == i)]]))
        if (left & (nearest == i)).any()
        else part
        for i, part in enumerate(parts)
    )
