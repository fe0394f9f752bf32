"""Loads of a moved object: what its joints demand of the hand, and whether it rests where no hand holds it.

A joint needs the generalised force ``M qdd + c + g(q) + k q + b qd + friction sgn(qd)``.  Gravity and springs keep
their sign on the way back, friction and damping turn with the motion.  While one joint moves, each term is bounded over
the whole move: gravity, inertia and centrifugal terms exactly over the joint's range, speed and acceleration by the
joint's limits, which the verifier proves of the timed curve.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import MechanismJoint, Release, make_mechanism_model
from costs.robot.servo import DAMPING_S
from service.demands.moved_object.assumed import assume_inertia
from service.demands.moved_object.ranges import bound_polynomial, bound_waves

AT_STOP = 1e-6  # by which a joint at its stop may be off [rad, m]
LEAST_LOAD = 1e-6  # smaller loads count as none [N m, N]
ANGLE_ROUNDING = 1e-5  # of a file's angles: what weight does to a joint that is off by this holds itself [rad]
INERTIA_SHARE = 0.2  # of what an object opposes at rest, that its inertia may come to
LAG_SHARE = 0.01  # of a travel, by which servos may lag behind as it ends
SLOWEST_S = 10.0  # a move is not made slower than this because of inertia
_ANGLES = 2.0 * np.pi * np.arange(5) / 5.0  # of the waves of up to two periods per turn: 1, cos, sin, cos 2, sin 2
_PLACES = np.array([-1.0, 0.0, 1.0])  # of a quadratic [m]


@dataclass(frozen=True)
class Spring:
    """Spring that pulls a joint back to its start, once it has left it.

    Attributes:
        preload: as soon as the joint has left its start [N m, N].
        stiffness: increase of that per travel [N m/rad, N/m].
    """

    preload: float
    stiffness: float

    def bound(self, first: float, last: float) -> tuple[float, float]:
        """Return the least and the largest force that holds the joint against it between two travels from its start."""
        ends = np.array([self._hold(first), self._hold(last)])
        if first * last < 0.0 or (first == 0.0 and last == 0.0):
            return float(ends.min()), float(ends.max())
        if first * last == 0.0:  # just after it has left its start
            ends[np.array([first, last]) == 0.0] = np.sign(first + last) * self.preload
        return float(ends.min()), float(ends.max())

    def _hold(self, travel: float) -> float:
        return float(np.sign(travel) * self.preload + self.stiffness * travel)


@dataclass(frozen=True)
class JointLoad:
    """What a hand must exert along a joint of the object during a move.

    Attributes:
        joint: its name.
        low, high: least and largest generalised force on the object, positive with the joint [N m, N].  A moving joint
            takes every value between them.  Both are of one sign where the hand only has to push one way.
        sense: 1.0 or -1.0 where the joint moves that way, 0.0 where the hand keeps it still.
        slack: of a joint that is kept still: by how much the force may be below ``low`` or above ``high`` before its
            friction, a stop or a latch gives way [N m, N].
    """

    joint: str
    low: float
    high: float
    sense: float = 0.0
    slack: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class UnheldJoint:
    """A joint that would move where nothing but the object itself holds it.

    Attributes:
        joint: its name.
        pull: generalised force that would move it, the largest of the move or place [N m, N].
        held: what its friction, or its spring at its start, holds against that [N m, N].
        cause: what pulls, in words: gravity, its spring, the acceleration of the move.
    """

    joint: str
    pull: float
    held: float
    cause: str


@dataclass(frozen=True)
class _Terms:
    """Bounds over one move, by joint, as arrays (2, k) of least and largest values.

    Attributes:
        gravity, springs: what holds the joint against them [N m, N].
        inertia: per acceleration of the moving joint.
        centrifugal: per squared speed of the moving joint.
    """

    gravity: Float[np.ndarray, "2 k"]
    springs: Float[np.ndarray, "2 k"]
    inertia: Float[np.ndarray, "2 k"]
    centrifugal: Float[np.ndarray, "2 k"]

    @property
    def still(self) -> Float[np.ndarray, "2 k"]:
        """(2, k) what holds the joints at rest, wherever they are."""
        return np.asarray(self.gravity + self.springs)


@dataclass(frozen=True)
class MovedObject:
    """The joints of an object with everything that acts on them but a hand.

    Attributes:
        joints: parents before children, with masses, friction and damping.
        springs: by joint.
        stops: per joint, where it cannot move on: lower and upper value [rad, m].
        releases: rules of its latches.
    """

    joints: tuple[MechanismJoint, ...]
    springs: Mapping[str, Spring] = field(default_factory=dict)
    stops: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    releases: tuple[Release, ...] = ()

    @cached_property
    def model(self) -> pin.Model:
        """The object's own masses and joints."""
        return make_mechanism_model(self.joints)

    @property
    def has_masses(self) -> bool:
        """Whether a joint moves a mass."""
        return any(joint.inertia is not None for joint in self.joints)

    def assume_masses(self) -> MovedObject:
        """Return the object with the masses that its shapes let expect."""
        own = ((joint, assume_inertia(list(joint.bodies.values()))) for joint in self.joints)
        return replace(self, joints=tuple(replace(joint, inertia=i if i.mass > 0.0 else None) for joint, i in own))

    @property
    def start(self) -> Float[np.ndarray, "k"]:
        """(k,) values of the joints at the start [rad, m]."""
        return np.array([joint.start for joint in self.joints])

    def bound_move(self, first: Float[np.ndarray, "k"], last: Float[np.ndarray, "k"]) -> _Terms:
        """Return what the joints need while at most one of them moves from ``first`` to ``last``."""
        count, column = len(self.joints), int(np.abs(last - first).argmax())
        terms = np.zeros((3, 2, count))
        if self.has_masses:
            joint = self.joints[column]
            nodes, bound = (_ANGLES, bound_waves) if joint.kind == "revolute" else (_PLACES, bound_polynomial)
            values = np.array([self._measure_terms(first, column, at) for at in nodes])
            low, high = sorted((float(first[column]), float(last[column])))
            for kind in range(3):
                for index in range(count):
                    terms[kind, :, index] = bound(values[:, kind, index], low, high)
        springs = np.zeros((2, count))
        for index, joint in enumerate(self.joints):
            if joint.name in self.springs:
                travel = first[index] - joint.start, last[index] - joint.start
                springs[:, index] = self.springs[joint.name].bound(float(travel[0]), float(travel[1]))
        return _Terms(terms[0], springs, terms[1], terms[2])

    def list_loads(
        self, first: Float[np.ndarray, "k"], last: Float[np.ndarray, "k"], carriers: Sequence[str]
    ) -> tuple[JointLoad, ...]:
        """Return the loads of the joints that carry the hand, while one of them moves from ``first`` to ``last``."""
        moving = int(np.abs(last - first).argmax())
        joint = self.joints[moving]
        terms = self.bound_move(first, last)
        need = terms.still + _bound_motion(terms, joint)
        loads = []
        for name in carriers:
            index = next(k for k, known in enumerate(self.joints) if known.name == name)
            low, high = need[:, index].tolist()
            if index != moving:
                loads.append(self._keep_still(index, first, low, high))
                continue
            sense = float(np.sign(last[index] - first[index]))
            damped = sorted((0.0, sense * joint.damping * joint.velocity))
            low, high = low + sense * joint.friction + damped[0], high + sense * joint.friction + damped[1]
            loads.append(JointLoad(name, low, high, sense))
        return tuple(loads)

    def find_unheld(
        self, first: Float[np.ndarray, "k"], last: Float[np.ndarray, "k"], among: Sequence[str] | None = None
    ) -> UnheldJoint | None:
        """Return a joint that would move by itself without a hand, at one place or along a move; None if all rest.

        Args:
            first, last: values of the joints, equal at one place.
            among: the joints that no hand holds; all by default.
        """
        terms = self.bound_move(first, last)
        shaken = np.zeros_like(terms.still)
        if not np.array_equal(first, last):
            shaken = _bound_motion(terms, self.joints[int(np.abs(last - first).argmax())])
        need = terms.still + shaken
        for index, joint in enumerate(self.joints):
            if among is not None and joint.name not in among:
                continue
            load = self._keep_still(index, first, *need[:, index].tolist())
            if load.low == load.high == 0.0:
                continue
            pull = load.high if load.high >= -load.low else load.low
            causes = (("gravity", terms.gravity), ("its spring", terms.springs), ("the acceleration", shaken))
            words = [name for name, part in causes if np.abs(part[:, index]).max() > LEAST_LOAD]
            return UnheldJoint(joint.name, -pull, self._measure_rest(index, first), " and ".join(words))
        return None

    def find_loose(self, values: Float[np.ndarray, "k"], among: Sequence[str]) -> str | None:
        """Return a joint that a push could move one way or the other at rest, however small; None if there is none."""
        still = self.bound_move(values, values).still
        for index, joint in enumerate(self.joints):
            if joint.name in among and min(self._keep_still(index, values, *still[:, index].tolist()).slack) <= 0.0:
                return joint.name
        return None

    def _keep_still(self, index: int, values: Float[np.ndarray, "k"], low: float, high: float) -> JointLoad:
        """Return the load of a joint that stays at its value and needs a force between two values to do so.

        A joint whose friction, stop or latch holds it needs no hand. Where they do not, the hand bears all of it: what
        friction takes of it is not known.
        """
        joint = self.joints[index]
        lower, upper = self.stops.get(joint.name, (-np.inf, np.inf))
        rest = self._measure_rest(index, values)
        is_latched = self._is_latched(joint.name, values)
        below = np.inf if is_latched or values[index] >= upper - AT_STOP else rest  # of a push with the joint ...
        above = np.inf if is_latched or values[index] <= lower + AT_STOP else rest  # ... and of one against it
        lowest, highest = min(low, 0.0), max(high, 0.0)
        least = LEAST_LOAD + self._measure_rounding(index, values)
        lowest = 0.0 if -lowest <= below + least else lowest
        highest = 0.0 if highest <= above + least else highest
        # The hand may exert from ``high - above`` to ``low + below`` without moving the joint.
        slack = (max(lowest - (high - above), 0.0), max(low + below - highest, 0.0))
        return JointLoad(joint.name, lowest, highest, 0.0, slack)

    def _measure_rest(self, index: int, values: Float[np.ndarray, "k"]) -> float:
        """Return what friction, and at its start the spring's preload, hold against a push either way [N m, N]."""
        joint = self.joints[index]
        spring = self.springs.get(joint.name)
        is_at_start = abs(float(values[index]) - joint.start) <= AT_STOP
        return joint.friction + (spring.preload if spring is not None and is_at_start else 0.0)

    def _measure_rounding(self, index: int, values: Float[np.ndarray, "k"]) -> float:
        """Return the largest load of a joint by weight if everything were tilted by the rounding of angles [N m, N]."""
        if not self.has_masses:
            return 0.0
        model, none = self.model.copy(), np.zeros(len(values))
        data, size = model.createData(), float(np.linalg.norm(self.model.gravity.linear))
        pulls = []
        for direction in np.eye(3):
            model.gravity.linear = ANGLE_ROUNDING * size * direction
            pulls.append(float(pin.rnea(model, data, values, none, none)[index]))
        return float(np.linalg.norm(pulls))

    def _is_latched(self, joint: str, values: Float[np.ndarray, "k"]) -> bool:
        """Return whether a latch locks a joint at 0."""
        names = [known.name for known in self.joints]
        if abs(float(values[names.index(joint)])) > AT_STOP:
            return False
        return any(
            release.joint == joint
            and float(values[names.index(release.latch)]) * np.sign(release.latch_at) < abs(release.latch_at)
            for release in self.releases
        )

    def _measure_terms(self, first: Float[np.ndarray, "k"], column: int, at: float) -> Float[np.ndarray, "3 k"]:
        """Return gravity, inertia and centrifugal terms with the moving joint at a value."""
        model, data = self.model, self.model.createData()
        q, unit, none = first.copy(), np.zeros(len(first)), np.zeros(len(first))
        q[column], unit[column] = at, 1.0
        gravity = pin.rnea(model, data, q, none, none).copy()
        inertia = pin.rnea(model, data, q, none, unit) - gravity
        return np.stack([gravity, inertia, pin.rnea(model, data, q, unit, none) - gravity])


