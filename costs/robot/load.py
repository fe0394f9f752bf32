"""Loading of a ``RobotModel`` from its files."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from lxml import etree

from costs.primitive import make_round_shape
from costs.robot import shapes
from costs.robot.elements.bases import ROLLS
from costs.robot.elements.joints import Joint
from costs.robot.elements.shapes import LONG_M, Shape
from costs.robot.errors import RobotError
from costs.robot.followers import let_follow
from costs.robot.mesh import Derived, DerivedCache, make_key, read_bytes, read_vertices, resolve_mesh
from costs.robot.mesh.hull import (
    EXACT_VERTICES,
    find_hull_vertices,
    has_crowded_vertex,
    make_outer_hull,
    thicken_flat_points,
)
from costs.robot.mesh.kept import find_kept_folder
from costs.robot.mesh.split import LinkSplit
from costs.robot.mjcf.source import is_mjcf
from costs.robot.model import BASE_NAMES, PLANAR_NAMES, LinkBody, RobotModel, RobotSource
from costs.robot.self_pairs import derive_ignored_pairs, find_same_joint_pairs
from costs.robot.srdf import EMPTY, Srdf, parse_srdf
from costs.robot.urdf import Urdf, format_urdf, make_pinocchio_xml, merge_notes, parse_urdf
from costs.robot.xmlfile import read_xml_text

DEFAULT_ACCELERATION = 10.0
PACKAGE_SCHEMES = ("package://", "model://")
STILL = 1e-6  # range that counts as none [rad, m]
Root = Literal["floating", "planar", "differential", "fixed"]


def load_files(
    urdf: Path,
    srdf: Path | None,
    package_dirs: Sequence[Path],
    root: Root,
    locked_joints: Mapping[str, float],
    drawn_links: Sequence[str] = (),
    split: LinkSplit | None = None,
) -> RobotModel:
    """Load a robot from a URDF or MJCF and, if given, an SRDF; see ``costs.robot.load_robot``."""
    roots = tuple(Path(folder) for folder in package_dirs) or (urdf.parent,)
    srdf_text = "" if srdf is None else read_xml_text(srdf)
    text = read_xml_text(urdf)
    notes: tuple[str, ...] = ()
    if is_mjcf(text):
        from costs.robot.mjcf.convert import rewrite_mjcf  # few robots are models of MuJoCo

        rewritten = rewrite_mjcf(text, urdf, roots)
        text, notes, roots = rewritten.urdf, rewritten.notes, (*roots, rewritten.folder)
        srdf_text = srdf_text or rewritten.srdf
    return build_robot(text, srdf_text, roots, root, locked_joints, str(urdf), str(srdf), drawn_links, notes, split)


def build_robot(
    urdf_source: str,
    srdf_source: str,
    roots: Sequence[Path],
    root: Root,
    locked_joints: Mapping[str, float],
    urdf_where: str,
    srdf_where: str,
    drawn_links: Sequence[str] = (),
    notes_before: Sequence[str] = (),
    split: LinkSplit | None = None,
) -> RobotModel:
    """Build a robot from the texts of its files; ``*_where`` name them in messages, ``notes_before`` come first."""
    whole_roots = roots

    def change(elements: Mapping[str, etree._Element], notes: list[str]) -> None:
        if split is not None:
            split.apply(elements, whole_roots, urdf_where, notes)

    urdf = parse_urdf(
        urdf_source,
        urdf_where,
        locked_joints,
        drawn_links,
        is_planar=root in ("planar", "differential"),
        rolls=root == "differential",
        change=change,
    )
    roots = roots if split is None else (*roots, find_kept_folder())
    srdf = parse_srdf(srdf_source, srdf_where, urdf) if srdf_source else EMPTY
    model = build_pinocchio_model(urdf, root, urdf_where)
    names = _name_coordinates(model, urdf_where)
    notes = [*notes_before, *urdf.notes, *srdf.notes]
    if srdf.is_planar and root == "fixed" and PLANAR_NAMES[0] not in names:
        notes.append(f"the SRDF's joint '{srdf.virtual_joint}' is planar; `robot.root: planar` lets the base move")
    limits = _collect_limits(urdf, names, notes)
    postures = {name: _read_posture(srdf, name, names, limits, root == "floating") for name in srdf.states}
    _soften_postures(postures, urdf, names, notes)
    meshes = _MeshFiles(roots, {}, {}, {})
    meshes.read(urdf, urdf_where)
    cache = DerivedCache.of_user()
    key = make_key([format_urdf(urdf), root, str(bool(srdf.disabled_pairs)), *meshes.digests.values()])
    known = cache.get(key)
    bodies, hulls = _make_bodies(urdf, model, meshes, known, urdf_where, notes)
    pairs = None
    if srdf.disabled_pairs:
        reasons = dict.fromkeys(find_same_joint_pairs(bodies), "same joint")
        reasons |= {pair: f"srdf ({reason})" if reason else "srdf" for pair, reason in srdf.disabled_pairs.items()}
    else:
        pairs = None if known is None else known.pairs
        if pairs is None:
            pairs = derive_ignored_pairs(model, bodies, limits["lower"], limits["upper"])
        reasons = {pair: "derived" if reason == "Always" else "adjacent" for pair, reason in pairs.items()}
    if known is None:
        cache.put(key, Derived(hulls, tuple(body.outer for body in bodies), pairs))
    return RobotModel(
        name=urdf.name,
        model=model,
        joint_names=names,
        **limits,
        bodies=bodies,
        is_floating=root == "floating",
        groups={name: tuple(j for j in names if j in joints) for name, joints in srdf.groups.items() if joints},
        link_groups=srdf.link_groups,
        postures=postures,
        ignored_pairs=frozenset(reasons),
        fixed_links=frozenset(link for link in urdf.links if find_body_frame(model, link).parentJoint == 0),
        mechanism_links=frozenset(),
        source=RobotSource(format_urdf(urdf), srdf_source, meshes.files, tuple(roots)),
        ignored_reasons=reasons,
        contacts={},
        hands={},
        notes=merge_notes(notes),
        rolls=any(element.get(ROLLS) is not None for element in urdf.tree.findall("joint")),
    )


def build_pinocchio_model(urdf: Urdf, root: Root, where: str) -> pin.Model:
    """Build the robot's joints and masses, a floating base as a composite joint.

    Raises:
        RobotError: no joint moves.
    """
    xml = make_pinocchio_xml(urdf)
    if root != "floating":
        model = pin.buildModelFromXML(xml)
    else:
        base = pin.JointModelComposite(pin.JointModelTranslation())
        base.addJoint(pin.JointModelSphericalZYX())
        model = pin.buildModelFromXML(xml, base)
    if model.nq == 0:
        kinds = Counter(joint.kind for joint in urdf.joints.values())
        count = ", ".join(f"{number} {kind}" for kind, number in kinds.items()) or "none"
        raise RobotError(
            f"{where}: no joint moves (joints: {count}); a robot has at least one that does, or a base that robot.root "
            "makes planar, differential or floating"
        )
    model = let_follow(model, {j.name: j.mimic for j in urdf.joints.values() if j.mimic is not None}, where)
    for frame in model.frames:
        # A joint may have the name of a link; frames of that name are then those of links.
        if frame.type != pin.FrameType.BODY and frame.name in urdf.links:
            frame.name = f"joint:{frame.name}"
    return model


def _name_coordinates(model: pin.Model, where: str) -> tuple[str, ...]:
    names: list[str] = []
    for joint in range(1, model.njoints):
        if model.joints[joint].nq:
            names.extend([model.names[joint]] if model.joints[joint].nq == 1 else BASE_NAMES)
    taken = [name for name in BASE_NAMES if names.count(name) > 1]
    if taken:
        raise RobotError(f"{where}: joint name '{taken[0]}' is reserved for the floating base; rename it")
    return tuple(names)


def _collect_limits(urdf: Urdf, names: Sequence[str], notes: list[str]) -> dict[str, Float[np.ndarray, "n"]]:
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
    for joint in urdf.joints.values():
        if joint.mimic is not None:
            _limit_by_follower(limits, names.index(joint.mimic[0]), joint, joint.mimic[1], joint.mimic[2], notes)
    return limits


def _limit_by_follower(
    limits: Mapping[str, Float[np.ndarray, "n"]],
    column: int,
    joint: Joint,
    multiplier: float,
    offset: float,
    notes: list[str],
) -> None:
    """Narrow the limits of a coordinate so that a joint that follows it stays within its own.

    A follower's velocity of 0 is not stated. The effort is that of the joint that moves both.
    """
    ends = sorted(((joint.lower - offset) / multiplier, (joint.upper - offset) / multiplier))
    lower, upper = max(limits["lower"][column], ends[0]), min(limits["upper"][column], ends[1])
    if upper - lower <= STILL < limits["upper"][column] - limits["lower"][column]:
        leader = joint.mimic[0] if joint.mimic else ""
        notes.append(f"joint '{joint.name}' cannot follow '{leader}' within its own limits, which do not count")
        return
    limits["lower"][column], limits["upper"][column] = lower, upper
    if joint.velocity > 0.0:
        limits["velocity"][column] = min(limits["velocity"][column], joint.velocity / abs(multiplier))
    if joint.acceleration is not None:
        limits["acceleration"][column] = min(limits["acceleration"][column], joint.acceleration / abs(multiplier))


def find_body_frame(model: pin.Model, link: str) -> pin.Frame:
    """Find the frame of a link."""
    return model.frames[int(model.getFrameId(link, pin.FrameType.BODY))]


def _make_bodies(
    urdf: Urdf, model: pin.Model, meshes: _MeshFiles, known: Derived | None, where: str, notes: list[str]
) -> tuple[tuple[LinkBody, ...], Mapping[str, Float[np.ndarray, "V 3"]]]:
    """Make one convex body per <collision>, in the frame of the joint that carries it; also return the meshes' hulls.

    ``known`` has hulls and outer hulls, if they were derived before.
    """
    bodies: list[LinkBody] = []
    hulls: dict[str, Float[np.ndarray, "V 3"]] = {} if known is None else dict(known.hulls)
    outers = () if known is None else known.outers
    for link, link_shapes in urdf.links.items():
        frame = find_body_frame(model, link)
        for index, shape in enumerate(link_shapes):
            inside = f"{where}: link '{link}'"
            points = _read_points(shape, meshes, hulls, inside)
            pose = frame.placement.homogeneous @ shape.pose_link_shape
            vertices = points @ pose[:3, :3].T + pose[:3, 3]
            if shape.kind != "mesh":  # a mesh's points are the vertices of its hull already
                vertices = find_hull_vertices(vertices, inside)
            if shape.kind == "mesh" and has_crowded_vertex(vertices):
                vertices = make_outer_hull(vertices)
                notes.append(
                    f"link '{link}': a flat face with very many corners is replaced by one with fewer around it"
                )
            if shape.kind == "mesh" and (size := float(np.ptp(vertices, axis=0).max())) > LONG_M:
                notes.append(f"link '{link}': a mesh of {size:.3g} m is read as it is; is it in millimetres?")
            name = link if index == 0 else f"{link}/{index}"
            round_shape = make_round_shape(shape.kind, shape.size)
            exact = None if round_shape is None else round_shape.move(pose)
            if exact is None and len(vertices) > EXACT_VERTICES and len(outers) > len(bodies):
                outer = outers[len(bodies)]
            else:
                outer = make_outer_hull(vertices) if exact is None else shapes.make_swept_hull(exact, vertices)
            bodies.append(LinkBody(name, link, int(frame.parentJoint), vertices, outer, exact))
    names = [body.name for body in bodies]
    if len(set(names)) != len(names):
        repeated = next(name for name in names if names.count(name) > 1)
        raise RobotError(f"{where}: two bodies have the name '{repeated}'; rename the link of that name")
    return tuple(bodies), hulls


@dataclass(frozen=True)
class _MeshFiles:
    """Mesh files of a robot.

    Attributes:
        roots: folders they are looked for in.
        files: real path by the key that a result folder stores the file under.
        digests: SHA-256 of each file's content by its path.
        found: key and real path of each mesh by the text that names it.
    """

    roots: Sequence[Path]
    files: dict[str, Path]
    digests: dict[Path, str]
    found: dict[str, tuple[str, Path]]

    def read(self, urdf: Urdf, where: str) -> None:
        """Find all mesh files of a URDF's collision shapes."""
        for link, link_shapes in urdf.links.items():
            for shape in link_shapes:
                if shape.kind == "mesh":
                    self.find(shape, f"{where}: link '{link}'")

    def find(self, shape: Shape, where: str) -> Path:
        """Return the file of a mesh, whose element then has the path that a result folder stores it under."""
        if shape.uri not in self.found:
            self.found[shape.uri] = resolve_mesh(shape.uri, self.roots, where)
        key, path = self.found[shape.uri]
        if self.files.setdefault(key, path) != path:
            raise RobotError(f"{where}: mesh '{shape.uri}' names another file than '{key}' elsewhere; rename one")
        if not shape.uri.startswith(PACKAGE_SCHEMES):
            # A path with '..' and an absolute one would leave the folder a result is written to.
            shape.element.set("filename", key)
        if path not in self.digests:
            self.digests[path] = hashlib.sha256(read_bytes(path, where)).hexdigest()
        return path


