"""Places of the centre of mass at which contact forces hold the robot, found under each wrench and covering drift."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from costs.contact import GRAVITY, WorldContacts
from costs.static_region.errors import NothingHoldsError
from costs.static_region.farthest_places import FIRST_DIRECTIONS, FarthestPlaces, measure_room_beyond
from costs.static_region.polygons import (
    RESOLUTION_M,
    HeldPolygon,
    intersect_polygons,
    refuse_degenerate,
    simplify_polygon,
)
from costs.support import SupportPolygon

# A region is found to within the larger of the resolution and this share of its size: feet to 0.1 mm, places between
# walls that are metres apart to a millimetre.
_RELATIVE_RESOLUTION = 4e-4
# Soles count as level and at one height within these: more height or lean only enlarges what friction can hold.
_LEVEL_M, _LEVEL_SINE = 1e-3, 1e-6
# The yaw moment that covers drift starts this much above that of the forces without it, which is mostly enough, and is
# raised a few times.
_FIRST_YAW_ROOM, _YAW_ROOM, _N_YAW_ROUNDS = 1.25, 1.05, 12


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
    vertices, witnesses = intersect_polygons(regions)
    total = np.linalg.norm(witnesses, axis=3).sum(axis=2).max()
    return StaticRegion(vertices, witnesses, held, float(total * drift_m / search.weight))


def _cover_drift(
    search: _Search, given: Float[np.ndarray, "G 6"], drift_m: float
) -> tuple[Float[np.ndarray, "W 6"], list[HeldPolygon]]:
    """Return wrenches and their regions; those that need tangential forces twice, with opposite yaw moments added.

    Larger moments need larger forces, which make larger moments: the moment, one for all, is raised until it covers
    what all forces make.
    """
    largest = int(np.linalg.norm(given, axis=1).argmax())
    alone = search.find_region(given[largest], largest)
    yaw = _FIRST_YAW_ROOM * drift_m * alone.most_tangential
    for _ in range(_N_YAW_ROUNDS):
        held: list[Float[np.ndarray, "6"]] = []
        regions: list[HeldPolygon] = []
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


class _Search:
    """Search for the regions of one set of contacts under single wrenches."""

    def __init__(self, contacts: WorldContacts, weight: float, drift_m: float) -> None:
        self.weight = weight
        self._contacts = contacts
        self._programs = FarthestPlaces(contacts, weight, drift_m)

    def holds_without_friction(self, wrench: Float[np.ndarray, "6"]) -> bool:
        """Return whether level soles carry the robot without load, and each point may carry all of it."""
        contacts = self._contacts
        lean = float(np.linalg.norm(contacts.normals[:, :2], axis=1).max())
        is_level = contacts.normals[:, 2].min() > 0.0 and lean <= min(_LEVEL_SINE, float(contacts.friction.min()))
        is_at_one_height = np.ptp(contacts.points[:, 2]) <= _LEVEL_M
        return bool(is_level and is_at_one_height and contacts.caps.min() >= self.weight and not wrench.any())

    def find_region(self, wrench: Float[np.ndarray, "6"], index: int) -> HeldPolygon:
        """Return the region under one wrench, which the errors call ``index``.

        Raises:
            NothingHoldsError: no program has a solution.
            DegenerateRegionError: the region is a line or a point.
        """
        if self.holds_without_friction(wrench):
            vertices, forces = self._list_sole_corners()
        else:
            vertices, forces = self._search_region(wrench, index)
        kept = simplify_polygon(vertices)
        vertices, forces = vertices[kept], forces[kept]
        refuse_degenerate(vertices, f"under wrench {index}", index)
        return HeldPolygon(vertices, forces)

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
        self._programs.set_wrench(wrench)
        places = self._programs.recall()
        for direction in FIRST_DIRECTIONS:
            if not any(np.array_equal(direction, known.direction) for known in places):
                places.append(self._programs.find(direction, index))
        places.sort(key=lambda place: place.turn)
        at = np.array([place.at for place in places])
        size = float(np.linalg.norm(np.diff(at, axis=0), axis=1).max())
        resolution = max(RESOLUTION_M, _RELATIVE_RESOLUTION * size)
        done = 0
        while done < len(places):
            first, second = places[done], places[(done + 1) % len(places)]
            if measure_room_beyond(first, second) > resolution:
                edge = second.at - first.at
                facing = np.array([edge[1], -edge[0]]) / np.linalg.norm(edge)
                farthest = self._programs.find(facing, index)
                if facing @ (farthest.at - first.at) > resolution:
                    places.insert(done + 1, farthest)
                    continue
            done += 1
        return self._programs.locate(places)
