"""CoACD in a sandboxed process with limited memory and time; a crash becomes a one-line error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from perception.errors import MeshError
from perception.sandbox import Cause, ProcessLimits, SandboxError, run_in_sandbox

if TYPE_CHECKING:  # the sandboxed process starts faster without these imports
    from costs.array_cache import Parts
    from perception.solids.mesh import Mesh

COACD_LIMITS = ProcessLimits(max_bytes=4 * 2**30, max_wall_s=120.0)


def run_coacd(
    meshes: Sequence[Mesh], options: Mapping[str, object], limits: ProcessLimits = COACD_LIMITS, name: str = "mesh"
) -> list[Parts]:
    """Return the convex parts of each mesh, computed by CoACD in a sandboxed process.

    Args:
        meshes: closed, finite, wound outwards.
        options: keyword arguments of ``coacd.run_coacd``.

    Raises:
        MeshError: CoACD crashed, or needs more memory or time than the limits allow.
        Stopped: the caller cancelled; the process is killed.
    """
    values: dict[str, Any] = {"n_meshes": len(meshes), "options": dict(options)}
    values |= {f"vertices_{i}": mesh.vertices for i, mesh in enumerate(meshes)}
    values |= {f"triangles_{i}": mesh.triangles for i, mesh in enumerate(meshes)}
    try:
        result = run_in_sandbox(split_meshes, values, limits, n_threads=None)
    except SandboxError as error:
        raise MeshError(f"{name}: {_explain(error)}") from None
    return [tuple(np.split(result[f"parts_{i}"], np.cumsum(result[f"counts_{i}"])[:-1])) for i in range(len(meshes))]


def split_meshes(n_meshes: int, options: dict[str, Any], **arrays: np.ndarray) -> dict[str, np.ndarray]:
    """Split each mesh into convex parts, in this process.

    Args:
        arrays: ``vertices_i`` and ``triangles_i`` of each mesh.

    Returns:
        For each mesh ``parts_i``, the vertices of all parts, and ``counts_i``, the vertices per part.
    """
    import coacd

    coacd.set_log_level("off")
    result = {}
    for i in range(n_meshes):
        parts = coacd.run_coacd(coacd.Mesh(arrays[f"vertices_{i}"], arrays[f"triangles_{i}"]), **options)
        result[f"parts_{i}"] = np.concatenate([np.asarray(part[0], dtype=np.float64) for part in parts])
        result[f"counts_{i}"] = np.array([len(part[0]) for part in parts])
    return result


def _explain(error: SandboxError) -> str:
    if error.cause is Cause.CRASH:
        return f"cannot be split into convex parts (CoACD ended with {error.ending}); simplify or repair it"
    if error.cause is Cause.MEMORY:
        return f"splitting into convex parts needs more than {error.limit}; simplify it"
    return f"splitting into convex parts takes longer than {error.limit}; simplify it"
