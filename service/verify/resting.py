"""Checks of single poses at rest: what a phase promises, held to one configuration after the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float, Int

from costs.curve import Curve, TimeLaw
from costs.robot import RobotModel
from costs.scene import Scene
from costs.work_space import borrow_data
from service.verify.certificate import Basis, Check, Where
from service.verify.clearance.pairs import PairTable, collect_pairs
from service.verify.forces.dynamics import compute_forces, find_limited_joints
from service.verify.ground import check_ground
from service.verify.motion import Motion, Phase, VerifySettings
from service.verify.polygons import describe_inside, outside_polygon
from service.verify.prepared_motion import ForwardKinematics, Placements, PreparedMotion
from service.verify.solids import CoalSolid, DistanceQuery
from service.verify.stance_checks import check_support
from service.verify.validation import validate_motion

_INSTANT_S = 1e-3  # length of the motion that stands for a pose
_TOUCH_M = 1e-6  # depth from which a pair that may not touch counts as in collision


@dataclass(frozen=True)
class PairDistance:
    """Distance of two bodies, or of body and piece.

    Attributes:
        names: of both.
        distance_m: signed; negative where they overlap [m].
        least_m: smallest distance that is allowed; negative where they may touch [m].
    """

    names: tuple[str, str]
    distance_m: float
    least_m: float

    @property
    def may_touch(self) -> bool:
        """Whether an allowance lets the two touch."""
        return self.least_m < 0.0


@dataclass(frozen=True)
class RestingPose:
    """The checks of one pose.

    Attributes:
        checks: of positions, planted links, balance, torques, ground and clearance.
        near: pairs within the horizon that were measured, the nearest to what is allowed first.
        balance_margin_m: distance of the centre of mass inside the edge of the support; None without a support [m].
        torque_share: largest share of a joint's torque limit; None where no joint has one.
        torque_joint: the joint that has it.
    """

    checks: tuple[Check, ...]
    near: tuple[PairDistance, ...]
    balance_margin_m: float | None
    torque_share: float | None
    torque_joint: str

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that fail."""
        return tuple(check for check in self.checks if not check.ok)

    @property
    def nearest(self) -> PairDistance | None:
        """The nearest pair that may not touch; None where all are beyond the horizon."""
        return min((pair for pair in self.near if not pair.may_touch), key=lambda pair: pair.distance_m, default=None)


