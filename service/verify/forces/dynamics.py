"""Forces along the timed curve from full inverse dynamics, at samples: ZMP and joint torques."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float, Int

from costs.curve import TimeLaw
from costs.stopping import poll
from costs.work_space import borrow_data
from service.request.paces import PACES
from service.verify.carrying.sharing import share_weight
from service.verify.certificate import Basis, Check, Where
from service.verify.forces.contact_forces import ContactShare, Joints, list_unit_wrenches
from service.verify.forces.hand_loads import list_load_cases
from service.verify.forces.loaded_balance import GRAVITY, Ground, weigh
from service.verify.frame_paths import find_mechanism_joints
from service.verify.motion import Motion, Phase, SupportPolygon, VerifySettings
from service.verify.polygons import describe_inside, outside_polygon
from service.verify.prepared_motion import PreparedMotion
from service.verify.timeline import find_times

# A moment of 1 Nm counts as much as a force of 1 / 0.1 N when the ground's wrench is shared between the feet.
_MOMENT_ARM_M = 0.1
_MOST_KEPT = 8_000  # samples whose inverse dynamics are kept, some 2 kB each


@dataclass(frozen=True)
class Forces:
    """Inverse dynamics at ``S`` times, for ``K`` cases: hands without load, then every combination of full loads.

    Attributes:
        times, path: (S,) [s] and path parameter.
        wrench: (K, S, 6) force and moment about the world's origin that the ground exerts on the robot [N, Nm]; NaN in
            a phase that neither plants a link nor names a support.
        torque: (K, S, n) generalised forces; joints between planted feet and base with the ground's wrench shared at
            least norm between the feet, or under forces inside the cones of the contacts.
        missing_n: (K, S) force that the contacts lack, in phases whose contacts are not soles on a level; 0 elsewhere.
    """

    times: Float[np.ndarray, "S"]
    path: Float[np.ndarray, "S"]
    wrench: Float[np.ndarray, "K S 6"]
    torque: Float[np.ndarray, "K S n"]
    missing_n: Float[np.ndarray, "K S"]

    def zmp(self, height: float) -> Float[np.ndarray, "K S 2"]:
        """Return the zero moment point of the ground's forces on a horizontal plane [m]; NaN without vertical force."""
        fx, fy, fz, mx, my, _ = np.moveaxis(self.wrench, -1, 0)
        pressed = np.where(fz > 1e-6, fz, np.nan)
        return np.stack([(height * fx - my) / pressed, (height * fy + mx) / pressed], axis=-1)

    def find_worst_zmp(self, support: SupportPolygon) -> tuple[Float[np.ndarray, "S 2"], Float[np.ndarray, "S"]]:
        """Return at each sample the ZMP of the worst case, and its distance outside the polygon (inf: no force) [m]."""
        points = self.zmp(support.height)
        outside = outside_polygon(support.polygon, points.reshape(-1, 2)).reshape(points.shape[:2])
        outside = np.nan_to_num(outside, nan=np.inf)
        worst = outside.argmax(axis=0)
        each = np.arange(points.shape[1])
        return points[worst, each], outside[worst, each]

    def find_largest_torque(self) -> Float[np.ndarray, "S n"]:
        """Return the largest size of each joint's torque over the cases [Nm]; it is affine in each load."""
        return np.asarray(np.abs(self.torque).max(axis=0))


def list_sample_times(motion: Motion, law: TimeLaw, first: float, last: float, step: float) -> Float[np.ndarray, "S"]:
    """Return times between two path parameters: evenly spread, and both sides of every jump of the acceleration."""
    start, end = find_times(law, np.array([first, last])).tolist()
    even = np.linspace(start, end, max(2, int(np.ceil((end - start) / step)) + 1))
    knots = motion.curve.knots
    jumps = find_times(law, knots[(knots >= first) & (knots <= last)])
    grid = law.times[(law.times >= start) & (law.times <= end)]
    near = np.concatenate([grid, jumps])
    after, before = np.minimum(near + 1e-7, end), np.maximum(near - 1e-7, start)
    return np.unique(np.concatenate([even, after, before]))


