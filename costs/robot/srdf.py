"""What an SRDF says, checked against its URDF: groups, named states, link pairs not to check."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from lxml import etree

from costs.robot.errors import RobotError, suggest
from costs.robot.urdf import Urdf
from costs.robot.urdf_elements import MOVABLE
from costs.robot.xmlfile import numbers, parse_xml, required


@dataclass(frozen=True)
class Srdf:
    """A checked SRDF.

    Attributes:
        groups: names of the movable joints by group, unordered.
        link_groups: link names by group, for groups that name links or chains.
        states: joint values by state name (a floating virtual joint: x y z qx qy qz qw).
        virtual_joint: name of the joint between world and root link, or "".
        disabled_pairs: link pairs (sorted) not to check, with the reason that the file gives ("" if none).
    """

    groups: Mapping[str, frozenset[str]]
    link_groups: Mapping[str, tuple[str, ...]]
    states: Mapping[str, Mapping[str, tuple[float, ...]]]
    virtual_joint: str
    disabled_pairs: Mapping[tuple[str, str], str]


EMPTY = Srdf({}, {}, {}, "", {})


def parse_srdf(text: str, where: str, urdf: Urdf) -> Srdf:
    """Read and check an SRDF.

    Raises:
        RobotError: for links, joints and groups the URDF or SRDF does not have, loops of groups, wrong values.
    """
    tree = parse_xml(text, where, "robot")
    reader = _GroupReader(tree, where, urdf)
    names = list(reader.elements)
    virtual = tree.find("virtual_joint")
    virtual_name = "" if virtual is None else required(virtual, "name", where)
    return Srdf(
        groups={name: reader.joints(name, ()) for name in names},
        link_groups={name: links for name in names if (links := reader.links(name, ()))},
        states=_states(tree, where, urdf, virtual_name),
        virtual_joint=virtual_name,
        disabled_pairs={
            _pair(element, where, urdf): element.get("reason", "") for element in tree.findall("disable_collisions")
        },
    )


class _GroupReader:
    """Resolves groups that name joints, links, chains and each other."""

    def __init__(self, tree: etree._Element, where: str, urdf: Urdf) -> None:
        self.where, self.urdf = where, urdf
        self.elements = {required(element, "name", where): element for element in tree.findall("group")}
        self.parent_joint = {joint.child: joint.name for joint in urdf.joints.values()}

    def joints(self, group: str, above: tuple[str, ...]) -> frozenset[str]:
        """Movable joints of a group: named ones, the parents of named links, those along chains."""
        element = self._element(group, above)
        found = {_known(required(item, "name", self.where), self.urdf.joints, f"{self._in(group)}: joint")
                 for item in element.findall("joint")}  # fmt: skip
        found.update(self.parent_joint.get(link, "") for link in self._named_links(element, group))
        for chain in element.findall("chain"):
            found.update(self.parent_joint[link] for link in self._chain(chain, group)[1:])
        for item in element.findall("group"):
            found |= self.joints(required(item, "name", self.where), (*above, group))
        return frozenset(name for name in found if name and self.urdf.joints[name].kind in MOVABLE)

    def links(self, group: str, above: tuple[str, ...]) -> tuple[str, ...]:
        """Links a group names, those along its chains and those of its subgroups, in file order."""
        element = self._element(group, above)
        found = dict.fromkeys(self._named_links(element, group))
        for chain in element.findall("chain"):
            found.update(dict.fromkeys(self._chain(chain, group)))
        for item in element.findall("group"):
            found.update(dict.fromkeys(self.links(required(item, "name", self.where), (*above, group))))
        return tuple(found)

    def _element(self, group: str, above: tuple[str, ...]) -> etree._Element:
        if group in above:
            raise RobotError(f"{self.where}: group '{group}' contains itself ({' > '.join(above)}); break the loop")
        _known(group, self.elements, f"{self.where}: group")
        return self.elements[group]

    def _named_links(self, element: etree._Element, group: str) -> list[str]:
        names = [required(item, "name", self.where) for item in element.findall("link")]
        return [_known(name, self.urdf.links, f"{self._in(group)}: link") for name in names]

    def _chain(self, chain: etree._Element, group: str) -> list[str]:
        """Links from base to tip, both included."""
        base = _known(required(chain, "base_link", self.where), self.urdf.links, f"{self._in(group)}: base_link")
        tip = _known(required(chain, "tip_link", self.where), self.urdf.links, f"{self._in(group)}: tip_link")
        links = [tip]
        while links[-1] != base:
            joint = self.parent_joint.get(links[-1])
            if joint is None:
                raise RobotError(f"{self._in(group)}: base_link '{base}' is not above tip_link '{tip}' in the tree")
            links.append(self.urdf.joints[joint].parent)
        return links[::-1]

    def _in(self, group: str) -> str:
        return f"{self.where}: group '{group}'"


def _states(
    tree: etree._Element, where: str, urdf: Urdf, virtual: str
) -> Mapping[str, Mapping[str, tuple[float, ...]]]:
    """Joint values by state name; states of one name (for several groups) are joined."""
    states: dict[str, dict[str, tuple[float, ...]]] = {}
    for element in tree.findall("group_state"):
        name = required(element, "name", where)
        inside = f"{where}: group_state '{name}'"
        values = states.setdefault(name, {})
        for item in element.findall("joint"):
            joint = required(item, "name", inside)
            if joint not in urdf.joints and joint != virtual:
                raise RobotError(f"{inside}: unknown joint '{joint}'; {suggest(joint, urdf.joints)}")
            count = 7 if joint == virtual else 1
            values[joint] = tuple(numbers(required(item, "value", inside), count, f"{inside}: joint '{joint}'"))
            if joint == virtual and math.hypot(*values[joint][3:]) < 1e-6:
                raise RobotError(f"{inside}: joint '{joint}': the quaternion is zero; write x y z qx qy qz qw")
    return states


def _pair(element: etree._Element, where: str, urdf: Urdf) -> tuple[str, str]:
    inside = f"{where}: disable_collisions"
    a = _known(required(element, "link1", inside), urdf.links, f"{inside}: link1")
    b = _known(required(element, "link2", inside), urdf.links, f"{inside}: link2")
    return (a, b) if a < b else (b, a)


def _known(name: str, known: Mapping[str, object], what: str) -> str:
    if name not in known:
        raise RobotError(f"{what} '{name}' is unknown; {suggest(name, known)}")
    return name
