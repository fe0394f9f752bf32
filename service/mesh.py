"""Mesh files of a request as convex parts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from service.errors import RequestError

if TYPE_CHECKING:
    from perception import View


def convex_parts(
    path: Path, field: str, scale: float = 1.0, *, decompose: bool = True
) -> list[Float[np.ndarray, "V 3"]]:
    """Vertices of convex parts that together contain the mesh [m].

    A convex mesh is one part. CoACD's parts (Wei et al., SIGGRAPH 2022) follow the surface to about 1 cm.

    Args:
        path: STL, OBJ or PLY.
        field: of the request that names it.
        scale: metres per unit of the file.
        decompose: whether to split it; else its hull is the one part.

    Raises:
        RequestError: naming ``field``: no such file, another format, too large, broken, or too long to split.
    """
    from perception import PerceptionError  # takes a while, and most scenes need none
    from perception.solids import decompose as solids
    from perception.solids.closed import solid_of
    from perception.solids.read import read_mesh

    _check_there(path, field)
    try:
        mesh = read_mesh(path, scale)
        solid = solid_of(mesh, path.name)
        return list(solids.convex_parts(solid, name=path.name)) if decompose else [solids.hull_part(solid)]
    except PerceptionError as error:
        raise RequestError(f"{field}: {error}") from None


def found_pose(
    path: Path, scale: float, initial: Float[np.ndarray, "4 4"], view: View, field: str
) -> Float[np.ndarray, "4 4"]:
    """Where the mesh stands in the scan, near where it is thought to be.

    Raises:
        RequestError: naming ``field``: the file cannot be used, or the scan does not show the mesh there.
    """
    from perception import CONFIDENT, PerceptionError
    from perception.solids.match import match_mesh
    from perception.solids.read import read_mesh

    _check_there(path, field)
    try:
        found = match_mesh(read_mesh(path, scale), view, initial=initial)
    except PerceptionError as error:
        raise RequestError(f"{field}: {error}") from None
    if found.confidence < CONFIDENT:
        place = ", ".join(f"{value:.2f}" for value in initial[:3, 3])
        raise RequestError(
            f"{field}: the scan does not show {path.name} near ({place}): confidence {found.confidence:.2f}, "
            f"{CONFIDENT} is needed; place it within 15 cm and 20 degrees, or leave match out"
        )
    return found.pose_world_mesh


def _check_there(path: Path, field: str) -> None:
    if not path.is_file():
        raise RequestError(f"{field}: {path} is not there; paths start at the request's folder")