def compute_forces(
    motion: Motion, law: TimeLaw, phase: Phase, times: Float[np.ndarray, "S"], *, torques: bool = True
) -> Forces:
    """Return wrench from the ground and joint torques at times of a phase (``torques=False``: wrench only)."""
    s, speed, gain = law.at(times)
    curve, model = motion.curve, motion.robot.model
    q, slope, bend = curve(s), curve(s, 1), curve(s, 2)
    v = slope * speed[:, None]
    a = slope * gain[:, None] + bend * speed[:, None] ** 2
    stands = bool(phase.contacts) or phase.support is not None
    shares = torques and bool(phase.contacts)
    is_loaded = torques and bool(phase.loads or any(len(carrier.grips) > 1 for carrier in phase.carriers))
    inverse = compute_inverse_dynamics(motion, q, v, a, has_jacobians=shares or is_loaded)
    torque, jacobians = inverse.torque, inverse.jacobians
    shared = share_weight(motion, phase, q, lambda j, w: _carried_torques(model, j, w, jacobians)) if torques else None
    torque = torque if shared is None else torque + shared
    wrench = inverse.wrench if stands else np.full((len(times), 6), np.nan)
    cases = list_load_cases(motion.robot, q, phase.loads)
    ground = np.stack([wrench - case.wrench for case in cases])
    each = np.stack([torque] * len(cases))
    missing = np.zeros(each.shape[:2])
    for k, (own, case, below) in enumerate(zip(each, cases, ground, strict=True)):
        for joint, part in case.parts if torques else ():
            own -= _carried_torques(model, joint, part, jacobians)
        if shares and phase.region_margin_m is not None:
            missing[k] = _share_in_cones(motion, phase, below, own, jacobians)
        elif shares:
            own -= _ground_torques(model, phase, below, jacobians)
    return Forces(times, s, ground, each, missing)


@dataclass(frozen=True)
class InverseDynamics:
    """Forces that a motion needs at ``S`` samples, before anything is known of contacts.

    Attributes:
        torque: (S, n) generalised forces of all coordinates.
        wrench: (S, 6) on the robot, about the world's origin [N, Nm].
        jacobians: (S, 6, n) of all joints, about the world's origin; (0, 6, n) where nobody needs them.
    """

    torque: Float[np.ndarray, "S n"]
    wrench: Float[np.ndarray, "S 6"]
    jacobians: Float[np.ndarray, "S 6 m"]


@dataclass(frozen=True)
class _Dynamics:
    """States of inverse dynamics, and the result; the model is kept, so that no other has its identity."""

    model: pin.Model
    choice: tuple[frozenset[int], bool]
    states: tuple[Float[np.ndarray, "S n"], ...]
    inverse: InverseDynamics


class _Latest(threading.local):
    """The latest inverse dynamics of a thread: as many as have ``_MOST_KEPT`` samples."""

    def __init__(self) -> None:
        self.known: list[_Dynamics] = []

    def add(self, known: _Dynamics) -> None:
        """Keep one more, and drop the oldest where there are too many samples."""
        self.known.insert(0, known)
        counts = np.cumsum([len(each.inverse.torque) for each in self.known])
        del self.known[max(1, int(np.searchsorted(counts, _MOST_KEPT, side="right"))) :]


_LATEST = _Latest()


