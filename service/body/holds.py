"""Holds: residuals kept at zero along a motion (planted feet, kept poses), and projection onto them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.collision import Contacts
from costs.kinematics import Kinematics, KinematicsEngine, locate_links
from costs.robot import PLANAR_NAMES, RobotModel
from costs.state import MotionState
from costs.stopping import poll
from costs.terms import AxisDirection, FramePose, NormWithin
from scopt import Constraint, Residual, Sense
from service.verify import RelativePoseTarget

Hold = Callable[[Int[np.ndarray, "S"]], Residual[MotionState]]
"""A function that makes the residual that is kept at zero, given the waypoints."""

DRIFT = 5e-4  # of a hold's residual between waypoints [m, rad]
CONTACT_DRIFT = 4e-5  # the same where contacts change, whose points stay where they are within 0.1 mm
PROJECTION_STEPS = 8
PROJECTION_TOLERANCE = 1e-9  # [m, rad]
CLOSE = 1e-5  # the same within joint limits, of guesses for the optimiser [m, rad]
LARGEST_STEP = 0.3  # of a coordinate in one step within joint limits, where the holds are out of reach [rad, m]
AT_WAYPOINTS = 1e-4  # per row, of the optimiser; the spline's projection does the rest [m, rad]
# Wider tolerances are regions in which the frame moves, narrower ones are held.
REGION_M, REGION_RAD = 0.02, float(np.deg2rad(3.0))
REGION_SHARE = 0.9  # of a region for the waypoints, the rest is for the curve
START_SHARE = 0.5  # of the tolerances at the start of what is held
DRIFT_SHARE = 0.25  # of the tolerances for the drift between waypoints
POSITION, ROTATION = (True,) * 3 + (False,) * 3, (False,) * 3 + (True,) * 3  # rows of a frame's pose


def linearize_holds(
    engine: KinematicsEngine, q: Float[np.ndarray, "S n"], holds: Sequence[Hold]
) -> tuple[Float[np.ndarray, "S k"], Float[np.ndarray, "S k n"]]:
    """Return residuals and Jacobians of all holds at separate configurations."""
    return linearize_residuals(engine, q, make_residuals(holds, len(q)))


def make_residuals(holds: Sequence[Hold], count: int) -> tuple[Residual[MotionState], ...]:
    """Return the residuals of all holds at as many configurations, which serve every step of a search."""
    return tuple(hold(np.arange(count)) for hold in holds)


def linearize_residuals(
    engine: KinematicsEngine, q: Float[np.ndarray, "S n"], residuals: Sequence[Residual[MotionState]]
) -> tuple[Float[np.ndarray, "S k"], Float[np.ndarray, "S k n"]]:
    """Return residuals and Jacobians at separate configurations, for which the residuals were made."""
    poll()
    state = MotionState(engine(q), Contacts.none())
    n = q.shape[1]
    values, jacobians = [], []
    for residual in residuals:
        rows = residual.linearize(state)
        k = len(rows.value) // len(q)
        values.append(rows.value.reshape(len(q), k))
        # A row touches the columns of its own configuration only.
        entries = rows.jacobian
        at = n * np.repeat(np.arange(len(rows.value)), np.diff(entries.indptr)) + entries.indices % n
        own = np.bincount(at, entries.data, minlength=len(rows.value) * n)
        jacobians.append(own.reshape(len(q), k, n))
    return np.concatenate(values, axis=1), np.concatenate(jacobians, axis=1)


def project_onto_holds(
    engine: KinematicsEngine,
    q: Float[np.ndarray, "S n"],
    holds: Sequence[Hold],
    fixed: Bool[np.ndarray, "n"] | None = None,
) -> Float[np.ndarray, "S n"]:
    """Return the nearest configurations that keep the holds (Gauss-Newton with least-norm steps).

    Coordinates that are ``fixed``, by default the joints of a mechanism, stay where they are: the others follow them.
    """
    poll()
    if not holds or not len(q):
        return q
    prescribed = find_prescribed(engine.robot) if fixed is None else fixed
    residuals = make_residuals(holds, len(q))
    for _ in range(PROJECTION_STEPS):
        value, jacobian = linearize_residuals(engine, q, residuals)
        if np.abs(value).max() < PROJECTION_TOLERANCE:
            break
        q = q - least_norm_step(np.where(prescribed, 0.0, jacobian), value)
    return q


def project_within_limits(
    engine: KinematicsEngine,
    q: Float[np.ndarray, "S n"],
    holds: Sequence[Hold],
    lower: Float[np.ndarray, "#S n"],
    upper: Float[np.ndarray, "#S n"],
    fixed: Bool[np.ndarray, "n"] | None = None,
) -> Float[np.ndarray, "S n"]:
    """Return configurations nearer to the holds after a few steps; coordinates that reach their limit stay there.

    Args:
        engine: of the robot.
        q: configurations.
        holds: to be kept.
        lower, upper: limits.
        fixed: coordinates that keep their values; by default those of a mechanism.
    """
    fixed = find_prescribed(engine.robot) if fixed is None else fixed
    lower, upper = np.where(fixed, -np.inf, lower), np.where(fixed, np.inf, upper)
    is_still = np.tile(fixed, (len(q), 1))
    residuals = make_residuals(holds, len(q))
    for _ in range(PROJECTION_STEPS):
        value, jacobian = linearize_residuals(engine, q, residuals)
        if np.abs(value).max() < CLOSE:
            break
        step = least_norm_step(np.where(is_still[:, None, :], 0.0, jacobian), value)
        moved = q - np.clip(step, -LARGEST_STEP, LARGEST_STEP)
        q = np.clip(moved, lower, upper)
        is_still |= q != moved
    return q


def find_prescribed(robot: RobotModel) -> Bool[np.ndarray, "n"]:
    """Return the mask of coordinates whose motion is prescribed: those of a mechanism."""
    prescribed = np.zeros(robot.n, dtype=bool)
    for joint in {body.joint for body in robot.bodies if body.link in robot.mechanism_links}:
        prescribed[robot.model.joints[joint].idx_v] = True
    return prescribed


def find_led(robot: RobotModel) -> Bool[np.ndarray, "n"]:
    """Return the mask of coordinates that no hold of a curve may move: a mechanism's, and those of a rolling base."""
    led = find_prescribed(robot)
    led[: len(PLANAR_NAMES)] |= robot.rolls
    return led


