"""A base on two wheels: rows of the optimiser and paths by which it turns on the spot or drives along its heading."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from costs.robot.model import PLANAR_NAMES
from costs.state import MotionState
from scopt import AffineRows, Residual

STAYS_M = 1e-7  # a shorter step is none [m]
# Shares of a path at which the base changes between turning (first) and driving.
CHANGES = (0.16, 0.42, 0.58, 0.84)
FEWEST_INTERVALS = len(CHANGES) + 1


def find_drives(n_intervals: int) -> Bool[np.ndarray, "I"]:
    """Return which intervals of a path drive; the base turns on the spot in the others, before, between and after."""
    # Each part has an interval of its own, the others are shared.
    spare = max(n_intervals - FEWEST_INTERVALS, 0)
    changes = np.arange(1, FEWEST_INTERVALS) + np.round(spare * np.array(CHANGES)).astype(int)
    return np.asarray(np.searchsorted(changes, np.arange(n_intervals), side="right") % 2 == 1)


def roll_path(q: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T n"]:
    """Return a path whose base turns and drives in turn, between the same ends and by way of the middle of its way.

    The other coordinates stay.  A path of too few waypoints is returned as it is.
    """
    if len(q) - 1 < FEWEST_INTERVALS:
        return q
    places = q[:, :2]
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    middle = places[int(np.searchsorted(travelled, 0.5 * travelled[-1]))]
    if np.linalg.norm(places[-1] - places[0]) > 0.999 * travelled[-1]:
        middle = 0.5 * (places[0] + places[-1])  # a straight way
    return _go_through(q, [places[0], middle, places[-1]], q[0, 2], q[-1, 2])


def straighten(q: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T n"]:
    """Return a path whose base turns and drives without the small errors of ``q``."""
    if len(q) - 1 < FEWEST_INTERVALS:
        return q
    drives = find_drives(len(q) - 1)
    turns = np.flatnonzero(~drives)
    middle = turns[(turns > np.flatnonzero(drives)[0]) & (turns < np.flatnonzero(drives)[-1])]
    corner = q[middle[0] : middle[-1] + 2, :2].mean(axis=0)
    return _go_through(q, [q[0, :2], corner, q[-1, :2]], q[0, 2], q[-1, 2])


def stop_between(q: Float[np.ndarray, "T n"], tangents: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T n"]:
    """Return the tangents of a path of turns and drives with a base that does neither while the other goes on.

    A cubic with these tangents keeps its place where it turns, and its line and heading where it drives.
    """
    out = np.array(tangents)
    moves = np.linalg.norm(np.diff(q[:, :2], axis=0), axis=1) > STAYS_M
    turns = np.abs(np.diff(q[:, 2])) > STAYS_M
    inner = slice(1, -1)
    drives_through = moves[:-1] & moves[1:] & ~turns[:-1] & ~turns[1:]
    turns_through = turns[:-1] & turns[1:] & ~moves[:-1] & ~moves[1:]
    heading = np.stack([np.cos(q[inner, 2]), np.sin(q[inner, 2])], axis=1)
    along = np.einsum("sk,sk->s", out[inner, :2], heading)[:, None] * heading
    out[inner, :2] = np.where(drives_through[:, None], along, 0.0)
    out[inner, 2] = np.where(turns_through, out[inner, 2], 0.0)
    return out


def _go_through(
    q: Float[np.ndarray, "T n"], corners: list[Float[np.ndarray, "2"]], first: float, last: float
) -> Float[np.ndarray, "T n"]:
    """Return the path with a base that drives from corner to corner, ahead or back, whichever turns less."""
    drives = find_drives(len(q) - 1)
    headings = [first, *_choose_headings(corners, first, last), last]
    out, leg = np.array(q), 0
    edges = [0, *(np.flatnonzero(np.diff(drives)) + 1).tolist(), len(q) - 1]
    for begin, end in pairwise(edges):
        share = np.linspace(0.0, 1.0, end - begin + 1)[:, None]
        if drives[begin]:
            out[begin : end + 1, :2] = corners[leg] + share * (corners[leg + 1] - corners[leg])
            out[begin : end + 1, 2] = headings[leg + 1]
            leg += 1
        else:
            out[begin : end + 1, :2] = corners[leg]
            out[begin : end + 1, 2] = headings[leg] + share[:, 0] * (headings[leg + 1] - headings[leg])
    return out


def _choose_headings(corners: list[Float[np.ndarray, "2"]], first: float, last: float) -> list[float]:
    """Return the heading of each leg, within half a turn of the one before; a leg without length keeps that one."""
    best: list[float] = []
    least = np.inf
    for flip in (0.0, np.pi):
        headings, before = list[float](), first
        for a, b in pairwise(corners):
            if np.linalg.norm(b - a) > STAYS_M:
                wanted = float(np.arctan2(*(b - a)[::-1])) + flip
                before = before + float(np.remainder(wanted - before + np.pi, 2.0 * np.pi) - np.pi)
            headings.append(before)
        turn = float(np.abs(np.diff([first, *headings, last])).sum())
        if turn < least:
            best, least = headings, turn
    return best


class RollingBase(Residual[MotionState]):
    """Errors of a planar base that cannot slide, two rows per interval.

    Where it turns: the displacement along x and y [m].  Where it drives: the turn [rad], and the displacement across
    the heading at the interval's beginning [m].
    """

    def __init__(self, n_waypoints: int) -> None:
        """
        Args:
            n_waypoints: of the path; the first coordinates are those of the base.
        """
        self._drives = find_drives(n_waypoints - 1)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        base = self._read(state)
        step = np.diff(base, axis=0)
        across = -np.sin(base[:-1, 2]) * step[:, 0] + np.cos(base[:-1, 2]) * step[:, 1]
        driving, turning = np.stack([step[:, 2], across], axis=1), step[:, :2]
        return np.asarray(np.where(self._drives[:, None], driving, turning).ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        base = self._read(state)
        step, n_intervals = np.diff(base, axis=0), len(base) - 1
        n = state.kinematics.q.shape[1]
        blocks = np.zeros((n_intervals, 2, 2, n))  # interval, row, end, coordinate
        sine, cosine = np.sin(base[:-1, 2]), np.cos(base[:-1, 2])
        for end, sign in ((0, -1.0), (1, 1.0)):
            blocks[:, 0, end, 0] = blocks[:, 1, end, 1] = np.where(self._drives, 0.0, sign)
            blocks[:, 0, end, 2] = np.where(self._drives, sign, 0.0)
            blocks[self._drives, 1, end, 0] = -sign * sine[self._drives]
            blocks[self._drives, 1, end, 1] = sign * cosine[self._drives]
        turned = -cosine * step[:, 0] - sine * step[:, 1]
        blocks[:, 1, 0, 2] += np.where(self._drives, turned, 0.0)
        first = np.repeat(np.arange(n_intervals), 2)
        return AffineRows.from_blocks(self.value(state), first, blocks.reshape(-1, 2, n), state.kinematics.n_waypoints)

    def _read(self, state: MotionState) -> Float[np.ndarray, "T 3"]:
        return np.asarray(state.kinematics.q[:, : len(PLANAR_NAMES)])
