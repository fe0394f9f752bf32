"""Loading of a ``RobotModel`` from its files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.primitive import make_round_shape
from costs.robot import shapes
from costs.robot.errors import RobotError
from costs.robot.hull import find_hull_vertices, make_outer_hull
from costs.robot.meshes import read_vertices, resolve_mesh
from costs.robot.model import BASE_NAMES, LinkBody, RobotModel, RobotSource
from costs.robot.self_pairs import derive_ignored_pairs, find_same_joint_pairs
from costs.robot.srdf import EMPTY, Srdf, parse_srdf
from costs.robot.urdf import Urdf, format_urdf, make_pinocchio_xml, parse_urdf
from costs.robot.urdf_elements import Shape
from costs.robot.xmlfile import read_xml_text

DEFAULT_ACCELERATION = 10.0
Root = Literal["floating", "fixed"]


def load_files(
    urdf: Path,
    srdf: Path | None,
    package_dirs: Sequence[Path],
    root: Root,
    locked_joints: Mapping[str, float],
) -> RobotModel:
    """Load a robot from a URDF and, if given, an SRDF; see ``costs.robot.load_robot``."""
    roots = tuple(Path(folder) for folder in package_dirs) or (urdf.parent,)
    srdf_text = "" if srdf is None else read_xml_text(srdf)
    return build_robot(read_xml_text(urdf), srdf_text, roots, root, locked_joints, str(urdf), str(srdf))


def build_robot(
    urdf_source: str,
    srdf_source: str,
    roots: Sequence[Path],
    root: Root,
    locked_joints: Mapping[str, float],
    urdf_where: str,
    srdf_where: str,
) -> RobotModel:
    """Build a robot from the texts of its files; ``*_where`` name them in messages."""
    urdf = parse_urdf(urdf_source, urdf_where, locked_joints)
    srdf = parse_srdf(srdf_source, srdf_where, urdf) if srdf_source else EMPTY
    model = build_pinocchio_model(urdf, root, urdf_where)
    names = _name_coordinates(model, urdf_where)
    limits = _collect_limits(urdf, names)
    bodies, files = _make_bodies(urdf, model, roots, urdf_where)
    if srdf.disabled_pairs:
        reasons = dict.fromkeys(find_same_joint_pairs(bodies), "same joint")
        reasons |= {pair: f"srdf ({reason})" if reason else "srdf" for pair, reason in srdf.disabled_pairs.items()}
    else:
        derived = derive_ignored_pairs(model, bodies, limits["lower"], limits["upper"])
        reasons = {pair: "derived" if reason == "Always" else "adjacent" for pair, reason in derived.items()}
    return RobotModel(
        name=urdf.name,
        model=model,
        joint_names=names,
        **limits,
        bodies=bodies,
        is_floating=root == "floating",
        groups={name: tuple(j for j in names if j in joints) for name, joints in srdf.groups.items() if joints},
        link_groups=srdf.link_groups,
        postures={name: _read_posture(srdf, name, names, limits) for name in srdf.states},
        ignored_pairs=frozenset(reasons),
        fixed_links=frozenset(link for link in urdf.links if find_body_frame(model, link).parentJoint == 0),
        mechanism_links=frozenset(),
        source=RobotSource(format_urdf(urdf), srdf_source, files),
        ignored_reasons=reasons,
        contacts={},
        hands={},
    )


def build_pinocchio_model(urdf: Urdf, root: Root, where: str) -> pin.Model:
    """Build the robot's joints and masses, the base as a composite joint if it is free.

    Raises:
        RobotError: no joint moves.
    """
    xml = make_pinocchio_xml(urdf)
    if root == "fixed":
        model = pin.buildModelFromXML(xml)
    else:
        base = pin.JointModelComposite(pin.JointModelTranslation())
        base.addJoint(pin.JointModelSphericalZYX())
        model = pin.buildModelFromXML(xml, base)
    if model.nq != model.nv or model.nq == 0:
        raise RobotError(f"{where}: has {model.nq} coordinates and {model.nv} velocities; at least one joint must move")
    return model


def _name_coordinates(model: pin.Model, where: str) -> tuple[str, ...]:
    names: list[str] = []
    for joint in range(1, model.njoints):
        names.extend([model.names[joint]] if model.joints[joint].nq == 1 else BASE_NAMES)
    taken = [name for name in BASE_NAMES if names.count(name) > 1]
    if taken:
        raise RobotError(f"{where}: joint name '{taken[0]}' is reserved for the floating base; rename it")
    return tuple(names)


def _collect_limits(urdf: Urdf, names: Sequence[str]) -> dict[str, Float[np.ndarray, "n"]]:
    """Return limits by name of the ``RobotModel`` field; the base's are infinite."""
    limits = {key: np.full(len(names), np.inf) for key in ("lower", "upper", "velocity", "acceleration", "effort")}
    limits["lower"] *= -1.0
    for column, name in enumerate(names):
        joint = urdf.joints.get(name)
        if joint is None:
            continue
        for key in ("lower", "upper", "velocity", "effort"):
            limits[key][column] = getattr(joint, key)
        limits["acceleration"][column] = DEFAULT_ACCELERATION if joint.acceleration is None else joint.acceleration
    return limits


