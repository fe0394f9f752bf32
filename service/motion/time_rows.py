"""Limits of a timed curve as linear rows per cell (speed, acceleration, torque, ZMP), and the fastest time law."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from costs.curve import Curve
from costs.robot.model import RobotModel
from costs.stopping import poll
from costs.work_space import borrow_data
from service.verify import SupportPolygon

# Share of the effort limit that is used at grid points, with a reserve for points between them.
_TORQUE_SHARE = 0.98
# Ratio of the ZMP's reserve at grid points to that between them.
_RESERVE_SHARE = 1.1
# Points of a cell at which speed and acceleration are limited.
_INSIDE = (0.0, 0.25, 0.5, 0.75, 1.0)
# Coefficients below this (in units of the limit) are zero.
_FLAT = 1e-10
_NEWTON_STEPS = 100


@dataclass(frozen=True)
class Cells:
    """Cells of a grid along a curve, with the derivatives of the cell's own piece at points within it.

    Attributes:
        grid: (M,) path parameters; the last cell has no width.
        width: (M, 1) of each cell.
        slopes, bends: by point of ``_INSIDE``, (M, n) dq/ds and d2q/ds2.
    """

    grid: Float[np.ndarray, "M"]
    width: Float[np.ndarray, "M 1"]
    slopes: list[Float[np.ndarray, "M n"]]
    bends: list[Float[np.ndarray, "M n"]]

    @staticmethod
    def of(curve: Curve, grid: Float[np.ndarray, "M"]) -> Cells:
        """Return the cells of a grid that contains every knot."""
        width = np.append(np.diff(grid), 0.0)[:, None]
        middle = np.append(0.5 * (grid[:-1] + grid[1:]), grid[-1])
        # q' is a parabola and q'' linear inside a cell: both follow from the middle and the third derivative.
        slope, bend = curve(middle, 1), curve(middle, 2)
        third = np.divide(
            curve(middle + 0.25 * width[:, 0], 2) - bend, 0.25 * width, out=np.zeros_like(bend), where=width > 0.0
        )
        ahead = [(share - 0.5) * width for share in _INSIDE]
        return Cells(
            grid,
            width,
            [slope + w * (bend + 0.5 * w * third) for w in ahead],
            [bend + w * third for w in ahead],
        )


def motion_rows(robot: RobotModel, cells: Cells) -> Iterator[HalfRows]:
    """Yield the limits of speed and acceleration at points of every cell.

    A reach r into the cell ``x`` is ``x + 2 r u``, which makes a row's ``a`` there ``a + 2 r b``.
    """
    is_limited = np.isfinite(robot.acceleration)
    scale = robot.acceleration[is_limited]
    for share, slope, bend in zip(_INSIDE, cells.slopes, cells.bends, strict=True):
        reach = share * cells.width
        a, b = slope[:, is_limited] / scale, bend[:, is_limited] / scale
        yield HalfRows.two_sided(a + 2.0 * reach * b, b, np.zeros_like(a), 1.0)
        fastest = ((slope / robot.velocity) ** 2).max(axis=1, keepdims=True)
        yield HalfRows(2.0 * reach * fastest, fastest, np.ones_like(fastest))


def force_rows(
    robot: RobotModel,
    curve: Curve,
    cells: Cells,
    torque_rows: Bool[np.ndarray, "n"],
    support: SupportPolygon | None,
    reserve_m: float,
) -> Iterator[HalfRows]:
    """Yield the limits of torques and ZMP at both ends of every cell.

    Args:
        robot: with the effort limits.
        curve, cells: the grid's.
        torque_rows: coordinates whose torque follows from the motion alone.
        support: polygon of the ZMP, or None.
        reserve_m: of the ZMP inside the polygon, at most half of that at rest.
    """
    if not np.any(torque_rows) and support is None:
        return
    q = curve(cells.grid)
    rest, gain = _compute_at_rest(robot, q, cells.slopes[0])
    bend = _compute_speed_share(robot, q, cells.slopes[0], cells.bends[0], rest)
    later = np.append(np.arange(1, len(q)), len(q) - 1)
    far = bend[later]
    # The second derivative jumps at knots only; elsewhere a cell ends as the next one begins.
    jumps = np.flatnonzero(~np.isclose(cells.bends[-1], cells.bends[0][later], rtol=1e-9, atol=1e-12).all(axis=1))
    far[jumps] = _compute_speed_share(
        robot, q[later[jumps]], cells.slopes[-1][jumps], cells.bends[-1][jumps], rest[later[jumps]]
    )
    n = robot.n
    for a, b, c, reach in ((gain, bend, rest, 0.0 * cells.width), (gain[later], far, rest[later], cells.width)):
        if np.any(torque_rows):
            limit = robot.effort * _TORQUE_SHARE
            # A joint that its own weight overloads cannot be helped by timing.
            light = torque_rows & np.all(np.abs(c[:, :n]) < limit, axis=0)
            part = (a[:, :n][:, light], b[:, :n][:, light], c[:, :n][:, light])
            yield HalfRows.two_sided(part[0] + 2.0 * reach * part[1], part[1], part[2], limit[light])
        if support is not None:
            yield _balance_rows(a[:, n:], b[:, n:], c[:, n:], reach, support, _RESERVE_SHARE * reserve_m)


def _balance_rows(
    a: Float[np.ndarray, "M 6"],
    b: Float[np.ndarray, "M 6"],
    c: Float[np.ndarray, "M 6"],
    reach: Float[np.ndarray, "M 1"],
    support: SupportPolygon,
    reserve_m: float,
) -> HalfRows:
    """Return ``normal . zmp <= offset - reserve`` per edge of the polygon, times the vertical ground force."""
    along = np.roll(support.polygon, -1, axis=0) - support.polygon
    length = np.linalg.norm(along, axis=1)
    is_edge = length > 1e-12
    along, start = along[is_edge] / length[is_edge, None], support.polygon[is_edge]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    offset, h = (normal * start).sum(axis=1), support.height
    zero = np.zeros(len(normal))
    # zmp = (h fx - my, h fy + mx) / fz
    of_wrench = np.stack([h * normal[:, 0], h * normal[:, 1], -offset, normal[:, 1], -normal[:, 0], zero], axis=1)
    weight = np.maximum(c[:, 2:3], 1e-12)
    inside = -(c @ of_wrench.T) / weight
    reserve = np.minimum(reserve_m, 0.5 * _RESERVE_SHARE * inside)
    is_held = inside > 1e-6
    room = np.where(is_held, (inside - reserve) * weight, np.inf)
    turn_a, turn_b = (of @ of_wrench.T + reserve * of[:, 2:3] for of in (a, b))
    return HalfRows(turn_a + 2.0 * reach * turn_b, turn_b, room)


def _compute_at_rest(
    robot: RobotModel, q: Float[np.ndarray, "M n"], slope: Float[np.ndarray, "M n"]
) -> tuple[Float[np.ndarray, "M n+6"], Float[np.ndarray, "M n+6"]]:
    """Return torques and ground wrench of the resting robot, and the increase by d2s/dt2 = 1 [Nm, N]."""
    still = np.zeros_like(q)
    rest = _compute_loads(robot, q, still, still)
    return rest, _compute_loads(robot, q, still, slope) - rest


def _compute_speed_share(
    robot: RobotModel,
    q: Float[np.ndarray, "M n"],
    slope: Float[np.ndarray, "M n"],
    bend: Float[np.ndarray, "M n"],
    rest: Float[np.ndarray, "M n+6"],
) -> Float[np.ndarray, "M n+6"]:
    """Return the increase by (ds/dt)^2 = 1: inertia times q'' plus Coriolis forces of q' [Nm, N]."""
    return np.asarray(_compute_loads(robot, q, slope, bend) - rest)


