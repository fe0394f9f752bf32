"""Where a surface of a hand meets a body at one pose, and whether forces in the friction cones push a joint there.

- A joint is pushed if forces in the cones of the contacts that touch, with the least friction, have the part along its
  way that it takes, and along every other joint that carries the body no more than that joint bears by itself.  The
  cones have a third of the friction angle where another joint is to stay: a hand that sets on slips before it sticks.
- A single contact may slide: it exerts ``N (n - mu v)`` with any slip ``v`` along the surface.  Of a way that is an
  angle a off the normal, its part along it is at least ``N (cos a - mu sin a)``.  The contact jams where that vanishes,
  and presses many times harder than the way needs shortly before; 0.4 of the pressure has to be left at every
  friction up to the largest.  What the way does not need is borne by the joint's bearings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import coal
import numpy as np
from jaxtyping import Float

from costs.robot import LinkBody
from service.verify.forces.pads import find_patch
from service.verify.forces.rounded import RoundedBody
from service.verify.forces.turning import measure_angle
from service.verify.motion import HandContact, HandPush
from service.verify.solids import make_coal_convex

TOUCH_GAP_M = 4e-3  # between surfaces that touch: parts are not drawn to the millimetre
LEAST_APART_M = 1e-3  # of the two cores; nearer ones have no normal
LEAST_SHARE = 0.4  # of the pressure of a contact that slides, along the way
HELD_SHARE = 1.0 / 3.0  # of the friction angle that keeps another joint still while the hand sets on
NOTHING_HOLDS = float(np.pi)  # by which cones would have to be wider where none suffices [rad]
_SIDES = 8  # of the pyramids inside the cones
_SHARES = np.arange(64) / 64  # of the angles by which cones are tried wider and narrower
_REST = 1e-6  # of balances that hold, relative to the force along the way
LEAST_FORCE_N = 1.0  # along the way of a joint that moves without resistance


def find_jamming_angle(push: HandPush) -> float:
    """Return the angle between normal and way from which on a single contact jams that slides [rad].

    There ``cos a - mu sin a = cos(a + atan mu) / cos(atan mu)`` is the least share of the pressure along the way.
    """
    cone = float(np.arctan(push.friction[1]))
    return float(np.arccos(LEAST_SHARE * np.cos(cone)) - cone)


@dataclass(frozen=True)
class Meeting:
    """Where a surface of a hand and a body meet at one pose, in the frame of the body's link.

    Attributes:
        apart: distance of the two cores [m].
        gap: between the surfaces; negative where they overlap [m].
        normal: (3,) unit, from the hand to the body.
        way: (3,) unit, along which the joint moves the contact point in the sense of the push.
        held: (h, 3) how each held joint would move the contact point, per unit of its coordinate [m/rad, 1].
        point: (3,) of the body's surface [m].
        spot_ways: (P, 3) of a flat pad, how the joint moves its points in the sense of the push, relative to the
            contact's own point; empty of a contact that is a point.
        spot_held: (P, h, 3) the same of each held joint, as ``held``.
    """

    apart: float
    gap: float
    normal: Float[np.ndarray, "3"]
    way: Float[np.ndarray, "3"]
    held: Float[np.ndarray, "h 3"]
    point: Float[np.ndarray, "3"]
    spot_ways: Float[np.ndarray, "P 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    spot_held: Float[np.ndarray, "P h 3"] = field(default_factory=lambda: np.zeros((0, 0, 3)))

    @property
    def angle(self) -> float:
        """Angle between normal and way [rad]."""
        return measure_angle(self.normal, self.way)

    @property
    def is_touching(self) -> bool:
        """Whether the surfaces touch, with a normal that is known."""
        return self.gap <= TOUCH_GAP_M and self.apart >= LEAST_APART_M


def find_least_share(push: HandPush, meeting: Meeting) -> float:
    """Return the least share of a single contact's pressure that is along the way, however it slides."""
    return float(np.cos(meeting.angle) - push.friction[1] * np.sin(meeting.angle))


def meet(
    contact: HandContact,
    body: LinkBody,
    pose: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]],
    sense: float,
    ways: Sequence[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]],
) -> Meeting:
    """Return where a surface of a hand meets a body.

    Args:
        contact, body: the surface and what it presses.
        pose: rotation and translation of the contact's frame in the frame of the body's joint.
        sense: of the push.
        ways: of the joint that is pushed, then of those that are held: velocity of the origin of the body's frame
            per unit of the coordinate, and angular velocity, both in that frame.
    """
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance = True
    solid = RoundedBody.of_body(body)
    core = make_coal_convex(contact.core)
    apart = float(coal.distance(core, coal.Transform3s(*pose), solid.core, solid.pose, request, result))
    normal = np.array(result.normal)
    point = np.array(result.getNearestPoint2()) - solid.radius * normal
    moves = _move_points(ways, point[None])[0]
    size = max(float(np.linalg.norm(moves[0])), 1e-12) if len(moves) else 1.0
    way = sense * moves[0] / size if len(moves) else np.zeros(3)
    met = Meeting(apart, apart - contact.radius - solid.radius, normal, way, moves[1:], point)
    if len(contact.core) <= 2 or len(moves) < 2:  # torsion acts on joints that stay, besides the one that is pushed
        return met
    spots = find_patch(contact.core @ pose[0].T + pose[1], body.vertices, normal)
    moved = _move_points(ways, spots + (point @ normal - spots @ normal)[:, None] * normal)
    return replace(met, spot_ways=sense * moved[:, 0] / size, spot_held=moved[:, 1:])