def find_body_frame(model: pin.Model, link: str) -> pin.Frame:
    """Find the frame of a link."""
    return model.frames[int(model.getFrameId(link, pin.FrameType.BODY))]


def _make_bodies(
    urdf: Urdf, model: pin.Model, roots: Sequence[Path], where: str
) -> tuple[tuple[LinkBody, ...], Mapping[str, Path]]:
    """Make one convex body per <collision>, in the frame of the joint that carries it; also return the mesh files."""
    bodies: list[LinkBody] = []
    files: dict[str, Path] = {}
    for link, link_shapes in urdf.links.items():
        frame = find_body_frame(model, link)
        for index, shape in enumerate(link_shapes):
            inside = f"{where}: link '{link}'"
            points = _read_points(shape, roots, files, inside)
            pose = frame.placement.homogeneous @ shape.pose_link_shape
            vertices = find_hull_vertices(points @ pose[:3, :3].T + pose[:3, 3], inside)
            name = link if index == 0 else f"{link}/{index}"
            round_shape = make_round_shape(shape.kind, shape.size)
            exact = None if round_shape is None else round_shape.move(pose)
            outer = make_outer_hull(vertices) if exact is None else shapes.make_swept_hull(exact, vertices)
            bodies.append(LinkBody(name, link, int(frame.parentJoint), vertices, outer, exact))
    names = [body.name for body in bodies]
    if len(set(names)) != len(names):
        repeated = next(name for name in names if names.count(name) > 1)
        raise RobotError(f"{where}: two bodies have the name '{repeated}'; rename the link of that name")
    return tuple(bodies), files


def _read_points(shape: Shape, roots: Sequence[Path], files: dict[str, Path], where: str) -> Float[np.ndarray, "V 3"]:
    """Return points whose hull contains the shape, in its own frame [m]; add a mesh's file to ``files``."""
    if shape.kind != "mesh":
        return shapes.make_points(shape.kind, shape.size)
    key, path = resolve_mesh(shape.uri, roots, where)
    if files.setdefault(key, path) != path:
        raise RobotError(f"{where}: mesh '{shape.uri}' names another file than '{key}' elsewhere; rename one")
    if "://" not in shape.uri:
        # A path with '..' would leave the folder a result is written to.
        shape.element.set("filename", key)
    return np.asarray(read_vertices(path, where) * shape.size)


def _read_posture(
    srdf: Srdf, state: str, names: Sequence[str], limits: Mapping[str, Float[np.ndarray, "n"]]
) -> Float[np.ndarray, "n"]:
    """Return the configuration of a named state; other joints are at 0, clipped into their limits."""
    values = srdf.states[state]
    posture = np.clip(np.zeros(len(names)), limits["lower"], limits["upper"])
    for column, name in enumerate(names):
        if name in values:
            posture[column] = values[name][0]
    if names[0] == BASE_NAMES[0] and srdf.virtual_joint in values:
        x, y, z, qx, qy, qz, qw = values[srdf.virtual_joint]
        # The quaternion may have any length but zero, which ``parse_srdf`` refuses.
        yaw_pitch_roll = pin.rpy.matrixToRpy(pin.Quaternion(qw, qx, qy, qz).normalized().matrix())[::-1]
        posture[:6] = [x, y, z, *yaw_pitch_roll]
    return posture