class RestingPoses:
    """Checks of poses of one robot in one scene, which share a phase's promises; prepared once for all of them.

    Args:
        robot: the robot.
        scene: its surroundings.
        phase: planted links, support and allowances; targets, loads and regions do not belong to a pose at rest.
        q: (n,) a configuration of the robot [rad, m].
        clearance_m: demanded distance from pieces that may not be touched [m].
        padding: what links and pieces add to it, by name [m]; see ``Motion``.
        horizon_m: pairs beyond it are not measured [m].
        sight_m: all pairs that are at most so much nearer than allowed plus this are measured [m].

    Raises:
        VerifyError: the phase or the configuration is malformed.
    """

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        phase: Phase,
        q: Float[np.ndarray, "n"],
        clearance_m: float = 0.0,
        padding: Mapping[str, float] | None = None,
        horizon_m: float = 0.1,
        sight_m: float = 0.025,
    ) -> None:
        self._phase = replace(phase, first=0.0, last=1.0)
        self._clearance_m, self._padding = clearance_m, dict(padding or {})
        self._horizon_m, self._sight_m = horizon_m, sight_m
        self._robot, self._scene = robot, scene
        motion = self._stand(q)
        validate_motion(motion)
        prepared = PreparedMotion(motion)
        self._forward = ForwardKinematics(robot.model)
        self._table = collect_pairs(motion, prepared.tree)
        self._pieces = _PieceFaces.of(self._table)
        self._query = DistanceQuery()
        support = () if phase.support is None or not phase.contacts else (check_support(self._phase, phase.support),)
        self._standing = (*support, *check_ground(prepared, self._phase, VerifySettings()))

    def check(self, q: Float[np.ndarray, "n"]) -> RestingPose:
        """Check a pose.

        Raises:
            VerifyError: the configuration is not finite or has a wrong length.
        """
        placed = self._forward.at(q[None])
        checks = [self._check_positions(q), *self._check_planted(q), *self._standing]
        margin = self._measure_balance(q)
        if margin is not None and self._phase.support is not None:
            least = self._phase.support.margin_m
            text = f"the centre of mass is {describe_inside(margin)} the support polygon"
            checks.append(Check("balance.pose", margin >= least, margin, least, "m", text, None, Basis.PROOF))
        torque = self._check_torque(q)
        near = tuple(self._measure_pairs(placed))
        checks += [] if torque is None else [torque]
        checks += self._check_pairs(near)
        share = None if torque is None else torque.value
        joint = "" if torque is None or torque.where is None else torque.where.names[0]
        return RestingPose(tuple(checks), near, margin, share, joint)

    def _stand(self, q: Float[np.ndarray, "n"]) -> Motion:
        """Return the motion that stays at a pose for an instant."""
        curve = Curve(np.array([0.0, 1.0]), np.stack([q, q]), np.zeros((2, len(q))))
        law = TimeLaw(np.array([0.0, _INSTANT_S]), np.array([0.0, 1.0]), np.full(2, 1.0 / _INSTANT_S))
        return Motion(
            self._robot, self._scene, curve, law, (self._phase,), clearance_m=self._clearance_m, padding=self._padding
        )

    def _check_positions(self, q: Float[np.ndarray, "n"]) -> Check:
        excess = np.maximum(self._robot.lower - q, q - self._robot.upper)
        worst = int(excess.argmax())
        value, name = float(excess[worst]), self._robot.joint_names[worst]
        text = f"{name} is {abs(value):.4f} rad {'inside' if value <= 0.0 else 'beyond'} its limits"
        where = Where(0.0, None, None, (name,))
        return Check("limits.position", value <= 1e-9, value, 0.0, "rad", text, where, Basis.PROOF)

    def _check_planted(self, q: Float[np.ndarray, "n"]) -> Iterator[Check]:
        model = self._robot.model
        data = borrow_data(model)
        pin.framesForwardKinematics(model, data, q)
        for contact in self._phase.contacts:
            pose = data.oMf[model.getFrameId(contact.link)]
            places = contact.sole @ np.array(pose.rotation).T + np.array(pose.translation)
            value = float(np.linalg.norm(places - contact.points, axis=1).max())
            text = f"{contact.link} is {1e3 * value:.3f} mm from where it stands"
            where, limit = Where(0.0, None, None, (contact.link,)), contact.knot_tolerance_m
            yield Check(f"planted.pose.{contact.link}", value <= limit, value, limit, "m", text, where, Basis.PROOF)

    def _measure_balance(self, q: Float[np.ndarray, "n"]) -> float | None:
        if self._phase.support is None:
            return None
        model = self._robot.model
        centre = np.array(pin.centerOfMass(model, borrow_data(model), q))[None, :2]
        return -float(outside_polygon(self._phase.support.polygon, centre)[0])

    def _check_torque(self, q: Float[np.ndarray, "n"]) -> Check | None:
        motion = self._stand(q)
        limited = find_limited_joints(motion)
        if not len(limited) or motion.law is None:
            return None
        forces = compute_forces(motion, motion.law, self._phase, np.zeros(1))
        shares = forces.find_largest_torque()[0, limited] / self._robot.effort[limited]
        worst = int(shares.argmax())
        value, name = float(shares[worst]), self._robot.joint_names[limited[worst]]
        text = f"{name} needs {100.0 * value:.0f} % of its torque"
        where = Where(0.0, None, None, (name,))
        return Check("torque.pose", value <= 1.0, value, 1.0, "1", text, where, Basis.SAMPLES)

    def _check_pairs(self, near: tuple[PairDistance, ...]) -> list[Check]:
        failed = [pair for pair in near if pair.distance_m < pair.least_m - _TOUCH_M]
        if not failed:
            least = min((pair.distance_m for pair in near if not pair.may_touch), default=self._horizon_m)
            text = f"clearance is {1e3 * least:.1f} mm" + ("" if least < self._horizon_m else " or more")
            return [Check("clearance", True, least, 0.0, "m", text, None, Basis.PROOF)]
        return [
            Check("clearance", False, p.distance_m, p.least_m, "m", _describe_hit(p), Where(0.0, None, None, p.names),
                  Basis.PROOF)
            for p in failed
        ]  # fmt: skip

    def _measure_pairs(self, placed: Placements) -> Iterator[PairDistance]:
        """Measure the pairs that may be near each other, by a lower bound of their distances first."""
        table, pieces = self._table, self._pieces
        rotation, origin = placed.rotation[0], placed.translation[0]
        body_joint = table.joint[: table.n_bodies]
        centre = np.einsum("bij,bj->bi", rotation[body_joint], table.centre) + origin[body_joint]
        is_piece = table.holder >= table.n_bodies
        floor = np.empty(len(table.mover))
        own, other = table.mover[~is_piece], table.holder[~is_piece]
        apart = np.linalg.norm(centre[own] - centre[other], axis=1)
        floor[~is_piece] = apart - table.radius[own] - table.radius[other]
        outside = pieces.measure_outside(centre) - table.radius[:, None]
        floor[is_piece] = outside[table.mover[is_piece], table.holder[is_piece] - table.n_bodies]
        allowed = table.allowed[:, 0]
        least = np.where(np.isnan(allowed), table.demanded, -np.nan_to_num(allowed))
        found, nearest = [], self._horizon_m
        for row in np.argsort(floor, kind="stable").tolist():
            if floor[row] >= max(nearest, least[row] + self._sight_m):
                if floor[row] >= max(nearest, float(table.demanded.max()) + self._sight_m):
                    break
                continue
            mover, holder = table.solids[table.mover[row]], table.solids[table.holder[row]]
            turned, moved = placed.relative(holder.joint, mover.joint)
            distance = float(self._query.closest([mover.convex], turned, moved, [holder.convex])[0][0])
            if np.isnan(allowed[row]):
                nearest = min(nearest, distance)
            found.append(PairDistance(table.names(row), distance, float(least[row])))
        found.sort(key=lambda pair: pair.distance_m - pair.least_m)
        yield from (pair for pair in found if pair.distance_m < max(self._horizon_m, pair.least_m))


