"""Text and files of an MJCF model: included files put in their places, meshes read from allowed folders only."""

from __future__ import annotations

import copy
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lxml import etree

from costs.robot.errors import RobotError
from costs.robot.mesh import read_bytes, resolve_mesh
from costs.robot.xmlfile import parse_xml, read_xml_text

ROOT_TAG = "mujoco"
MOST_INCLUDES = 50
# What says nothing about links, joints and masses; textures and height fields name files of their own.
UNUSED = ("visual", "statistic", "size", "sensor", "extension", "custom", "deformable", "default//texture",
          "asset/texture", "asset/hfield", "asset/skin", "asset/model")  # fmt: skip


def is_mjcf(text: str) -> bool:
    """Return whether the root element of an XML text is that of a model of MuJoCo."""
    found = re.search(r"<\s*([A-Za-z][\w:.-]*)", re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL))
    return found is not None and found[1] == ROOT_TAG


def compile_mjcf(text: str, path: Path, roots: Sequence[Path]) -> Any:
    """Let MuJoCo read a model with all files that it names; return its ``MjModel``.

    Args:
        text: content of ``path``.
        path: file of the model; included files start at its folder.
        roots: folders that files may lie in.

    Raises:
        RobotError: MuJoCo is not installed or refuses the model, or a file is missing or lies elsewhere.
    """
    try:
        import mujoco
    except ImportError:
        raise RobotError(
            f"{path}: a model of MuJoCo is read by MuJoCo, which is not installed; pip install 'scopt[sim]'"
        ) from None
    root = parse_xml(text, str(path), ROOT_TAG)
    _include(root, path.parent, roots, str(path), 0)
    for name in UNUSED:
        for element in root.findall(name):
            _remove(element)
    for material in root.iter("material"):
        material.attrib.pop("texture", None)
        for layer in material.findall("layer"):
            material.remove(layer)
    for geom in list(root.iter("geom")):
        if geom.get("type") in ("hfield", "sdf"):
            _remove(geom)
    assets = _read_meshes(root, path.parent, roots, str(path))
    for compiler in root.findall("compiler"):
        for key in ("meshdir", "assetdir", "texturedir", "strippath"):
            compiler.attrib.pop(key, None)
        compiler.set("fusestatic", "false")
        compiler.set("discardvisual", "false")
    try:
        return mujoco.MjSpec.from_string(etree.tostring(root, encoding="unicode"), assets=assets).compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise RobotError(f"{path}: MuJoCo cannot use the model ({reason[:300]})") from None


def _include(element: etree._Element, folder: Path, roots: Sequence[Path], where: str, count: int) -> int:
    """Put the content of included files in their places, in place; return how many were included so far."""
    for include in list(element.iter("include")):
        count += 1
        if count > MOST_INCLUDES:
            raise RobotError(f"{where}: more than {MOST_INCLUDES} included files; does a file include itself?")
        path = _find(include.get("file") or "", folder, roots, f"{where}: <include>")
        included = parse_xml(read_xml_text(path), str(path), _root_tag(path))
        count = _include(included, folder, roots, where, count)
        parent, place = include.getparent(), include.getparent().index(include)
        parent.remove(include)
        for offset, child in enumerate(list(included)):
            parent.insert(place + offset, copy.deepcopy(child))
    return count


def _root_tag(path: Path) -> str:
    """Return the root tag of an included file, which may have any."""
    found = re.search(r"<\s*(mujoco\w*)", read_xml_text(path))
    return ROOT_TAG if found is None else found[1]


def _read_meshes(root: etree._Element, folder: Path, roots: Sequence[Path], where: str) -> dict[str, bytes]:
    """Give each mesh file a name without a path; return the contents by these names."""
    directory = ""
    for compiler in root.findall("compiler"):
        directory = compiler.get("meshdir") or compiler.get("assetdir") or directory
    assets = {}
    for number, mesh in enumerate(root.findall("asset/mesh")):
        file = mesh.get("file")
        if file is None:
            continue
        path = _find(str(Path(directory) / file), folder, roots, where)
        if mesh.get("name") is None:
            mesh.set("name", Path(file).stem)
        key = f"{number}{path.suffix.lower()}"
        mesh.set("file", key)
        assets[key] = read_bytes(path, where)
    return assets


def _find(file: str, folder: Path, roots: Sequence[Path], where: str) -> Path:
    """Return the path of a file that a model names, relative to the model's folder."""
    inside = [root for root in roots if folder.resolve().is_relative_to(root.resolve())]
    own = [folder] if inside else []
    if ".." in Path(file).parts and inside:
        # A path out of the model's folder is allowed as far as the folders of the request reach.
        return resolve_mesh(str((folder / file).resolve()), inside, where)[1]
    return resolve_mesh(file, [*own, *roots], where)[1]


def _remove(element: etree._Element) -> None:
    parent = element.getparent()
    if parent is not None:
        parent.remove(element)