def compute_inverse_dynamics(
    motion: Motion,
    q: Float[np.ndarray, "S n"],
    v: Float[np.ndarray, "S n"],
    a: Float[np.ndarray, "S n"],
    *,
    has_jacobians: bool = True,
) -> InverseDynamics:
    """Return the forces of a motion at given states; the latest are kept: a law is timed by them, phase by phase."""
    model: pin.Model = motion.robot.model
    data = borrow_data(model)
    apart = find_mechanism_joints(motion)
    states, choice = (q, v, a), (apart, has_jacobians)
    for known in _LATEST.known:
        if known.model is model and known.choice == choice and all(map(np.array_equal, known.states, states)):
            return known.inverse
    roots = [j for j in range(1, model.njoints) if int(model.parents[j]) == 0 and j not in apart]
    torque, wrench = np.empty((len(q), model.nv)), np.zeros((len(q), 6))
    jacobians = np.empty((len(q) if has_jacobians else 0, 6, model.nvExtended))
    for k in range(len(q)):
        poll()
        if has_jacobians:
            jacobians[k] = pin.computeJointJacobians(model, data, q[k]).reshape(6, model.nvExtended)
        torque[k] = pin.rnea(model, data, q[k], v[k], a[k])
        for joint in roots:
            # The parent of a root is the world, so its placement in its parent is the one in the world.
            wrench[k] += data.liMi[joint].act(data.f[joint]).vector
    for array in (torque, wrench, jacobians):
        array.flags.writeable = False
    inverse = InverseDynamics(torque, wrench, jacobians)
    if len(q):
        _LATEST.add(_Dynamics(model, choice, (q.copy(), v.copy(), a.copy()), inverse))
    return inverse


def _share_in_cones(
    motion: Motion,
    phase: Phase,
    wrench: Float[np.ndarray, "S 6"],
    torque: Float[np.ndarray, "S n"],
    jacobians: Float[np.ndarray, "S 6 m"],
) -> Float[np.ndarray, "S"]:
    """Take the torques of contact forces off ``torque``; return the force that the contacts lack [N]."""
    levers = list_levers(motion.robot.model, phase, jacobians)
    joints = make_joints(motion, torque, levers)
    held = make_contact_share(motion, phase).hold(wrench, joints)
    torque -= np.einsum("skc,sc->sk", levers, held.forces.reshape(len(wrench), -1))
    return held.missing_n


def make_contact_share(motion: Motion, phase: Phase) -> ContactShare:
    """Return the contacts of a phase as a whole that carries wrenches."""
    return ContactShare(Ground.within_tilt(phase.contacts), weigh(motion) * GRAVITY)


def make_joints(motion: Motion, torque: Float[np.ndarray, "S n"], levers: Float[np.ndarray, "S n 3C"]) -> Joints:
    """Return the limited joints, given the torques and levers of all coordinates."""
    limited = find_limited_joints(motion)
    return Joints(torque[:, limited], levers[:, limited], motion.robot.effort[limited])


def list_levers(model: pin.Model, phase: Phase, jacobians: Float[np.ndarray, "S 6 m"]) -> Float[np.ndarray, "S n 3C"]:
    """Return the generalised forces of unit forces at a phase's contact points, in world axes."""
    parts = []
    for contact in phase.contacts:
        joint = int(model.frames[model.getFrameId(contact.link)].parentJoint)
        axes = map_axes(model, joint).T
        parts.append(axes @ (np.swapaxes(jacobians, 1, 2) @ list_unit_wrenches(contact.points)))
    return np.concatenate(parts, axis=2)


def find_limited_joints(motion: Motion) -> Int[np.ndarray, "k"]:
    """Return the coordinates with a torque limit."""
    return np.flatnonzero(np.isfinite(motion.robot.effort) & (motion.robot.effort > 0.0))


def _ground_torques(
    model: pin.Model, phase: Phase, wrench: Float[np.ndarray, "S 6"], jacobians: Float[np.ndarray, "S 6 m"]
) -> Float[np.ndarray, "S n"]:
    """Return the joint torques of the ground's wrench, shared at least norm between the planted links.

    Column j of a Jacobian is the velocity that coordinate j gives what it carries, about the world's origin.
    """
    share = _share_map([contact.pose_world_link[:3, 3] for contact in phase.contacts])
    torque = np.zeros((len(wrench), model.nv))
    for contact, part in zip(phase.contacts, share.reshape(-1, 6, 6), strict=True):
        joint = int(model.frames[model.getFrameId(contact.link)].parentJoint)
        torque += _carried_torques(model, joint, wrench @ part.T, jacobians)
    return torque


def _carried_torques(
    model: pin.Model, joint: int, wrench: Float[np.ndarray, "S 6"], jacobians: Float[np.ndarray, "S 6 m"]
) -> Float[np.ndarray, "S n"]:
    """Return the generalised forces of a wrench on what a joint carries, about the world's origin."""
    return np.asarray(np.matmul(wrench[:, None], jacobians)[:, 0] @ map_axes(model, joint))


