"""Joint torques that hold a configuration against weight, contact forces and given loads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from costs.contact_points import DOWN, ContactPoints, Load, Loads, measure_weight
from costs.kinematics import Topology
from costs.robot.model import RobotModel
from costs.state import LoadedState
from costs.terms.pose import make_waypoint_rows
from scopt import AffineRows, Residual


class StaticTorque:
    """Generalised forces of a configuration at rest, in units of the robot's weight [weight, weight times m].

    ``tau = g(q) - sum J_i^T f_i`` less the loads; the first six entries of a floating base are zero in equilibrium.
    """

    def __init__(self, robot: RobotModel, points: ContactPoints, loads: Sequence[Load] = ()) -> None:
        """
        Args:
            points: of the contacts, in the order of the state's forces.
            loads: that act on the robot.
        """
        self._points = points
        self._loads = Loads.of(robot, loads)

    def measure(self, state: LoadedState, waypoints: Int[np.ndarray, "S"]) -> Float[np.ndarray, "S n"]:
        """Return the generalised forces at waypoints."""
        moves, forces = self._gather(state, waypoints)
        angular = state.kinematics.jacobian[waypoints, 3:]
        turned = np.einsum("skn,ck,cn->sn", angular, self._loads.moment, self._carries(state))
        return state.kinematics.topology.add_followers(-np.einsum("sckn,sck->sn", moves, forces) - turned)

    def differentiate(
        self, state: LoadedState, waypoints: Int[np.ndarray, "S"]
    ) -> tuple[Float[np.ndarray, "S n n"], Float[np.ndarray, "S n F"]]:
        """Return their derivatives by the configuration and by the ``F = 3 C`` components of the forces.

        A force that stays fixed while the links turn has a potential, whose Hessian is
        ``f . (w_i x dp/dq_j)`` for a coordinate ``i`` before ``j`` on the chain, ``w_i`` its axis.
        """
        moves, forces = self._gather(state, waypoints)
        topology = state.kinematics.topology
        precedes = topology.precedes
        angular = state.kinematics.jacobian[waypoints, 3:]
        turning = np.cross(moves, forces[..., None], axis=2).sum(axis=1)
        upper = np.einsum("ski,skj->sij", angular, turning) * precedes
        by_q = -(upper + np.triu(upper, 1).transpose(0, 2, 1))
        for moment, carries in zip(self._loads.moment, self._carries(state), strict=True):
            # Row k along an earlier coordinate j: m . (w_j x w_k).
            axes = np.cross(moment, angular, axisa=0, axisb=1, axisc=1)
            by_q -= np.einsum("skr,skj->srj", angular, axes) * precedes.T * carries[:, None]
        by_q = topology.add_followers(topology.add_followers(by_q).transpose(0, 2, 1)).transpose(0, 2, 1)
        n_points = len(self._points)
        at_contacts = topology.add_followers(moves[:, :n_points])
        by_forces = -at_contacts.transpose(0, 3, 1, 2).reshape(len(waypoints), -1, 3 * n_points)
        return by_q, by_forces

    def _gather(
        self, state: LoadedState, waypoints: Int[np.ndarray, "S"]
    ) -> tuple[Float[np.ndarray, "S A 3 m"], Float[np.ndarray, "S A 3"]]:
        """Return where forces act (contacts, loads, the weight), differentiated by the robot's axes, and the forces."""
        kinematics = state.kinematics
        moves = (
            self._points.places.differentiate_by_axes(kinematics, waypoints),
            self._loads.points.differentiate_by_axes(kinematics, waypoints),
            kinematics.com_columns[waypoints][:, None],
        )
        given = np.concatenate([self._loads.force, DOWN[None]])
        forces = state.forces[waypoints], np.broadcast_to(given, (len(waypoints), *given.shape))
        return np.concatenate(moves, axis=1), np.concatenate(forces, axis=1)

    def _carries(self, state: LoadedState) -> Float[np.ndarray, "L m"]:
        return np.asarray(state.kinematics.topology.moves[self._loads.points.joint], dtype=float)


class JointTorque(Residual[LoadedState]):
    """Joint torque beyond a share of its limit, both signs, two rows per limited joint and waypoint [share of limit].

    ``tau / limit - share``, then ``-tau / limit - share``, with the torque at rest (``StaticTorque``): torque limits
    in eq. 1 of Liu et al., Humanoids 2015.  Joints without a limit, the base and mechanisms have no rows.
    """

    def __init__(
        self,
        robot: RobotModel,
        points: ContactPoints,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        loads: Sequence[Load] = (),
        share: float = 1.0,
    ) -> None:
        """
        Args:
            points: of the contacts, in the order of the state's forces.
            waypoints: (S,) where the rows are measured.
            loads: that act at all these waypoints.
            share: of the limits that may be used.
        """
        self._torque = StaticTorque(robot, points, loads)
        self._waypoints = np.asarray(waypoints)
        self.limited = find_limited_joints(robot)
        self._gain = measure_weight(robot) / robot.effort[self.limited]
        self._share = float(share)

    def value(self, state: LoadedState) -> Float[np.ndarray, "m"]:
        used = self._torque.measure(state, self._waypoints)[:, self.limited] * self._gain
        return np.concatenate([used - self._share, -used - self._share], axis=1).ravel()

    def linearize(self, state: LoadedState) -> AffineRows:
        by_q, by_forces = self._torque.differentiate(state, self._waypoints)
        rows = np.concatenate([by_q, by_forces], axis=2)[:, self.limited] * self._gain[:, None]
        both = np.concatenate([rows, -rows], axis=1)
        return make_waypoint_rows(self.value(state), both, self._waypoints, state.kinematics)


def find_limited_joints(robot: RobotModel) -> Int[np.ndarray, "k"]:
    """Return the coordinates with a torque limit, those of mechanisms left out."""
    supports = Topology.of(robot.model).supports
    frames = [robot.model.frames[robot.model.getFrameId(link)] for link in robot.mechanism_links]
    of_mechanism = supports[[int(frame.parentJoint) for frame in frames]].any(axis=0)
    has_limit = np.isfinite(robot.effort) & (robot.effort > 0.0)
    return np.flatnonzero(has_limit & ~of_mechanism)
