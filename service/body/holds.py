"""Holds: residuals kept at zero along a motion (planted feet, kept poses), and projection onto them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from costs.collision import Contacts
from costs.kinematics import KinematicsEngine, locate_frame, locate_links
from costs.robot import RobotModel
from costs.state import MotionState
from costs.stopping import poll
from costs.terms import AxisDirection, FramePose
from scopt import Constraint, Residual, Sense
from service.demands.targets import find_free_axis, make_kept_pose
from service.errors import RequestError
from service.request.schema import KeepRequest
from service.verify import RelativePoseTarget

Hold = Callable[[Int[np.ndarray, "S"]], Residual[MotionState]]
"""Makes the residual that a hold keeps at zero at the given waypoints."""

DRIFT = 5e-4  # between waypoints, of what is held [m, rad]
PROJECTION_STEPS = 8
PROJECTION_TOLERANCE = 1e-9  # [m, rad]
AT_WAYPOINTS = 1e-4  # per row, of the optimiser; the spline's projection does the rest [m, rad]
START_SHARE = 0.5  # of the tolerances may be used up at the start, the rest is for the curve
DRIFT_SHARE = 0.25  # of the tolerances may a row drift between waypoints


def linearize_holds(
    engine: KinematicsEngine, q: Float[np.ndarray, "S n"], holds: Sequence[Hold]
) -> tuple[Float[np.ndarray, "S k"], Float[np.ndarray, "S k n"]]:
    """Residuals and Jacobians of all holds at separate configurations."""
    poll()
    state = MotionState(engine(q), Contacts.none())
    everywhere = np.arange(len(q))
    n = q.shape[1]
    values, jacobians = [], []
    for hold in holds:
        rows = hold(everywhere).linearize(state)
        k = len(rows.value) // len(q)
        values.append(rows.value.reshape(len(q), k))
        # A row touches the columns of its own configuration only.
        entries, own = rows.jacobian.tocoo(), np.zeros((len(rows.value), n))
        entries.sum_duplicates()
        own[entries.row, entries.col % n] = entries.data
        jacobians.append(own.reshape(len(q), k, n))
    return np.concatenate(values, axis=1), np.concatenate(jacobians, axis=1)


def project_onto_holds(
    engine: KinematicsEngine, q: Float[np.ndarray, "S n"], holds: Sequence[Hold]
) -> Float[np.ndarray, "S n"]:
    """The nearest configurations that keep the holds (Gauss-Newton with least-norm steps)."""
    poll()
    if not holds or not len(q):
        return q
    for _ in range(PROJECTION_STEPS):
        value, jacobian = linearize_holds(engine, q, holds)
        if np.abs(value).max() < PROJECTION_TOLERANCE:
            break
        q = q - least_norm_step(jacobian, value)
    return q


def least_norm_step(jacobian: Float[np.ndarray, "S k n"], value: Float[np.ndarray, "S k"]) -> Float[np.ndarray, "S n"]:
    """The shortest step that changes the value by as much."""
    return np.asarray(np.einsum("snk,sk->sn", np.linalg.pinv(jacobian, rcond=1e-6), value))


def largest_hold_error(
    engine: KinematicsEngine, q: Float[np.ndarray, "S n"], holds: Sequence[Hold]
) -> Float[np.ndarray, "S"]:
    """Largest residual of any hold at each configuration."""
    if not holds:
        return np.zeros(len(q))
    state = MotionState(engine(q), Contacts.none())
    everywhere = np.arange(len(q))
    parts = [np.abs(hold(everywhere).value(state)).reshape(len(q), -1) for hold in holds]
    return np.asarray(np.concatenate(parts, axis=1).max(axis=1))


PLACE, TURN = (True,) * 3 + (False,) * 3, (False,) * 3 + (True,) * 3


PLACE, TURN = (True,) * 3 + (False,) * 3, (False,) * 3 + (True,) * 3


@dataclass(frozen=True)
class KeptPose:
    """A frame keeps its pose relative to another along a whole motion.

    Attributes:
        link: the frame.
        reference: the other frame; None for the world.
        held: (4, 4) ``pose_reference_link`` at the start, which the motion holds.
        wanted: (4, 4) the pose asked for, which the certificate is held to.
        position_tolerance_m: greatest distance of the link's origin from its place.
        rotation_tolerance_rad: greatest angle off the orientation, or of the free axis off its direction.
        free_axis: (3,) in the link, about which it may turn, or None.
    """

    link: str
    reference: str | None
    held: Float[np.ndarray, "4 4"]
    wanted: Float[np.ndarray, "4 4"]
    position_tolerance_m: float
    rotation_tolerance_rad: float
    free_axis: Float[np.ndarray, "3"] | None = None

    @property
    def name(self) -> str:
        """As the user sees it."""
        return f"{self.link} relative to {self.reference or 'the world'}"

    @property
    def drift(self) -> float:
        """How far a row of the holds may be off between waypoints [m, rad]."""
        return min(DRIFT, DRIFT_SHARE * self.position_tolerance_m, DRIFT_SHARE * self.rotation_tolerance_rad)

    def constraints(self, robot: RobotModel, waypoints: Int[np.ndarray, "S"]) -> tuple[Constraint[MotionState], ...]:
        """Place and orientation as equalities at the given waypoints."""
        place, turn = self._residuals(robot, waypoints)
        what = "orientation" if self.free_axis is None else "axis"
        return (
            Constraint(f"place of {self.name}", place, Sense.EQUAL_ZERO, AT_WAYPOINTS, unit="m"),
            Constraint(f"{what} of {self.name}", turn, Sense.EQUAL_ZERO, AT_WAYPOINTS, unit="rad"),
        )

    def holds(self, robot: RobotModel) -> tuple[Hold, ...]:
        """What the curve keeps at zero."""
        return (
            lambda waypoints: self._residuals(robot, waypoints)[0],
            lambda waypoints: self._residuals(robot, waypoints)[1],
        )

    def target(self) -> RelativePoseTarget:
        """What the verifier holds the curve to."""
        return RelativePoseTarget(
            self.link,
            self.reference,
            self.wanted[:3, 3],
            self.wanted[:3, :3],
            self.position_tolerance_m,
            self.rotation_tolerance_rad,
            self.free_axis,
        )

    def errors(self, pose: Float[np.ndarray, "4 4"]) -> tuple[float, float]:
        """How far a ``pose_reference_link`` is off what is asked: distance [m] and angle [rad]."""
        turn = Rotation.from_matrix(self.wanted[:3, :3].T @ pose[:3, :3]).magnitude()
        if self.free_axis is not None:
            axes = self.wanted[:3, :3] @ self.free_axis, pose[:3, :3] @ self.free_axis
            turn = np.arctan2(np.linalg.norm(np.cross(*axes)), axes[0] @ axes[1])
        return float(np.linalg.norm(pose[:3, 3] - self.wanted[:3, 3])), float(turn)

    def _residuals(
        self, robot: RobotModel, waypoints: Int[np.ndarray, "S"]
    ) -> tuple[Residual[MotionState], Residual[MotionState]]:
        place = FramePose(robot, self.link, waypoints, self.held, PLACE, self.reference)
        if self.free_axis is None:
            return place, FramePose(robot, self.link, waypoints, self.held, TURN, self.reference)
        direction = self.held[:3, :3] @ self.free_axis
        return place, AxisDirection(robot, self.link, waypoints, self.free_axis, direction, self.reference)


def make_kept_poses(
    robot: RobotModel, start: Float[np.ndarray, "n"], keep: Sequence[KeepRequest]
) -> tuple[KeptPose, ...]:
    """What a request keeps, for a robot that has the links it names, from the configuration ``start`` on.

    Raises:
        RequestError: a pair is named twice or cannot move, or is not as asked at the start.
    """
    kept = tuple(_kept_pose(robot, start, one) for one in keep)
    problems = [line for index in range(len(keep)) for line in _problems(robot, start, kept, index)]
    if problems:
        raise RequestError(problems)
    return kept


def _kept_pose(robot: RobotModel, start: Float[np.ndarray, "n"], keep: KeepRequest) -> KeptPose:
    held = relative_pose(robot, start, keep.link, keep.relative_to)
    return KeptPose(
        keep.link,
        keep.relative_to,
        held,
        make_kept_pose(keep, held),
        keep.position_tolerance_m,
        float(np.deg2rad(keep.rotation_tolerance_deg)),
        find_free_axis(keep),
    )


def relative_pose(
    robot: RobotModel, q: Float[np.ndarray, "n"], link: str, reference: str | None
) -> Float[np.ndarray, "4 4"]:
    """``pose_reference_link`` at one configuration."""
    poses = locate_links(KinematicsEngine(robot), q, [link] if reference is None else [link, reference])
    return poses[link] if reference is None else np.linalg.inv(poses[reference]) @ poses[link]


def _problems(robot: RobotModel, start: Float[np.ndarray, "n"], kept: Sequence[KeptPose], index: int) -> Iterator[str]:
    """Why a kept pose cannot be asked for."""
    one, field = kept[index], f"keep[{index}]"
    pairs = [{other.link, other.reference} for other in kept[:index]]
    if {one.link, one.reference} in pairs:
        yield f"{field}: {one.name} is kept by keep[{pairs.index({one.link, one.reference})}] already; leave one out"
    joint = locate_frame(robot, one.link)[0]
    if joint == (0 if one.reference is None else locate_frame(robot, one.reference)[0]):
        yield f"{field}: no joint moves {one.name}; leave it out"
    off, turn = one.errors(one.held)
    if off > START_SHARE * one.position_tolerance_m:
        most = 1e3 * START_SHARE * one.position_tolerance_m
        yield (
            f"{field}: at the start {one.name} is {1e3 * off:.1f} mm off the position asked for; "
            f"expected at most {most:.2g} mm, half of position_tolerance_m"
        )
    if turn > START_SHARE * one.rotation_tolerance_rad:
        most = np.rad2deg(START_SHARE * one.rotation_tolerance_rad)
        yield (
            f"{field}: at the start {one.name} is turned by {np.rad2deg(turn):.1f} deg from what is asked for; "
            f"expected at most {most:.2g} deg, half of rotation_tolerance_deg"
        )
