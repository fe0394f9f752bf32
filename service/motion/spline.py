"""The executed curve through the waypoints: projected onto the holds, smooth within a phase, at rest between most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_banded

from costs.curve import Curve
from costs.kinematics import KinematicsEngine
from costs.stopping import poll
from costs.terms.rolling import stop_between, straighten
from service.body.holds import (
    DRIFT,
    Hold,
    find_led,
    largest_hold_error,
    least_norm_step,
    linearize_holds,
    project_onto_holds,
)
from service.body.task_plan import KeptCurve

SMALLEST_STEP = 1e-3  # of the path parameter, so that a waypoint that repeats does not stop the curve
SMALLEST_RATE = 1e-12  # tangents this close to their limits keep them
ALIKE = 1e-3  # of the directions that two ways leave open where one goes over into the other, which rounding tilts
LIMIT_ROUNDS = 3  # of the search for joints at their limits
DRIFT_AT = np.array([0.2, 0.5, 0.8])  # of an interval: where drift is measured; a knot is added in its middle
MAX_INSERTIONS = 6  # rounds; each halves the intervals that drift


@dataclass(frozen=True)
class PhasePath:
    """Waypoints and holds of a phase.

    Attributes:
        name: of the phase.
        q: (T, n) waypoints; the first is the last of the phase before.
        holds: residuals kept at zero (planted feet, a hand on a wheel).
        drift: largest residual of a hold between waypoints [m, rad].
        kept: curve through the waypoints that is taken as it is, or None.
        flows: whether the curve goes on into the next phase without a rest.
    """

    name: str
    q: Float[np.ndarray, "T n"]
    holds: tuple[Hold, ...]
    drift: float = DRIFT
    kept: KeptCurve | None = None
    flows: bool = False


@dataclass(frozen=True)
class Spline:
    """The curve of all phases.

    Attributes:
        curve: through all waypoints.
        ends: (F + 1,) knot index at which each phase begins, and the last knot.
        is_waypoint: (K,) whether a knot is one of the phases' own waypoints, not inserted.
    """

    curve: Curve
    ends: tuple[int, ...]
    is_waypoint: np.ndarray


def make_spline(
    engine: KinematicsEngine,
    paths: Sequence[PhasePath],
    lower: Float[np.ndarray, "n"],
    upper: Float[np.ndarray, "n"],
    speed: Float[np.ndarray, "n"],
    *,
    is_smooth: bool = False,
) -> Spline:
    """Make a C1 cubic spline through all phases, with waypoints inserted where a hold would drift.

    Curves that are kept are taken as they are.

    Args:
        engine: kinematics.
        paths: phases in order; each begins where the one before ends.
        lower, upper: (n,) limits that tangents must not cross.
        speed: (n,) natural speed of each coordinate; the path parameter runs in about seconds at these speeds.
        is_smooth: whether the second derivative is continuous too, as far as limits and holds allow; it leaves the
            chords further than other tangents do.
    """
    originals: list[np.ndarray] = []
    refined: list[PhasePath] = []
    tangents: list[np.ndarray] = []
    knots: list[np.ndarray] = []
    led = find_led(engine.robot)
    rest = np.zeros(len(lower))
    leaving = rest  # tangent at the end of the phase before
    for index, path in enumerate(paths):
        first = refined[-1].q[-1] if index else path.q[0]
        entering, leaving = leaving, rest
        if path.kept is not None:
            own = path.kept.curve
            refined.append(replace(path, q=np.concatenate([first[None], own.positions[1:]])))
            tangents.append(own.tangents)
            knots.append(own.knots - own.knots[0])
            originals.append(np.ones(len(own.knots), dtype=bool))
            continue
        q = np.array(path.q)
        q[0] = first
        is_original = np.ones(len(q), dtype=bool)
        if engine.robot.rolls:
            q = straighten(q)
        q[1:] = project_onto_holds(engine, q[1:], path.holds, led)
        if path.flows and index + 1 < len(paths) and paths[index + 1].kept is None:
            leaving = _find_border_tangent(engine, q, path.holds, paths[index + 1], lower, upper, speed)
        ends = np.stack([entering, leaving])
        for _ in range(MAX_INSERTIONS):
            s = _parametrise(q, speed)
            v = _compute_tangents(engine, q, s, path.holds, lower, upper, ends, is_smooth=is_smooth)
            curve = Curve(s, q, v)
            inner = curve((s[:-1] + np.diff(s) * DRIFT_AT[:, None]).ravel())
            errors = largest_hold_error(engine, inner, path.holds).reshape(len(DRIFT_AT), -1)
            drifting = np.flatnonzero(errors.max(axis=0) > path.drift)
            if not len(drifting):
                break
            inserted = project_onto_holds(engine, curve(0.5 * (s[1:] + s[:-1])[drifting]), path.holds, led)
            q = np.insert(q, drifting + 1, inserted, axis=0)
            is_original = np.insert(is_original, drifting + 1, False)
        s = _parametrise(q, speed)
        refined.append(replace(path, q=q))
        tangents.append(_compute_tangents(engine, q, s, path.holds, lower, upper, ends, is_smooth=is_smooth))
        knots.append(s)
        originals.append(is_original)
    return _join_phases(refined, knots, tangents, originals)


def _join_phases(
    paths: Sequence[PhasePath],
    knots: Sequence[np.ndarray],
    tangents: Sequence[np.ndarray],
    originals: Sequence[np.ndarray],
) -> Spline:
    """Join the phases to a curve; they share their border knots and the tangents there."""
    s, q, v = [knots[0]], [paths[0].q], [tangents[0]]
    is_waypoint = [originals[0]]
    ends = [0, len(knots[0]) - 1]
    for path, knot, tangent, original in zip(paths[1:], knots[1:], tangents[1:], originals[1:], strict=True):
        s.append(knot[1:] + s[-1][-1])
        q.append(path.q[1:])
        v.append(tangent[1:])
        is_waypoint.append(original[1:])
        ends.append(ends[-1] + len(knot) - 1)
    curve = Curve(np.concatenate(s), np.concatenate(q), np.concatenate(v))
    return Spline(curve, tuple(ends), np.concatenate(is_waypoint))


def _parametrise(q: Float[np.ndarray, "T n"], speed: Float[np.ndarray, "n"]) -> Float[np.ndarray, "T"]:
    """Return the cumulative time of the slowest coordinate at its natural speed."""
    steps = np.maximum((np.abs(np.diff(q, axis=0)) / speed).max(axis=1), SMALLEST_STEP)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _compute_tangents(
    engine: KinematicsEngine,
    q: Float[np.ndarray, "T n"],
    s: Float[np.ndarray, "T"],
    holds: Sequence[Hold],
    lower: Float[np.ndarray, "n"],
    upper: Float[np.ndarray, "n"],
    ends: Float[np.ndarray, "2 n"],
    *,
    is_smooth: bool,
    alike: float = 1e-6,
) -> Float[np.ndarray, "T n"]:
    """Return dq/ds at the waypoints, within limits and along the holds; at both ends as they are given.

    They are three-point differences, or those of the cubic spline with a continuous second derivative.
    """
    poll()
    slopes = np.diff(q, axis=0) / np.diff(s)[:, None]
    tangents = np.zeros_like(q)
    tangents[0], tangents[-1] = ends
    h = np.diff(s)[:, None]
    if len(q) > 2:
        mean = h[1:] * slopes[:-1] + h[:-1] * slopes[1:]
        width = h[1:] + h[:-1]
        tangents[1:-1] = _solve_smooth(h[:, 0], 3.0 * mean, ends) if is_smooth else mean / width
    least, most = _tangent_limits(q, h, lower, upper)
    tangents = np.clip(tangents, least, most)
    if engine.robot.rolls:
        tangents = stop_between(q, tangents)
    tangents[1:-1] = _project_tangents(engine, q[1:-1], tangents[1:-1], holds, least[1:-1], most[1:-1], alike)
    return np.asarray(tangents)


def _find_border_tangent(
    engine: KinematicsEngine,
    q: Float[np.ndarray, "T n"],
    holds: Sequence[Hold],
    after: PhasePath,
    lower: Float[np.ndarray, "n"],
    upper: Float[np.ndarray, "n"],
    speed: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n"]:
    """Return dq/ds between two phases, along the holds of both.

    Args:
        engine, lower, upper, speed: as in ``make_spline``.
        q: (T, n) waypoints of the phase before.
        holds: of the phase before.
        after: the phase after.
    """
    around = np.stack([q[-2], q[-1], project_onto_holds(engine, after.q[1:2], after.holds, find_led(engine.robot))[0]])
    s = _parametrise(around, speed)
    both = (*holds, *after.holds)
    rest = np.zeros((2, q.shape[1]))
    tangents = _compute_tangents(engine, around, s, both, lower, upper, rest, is_smooth=False, alike=ALIKE)
    return np.asarray(tangents[1])


def _solve_smooth(
    h: Float[np.ndarray, "T-1"], right: Float[np.ndarray, "T-2 n"], ends: Float[np.ndarray, "2 n"]
) -> Float[np.ndarray, "T-2 n"]:
    """Return the inner tangents at which the second derivatives of both sides are equal, for given ends."""
    right = right.copy()
    right[0] -= h[1] * ends[0]
    right[-1] -= h[-2] * ends[1]
    bands = np.zeros((3, len(right)))
    bands[1] = 2.0 * (h[1:] + h[:-1])
    bands[0, 1:], bands[2, :-1] = h[:-2], h[2:]
    return np.asarray(solve_banded((1, 1), bands, right))


def _tangent_limits(
    q: Float[np.ndarray, "T n"],
    h: Float[np.ndarray, "T-1 1"],
    lower: Float[np.ndarray, "n"],
    upper: Float[np.ndarray, "n"],
) -> tuple[Float[np.ndarray, "T n"], Float[np.ndarray, "T n"]]:
    """Return the least and greatest tangents with which no interval leaves the limits.

    With ``h v <= 3 (upper - q)`` at its first knot and ``-h v <= 3 (upper - q)`` at its last, a cubic stays below
    ``upper``, since ``u (1-u)^2`` is at most a third of ``(1 + 2u) (1-u)^2``; the lower limit mirrors it.
    """
    above, below = 3.0 * np.maximum(upper - q, 0.0), 3.0 * np.maximum(q - lower, 0.0)
    least, most = np.full_like(q, -np.inf), np.full_like(q, np.inf)
    most[:-1], least[:-1] = above[:-1] / h, -below[:-1] / h
    most[1:] = np.minimum(most[1:], below[1:] / h)
    least[1:] = np.maximum(least[1:], -above[1:] / h)
    return least, most


def _project_tangents(
    engine: KinematicsEngine,
    q: Float[np.ndarray, "S n"],
    v: Float[np.ndarray, "S n"],
    holds: Sequence[Hold],
    least: Float[np.ndarray, "S n"],
    most: Float[np.ndarray, "S n"],
    alike: float,
) -> Float[np.ndarray, "S n"]:
    """Return velocities near the given ones along the holds and within the limits.

    Joints that would pass a limit stay at it while the others keep the holds; where that is not enough, all are scaled
    down together.
    """
    if not holds or not len(q):
        return v
    _, jacobian = linearize_holds(engine, q, holds)
    led = find_led(engine.robot)
    at_limit = np.tile(led, (len(v), 1))
    for _ in range(LIMIT_ROUNDS):
        free = np.where(at_limit[:, None, :], 0.0, jacobian)
        v = v - least_norm_step(free, np.einsum("skn,sn->sk", jacobian, v), alike)
        beyond = (v > most + SMALLEST_RATE) | (v < least - SMALLEST_RATE)
        if not beyond.any():
            return v
        at_limit |= beyond
        v = np.clip(v, least, most)
    free = np.where(led, 0.0, jacobian)
    v = v - least_norm_step(free, np.einsum("skn,sn->sk", jacobian, v), alike)
    beyond = (v > most + SMALLEST_RATE) | (v < least - SMALLEST_RATE)
    share = np.where(beyond, np.where(v > 0.0, most, least) / np.where(beyond, v, 1.0), 1.0)
    return np.asarray(v * share.min(axis=1, keepdims=True))