def _read_points(
    shape: Shape, meshes: _MeshFiles, hulls: dict[str, Float[np.ndarray, "V 3"]], where: str
) -> Float[np.ndarray, "V 3"]:
    """Return points whose hull contains the shape, in its own frame [m]; add a mesh's hull to ``hulls``."""
    if shape.kind != "mesh":
        return shapes.make_points(shape.kind, shape.size)
    path = meshes.find(shape, where)
    digest = meshes.digests[path]
    if digest not in hulls:
        data = read_bytes(path, where)
        if hashlib.sha256(data).hexdigest() != digest:
            raise RobotError(f"{where}: mesh '{path.name}' changed while it was read; load the robot again")
        hulls[digest] = find_hull_vertices(thicken_flat_points(read_vertices(path, where, data)), where)
    return np.asarray(hulls[digest] * shape.size)


def _read_posture(
    srdf: Srdf, state: str, names: Sequence[str], limits: Mapping[str, Float[np.ndarray, "n"]], is_floating: bool
) -> Float[np.ndarray, "n"]:
    """Return the configuration of a named state; other joints are at 0, clipped into their limits."""
    values = srdf.states[state]
    posture = np.clip(np.zeros(len(names)), limits["lower"], limits["upper"])
    for column, name in enumerate(names):
        if name in values:
            posture[column] = values[name][0]
    if srdf.virtual_joint not in values:
        return posture
    if srdf.is_planar:
        for name, value in zip(PLANAR_NAMES, values[srdf.virtual_joint], strict=True):
            if name in names:
                posture[names.index(name)] = value
    elif is_floating:
        x, y, z, qx, qy, qz, qw = values[srdf.virtual_joint]
        # The quaternion may have any length but zero, which ``parse_srdf`` refuses.
        yaw_pitch_roll = pin.rpy.matrixToRpy(pin.Quaternion(qw, qx, qy, qz).normalized().matrix())[::-1]
        posture[:6] = [x, y, z, *yaw_pitch_roll]
    return posture


def _soften_postures(
    postures: Mapping[str, Float[np.ndarray, "n"]], urdf: Urdf, names: Sequence[str], notes: list[str]
) -> None:
    """Bring postures within the joints' stops inside their soft limits, with a note."""
    for column, name in enumerate(names):
        joint = urdf.joints.get(name)
        if joint is None or joint.stops is None:
            continue
        for posture, values in postures.items():
            soft = min(max(float(values[column]), joint.lower), joint.upper)
            if joint.stops[0] <= values[column] <= joint.stops[1] and values[column] != soft:
                notes.append(f"posture '{posture}': {name} at {values[column]:g} is put at its soft limit {soft:g}")
                values[column] = soft
