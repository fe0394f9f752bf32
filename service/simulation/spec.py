"""The parts of a physics model: bodies, shapes, joints, servos and equalities of a motion as MuJoCo's specification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotHand, RobotModel, read_joint_axis
from costs.robot.carried import MovableObject
from service.demands.moved_object.assumed import assume_inertia, measure_volume
from service.demands.resistance import MechanismPhysics
from service.demands.stance import UNSETTLED
from service.errors import ResultError
from service.simulation.hulls import find_level_top, shrink_hull
from service.simulation.options import SimulationOptions
from service.simulation.perturb import Perturbation
from service.verify import Motion, find_mechanism_joints, measure_rests, place_resting, split_motion

TIME_STEP_S = 1e-3
ARMATURE = 0.1  # of a joint of a robot of the reference mass [kg m^2]
REFERENCE_MASS = 160.0  # of Atlas [kg]
MECHANISM_ARMATURE = 0.01  # [kg m^2, kg]
# Of the world's surfaces: with MuJoCo's defaults the feet turn in the floor almost as easily as the robot tips.
STIFF: Mapping[str, list[float]] = {"solref": [0.005, 1.0], "solimp": [0.95, 0.99, 0.001, 0.5, 2.0]}
# Of the mechanism's surfaces: MuJoCo scales the stiffness of a contact by the lighter body's mass, and a hand of 40 N
# would sink 10 mm into a bar of 60 g with its defaults.
HARD: Mapping[str, list[float]] = {"solref": [0.005, 1.0], "solimp": [0.99, 0.999, 0.001, 0.5, 2.0]}
SELF_FRICTION = 0.5  # between links of the robot
HAND_FRICTION = 0.3  # between a hand and a mechanism, where no request says it
LEAST_MASS, LEAST_INERTIA = 1e-3, 1e-6  # of a link without mass [kg, kg m^2]
LEAST_VOLUME = 1e-9  # of a hull that gets a shape [m^3]
CUT_M = 0.01  # depth in a piece from which on a link is taken to cut it, not to touch it [m]
IMU = "imu"
SPOKE = "/spoke/"  # in the names of a wheel's bodies
SPOKE_SIZE = (0.01, 0.05, 0.03)  # of an assumed spoke: across, along the radius, along the axis [m]
SPOKE_APART = 0.01  # nearer places of loads share an assumed spoke [m]
PEG_RADIUS = RobotHand.peg_radius + 5e-4  # from a peg's middle to what it presses [m]
PATCH_ARM_M = 5e-3  # mean distance of a pad's patch from its middle, which resists torsion [m]
BOX_CORNERS = 8
BASE = "base"  # the joint of a floating base


@dataclass(frozen=True)
class Follower:
    """Joint that follows another one: ``value = offset + ratio * leader``.

    Attributes:
        joint, leader: names.
        column: of the leader in a configuration of the plan.
        ratio, offset: [rad/rad], [rad] or the like for prismatic joints.
    """

    joint: str
    leader: str
    column: int
    ratio: float
    offset: float


class SpecBuilder:
    """MjSpec of a motion, part by part."""

    def __init__(
        self,
        mujoco: Any,
        motion: Motion,
        physics: MechanismPhysics,
        options: SimulationOptions,
        perturbation: Perturbation,
    ) -> None:
        self.mujoco, self.motion, self.robot = mujoco, motion, motion.robot
        self.physics, self.options, self.perturbation = physics, options, perturbation
        self.spec = mujoco.MjSpec()
        self.spec.compiler.balanceinertia = True
        self.spec.compiler.degree = False
        self.spec.option.timestep = TIME_STEP_S
        self.spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        self.spec.option.impratio = 10.0
        self.apart = find_mechanism_joints(motion)
        self.owner_of_geom: dict[str, tuple[str, str]] = {}
        self.body_of_link: dict[str, str] = {}
        model: pin.Model = self.robot.model
        self.moved_columns = [int(model.joints[j].idx_q) for j in range(1, model.njoints) if j in self.apart]
        mass = sum(float(model.inertias[j].mass) for j in range(1, model.njoints) if j not in self.apart)
        self.armature = ARMATURE * mass / REFERENCE_MASS
        self.base_link = ""

    def add_world(self) -> None:
        """Add the pieces of the scene: level floors as planes, others as hulls."""
        floors = [find_level_top(piece.vertices) for piece in self.motion.scene.pieces if piece.kind == "floor"]
        tops = [top for top in floors if top is not None]
        for piece in self.motion.scene.pieces:
            top = find_level_top(piece.vertices) if piece.kind == "floor" else None
            moved = self.perturbation.places[piece.name]
            if top is not None and top <= min(tops) + 1e-9:
                middle = piece.vertices.mean(axis=0)
                self._add_geom(
                    self.spec.worldbody,
                    piece.name,
                    ("world", piece.name),
                    type=self.mujoco.mjtGeom.mjGEOM_PLANE,
                    size=[*(0.5 * np.ptp(piece.vertices[:, :2], axis=0)), 1.0],
                    pos=[middle[0] + moved[0], middle[1] + moved[1], top + moved[2]],
                )
            else:
                holder = self.spec.worldbody
                if any(piece.name == cut for _, cut in self.cut_pairs):  # only bodies can be left out of contacts
                    holder = holder.add_body(name=f"piece:{piece.name}")
                self._add_hull(holder, piece.name, ("world", piece.name), piece.vertices + moved)

    def add_objects(self) -> None:
        """Add what hands carry as free bodies at their start, on what they rest on."""
        if not self.motion.objects:
            return
        # Hulls touch at several points by default from MuJoCo 4 on; nothing rests on a single one.
        several = getattr(self.mujoco.mjtEnableBit, "mjENBL_MULTICCD", None)
        if several is not None:
            self.spec.option.enableflags |= int(several)
        places = dict(self.perturbation.places)
        for item in sorted(self.motion.objects, key=lambda own: float(own.start[2, 3])):  # what carries others first
            names = self.supports.get(item.name, ())
            moved = np.mean([places[name] for name in names if name in places] or [np.zeros(3)], axis=0)
            places[item.name] = moved
            body = self.spec.worldbody.add_body(
                name=f"object:{item.name}", pos=item.start[:3, 3] + moved, quat=_quaternion(item.start[:3, :3])
            )
            body.explicitinertial = True
            _set_inertia(body, item.inertia.mass, item.inertia.centre, item.inertia.moments)
            body.add_freejoint(name=f"object:{item.name}")
            self._add_shape(body, item)

    @cached_property
    def supports(self) -> dict[str, tuple[str, ...]]:
        """On what each object rests at the start that no hand holds then: pieces and other objects."""
        if not self.motion.objects:
            return {}
        first = split_motion(self.motion)[0]
        carried = {carrier.item for carrier in first.phases[0].carriers if carrier.link is not None}
        resting = [place_resting(first.robot, item) for item in self.motion.objects if item.name not in carried]
        return {name: rest.names for name, rest in measure_rests(resting, self.motion.scene.pieces).items()}

    def _add_shape(self, body: Any, item: MovableObject) -> None:
        """Add the shape of an object: a round one as it is, others as hulls."""
        owner, kind = ("object", item.name), self.mujoco.mjtGeom
        if item.exact is not None and item.exact.kind == "cylinder":
            size = [item.exact.radius, 0.5 * item.exact.length, 0.0]
            pose = item.exact.pose
            self._add_geom(
                body, item.name, owner, type=kind.mjGEOM_CYLINDER, size=size, pos=pose[:3, 3],
                quat=_quaternion(pose[:3, :3]),
            )  # fmt: skip
            return
        low, high = item.vertices.min(axis=0), item.vertices.max(axis=0)
        on_corner = np.isclose(item.vertices, low) | np.isclose(item.vertices, high)
        if len(item.vertices) == BOX_CORNERS and on_corner.all():
            self._add_geom(
                body, item.name, owner, type=kind.mjGEOM_BOX, size=0.5 * (high - low), pos=0.5 * (low + high)
            )
            return
        self._add_hull(body, item.name, owner, item.vertices)

    def add_joints(self) -> None:
        """Add a body per joint of robot and mechanism, with its inertia, and a body per link with its shapes."""
        model: pin.Model = self.robot.model
        sways = bool(self.motion.sway)
        fixed = self.spec.worldbody.add_body(name="joint:fixed", mocap=sways)  # a base that is moved from outside
        bodies = {0: fixed if sways else self.spec.worldbody}
        for joint in range(1, model.njoints):
            place = model.jointPlacements[joint]
            parent = bodies[int(model.parents[joint])]
            body = parent.add_body(
                name=f"joint:{model.names[joint]}", pos=np.array(place.translation), quat=_quaternion(place.rotation)
            )
            bodies[joint] = body
            is_moved = joint in self.apart
            self._add_inertia(body, joint, is_moved)
            if self.robot.is_floating and joint == 1:
                body.add_freejoint(name=BASE)
            else:
                self._add_joint(body, joint, is_moved)
        carried: dict[str, Any] = {}
        for link_body in self.robot.bodies:
            holder = fixed if link_body.joint == 0 else bodies[link_body.joint]
            is_moved = link_body.link in self.robot.mechanism_links
            if link_body.link not in carried:
                carried[link_body.link] = holder.add_body(name=f"link:{link_body.link}")
                self.body_of_link[link_body.link] = f"link:{link_body.link}"
            vertices = link_body.vertices
            if is_moved:
                vertices = shrink_hull(vertices, self.physics.growth_m)
            owner = ("mechanism" if is_moved else "robot", link_body.link)
            self._add_hull(carried[link_body.link], link_body.name, owner, vertices)
        self._add_assumed_spokes(bodies)
        bare = next((c.link for p in self.motion.phases for c in p.contacts if c.link not in carried), None)
        if bare is not None:
            raise ResultError(f"the plan plants '{bare}', which has no shape that could carry force")
        base = bodies[1] if self.robot.is_floating else fixed
        base.add_site(name=IMU)
        for name, kind in (("gyro", "mjSENS_GYRO"), ("accelerometer", "mjSENS_ACCELEROMETER")):
            self.spec.add_sensor(
                name=name,
                type=getattr(self.mujoco.mjtSensor, kind),
                objtype=self.mujoco.mjtObj.mjOBJ_SITE,
                objname=IMU,
            )
        at_base = [body.link for body in self.robot.bodies if body.joint == (1 if self.robot.is_floating else 0)]
        self.base_link = at_base[0] if at_base else ""

    @cached_property
    def cut_pairs(self) -> frozenset[tuple[str, str]]:
        """Links and the pieces into which the plan lets them deeper than what touches: they pass through these.

        What an object rests on at first holds it up: it does not pass through that.
        """
        phases = [phase for phase in self.motion.phases if phase.name not in UNSETTLED]
        planted = {contact.link for phase in phases for contact in phase.contacts}
        pairs = set()
        for own in (own for phase in phases for own in phase.allowances if own.depth > CUT_M):
            links = {ref.link for ref in (own.first, own.second) if ref.link is not None} - planted
            pieces = {ref.body for ref in (own.first, own.second) if ref.owner == "scene" and ref.body is not None}
            pairs |= set(product(links, pieces))
        return frozenset((link, piece) for link, piece in pairs if piece not in self.supports.get(link, ()))

    def exclude_pairs(self) -> None:
        """Exclude the pairs of links that the robot's description leaves out, and what the plan cuts."""
        for first, second in sorted(self.robot.ignored_pairs):
            if first in self.body_of_link and second in self.body_of_link:
                self.spec.add_exclude(bodyname1=self.body_of_link[first], bodyname2=self.body_of_link[second])
        objects = {item.name: f"object:{item.name}" for item in self.motion.objects}
        for link, piece in sorted(self.cut_pairs):
            cutter = objects.get(link, self.body_of_link.get(link))
            if cutter is not None and self.spec.body(f"piece:{piece}") is not None:
                self.spec.add_exclude(bodyname1=cutter, bodyname2=f"piece:{piece}")

    def add_servos(
        self,
        names: tuple[str, ...],
        kp: Float[np.ndarray, "k"],
        kd: Float[np.ndarray, "k"],
        effort: Float[np.ndarray, "k"],
    ) -> None:
        """Add an actuator per joint: ``ctrl - kp q - kd qd``, within the effort."""
        for name, p, d, most in zip(names, kp, kd, effort, strict=True):
            actuator = self.spec.add_actuator(
                name=name,
                target=name,
                trntype=self.mujoco.mjtTrn.mjTRN_JOINT,
                gaintype=self.mujoco.mjtGain.mjGAIN_FIXED,
                biastype=self.mujoco.mjtBias.mjBIAS_AFFINE,
                forcerange=[-float(most), float(most)],
                forcelimited=True,
            )
            actuator.gainprm[0] = 1.0
            actuator.biasprm[:3] = [0.0, -float(p), -float(d)]

    def add_latches(self) -> tuple[int, ...]:
        """Add an equality per release that holds its joint at 0; return their indices."""
        for release in self.motion.releases:
            equality = self.spec.add_equality(
                type=self.mujoco.mjtEq.mjEQ_JOINT, name1=release.joint, objtype=self.mujoco.mjtObj.mjOBJ_JOINT
            )
            equality.data[:5] = 0.0
        return tuple(range(len(self.motion.releases)))

    def add_grips(self) -> list[list[tuple[int, Float[np.ndarray, "6"]]]]:
        """Add an equality per load of a closed gripper; return per phase their indices and anchors in both bodies."""
        phases: list[list[tuple[int, np.ndarray]]] = [[] for _ in self.motion.phases]
        if not self.physics.is_gripped:
            return phases
        index, model = len(self.motion.releases), self.robot.model
        for phase, grips in zip(self.motion.phases, phases, strict=True):
            for load in phase.loads:
                tool, link = (model.frames[model.getFrameId(name)] for name in (load.tool, load.link))
                anchors = np.concatenate([tool.placement.translation, link.placement.act(load.place)])
                self.spec.add_equality(
                    type=self.mujoco.mjtEq.mjEQ_CONNECT,
                    objtype=self.mujoco.mjtObj.mjOBJ_BODY,
                    name1=f"joint:{model.names[tool.parentJoint]}",
                    name2=f"joint:{model.names[link.parentJoint]}",
                    active=False,
                )
                grips.append((index, anchors))
                index += 1
        return phases

    def add_followers(self) -> tuple[Follower, ...]:
        """Add an equality per joint that follows another one: ``value = offset + ratio * leader``."""
        followers = tuple(_list_followers(self.robot))
        for follower in followers:
            equality = self.spec.add_equality(
                type=self.mujoco.mjtEq.mjEQ_JOINT,
                name1=follower.joint,
                name2=follower.leader,
                objtype=self.mujoco.mjtObj.mjOBJ_JOINT,
                **STIFF,
            )
            equality.data[:5] = [follower.offset, follower.ratio, 0.0, 0.0, 0.0]
        return followers

    def _add_assumed_spokes(self, bodies: Mapping[int, Any]) -> None:
        """Add the spokes that a peg presses where the record shows none: a thin box before each place of a load."""
        if not self.physics.has_assumed_spokes or any(SPOKE in body.name for body in self.robot.bodies):
            return
        model = self.robot.model
        places: list[np.ndarray] = []
        for load in (load for phase in self.motion.phases for load in phase.loads):
            if any(np.linalg.norm(load.place - place) < SPOKE_APART for place in places):
                continue
            places.append(load.place)
            frame = model.frames[model.getFrameId(load.link)]
            push = load.force / np.linalg.norm(load.force)
            axis = read_joint_axis(self.robot, int(frame.parentJoint))[3:]
            along = np.cross(axis, push)
            middle = load.place + (PEG_RADIUS + 0.5 * SPOKE_SIZE[0]) * push
            name = f"assumed spoke {len(places)}"
            self._add_geom(
                bodies[int(frame.parentJoint)],
                name,
                ("mechanism", load.link),
                type=self.mujoco.mjtGeom.mjGEOM_BOX,
                size=[0.5 * side for side in SPOKE_SIZE],
                pos=middle,
                quat=_quaternion(np.column_stack([push, along / np.linalg.norm(along), axis])),
            )

    def _add_inertia(self, body: Any, joint: int, is_moved: bool) -> None:
        body.explicitinertial = True
        known = self.physics.inertias.get(str(self.robot.model.names[joint])) if is_moved else None
        if known is not None:
            _set_inertia(body, known.mass, known.centre, known.moments)
            return
        if is_moved:
            assumed = assume_inertia([b.vertices for b in self.robot.bodies if b.joint == joint])
            _set_inertia(body, assumed.mass, assumed.centre, assumed.moments)
            body.gravcomp = 1.0  # the request's loads are all that a mechanism opposes
            return
        inertia = self.robot.model.inertias[joint]
        factor = self.perturbation.masses[joint]
        moments = factor * np.array(inertia.inertia)
        _set_inertia(body, factor * float(inertia.mass), np.array(inertia.lever), moments)

    def _add_joint(self, body: Any, joint: int, is_moved: bool) -> None:
        model = self.robot.model
        name = str(model.names[joint])
        column = int(model.joints[joint].idx_q)
        axis, is_follower = read_joint_axis(self.robot, joint), _is_follower(self.robot, joint)
        if is_follower:  # its axis comes multiplied by its ratio
            axis = axis / float(model.joints[joint].extract().scaling)
        is_turning = bool(np.any(axis[3:]))
        kind = self.mujoco.mjtJoint
        low, high = float(self.robot.lower[column]), float(self.robot.upper[column])
        limited = not is_follower and bool(np.isfinite([low, high]).all())
        made = body.add_joint(
            name=name,
            type=kind.mjJNT_HINGE if is_turning else kind.mjJNT_SLIDE,
            axis=axis[3:] if is_turning else axis[:3],
            limited=limited,
            range=[low, high] if limited else [0.0, 0.0],
        )
        if is_moved:
            made.armature = 0.0 if name in self.physics.inertias else MECHANISM_ARMATURE
            made.frictionloss = self._resist(name)
        else:
            made.armature = 0.0 if is_follower else self.armature
            made.frictionloss = 0.0 if is_follower else self.options.joint_friction * float(self.robot.effort[column])

    def _resist(self, name: str) -> float:
        resistance = self.physics.joints.get(name)
        return 0.0 if resistance is None else resistance.friction

    def _add_hull(self, body: Any, name: str, owner: tuple[str, str], vertices: Float[np.ndarray, "V 3"]) -> None:
        if measure_volume(vertices) < LEAST_VOLUME:
            return
        mesh = self.spec.add_mesh(name=f"mesh:{name}")
        mesh.uservert = np.asarray(vertices, dtype=float).ravel()
        self._add_geom(body, name, owner, type=self.mujoco.mjtGeom.mjGEOM_MESH, meshname=f"mesh:{name}")

    def _add_geom(self, body: Any, name: str, owner: tuple[str, str], **fields: Any) -> None:
        kind = owner[0]
        of_world = max(self.options.friction + self.perturbation.friction, 0.0)
        of_hand = HAND_FRICTION if self.options.hand_friction is None else self.options.hand_friction
        friction = {"robot": SELF_FRICTION, "mechanism": of_hand, "world": of_world, "object": of_hand}[kind]
        # A patch of a pad resists torsion with the least friction of hands.
        torsion = PATCH_ARM_M * friction if kind == "object" else 0.005
        body.add_geom(
            name=f"{kind}:{name}",
            contype=1 if kind in ("robot", "object") else 0,
            conaffinity=1,
            priority={"robot": 0, "object": 2}.get(kind, 1),
            friction=[friction, torsion, 1e-4],
            density=0.0,
            condim=4 if kind == "object" else 3,
            # A held object lets go for a moment, again and again, where its surface gives way by micrometres only.
            **{"world": STIFF, "mechanism": HARD, "robot": {}, "object": STIFF}[kind],
            **fields,
        )
        self.owner_of_geom[f"{kind}:{name}"] = owner


