"""Robots with false files: shapes left out, shrunk, overlapping or invented."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from benchmarks.attack.arm_files import NEIGHBOURS, POST, START, arm_request, honest_urdf, write_arm
from benchmarks.attack.outcome import Answer, Attack
from benchmarks.attack.requests import Expected, Lie, Make, answer_of

Change = Callable[[ET.Element], object]
NO, NAMED, TRUTH = Expected.NO_CERTIFICATE, Expected.NAMED, Expected.TRUTH
ROBOTS: dict[str, Make] = {}
# Left to the long version: two are slow, and of the others a wall behind rail and lift together stays.
LONG = (
    "origin of a million metres",
    "hand's mesh in kilometres",
    "lift through a ceiling of its own",
    "rail through a wall of its own",
)


def attacks() -> list[Attack]:
    """Return one attack for each robot."""

    def run(make: Make) -> Callable[[Path], tuple[Answer, str]]:
        return lambda scratch: answer_of(make(scratch), scratch)

    return [Attack("robots", name, run(make), name not in LONG) for name, make in ROBOTS.items()]


def _arm(
    name: str,
    change: Change,
    expected: Expected = TRUTH,
    *words: str,
    disabled: Iterable[tuple[str, str]] | None = NEIGHBOURS,
    is_changed_honest: bool = False,
    files: dict[str, str] | None = None,
    **more: Any,
) -> None:
    """Register the arm with a change to its URDF.

    Args:
        name: what is false.
        change: applied to the parsed URDF.
        expected, words: as of :class:`Lie`.
        disabled: pairs of its SRDF; None for no SRDF.
        is_changed_honest: whether the changed URDF is correct; else the unchanged one is.
        files: further files beside the URDF.
        more: further parts of the request.
    """

    def make(folder: Path) -> Lie:
        robot = write_arm(folder, change, disabled)
        for file, text in (files or {}).items():
            (folder / file).write_text(text, encoding="utf-8")
        urdf = Path(robot["urdf"]).read_text(encoding="utf-8") if is_changed_honest else honest_urdf()
        apart = tuple(pair for pair in NEIGHBOURS if pair == ("forearm", "hand"))
        return Lie(arm_request(robot, **more), expected, words, urdf, folder, "collision", apart)

    ROBOTS[name] = make


def _each(path: str, change: Change) -> Change:
    def run(root: ET.Element) -> None:
        found = root.findall(path)
        if not found:
            raise AssertionError(f"{path} is nowhere in the arm")
        for element in found:
            change(element)

    return run


def _set(path: str, **values: str) -> Change:
    return _each(path, lambda element: element.attrib.update(values))


def _drop(tag: str, *links: str) -> Change:
    def run(root: ET.Element) -> None:
        for link in root.findall("link"):
            if not links or link.get("name") in links:
                for element in link.findall(tag):
                    link.remove(element)

    return run


def _replace_shape(link: str, text: str) -> Change:
    def change(geometry: ET.Element) -> None:
        geometry.clear()
        geometry.append(ET.fromstring(text))

    return _each(f"link[@name='{link}']/collision/geometry", change)


def _add(text: str) -> Change:
    return lambda root: root.extend(list(ET.fromstring(f"<all>{text}</all>")))


def _all(*changes: Change) -> Change:
    def run(root: ET.Element) -> None:
        for change in changes:
            change(root)

    return run


def _box(name: str, size: str, xyz: str, mass: str = "1") -> str:
    """Return a link with one box, and mass."""
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/>'
        '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
        f'<collision><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></collision></link>'
    )


def _fixed(name: str, parent: str, child: str, xyz: str = "0 0 0") -> str:
    return (
        f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/></joint>'
    )


def _slide(name: str, parent: str, child: str, axis: str, lower: float = 0.0, upper: float = 1.5) -> str:
    return (
        f'<joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        f'<limit lower="{lower}" upper="{upper}" velocity="1" effort="500"/></joint>'
    )


def _machine(name: str, text: str, goal: dict[str, float], expected: Expected = TRUTH, disabled: str = "") -> None:
    """Register another machine, whose URDF is correct."""

    def make(folder: Path) -> Lie:
        urdf = f'<robot name="machine">{text}</robot>'
        (folder / "machine.urdf").write_text(urdf, encoding="utf-8")
        robot = {"urdf": str(folder / "machine.urdf")}
        if disabled:
            (folder / "machine.srdf").write_text(f'<robot name="machine">{disabled}</robot>', encoding="utf-8")
            robot["srdf"] = str(folder / "machine.srdf")
        return Lie(
            {"robot": robot, "goal": {"joints": goal}, "options": {"time_limit_s": 1.0}}, expected, (), urdf, folder
        )

    ROBOTS[name] = make


BASE = _box("base", "0.2 0.2 0.2", "0 0 0")
CARRIAGE = _box("carriage", "0.2 0.2 0.2", "0 0 0.3")
MAST = _box("mast", "0.1 0.1 0.1", "0 0 0.6")
# Missing or too small shapes.
_arm("no shapes at all, inside a box of 3 m", _drop("collision"), NO, scene={"obstacles": [
    {"name": "block", "type": "box", "size": [3.0, 3.0, 3.0], "position": [0.0, 0.0, 0.5]}]})  # fmt: skip
_arm("no shapes at all, and nothing around", _drop("collision"), NO, scene={"obstacles": []})
_arm("no shapes but the base's", _drop("collision", "turret", "upper_arm", "forearm", "wrist_link", "hand"), NO)
_arm("hand without shape", _drop("collision", "hand"), TRUTH, "hand")
_arm("hand and forearm without shape", _drop("collision", "hand", "forearm"), TRUTH, "hand", "forearm")
_arm("upper arm without shape between shaped links", _drop("collision", "upper_arm"), NAMED, "upper_arm")
_arm("tiny shapes inside what is drawn", _all(_set("link/collision/geometry/box", size="0.01 0.01 0.01"),
    _set("link[@name='hand']/collision/geometry/mesh", scale="0.1 0.1 0.1")), TRUTH)  # fmt: skip
_arm("hand's mesh in millimetres", _set("link[@name='hand']/collision/geometry/mesh", scale="0.001 0.001 0.001"))
_arm("hand's mesh in kilometres", _set("link[@name='hand']/collision/geometry/mesh", scale="1000 1000 1000"))
_arm("hand's mesh mirrored", _set("link[@name='hand']/collision/geometry/mesh", scale="1 -1 1"))
_arm("shape of the hand placed elsewhere", _each("link[@name='hand']/collision", lambda c: c.append(
    ET.fromstring('<origin xyz="0 0 -0.2"/>'))))  # fmt: skip
_arm("flat mesh", _set("link[@name='hand']/collision/geometry/mesh", filename="flat.obj"), NO,
    files={"flat.obj": "v 0 0 0\nv 1e-9 0 0\nv 0 1e-9 0\nf 1 2 3\n"})  # fmt: skip
_arm(
    "empty mesh", _set("link[@name='hand']/collision/geometry/mesh", filename="empty.obj"), NO, files={"empty.obj": ""}
)
_arm("missing mesh", _set("link[@name='hand']/collision/geometry/mesh", filename="gone.obj"), NO)
_arm("mesh outside the package", _set("link[@name='hand']/collision/geometry/mesh", filename="../../etc/passwd"), NO)
# Pairs that the loader treats as neighbours or leaves out.
_machine("rail through a wall of its own", BASE + _box("wall", "0.1 1 1", "0.7 0 0.3") + CARRIAGE
    + _fixed("w", "base", "wall") + _slide("rail", "base", "carriage", "1 0 0"), {"rail": 1.4})  # fmt: skip
_machine("lift through a ceiling of its own", BASE + _box("ceiling", "1 1 0.1", "0 0 1.0") + CARRIAGE
    + _fixed("c", "base", "ceiling") + _slide("lift", "base", "carriage", "0 0 1"), {"lift": 1.4})  # fmt: skip
_machine("rail and lift through a wall of its own", BASE + _box("wall", "0.1 1 1", "0.7 0 0.3") + CARRIAGE + MAST
    + _fixed("w", "base", "wall") + _slide("rail", "base", "carriage", "1 0 0")
    + _slide("lift", "carriage", "mast", "0 0 1"), {"rail": 1.4, "lift": 0.1})  # fmt: skip
_machine("wall behind a shapeless foot plate", BASE + '<link name="plate"/>' + _box("wall", "0.1 1 1", "0.7 0 0.3")
    + CARRIAGE + _fixed("p", "base", "plate") + _fixed("w", "plate", "wall")
    + _slide("rail", "base", "carriage", "1 0 0"), {"rail": 1.4})  # fmt: skip
_machine("only pair is left out because it always overlaps",
    _box("base", "1 1 1", "0 0 0") + '<link name="between"/>' + _box("slider", "1 1 1", "0.951 0 0")
    + _slide("a", "base", "between", "0 1 0", -0.1, 0.1) + _slide("b", "between", "slider", "0 1 0", -0.1, 0.1),
    {"a": 0.08, "b": 0.08}, NO)  # fmt: skip
_machine("a pair that overlaps nearly always, deeper in the motion",
    BASE + MAST + _box("ram", "0.4 0.4 0.4", "0 0 0.45") + _slide("a", "base", "mast", "1 0 0", 0.0, 0.05)
    + _slide("b", "mast", "ram", "0 0 1", -0.4, 0.0), {"a": 0.04, "b": -0.3})  # fmt: skip
_machine("one link alone", BASE + CARRIAGE + _slide("rail", "base", "carriage", "1 0 0"), {"rail": 1.0}, NO)
_machine("SRDF that disables the wall", BASE + _box("wall", "0.1 1 1", "0.7 0 0.3") + CARRIAGE + MAST
    + _fixed("w", "base", "wall") + _slide("rail", "base", "carriage", "1 0 0")
    + _slide("lift", "carriage", "mast", "0 0 1"), {"rail": 1.4, "lift": 0.1},
    disabled='<disable_collisions link1="wall" link2="carriage"/><disable_collisions link1="wall" link2="mast"/>'
    '<disable_collisions link1="base" link2="carriage"/>')  # fmt: skip
LINKS = ("base", "turret", "upper_arm", "forearm", "wrist_link", "hand")
EVERY_PAIR = tuple((a, b) for k, a in enumerate(LINKS) for b in LINKS[k + 1 :])
FOLDED = {"joints": {**START, "shoulder": 1.5, "elbow": 2.3, "wrist": 0.9}}
_arm("SRDF that disables all pairs", lambda root: None, disabled=EVERY_PAIR, is_changed_honest=True, goal=FOLDED)
BEHIND_THE_BASE = (*NEIGHBOURS, ("base", "hand"), ("base", "forearm"), ("base", "wrist_link"))
_arm(
    "SRDF that disables hand and base", lambda root: None, disabled=BEHIND_THE_BASE, is_changed_honest=True, goal=FOLDED
)
# Impossible numbers.
_arm("effort 0 everywhere", _set("joint/limit", effort="0"), NAMED, "not checked: torques")
_arm("effort 0 on the shoulder", _set("joint[@name='shoulder']/limit", effort="0"), NAMED, "shoulder")
_arm("effort without bound", _set("joint/limit", effort="inf"), NO)
_arm("negative effort", _set("joint/limit", effort="-50"), NO)
_arm("negative inertia", _set("link/inertial/inertia", ixx="-0.5", iyy="-0.5", izz="-0.5"), NO)
_arm("inertia that no body has", _set("link[@name='hand']/inertial/inertia", ixx="1", iyy="0.001", izz="0.001"), NAMED,
    "inertia of hand")  # fmt: skip
_arm("negative masses", _set("link/inertial/mass", value="-2"), NO)
_arm("one negative mass", _set("link[@name='forearm']/inertial/mass", value="-2"), NO)
_arm("no mass at all", _set("link/inertial/mass", value="0"), NAMED, "mass")
_arm("no inertials", _drop("inertial"), NAMED, "mass")
_arm("forearm without mass", _drop("inertial", "forearm"), NAMED, "forearm")
_arm("mass that is no number", _set("link[@name='hand']/inertial/mass", value="nan"), NO)
_arm("limits that are no numbers", _set("joint[@name='elbow']/limit", lower="nan", upper="nan"), NO)
_arm("limits reversed", _set("joint[@name='elbow']/limit", lower="2", upper="-2"), NO)
_arm("speed limit 0", _set("joint[@name='elbow']/limit", velocity="0"), NO)
_arm("speed limits of a million", _set("joint/limit", velocity="1e6"), TRUTH)
_arm("axis of zero length", _set("joint[@name='elbow']/axis", xyz="0 0 0"), NO)
_arm("axis twice as long", _set("joint[@name='elbow']/axis", xyz="0 2 0"), TRUTH)
_arm("capsule of no length", _replace_shape("wrist_link", '<capsule radius="0.04" length="0"/>'), TRUTH)
_arm("cylinder of no radius", _set("link/collision/geometry/cylinder", radius="0"), NO)
_arm("origin of a million metres", _set("joint[@name='wrist']/origin", xyz="0 0 1e6"), NO)
# Names and joints.
RENAMED = {"forearm" if name == "wrist" else name: value for name, value in START.items()}
_arm("link called like a joint", _each("joint[@name='wrist']", lambda j: j.set("name", "forearm")), TRUTH,
    is_changed_honest=True, start={"joints": RENAMED}, goal={"joints": {"yaw": 0.9}})  # fmt: skip
_arm("two links of one name", _add('<link name="hand"/>'), NO)
_arm("two joints of one name", _set("joint[@name='roll']", name="yaw"), NO)
_arm("link called universe", _add('<link name="universe"/>' + _fixed("u", "base", "universe")), NO)
SECOND_POST = _box("post", "0.2 0.2 0.2", "0 0 0") + _fixed("p", "base", "post", "0.62 0 1.1")
_arm("link called like an obstacle", _add(SECOND_POST), TRUTH, is_changed_honest=True)
_arm("link called floor", _add(_box("floor", "3 3 0.02", "0 0 0") + _fixed("p", "base", "floor", "0 0 -0.02")), TRUTH,
    is_changed_honest=True, scene={"floor": True, "obstacles": [POST]})  # fmt: skip
_arm("bodies of one name", _add(_box("hand/1", "0.1 0.1 0.1", "0 0 0") + _fixed("p", "base", "hand/1")), TRUTH,
    is_changed_honest=True)  # fmt: skip
FINGER, LEFT, RIGHT = (_box(name, "0.02 0.02 0.1", "0 0 0.2") for name in ("finger", "left", "right"))


def _mimics(name: str, leader: str, child: str) -> str:
    return _slide(name, "hand", child, "0 1 0").replace("</joint>", f'<mimic joint="{leader}"/></joint>')


_arm("finger that mimics itself", _add(FINGER + _mimics("grip", "grip", "finger")), NO)
_arm("fingers that mimic each other", _add(LEFT + RIGHT + _mimics("a", "b", "left") + _mimics("b", "a", "right")), NO)
_arm("joint of six freedoms", _each("joint[@name='yaw']", lambda j: j.set("type", "floating")), NO)
_arm("links in a loop", _add(_fixed("loop", "hand", "base")), NO)
POLE = _box("pole", "0.03 0.03 0.6", "0 0 0.5") + _fixed("p", "hand", "pole")
_arm("a carried pole in the hand's own file", _add(POLE), TRUTH, is_changed_honest=True, disabled=None)