def least_norm_step(
    jacobian: Float[np.ndarray, "S k n"], value: Float[np.ndarray, "S k"], alike: float = 1e-6
) -> Float[np.ndarray, "S n"]:
    """Return the shortest step that changes the residual by its value; rows less than ``alike`` apart are one."""
    return np.asarray(np.einsum("snk,sk->sn", np.linalg.pinv(jacobian, rcond=alike), value))


def largest_hold_error(
    engine: KinematicsEngine, q: Float[np.ndarray, "S n"], holds: Sequence[Hold]
) -> Float[np.ndarray, "S"]:
    """Return the largest residual of any hold at each configuration."""
    if not holds:
        return np.zeros(len(q))
    state = MotionState(engine(q), Contacts.none())
    everywhere = np.arange(len(q))
    parts = [np.abs(hold(everywhere).value(state)).reshape(len(q), -1) for hold in holds]
    return np.asarray(np.concatenate(parts, axis=1).max(axis=1))


@dataclass(frozen=True)
class KeptPose:
    """A frame's pose relative to another, kept along a whole motion.

    Small tolerances are held: they are room for errors.  Wider ones are regions in which the frame may move.

    Attributes:
        link, reference: the frames; no reference for the world.
        held: ``pose_reference_link`` at the start, which the motion holds.
        wanted: ``pose_reference_link`` of the request, which the verifier checks.
        position_tolerance_m: of the link's origin.
        rotation_tolerance_rad: of the orientation, or of the free axis' direction.
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
        """Description for messages."""
        return f"{self.link} relative to {self.reference or 'the world'}"

    @property
    def is_whole(self) -> bool:
        """Yes: it is kept along the whole motion."""
        return True

    def place(self, shares: Float[np.ndarray, "T"]) -> KeptPose:
        """Return the pose for waypoints at these shares of the path, which is the same."""
        return self

    @property
    def is_held(self) -> tuple[bool, bool]:
        """Whether position and orientation are held, instead of moving within a region."""
        return self.position_tolerance_m <= REGION_M, self.rotation_tolerance_rad <= REGION_RAD

    @property
    def drift(self) -> float:
        """Largest residual of its holds between waypoints [m, rad]."""
        tolerances = self.position_tolerance_m, self.rotation_tolerance_rad
        held = [DRIFT_SHARE * most for most, is_held in zip(tolerances, self.is_held, strict=True) if is_held]
        return min([DRIFT, *held])

    def constraints(self, robot: RobotModel, waypoints: Int[np.ndarray, "S"]) -> tuple[Constraint[MotionState], ...]:
        """Return what is held as equalities at the given waypoints, and the regions as inequalities."""
        position, rotation = self._residuals(robot, waypoints)
        name = "orientation" if self.free_axis is None else "axis"
        parts = (
            (f"position of {self.name}", position, 3, self.position_tolerance_m, "m"),
            (
                f"{name} of {self.name}",
                rotation,
                3 if self.free_axis is None else 2,
                self.rotation_tolerance_rad,
                "rad",
            ),
        )
        constraints = []
        for is_held, (title, residual, rows, most, unit) in zip(self.is_held, parts, strict=True):
            if is_held:
                constraints.append(Constraint(title, residual, Sense.EQUAL_ZERO, AT_WAYPOINTS, unit=unit))
            elif unit == "m" or most < np.pi:
                inside = NormWithin(residual, rows, REGION_SHARE * most)
                constraints.append(Constraint(title, inside, Sense.AT_MOST_ZERO, AT_WAYPOINTS, unit=unit))
        return tuple(constraints)

    def holds(self, robot: RobotModel) -> tuple[Hold, ...]:
        """Return the holds of the curve."""
        parts: tuple[Hold, ...] = (
            lambda waypoints: self._residuals(robot, waypoints)[0],
            lambda waypoints: self._residuals(robot, waypoints)[1],
        )
        return tuple(hold for hold, is_held in zip(parts, self.is_held, strict=True) if is_held)

    def are_within(self, robot: RobotModel, placed: Kinematics) -> bool:
        """Return whether every pose is in the regions; what is held is not looked at."""
        state = MotionState(placed, Contacts.none())
        everywhere = np.arange(placed.n_waypoints)
        regions = [one for one in self.constraints(robot, everywhere) if one.sense is Sense.AT_MOST_ZERO]
        return all(bool(np.all(region.residual.value(state) <= 0.0)) for region in regions)

    def target(self) -> RelativePoseTarget:
        """Return the verifier's target."""
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
        """Return distance [m] and angle [rad] of a ``pose_reference_link`` from ``wanted``."""
        from scipy.spatial.transform import Rotation  # slow to import

        angle = Rotation.from_matrix(self.wanted[:3, :3].T @ pose[:3, :3]).magnitude()
        if self.free_axis is not None:
            axes = self.wanted[:3, :3] @ self.free_axis, pose[:3, :3] @ self.free_axis
            angle = np.arctan2(np.linalg.norm(np.cross(*axes)), axes[0] @ axes[1])
        return float(np.linalg.norm(pose[:3, 3] - self.wanted[:3, 3])), float(angle)

    def _residuals(
        self, robot: RobotModel, waypoints: Int[np.ndarray, "S"]
    ) -> tuple[Residual[MotionState], Residual[MotionState]]:
        """Return the distance from the pose at the start where it is held, from the request's where it is a region."""
        place, turn = (self.held if is_held else self.wanted for is_held in self.is_held)
        position = FramePose(robot, self.link, waypoints, place, POSITION, self.reference)
        if self.free_axis is None:
            return position, FramePose(robot, self.link, waypoints, turn, ROTATION, self.reference)
        direction = turn[:3, :3] @ self.free_axis
        return position, AxisDirection(robot, self.link, waypoints, self.free_axis, direction, self.reference)


def relative_pose(
    robot: RobotModel, q: Float[np.ndarray, "n"], link: str, reference: str | None
) -> Float[np.ndarray, "4 4"]:
    """Return ``pose_reference_link`` at a configuration."""
    poses = locate_links(KinematicsEngine(robot), q, [link] if reference is None else [link, reference])
    return poses[link] if reference is None else np.linalg.inv(poses[reference]) @ poses[link]
