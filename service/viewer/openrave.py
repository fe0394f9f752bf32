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
from service.viewer.movables import is_prismatic, list_chains

BASE_COLUMNS = ("base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz")
AFFINE_DOFS = 39
"""OpenRAVE's ``DOF_X | DOF_Y | DOF_Z | DOF_RotationQuat``: x y z qw qx qy qz."""

BASE = "base"
"""The body of a kinbody that does not move."""

FREE = 4.0 * np.pi
"""Limit of a joint that has none [rad]."""

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
    """Return ``<environment>`` with a static kinbody per piece and one with joints per tree of movables."""
    root = etree.Element("environment")
    for piece in result.get("pieces") or []:
        kinbody = etree.SubElement(root, "kinbody", name=_make_identifier(piece["name"]))
        _add_geom(etree.SubElement(kinbody, "body", name="base", type="static"), piece)
    for tree in _list_trees(result):
        _add_tree(root, tree)
    return root


def make_trajectory(result: Mapping[str, Any]) -> Any:
    """Return ``<trajectory>``: base pose, joint values and time step of the robot, and the values of every movable.

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
    for tree in _list_trees(result):
        if all(len(movable.get("angles") or []) == len(times) for movable in tree):
            values = np.column_stack([np.asarray(movable["angles"], dtype=float) for movable in tree])
            indices = " ".join(str(index) for index in range(len(tree)))
            groups.append((f"joint_values {_make_identifier(tree[0]['name'])} {indices}", "linear", values))
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


def _list_trees(result: Mapping[str, Any]) -> list[list[Mapping[str, Any]]]:
    """Return the movables in trees, each with its root first and parents before children.

    Raises:
        ValueError: a parent is no movable, or parents form a cycle.
    """
    chains = list_chains(result.get("movables") or [])
    by_name = {chain[-1]["name"]: chain for chain in chains}
    roots = [chain[0]["name"] for chain in chains if len(chain) == 1]
    ordered = sorted(by_name.values(), key=len)  # stable: parents before children, else as in the result
    return [[chain[-1] for chain in ordered if chain[0]["name"] == root] for root in roots]


def _add_tree(root: Any, tree: Sequence[Mapping[str, Any]]) -> None:
    """Add a kinbody with a body and a joint per movable; everything is described in the world with all joints at 0."""
    kinbody = etree.SubElement(root, "kinbody", name=_make_identifier(tree[0]["name"]))
    # A joint joins two bodies; the static one has no shape.
    etree.SubElement(kinbody, "body", name=BASE, type="static")
    for movable in tree:
        moving = etree.SubElement(kinbody, "body", name=_make_identifier(movable["name"]), type="dynamic")
        for body in movable["bodies"]:
            _add_geom(moving, body)
    for movable in tree:
        _add_joint(kinbody, movable)
    starts = [float(movable.get("start") or 0.0) for movable in tree]
    if any(starts):
        etree.SubElement(kinbody, "jointvalues").text = _format_numbers(starts)


def _add_joint(kinbody: Any, movable: Mapping[str, Any]) -> None:
    slides = is_prismatic(movable)
    name = _make_identifier(movable.get("joint") or ("slide" if slides else "turn"))
    joint = etree.SubElement(kinbody, "joint", name=name, type="slider" if slides else "hinge")
    parent = movable.get("parent")
    etree.SubElement(joint, "body").text = BASE if parent is None else _make_identifier(parent)
    etree.SubElement(joint, "body").text = _make_identifier(movable["name"])
    etree.SubElement(joint, "offsetfrom").text = BASE
    etree.SubElement(joint, "anchor").text = _format_numbers(movable["origin"])
    etree.SubElement(joint, "axis").text = _format_numbers(movable["axis"])
    limits = np.array([movable.get("lower", -FREE), movable.get("upper", FREE)], dtype=float)
    tag, values = ("limits", limits) if slides else ("limitsdeg", np.degrees(limits))
    etree.SubElement(joint, tag).text = _format_numbers(values)


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
