"""Files of a request's mechanisms, read into the request, so that its result and its hash say everything."""

from __future__ import annotations

import dataclasses

from costs.robot import RobotError, read_mesh_hulls
from costs.robot.xmlfile import read_xml_text
from service.errors import RequestError
from service.request.schema import PlanRequest
from service.request.tasks.mechanism import (
    MAX_MESH_POINTS,
    MAX_TEXT,
    MechanismRequest,
    MeshHullRequest,
    is_urdf_text,
)


def inline_mechanisms(request: PlanRequest) -> PlanRequest:
    """Return the request with the text of its mechanisms' URDFs instead of paths, and with their meshes' hulls.

    Meshes of a URDF file are read from inside its folder; a request with the text has its meshes.

    Raises:
        RequestError: one line; a file is missing or cannot be used.
    """
    if request.task is None:
        return request
    task = request.task.replace_mechanisms(lambda field, mechanism: _inline(request, f"{field}.urdf", mechanism))
    return dataclasses.replace(request, task=task)


def _inline(request: PlanRequest, field: str, mechanism: MechanismRequest) -> MechanismRequest:
    if is_urdf_text(mechanism.urdf):
        return mechanism
    path = request.resolve(mechanism.urdf)
    if not path.is_file():
        raise RequestError(f"{field}: {path} is not there; paths start at the request's folder")
    try:
        text = read_xml_text(path).lstrip("\ufeff \t\r\n")
        if len(text) > MAX_TEXT or not is_urdf_text(text):
            raise RobotError(f"{path.name}: expected a URDF of at most {MAX_TEXT} characters")
        hulls = read_mesh_hulls(text, path.name, path.parent)
    except RobotError as error:
        raise RequestError(f"{field}: {' '.join(str(error).split())}") from None
    for name, hull in hulls.items():
        if len(hull) > MAX_MESH_POINTS:
            raise RequestError(
                f"{field}: the hull of mesh '{name}' has {len(hull)} corners; expected at most {MAX_MESH_POINTS}"
            )
    meshes = {name: MeshHullRequest(tuple((x, y, z) for x, y, z in hull.tolist())) for name, hull in hulls.items()}
    return dataclasses.replace(mechanism, urdf=text, meshes={**meshes, **mechanism.meshes})