def _move_points(
    ways: Sequence[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]], points: Float[np.ndarray, "P 3"]
) -> Float[np.ndarray, "P j 3"]:
    """Return how each joint moves each point per unit of its coordinate."""
    moves = []
    for linear, angular in ways:
        x, y, z = angular.tolist()
        moves.append(linear + points @ [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # angular x points
    return np.stack(moves, axis=1) if moves else np.zeros((len(points), 0, 3))


def measure_excess(push: HandPush, met: Sequence[Meeting]) -> float:
    """Return how much wider the friction cones at a pose would have to be for the push; negative where it holds [rad].

    Half a turn where nothing touches, or where a force would exceed a cap.
    """
    return float(measure_excesses(push, [met])[0])


def measure_excesses(push: HandPush, poses: Sequence[Sequence[Meeting]]) -> Float[np.ndarray, "S"]:
    """Return ``measure_excess`` of several poses, which takes less time the nearer each is to the one before."""
    excesses = np.full(len(poses), NOTHING_HOLDS)
    least = np.full(len(poses), -NOTHING_HOLDS)
    alike: dict[tuple[tuple[int, int], ...], list[int]] = {}
    for k, met in enumerate(poses):
        touching = [(number, each) for number, each in enumerate(met) if each.is_touching]
        if len(touching) == 1:
            ((number, meeting),) = touching
            jams = meeting.angle - find_jamming_angle(push)
            if jams <= 0.0 and push.force_n > push.contacts[number].cap_n * np.cos(meeting.angle):
                continue
            if jams > 0.0 or not push.held:
                excesses[k] = jams
                continue
            least[k] = jams
        if touching:
            alike.setdefault(tuple((number, len(each.spot_ways)) for number, each in touching), []).append(k)
    for key, rows in alike.items():
        numbers = [number for number, _ in key]
        caps = [push.contacts[number].cap_n for number in numbers]
        found = _search_widenings(push, caps, [[poses[k][number] for number in numbers] for k in rows])
        excesses[rows] = np.maximum(least[rows], found)
    return excesses


def _search_widenings(
    push: HandPush, caps: Sequence[float], touching: Sequence[Sequence[Meeting]]
) -> Float[np.ndarray, "S"]:
    """Search for the least widening of all cones in which forces balance the push, at several poses [rad]."""
    balance = _Balance(push, caps, touching)
    cone = float(np.arctan(push.friction[0])) * (HELD_SHARE if push.held else 1.0)
    widest = 0.5 * np.pi - cone - 1e-3
    # From the widest cones to the given ones, then on to none.
    halves = np.concatenate([cone + widest * (1.0 - _SHARES), cone * (1.0 - _SHARES)]).tolist()
    offs = (0.25 * np.pi * _SHARES).tolist()  # of the normal of a single contact that needs no friction
    excesses = np.full(len(touching), NOTHING_HOLDS)
    near: int | None = None
    for k in range(len(touching)):
        if len(caps) == 1 and balance.holds_about(k, 0.0):
            excesses[k] = -cone - offs[_find_last(partial(balance.holds_about, k), offs)]
            continue
        near = _find_last(partial(balance.exists, k), halves, near)
        if near >= 0:
            excesses[k] = halves[near] - cone
    return excesses


def _find_last(holds: Callable[[float], bool], angles: Sequence[float], near: int | None = None) -> int:
    """Return the number of the last angle that holds, where all do up to one of them; -1 where none does.

    With a guess ``near`` it is looked for from there on, in steps that grow.
    """
    count = len(angles)
    low, high, step = -1, count, 1
    at = count // 2 if near is None else max(near, 0)
    while high - low > 1:
        is_held = holds(angles[at])
        low, high = (at, high) if is_held else (low, at)
        is_between = near is None or (low >= 0 and high < count)
        at = (low + high) // 2 if is_between else low + step if is_held else high - step
        at, step = min(max(at, low + 1), high - 1), 2 * step
    return low


class _Balance:
    """Forces of contacts that push a joint and leave the held ones where they are, at ``S`` poses.

    Several contacts do not press across the way, where they would hold against each other.  Each pad of them that lies
    flat on the body presses at several spots, and so resists torsion.
    """

    def __init__(self, push: HandPush, caps: Sequence[float], touching: Sequence[Sequence[Meeting]]) -> None:
        """Prepare.

        Args:
            push: what the contacts do.
            caps: of the contacts that touch [N].
            touching: where each of them meets its body, by pose; each has as many spots at every pose.
        """
        self._force = max(push.force_n, LEAST_FORCE_N)
        self._caps = np.array(caps)
        self._low = np.array([held.low for held in push.held])
        self._high = np.array([held.high for held in push.held])
        several = len(caps) > 1
        parts = [[_list_spots(meeting, flat=several) for meeting in each] for each in touching]
        self._owners = np.repeat(np.arange(len(caps)), [len(ways) for ways, _ in parts[0]])
        self._normals = np.array([[meeting.normal for meeting in each] for each in touching])[:, self._owners]
        self._ways = np.stack([np.concatenate([ways for ways, _ in each]) for each in parts])
        self._held = np.stack([np.concatenate([held for _, held in each]) for each in parts])
        self._around = _list_tangents(self._normals, self._ways)
        middle = np.mean([[meeting.way for meeting in each] for each in touching], axis=1)
        self._across = np.linalg.svd(middle[:, None])[2][:, 1:] if several else np.zeros((len(touching), 0, 3))
        is_low, is_high = np.isfinite(self._low), np.isfinite(self._high)
        bounds = np.concatenate([self._high[is_high], -self._low[is_low], self._caps])
        self._wanted = np.concatenate([[self._force], np.zeros(self._across.shape[1]), bounds])
        # An edge is a sum of normal and tangent, and so is everything that is linear in it.
        self._of_normals = self._make_rows(np.broadcast_to(self._normals[:, :, None], self._around.shape))
        self._of_tangents = self._make_rows(self._around)
        self._slacks = np.eye(len(self._wanted))[:, len(self._wanted) - len(bounds) :]

    def _make_rows(self, edges: Float[np.ndarray, "S P E 3"]) -> Float[np.ndarray, "S r e"]:
        """Return what unit forces along edges do, row by row: along the way, across it, at held joints and caps."""
        n_poses, count = len(edges), edges.shape[1] * edges.shape[2]
        along = (edges * self._ways[:, :, None]).sum(axis=3).reshape(n_poses, 1, count)
        across = self._across @ edges.reshape(n_poses, count, 3).transpose(0, 2, 1)
        parts = np.einsum("spek,sphk->shpe", edges, self._held).reshape(n_poses, len(self._low), count)
        owned = np.arange(len(self._caps))[:, None] == self._owners
        pressed = owned[:, :, None] * (edges * self._normals[:, :, None]).sum(axis=3)[:, None]
        is_low, is_high = np.isfinite(self._low), np.isfinite(self._high)
        own = pressed.reshape(n_poses, len(self._caps), count)
        return np.concatenate([along, across, parts[:, is_high], -parts[:, is_low], own], axis=1)

    def exists(self, pose: int, half: float) -> bool:
        """Return whether there are such forces at a pose within a half-angle of the normals.

        A non-negative least-squares problem: coefficients of the cones' edges, and slacks of caps and of held joints.
        """
        if half <= 0.0:
            return False
        from scipy.optimize import nnls  # slow to import, and rarely needed

        edges = np.cos(half) * self._of_normals[pose] + np.sin(half) * self._of_tangents[pose]
        _, rest = nnls(np.hstack([edges, self._slacks]), self._wanted)
        return bool(rest < _REST * self._force)

    def holds_about(self, pose: int, off: float) -> bool:
        """Return whether a single contact holds without friction, for every normal within an angle of its own."""
        half = off / np.cos(np.pi / _SIDES)
        edges = np.cos(half) * self._normals[pose] + np.sin(half) * self._around[pose, 0]
        normals = np.vstack([self._normals[pose], edges])
        share = normals @ self._ways[pose, 0]
        if share.min() <= 0.0:
            return False
        pressure = self._force / share
        parts = pressure[:, None] * (normals @ self._held[pose, 0].T)
        slack = _REST * pressure.max()
        is_held = (parts >= self._low - slack) & (parts <= self._high + slack)
        return bool(is_held.all()) and bool(pressure.max() <= self._caps[0])


def _list_spots(meeting: Meeting, *, flat: bool) -> tuple[Float[np.ndarray, "P 3"], Float[np.ndarray, "P h 3"]]:
    """Return how the joint, and the held ones, move the spots at which a contact presses."""
    if flat and len(meeting.spot_ways):
        return meeting.spot_ways, meeting.spot_held
    return meeting.way[None], meeting.held[None]


def _list_tangents(
    normals: Float[np.ndarray, "S P 3"], ways: Float[np.ndarray, "S P 3"]
) -> Float[np.ndarray, "S P E 3"]:
    """Return unit vectors around each normal, at equal angles, the first where the way leads along the surface."""
    basis = np.linalg.svd(normals[..., None, :])[2][..., 1:, :]
    along = (basis * ways[..., None, :]).sum(axis=-1)
    size = np.linalg.norm(along, axis=-1)
    first = np.where(size > _REST, np.arctan2(along[..., 1], along[..., 0]), 0.0)
    turn = first[..., None] + 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    return np.asarray(np.stack([np.cos(turn), np.sin(turn)], axis=-1) @ basis)
