"""Rewriting of a compiled model of MuJoCo as URDF and SRDF.

A body with several joints becomes a chain of links without mass; a joint whose axis lies off its body's frame gets a
fixed joint below it, so that links have the frames of their bodies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from lxml import etree
from scipy.spatial.transform import Rotation

from costs.robot.elements.joints import DEFAULT_VELOCITY
from costs.robot.errors import RobotError
from costs.robot.mesh.kept import find_kept_folder, keep_triangles
from costs.robot.mjcf.source import compile_mjcf
from costs.robot.poses import axis_rotation, format_numbers, make_origin
from costs.robot.xmlfile import MADE_HERE

FREE, BALL, SLIDE, HINGE = range(4)  # types of joints
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH, SDF = range(9)  # types of geoms
ODD = (PLANE, HFIELD, SDF)  # geoms that no shape is made of
JOINT_EQUALITY = 2
EARTH = (0.0, 0.0, -9.81)  # gravity of every plan [m/s^2]
GRAVITY_ROUNDING = 0.02  # of models, which write 9.8 or 9.80665 [m/s^2]
JOINT_TRANSMISSION = 0
WORLD = "world"
TINY_M = 1e-12


@dataclass(frozen=True)
class RewrittenRobot:
    """A robot in the form that everything else reads.

    Attributes:
        urdf, srdf: texts; the SRDF has the model's keyframes as postures and is "" without any.
        folder: where the URDF's meshes lie.
        notes: what the model leaves open, and what was left out.
    """

    urdf: str
    srdf: str
    folder: Path
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Model:
    """A compiled model with the names of its parts.

    Attributes:
        mj: the ``MjModel``.
        name: of the robot.
        bodies: names by number of the body.
        joints: names by number of the joint.
        kept: numbers of the robot's bodies, parents first.
        free: number of the body that a free joint moves; None for a robot that stands in the world.
    """

    mj: Any
    name: str
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    kept: tuple[int, ...]
    free: int | None


def rewrite_mjcf(text: str, path: Path, roots: Sequence[Path]) -> RewrittenRobot:
    """Read an MJCF model by MuJoCo and rewrite it as URDF.

    Args:
        text: content of ``path``.
        path: file of the model.
        roots: folders that its meshes and included files may lie in.

    Raises:
        RobotError: the model or a file of it cannot be used, or it has a joint that a URDF cannot have.
    """
    mj = compile_mjcf(text, path, roots)
    notes: list[str] = []
    model = _name_parts(mj, path, notes)
    robot = etree.Element("robot", name=model.name)
    if model.free is None:
        robot.append(_make_link(model, 0, has_mass=False))
    for body in model.kept:
        robot.append(_make_link(model, body, has_mass=True))
    efforts = _list_efforts(model)
    for body in model.kept:
        if body != model.free:
            for element in _list_joints(model, body, efforts):
                robot.append(element)
    _add_followers(model, robot, notes)
    notes += _list_left_out(model)
    notes.append(
        f"a model of MuJoCo states no limits of speed: {DEFAULT_VELOCITY:g} rad/s or m/s are used; the pairs of links "
        "that its contacts leave out are not taken over"
    )
    urdf = str(etree.tostring(robot, encoding="unicode"))
    return RewrittenRobot(urdf, _write_postures(model), find_kept_folder(), tuple(notes))


def _name_parts(mj: Any, path: Path, notes: list[str]) -> _Model:
    """Choose the robot's bodies and name all parts (RobotError: no robot, or a ball joint)."""
    taken: set[str] = set()
    bodies = tuple(_make_name(mj.body(k).name or ("" if k else WORLD), f"body{k}", taken) for k in range(mj.nbody))
    joints = tuple(_make_name(mj.joint(k).name, f"joint{k}", taken) for k in range(mj.njnt))
    trees = {root: tuple(k for k in range(1, mj.nbody) if mj.body_rootid[k] == root) for root in
             sorted({int(k) for k in mj.body_rootid[1:]})}  # fmt: skip
    moving = {root: sum(int(mj.body_jntnum[k]) for k in own) - int(_is_free(mj, root)) for root, own in trees.items()}
    if not moving or max(moving.values()) == 0:
        raise RobotError(f"{path}: no joint moves; a robot has at least one that does")
    main = max(moving, key=lambda root: moving[root])
    free = main if _is_free(mj, main) else None
    chosen = [main] if free is not None else [root for root in trees if not _is_free(mj, root)]
    left_out = [bodies[root] for root in trees if root not in chosen]
    if left_out:
        notes.append(
            f"bodies {', '.join(left_out)} do not belong to the robot and are left out; put them into the scene"
        )
    if free is None and any(mj.geom_type[g] in (PLANE, HFIELD) for g in _list_geoms(mj, 0)):
        notes.append("the model's ground is left out; the request's scene has it")
    kept = tuple(k for root in chosen for k in trees[root])
    for body in kept:
        for joint in _list_body_joints(mj, body):
            if mj.jnt_type[joint] == BALL or (mj.jnt_type[joint] == FREE and body != free):
                kind = "ball" if mj.jnt_type[joint] == BALL else "free"
                raise RobotError(
                    f"{path}: joint '{joints[joint]}' is a {kind} joint; expected hinge and slide joints, which a "
                    "ball joint can be written as"
                )
    names = [bodies[int(mj.eq_obj1id[k])] for k in range(mj.neq) if mj.eq_type[k] in (0, 1) and mj.eq_active0[k]]
    if names and mj.neq:
        notes.append(
            "closed loops are left out (equality connect and weld); robot.locked fixes the joints of such a mechanism"
        )
    name = str(mj.names[: mj.names.index(b"\0")].decode(errors="replace")) or path.stem
    return _Model(mj, name, bodies, joints, kept, free)


