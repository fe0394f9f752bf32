"""Chains of joints, and the bound of how far a point of the robot can leave its chord.

On an interval of length ``h`` with ``|dq_i/ds| <= a_i`` and ``|d2q_i/ds2| <= b_i`` every point of a body stays within

    h^2/8 * (sum_ij a_i a_j w_ij + sum_i b_i r_i)

of the chord between its end positions, since a path leaves its chord by at most ``h^2/8 max|p''|``.  ``r_i`` bounds
``|dp/dq_i|``: the distance from joint i's origin to the body's farthest point for a revolute joint, 1 for a prismatic
one.  ``w_ij = |d2p/dq_i dq_j|`` is bounded by ``r`` of the more distal of the two if the more proximal is revolute and
vanishes if it is prismatic.  A joint that follows a coordinate (``mimic``: angle = ratio * q + offset) is a joint of
its own here, whose rates are those of its coordinate times the ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from service.verify.curves.bounds import RateBounds
from service.verify.motion import VerifyError

_REVOLUTE = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")
_PRISMATIC = ("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned")
_SEVERAL = {"JointModelTranslation": (False,) * 3, "JointModelSphericalZYX": (True,) * 3}


@dataclass(frozen=True)
class JointChain:
    """Coordinates between a frame and a body, from the frame outwards; or, row by row, those of many bodies.

    Rows of fewer coordinates than the longest are filled up with coordinate 0 at a reach of 0.

    Attributes:
        coordinates: (m,) or (C, m) indices into the configuration.
        joints: pinocchio joint of each.
        is_revolute: true for revolute, false for prismatic coordinates.
        reach: largest ``|dp/dq|`` of a point of the body whatever the configuration, ``q`` the joint's own [m/rad, 1].
        base_rotations: the base's angles, which are exported as a quaternion.
        ratio: size of the joint's motion per motion of its coordinate; 1 except for a joint that follows another one.
    """

    coordinates: Int[np.ndarray, "*C m"]
    joints: Int[np.ndarray, "*C m"]
    is_revolute: Bool[np.ndarray, "*C m"]
    reach: Float[np.ndarray, "*C m"]
    base_rotations: Bool[np.ndarray, "*C m"]
    ratio: Float[np.ndarray, "*C m"]

    @staticmethod
    def stack(chains: Sequence[JointChain]) -> JointChain:
        """Stack chains row by row."""
        width = max((len(chain.coordinates) for chain in chains), default=0)
        shape = (len(chains), width)
        stacked = JointChain(*(np.zeros(shape, dtype) for dtype in (int, int, bool, float, bool, float)))
        if not width:
            return stacked
        lengths = np.array([len(chain.coordinates) for chain in chains])
        row = np.repeat(np.arange(len(chains)), lengths)
        column = np.arange(len(row)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        for name in _COLUMNS:
            getattr(stacked, name)[row, column] = np.concatenate([getattr(chain, name) for chain in chains])
        return stacked

    def take(self, rows: Int[np.ndarray, "E"]) -> JointChain:
        """Return these rows, in this order."""
        return JointChain(*(getattr(self, name)[rows] for name in _COLUMNS))

    @cached_property
    def weight(self) -> float:
        """Rotation bound for equal rates, to choose in whose frame a pair is swept."""
        turning = self.is_revolute.astype(float)
        return float((self.reach * (2.0 * np.cumsum(turning) - turning)).sum())

    def deviation(self, over: RateBounds, reach: Float[np.ndarray, "I m"] | None = None) -> Float[np.ndarray, "I"]:
        """Bound the distance of any point of the body from its chord on each interval [m]; many bodies: row by row."""
        r = self.reach if reach is None else reach
        a = self._own(over.speed)
        turning = a * self.is_revolute
        proximal = np.cumsum(turning, axis=1) - turning
        curvature = r * (a * (2.0 * proximal + turning) + self._own(over.bend))
        return np.asarray(over.length**2 / 8.0 * curvature.sum(axis=1))

    def travel(self, over: RateBounds) -> Float[np.ndarray, "I"]:
        """Bound the length of the path of any point of the body on each interval [m]."""
        return np.asarray(over.length * (self.reach * self._own(over.speed)).sum(axis=1))

    def sampling_slack(self, over: RateBounds, rounding: float) -> Float[np.ndarray, "I"]:
        """Bound the distance of a point of the body from the curve when exported samples are read linearly [m].

        Joint by joint the line leaves the curve by at most ``step^2/8 |q''|``; a base read by slerp leaves the z-y-x
        angles by at most ``(sum |step q'|)^2 / 4`` (twice the chord bound of a rotation); ``rounding`` is the
        error of a written coordinate.
        """
        line = over.step[:, None] ** 2 / 8.0 * self._own(over.step_bend) + rounding * self.ratio
        slack = (self.reach * line).sum(axis=1)
        if np.any(self.base_rotations):
            turn = (over.step[:, None] * self._own(over.step_speed) * self.base_rotations).sum(axis=1)
            slack = slack + turn**2 / 4.0 * (self.reach * self.base_rotations).max(axis=-1)
        return np.asarray(np.where(over.step > 0.0, slack, 0.0))

    def local_reach(self, distance: Float[np.ndarray, "I m"], over: RateBounds) -> Float[np.ndarray, "I m"]:
        """Return the reach on each interval, from distances of joint origins to the farthest point at its middle.

        Only more distal joints change such a distance, each by at most ``speed * reach`` per unit of the path.
        """
        travel = self._own(over.speed) * self.reach
        distal = np.cumsum(travel[:, ::-1], axis=1)[:, ::-1] - travel
        local = np.minimum(self.reach, distance + 0.5 * over.length[:, None] * distal)
        return np.asarray(np.where(self.is_revolute, local, self.reach))

    def _own(self, rates: Float[np.ndarray, "I n"]) -> Float[np.ndarray, "I m"]:
        """Return the rates of the chain's joints from rates of all coordinates."""
        if self.coordinates.ndim == 1:
            return np.asarray(rates[:, self.coordinates] * self.ratio)
        return np.asarray(np.take_along_axis(rates, self.coordinates, axis=1) * self.ratio)


_COLUMNS = tuple(item.name for item in fields(JointChain))


class JointTree:
    """Joints of a robot with what chains need: coordinates, offsets and travels."""

    def __init__(self, model: pin.Model, travel: Float[np.ndarray, "n"], n_base: int) -> None:
        """Read the joints; ``travel`` is the largest ``|q|`` of each coordinate, ``n_base`` the base's coordinates.

        Raises:
            VerifyError: for a joint that is neither revolute nor prismatic nor the composite base.
        """
        self._parents = [int(p) for p in model.parents]
        self._origins = np.array([placement.translation for placement in model.jointPlacements])
        self._offsets: list[float] = np.linalg.norm(self._origins, axis=1).tolist()
        self._axes: list[list[_Axis]] = [[] for _ in range(model.njoints)]
        for joint in range(1, model.njoints):
            made, name = model.joints[joint], model.names[joint]
            start, ratio, offset = int(made.idx_v), 1.0, 0.0
            kinds: tuple[bool, ...]
            if made.shortname() == "JointModelMimic":
                follower = made.extract()
                ratio, offset = float(follower.scaling), float(follower.offset)
                kinds = (_read_follower(model, joint),)
            else:
                kinds = _joint_kinds(made, name)
            self._axes[joint] = [
                _Axis(start + k, kind, abs(ratio), abs(ratio) * float(travel[start + k]) + abs(offset))
                for k, kind in enumerate(kinds)
            ]
        self._n_base = n_base
        self._known = _borrow_chains(model)

    @property
    def travels(self) -> tuple[float, ...]:
        """Farthest position of each sliding axis from zero [m]."""
        return tuple(axis.travel for own in self._axes for axis in own if not axis.is_revolute)

    def ancestors(self, joint: int) -> list[int]:
        """Return the joint and its ancestors up to, not including, the universe."""
        path = []
        while joint > 0:
            path.append(joint)
            joint = self._parents[joint]
        return path

    def chain_of_body(self, holder: int, mover: int, vertices: Float[np.ndarray, "V 3"]) -> JointChain:
        """Return ``chain`` of a body's own vertices, which is known from other motions with the same travels."""
        known = self._known.get((holder, mover, id(vertices)))
        if known is None or known.vertices is not vertices or not all(axis in self._axes[j] for j, axis in known.needs):
            chain = self.chain(holder, mover, vertices)
            joints = {*self.ancestors(holder)} ^ {*self.ancestors(mover)}
            needs = tuple((j, axis) for j in joints for axis in self._axes[j] if not axis.is_revolute)
            known = self._known[holder, mover, id(vertices)] = _KnownChain(vertices, needs, chain)
        return known.chain

    def chain(self, holder: int, mover: int, points: Float[np.ndarray, "V 3"]) -> JointChain:
        """Return the chain that moves ``points`` (in the frame of joint ``mover``) in the frame of joint ``holder``."""
        poll()
        up, down = self.ancestors(holder), self.ancestors(mover)
        while up and down and up[-1] == down[-1]:
            up.pop()
            down.pop()
        rows: list[tuple[int, _Axis, float]] = []
        length = _farthest(points)
        for joint in down:
            length = self._pass(joint, length, rows, outwards=False)
            length += self._offsets[joint] if joint != down[-1] else 0.0
        if up and down:
            length += float(np.linalg.norm(self._origins[up[-1]] - self._origins[down[-1]]))
        elif up:
            length = _farthest(points - self._origins[up[-1]])
        for joint in reversed(up):
            length += self._offsets[joint] if joint != up[-1] else 0.0
            length = self._pass(joint, length, rows, outwards=True)
        rows.reverse()
        axes = [row[1] for row in rows]
        coordinates = np.array([axis.coordinate for axis in axes], dtype=int)
        is_revolute = np.array([axis.is_revolute for axis in axes], dtype=bool)
        return JointChain(
            coordinates,
            np.array([row[0] for row in rows], dtype=int),
            is_revolute,
            np.array([row[2] for row in rows], dtype=float),
            (coordinates < self._n_base) & is_revolute,
            np.array([axis.ratio for axis in axes], dtype=float),
        )

    def distance(self, joint: int, points: Float[np.ndarray, "V 3"]) -> float:
        """Bound the distance of points in the frame of a joint from the world's origin in all configurations [m]."""
        slides = [axis.travel for own in self.ancestors(joint) for axis in self._axes[own] if not axis.is_revolute]
        return _farthest(points) + sum(slides) + sum(self._offsets[own] for own in self.ancestors(joint))

    def _pass(self, joint: int, length: float, rows: list[tuple[int, _Axis, float]], *, outwards: bool) -> float:
        """Append the joint's axes, the most distal first; return the length beyond the joint."""
        own = self._axes[joint]
        for axis in own if outwards else reversed(own):
            rows.append((joint, axis, length if axis.is_revolute else 1.0))
            length += 0.0 if axis.is_revolute else axis.travel
        return length


@dataclass(frozen=True)
class _Axis:
    """An axis of a joint.

    Attributes:
        coordinate: that moves it.
        is_revolute: true if it turns, false if it slides.
        ratio: size of its motion per motion of its coordinate.
        travel: its farthest position from zero [rad, m].
    """

    coordinate: int
    is_revolute: bool
    ratio: float
    travel: float


@dataclass(frozen=True)
class _KnownChain:
    """A chain that was computed for another motion.

    Attributes:
        vertices: the body's own, by whose identity it is found.
        needs: sliding axes with the travels that its reaches count.
        chain: the chain.
    """

    vertices: Float[np.ndarray, "V 3"]
    needs: tuple[tuple[int, _Axis], ...]
    chain: JointChain


_CHAINS: dict[int, tuple[pin.Model, dict[tuple[int, int, int], _KnownChain]]] = {}
_KEPT = 4  # models


def _borrow_chains(model: pin.Model) -> dict[tuple[int, int, int], _KnownChain]:
    """Return the chains that are known of a model that is not changed any more."""
    known = _CHAINS.pop(id(model), (model, {}))
    while len(_CHAINS) >= _KEPT:
        _CHAINS.pop(next(iter(_CHAINS)), None)
    _CHAINS[id(model)] = known  # the last one used is the last one dropped
    return known[1]


def _farthest(points: Float[np.ndarray, "V 3"]) -> float:
    """Return the largest distance of a point from the origin [m]."""
    return math.sqrt(np.einsum("vk,vk->v", points, points).max())


def _read_follower(model: pin.Model, joint: int) -> bool:
    """Return whether a joint that follows another turns (True) or slides (False), from the axis of its motion.

    Raises:
        VerifyError: it does neither.
    """
    made = model.joints[joint]
    data = made.createData()
    made.calc(data, np.zeros(model.nq), np.zeros(model.nv))
    axis = np.asarray(data.S, dtype=float).reshape(6, -1)
    # pinocchio has the ratio in the axis.
    linear, angular = float(np.linalg.norm(axis[:3])), float(np.linalg.norm(axis[3:]))
    if axis.shape[1] != 1 or min(linear, angular) > 0.0 or not max(linear, angular) > 0.0:
        raise VerifyError(
            f"joint '{model.names[joint]}' follows another one, but neither turns nor slides about an axis"
        )
    return angular > 0.0


def _joint_kinds(joint: pin.JointModel, name: str) -> tuple[bool, ...]:
    """Return per coordinate of a joint whether it is revolute (True) or prismatic (False)."""
    kind = joint.shortname()
    if kind in _REVOLUTE:
        return (True,)
    if kind in _PRISMATIC:
        return (False,)
    if kind in _SEVERAL:
        return _SEVERAL[kind]
    if kind == "JointModelComposite":
        composite = joint.extract()
        shifts = [np.abs(p.translation).max() for p in composite.jointPlacements]
        if max(shifts) > 0.0:
            raise VerifyError(f"joint '{name}' is a composite whose parts do not share one origin")
        return tuple(flag for part in composite.joints for flag in _joint_kinds(part, name))
    raise VerifyError(f"joint '{name}' is a {kind}; revolute, prismatic and the floating base can be verified")
