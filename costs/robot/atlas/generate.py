"""Writes the bundled Atlas from our figures and shapes: ``python -m costs.robot.atlas.generate``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.spatial import ConvexHull

from costs.robot.atlas.body_shapes import foot, link_shapes
from costs.robot.atlas.figures import FIXED_JOINTS, JOINTS, LINKS, MASSLESS_LINKS, SOLES
from costs.robot.atlas.postures import GROUPS, LINK_GROUPS, POSTURES, whole_posture
from costs.robot.errors import RobotError
from costs.robot.load import build_robot
from costs.robot.model import RobotModel
from costs.robot.self_pairs import derive_ignored_pairs

FOLDER = Path(__file__).parent
DEFAULT_TOOL_DISTANCE = 0.12
MIN_TOOL_DISTANCE, MAX_TOOL_DISTANCE = 0.07, 0.60
HOOK_RADIUS = 0.009
# Where the hook's rod begins on the hand axis, inside the hand's palm.
HOOK_START = 0.045


def urdf_text(tool_distance_m: float = DEFAULT_TOOL_DISTANCE) -> str:
    """The URDF, with hooks that end at ``tool_distance_m`` from the hand frames.

    Raises:
        RobotError: when the distance would put the tool inside the hand or out of any proportion.
    """
    if not MIN_TOOL_DISTANCE <= tool_distance_m <= MAX_TOOL_DISTANCE:
        raise RobotError(
            f"tool_distance_m {tool_distance_m} is out of range; between {MIN_TOOL_DISTANCE} and {MAX_TOOL_DISTANCE} m"
        )
    lines = [
        '<?xml version="1.0"?>',
        "<!-- Written by costs.robot.atlas.generate. Kinematics, limits, masses and inertias: osrf/drcsim atlas_v5.urdf",
        "     and multisense_sl_v4.urdf, Apache License 2.0. Shapes and hooks are this project's own. -->",
        '<robot name="atlas">',
    ]
    shapes = _mesh_points()
    for link in LINKS:
        lines += [f'  <link name="{link.name}">', "    <inertial>", f"      <mass value={_quoted([link.mass])}/>",
                  f'      <origin xyz={_quoted(link.com)} rpy="0 0 0"/>']  # fmt: skip
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        values = " ".join(f"{key}={_quoted([value])}" for key, value in zip(keys, link.inertia, strict=True))
        lines += [f"      <inertia {values}/>", "    </inertial>"]
        lines += [line for name in shapes if name.rpartition("_")[0] == link.name for line in _mesh_lines(name)]
        lines.append("  </link>")
    lines += [f'  <link name="{name}"/>' for name in MASSLESS_LINKS]
    for joint in JOINTS:
        lines += [f'  <joint name="{joint.name}" type="revolute">', *_ends(joint.parent, joint.child),
                  _origin(joint.xyz, joint.rpy), f"    <axis xyz={_quoted(joint.axis)}/>",
                  f"    <limit lower={_quoted([joint.lower])} upper={_quoted([joint.upper])}"
                  f" velocity={_quoted([joint.velocity])} effort={_quoted([joint.effort])}/>",
                  f"    <dynamics damping={_quoted([joint.damping])} friction={_quoted([joint.friction])}/>",
                  "  </joint>"]  # fmt: skip
    for fixed in FIXED_JOINTS:
        lines += _fixed(fixed.name, fixed.parent, fixed.child, fixed.xyz, fixed.rpy)
    for side, sign in (("l", 1.0), ("r", -1.0)):
        lines += _hook_lines(side, sign, tool_distance_m)
    return "\n".join([*lines, "</robot>", ""])


def srdf_text(robot: RobotModel, reasons: Mapping[tuple[str, str], str]) -> str:
    """The SRDF: groups, postures and the pairs not to check."""
    lines = [
        '<?xml version="1.0"?>',
        "<!-- Written by costs.robot.atlas.generate. The virtual joint's value is x y z qx qy qz qw. -->",
        '<robot name="atlas">',
        '  <virtual_joint name="base" type="floating" parent_frame="world" child_link="pelvis"/>',
    ]
    for group, joints in GROUPS.items():
        lines += [f'  <group name="{group}">', *(f'    <joint name="{joint}"/>' for joint in joints), "  </group>"]
    for group, links in LINK_GROUPS.items():
        lines += [f'  <group name="{group}">', *(f'    <link name="{link}"/>' for link in links), "  </group>"]
    for name in POSTURES:
        angles = whole_posture(name)
        lines.append(f'  <group_state name="{name}" group="whole_body">')
        lines.append(f'    <joint name="base" value="0 0 {_standing_height(robot, angles):.9f} 0 0 0 1"/>')
        lines += [f'    <joint name="{joint}" value={_quoted([angle])}/>' for joint, angle in angles.items()]
        lines.append("  </group_state>")
    lines += [
        f'  <disable_collisions link1="{a}" link2="{b}" reason="{reason}"/>' for (a, b), reason in reasons.items()
    ]
    return "\n".join([*lines, "</robot>", ""])


def generate() -> Mapping[str, str]:
    """Text of every file of the bundled robot by its path in this folder."""
    files = {f"meshes/{name}.obj": _obj(name, points) for name, points in _mesh_points().items()}
    files["atlas.urdf"] = urdf_text()
    with TemporaryDirectory() as scratch:
        package = Path(scratch) / "atlas"
        _write(package, files)
        robot = build_robot(files["atlas.urdf"], "", (Path(scratch),), "floating", {}, "atlas.urdf", "")
    reasons = derive_ignored_pairs(robot.model, robot.bodies, robot.lower, robot.upper)
    files["atlas.srdf"] = srdf_text(robot, reasons)
    return files


def _write(folder: Path, files: Mapping[str, str]) -> None:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")


def _mesh_points() -> Mapping[str, Float[np.ndarray, "V 3"]]:
    """Vertices by mesh name, ``link_0``, ``link_1``, ..., rounded to a hundredth of a millimetre."""
    shapes = {link: tuple(bodies) for link, bodies in link_shapes().items()}
    shapes.update({link: (foot(np.array(sole)),) for link, sole in SOLES.items()})
    return {f"{link}_{index}": np.round(points[np.sort(ConvexHull(points).vertices)], 5) + 0.0
            for link, bodies in sorted(shapes.items()) for index, points in enumerate(bodies)}  # fmt: skip


def _obj(name: str, points: Float[np.ndarray, "V 3"]) -> str:
    """OBJ with one polygon per face, in an order that does not depend on the hull code's."""
    hull = ConvexHull(points)
    planes: dict[tuple[float, ...], set[int]] = {}
    for simplex, plane in zip(hull.simplices, hull.equations, strict=True):
        planes.setdefault(tuple(np.round(plane, 4) + 0.0), set()).update(int(index) for index in simplex)
    faces = []
    for plane, members in planes.items():
        indices = sorted(members)
        centre = points[indices].mean(axis=0)
        first = points[indices[0]] - centre
        second = np.cross(plane[:3], first)
        angle = [np.arctan2((points[i] - centre) @ second, (points[i] - centre) @ first) for i in indices]
        # The first vertex stands at angle 0: the face begins with its smallest index.
        faces.append([indices[k] for k in np.argsort(np.mod(np.round(angle, 9), 2.0 * np.pi), kind="stable")])
    lines = [f"# {name}: written by costs.robot.atlas.generate", f"o {name}"]
    lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in points]
    lines += ["f " + " ".join(str(index + 1) for index in face) for face in sorted(faces)]
    return "\n".join([*lines, ""])


