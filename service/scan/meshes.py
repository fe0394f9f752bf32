"""Reading of a request's mesh files as solids, and decomposition of solids into convex parts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from costs.robot import RobotError, StillShape, read_object_shapes, read_triangles
from service.errors import RequestError
from service.request.shapes import OBJECT_SUFFIXES
from service.scan.given_objects import read_object

if TYPE_CHECKING:
    from perception.solids.mesh import Mesh, Solid

URDF = ".urdf"
SCENES = (".dae", ".glb", ".gltf")  # files of several parts with their places, which robots may be made of too
NOT_STRETCHED = (1.0, 1.0, 1.0)
FORMATS = (".stl", ".obj", ".ply", *SCENES, URDF, *OBJECT_SUFFIXES)


def read_solid(
    path: Path, field: str, scale: float = 1.0, scale_xyz: tuple[float, float, float] = NOT_STRETCHED
) -> Solid:
    """Read a mesh file, in its own frame [m].

    Args:
        path: STL, OBJ, PLY, Collada or glTF, or a URDF, whose collision shapes with every joint at zero form one
            object, or an object file with its parameters. Flat meshes become thin plates.
        field: field of the request that names the file.
        scale: metres per unit of the file.
        scale_xyz: further factors along the axes of the file; negative ones mirror.

    Raises:
        RequestError: the file is missing, of another format, too large or broken; the message names ``field``.
    """
    from perception import PerceptionError  # takes a while, and most scenes need none
    from perception.solids.mesh import unite_solids

    factors = np.array(scale_xyz)
    if not path.is_file():
        raise RequestError(f"{field}: {path} is not there; paths start at the request's folder")
    if path.suffix.lower() not in FORMATS:
        raise RequestError(f"{field}: {path.name}: format '{path.suffix}' is not read; expected {', '.join(FORMATS)}")
    try:
        if path.suffix.lower() in OBJECT_SUFFIXES:
            return read_object(path, scale * factors)
        if path.suffix.lower() != URDF:
            return _make_solid(_read_triangles(path, scale * factors), path.name)
        shapes = [(_read_shape(shape, scale).stretch(factors), shape.where) for shape in read_object_shapes(path)]
        return unite_solids([_make_solid(mesh, where) for mesh, where in shapes], path.name)
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


def _make_solid(mesh: Mesh, name: str) -> Solid:
    from perception.solids.mesh import make_solid
    from perception.solids.sheet import make_sheet

    return make_sheet(mesh, name) or make_solid(mesh, name)


def _read_triangles(path: Path, scale: float | Float[np.ndarray, "3"]) -> Mesh:
    """Return the triangles of a mesh file [m]; Collada and glTF say their own unit, and ``scale`` comes on top."""
    from perception.solids.mesh import Mesh
    from perception.solids.read import read_mesh

    if path.suffix.lower() not in SCENES:
        return read_mesh(path, scale)
    read = read_triangles(path, path.name)
    return Mesh(read.vertices, read.faces).stretch(scale)


def _read_shape(shape: StillShape, scale: float) -> Mesh:
    """Return a shape's triangles in the object's frame; a round shape becomes its circumscribed polytope."""
    from perception.solids.mesh import hull_mesh

    pose = shape.pose_object_shape.copy()
    pose[:3, 3] *= scale
    if shape.mesh is not None:
        return _read_triangles(shape.mesh, shape.scale * scale).place(pose)
    return hull_mesh(np.asarray(shape.points) * scale).place(pose)
