"""Linear programs for the places of the centre of mass that are farthest in a direction, under one wrench at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import highspy
import numpy as np
from jaxtyping import Float

from costs.contact import N_PYRAMID_EDGES, WorldContacts
from costs.static_region.errors import NothingHoldsError
from costs.static_region.polygons import RESOLUTION_M

FIRST_DIRECTIONS = tuple(np.array([np.cos(t), np.sin(t)]) for t in 0.1 + np.arange(3) * 2.0 * np.pi / 3.0)
# Forces balance to this share of the weight (moments: times 1 m).
_BALANCE_TOLERANCE = 5e-7
_SHARE_TOLERANCE = 1e-9  # below zero or beyond a cap, of a force from a known basis [weight]
# Least price of contact force in the search for the farthest place [m per weight]: of forces that are equally good for
# the place, the smallest are taken. Places are less far by at most the price times the sum of forces.
_FORCE_PRICE_M = 1e-5


@dataclass(frozen=True)
class Place:
    """Place of the centre of mass that is farthest in a direction, under one wrench.

    Attributes:
        at: (2,) without the wrench's own offset, from the middle of the contact points [m].
        shares: forces along the edges and normals of all pyramids [weight].
        direction: (2,) unit vector.
    """

    at: Float[np.ndarray, "2"]
    shares: Float[np.ndarray, "columns"]
    direction: Float[np.ndarray, "2"]

    @property
    def turn(self) -> float:
        """Angle of the direction from the first one, 0 to a whole turn [rad]."""
        x, y = self.direction.tolist()
        x0, y0 = FIRST_DIRECTIONS[0].tolist()
        return math.atan2(x0 * y - y0 * x, x0 * x + y0 * y) % math.tau


@dataclass(frozen=True)
class _Basis:
    """Basis of a linear program, which is the best for its direction: its shares are ``gain @ bounds of the rows``."""

    direction: Float[np.ndarray, "2"]
    gain: Float[np.ndarray, "columns rows"]


class FarthestPlaces:
    """Linear programs of one set of contacts, solved one after the other from the last basis.

    Variables are the forces along the edges and the normal of each pyramid, in weights, per unit of normal force.
    Moments are about the middle of the points; those about x and y give the centre of mass.
    """

    def __init__(self, contacts: WorldContacts, weight: float, drift_m: float) -> None:
        self._weight = weight
        self._origin = contacts.points.mean(axis=0)
        normals = contacts.normals / np.linalg.norm(contacts.normals, axis=1, keepdims=True)
        self._edges = np.concatenate([contacts.list_pyramid_edges(), normals[:, None]], axis=1)
        edges = self._edges.reshape(-1, 3)
        moments = np.cross(np.repeat(contacts.points - self._origin, N_PYRAMID_EDGES + 1, axis=0), edges)
        # c x (0, 0, -1) = (-c_y, c_x, 0) and all moments sum to zero: c = (-m_y, m_x)
        self._place = np.stack([-moments[:, 1], moments[:, 0]])
        self._balance = np.concatenate([edges.T, moments[:, 2:].T])
        # A force that loses by drift what it gains in reach is not worth having.
        self._price = max(_FORCE_PRICE_M, drift_m) * np.linalg.norm(edges, axis=1)
        self._columns = np.arange(len(edges), dtype=np.int32)
        self._caps = contacts.caps / weight
        self._rows = np.concatenate([self._balance, np.kron(np.eye(len(self._caps)), np.ones(N_PYRAMID_EDGES + 1))])
        self._bases: list[_Basis] = []

    @cached_property
    def _solver(self) -> highspy.Highs:
        return _make_solver(self._balance, self._caps)

    def set_wrench(self, wrench: Float[np.ndarray, "6"]) -> None:
        """Hold this wrench from now on: force and moment about the world origin [N, Nm]."""
        force = wrench[:3] / self._weight
        moment = (wrench[3:] - np.cross(self._origin, wrench[:3])) / self._weight
        self._offset = np.array([-moment[1], moment[0]])
        self._target = np.array([-force[0], -force[1], 1.0 - force[2], -moment[2]])
        for row, value in enumerate(self._target):
            self._solver.changeRowBounds(row, value, value)

    def recall(self) -> list[Place]:
        """Return the farthest places in the directions of earlier programs whose bases hold the wrench as well.

        A basis that is the best for a direction is so for every wrench under which its forces are none negative.
        """
        if not self._bases:
            return []
        shares = np.stack([basis.gain for basis in self._bases]) @ np.concatenate([self._target, self._caps])
        most = shares.reshape(len(shares), len(self._caps), -1).sum(axis=2)
        holds = (shares.min(axis=1) >= -_SHARE_TOLERANCE) & (most <= self._caps + _SHARE_TOLERANCE).all(axis=1)
        shares = np.maximum(shares, 0.0)
        holds &= np.abs(shares @ self._balance.T - self._target).max(axis=1) <= _BALANCE_TOLERANCE
        at = shares @ self._place.T
        return [Place(at[k], shares[k], self._bases[k].direction) for k in np.flatnonzero(holds)]

    def find(self, direction: Float[np.ndarray, "2"], index: int) -> Place:
        """Return the farthest place in a direction under the wrench, which errors call ``index``.

        Raises:
            NothingHoldsError: the program has no solution.
        """
        cost = self._price - direction @ self._place
        self._solver.changeColsCost(len(cost), self._columns, cost)
        status = _run(self._solver)
        shares = self._read_shares(status)
        if shares is None:  # a start from the last basis may be at fault
            self._solver.clearSolver()
            status = _run(self._solver)
            shares = self._read_shares(status)
        if shares is None and status == highspy.HighsModelStatus.kInfeasible:
            raise NothingHoldsError(
                f"no contact forces within friction and force caps hold the robot under wrench {index}, "
                "wherever its centre of mass is",
                index,
            )
        if shares is None:
            raise RuntimeError(f"linear program of the static region ended with {status.name} under wrench {index}")
        self._keep_basis(direction)
        return Place(self._place @ shares, shares, direction)

    def locate(self, places: Sequence[Place]) -> tuple[Float[np.ndarray, "V 2"], Float[np.ndarray, "V C 3"]]:
        """Return places in the world [m], and the contact forces that hold the wrench there [N]."""
        shares = np.array([place.shares for place in places]).reshape(len(places), *self._edges.shape[:2])
        forces = self._weight * np.einsum("vck,cki->vci", shares, self._edges)
        return np.array([place.at for place in places]) + self._origin[:2] + self._offset, forces

    def _read_shares(self, status: highspy.HighsModelStatus) -> Float[np.ndarray, "columns"] | None:
        """Return the solver's solution, none negative, or None where there is no solution that balances."""
        if status != highspy.HighsModelStatus.kOptimal:
            return None
        shares = np.maximum(np.array(self._solver.getSolution().col_value), 0.0)
        return shares if np.abs(self._balance @ shares - self._target).max() <= _BALANCE_TOLERANCE else None

    def _keep_basis(self, direction: Float[np.ndarray, "2"]) -> None:
        """Keep the basis of the last solution, unless it is singular."""
        status, basic = self._solver.getBasicVariables()
        if status != highspy.HighsStatus.kOk:
            return
        basic = np.asarray(basic)
        columns = basic[basic >= 0]
        is_bound = np.ones(len(self._rows), dtype=bool)
        is_bound[-1 - basic[basic < 0]] = False
        rows = np.flatnonzero(is_bound)
        gain = np.zeros((len(self._columns), len(self._rows)))
        try:
            gain[np.ix_(columns, rows)] = np.linalg.inv(self._rows[np.ix_(rows, columns)])
        except np.linalg.LinAlgError:
            return
        self._bases.append(_Basis(direction, gain))


