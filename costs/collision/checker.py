"""Search for the swept contacts of all waypoints at once: boxes in numpy, then GJK, and coal for pairs that meet."""

from __future__ import annotations

import copy
import ctypes
from functools import cached_property

import coal
import numpy as np
from jaxtyping import Float, Int

from costs.collision.contacts import Contacts
from costs.collision.pairs import PairMargins
from costs.collision.shapes import make_convex, make_outer_convex, make_swept_convex
from costs.collision.slabs import find_slabs, find_slabs_of_sets
from costs.collision.sweep import BodyVertices, find_extent, share_gradient
from costs.kinematics import Kinematics
from costs.native import APART, TOUCHING, HullSet, call, find_library
from costs.robot.model import RobotModel
from costs.scene import Scene
from costs.stopping import poll

# Where two faces touch within rounding coal fails and returns the lowest double: it is called again with one
# of them nudged by far less than any tolerance [m].
_ABSURD = 1e6
_NUDGES = [
    coal.Transform3s(np.eye(3), 1e-8 * np.array(way))
    for way in ((0.61, -0.48, 0.63), (-0.43, 0.71, -0.56), (0.37, 0.52, -0.77), (-0.8, -0.3, 0.52))
]
_IDENTITY = coal.Transform3s()
_MOST_WRITTEN = 2**25  # numbers of vertices for which the library is given space, of which it writes few
MANY = 20  # pairs of an interval whose boxes meet, from which extents along other directions save more than they take


class _CoalSpace:
    """Objects and work space of coal, which few plans need where the library is built."""

    def __init__(self, robot: RobotModel, scene: Scene) -> None:
        swept = [make_swept_convex(body.outer) for body in robot.bodies]
        self.swept, self.points = [convex for convex, _ in swept], [points for _, points in swept]
        self.pieces = [make_convex(piece.vertices) for piece in scene.pieces]
        self.still = [make_outer_convex(body) for body in robot.bodies]
        self.functors: dict[tuple[bool, int], dict[int, coal.ComputeDistance]] = {}
        self.request = coal.DistanceRequest()
        self.request.enable_signed_distance = True
        self.result = coal.DistanceResult()