def _make_name(name: str, otherwise: str, taken: set[str]) -> str:
    chosen = name or otherwise
    while chosen in taken:
        chosen += "_"
    taken.add(chosen)
    return chosen


def _is_free(mj: Any, body: int) -> bool:
    return any(mj.jnt_type[joint] == FREE for joint in _list_body_joints(mj, body))


def _list_body_joints(mj: Any, body: int) -> range:
    first = int(mj.body_jntadr[body])
    return range(first, first + int(mj.body_jntnum[body]))


def _list_geoms(mj: Any, body: int) -> range:
    first = int(mj.body_geomadr[body])
    return range(first, first + int(mj.body_geomnum[body]))


def _make_link(model: _Model, body: int, *, has_mass: bool) -> etree._Element:
    """Make the link of a body with its mass and shapes; those that touch nothing are only drawn."""
    mj = model.mj
    link = etree.Element("link", name=model.bodies[body])
    if has_mass and mj.body_mass[body] > 0.0:
        inertial = etree.SubElement(link, "inertial")
        inertial.append(make_origin(_pose(mj.body_ipos[body], mj.body_iquat[body])))
        etree.SubElement(inertial, "mass", value=repr(float(mj.body_mass[body])))
        moments = dict(zip(("ixx", "iyy", "izz"), map(float, mj.body_inertia[body]), strict=True))
        values = {key: repr(moments.get(key, 0.0)) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
        etree.SubElement(inertial, "inertia", values)
    pairs = {int(geom) for geom in (*mj.pair_geom1, *mj.pair_geom2)}
    for geom in _list_geoms(mj, body):
        shape = _make_shape(mj, geom)
        if shape is None:
            continue
        is_solid = bool(mj.geom_contype[geom] or mj.geom_conaffinity[geom]) or geom in pairs
        part = etree.SubElement(link, "collision" if is_solid else "visual")
        part.append(make_origin(_pose(mj.geom_pos[geom], mj.geom_quat[geom])))
        etree.SubElement(part, "geometry").append(shape)
    return link


def _make_shape(mj: Any, geom: int) -> etree._Element | None:
    """Make the shape of a geom; None for the ground."""
    kind, size = int(mj.geom_type[geom]), mj.geom_size[geom]
    if kind == SPHERE:
        return etree.Element("sphere", radius=repr(float(size[0])))
    if kind in (CAPSULE, CYLINDER):
        return etree.Element(
            "capsule" if kind == CAPSULE else "cylinder",
            radius=repr(float(size[0])),
            length=repr(2.0 * float(size[1])),
        )
    if kind == ELLIPSOID:
        return etree.Element("ellipsoid", {key: repr(float(size[k])) for k, key in enumerate("abc")})
    if kind == BOX:
        return etree.Element("box", size=format_numbers(2.0 * size))
    if kind == MESH:
        mesh = int(mj.geom_dataid[geom])
        vertices = mj.mesh_vert[mj.mesh_vertadr[mesh] :][: mj.mesh_vertnum[mesh]]
        faces = mj.mesh_face[mj.mesh_faceadr[mesh] :][: mj.mesh_facenum[mesh]]
        return etree.Element("mesh", filename=keep_triangles(vertices[faces]))
    return None


def _list_joints(model: _Model, body: int, efforts: dict[int, float]) -> Iterator[etree._Element]:
    """Yield the joints from a body's parent to the body, and the links without mass between them."""
    mj = model.mj
    name, parent = model.bodies[body], model.bodies[int(mj.body_parentid[body])]
    pose = _pose(mj.body_pos[body], mj.body_quat[body])  # pose_parent_body, as far as it is not used up
    joints = list(_list_body_joints(mj, body))
    for number, joint in enumerate(joints):
        axis, anchor = np.asarray(mj.jnt_axis[joint], dtype=float), np.zeros(3)
        is_turning = mj.jnt_type[joint] == HINGE
        if is_turning:
            anchor = np.asarray(mj.jnt_pos[joint], dtype=float)
        origin, rest = pose @ _shift(anchor), _shift(-anchor)
        reference = float(mj.qpos0[mj.jnt_qposadr[joint]])
        if reference:
            back = np.eye(4)
            if is_turning:
                back[:3, :3] = axis_rotation(axis, -reference)
            else:
                back[:3, 3] = -reference * axis
            rest = back @ rest
        is_last = number == len(joints) - 1 and np.allclose(rest, np.eye(4), atol=TINY_M, rtol=0.0)
        child = name if is_last else f"{name}.{model.joints[joint]}"
        made = etree.Element("joint", name=model.joints[joint])
        made.append(make_origin(origin))
        etree.SubElement(made, "parent", link=parent)
        etree.SubElement(made, "child", link=child)
        etree.SubElement(made, "axis", xyz=format_numbers(axis))
        made.append(_make_limit(mj, joint, efforts.get(joint)))
        is_endless = is_turning and not mj.jnt_limited[joint]
        made.set("type", "continuous" if is_endless else "revolute" if is_turning else "prismatic")
        dynamics = {"friction": mj.dof_frictionloss, "damping": mj.dof_damping}
        dof = int(mj.jnt_dofadr[joint])
        etree.SubElement(made, "dynamics", {key: repr(float(np.ravel(of[dof])[0])) for key, of in dynamics.items()})
        yield made
        if is_last:
            return
        yield etree.Element("link", name=child)
        parent, pose = child, rest
    fixed = etree.Element("joint", name=f"{name}.fixed", type="fixed")
    fixed.append(make_origin(pose))
    etree.SubElement(fixed, "parent", link=parent)
    etree.SubElement(fixed, "child", link=name)
    yield fixed


def _pose(position: Float[np.ndarray, "3"], quaternion_wxyz: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4 4"]:
    pose = _shift(position)
    pose[:3, :3] = Rotation.from_quat(quaternion_wxyz, scalar_first=True).as_matrix()
    return pose


def _shift(offset: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, 3] = offset
    return pose


def _make_limit(mj: Any, joint: int, effort: float | None) -> etree._Element:
    limit = {"velocity": repr(DEFAULT_VELOCITY), MADE_HERE: "true"}
    if mj.jnt_limited[joint]:
        limit |= {key: repr(float(mj.jnt_range[joint][k])) for k, key in enumerate(("lower", "upper"))}
    elif mj.jnt_type[joint] == SLIDE:
        limit |= {"lower": "-inf", "upper": "inf"}
    if effort is not None:
        limit["effort"] = repr(effort)
    return etree.Element("limit", limit)


def _list_efforts(model: _Model) -> dict[int, float]:
    """Return the largest force of each joint that has one: its own limit, or what its actuators give [N m, N]."""
    mj, found = model.mj, dict[int, float]()
    for k in range(mj.nu):
        if mj.actuator_trntype[k] != JOINT_TRANSMISSION:
            continue
        joint, gear = int(mj.actuator_trnid[k][0]), abs(float(mj.actuator_gear[k][0]))
        if mj.actuator_forcelimited[k]:
            most = float(np.abs(mj.actuator_forcerange[k]).min()) * gear
        elif mj.actuator_biastype[k] == 0 and mj.actuator_gaintype[k] == 0 and mj.actuator_ctrllimited[k]:
            # A motor: its force is its control times a factor.
            most = float(np.abs(mj.actuator_ctrlrange[k]).min()) * abs(float(mj.actuator_gainprm[k][0])) * gear
        else:
            continue
        if most > 0.0:
            found[joint] = found.get(joint, 0.0) + most
    for joint in range(mj.njnt):
        if mj.jnt_actfrclimited[joint]:
            most = float(np.abs(mj.jnt_actfrcrange[joint]).min())
            found[joint] = min(found.get(joint, np.inf), most)
    return found


def _add_followers(model: _Model, robot: etree._Element, notes: list[str]) -> None:
    """Let joints follow others where an equality of joints is a straight line."""
    mj = model.mj
    elements = {joint.get("name"): joint for joint in robot.findall("joint")}
    for k in range(mj.neq):
        if mj.eq_type[k] != JOINT_EQUALITY or not mj.eq_active0[k] or int(mj.eq_obj2id[k]) < 0:
            continue
        follower, leader = (model.joints[int(of[k])] for of in (mj.eq_obj1id, mj.eq_obj2id))
        if follower not in elements or leader not in elements:
            continue
        data = mj.eq_data[k]
        if np.any(data[2:5]):
            notes.append(f"joint '{follower}' follows '{leader}' by a curve, which is left out: it moves by itself")
            continue
        starts = [float(mj.qpos0[mj.jnt_qposadr[int(of[k])]]) for of in (mj.eq_obj1id, mj.eq_obj2id)]
        offset = starts[0] + float(data[0]) - float(data[1]) * starts[1]
        etree.SubElement(
            elements[follower], "mimic", joint=leader, multiplier=repr(float(data[1])), offset=repr(offset)
        )


def _list_left_out(model: _Model) -> Iterator[str]:
    """Yield a note on each kind of thing that the model has and a URDF cannot say."""
    mj = model.mj
    own = [joint for body in model.kept if body != model.free for joint in _list_body_joints(mj, body)]
    dofs = {joint: int(mj.jnt_dofadr[joint]) for joint in own}
    if sprung := [model.joints[joint] for joint in own if np.any(mj.jnt_stiffness[joint])]:
        yield f"springs of joints {', '.join(sprung)} are left out of their torques"
    if heavy := [model.joints[joint] for joint in own if mj.dof_armature[dofs[joint]] > 0.0]:
        yield f"inertias of rotors (armature) of joints {', '.join(heavy)} are left out of their torques"
    if lifted := [model.bodies[body] for body in model.kept if mj.body_gravcomp[body]]:
        yield f"weight that the model takes off bodies {', '.join(lifted)} (gravcomp) counts in full"
    if not np.allclose(mj.opt.gravity, EARTH, rtol=0.0, atol=GRAVITY_ROUNDING):
        yield f"the model's gravity, {format_numbers(mj.opt.gravity)} m/s^2, is not used; that of the earth along -z is"
    if mj.ntendon:
        yield "tendons are left out: joints that they couple move by themselves, and their forces are in no torque"
    for k in range(mj.neq):
        if mj.eq_type[k] == JOINT_EQUALITY and mj.eq_active0[k] and int(mj.eq_obj2id[k]) < 0:
            name = model.joints[int(mj.eq_obj1id[k])]
            yield f"joint '{name}' is held in its place by an equality, which is left out; robot.locked fixes it"
    odd = [model.bodies[body] for body in model.kept if any(mj.geom_type[g] in ODD for g in _list_geoms(mj, body))]
    if odd:
        yield f"planes, fields and sdf shapes of bodies {', '.join(odd)} are left out; nothing keeps clear of them"
    if mj.nflex or mj.nskin:
        yield "soft bodies (flex, skin) are left out; nothing keeps clear of them"
    if model.free is not None and any(_make_shape(mj, geom) is not None for geom in _list_geoms(mj, 0)):
        yield "shapes of the model's world are left out; put them into the scene"


def _write_postures(model: _Model) -> str:
    """Write the model's keyframes as postures of an SRDF."""
    mj = model.mj
    own = [joint for body in model.kept if body != model.free for joint in _list_body_joints(mj, body)]
    followers = {int(mj.eq_obj1id[k]) for k in range(mj.neq) if mj.eq_type[k] == JOINT_EQUALITY}
    names = [name for k in range(mj.nkey) if (name := mj.key(k).name)]
    if not names or not own:
        return ""
    srdf = etree.Element("robot", name=model.name)
    group = etree.SubElement(srdf, "group", name="all")
    moving = [joint for joint in own if joint not in followers]
    for joint in moving:
        etree.SubElement(group, "joint", name=model.joints[joint])
    for name in names:
        state = etree.SubElement(srdf, "group_state", name=name, group="all")
        q = mj.key(name).qpos
        for joint in moving:
            value = repr(float(q[mj.jnt_qposadr[joint]]))
            etree.SubElement(state, "joint", name=model.joints[joint], value=value)
        if model.free is not None:
            _add_free_base(model, q, srdf, state)
    return str(etree.tostring(srdf, encoding="unicode"))


def _add_free_base(model: _Model, q: np.ndarray, srdf: etree._Element, state: etree._Element) -> None:
    """Add the place of a floating base to a posture."""
    if srdf.find("virtual_joint") is None:
        base = {"name": "root_joint", "type": "floating", "parent_frame": WORLD}
        srdf.insert(0, etree.Element("virtual_joint", {**base, "child_link": model.bodies[model.free or 0]}))
    first = int(model.mj.jnt_qposadr[_list_body_joints(model.mj, model.free or 0)[0]])
    place = q[first : first + 7]
    values = np.concatenate([place[:3], place[[4, 5, 6, 3]]])  # x y z qx qy qz qw
    etree.SubElement(state, "joint", name="root_joint", value=format_numbers(values))
