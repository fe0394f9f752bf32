"""Proof by their triangles that two links keep apart: over cells of the positions of the joints between them.

Hulls of concave links overlap where the links do not.  A cell is a box in the coordinates of the joints between two
links.  On a cell of widths w every point p of the moving link stays within

    sum_i w_i^2 / 8 * max |d2p/dq_i^2|

of the hull of its places at the corners of the cell, since interpolation from the corners errs by no more.  So the
triangles keep apart where their hulls at the corners do.  Cells that are too large are halved.  What was proven of a
cell holds for every motion of the robot, and is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin
from jaxtyping import Float, Int

from costs.robot import LinkBody, LinkSurface, read_surface
from costs.stopping import poll
from service.verify.coverage.surface_gap import HeldSurface
from service.verify.joint_chain import JointChain, JointTree
from service.verify.prepared_motion import ForwardKinematics, PreparedMotion

_TURN, _SLIDE = 0.4, 0.1  # widths of the largest cells [rad, m]
_HALVINGS = 6
_MOST_CELLS = 4000  # computed for a pair in one proof
_MOST_INTERVALS = 500  # of a motion, for a pair that has no cells
_MOST_COORDINATES = 4  # with which there are cells
_MOST_SAMPLES = 500
_PARTS = 4  # of a knot interval, in which the range of the coordinates is bounded
_ROUNDING = 1e-9  # of coordinates
_LOOKED = 4  # places of a motion that are looked at before cells
_KEPT = 1000  # pairs whose cells are known
_SURFACES: WeakKeyDictionary[LinkBody, dict[str, LinkSurface | None]] = WeakKeyDictionary()
_BEYOND: WeakKeyDictionary[LinkSurface, dict[tuple[bytes, float], LinkSurface]] = WeakKeyDictionary()
_SPACES: dict[tuple[object, ...], LinkPairSpace] = {}

Cell = tuple[int, tuple[int, ...]]
"""How often it was halved, and its index along each coordinate."""


class LinkPairSpace:
    """Two links, and the coordinates of the joints between them.

    Attributes:
        coordinates: (m,) indices into the configuration.
        known: gap of each cell that was examined [m]; 0 where it is not shown.
    """

    def __init__(self, model: pin.Model, tree: JointTree, first: LinkSurface, second: LinkSurface) -> None:
        """Choose which of the links moves: the one farther from the root.

        Args:
            model: of the robot.
            tree: its joints, with the largest travels of sliding ones.
            first, second: the surfaces of the links.
        """
        is_above = second.joint == 0 or second.joint in tree.ancestors(first.joint)
        holder, self._mover = (second, first) if is_above else (first, second)
        self._holder = HeldSurface(holder)
        self._forward, self._n = ForwardKinematics(model), int(model.nq)
        self._chain = chain = tree.chain(holder.joint, self._mover.joint, self._mover.vertices)
        self.coordinates = np.array(sorted(set(chain.coordinates.tolist())), dtype=int)
        turns = [bool(chain.is_revolute[chain.coordinates == c].any()) for c in self.coordinates]
        self._widths = np.where(np.array(turns, dtype=bool), _TURN, _SLIDE)
        self._bend = _bound_bends(chain, self.coordinates, self._mover.vertices)
        self.known: dict[Cell, float] = {}
        self._nested: dict[Cell, bool] = {}

    @property
    def is_small(self) -> bool:
        """Whether there are few enough coordinates for cells."""
        return len(self.coordinates) <= _MOST_COORDINATES

    def prove(
        self, low: Float[np.ndarray, "I m"], high: Float[np.ndarray, "I m"], places: Float[np.ndarray, "P m"]
    ) -> float:
        """Return a lower bound of the gap wherever the coordinates are in one of the boxes; 0 if there is none [m].

        Args:
            low, high: corners of the boxes.
            places: in them, looked at first; neither link may be inside the other at the first one.
        """
        gap, todo, computed, start = np.inf, self._list_cells(low, high), 0, places[0]
        begin: Cell | None = None
        is_known = all(cell in self.known for cell in todo)
        if not is_known and any(self._measure(place, place) == 0.0 for place in places):
            return 0.0
        while todo:
            poll()
            cell = todo.pop()
            if cell not in self.known:
                computed += 1
                if computed > _MOST_CELLS:
                    return 0.0
                self.known[cell] = self._measure(*self._bounds(cell))
            own = self.known[cell]
            if own > 0.0:
                gap = min(gap, own)
                lower, upper = self._bounds(cell)
                if begin is None and np.all((lower <= start) & (start <= upper)):
                    begin = cell
            elif cell[0] >= _HALVINGS:
                return 0.0
            else:
                todo += self._halve(cell, low, high)
        return 0.0 if begin is None or self._is_nested(begin, start) else float(gap)

    def prove_along(self, prepared: PreparedMotion, places: Float[np.ndarray, "P"]) -> float:
        """Return a lower bound of the gap along a motion, for links with many joints between; 0 if there is none [m].

        Args:
            prepared: the motion, which is split until the triangles keep apart by more than they leave their chords.
            places: path parameters that are looked at first; neither link may be inside the other at the first one.
        """
        at = prepared.motion.curve(places)[:, self.coordinates]
        if any(self._measure(place, place) == 0.0 for place in at) or self._is_nested(None, at[0]):
            return 0.0
        edges, gap, computed = prepared.edges.tolist(), np.inf, 0
        todo = [(first, last, 0) for first, last in pairwise(edges) if last > first]
        while todo:
            poll()
            first, last, level = todo.pop()
            over = prepared.over(np.array([first]), np.array([last]))
            stray = float((self._chain.deviation(over) + self._chain.sampling_slack(over, _ROUNDING))[0])
            ends = prepared.motion.curve(np.array([first, last]))[:, self.coordinates]
            own = self._holder.bound_gap(
                self._mover.triangles, self._place(ends), np.full(len(self._mover.vertices), stray)
            )
            computed += 1
            if own > 0.0:
                gap = min(gap, own)
            elif level >= _HALVINGS or computed > _MOST_INTERVALS:
                return 0.0
            else:
                middle = 0.5 * (first + last)
                todo += [(first, middle, level + 1), (middle, last, level + 1)]
        return float(gap)

    def _list_cells(self, low: Float[np.ndarray, "I m"], high: Float[np.ndarray, "I m"]) -> list[Cell]:
        """Return the largest cells that meet a box."""
        first, last = (np.floor(side / self._widths).astype(int) for side in (low, high))
        found: set[tuple[int, ...]] = set()
        for lower, upper in {(tuple(a), tuple(b)) for a, b in zip(first.tolist(), last.tolist(), strict=True)}:
            found.update(product(*(range(a, b + 1) for a, b in zip(lower, upper, strict=True))))
        return [(0, index) for index in sorted(found)]

    def _halve(self, cell: Cell, low: Float[np.ndarray, "I m"], high: Float[np.ndarray, "I m"]) -> list[Cell]:
        """Return the halves of a cell along all coordinates that meet a box."""
        level, index = cell
        halves = [(level + 1, half) for half in product(*((2 * k, 2 * k + 1) for k in index))]
        bounds = [self._bounds(half) for half in halves]
        return [
            half
            for half, (lower, upper) in zip(halves, bounds, strict=True)
            if np.any(np.all((low <= upper) & (high >= lower), axis=1))
        ]

    def _bounds(self, cell: Cell) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
        width = self._widths / 2.0 ** cell[0]
        return np.array(cell[1]) * width, (np.array(cell[1]) + 1) * width

    def _measure(self, lower: Float[np.ndarray, "m"], upper: Float[np.ndarray, "m"]) -> float:
        """Return a lower bound of the gap in a box, 0 where none is shown [m]."""
        width = upper - lower
        corners = np.array(list(product(*zip(lower, upper, strict=True)))) if width.any() else lower[None]
        return self._holder.bound_gap(self._mover.triangles, self._place(corners), (width**2 / 8.0) @ self._bend)

    def _place(self, at: Float[np.ndarray, "K m"]) -> Float[np.ndarray, "K V 3"]:
        """Return the corners of the moving link in the frame of the other one."""
        q = np.zeros((len(at), self._n))
        q[:, self.coordinates] = at
        turned, shifted = self._forward.at(q).relative(self._holder.surface.joint, self._mover.joint)
        return np.asarray(self._mover.vertices @ np.swapaxes(turned, -1, -2) + shifted[:, None])

    def _is_nested(self, cell: Cell | None, at: Float[np.ndarray, "m"]) -> bool:
        """Return whether one link is inside the other, which in a cell where they keep apart is the same everywhere."""
        if cell is None or cell not in self._nested:
            holder, mover = self._holder.surface, self._mover
            q = np.zeros((1, self._n))
            q[:, self.coordinates] = at
            turned, shifted = (part[0] for part in self._forward.at(q).relative(holder.joint, mover.joint))
            inward = mover.samples[:_MOST_SAMPLES] @ turned.T + shifted
            outward = (holder.samples[:_MOST_SAMPLES] - shifted) @ turned
            is_nested = bool(holder.holds(inward).any() or mover.holds(outward).any())
            if cell is None:
                return is_nested
            self._nested[cell] = is_nested
        return self._nested[cell]


def _bound_bends(
    chain: JointChain, coordinates: Int[np.ndarray, "m"], points: Float[np.ndarray, "V 3"]
) -> Float[np.ndarray, "m V"]:
    """Bound ``|d2p/dq^2|`` of each point for each coordinate, which several joints of the chain may follow [m]."""
    length = np.linalg.norm(points, axis=1)
    farthest = float(length.max())
    bends = np.zeros((len(coordinates), len(points)))
    for k, coordinate in enumerate(coordinates.tolist()):
        rows = np.flatnonzero(chain.coordinates == coordinate).tolist()
        for i in rows:
            for j in rows:
                distal, proximal = max(i, j), min(i, j)
                if not chain.is_revolute[proximal]:
                    continue
                reach = chain.reach[distal] - farthest + length if chain.is_revolute[distal] else 1.0
                bends[k] += chain.ratio[i] * chain.ratio[j] * reach
    return bends


def bound_ranges(
    prepared: PreparedMotion, coordinates: Int[np.ndarray, "m"]
) -> tuple[Float[np.ndarray, "I m"], Float[np.ndarray, "I m"]]:
    """Return boxes that contain the coordinates along the whole motion, between exported samples too."""
    share = np.linspace(0.0, 1.0, _PARTS + 1)
    starts, ends = prepared.edges[:-1, None], prepared.edges[1:, None]
    places = starts + share * (ends - starts)
    places[:, -1] = prepared.edges[1:]
    first, last = places[:, :-1].ravel(), places[:, 1:].ravel()
    is_long = last > first
    over = prepared.over(first[is_long], last[is_long])
    at_first, at_last = (prepared.motion.curve(side)[:, coordinates] for side in (over.first, over.last))
    off = over.length[:, None] ** 2 / 8.0 * over.bend[:, coordinates]
    off = off + over.step[:, None] ** 2 / 8.0 * over.step_bend[:, coordinates] + _ROUNDING
    return np.minimum(at_first, at_last) - off, np.maximum(at_first, at_last) + off


@dataclass
class SurfaceProofs:
    """Proofs about the surfaces of pairs of links along one motion.

    Attributes:
        prepared: the motion.
        gaps: proven gap by pair [m].
    """

    prepared: PreparedMotion
    gaps: dict[tuple[str, str], float] = field(default_factory=dict)

    def keep_apart(self, pair: tuple[str, str], at: float) -> bool:
        """Return whether the surfaces of two links are proven to keep apart along the motion.

        Args:
            pair: names of the links.
            at: path parameter at which their hulls overlap most.
        """
        surfaces = [self._read(link) for link in pair]
        gap = self._prove(surfaces[0], surfaces[1], at)
        if gap > 0.0:
            self.gaps[pair] = gap
        return gap > 0.0

    def have_meshes(self, pair: tuple[str, str]) -> bool:
        """Return whether more is known of two links than their hulls."""
        surfaces = [self._read(link) for link in pair]
        return all(surface is not None for surface in surfaces) and any(s is not None and s.has_mesh for s in surfaces)

    def keep_apart_beyond(
        self, pair: tuple[str, str], at: float, centres: Sequence[Float[np.ndarray, "3"]], radius: float
    ) -> bool:
        """Return whether two links meet only within balls about joints between them.

        Args:
            pair: names of the links.
            at: path parameter at which their hulls overlap most.
            centres: of the ball of each link, in the frame of its joint [m].
            radius: of the balls [m].
        """
        surfaces = [self._read(link) for link in pair]
        for k in (0, 1):
            own, other = surfaces[k], surfaces[1 - k]
            if own is None or other is None:
                return False
            far = self._read_beyond(own, centres[k], radius)
            if len(far.triangles) and self._prove(*((far, other) if k == 0 else (other, far)), at) == 0.0:
                return False
        return True

    def _read(self, link: str) -> LinkSurface | None:
        robot = self.prepared.motion.robot
        first = next(body for body in robot.bodies if body.link == link)
        known = _SURFACES.setdefault(first, {})
        if link not in known:
            known[link] = read_surface(robot, link)
        return known[link]

    @staticmethod
    def _read_beyond(own: LinkSurface, centre: Float[np.ndarray, "3"], radius: float) -> LinkSurface:
        known = _BEYOND.setdefault(own, {})
        key = (centre.tobytes(), radius)
        if key not in known:
            known[key] = own.beyond(centre, radius)
        return known[key]

    def _prove(self, first: LinkSurface | None, second: LinkSurface | None, at: float) -> float:
        if first is None or second is None or not (first.has_mesh or second.has_mesh):
            return 0.0
        space = self._find_space(first, second)
        knots = self.prepared.motion.curve.knots
        places = np.array([knots[0], at, *np.linspace(knots[0], knots[-1], _LOOKED)[1:]])
        if not space.is_small:
            return space.prove_along(self.prepared, places)
        low, high = bound_ranges(self.prepared, space.coordinates)
        return space.prove(low, high, self.prepared.motion.curve(places)[:, space.coordinates])

    def _find_space(self, first: LinkSurface, second: LinkSurface) -> LinkPairSpace:
        """Return the space of a pair, known from earlier motions of the same robot."""
        robot, tree = self.prepared.motion.robot, make_tree(self.prepared)
        key = (robot.source.urdf, robot.model.nq, tree.travels, first.digest, second.digest)
        space = _SPACES.pop(key, None) or LinkPairSpace(robot.model, tree, first, second)
        while len(_SPACES) >= _KEPT:
            _SPACES.pop(next(iter(_SPACES)), None)
        _SPACES[key] = space  # the last one used is the last one dropped
        return space


def make_tree(prepared: PreparedMotion) -> JointTree:
    """Return the robot's joints with the travels that their limits allow: what is proven holds for any motion."""
    robot = prepared.motion.robot
    low, high = prepared.range
    within = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
    travel = np.where(np.isfinite(within), within, np.maximum(np.abs(low).max(axis=0), np.abs(high).max(axis=0)))
    return JointTree(robot.model, travel, 6 if robot.is_floating else 0)
