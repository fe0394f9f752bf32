"""A mesh file as convex parts, split by CoACD in a process of its own that can be stopped."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from service.errors import RequestError, shown

MAX_BYTES = 64 * 2**20
MAX_SECONDS = 60.0
MAX_MEMORY = 4 * 2**30
MAX_TRIANGLES = 500_000
CONCAVITY_M = 0.01
CONVEX_SHARE = 0.98  # a closed mesh that fills its hull to this share is convex
FORMATS = (".stl", ".obj", ".ply")


def convex_parts(path: Path, field: str) -> list[Float[np.ndarray, "V 3"]]:
    """Vertices of convex parts that together contain the mesh [m].

    A convex mesh is one part. CoACD's parts (Wei et al., SIGGRAPH 2022) follow the surface to about 1 cm.

    Raises:
        RequestError: naming ``field``: no such file, another format, too large, broken, or too long to split.
    """
    _check_file(path, field)
    command = [sys.executable, "-m", "service.mesh", str(path.resolve())]
    try:
        done = subprocess.run(command, capture_output=True, timeout=MAX_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        raise RequestError(
            f"{field}: splitting {path.name} takes longer than {MAX_SECONDS:.0f} s; simplify it"
        ) from None
    try:
        answer = json.loads(done.stdout.splitlines()[-1])
    except (IndexError, ValueError):
        raise RequestError(f"{field}: {path.name} cannot be split into convex parts; simplify or repair it") from None
    if "problem" in answer:
        raise RequestError(f"{field}: {path.name} {answer['problem']}")
    return [np.array(part) for part in answer["parts"]]


def _check_file(path: Path, field: str) -> None:
    if path.suffix.lower() not in FORMATS:
        raise RequestError(f"{field}: format {shown(path.suffix)} is not read; {', '.join(FORMATS)} would do")
    if not path.is_file():
        raise RequestError(f"{field}: {path} is not there; paths start at the request's folder")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise RequestError(f"{field}: {path.name} has {size} bytes; at most {MAX_BYTES} are read")


def _split(path: str) -> dict[str, object]:
    """Runs in the child: what a broken mesh does to its parser or to CoACD stays here."""
    import open3d

    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    mesh = open3d.io.read_triangle_mesh(Path(path))
    n_triangles = len(mesh.triangles)
    if not 4 <= n_triangles <= MAX_TRIANGLES:
        return {"problem": f"has {n_triangles} triangles; a solid with 4 to {MAX_TRIANGLES} would do"}
    if not np.isfinite(np.asarray(mesh.vertices)).all():
        return {"problem": "has a vertex that is not finite; repair it"}
    mesh.remove_duplicated_vertices()
    component = np.asarray(mesh.cluster_connected_triangles()[0])
    parts: list[object] = []
    for number in range(component.max() + 1):
        solid = open3d.geometry.TriangleMesh(mesh)
        solid.remove_triangles_by_mask(component != number)
        solid.remove_unreferenced_vertices()
        try:
            hull, _ = solid.compute_convex_hull()
        except RuntimeError:
            return {"problem": "has a part that lies in a plane; a solid would do"}
        if solid.is_watertight() and solid.get_volume() >= CONVEX_SHARE * hull.get_volume():
            parts.append(np.asarray(hull.vertices).tolist())
        else:
            parts += _decomposed(np.asarray(solid.vertices), np.asarray(solid.triangles))
    return {"parts": parts}


def _decomposed(vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"]) -> list[list[list[float]]]:
    """CoACD's parts; its search is shallower than by default, which takes a table from 18 s to 4 s."""
    import coacd  # after open3d, or it fails to load

    coacd.set_log_level("error")
    mesh = coacd.Mesh(vertices, triangles)
    parts = coacd.run_coacd(
        mesh, threshold=CONCAVITY_M, real_metric=True, mcts_iterations=60, mcts_nodes=10, mcts_max_depth=2
    )
    return [np.asarray(part[0]).tolist() for part in parts]


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
    print(json.dumps(_split(sys.argv[1])))