def _mesh_lines(name: str) -> list[str]:
    geometry = f'<geometry><mesh filename="package://atlas/meshes/{name}.obj"/></geometry>'
    return [f"    <visual>{geometry}</visual>", f"    <collision>{geometry}</collision>"]


def _hook_lines(side: str, sign: float, tool_distance: float) -> list[str]:
    """Hook link and tool frame: z along the hand axis, away from the elbow; x as the hand's."""
    turned = (-sign * 0.5 * np.pi, 0.0, 0.0)
    length = tool_distance - HOOK_START
    rod = (f'<origin xyz={_quoted([0.0, 0.0, 0.5 * length])} rpy="0 0 0"/>'
           f'<geometry><cylinder radius="{HOOK_RADIUS}" length={_quoted([length])}/></geometry>')  # fmt: skip
    return [
        f'  <link name="{side}_hook">',
        f"    <visual>{rod}</visual>",
        f"    <collision>{rod}</collision>",
        "  </link>",
        f'  <link name="{side}_tool"/>',
        *_fixed(f"{side}_hook_joint", f"{side}_hand", f"{side}_hook", (0.0, sign * HOOK_START, 0.0), turned),
        *_fixed(f"{side}_tool_joint", f"{side}_hook", f"{side}_tool", (0.0, 0.0, length), (0.0, 0.0, 0.0)),
    ]


def _standing_height(robot: RobotModel, angles: Mapping[str, float]) -> float:
    """Height of the base that puts the lower sole on z = 0 [m]."""
    q = np.zeros(robot.n)
    for joint, angle in angles.items():
        q[robot.joint_names.index(joint)] = angle
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    lowest = [(data.oMf[int(robot.model.getFrameId(link))].act(np.array(corner)))[2]
              for link, sole in SOLES.items() for corner in sole]  # fmt: skip
    return -float(min(lowest))


def _fixed(name: str, parent: str, child: str, xyz: tuple[float, ...], rpy: tuple[float, ...]) -> list[str]:
    return [f'  <joint name="{name}" type="fixed">', *_ends(parent, child), _origin(xyz, rpy), "  </joint>"]


def _ends(parent: str, child: str) -> list[str]:
    return [f'    <parent link="{parent}"/>', f'    <child link="{child}"/>']


def _origin(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> str:
    return f"    <origin xyz={_quoted(xyz)} rpy={_quoted(rpy)}/>"


def _quoted(values: tuple[float, ...] | list[float]) -> str:
    return quoteattr(" ".join(f"{float(value):.12g}" for value in values))


if __name__ == "__main__":
    _write(FOLDER, generate())
