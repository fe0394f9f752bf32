"""OpenRAVE files of a result: an environment of trimesh kinbodies and a GenericTrajectory.

Formats: OpenRAVE's "kinbody" XML (a trimesh's ``vertices`` are nine numbers per triangle) and its trajectory XML
(http://openrave.org/docs/latest_stable/, GenericTrajectory).  The robot itself is the URDF of
the result's ``robot`` folder; load it under the result's robot name and the trajectory fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from lxml import etree

from service.viewer.files import replace_file
from service.viewer.hulls import make_convex_mesh

BASE_COLUMNS = ("base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz")
AFFINE_DOFS = 39
"""OpenRAVE's ``DOF_X | DOF_Y | DOF_Z | DOF_RotationQuat``: x y z qw qx qy qz."""

COLOURS = {"floor": "0.62 0.65 0.70", "rim": "0.90 0.35 0.20", "hub": "0.60 0.22 0.12"}
PIECE_COLOUR = "0.50 0.62 0.82"


def write_openrave(result: Mapping[str, Any], folder: Path) -> tuple[Path, ...]:
    """Write ``environment.xml`` and, if the result has a trajectory, ``trajectory.xml``; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    documents = {"environment.xml": make_environment(result)}
    if (result.get("trajectory") or {}).get("times"):
        documents["trajectory.xml"] = make_trajectory(result)
    for name, root in documents.items():
        text = etree.tostring(root, encoding="utf-8", pretty_print=True, xml_declaration=True)
        replace_file(folder / name, text)
    return tuple(folder / name for name in documents)


def make_environment(result: Mapping[str, Any]) -> Any:
    """Return ``<environment>`` with a static kinbody per piece and one with a hinge per movable."""
    root = etree.Element("environment")
    for piece in result.get("pieces") or []:
        kinbody = etree.SubElement(root, "kinbody", name=_make_identifier(piece["name"]))
        _add_geom(etree.SubElement(kinbody, "body", name="base", type="static"), piece)
    for movable in result.get("movables") or []:
        _add_movable(root, movable)
    return root


def make_trajectory(result: Mapping[str, Any]) -> Any:
    """Return ``<trajectory>``: base pose, joint values and time step of the robot, and the angle of every movable.

    Degrees of freedom are numbered in the order of ``trajectory.joint_names``, which the description lists.
    """
    trajectory = result["trajectory"]
    robot = _make_identifier((result.get("robot") or {}).get("name") or "robot")
    names: Sequence[str] = trajectory["joint_names"]
    positions = np.asarray(trajectory["positions"], dtype=float)
    times = np.asarray(trajectory["times"], dtype=float)
    n_base = len(BASE_COLUMNS) if tuple(names[: len(BASE_COLUMNS)]) == BASE_COLUMNS else 0

    indices = " ".join(str(index) for index in range(len(names) - n_base))
    groups = [(f"joint_values {robot} {indices}", "linear", positions[:, n_base:])]
    if n_base:
        groups.append((f"affine_transform {robot} {AFFINE_DOFS}", "linear", positions[:, :n_base]))
    for movable in result.get("movables") or []:
        if len(movable.get("angles") or []) == len(times):
            angles = np.asarray(movable["angles"], dtype=float)[:, None]
            groups.append((f"joint_values {_make_identifier(movable['name'])} 0", "linear", angles))
    groups.append(("deltatime", "", np.diff(times, prepend=times[0])[:, None]))

    root = etree.Element("trajectory", type="GenericTrajectory")
    configuration = etree.SubElement(root, "configuration")
    offset = 0
    for name, interpolation, columns in groups:
        attributes = {"name": name, "offset": str(offset), "dof": str(columns.shape[1])}
        etree.SubElement(configuration, "group", **attributes, interpolation=interpolation)
        offset += columns.shape[1]
    data = etree.SubElement(root, "data", count=str(len(times)))
    data.text = "\n".join(_format_numbers(row) for row in np.hstack([columns for _, _, columns in groups]))
    etree.SubElement(
        root, "description"
    ).text = f"{robot} {result.get('verdict', '')}; dofs: {' '.join(names[n_base:])}"
    return root


def _add_movable(root: Any, movable: Mapping[str, Any]) -> None:
    kinbody = etree.SubElement(root, "kinbody", name=_make_identifier(movable["name"]))
    # A hinge joins two bodies; the static one has no shape.
    etree.SubElement(kinbody, "body", name="base", type="static")
    moving = etree.SubElement(kinbody, "body", name="moving", type="dynamic")
    for body in movable["bodies"]:
        _add_geom(moving, body)
    joint = etree.SubElement(kinbody, "joint", name=_make_identifier(movable.get("joint") or "turn"), type="hinge")
    for name in ("base", "moving"):
        etree.SubElement(joint, "body").text = name
    etree.SubElement(joint, "offsetfrom").text = "base"
    etree.SubElement(joint, "anchor").text = _format_numbers(movable["origin"])
    etree.SubElement(joint, "axis").text = _format_numbers(movable["axis"])
    etree.SubElement(joint, "limitsdeg").text = "-720 720"


def _add_geom(body: Any, piece: Mapping[str, Any]) -> None:
    """Add the hull of a piece as a trimesh, unless it is too thin to have a surface."""
    mesh = make_convex_mesh(np.asarray(piece["vertices"], dtype=float))
    if len(mesh.triangles) == 0:
        return
    geom = etree.SubElement(body, "geom", type="trimesh", name=_make_identifier(piece["name"]))
    etree.SubElement(geom, "vertices").text = "\n".join(
        _format_numbers(t.ravel()) for t in mesh.vertices[mesh.triangles]
    )
    etree.SubElement(geom, "diffusecolor").text = COLOURS.get(piece.get("kind", ""), PIECE_COLOUR)


def _format_numbers(values: Sequence[float] | Float[np.ndarray, "m"]) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)


def _make_identifier(name: str) -> str:
    """Return the name without blanks, which separate words in a group's name."""
    return "_".join(str(name).split()) or "unnamed"