class SweptCollisionChecker:
    """Swept contacts of one robot in one scene.

    Keeps coal's objects and work space between queries; its results depend on the query alone.
    """

    def __init__(self, robot: RobotModel, scene: Scene, margins: PairMargins, buffer: float = 0.03) -> None:
        """
        Args:
            buffer: pairs are reported up to this beyond their margin [m].
        """
        self.robot, self.scene, self.margins, self.buffer = robot, scene, margins, buffer
        self._bodies = BodyVertices.of(robot)
        self._piece_hulls = HullSet.of([piece.vertices for piece in scene.pieces])
        self._still_hulls = HullSet.of([body.outer for body in robot.bodies])
        self._lower = np.array([piece.lower for piece in scene.pieces]).reshape(-1, 3)
        self._upper = np.array([piece.upper for piece in scene.pieces]).reshape(-1, 3)
        self._slab_low, self._slab_high = find_slabs_of_sets([piece.vertices for piece in scene.pieces])
        self._pairs = np.array([self._order_pair(a, b) for a, b in margins.self_pairs], dtype=int).reshape(-1, 2)

    @cached_property
    def _coal(self) -> _CoalSpace:
        return _CoalSpace(self.robot, self.scene)

    def with_margins(self, margins: PairMargins) -> SweptCollisionChecker:
        """Return a checker of the same pairs with other margins, which shares this one's work space."""
        if not np.array_equal(margins.self_pairs, self.margins.self_pairs):
            raise ValueError("the margins must be those of the checker's own pairs")
        other = copy.copy(self)
        other.margins = margins
        return other

    def _order_pair(self, a: int, b: int) -> tuple[int, int]:
        """Return two bodies with the one that sweeps last: it has fewer vertices, and is not of a mechanism.

        A door's leaf that swept in the frame of the hand on it would sweep over the hand.
        """
        is_moved = [self.robot.bodies[body].link in self.robot.mechanism_links for body in (a, b)]
        if is_moved[0] != is_moved[1]:
            return (a, b) if is_moved[0] else (b, a)
        return (a, b) if self._bodies.count[a] >= self._bodies.count[b] else (b, a)

    def __call__(self, kinematics: Kinematics) -> Contacts:
        """Find the contacts of all intervals, or of the single pose if there is one waypoint."""
        first = np.arange(max(kinematics.n_waypoints - 1, 1))
        return self._find(kinematics, first, np.minimum(first + 1, kinematics.n_waypoints - 1))

    def at_poses(self, kinematics: Kinematics) -> Contacts:
        """Find the contacts of all waypoints as single poses."""
        each = np.arange(kinematics.n_waypoints)
        return self._find(kinematics, each, each)

    def _find(self, kinematics: Kinematics, first: Int[np.ndarray, "I"], second: Int[np.ndarray, "I"]) -> Contacts:
        world = self._bodies.in_world(kinematics)
        return Contacts.join(
            [
                self._find_world_contacts(world, first, second),
                self._find_self_contacts(kinematics, world, first, second),
            ]
        )

    def _find_world_contacts(
        self, world: Float[np.ndarray, "T B V 3"], first: Int[np.ndarray, "I"], second: Int[np.ndarray, "I"]
    ) -> Contacts:
        if not self.scene.pieces:
            return Contacts.none()
        at_first, at_second = world[: len(first)], world[-len(second) :]
        interval, body, piece = self._find_near_pieces(world, first, second)
        query = self.margins.world[body, piece] + self.buffer
        keep, distance, normal, witness = self._measure(
            at_first, at_second, interval, body, piece, query, is_self=False
        )
        interval, body, piece = interval[keep], body[keep], piece[keep]
        vertices_first, vertices_second = at_first[interval, body], at_second[interval, body]
        share, point_first, point_second = share_gradient(vertices_first, vertices_second, normal, witness)
        return Contacts(
            first=first[interval],
            second=second[interval],
            body=body,
            other=piece,
            is_self=np.zeros(len(keep), dtype=bool),
            distance=distance,
            margin=self.margins.world[body, piece],
            share=share,
            normal=np.stack([normal, normal], axis=1),
            point=np.stack([point_first, point_second], axis=1),
        )

    def _find_near_pieces(
        self, world: Float[np.ndarray, "T B V 3"], first: Int[np.ndarray, "I"], second: Int[np.ndarray, "I"]
    ) -> tuple[Int[np.ndarray, "c"], Int[np.ndarray, "c"], Int[np.ndarray, "c"]]:
        """Find intervals, bodies and pieces whose extents come near along the axes, and of many along others too."""
        poll()
        low, high = find_extent(world)
        low, high = np.minimum(low[first], low[second]), np.maximum(high[first], high[second])
        reach = self.margins.world + self.buffer
        near = np.ones((len(first), *reach.shape), dtype=bool)
        for axis in range(3):
            near &= low[:, :, axis, None] <= self._upper[:, axis] + reach
            near &= self._lower[:, axis] - reach <= high[:, :, axis, None]
        interval, body, piece = np.nonzero(near)
        if len(interval) < MANY * len(first):
            return interval, body, piece
        low, high = find_slabs(world)
        gap = np.maximum(
            np.minimum(low[first], low[second])[interval, body] - self._slab_high[piece],
            self._slab_low[piece] - np.maximum(high[first], high[second])[interval, body],
        )
        is_near = gap.max(axis=1) <= reach[body, piece]
        return interval[is_near], body[is_near], piece[is_near]

    def _find_self_contacts(
        self,
        kinematics: Kinematics,
        world: Float[np.ndarray, "T B V 3"],
        first: Int[np.ndarray, "I"],
        second: Int[np.ndarray, "I"],
    ) -> Contacts:
        interval, pair, at_first, at_second = self._sweep_pairs(kinematics, world, first, second)
        still, moving = self._pairs[pair].T
        rows = np.arange(len(pair))
        keep, distance, normal, witness = self._measure(
            at_first[:, None],
            at_second[:, None],
            rows,
            moving,
            still,
            self.margins.own[pair] + self.buffer,
            is_self=True,
        )
        interval, pair, still, moving = interval[keep], pair[keep], still[keep], moving[keep]
        joint = self._bodies.joint[still]
        share, *local_points = share_gradient(at_first[keep], at_second[keep], normal, witness)
        normals, points = [], []
        for waypoint, local_point in zip((first[interval], second[interval]), local_points, strict=True):
            rotation, position = kinematics.rotation[waypoint, joint], kinematics.position[waypoint, joint]
            normals.append(np.einsum("mkl,ml->mk", rotation, normal))
            points.append(np.einsum("mkl,ml->mk", rotation, local_point) + position)
        return Contacts(
            first=first[interval],
            second=second[interval],
            body=moving,
            other=still,
            is_self=np.ones(len(keep), dtype=bool),
            distance=distance,
            margin=self.margins.own[pair],
            share=share,
            normal=np.stack(normals, axis=1),
            point=np.stack(points, axis=1),
        )

    def _sweep_pairs(
        self,
        kinematics: Kinematics,
        world: Float[np.ndarray, "T B V 3"],
        first: Int[np.ndarray, "I"],
        second: Int[np.ndarray, "I"],
    ) -> tuple[Int[np.ndarray, "c"], Int[np.ndarray, "c"], Float[np.ndarray, "c V 3"], Float[np.ndarray, "c V 3"]]:
        """Find intervals and self pairs near each other, and the mover's vertices in the other's frame at both ends."""
        poll()
        library = find_library()
        if library is not None and len(first) * len(self._pairs) * 3 * world.shape[2] <= _MOST_WRITTEN:
            return self._sweep_pairs_compiled(library, kinematics, world, first, second)
        interval, pair = self._find_near_pairs(kinematics, first, second)
        still, moving = self._pairs[pair].T
        joint = self._bodies.joint[still]
        ends = []
        for waypoint in (first[interval], second[interval]):
            rotation, position = kinematics.rotation[waypoint, joint], kinematics.position[waypoint, joint]
            ends.append(np.matmul(world[waypoint, moving] - position[:, None], rotation))
        reach = (self.margins.own[pair] + self.buffer)[:, None]
        (low_first, high_first), (low_second, high_second) = find_extent(ends[0]), find_extent(ends[1])
        low, high = np.minimum(low_first, low_second) - reach, np.maximum(high_first, high_second) + reach
        near = np.all((low <= self._bodies.upper[still]) & (self._bodies.lower[still] <= high), axis=1)
        return interval[near], pair[near], ends[0][near], ends[1][near]

    def _sweep_pairs_compiled(
        self,
        library: ctypes.CDLL,
        kinematics: Kinematics,
        world: Float[np.ndarray, "T B V 3"],
        first: Int[np.ndarray, "I"],
        second: Int[np.ndarray, "I"],
    ) -> tuple[Int[np.ndarray, "c"], Int[np.ndarray, "c"], Float[np.ndarray, "c V 3"], Float[np.ndarray, "c V 3"]]:
        bodies, most = self._bodies, len(first) * len(self._pairs)
        interval, pair = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
        # Memory that is not written is not taken.
        at_first, at_second = np.empty((most, *world.shape[2:])), np.empty((most, *world.shape[2:]))
        found = call(
            library.scopt_sweep_pairs,
            len(first),
            np.ascontiguousarray(first),
            np.ascontiguousarray(second),
            kinematics.rotation.shape[1],
            np.ascontiguousarray(kinematics.rotation),
            np.ascontiguousarray(kinematics.position),
            *world.shape[1:3],
            np.ascontiguousarray(world),
            np.ascontiguousarray(bodies.joint),
            np.ascontiguousarray(bodies.lower),
            np.ascontiguousarray(bodies.upper),
            np.ascontiguousarray(bodies.centre),
            np.ascontiguousarray(bodies.radius),
            len(self._pairs),
            np.ascontiguousarray(self._pairs),
            np.ascontiguousarray(self.margins.own + self.buffer),
            interval,
            pair,
            at_first,
            at_second,
        )
        return interval[:found], pair[:found], at_first[:found], at_second[:found]

    def _find_near_pairs(
        self, kinematics: Kinematics, first: Int[np.ndarray, "I"], second: Int[np.ndarray, "I"]
    ) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
        """Find intervals and self pairs in which the mover's sphere, on its chord, comes near the other body's box."""
        poll()
        if not len(self._pairs):
            return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
        bodies = self._bodies
        still, moving = self._pairs.T
        centres, joint = bodies.centres_in_world(kinematics), bodies.joint
        offset = centres[:, None] - kinematics.position[:, joint, None]
        relative = np.matmul(offset, kinematics.rotation[:, joint])[:, still, moving]
        start, end = relative[first], relative[second]
        below = bodies.lower[still] - np.maximum(start, end)
        gap = np.maximum(np.maximum(np.minimum(start, end) - bodies.upper[still], below), 0.0)
        reach = bodies.radius[moving] + self.margins.own + self.buffer
        is_near = (gap**2).sum(axis=2) <= np.maximum(reach, 0.0) ** 2
        intervals, pairs = np.nonzero(is_near)
        return intervals, pairs

    def _measure(
        self,
        at_first: Float[np.ndarray, "I B V 3"],
        at_second: Float[np.ndarray, "I B V 3"],
        interval: Int[np.ndarray, "c"],
        body: Int[np.ndarray, "c"],
        other: Int[np.ndarray, "c"],
        query: Float[np.ndarray, "c"],
        *,
        is_self: bool,
    ) -> tuple[Int[np.ndarray, "m"], Float[np.ndarray, "m"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
        """Measure candidate pairs: keep those nearer than ``query``, with distance, normal and witness."""
        library, rows = find_library(), np.arange(len(interval))
        if library is None:
            return self._measure_by_coal(at_first, at_second, interval, body, other, query, rows, is_self=is_self)
        n_bodies, width = at_first.shape[1:3]
        distance, normal, witness, answer = (self._still_hulls if is_self else self._piece_hulls).measure_swept(
            library,
            np.ascontiguousarray(at_first).reshape(-1, width, 3),
            np.ascontiguousarray(at_second).reshape(-1, width, 3),
            interval if is_self else interval * n_bodies + body,
            self._bodies.count[body],
            other,
            query,
        )
        is_kept = (answer == APART) & (distance < query)
        # Only where hulls meet, the depth takes more than GJK.
        meets = np.flatnonzero(answer == TOUCHING)
        if len(meets):
            found = self._measure_by_coal(at_first, at_second, interval, body, other, query, meets, is_self=is_self)
            is_kept[found[0]] = True
            distance[found[0]], normal[found[0]], witness[found[0]] = found[1], -found[2], found[3]
        keep = np.flatnonzero(is_kept)
        return keep, distance[keep], -normal[keep], witness[keep]

    def _measure_by_coal(
        self,
        at_first: Float[np.ndarray, "I B V 3"],
        at_second: Float[np.ndarray, "I B V 3"],
        interval: Int[np.ndarray, "c"],
        body: Int[np.ndarray, "c"],
        other: Int[np.ndarray, "c"],
        query: Float[np.ndarray, "c"],
        rows: Int[np.ndarray, "r"],
        *,
        is_self: bool,
    ) -> tuple[Int[np.ndarray, "m"], Float[np.ndarray, "m"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
        """Measure these rows by GJK/EPA of coal, one after the other."""
        space = self._coal
        keep: list[int] = []
        distances: list[float] = []
        normals: list[np.ndarray] = []
        witnesses: list[np.ndarray] = []
        request, result, clear = space.request, space.result, space.result.clear
        counts = self._bodies.count.tolist()
        written, functors = (-1, -1), dict[int, coal.ComputeDistance]()
        columns = (column[rows].tolist() for column in (interval, body, other, query))
        for row, i, b, o, limit in zip(rows.tolist(), *columns, strict=True):
            if written != (i, b):
                column, count, points = 0 if is_self else b, counts[b], space.points[b]
                points[:count] = at_first[i, column, :count]
                points[count:] = at_second[i, column, :count]
                written, functors = (i, b), space.functors.setdefault((is_self, b), {})
            measure = functors.get(o)
            if measure is None:
                target = space.still[o] if is_self else space.pieces[o]
                measure = functors[o] = coal.ComputeDistance(space.swept[b], target)
            clear()
            distance = measure(_IDENTITY, _IDENTITY, request, result)
            if distance < -_ABSURD:
                for nudge in _NUDGES:
                    clear()
                    distance = measure(nudge, _IDENTITY, request, result)
                    if distance > -_ABSURD:
                        break
            if -_ABSURD < distance < limit:
                keep.append(row)
                distances.append(distance)
                normals.append(-result.normal)
                witnesses.append(result.getNearestPoint1())
        shape = (len(keep), 3)
        return (
            np.array(keep, dtype=int),
            np.array(distances),
            np.array(normals).reshape(shape),
            np.array(witnesses).reshape(shape),
        )
