"""Contact forces at samples: forces inside friction cones and caps that make a given wrench, and torques under them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.rotation import skew
from costs.stopping import poll
from service.verify.forces.linear_program import LinearProgram
from service.verify.forces.loaded_balance import Ground

# Wrench and cones may be missed by this share of the weight.
TOLERANCE = 1e-5
_EDGES = 8  # of the pyramid inside a friction cone, for the programs
_EXACT = 1e3  # weight of the wrench against torques in a least-squares program
_SMALL = 1e-2  # weight of the size of forces in it
_FILLED = 0.98  # of caps and friction, in it
_WANTED_SHARE = 0.95  # of torque limits: forces that need more are improved where possible


@dataclass(frozen=True)
class Joints:
    """Torques of the joints before contact forces, and how these change them, at ``S`` samples.

    Attributes:
        torque: (S, k) of the limited joints without contact forces [Nm].
        lever: (S, k, 3C) decrease of the torques per unit force at each contact point.
        effort: (k,) limits [Nm].
    """

    torque: Float[np.ndarray, "S k"]
    lever: Float[np.ndarray, "S k 3C"]
    effort: Float[np.ndarray, "k"]

    def take(self, rows: Int[np.ndarray, "R"]) -> Joints:
        """Return some of the samples."""
        return Joints(self.torque[rows], self.lever[rows], self.effort)

    def measure_shares(self, forces: Float[np.ndarray, "S 3C"]) -> Float[np.ndarray, "S k"]:
        """Return torques under contact forces relative to their limits."""
        return np.asarray((self.torque - np.einsum("skc,sc->sk", self.lever, forces)) / self.effort)


@dataclass(frozen=True)
class ContactForces:
    """Forces at ``S`` samples.

    Attributes:
        forces: (S, C, 3) of the surroundings on the robot [N].
        missing_n: (S,) by how much wrench or cones are missed at least [N]; 0 where forces exist.
        shares: (S, k) torques relative to their limits under these forces.
    """

    forces: Float[np.ndarray, "S C 3"]
    missing_n: Float[np.ndarray, "S"]
    shares: Float[np.ndarray, "S k"]


class ContactShare:
    """Distributes wrenches between the contacts of a phase, which do not move."""

    def __init__(self, ground: Ground, weight: float) -> None:
        """
        Args:
            ground: contact points in the world.
            weight: of the robot [N].
        """
        self.ground, self.weight = ground, weight
        self.middle = ground.points.mean(axis=0)
        self.grasp = list_unit_wrenches(ground.points - self.middle)
        self.scale = np.repeat(np.minimum(ground.caps, weight), 3) / weight
        scaled = self.grasp * self.scale
        self._least = self.scale[:, None] * np.linalg.pinv(scaled)
        self.edges = self._list_edges()
        self._spread_edges = self._list_edges(_FILLED) * np.repeat(self.scale[::3], _EDGES)
        self._spread_rows = self._make_spread_rows()

    def _list_edges(self, share: float = 1.0) -> Float[np.ndarray, "3C E"]:
        """Return the edges of all pyramids as columns, each of unit normal force, for a share of the friction."""
        ground, count = self.ground, len(self.ground.points)
        normals = ground.normals
        side = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
        u = side / np.linalg.norm(side, axis=1, keepdims=True)
        angles = 2.0 * np.pi * np.arange(_EDGES) / _EDGES
        turned = np.cos(angles)[:, None] * u[:, None] + np.sin(angles)[:, None] * np.cross(normals, u)[:, None]
        columns = np.zeros((count, 3, count, _EDGES))
        columns[np.arange(count), :, np.arange(count)] = np.swapaxes(
            normals[:, None] + share * ground.friction[:, None, None] * turned, 1, 2
        )
        return columns.reshape(3 * count, _EDGES * count)

    def about_middle(self, wrench: Float[np.ndarray, "S 6"]) -> Float[np.ndarray, "S 6"]:
        """Return wrenches about the middle of the contact points, given about the world's origin."""
        moment = wrench[:, 3:] - np.cross(self.middle, wrench[:, :3])
        return np.concatenate([wrench[:, :3], moment], axis=1)

    def hold(self, wrench: Float[np.ndarray, "S 6"], joints: Joints | None = None) -> ContactForces:
        """Find forces for each wrench (about the world's origin) [N, Nm], with torques within limits where possible."""
        wanted = self.about_middle(wrench)
        forces = wanted @ self._least.T
        missing, shares = self._judge(wanted, forces, joints)
        limit = TOLERANCE * self.weight

        def is_open() -> Bool[np.ndarray, "S"]:
            return np.asarray((missing > limit) | (shares > _WANTED_SHARE).any(axis=1))

        def keep_better(rows: Int[np.ndarray, "R"], better: Float[np.ndarray, "R 3C"]) -> None:
            miss, share = self._judge(wanted[rows], better, None if joints is None else joints.take(rows))
            was = np.maximum(missing[rows], limit) + self.weight * np.maximum(
                shares[rows].max(axis=1, initial=0.0), _WANTED_SHARE
            )
            now = np.maximum(miss, limit) + self.weight * np.maximum(share.max(axis=1, initial=0.0), _WANTED_SHARE)
            taken = now < was
            forces[rows[taken]], missing[rows[taken]], shares[rows[taken]] = better[taken], miss[taken], share[taken]

        # Wrenches change little from sample to sample: forces that make one of them are shifted a little for others.
        tried = np.zeros(len(wanted), dtype=bool)
        while len(rows := np.flatnonzero(is_open() & ~tried)):
            poll()
            row = int(rows[len(rows) // 2])
            tried[row] = True
            amounts = self._choose_amounts(wanted[row], None if joints is None else joints.take(np.array([row])))
            keep_better(rows, self._shift(wanted[rows], amounts))
        for row in np.flatnonzero(is_open()).tolist():
            poll()
            one = np.array([row])
            found = self._program(wanted[row], None if joints is None else joints.take(one))
            if found is not None:
                keep_better(one, found[None])
        missing = np.where(missing <= limit, 0.0, missing)
        return ContactForces(forces.reshape(len(wrench), len(self.ground.points), 3), missing, shares)

    def find_part(self, rest: Float[np.ndarray, "6"], more: Float[np.ndarray, "6"], joints: Joints | None) -> float:
        """Return the largest x in [0, 1] for which forces hold ``rest + x more`` within torque limits; NaN if none do.

        Args:
            rest, more: about the world's origin [N, Nm].
            joints: two samples: at rest, and the increase of torque by the motion.
        """
        wanted, slope = self.about_middle(np.stack([rest, more]))
        n_edges = self.edges.shape[1]
        lengths = np.concatenate([np.ones(3), np.full(3, 0.1)]) * self.weight
        equal = np.column_stack([self.grasp @ self.edges, -slope / self.weight]) * self.weight / lengths[:, None]
        rows, bounds = self._cap_rows(1)
        if joints is not None:
            lever = joints.lever[0] @ self.edges * self.weight / joints.effort[:, None]
            own, rise = joints.torque / joints.effort
            rows = np.concatenate([rows, np.column_stack([-lever, rise]), np.column_stack([lever, -rise])])
            bounds = np.concatenate([bounds, 1.0 - own, 1.0 + own])
        most = np.append(np.full(n_edges, np.inf), 1.0)
        found = _solve_program(-1.0, rows, bounds, equal, wanted / lengths, most)
        return float("nan") if found is None else float(found[-1])

    def _cap_rows(self, n_more: int) -> tuple[Float[np.ndarray, "C E+k"], Float[np.ndarray, "C"]]:
        """Return the caps as rows of edge forces in units of the weight, with further columns of zeros."""
        count = len(self.ground.points)
        rows = np.zeros((count, _EDGES * count + n_more))
        rows[:, : _EDGES * count] = np.repeat(np.eye(count), _EDGES, axis=1)
        return rows, self.ground.caps / self.weight

    def _judge(
        self, wanted: Float[np.ndarray, "S 6"], forces: Float[np.ndarray, "S 3C"], joints: Joints | None
    ) -> tuple[Float[np.ndarray, "S"], Float[np.ndarray, "S k"]]:
        """Return by how much wrench, cones and caps are missed [N], and sizes of torques relative to their limits."""
        ground = self.ground
        points = forces.reshape(len(forces), len(ground.points), 3)
        normal = np.einsum("sck,ck->sc", points, ground.normals)
        across = np.linalg.norm(points - normal[..., None] * ground.normals, axis=2)
        cone = np.maximum(across - ground.friction * normal, -normal).max(axis=1)
        cap = (normal - ground.caps).max(axis=1)
        wrench = np.abs(forces @ self.grasp.T - wanted).max(axis=1)
        missing = np.maximum(np.maximum(cone, cap), np.maximum(wrench, 0.0))
        shares = np.zeros((len(forces), 0)) if joints is None else np.abs(joints.measure_shares(forces))
        return missing, shares

    def _choose_amounts(self, wanted: Float[np.ndarray, "6"], joints: Joints | None) -> Float[np.ndarray, "E"]:
        """Return the amounts of all edges that make one wrench, small and with small torques, by least squares."""
        from scipy.optimize import nnls  # slow to import, and rarely needed

        fixed, target = self._spread_rows
        rows, aims = [fixed], [_EXACT * wanted / self.weight, target]
        if joints is not None:
            lever = joints.lever[0] @ self._spread_edges * (self.weight / joints.effort[:, None])
            rows.append(np.hstack([lever, np.zeros((len(lever), len(self.ground.points)))]))
            aims.append(joints.torque[0] / joints.effort)
        try:
            return np.asarray(nnls(np.concatenate(rows), np.concatenate(aims))[0][: self._spread_edges.shape[1]])
        except RuntimeError:  # too many steps
            return np.zeros(self._spread_edges.shape[1])

    def _shift(self, wanted: Float[np.ndarray, "R 6"], amounts: Float[np.ndarray, "E"]) -> Float[np.ndarray, "R 3C"]:
        """Return forces that make wrenches, from the amounts of all edges at one of them.

        Each amount changes in proportion to its square, so that edges without force stay so and few change their sign:
        whether forces are inside the pyramids is for the caller to see.
        """
        forces = self.weight * self._spread_edges
        made = self.grasp @ forces
        used = made * amounts**2
        change = np.linalg.pinv(used @ made.T) @ used
        return np.asarray((amounts + (wanted - made @ amounts) @ change) @ forces.T)

    def _make_spread_rows(self) -> tuple[Float[np.ndarray, "G V"], Float[np.ndarray, "H"]]:
        """Return the rows of the least-squares program that all samples have, and the aims of all but the first six.

        Unknowns are the amounts of all edges, and what each contact point could still bear up to its cap.
        """
        count, n_edges = len(self.ground.points), self._spread_edges.shape[1]
        used = np.repeat(np.eye(count), _EDGES, axis=1) * np.repeat(self.scale[::3], _EDGES)
        used *= (self.weight / (_FILLED * self.ground.caps))[:, None]
        rows = [
            np.hstack([_EXACT * self.grasp @ self._spread_edges, np.zeros((6, count))]),
            np.hstack([_EXACT * used, _EXACT * np.eye(count)]),
            np.hstack([_SMALL * np.eye(n_edges), np.zeros((n_edges, count))]),
        ]
        return np.concatenate(rows), np.concatenate([np.full(count, _EXACT), np.zeros(n_edges)])

    def _program(self, wanted: Float[np.ndarray, "6"], joints: Joints | None) -> Float[np.ndarray, "3C"] | None:
        """Return forces with the least largest share of torque, by a linear program; None where there are none."""
        lengths = np.concatenate([np.ones(3), np.full(3, 0.1)])
        equal = np.column_stack([self.grasp @ self.edges, np.zeros(6)]) / lengths[:, None]
        rows, bounds = self._cap_rows(1)
        if joints is not None:
            lever = joints.lever[0] @ self.edges * self.weight / joints.effort[:, None]
            own, one = joints.torque[0] / joints.effort, np.ones((len(joints.effort), 1))
            rows = np.concatenate([rows, np.hstack([-lever, -one]), np.hstack([lever, -one])])
            bounds = np.concatenate([bounds, -own, own])
        found = _solve_program(1.0, rows, bounds, equal, wanted / self.weight / lengths)
        if found is None:
            return None
        force = self.weight * self.edges @ found[:-1]
        return np.asarray(force + self._least @ (wanted - self.grasp @ force))


def _solve_program(
    last: float,
    rows: Float[np.ndarray, "r n"],
    bounds: Float[np.ndarray, "r"],
    equal: Float[np.ndarray, "6 n"],
    wanted: Float[np.ndarray, "6"],
    most: Float[np.ndarray, "n"] | float = np.inf,
) -> Float[np.ndarray, "n"] | None:
    """Return x between 0 and ``most`` with the least ``last x[-1]``, ``rows x <= bounds``, ``equal x = wanted``."""
    cost = np.zeros(rows.shape[1])
    cost[-1] = last
    low = np.concatenate([np.full(len(bounds), -np.inf), wanted])
    return LinearProgram(cost, np.concatenate([rows, equal]), most).solve(low, np.concatenate([bounds, wanted]))


def list_unit_wrenches(points: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "6 3C"]:
    """Return the wrenches of unit forces along the axes at points, about the origin, as columns [-, m]."""
    return np.concatenate([np.tile(np.eye(3), len(points)), np.concatenate(list(skew(points)), axis=1)])


def is_held(forces: ContactForces) -> Bool[np.ndarray, "S"]:
    """Return at which samples forces exist and no torque is beyond its limit."""
    return np.asarray((forces.missing_n <= 0.0) & (forces.shares <= 1.0).all(axis=1))