def _is_follower(robot: RobotModel, joint: int) -> bool:
    return bool(robot.model.joints[joint].shortname() == "JointModelMimic")


def _list_followers(robot: RobotModel) -> list[Follower]:
    """Return the joints that follow another one (URDF's ``mimic``)."""
    followers = []
    for joint in range(1, robot.model.njoints):
        if _is_follower(robot, joint):
            made = robot.model.joints[joint]
            own, column = made.extract(), int(made.idx_q)
            leader = robot.joint_names[column]
            name = str(robot.model.names[joint])
            followers.append(Follower(name, leader, column, float(own.scaling), float(own.offset)))
    return followers


def _set_inertia(body: Any, mass: float, centre: Float[np.ndarray, "3"], moments: Float[np.ndarray, "3 3"]) -> None:
    """Give a body its mass, with moments about the centre of mass along the body's axes."""
    body.mass, body.ipos = max(mass, LEAST_MASS), centre
    values, axes = np.linalg.eigh(moments)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    body.inertia = np.maximum(values, LEAST_INERTIA)
    body.iquat = _quaternion(axes)


def _quaternion(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4"]:
    """Return a rotation as (w, x, y, z)."""
    xyzw = pin.Quaternion(np.asarray(rotation)).coeffs()
    return np.array([xyzw[3], xyzw[0], xyzw[1], xyzw[2]])
