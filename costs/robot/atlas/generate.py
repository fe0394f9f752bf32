"""Generator of the bundled Atlas's files from figures and shapes: ``python -m costs.robot.atlas.generate``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.spatial import ConvexHull

from costs.robot.atlas.description import FOLDER, format_urdf, mesh_points, quote
from costs.robot.atlas.figures import SOLES
from costs.robot.atlas.postures import GROUPS, LINK_GROUPS, POSTURES, whole_posture
from costs.robot.load import build_robot
from costs.robot.model import RobotModel
from costs.robot.self_pairs import derive_ignored_pairs


def generate() -> Mapping[str, str]:
    """Generate the text of every file of the bundled robot by its path in this folder."""
    files = {f"meshes/{name}.obj": _obj(name, points) for name, points in mesh_points().items()}
    files["atlas.urdf"] = format_urdf()
    with TemporaryDirectory() as scratch:
        package = Path(scratch) / "atlas"
        write(package, files)
        robot = build_robot(files["atlas.urdf"], "", (Path(scratch),), "floating", {}, "atlas.urdf", "")
    reasons = derive_ignored_pairs(robot.model, robot.bodies, robot.lower, robot.upper)
    files["atlas.srdf"] = _format_srdf(robot, reasons)
    return files


def write(folder: Path, files: Mapping[str, str]) -> None:
    """Write texts by path into a folder."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")


def _format_srdf(robot: RobotModel, reasons: Mapping[tuple[str, str], str]) -> str:
    """Format the SRDF: groups, postures and the pairs not to check."""
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
        lines += [f'    <joint name="{joint}" value={quote([angle])}/>' for joint, angle in angles.items()]
        lines.append("  </group_state>")
    lines += [
        f'  <disable_collisions link1="{a}" link2="{b}" reason="{reason}"/>' for (a, b), reason in reasons.items()
    ]
    return "\n".join([*lines, "</robot>", ""])


def _obj(name: str, points: Float[np.ndarray, "V 3"]) -> str:
    """Format a mesh as OBJ, one polygon per face, in an order that does not depend on the hull library."""
    hull = ConvexHull(points)
    planes: dict[tuple[float, ...], set[int]] = {}
    for simplex, equation in zip(hull.simplices, hull.equations, strict=True):
        planes.setdefault(tuple(np.round(equation, 4) + 0.0), set()).update(int(index) for index in simplex)
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


def _standing_height(robot: RobotModel, angles: Mapping[str, float]) -> float:
    """Return the height of the base that puts the lower sole on z = 0 [m]."""
    q = np.zeros(robot.n)
    for joint, angle in angles.items():
        q[robot.joint_names.index(joint)] = angle
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    lowest = [(data.oMf[int(robot.model.getFrameId(link))].act(np.array(corner)))[2]
              for link, sole in SOLES.items() for corner in sole]  # fmt: skip
    return -float(min(lowest))


if __name__ == "__main__":
    write(FOLDER, generate())