def choose_pace(
    moved: MovedObject, moves: Sequence[tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]]
) -> Iterator[MechanismJoint]:
    """Yield the joints with the limits of speed and acceleration that the loads are made for.

    A short travel takes at least 0.6 s: position servos lag behind by the acceleration times the square of their time
    constant as a motion ends, which then is a hundredth of the travel.
    A joint is moved so gently that its inertia comes to a fifth of what it opposes at rest: the object then never runs
    ahead of a hand that pushes it against its friction or weight.  A move takes no longer than 10 s for it.  Where
    nobody states a mass, the inertia is that of the shapes as wood, which loads leave out.
    From rest to rest the speed is at most the root of acceleration times travel.
    """
    heavy = moved if moved.has_masses else moved.assume_masses()
    for index, joint in enumerate(moved.joints):
        own = [(first, last) for first, last in moves if last[index] != first[index]]
        lags = (LAG_SHARE * float(abs(last[index] - first[index])) / DAMPING_S**2 for first, last in own)
        joint = replace(joint, acceleration=min([joint.acceleration, *lags]))
        gentle = min((_find_gentle(moved, heavy, index, *move) for move in own), default=np.inf)
        if not own or not (moved.has_masses or joint.damping or np.isfinite(gentle)):
            yield joint
            continue
        acceleration = min(joint.acceleration, gentle)
        travel = sum(float(abs(last[index] - first[index])) for first, last in own)
        yield replace(
            joint, acceleration=acceleration, velocity=min(joint.velocity, float(np.sqrt(acceleration * travel)))
        )