def _compute_loads(
    robot: RobotModel, q: Float[np.ndarray, "M n"], v: Float[np.ndarray, "M n"], a: Float[np.ndarray, "M n"]
) -> Float[np.ndarray, "M n+6"]:
    """Return generalised forces, and the ground wrench about the world's origin without the mechanism's share."""
    model = robot.model
    data = borrow_data(model)
    apart = {body.joint for body in robot.bodies if body.link in robot.mechanism_links}
    roots = [j for j in range(1, model.njoints) if int(model.parents[j]) == 0 and j not in apart]
    loads = np.zeros((len(q), model.nv + 6))
    for k in range(len(q)):
        poll()
        loads[k, : model.nv] = pin.rnea(model, data, q[k], v[k], a[k])
        for joint in roots:
            loads[k, model.nv :] += data.liMi[joint].act(data.f[joint]).vector
    return loads


@dataclass(frozen=True)
class HalfRows:
    """Rows ``a u + b x <= room`` of ``M`` cells, ``m`` each; u = x = 0 keeps them all.

    Attributes:
        a, b: (M, m).
        room: (M, m) > 0; inf where there is no row.
    """

    a: Float[np.ndarray, "M m"]
    b: Float[np.ndarray, "M m"]
    room: Float[np.ndarray, "M m"]

    @staticmethod
    def two_sided(a: np.ndarray, b: np.ndarray, c: np.ndarray, limit: np.ndarray | float) -> HalfRows:
        """Return ``|a u + b x + c| <= limit`` where ``|c| < limit``."""
        return HalfRows(np.hstack([a, -a]), np.hstack([b, -b]), np.hstack([limit - c, limit + c]))


