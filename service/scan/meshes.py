"""Reading of a request's mesh files as solids, and decomposition of solids into convex parts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from costs.robot import RobotError, StillShape, read_object_shapes
from service.errors import RequestError
from service.request.shapes import OBJECT_SUFFIXES
from service.scan.given_objects import read_object

if TYPE_CHECKING:
    from perception.solids.mesh import Mesh, Solid

URDF = ".urdf"
FORMATS = (".stl", ".obj", ".ply", URDF, *OBJECT_SUFFIXES)


def read_solid(path: Path, field: str, scale: float = 1.0) -> Solid:
    """Read a mesh file, in its own frame [m].

    Args:
        path: STL, OBJ or PLY, or a URDF, whose collision shapes with every joint at zero form one object, or an object
            file with its parameters.
        field: field of the request that names the file.
        scale: metres per unit of the file.

    Raises:
        RequestError: the file is missing, of another format, too large or broken; the message names ``field``.
    """
    from perception import PerceptionError  # takes a while, and most scenes need none
    from perception.solids.mesh import make_solid, unite_solids
    from perception.solids.read import read_mesh

    if not path.is_file():
        raise RequestError(f"{field}: {path} is not there; paths start at the request's folder")
    if path.suffix.lower() not in FORMATS:
        raise RequestError(f"{field}: {path.name}: format '{path.suffix}' is not read; expected {', '.join(FORMATS)}")
    try:
        if path.suffix.lower() in OBJECT_SUFFIXES:
            return read_object(path, scale)
        if path.suffix.lower() != URDF:
            return make_solid(read_mesh(path, scale), path.name)
        return unite_solids(
            [make_solid(_read_shape(shape, scale), shape.where) for shape in read_object_shapes(path)], path.name
        )
    except RequestError as error:
        raise RequestError([f"{field}: {problem}" for problem in error.problems]) from None
    except (PerceptionError, RobotError) as error:
        raise RequestError(f"{field}: {error}") from None


def split_convex(solid: Solid, name: str, field: str, *, decompose: bool = True) -> list[Float[np.ndarray, "V 3"]]:
    """Return the vertices of convex parts that together contain a solid [m].

    A convex mesh is one part. CoACD's parts (Wei et al., SIGGRAPH 2022) follow the surface to about 1 cm.

    Args:
        name: name of the solid in errors.
        field: field of the request that names its file.
        decompose: whether to split the solid; else its hull is the only part.

    Raises:
        RequestError: CoACD crashed or needs too much; the message names ``field``.
    """
    from perception import PerceptionError
    from perception.solids import decompose as solids

    try:
        if not decompose:
            return [solids.make_hull_part(solid)]
        return list(solids.split_solid(solid, name=name))
    except PerceptionError as error:
        raise RequestError(f"{field}: {error}") from None


def _read_shape(shape: StillShape, scale: float) -> Mesh:
    """Return a shape's triangles in the object's frame; a round shape becomes its circumscribed polytope."""
    from perception.solids.read import read_mesh

    pose = shape.pose_object_shape.copy()
    pose[:3, 3] *= scale
    if shape.mesh is not None:
        return read_mesh(shape.mesh, shape.scale * scale).place(pose)
    return hull_mesh(np.asarray(shape.points) * scale).place(pose)


def hull_mesh(points: Float[np.ndarray, "N 3"]) -> Mesh:
    """Return the convex hull of points as triangles with outward normals."""
    from perception.solids.mesh import Mesh

    hull = ConvexHull(points)
    a, b, c = np.moveaxis(points[hull.simplices], 1, 0)
    is_inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0.0
    triangles = np.where(is_inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return Mesh(points, triangles.astype(np.int64))
