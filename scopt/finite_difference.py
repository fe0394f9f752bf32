"""Derivatives by checked central differences over all waypoints.

Moving one waypoint after the other shows which waypoints a row depends on.  Waypoints that no row shares are then moved
together, so that a residual measured waypoint by waypoint takes ``2 (T + n)`` values and not ``2 T n``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse

from scopt.affine import AffineRows
from scopt.errors import DerivativeError, DerivativeWarning

STEP = float(np.cbrt(np.finfo(float).eps))  # truncation and rounding errors of central differences are alike
LONGER, SHORTER = 16.0, 0.25  # times STEP, for a second opinion
KINK = 1e-3  # a slope that jumps by this fraction of the row's largest slope is looked at with a shorter step
DISAGREEMENT = 1e-3  # between the derivative and a difference over a longer step, as a fraction of the change
ROUNDING = 1e3 * float(np.finfo(float).eps)  # of a value: smaller differences may be rounding
FLAT = 1e-4  # of the largest slope of all rows: errors below it do not matter


@runtime_checkable
class Movable(Protocol):
    """A state that can be measured again at another iterate."""

    @property
    def x(self) -> Float[np.ndarray, "T n"]:
        """The iterate."""
        ...

    def at(self, x: Float[np.ndarray, "T n"]) -> Self:
        """Return the state at another iterate of the same shape."""
        ...


def differentiate(value: Callable[[Any], Float[np.ndarray, "m"]], state: Any, term: str) -> AffineRows:
    """Return value and derivative of a residual of which only the value is known.

    A kink at the iterate, or a derivative that depends on the step, raises a ``DerivativeWarning``.

    Args:
        value: of the residual, (m,) with the same rows around the iterate.
        state: an array (T, n), or a ``Movable``; its ``variable_names``, if it has any, name variables in messages.
        term: name for messages.

    Raises:
        DerivativeError: the state cannot be moved, a value is not finite, or the number of rows changes.
    """
    if isinstance(state, np.ndarray):
        return Differences(value, state, term).linearize()
    if not isinstance(state, Movable):
        raise DerivativeError(
            f"'{term}' has no derivative, and finite differences need a state that is an array (T, n) or has `x` "
            f"and `at(x)`; {type(state).__name__} has not: give it both, or the residual a `linearize`"
        )
    names = getattr(state, "variable_names", ())
    return Differences(lambda x: value(state.at(x)), state.x, term, names).linearize()


@dataclass(frozen=True)
class Differences:
    """A function around one iterate.

    Attributes:
        function: maps an iterate to rows.
        x: (T, n) the iterate.
        term: name for messages.
        names: (n,) of the variables, for messages; may be empty.
    """

    function: Callable[[Float[np.ndarray, "T n"]], Float[np.ndarray, "m"]]
    x: Float[np.ndarray, "T n"]
    term: str
    names: Sequence[str] = ()

    def linearize(self, *, warns: bool = True) -> AffineRows:
        """Return value and derivative; optionally warn of slopes that depend on the step."""
        slope, jump = np.zeros((2, len(self.middle), *self.x.shape))
        for group in self.groups:
            row = np.flatnonzero(group.owner >= 0)
            for variable in range(self.x.shape[1]):
                change = self._differences(group, variable, 1.0)
                slope[row, group.owner[row], variable], jump[row, group.owner[row], variable] = change[:, row]
        if warns and not self._warn_of_kinks(slope, jump):
            self._warn_of_unsettled(slope)
        return AffineRows(self.middle, sparse.csr_array(slope.reshape(len(self.middle), self.x.size)))

    @cached_property
    def middle(self) -> Float[np.ndarray, "m"]:
        """Rows at the iterate."""
        return self._value(self.x, lambda row: "at the iterate")

    @cached_property
    def step(self) -> Float[np.ndarray, "T n"]:
        """Step of each variable."""
        return np.asarray(STEP * np.maximum(1.0, np.abs(self.x)))

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """Waypoints that can be moved together."""
        return group_waypoints(self._find_touched())

    def describe(self, waypoint: int, variable: int) -> str:
        """Return a variable in words."""
        name = f" ('{self.names[variable]}')" if variable < len(self.names) else ""
        return f"waypoint {waypoint}, variable {variable}{name}"

    def _find_touched(self) -> Bool[np.ndarray, "m T"]:
        """Find which waypoints each row depends on."""
        rng = np.random.default_rng(0)  # unlike amounts: equal ones cancel in a difference of two variables
        touched = np.zeros((len(self.middle), len(self.x)), dtype=bool)
        for waypoint in range(len(self.x)):
            for sign in (1.0, -1.0):  # a row may be flat on one side
                moved = self.x.copy()
                moved[waypoint] += sign * self.step[waypoint] * rng.uniform(0.5, 1.0, self.x.shape[1])
                touched[:, waypoint] |= self._value(moved, partial(_beside, waypoint)) != self.middle
        return touched

    def _differences(self, group: Group, variable: int, scale: float) -> Float[np.ndarray, "2 m"]:
        """Return each row's slope and its jump at the iterate along one variable of a group's waypoints."""
        forward, backward = self.x.copy(), self.x.copy()
        at = group.waypoints
        forward[at, variable] += scale * self.step[at, variable]
        backward[at, variable] -= scale * self.step[at, variable]

        def beside(row: int) -> str:
            owner = int(group.owner[row])
            return f"beside the iterate at {self.describe(owner if owner >= 0 else int(at[0]), variable)}"

        ahead, behind = self._value(forward, beside), self._value(backward, beside)
        half = 0.5 * (forward - backward)[group.owner, variable]
        return np.asarray(np.stack([0.5 * (ahead - behind), ahead - 2.0 * self.middle + behind]) / half)

    def _value(self, x: Float[np.ndarray, "T n"], place: Callable[[int], str]) -> Float[np.ndarray, "m"]:
        value = np.asarray(self.function(x), dtype=float)
        if value.ndim != 1:
            raise DerivativeError(f"the value of '{self.term}' must be a vector (m,), got shape {value.shape}")
        if x is not self.x and len(value) != len(self.middle):
            raise DerivativeError(
                f"'{self.term}' has {len(self.middle)} rows at the iterate and {len(value)} beside it; a residual "
                "whose rows come and go needs a `linearize` of its own"
            )
        if not np.isfinite(value).all():
            row = int(np.flatnonzero(~np.isfinite(value))[0])
            raise DerivativeError(f"row {row} of '{self.term}' is {value[row]} {place(row)}")
        return value

    def _warn_of_kinks(self, slope: Float[np.ndarray, "m T n"], jump: Float[np.ndarray, "m T n"]) -> bool:
        """Warn of the slope with the largest jump at the iterate; return whether there is one.

        Across a kink the jump stays as the step shrinks; where the row is merely curved it shrinks with the step.
        """
        steepest = np.abs(slope).max(axis=(1, 2), initial=0.0)[:, None, None]
        jump = np.abs(jump)
        jump[jump <= KINK * steepest + self._rounding[:, None, None] / self.step] = 0.0
        for group in self.groups:
            rows = np.flatnonzero(group.owner >= 0)
            for suspect in np.flatnonzero(jump[rows, group.owner[rows]].any(axis=0)):
                again = np.abs(self._differences(group, int(suspect), SHORTER)[1])[rows]
                entry = rows, group.owner[rows], suspect
                jump[entry] = np.where(again > 0.5 * jump[entry], jump[entry], 0.0)
        if not jump.any():
            return False
        row, waypoint, variable = np.unravel_index(int(np.argmax(jump)), jump.shape)
        self._warn(int(row), int(waypoint), int(variable))
        return True

    def _warn_of_unsettled(self, slope: Float[np.ndarray, "m T n"]) -> None:
        """Warn when a longer difference along all variables at once disagrees."""
        rng = np.random.default_rng(1)
        amount = LONGER * self.step * rng.uniform(0.5, 1.0, self.x.shape) * rng.choice([-1.0, 1.0], self.x.shape)
        ends = [self._value(self.x + sign * amount, lambda row: "beside the iterate") for sign in (1.0, -1.0)]
        parts = slope * amount
        flat = FLAT * float(np.abs(slope).max(initial=0.0)) * float(np.abs(amount).max(initial=0.0))
        bend = np.abs(ends[0] - 2.0 * self.middle + ends[1])
        allowed = DISAGREEMENT * (np.abs(parts).sum(axis=(1, 2)) + bend) + flat + self._rounding
        excess = np.abs(0.5 * (ends[0] - ends[1]) - parts.sum(axis=(1, 2))) - allowed
        worst = int(np.argmax(excess)) if len(excess) else 0
        if not len(excess) or excess[worst] <= 0.0:
            return
        off = np.zeros(self.x.shape)
        for group in self.groups:
            owner = int(group.owner[worst])
            for variable in range(self.x.shape[1]) if owner >= 0 else ():
                off[owner, variable] = abs(
                    self._differences(group, variable, LONGER)[0, worst] - slope[worst, owner, variable]
                )
        self._warn(worst, *divmod(int(np.argmax(off)), self.x.shape[1]))

    @cached_property
    def _rounding(self) -> Float[np.ndarray, "m"]:
        """Changes of each row that may be rounding."""
        return np.asarray(ROUNDING * np.maximum(np.abs(self.middle), np.abs(self.x).max(initial=1.0)))

    def _warn(self, row: int, waypoint: int, variable: int) -> None:
        text = (
            f"the slope of row {row} of '{self.term}' along {self.describe(waypoint, variable)} depends on the step it "
            "is measured with: a kink (abs, max, a switch: let Penalty.ABS or Penalty.HINGE do it) or noise (an inner "
            "iteration, single precision: give the residual a `linearize`)"
        )
        warnings.warn(DerivativeWarning(text, self.term, row, waypoint, variable), stacklevel=2)


def _beside(waypoint: int, row: int) -> str:
    return f"beside the iterate at waypoint {waypoint}"


@dataclass(frozen=True)
class Group:
    """Waypoints that no row shares.

    Attributes:
        waypoints: (g,) their indices.
        owner: (m,) the waypoint of the group that a row depends on, -1 if none.
    """

    waypoints: Int[np.ndarray, "g"]
    owner: Int[np.ndarray, "m"]


def group_waypoints(touched: Bool[np.ndarray, "m T"]) -> tuple[Group, ...]:
    """Sort waypoints into few groups by greedy colouring; waypoints that share a row are in different groups."""
    share = touched.T.astype(int) @ touched.astype(int) > 0
    colour = np.full(touched.shape[1], -1)
    for waypoint in range(len(colour)):
        taken = set(colour[share[waypoint]].tolist())
        colour[waypoint] = next(k for k in range(len(colour)) if k not in taken)
    groups = []
    for k in range(int(colour.max(initial=-1)) + 1):
        waypoints = np.flatnonzero(colour == k)
        here = touched[:, waypoints]
        if here.any():
            groups.append(Group(waypoints, np.where(here.any(axis=1), waypoints[np.argmax(here, axis=1)], -1)))
    return tuple(groups)