def _make_solver(balance: Float[np.ndarray, "4 columns"], caps: Float[np.ndarray, "C"]) -> highspy.Highs:
    """Return a solver with four rows of balance, yet without a wrench, and one row per force cap."""
    n_columns = balance.shape[1]
    per_point = n_columns // len(caps)
    program = highspy.HighsLp()
    program.num_col_, program.num_row_ = n_columns, 4 + len(caps)
    program.col_cost_ = np.zeros(n_columns)
    program.col_lower_, program.col_upper_ = np.zeros(n_columns), np.full(n_columns, highspy.kHighsInf)
    program.row_lower_ = np.concatenate([np.zeros(4), np.full(len(caps), -highspy.kHighsInf)])
    program.row_upper_ = np.concatenate([np.zeros(4), caps])
    matrix = program.a_matrix_
    matrix.format_ = highspy.MatrixFormat.kColwise
    matrix.start_ = 5 * np.arange(n_columns + 1, dtype=np.int32)
    cap_rows = 4 + np.arange(n_columns) // per_point
    matrix.index_ = (
        np.concatenate([np.tile(np.arange(4)[:, None], n_columns), cap_rows[None]]).T.ravel().astype(np.int32)
    )
    matrix.value_ = np.concatenate([balance, np.ones((1, n_columns))]).T.ravel()
    solver = highspy.Highs()
    for name, value in (
        ("output_flag", False),
        ("threads", 1),
        ("presolve", "off"),
        ("solver", "simplex"),
        ("simplex_strategy", 4),  # primal: the last solution stays feasible while only the direction changes
        ("primal_feasibility_tolerance", 1e-9),
        ("dual_feasibility_tolerance", 1e-9),
    ):
        solver.setOptionValue(name, value)
    solver.passModel(program)
    return solver


def _run(solver: highspy.Highs) -> highspy.HighsModelStatus:
    """Solve, and return the status of the model."""
    if solver.run() == highspy.HighsStatus.kError:
        # HiGHS has one pool of threads per process and refuses another number than the pool's; 0 takes it as it is.
        solver.setOptionValue("threads", 0)
        solver.run()
    status: highspy.HighsModelStatus = solver.getModelStatus()
    return status


def measure_room_beyond(first: Place, second: Place) -> float:
    """Return how far a region may reach beyond the edge of two places that are farthest in their directions [m]."""
    (x1, y1), (x2, y2) = first.direction.tolist(), second.direction.tolist()
    along, across = (second.at - first.at).tolist()
    length = math.hypot(along, across)
    if length < RESOLUTION_M:
        return 0.0
    turn = x1 * y2 - y1 * x2
    if turn < 1e-9:
        return 0.0 if x1 * x2 + y1 * y2 > 0.0 else math.inf
    # the tangents meet at first + u: d1 . u = 0 and d2 . u = d2 . edge
    scale = (x2 * along + y2 * across) / turn
    return float(scale * (-y1 * across - x1 * along) / length)
