"""Forces at the contacts of one configuration: the least ones that hold it, their reserve, and the torque they cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import sparse

from costs.collision import Contacts
from costs.contact_points import ContactPoints, Load, measure_weight
from costs.kinematics import KinematicsEngine
from costs.state import LoadedState, MotionState
from costs.terms import Equilibrium, FrictionPyramid, JointTorque, MechanismBalance
from scopt import Residual
from scopt.qp import QPStatus, QuadraticProgram, solve_clarabel

MISFIT_WEIGHT = 1e3  # of missing balance against the size of forces, for a first guess


@dataclass(frozen=True)
class ForceRows:
    """Rows that are linear in the ``F = 3 C`` components of the contact forces, at one configuration.

    Attributes:
        balance: (B, F) and (B,): ``A f + b = 0`` balances robot and mechanisms [robot's weight, its moment].
        inside: (R, F) and (R,): ``A f + b <= 0`` inside pyramids and caps [robot's weight].
        length: (R,) of the rows of ``inside``: how much a unit of force changes them at most; 0 where no force has any
            room (sides of points without friction).
        used: (J, F) and (J,): ``A f + b`` is the share of its limit that each limited joint uses.
        limited: (J,) coordinates of these joints.
        weight_n: the robot's weight [N].
    """

    balance: tuple[Float[np.ndarray, "B F"], Float[np.ndarray, "B"]]
    inside: tuple[Float[np.ndarray, "R F"], Float[np.ndarray, "R"]]
    length: Float[np.ndarray, "R"]
    used: tuple[Float[np.ndarray, "J F"], Float[np.ndarray, "J"]]
    limited: np.ndarray
    weight_n: float

    @staticmethod
    def at(
        engine: KinematicsEngine,
        q: Float[np.ndarray, "n"],
        points: ContactPoints,
        loads: Sequence[Load] = (),
        mechanism_loads: Mapping[str, float] | None = None,
    ) -> ForceRows:
        """Return the rows at a configuration.

        Args:
            engine: of the robot.
            q: configuration.
            points: of the contacts.
            loads: on the robot.
            mechanism_loads: by joint name: what the robot has to exert along it [N m, N].

        Raises:
            KeyError: a load on a link or joint that is unknown.
        """
        robot = engine.robot
        state = LoadedState(MotionState(engine(q[None]), Contacts.none()), np.zeros((1, len(points), 3)))
        about = points.places.locate(state.kinematics, np.arange(1))[0].mean(axis=0)

        def rows(term: Residual[LoadedState]) -> tuple[Float[np.ndarray, "m F"], Float[np.ndarray, "m"]]:
            linear = term.linearize(state)
            return linear.jacobian.toarray()[:, robot.n :], linear.value

        friction = FrictionPyramid(points, [0])
        torque = JointTorque(robot, points, [0], loads, share=0.0)
        robot_rows = rows(Equilibrium(robot, points, [0], loads, about))
        mechanism_rows = rows(MechanismBalance(robot, points, [0], mechanism_loads))
        balance = tuple(np.concatenate(parts) for parts in zip(robot_rows, mechanism_rows, strict=True))
        half = len(torque.limited)
        by_forces, at_rest = rows(torque)
        return ForceRows(
            (balance[0], balance[1]),
            rows(friction),
            friction.length,
            (by_forces[:half], at_rest[:half]),
            torque.limited,
            measure_weight(robot),
        )

    def find_least(
        self, torque_share: float | None, margin_n: float = 0.0, near: Float[np.ndarray, "C 3"] | None = None
    ) -> Float[np.ndarray, "C 3"] | None:
        """Return the forces with the least sum of squares that hold the configuration [N]; None where none do.

        Args:
            torque_share: of the joints' limits that may be used; None for any torque.
            margin_n: how far inside pyramids and caps [N].
            near: forces whose distance is measured instead of that from zero [N].
        """
        (A, b), (E, e) = self._inequalities(torque_share, margin_n / self.weight_n), self.balance
        size = E.shape[1]
        towards = np.zeros(size) if near is None else near.ravel() / self.weight_n
        program = QuadraticProgram(
            sparse.csc_array(sparse.eye_array(size)), -towards, sparse.csc_array(A), -b,
            np.full(size, -np.inf), np.full(size, np.inf), E=sparse.csc_array(E), f=-e,
        )  # fmt: skip
        solution = solve_clarabel(program)
        return self.weight_n * solution.x.reshape(-1, 3) if solution.status is QPStatus.SOLVED else None

    def guess(self) -> Float[np.ndarray, "C 3"]:
        """Return forces inside pyramids and caps that nearly balance the configuration, whatever it is [N]."""
        (A, b), (E, e) = self.inside, self.balance
        size = E.shape[1]
        P = 2.0 * (MISFIT_WEIGHT * E.T @ E + np.eye(size))
        program = QuadraticProgram(
            sparse.csc_array(P), 2.0 * MISFIT_WEIGHT * E.T @ e, sparse.csc_array(A), -b,
            np.full(size, -np.inf), np.full(size, np.inf),
        )  # fmt: skip
        solution = solve_clarabel(program)
        forces = solution.x if solution.is_usable else np.zeros(size)
        return np.asarray(self.weight_n * forces.reshape(-1, 3))

    def measure_reserve(self, torque_share: float | None) -> float:
        """Return how far inside pyramids and caps the forces at all contact points can be at once [N].

        Errors of the forces up to it, in any direction, make no contact slip, lift or press too hard (a linear program;
        Del Prete, Tonneau and Mansard, ICRA 2016, use the same figure).  Negative where no forces hold the
        configuration: by how much they would have to leave their pyramids; ``-inf`` where even that does not help.

        Args:
            torque_share: of the joints' limits that may be used; None for any torque.
        """
        (A, b), (E, e) = self._inequalities(torque_share), self.balance
        length = np.zeros(len(A))
        length[: len(self.length)] = self.length
        x = _minimise_last(np.column_stack([A, length]), b, -1.0, E, e)
        return -np.inf if x is None else self.weight_n * float(x[-1])

    def spread_torque(self) -> tuple[float, Float[np.ndarray, "C 3"]]:
        """Return the least share of its limit that the most loaded joint can use, and the forces for it [N].

        The share is ``inf`` where no forces hold the configuration; the forces are then zero.
        """
        (A, b), (E, e), (U, u) = self.inside, self.balance, self.used
        rows = np.block([[A, np.zeros((len(A), 1))], [U, -np.ones((len(U), 1))], [-U, -np.ones((len(U), 1))]])
        x = _minimise_last(rows, np.concatenate([b, u, -u]), 1.0, E, e)
        if x is None:
            return np.inf, np.zeros((E.shape[1] // 3, 3))
        return float(x[-1]), self.weight_n * x[:-1].reshape(-1, 3)

    def measure_shares(self, forces: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "J"]:
        """Return the share of its limit that each limited joint uses with forces [N]."""
        U, u = self.used
        return np.asarray(np.abs(U @ forces.ravel() / self.weight_n + u))

    def measure_misfit(self, forces: Float[np.ndarray, "C 3"]) -> float:
        """Return the largest component of force or moment that forces leave unbalanced [N, N m]."""
        E, e = self.balance
        return float(np.abs(E @ forces.ravel() + self.weight_n * e).max())

    def _inequalities(self, torque_share: float | None, margin: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        (A, b), (U, u) = self.inside, self.used
        b = b + margin * self.length
        if torque_share is None:
            return A, b
        return np.concatenate([A, U, -U]), np.concatenate([b, u - torque_share, -u - torque_share])


def _minimise_last(
    A: Float[np.ndarray, "M X"],
    b: Float[np.ndarray, "M"],
    sign: float,
    E: Float[np.ndarray, "B F"],
    e: Float[np.ndarray, "B"],
) -> Float[np.ndarray, "X"] | None:
    """Return ``x = (f, last)`` with the least ``sign last`` that has ``A x + b <= 0`` and ``E f + e = 0``."""
    size = A.shape[1]
    c = np.zeros(size)
    c[-1] = sign
    program = QuadraticProgram(
        sparse.csc_array((size, size)), c, sparse.csc_array(A), -b,
        np.full(size, -np.inf), np.full(size, np.inf), E=sparse.csc_array(np.column_stack([E, 0.0 * e])), f=-e,
    )  # fmt: skip
    solution = solve_clarabel(program)
    return solution.x if solution.is_usable else None