@dataclass(frozen=True)
class _PieceFaces:
    """Faces of all pieces, piece by piece: a point is as far from a piece as from its farthest face, or farther.

    Attributes:
        normals: (F, 3) outward.
        offsets: (F,) of the faces along their normals [m].
        first: (P,) index of each piece's first face.
    """

    normals: Float[np.ndarray, "F 3"]
    offsets: Float[np.ndarray, "F"]
    first: Int[np.ndarray, "P"]

    @staticmethod
    def of(table: PairTable) -> _PieceFaces:
        faces = [_list_faces(solid) for solid in table.solids[table.n_bodies :]]
        counts = [len(part) for part in faces]
        stacked = np.concatenate(faces) if faces else np.zeros((0, 4))
        return _PieceFaces(stacked[:, :3], stacked[:, 3], np.cumsum([0, *counts[:-1]]) if counts else np.zeros(0, int))

    def measure_outside(self, points: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "B P"]:
        """Return a lower bound of the distance of each point from each piece [m]."""
        if not len(self.first):
            return np.zeros((len(points), 0))
        return np.asarray(np.maximum.reduceat(points @ self.normals.T + self.offsets, self.first, axis=1))


def _list_faces(solid: CoalSolid) -> Float[np.ndarray, "F 4"]:
    """Return unit normals and offsets of planes with all of a solid on one side: its faces, else those of its box."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        return np.asarray(ConvexHull(solid.vertices).equations)
    except QhullError:
        low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
        axes = np.concatenate([np.eye(3), -np.eye(3)])
        return np.concatenate([axes, np.concatenate([-high, low])[:, None]], axis=1)


def _describe_hit(pair: PairDistance) -> str:
    first, second = pair.names
    if pair.may_touch:
        return f"{first} is {-1e3 * pair.distance_m:.1f} mm inside {second}, {-1e3 * pair.least_m:.1f} mm are allowed"
    if pair.distance_m < 0.0:
        return f"{first} is {-1e3 * pair.distance_m:.1f} mm inside {second}"
    return f"{first} comes within {1e3 * pair.distance_m:.1f} mm of {second}, {1e3 * pair.least_m:.1f} mm are demanded"