def _find_gentle(
    moved: MovedObject, heavy: MovedObject, index: int, first: Float[np.ndarray, "k"], last: Float[np.ndarray, "k"]
) -> float:
    """Return the acceleration of a move at which the inertia of a heavy object is small beside what opposes."""
    terms = moved.bound_move(first, last)
    inertia = float(np.abs(heavy.bound_move(first, last).inertia[:, index]).max())
    if inertia <= 0.0:
        return np.inf
    travel = float(last[index] - first[index])
    low, high = (terms.still[:, index] + np.sign(travel) * moved.joints[index].friction).tolist()
    sizes = float(abs(low)), float(abs(high))
    opposed = min(sizes) if low * high > 0.0 else max(sizes)
    if not opposed and not moved.has_masses:
        return np.inf  # what nobody opposes, and nobody has weighed
    return max(INERTIA_SHARE * opposed / inertia, 4.0 * abs(travel) / SLOWEST_S**2)


def _bound_motion(terms: _Terms, moving: MechanismJoint) -> Float[np.ndarray, "2 k"]:
    """Return what all joints need because one speeds up, slows down and turns, within its limits."""
    most = np.abs(terms.inertia).max(axis=0) * moving.acceleration
    turning = np.stack([np.minimum(terms.centrifugal[0], 0.0), np.maximum(terms.centrifugal[1], 0.0)])
    return np.stack([-most, most]) + moving.velocity**2 * turning
