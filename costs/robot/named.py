"""Loading of robots by name or by path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from costs.contact import Contact
from costs.names import would_do
from costs.robot.atlas import load_atlas, load_contacts
from costs.robot.atlas.description import HandKind
from costs.robot.errors import RobotError
from costs.robot.load import Root, load_files
from costs.robot.mesh.split import LinkSplit
from costs.robot.mesh.visual import VisualMesh, read_visuals
from costs.robot.model import RobotModel
from costs.robot.urdf import parse_urdf

_BUNDLED = {"atlas": "Atlas v5: 30 joints, floating base, 158.6 kg, a hook on each hand"}


def bundled_robots() -> Mapping[str, str]:
    """Return the description of each robot that ships with the package, by name."""
    return dict(_BUNDLED)


def bundled_contacts(name: str) -> Mapping[str, Contact]:
    """Return the contact patches by name of a bundled robot, without loading the robot.

    Raises:
        RobotError: no such robot.
    """
    if name not in _BUNDLED:
        raise RobotError(f"unknown robot '{name}'; expected {would_do(name, _BUNDLED)}")
    return load_contacts()


def read_robot_visuals(robot: RobotModel) -> tuple[VisualMesh, ...]:
    """Read the meshes that a robot looks like, simplified; none where they are the files of its collision shapes."""
    urdf = parse_urdf(robot.source.urdf, robot.name, {})
    drawn = {mesh.get("filename") for mesh in urdf.tree.iterfind("link/visual/geometry/mesh")}
    solid = {mesh.get("filename") for mesh in urdf.tree.iterfind("link/collision/geometry/mesh")}
    return read_visuals(urdf, robot.source.roots) if drawn - solid else ()


def read_followers(robot: RobotModel) -> dict[str, tuple[str, float, float]]:
    """Return the joints that follow others: by name the joint that moves by itself, multiplier and offset."""
    joints = parse_urdf(robot.source.urdf, robot.name, {}).joints
    return {joint.name: joint.mimic for joint in joints.values() if joint.mimic is not None}


def load_robot(
    name: str | None = None,
    *,
    urdf: Path | None = None,
    srdf: Path | None = None,
    package_dirs: Sequence[Path] = (),
    root: Root | None = None,
    tool_distance_m: float | None = None,
    hand: HandKind | None = None,
    locked_joints: Mapping[str, float] | None = None,
    drawn_links: Sequence[str] = (),
    split: LinkSplit | None = None,
) -> RobotModel:
    """Load a bundled robot by name, or any robot by its URDF.

    Args:
        name: one of ``bundled_robots()``; or None when ``urdf`` is given.
        urdf, srdf: files of another robot.
        package_dirs: folders that ``package://`` and relative mesh paths are looked for in, and the only ones meshes
            are read from; the URDF's own folder when empty.
        root: ``floating``, ``planar``, ``differential`` (a planar one that cannot slide) or ``fixed``; when
            None, floating for bundled robots and fixed for others.
        tool_distance_m: distance of the bundled robots' tool frames from the hand frame [m], default 0.12.
        hand: of the bundled robots, ``hook`` or ``gripper``, default ``hook``.
        locked_joints: position by name of joints that become fixed [rad or m].
        drawn_links: links of the URDF without a collision shape that get their drawn shapes as such.
        split: links of the URDF whose collision meshes are split into convex parts.

    Raises:
        RobotError: one line that names the file, element and value that cannot be used.
    """
    if (name is None) == (urdf is None):
        raise RobotError("give either the name of a bundled robot or a urdf, not both")
    if root not in (None, "floating", "planar", "differential", "fixed"):
        raise RobotError(f"root '{root}' is not known; expected floating, planar, differential or fixed")
    locked = dict(locked_joints or {})
    if urdf is not None:
        if tool_distance_m is not None:
            raise RobotError("tool_distance_m belongs to bundled robots; with a urdf, put the tool frame into it")
        if hand is not None:
            raise RobotError("hand belongs to bundled robots; with a urdf, put the hand into it")
        return load_files(
            Path(urdf), None if srdf is None else Path(srdf), package_dirs, root or "fixed", locked, drawn_links, split
        )
    if name not in _BUNDLED:
        raise RobotError(f"unknown robot '{name}'; expected {would_do(name, _BUNDLED)}")
    if srdf is not None or package_dirs or drawn_links or split:
        raise RobotError(f"srdf, package_dirs, drawn_links and split go with a urdf; '{name}' brings its own")
    if root in ("planar", "differential"):
        raise RobotError(f"root {root} goes with a urdf, not with the name of a bundled robot")
    if hand not in (None, "hook", "gripper"):
        raise RobotError(f"hand '{hand}' is not known; expected hook or gripper")
    if hand == "gripper" and tool_distance_m is not None:
        raise RobotError("tool_distance_m is the length of a hook; a gripper has its own")
    return load_atlas(root or "floating", tool_distance_m, locked, hand or "hook")