class Limits:
    """All rows of ``M`` cells and ``x <= limit``, for evaluation cell by cell.

    Attributes:
        highest: (M,) largest x that the rows without u allow.
    """

    def __init__(self, rows: Sequence[HalfRows], limit: Float[np.ndarray, "M"]) -> None:
        a, b = (np.hstack([getattr(part, name) / part.room for part in rows]) for name in ("a", "b"))
        is_up, is_down = a > _FLAT, a < -_FLAT
        inverse = np.divide(1.0, a, out=np.zeros_like(a), where=is_up | is_down)
        # u lies between low + slope x and high + slope x.
        self._slope = -b * inverse
        self._low, self._high = np.where(is_down, inverse, -np.inf), np.where(is_up, inverse, np.inf)
        is_flat = ~(is_up | is_down) & (b > _FLAT)
        room = np.divide(1.0, b, out=np.full_like(b, np.inf), where=is_flat)
        self.highest = np.minimum(limit, room.min(axis=1, initial=np.inf))

    def bounds(self, i: int, x: float, width: float, highest: float) -> tuple[float, float, float, float]:
        """Return least and greatest u at ``x`` by the rows and ``0 <= x + 2 width u <= highest``, and their slopes."""
        shift = self._slope[i] * x
        low, high = self._low[i] + shift, self._high[i] + shift
        k, j = low.argmax(), high.argmin()
        least, most = float(low[k]), float(high[j])
        least_slope, most_slope = float(self._slope[i, k]), float(self._slope[i, j])
        if -0.5 * x / width >= least:
            least, least_slope = -0.5 * x / width, -0.5 / width
        if 0.5 * (highest - x) / width <= most:
            most, most_slope = 0.5 * (highest - x) / width, -0.5 / width
        return least, most, least_slope, most_slope


def fastest_speed(
    limits: Limits, width: Float[np.ndarray, "M-1"], ends: tuple[float, float] = (0.0, 0.0)
) -> Float[np.ndarray, "M"]:
    """Return the greatest ds/dt between two ends: controllable sets backwards, then greedily forwards.

    Rest is always controllable (u = x = 0 keeps every row), so each set is ``[0, reachable]``: the first speed is at
    most that from which the robot can slow down, the last one at most that which it reaches.
    """
    n = len(width)
    reachable = np.zeros(n + 1)
    reachable[n] = min(ends[1] ** 2, float(limits.highest[n]))
    for i in range(n - 1, -1, -1):
        poll()
        x = float(limits.highest[i])
        for _ in range(_NEWTON_STEPS):
            least, most, least_slope, most_slope = limits.bounds(i, x, width[i], reachable[i + 1])
            if least <= most or x <= 0.0:
                break
            # least - most is convex and piecewise linear in x: Newton from the right descends onto its root.
            x = max(0.0, x - (least - most) / (least_slope - most_slope) - 1e-12 * x)
        reachable[i] = x
    square = np.zeros(n + 1)
    square[0] = min(ends[0] ** 2, reachable[0])
    for i in range(n):
        poll()
        _, most, _, _ = limits.bounds(i, square[i], width[i], reachable[i + 1])
        square[i + 1] = min(max(square[i] + 2.0 * width[i] * most, 0.0), reachable[i + 1])
    return np.asarray(np.sqrt(square))
