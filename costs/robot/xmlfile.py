"""Reading of untrusted XML: limited size, no entities, no network access, finite numbers only."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float
from lxml import etree

from costs.robot.errors import RobotError

MAX_XML_BYTES = 4 * 1024 * 1024

DRAKE = "http://drake.mit.edu"
"""Namespace of Drake's extensions of URDF."""

_DRAKE_ELEMENTS = ("joint", "capsule", "ellipsoid")
_UNDECLARED = re.compile(r"Namespace prefix \S+ .*is not defined")
_FORMATS = {
    "mujoco": " (a model of MuJoCo)",
    "sdf": " (a model of Gazebo)",
    "COLLADA": " (a mesh)",
    "html": " (a web page)",
}
MADE_HERE = "made_here"  # attribute of elements that no file had


def read_xml_text(path: Path) -> str:
    """Read the text of an XML file of at most ``MAX_XML_BYTES``.

    Raises:
        RobotError: when the file cannot be read, is too large or is not UTF-8.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_XML_BYTES + 1)
    except OSError as error:
        raise RobotError(f"{path}: cannot be read ({error.strerror or error})") from None
    if len(data) > MAX_XML_BYTES:
        raise RobotError(f"{path}: larger than {MAX_XML_BYTES // 2**20} MB; a robot description is far smaller")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise RobotError(f"{path}: not UTF-8 (byte {error.start}); save it as UTF-8") from None


def parse_xml(text: str, where: str, root_tag: str, max_bytes: int = MAX_XML_BYTES) -> etree._Element:
    """Parse an XML text whose root element is ``<root_tag>``.

    Entities are never resolved; a DOCTYPE is refused, since it can define entity bombs and external references.
    Elements of the root's own namespace are read as if they had none, those of other namespaces are dropped, but for
    the joints, shapes and limits of ``DRAKE``.
    """
    if len(text) > max_bytes:
        raise RobotError(f"{where}: larger than {max_bytes // 2**20} MB; a robot description is far smaller")
    # Entities in attributes would be expanded while parsing, so a DOCTYPE in plain sight is refused before.
    refused = RobotError(f"{where}: DOCTYPE is refused; remove it")
    if "<!DOCTYPE" in text:
        raise refused
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False,
                             remove_comments=True, remove_pis=True)  # fmt: skip
    try:
        root = etree.fromstring(text.encode("utf-8"), parser)
    except (etree.XMLSyntaxError, UnicodeEncodeError) as error:
        recovered = _parse_undeclared(text, error)
        if recovered is None:
            reason = str(error).splitlines()[0]
            if "depth" in reason:
                line = f"{where}: elements are nested too deeply; a robot's file needs a few levels"
                raise RobotError(line) from None
            raise RobotError(f"{where}: not well-formed XML ({reason})") from None
        root = recovered
    if root.getroottree().docinfo.doctype:
        # One hidden by the declared encoding.
        raise refused
    _drop_namespaces(root, where)
    if root.tag != root_tag:
        known = _FORMATS.get(str(root.tag), "") if root_tag == "robot" else ""
        raise RobotError(f"{where}: the root element is <{root.tag}>{known}; it must be <{root_tag}>")
    return root


def _parse_undeclared(text: str, error: Exception) -> etree._Element | None:
    """Parse a text whose only mistakes are prefixes that it does not declare; None for any other mistake."""
    if not _UNDECLARED.search(str(error)):
        return None
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False,
                             remove_comments=True, remove_pis=True, recover=True)  # fmt: skip
    root = etree.fromstring(text.encode("utf-8"), parser)
    if root is None or any(entry.type_name != "NS_ERR_UNDEFINED_NAMESPACE" for entry in parser.error_log):
        return None
    return root


def _drop_namespaces(root: etree._Element, where: str) -> None:
    """Drop elements of foreign namespaces, and the namespace of the others.

    Raises:
        RobotError: the file is a template of xacro.
    """
    namespace = etree.QName(root).namespace
    for element in list(root.iter()):
        if not isinstance(element.tag, str):
            continue
        if ":" in element.tag and not element.tag.startswith("{"):
            # Of a prefix that the file does not declare.
            prefix, local = element.tag.split(":", 1)
            element.tag = f"{{{DRAKE if prefix == 'drake' else prefix}}}{local}"
        name = etree.QName(element)
        if name.namespace is not None and name.namespace.rstrip("/").endswith("xacro"):
            name = where.rsplit("/", 1)[-1]
            stem = name.split(".", 1)[0] or "robot"
            stem += ".expanded" * (name == f"{stem}.urdf")  # not onto itself
            raise RobotError(
                f"{where}: is a xacro file; expand it first: xacro {where} > {stem}.urdf (pip install xacro)"
            )
        is_known = name.namespace == DRAKE and name.localname in _DRAKE_ELEMENTS
        if name.namespace == namespace or element is root or is_known:
            element.tag = name.localname
        elif name.namespace is not None and element.getparent() is not None:
            element.getparent().remove(element)
    for limit in root.iterfind("joint/limit"):
        acceleration = limit.get(f"{{{DRAKE}}}acceleration") or limit.get("drake:acceleration")
        if acceleration is not None and limit.get("acceleration") is None:
            limit.set("acceleration", acceleration)


def read_attribute(element: etree._Element, attribute: str, where: str) -> str:
    """Read a non-empty attribute of ``element``."""
    value = element.get(attribute)
    if value is None or not value.strip():
        raise RobotError(f"{where}: <{element.tag}> lacks {attribute}; give it one")
    return str(value)


def parse_numbers(text: str, count: int, where: str) -> Float[np.ndarray, "count"]:
    """Parse exactly ``count`` finite numbers separated by blanks."""
    parts = text.split()
    if len(parts) != count:
        raise RobotError(f"{where}: {_shorten(text)!r} holds {len(parts)} numbers; {count} are needed")
    values = [_parse_finite(part, where) for part in parts]
    return np.array(values)


def parse_number(text: str, where: str) -> float:
    """Parse one finite number."""
    return float(parse_numbers(text, 1, where)[0])


def parse_limit(text: str, where: str) -> float:
    """Parse one number, which may be infinite."""
    word = text.strip().lower()
    if word.lstrip("+-") in ("inf", "infinity"):
        return -math.inf if word.startswith("-") else math.inf
    return parse_number(text, where)


def _parse_finite(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        hint = "; the file is a xacro template, expand it with the command xacro" if "${" in text else ""
        raise RobotError(f"{where}: {_shorten(text)!r} is not a number{hint}") from None
    if not math.isfinite(value):
        raise RobotError(f"{where}: {_shorten(text)!r} is not a finite number")
    return value


def _shorten(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."
