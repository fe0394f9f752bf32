"""Templates: parts of an object by its sizes, what must be empty, and what the object hangs on or stands on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from perception.detect.engine.primitives import Box, Primitive

Mount = Literal["support", "face", "pipe", "none"]


@dataclass(frozen=True)
class Size:
    """A size that is fitted.

    Attributes:
        low, high: its limits [m].
        usual, spread: mean and standard deviation of such objects [m].
        source: where the limits and the mean come from.
    """

    name: str
    low: float
    high: float
    usual: float
    spread: float
    source: str


@dataclass(frozen=True)
class Part:
    """Part of an object.

    Attributes:
        solid: its primitive.
        must_show: whether a hit needs rays that ended on it, where it can be seen.
    """

    name: str
    solid: Primitive
    must_show: bool = True


@dataclass(frozen=True)
class Looseness:
    """Standard deviations of an object's pose against what holds it.

    Attributes:
        tilt: of its orientation, but about the support's normal [rad].
        height: along the support's normal [m].
        level: of the x axis of an object at rest from level, if it is not clearly turned; infinite: any [rad].
    """

    tilt: float
    height: float
    level: float = np.inf


@dataclass(frozen=True)
class Starts:
    """Where fits of a kind begin.

    Attributes:
        sizes: (K, S) sizes to begin with [m].
        over: heights over a support or face in which the object has points [m].
        postures: (P, 3, 3) orientations on the plane, its normal along z, before the turn about it.
        lifts: (P,) height of the origin over the plane in each posture; NaN where the points have it [m].
        n_turns: turns about the normal, or without a plane directions of the axis ``spread``.
        spread: axis of the object that is led to all directions.
        n_spins: turns about it.
        near: radius in which points are averaged to a place [m].
        is_slender: whether the x axis may follow the points about a place.
        part: template of the first sizes alone, along the same x axis; fits begin where it fits, either way round.
    """

    sizes: Float[np.ndarray, "K S"]
    over: tuple[float, float] = (0.0, 0.0)
    postures: Float[np.ndarray, "P 3 3"] = field(default_factory=lambda: np.eye(3)[None])
    lifts: Float[np.ndarray, "P"] = field(default_factory=lambda: np.array([np.nan]))
    n_turns: int = 16
    spread: int = 0
    n_spins: int = 1
    near: float = 0.1
    is_slender: bool = False
    part: Template | None = None


def _along_own_axes(sizes: dict[str, Float[np.ndarray, "B"]]) -> Float[np.ndarray, "B 3 3"]:
    return np.tile(np.eye(3), (len(next(iter(sizes.values()))), 1, 1))


def _at_own_origin(sizes: dict[str, Float[np.ndarray, "B"]]) -> Float[np.ndarray, "B 3"]:
    return np.zeros((len(next(iter(sizes.values()))), 3))


@dataclass(frozen=True)
class Template:
    """A kind of object.

    Attributes:
        kind: name of the kind.
        sizes: sizes that are fitted.
        build: parts by sizes, an array (B,) per name; in the object's frame.
        hollows: boxes that must be empty, by sizes; rays through them that miss all parts must end beyond.
        mount: what it stands on or hangs on.
        looseness: of its pose against the mount.
        reach: radius of a sphere about ``middle`` that holds it, without ``extent`` [m].
        extent: size half of which adds to ``reach``; empty if none does.
        middle: centre of the object by sizes, (B, 3) [m].
        model_sigma: how far real surfaces are from the parts' [m].
        starts: where fits begin about a click; None: nowhere.
        origin: of the frame that users see, by sizes, in the template's [m].
        axes: rotation of that frame in the template's, by sizes.
        show: sizes that users see, by the template's.
    """

    kind: str
    sizes: tuple[Size, ...]
    build: Callable[[dict[str, Float[np.ndarray, "B"]]], tuple[Part, ...]]
    hollows: Callable[[dict[str, Float[np.ndarray, "B"]]], tuple[Box, ...]]
    mount: Mount
    looseness: Looseness
    reach: float
    middle: Callable[[dict[str, Float[np.ndarray, "B"]]], Float[np.ndarray, "B 3"]]
    model_sigma: float
    extent: str = ""
    starts: Starts | None = None
    origin: Callable[[dict[str, Float[np.ndarray, "B"]]], Float[np.ndarray, "B 3"]] = _at_own_origin
    axes: Callable[[dict[str, Float[np.ndarray, "B"]]], Float[np.ndarray, "B 3 3"]] = _along_own_axes
    show: Callable[[dict[str, float]], dict[str, float]] = dict

    def named(self, sizes: Float[np.ndarray, "B S"]) -> dict[str, Float[np.ndarray, "B"]]:
        """Return the sizes by name."""
        return {size.name: sizes[:, i] for i, size in enumerate(self.sizes)}

    def solids(self, sizes: Float[np.ndarray, "B S"]) -> list[Primitive]:
        """Return the primitives of B objects."""
        return [part.solid for part in self.build(self.named(sizes))]

    def radii(self, sizes: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B"]:
        """Return the radii of spheres about the middles that hold B objects [m]."""
        more = 0.5 * self.named(sizes)[self.extent] if self.extent else np.zeros(len(sizes))
        return np.asarray(self.reach + more)

    @property
    def radius(self) -> float:
        """Radius at the usual sizes [m]."""
        return float(self.radii(self.usual[None])[0])

    @property
    def usual(self) -> Float[np.ndarray, "S"]:
        """(S,) usual sizes [m]."""
        return np.array([size.usual for size in self.sizes])

    @property
    def spread(self) -> Float[np.ndarray, "S"]:
        """(S,) standard deviations of the sizes [m]."""
        return np.array([size.spread for size in self.sizes])

    def clip(self, sizes: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B S"]:
        """Return sizes moved into their limits."""
        return np.asarray(np.clip(sizes, [size.low for size in self.sizes], [size.high for size in self.sizes]))


def columns(*values: Float[np.ndarray, "B"] | float) -> Float[np.ndarray, "B 3"]:
    """Return coordinates as rows; a number counts for all rows."""
    rows = np.empty((max(np.size(value) for value in values), len(values)))
    for i, value in enumerate(values):
        rows[:, i] = value
    return rows
