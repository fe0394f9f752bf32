"""Content of an SRDF, checked against its URDF: groups, named states, link pairs not to check."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from lxml import etree

from costs.names import would_do
from costs.robot.elements.joints import MOVABLE
from costs.robot.errors import RobotError
from costs.robot.urdf import Urdf
from costs.robot.xmlfile import parse_numbers, parse_xml, read_attribute


@dataclass(frozen=True)
class Srdf:
    """A checked SRDF.

    Attributes:
        groups: names of the movable joints by group, unordered.
        link_groups: link names by group, for groups that name links or chains.
        states: joint values by state name (a virtual joint: x y z qx qy qz qw, or x y yaw if it is planar).
        virtual_joint: name of the joint between world and root link, or "".
        is_planar: whether that joint is planar.
        disabled_pairs: link pairs (sorted) not to check, with the reason that the file gives ("" if none).
        notes: names that the URDF does not have, which are left out.
    """

    groups: Mapping[str, frozenset[str]]
    link_groups: Mapping[str, tuple[str, ...]]
    states: Mapping[str, Mapping[str, tuple[float, ...]]]
    virtual_joint: str
    is_planar: bool
    disabled_pairs: Mapping[tuple[str, str], str]
    notes: tuple[str, ...] = ()


ROOT_JOINT = "root_joint"  # Pinocchio's name of the base, which SRDFs without a virtual joint use
EMPTY = Srdf({}, {}, {}, "", False, {})


def parse_srdf(text: str, where: str, urdf: Urdf) -> Srdf:
    """Read and check an SRDF. Links and joints that the URDF does not have are left out, with a note.

    Raises:
        RobotError: for groups that the SRDF does not have, loops of groups, wrong values.
    """
    tree = parse_xml(text, where, "robot")
    notes: list[str] = []
    reader = _GroupReader(tree, where, urdf, notes)
    names = list(reader.elements)
    virtual = tree.find("virtual_joint")
    virtual_name = ROOT_JOINT if virtual is None else read_attribute(virtual, "name", where)
    is_planar = virtual is not None and virtual.get("type") == "planar"
    return Srdf(
        groups={name: reader.find_joints(name, ()) for name in names},
        link_groups={name: links for name in names if (links := reader.find_links(name, ()))},
        states=_read_states(tree, where, urdf, (virtual_name, 3 if is_planar else 7), notes),
        virtual_joint=virtual_name,
        is_planar=is_planar,
        disabled_pairs={
            pair: element.get("reason", "")
            for element in tree.findall("disable_collisions")
            if (pair := _read_pair(element, where, urdf, notes)) is not None
        },
        notes=tuple(dict.fromkeys(notes)),
    )


def format_srdf(source: str, name: str, reasons: Mapping[tuple[str, str], str]) -> str:
    """Format an SRDF (``source``, or a new one if that is empty) that lists exactly these pairs with their reasons."""
    from xml.sax.saxutils import quoteattr  # loads HTTP, too

    tree = parse_xml(source or f"<robot name={quoteattr(name)}/>", name, "robot")
    for element in tree.findall("disable_collisions"):
        tree.remove(element)
    for (first, second), reason in sorted(reasons.items()):
        etree.SubElement(tree, "disable_collisions", link1=first, link2=second, reason=reason)
    etree.indent(tree)
    return str(etree.tostring(tree, encoding="unicode")) + "\n"


class _GroupReader:
    """Resolves groups that name joints, links, chains and each other."""

    def __init__(self, tree: etree._Element, where: str, urdf: Urdf, notes: list[str]) -> None:
        self.where, self.urdf, self.notes = where, urdf, notes
        self.elements = {read_attribute(element, "name", where): element for element in tree.findall("group")}
        self.parent_joint = {joint.child: joint.name for joint in urdf.joints.values()}

    def find_joints(self, group: str, above: tuple[str, ...]) -> frozenset[str]:
        """Return the movable joints of a group: named ones, the parents of named links, those along chains."""
        element = self._find_element(group, above)
        items = [read_attribute(item, "name", self.where) for item in element.findall("joint")]
        names = {name for name in items if _is_known("joint", name, self.urdf.joints, self.notes)}
        names.update(self.parent_joint.get(link, "") for link in self._read_links(element, group))
        for chain in element.findall("chain"):
            names.update(self.parent_joint[link] for link in self._follow_chain(chain, group)[1:])
        for item in element.findall("group"):
            names |= self.find_joints(read_attribute(item, "name", self.where), (*above, group))
        joints = self.urdf.joints
        return frozenset(n for n in names if n and joints[n].kind in MOVABLE and joints[n].mimic is None)

    def find_links(self, group: str, above: tuple[str, ...]) -> tuple[str, ...]:
        """Return the links a group names, those along its chains and those of its subgroups, in file order."""
        element = self._find_element(group, above)
        links = dict.fromkeys(self._read_links(element, group))
        for chain in element.findall("chain"):
            links.update(dict.fromkeys(self._follow_chain(chain, group)))
        for item in element.findall("group"):
            links.update(dict.fromkeys(self.find_links(read_attribute(item, "name", self.where), (*above, group))))
        return tuple(links)

    def _find_element(self, group: str, above: tuple[str, ...]) -> etree._Element:
        if group in above:
            raise RobotError(f"{self.where}: group '{group}' contains itself ({' > '.join(above)}); break the loop")
        _check_known(group, self.elements, f"{self.where}: group")
        return self.elements[group]

    def _read_links(self, element: etree._Element, group: str) -> list[str]:
        names = [read_attribute(item, "name", self.where) for item in element.findall("link")]
        return [name for name in names if _is_known("link", name, self.urdf.links, self.notes)]

    def _follow_chain(self, chain: etree._Element, group: str) -> list[str]:
        """Return the links from base to tip, both included."""
        base = read_attribute(chain, "base_link", self.where)
        tip = read_attribute(chain, "tip_link", self.where)
        ends = [_is_known("link", name, self.urdf.links, self.notes) for name in (base, tip)]
        if not all(ends):
            return []
        links = [tip]
        while links[-1] != base:
            joint = self.parent_joint.get(links[-1])
            if joint is None:
                raise RobotError(f"{self._locate(group)}: base_link '{base}' is not above tip_link '{tip}' in the tree")
            links.append(self.urdf.joints[joint].parent)
        return links[::-1]

    def _locate(self, group: str) -> str:
        return f"{self.where}: group '{group}'"


def _read_states(
    tree: etree._Element, where: str, urdf: Urdf, virtual_joint: tuple[str, int], notes: list[str]
) -> Mapping[str, Mapping[str, tuple[float, ...]]]:
    """Read joint values by state name; states of one name (for several groups) are merged.

    ``virtual_joint`` is the name of the joint below the root link, and the number of its values.
    """
    virtual, n_virtual = virtual_joint
    states: dict[str, dict[str, tuple[float, ...]]] = {}
    for element in tree.findall("group_state"):
        name = read_attribute(element, "name", where)
        inside = f"{where}: group_state '{name}'"
        values = states.setdefault(name, {})
        for item in element.findall("joint"):
            joint = read_attribute(item, "name", inside)
            if joint == ROOT_JOINT and (joint != virtual or len(item.get("value", "").split()) == 1):
                continue  # the base, as others call it, of whatever joint they give it
            if joint != virtual and not _is_known("joint", joint, urdf.joints, notes):
                continue
            count = n_virtual if joint == virtual else 1
            values[joint] = tuple(
                parse_numbers(read_attribute(item, "value", inside), count, f"{inside}: joint '{joint}'")
            )
            if joint == virtual and count == 7 and math.hypot(*values[joint][3:]) < 1e-6:
                raise RobotError(f"{inside}: joint '{joint}': the quaternion is zero; write x y z qx qy qz qw")
    return states


def _read_pair(element: etree._Element, where: str, urdf: Urdf, notes: list[str]) -> tuple[str, str] | None:
    """Return the link pair of an element; None, and a note, for a link that the URDF does not have."""
    inside = f"{where}: disable_collisions"
    a, b = (read_attribute(element, key, inside) for key in ("link1", "link2"))
    known = [_is_known("link", name, urdf.links, notes) for name in (a, b)]  # both, so that both get their note
    if not all(known):
        return None
    return (a, b) if a < b else (b, a)


def _is_known(kind: str, name: str, known: Mapping[str, object], notes: list[str]) -> bool:
    """Return whether the URDF has a link or joint of that name; add a note if not."""
    if name not in known:
        notes.append(f"{kind} '{name}': the SRDF names it, the URDF does not; left out")
    return name in known


def _check_known(name: str, known: Mapping[str, object], what: str) -> str:
    if name not in known:
        raise RobotError(f"{what} '{name}' is unknown; expected {would_do(name, known) or 'none'}")
    return name
