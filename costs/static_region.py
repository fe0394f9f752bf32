"""Places of the centre of mass at which contact forces hold the robot still, with the forces that prove it.

Bretl and Lall, Testing static equilibrium for legged robots, T-RO 2008: for contacts fixed in the world these places
are a convex polygon in (x, y), whatever the height. Cones of friction and balances of forces are convex: a centre of
mass inside the polygon is held by the same combination of forces (witnesses) as it is of the vertices. No solver is
needed to check a region (``service.verify.forces.equilibrium``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import highspy
import numpy as np
from jaxtyping import Float

from costs.contact import GRAVITY, N_PYRAMID_EDGES, WorldContacts
from costs.support import SupportPolygon

# Shorter edges are merged, narrower regions are degenerate [m].
_RESOLUTION_M = 1e-4
# A region is found to within the larger of the resolution and this share of its size: feet to 0.1 mm, places between
# walls that are metres apart to a millimetre.
_RELATIVE_RESOLUTION = 4e-4
_FIRST_DIRECTIONS = tuple(np.array([np.cos(t), np.sin(t)]) for t in 0.1 + np.arange(3) * 2.0 * np.pi / 3.0)
_FLAT_M = 1e-7  # a corner that sticks out by less is left out
# Forces balance to this share of the weight (moments: times 1 m).
_BALANCE_TOLERANCE = 5e-7
_SHARE_TOLERANCE = 1e-9  # below zero or beyond a cap, of a force from a known basis [weight]
# Least price of contact force in the search for the farthest place [m per weight]: of forces that are equally good for
# the place, the smallest are taken. Places are less far by at most the price times the sum of forces.
_FORCE_PRICE_M = 1e-5
# Soles count as level and at one height within these: more height or lean only enlarges what friction can hold.
_LEVEL_M, _LEVEL_SINE = 1e-3, 1e-6
# The yaw moment that covers drift starts this much above that of the forces without it, which is mostly enough, and is
# raised a few times.
_FIRST_YAW_ROOM, _YAW_ROOM, _N_YAW_ROUNDS = 1.25, 1.05, 12


class StaticRegionError(ValueError):
    """Error for a stance without a region.

    Attributes:
        wrench: index of the given wrench, None where it takes several wrenches to leave no region.
    """

    def __init__(self, message: str, wrench: int | None) -> None:
        super().__init__(message)
        self.wrench = wrench


class NothingHoldsError(StaticRegionError):
    """Error for wrenches under which no place of the centre of mass was found to be in equilibrium.

    It is no proof of impossibility: forces were sought in pyramids inside the friction cones.
    """


class DegenerateRegionError(StaticRegionError):
    """Error for a region that is a line or a point, as that of two contact points: no motion keeps a margin in it."""


@dataclass(frozen=True)
class StaticRegion:
    """Convex polygon of places of the centre of mass, and contact forces that hold the robot at its vertices.

    The robot is held at every place inside and under every wrench in the convex hull of ``wrenches``.

    Attributes:
        vertices: (V, 2) world x and y, counter-clockwise [m].
        witnesses: (V, W, C, 3) forces of the world on the robot at each contact point, per vertex and wrench [N].
        wrenches: (W, 6) force and moment about the world origin that the world puts on the robot besides the contacts
            [N, Nm]. With drift, those that need tangential forces stand twice, with yaw moments of both signs.
        shift_m: part of the margin that is lost where contact points drift from their places.
    """

    vertices: Float[np.ndarray, "V 2"]
    witnesses: Float[np.ndarray, "V W C 3"]
    wrenches: Float[np.ndarray, "W 6"]
    shift_m: float

    @cached_property
    def polygon(self) -> SupportPolygon:
        """The region with its edges; ``shift_m`` is not taken off."""
        return SupportPolygon.of_points(self.vertices)

    def margin(self, points: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N"]:
        """Return each point's distance from the nearest edge line less ``shift_m``, negative outside [m]."""
        return self.polygon.margin(points) - self.shift_m

    def contains(self, points: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N"]:
        """Return whether the robot is held with its centre of mass above each point, drift included."""
        return np.asarray(self.margin(points) >= 0.0)


def find_static_region(
    contacts: WorldContacts,
    mass: float,
    wrenches: Float[np.ndarray, "W 6"] | None = None,
    drift_m: float = 0.0,
    tilt_rad: Float[np.ndarray, "#C"] | float = 0.0,
) -> StaticRegion:
    """Return the places of the centre of mass at which contact forces hold the robot under each of the wrenches.

    Contact points that are off by up to ``drift_m`` make moments of at most ``drift_m * sum |f|``. The horizontal ones
    act like a centre of mass that is off by ``shift_m``. The one about z is covered by holding each wrench with the
    opposite yaw moments ``+-drift_m * sum |f_xy|`` added: some combination of both holds none.

    Args:
        contacts: points with friction and caps in the world; none on a mechanism that moves freely.
        mass: of the robot with what it carries [kg].
        wrenches: (W, 6) force and moment about the world origin that the world puts on the robot besides the contacts
            [N, Nm]; None for no load. The region is the intersection over all of them.
        drift_m: farthest that a contact point may be from its place.
        tilt_rad: largest angle of a contact's normal off its direction; one for all points, or (C,).

    Raises:
        NothingHoldsError: some wrench, or all of them together, can be held nowhere.
        DegenerateRegionError: the places are a line or a point.
        ValueError: an argument is not finite, out of range, or has a wrong shape.
    """
    if not 0.0 < mass < np.inf:
        raise ValueError(f"mass must be positive and finite, got {mass:g}")
    if not 0.0 <= drift_m < np.inf:
        raise ValueError(f"drift_m must be finite and not negative, got {drift_m:g}")
    given = np.zeros((1, 6)) if wrenches is None else np.array(wrenches, dtype=float)
    if given.ndim != 2 or given.shape[1] != 6 or not len(given):
        raise ValueError(f"wrenches must have shape (W, 6) with W at least 1, got {given.shape}")
    if not np.isfinite(given).all():
        raise ValueError(f"wrenches[{int((~np.isfinite(given)).any(axis=1).argmax())}] must be finite")
    search = _Search(contacts.tilt_normals(tilt_rad), mass * GRAVITY, drift_m)
    held, regions = _cover_drift(search, given, drift_m)
    vertices, witnesses = _intersect(regions)
    total = np.linalg.norm(witnesses, axis=3).sum(axis=2).max()
    return StaticRegion(vertices, witnesses, held, float(total * drift_m / search.weight))


@dataclass(frozen=True)
class _Region:
    """Region under one wrench: vertices (V, 2) counter-clockwise [m], and forces (V, C, 3) that hold there [N]."""

    vertices: Float[np.ndarray, "V 2"]
    forces: Float[np.ndarray, "V C 3"]

    @property
    def most_tangential(self) -> float:
        """Largest sum of horizontal forces of a vertex [N]."""
        return float(np.linalg.norm(self.forces[:, :, :2], axis=2).sum(axis=1).max())


def _cover_drift(
    search: _Search, given: Float[np.ndarray, "G 6"], drift_m: float
) -> tuple[Float[np.ndarray, "W 6"], list[_Region]]:
    """Return wrenches and their regions; those that need tangential forces twice, with opposite yaw moments added.

    Larger moments need larger forces, which make larger moments: the moment, one for all, is raised until it covers
    what all forces make.
    """
    largest = int(np.linalg.norm(given, axis=1).argmax())
    alone = search.find_region(given[largest], largest)
    yaw = _FIRST_YAW_ROOM * drift_m * alone.most_tangential
    for _ in range(_N_YAW_ROUNDS):
        held: list[Float[np.ndarray, "6"]] = []
        regions: list[_Region] = []
        for i, wrench in enumerate(given):
            if yaw <= 1e-9 * search.weight or search.holds_without_friction(wrench):
                held.append(wrench)
                regions.append(alone if i == largest else search.find_region(wrench, i))
                continue
            for moment in (-yaw, yaw):
                held.append(wrench + np.array([0.0, 0.0, 0.0, 0.0, 0.0, moment]))
                regions.append(search.find_region(held[-1], i))
        needed = drift_m * max(region.most_tangential for region in regions)
        if needed <= max(yaw, 1e-9 * search.weight):
            return np.array(held), regions
        yaw = _YAW_ROOM * needed
    raise NothingHoldsError(
        f"contact points that drift by {1e3 * drift_m:g} mm turn the robot more than friction can hold", None
    )


@dataclass(frozen=True)
class _Place:
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
        x0, y0 = _FIRST_DIRECTIONS[0].tolist()
        return math.atan2(x0 * y - y0 * x, x0 * x + y0 * y) % math.tau


@dataclass(frozen=True)
class _Basis:
    """Basis of a linear program, which is the best for its direction: its shares are ``gain @ bounds of the rows``."""

    direction: Float[np.ndarray, "2"]
    gain: Float[np.ndarray, "columns rows"]


class _Search:
    """Linear programs of one set of contacts, solved one after the other from the last basis.

    Variables are the forces along the edges and the normal of each pyramid, in weights, per unit of normal force.
    Moments are about the middle of the points; those about x and y give the centre of mass.
    """

    def __init__(self, contacts: WorldContacts, weight: float, drift_m: float) -> None:
        self.weight = weight
        self._contacts = contacts
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

    def holds_without_friction(self, wrench: Float[np.ndarray, "6"]) -> bool:
        """Return whether level soles carry the robot without load, and each point may carry all of it."""
        contacts = self._contacts
        lean = float(np.linalg.norm(contacts.normals[:, :2], axis=1).max())
        is_level = contacts.normals[:, 2].min() > 0.0 and lean <= min(_LEVEL_SINE, float(contacts.friction.min()))
        is_at_one_height = np.ptp(contacts.points[:, 2]) <= _LEVEL_M
        return bool(is_level and is_at_one_height and contacts.caps.min() >= self.weight and not wrench.any())

    def find_region(self, wrench: Float[np.ndarray, "6"], index: int) -> _Region:
        """Return the region under one wrench, which the errors call ``index``.

        Raises:
            NothingHoldsError: no program has a solution.
            DegenerateRegionError: the region is a line or a point.
        """
        if self.holds_without_friction(wrench):
            vertices, forces = self._list_sole_corners()
        else:
            vertices, forces = self._search_region(wrench, index)
        kept = _simplify(vertices)
        vertices, forces = vertices[kept], forces[kept]
        _refuse_degenerate(vertices, f"under wrench {index}", index)
        return _Region(vertices, forces)

    def _list_sole_corners(self) -> tuple[Float[np.ndarray, "V 2"], Float[np.ndarray, "V C 3"]]:
        points = self._contacts.points[:, :2]
        try:
            corners = SupportPolygon.of_points(points).vertices
        except ValueError:  # one line, or fewer points than three
            along = points - points[0]
            far = int(np.linalg.norm(along, axis=1).argmax())
            reach = along @ along[far]
            corners = points[[int(reach.argmin()), int(reach.argmax())]]
        nearest = np.linalg.norm(corners[:, None] - points, axis=2).argmin(axis=1)
        forces = np.zeros((len(corners), len(points), 3))
        forces[np.arange(len(corners)), nearest, 2] = self.weight
        return corners, forces

    def _search_region(
        self, wrench: Float[np.ndarray, "6"], index: int
    ) -> tuple[Float[np.ndarray, "V 2"], Float[np.ndarray, "V C 3"]]:
        """Return places that are farthest in chosen directions, counter-clockwise, and their forces.

        Where the tangents at two neighbouring places leave room for more than the resolution, the direction that their
        edge faces is tried.
        """
        self._set_wrench(wrench)
        places = self._recall_places()
        for direction in _FIRST_DIRECTIONS:
            if not any(np.array_equal(direction, known.direction) for known in places):
                places.append(self._find_farthest(direction, index))
        places.sort(key=lambda place: place.turn)
        at = np.array([place.at for place in places])
        size = float(np.linalg.norm(np.diff(at, axis=0), axis=1).max())
        resolution = max(_RESOLUTION_M, _RELATIVE_RESOLUTION * size)
        done = 0
        while done < len(places):
            first, second = places[done], places[(done + 1) % len(places)]
            if _room_beyond(first, second) > resolution:
                edge = second.at - first.at
                facing = np.array([edge[1], -edge[0]]) / np.linalg.norm(edge)
                farthest = self._find_farthest(facing, index)
                if facing @ (farthest.at - first.at) > resolution:
                    places.insert(done + 1, farthest)
                    continue
            done += 1
        shares = np.array([place.shares for place in places]).reshape(len(places), *self._edges.shape[:2])
        forces = self.weight * np.einsum("vck,cki->vci", shares, self._edges)
        return np.array([place.at for place in places]) + self._origin[:2] + self._offset, forces

    def _set_wrench(self, wrench: Float[np.ndarray, "6"]) -> None:
        force = wrench[:3] / self.weight
        moment = (wrench[3:] - np.cross(self._origin, wrench[:3])) / self.weight
        self._offset = np.array([-moment[1], moment[0]])
        self._target = np.array([-force[0], -force[1], 1.0 - force[2], -moment[2]])
        for row, value in enumerate(self._target):
            self._solver.changeRowBounds(row, value, value)

    def _recall_places(self) -> list[_Place]:
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
        return [_Place(at[k], shares[k], self._bases[k].direction) for k in np.flatnonzero(holds)]

    def _find_farthest(self, direction: Float[np.ndarray, "2"], index: int) -> _Place:
        """Return the farthest place in a direction, without the wrench's own offset."""
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
        return _Place(self._place @ shares, shares, direction)

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


def _room_beyond(first: _Place, second: _Place) -> float:
    """Return how far a region may reach beyond the edge of two places that are farthest in their directions [m]."""
    (x1, y1), (x2, y2) = first.direction.tolist(), second.direction.tolist()
    along, across = (second.at - first.at).tolist()
    length = math.hypot(along, across)
    if length < _RESOLUTION_M:
        return 0.0
    turn = x1 * y2 - y1 * x2
    if turn < 1e-9:
        return 0.0 if x1 * x2 + y1 * y2 > 0.0 else math.inf
    # the tangents meet at first + u: d1 . u = 0 and d2 . u = d2 . edge
    scale = (x2 * along + y2 * across) / turn
    return float(scale * (-y1 * across - x1 * along) / length)


def _simplify(vertices: Float[np.ndarray, "V 2"]) -> list[int]:
    """Return the vertices to keep so that no edge is short and no corner flat; the polygon only gets smaller."""
    points = vertices.tolist()
    kept = list(range(len(points)))
    i = 0
    while i < len(kept) and len(kept) > 1:
        (x0, y0), (x1, y1), (x2, y2) = (points[kept[k % len(kept)]] for k in (i - 1, i, i + 1))
        turn = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
        is_short = math.hypot(x1 - x0, y1 - y0) < _RESOLUTION_M
        is_flat = len(kept) > 2 and turn < _FLAT_M * math.hypot(x2 - x0, y2 - y0)
        if is_short or is_flat:
            del kept[i]
            i = max(i - 1, 0)
        else:
            i += 1
    return kept


def _refuse_degenerate(vertices: Float[np.ndarray, "V 2"], place: str, index: int | None) -> None:
    """Raise DegenerateRegionError for a polygon that is nowhere wider than the resolution."""
    apart = np.linalg.norm(vertices[:, None] - vertices, axis=2)
    i, j = np.unravel_index(int(apart.argmax()), apart.shape)
    length = float(apart[i, j])
    if length >= _RESOLUTION_M:
        across = (vertices - vertices[i]) @ np.array([[0.0, -1.0], [1.0, 0.0]]) @ (vertices[j] - vertices[i]) / length
        if np.ptp(across) >= _RESOLUTION_M:
            return
        shape = f"a line {length:.3f} m long from ({_xy(vertices[i])}) to ({_xy(vertices[j])})"
    else:
        shape = f"the point ({_xy(vertices[0])})"
    raise DegenerateRegionError(
        f"{place}, contact forces hold the robot only with its centre of mass on {shape}; "
        "a motion needs a region with an area (three contact points that are not on a line)",
        index,
    )


def _xy(point: Float[np.ndarray, "2"]) -> str:
    return f"{point[0]:.3f}, {point[1]:.3f}"


def _intersect(regions: Sequence[_Region]) -> tuple[Float[np.ndarray, "V 2"], Float[np.ndarray, "V W C 3"]]:
    """Return the vertices of the intersection of the regions, and the forces that hold there under each wrench.

    Raises:
        NothingHoldsError: they have no point in common.
        DegenerateRegionError: what they have in common is a line or a point.
    """
    vertices = regions[0].vertices
    if len(regions) == 1:
        return vertices, regions[0].forces[:, None]
    together = f"under all {len(regions)} wrenches together"
    for region in regions[1:]:
        vertices = _clip(vertices, region.vertices)
        if not len(vertices):
            raise NothingHoldsError(
                f"each wrench alone is held somewhere, but no place of the centre of mass is held {together}", None
            )
    vertices = vertices[_simplify(vertices)]
    _refuse_degenerate(vertices, together, None)
    return vertices, np.stack([_combine_forces(region, vertices) for region in regions], axis=1)


def _clip(polygon: Float[np.ndarray, "V 2"], by: Float[np.ndarray, "E 2"]) -> Float[np.ndarray, "U 2"]:
    """Return the part of a convex polygon inside another (Sutherland and Hodgman, CACM 1974)."""
    for start, end in zip(by, np.roll(by, -1, axis=0), strict=True):
        if not len(polygon):
            break
        edge = end - start
        outside = ((polygon - start) @ np.array([edge[1], -edge[0]])) / np.linalg.norm(edge)
        if outside.max() <= 0.0:
            continue
        following, outside_next = np.roll(polygon, -1, axis=0), np.roll(outside, -1)
        parts = []
        for p, q, a, b in zip(polygon, following, outside, outside_next, strict=True):
            if a <= 0.0:
                parts.append(p)
            if (a < 0.0 < b) or (b < 0.0 < a):
                parts.append(p + a / (a - b) * (q - p))
        polygon = np.array(parts).reshape(-1, 2)
    return polygon


def _combine_forces(region: _Region, places: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N C 3"]:
    """Return forces at places inside the region: the combination of a triangle of its vertices."""
    # Fan of triangles from the vertex with the least force, so that combinations need little.
    base = int(np.linalg.norm(region.forces, axis=2).sum(axis=1).argmin())
    order = np.roll(np.arange(len(region.vertices)), -base)
    corners = np.stack([np.full(len(order) - 2, order[0]), order[1:-1], order[2:]], axis=1)
    a, b, c = np.moveaxis(region.vertices[corners], 1, 0)
    areas = _turn(b - a, c - a)
    usable = areas > 1e-12
    corners, a, b, c, areas = corners[usable], a[usable], b[usable], c[usable], areas[usable]
    at = places[:, None]
    shares = np.stack([_turn(b - at, c - at), _turn(c - at, a - at), _turn(a - at, b - at)], axis=2) / areas[:, None]
    best = shares.min(axis=2).argmax(axis=1)
    chosen = np.maximum(shares[np.arange(len(places)), best], 0.0)
    chosen /= chosen.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("nk,nkci->nci", chosen, region.forces[corners[best]]))


def _turn(u: Float[np.ndarray, "... 2"], v: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "..."]:
    """Return the z of the cross products of vectors in the plane."""
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