def map_axes(model: pin.Model, joint: int) -> Float[np.ndarray, "m n"]:
    """Return the map from torques about all axes to those of the coordinates, of the axes that carry a joint alone.

    There is an axis per coordinate and one per joint that follows another (``mimic``).
    """
    carried = np.zeros((model.nvExtended, model.nv))
    for above in list(model.supports[joint])[1:]:
        made = model.joints[above]
        for k in range(made.nvExtended):
            carried[made.idx_vExtended + k, made.idx_v + k] = 1.0
    return carried


def check_dynamics(prepared: PreparedMotion, phase: Phase, settings: VerifySettings) -> Iterator[Check]:
    """Check that the ZMP is inside the support polygon and torques are within limits, at samples."""
    motion, law = prepared.motion, prepared.motion.law
    if law is None:
        return
    times = list_sample_times(motion, law, phase.first, phase.last, settings.time_step_s)
    dynamics = compute_forces(motion, law, phase, times)
    pace = None if motion.pace is None else PACES[motion.pace]
    if phase.support is not None:
        zmp, outside = dynamics.find_worst_zmp(phase.support)
        worst = int(outside.argmax())
        value, least = -float(outside[worst]), 0.0 if pace is None else pace.zmp_inside_m
        point = (float(zmp[worst, 0]), float(zmp[worst, 1]), phase.support.height)
        where = Where(float(dynamics.path[worst]), float(times[worst]), point)
        verb = "stays" if value >= 0.0 else "is"
        text = f"the ZMP {verb} {describe_inside(value)} the feet during {phase.name} ({len(times)} samples)"
        text += f"; the pace {motion.pace} asks for {1e3 * least:.0f} mm" if value < least else ""
        yield Check(f"zmp.{phase.name}", value >= least, value, least, "m", text, where, Basis.SAMPLES)
    if phase.region_margin_m is not None:
        yield _forces_check(phase, dynamics)
    limited = find_limited_joints(motion)
    if len(limited):
        ratio = dynamics.find_largest_torque()[:, limited] / motion.robot.effort[limited]
        row, column = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        value, most = float(ratio[row, column]), 1.0 if pace is None else pace.torque_share
        name = motion.robot.joint_names[limited[column]]
        where = Where(float(dynamics.path[row]), float(times[row]), None, (name,))
        text = f"{name} needs {100.0 * value:.0f} % of its torque during {phase.name} ({len(times)} samples)"
        text += f"; the pace {motion.pace} allows {100.0 * most:.0f} %" if value > most < 1.0 else ""
        yield Check(f"torque.{phase.name}", value <= most, value, most, "1", text, where, Basis.SAMPLES)


def _forces_check(phase: Phase, dynamics: Forces) -> Check:
    """Check that forces inside friction and caps make the wrench of the motion at all samples."""
    missing = dynamics.missing_n.max(axis=0)
    worst = int(missing.argmax())
    value = float(missing[worst])
    where = Where(float(dynamics.path[worst]), float(dynamics.times[worst]), None)
    text = f"forces inside friction and caps carry the motion during {phase.name} ({len(missing)} samples)"
    if value > 0.0:
        text = f"the contacts lack {value:.1f} N to carry the motion during {phase.name}"
    return Check(f"forces.{phase.name}", value <= 0.0, value, 0.0, "N", text, where, Basis.SAMPLES)


def _share_map(positions: list[np.ndarray]) -> Float[np.ndarray, "6F 6"]:
    """Return the map from a wrench to its least-norm share per foot, all about the origin, in world axes."""
    scale = np.array([1.0, 1.0, 1.0, _MOMENT_ARM_M, _MOMENT_ARM_M, _MOMENT_ARM_M])
    shifts = []
    for x, y, z in positions:
        shift = np.eye(6)
        shift[3:, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
        shifts.append(shift * scale)
    local = np.linalg.pinv(np.hstack(shifts)).reshape(len(positions), 6, 6)
    return np.concatenate([shift @ part for shift, part in zip(shifts, local, strict=True)])
