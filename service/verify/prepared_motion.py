"""The motion as all proofs use it: phases, joint placements along the curve, derivative bounds, joint chains."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float, Int

from costs.stopping import poll
from costs.work_space import borrow_data
from service.verify.carrying.placing import split_motion
from service.verify.curves.bounds import RateBounds, Rates, position_range
from service.verify.joint_chain import JointTree
from service.verify.motion import Motion, Phase, VerifyError
from service.verify.timeline import list_phases, split_at_phases

_POLLED = 64  # configurations between two polls: a millisecond


@dataclass(frozen=True)
class Placements:
    """Joint frames in the world at ``S`` configurations.

    Attributes:
        rotation: (S, J, 3, 3) rotation_world_joint.
        translation: (S, J, 3) joint origins [m].
    """

    rotation: Float[np.ndarray, "S J 3 3"]
    translation: Float[np.ndarray, "S J 3"]

    def relative(
        self, holder: int, mover: int, rows: np.ndarray | slice | int = slice(None)
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return rotation (S, 3, 3) and translation (S, 3) of joint ``mover`` in the frame of joint ``holder``."""
        rotation, translation = self.rotation[rows, mover], self.translation[rows, mover]
        if holder == 0:
            return rotation, translation
        transposed = np.swapaxes(self.rotation[rows, holder], -1, -2)
        offset = translation - self.translation[rows, holder]
        return transposed @ rotation, (transposed @ offset[..., None])[..., 0]


class ForwardKinematics:
    """Forward kinematics at many configurations."""

    def __init__(self, model: pin.Model) -> None:
        """Prepare for configurations of this model.

        Raises:
            VerifyError: when pinocchio keeps its placements in another way than they are read here.
        """
        self._model = model
        _view_placements(model, borrow_data(model))

    def at(self, configurations: Float[np.ndarray, "S n"]) -> Placements:
        """Return joint placements at every configuration.

        Raises:
            VerifyError: when a configuration is not finite or has the wrong length.
        """
        q, model = np.ascontiguousarray(configurations, dtype=float), self._model
        if q.ndim != 2 or q.shape[1] != model.nq or not np.all(np.isfinite(q)):
            raise VerifyError(f"configurations must be finite and have {model.nq} columns, got shape {q.shape}")
        data = borrow_data(model)
        view, block = _view_placements(model, data), np.empty((len(q), model.njoints, 12))
        for number, configuration in enumerate(q):
            if number % _POLLED == 0:
                poll()
            pin.forwardKinematics(model, data, configuration)
            block[number] = view
        rotation = np.swapaxes(block[..., :9].reshape(len(q), model.njoints, 3, 3), -1, -2)
        return Placements(np.ascontiguousarray(rotation), np.ascontiguousarray(block[..., 9:]))


def _view_placements(model: pin.Model, data: pin.Data) -> Float[np.ndarray, "J 12"]:
    """Return a live view of all joint placements: 12 doubles each, the rotation column by column.

    One strided view reads them all at once, hundreds of times faster than element by element.

    Raises:
        VerifyError: when pinocchio keeps them in another way.
    """
    first = data.oMi[0].rotation
    view = np.lib.stride_tricks.as_strided(first.T.reshape(-1), shape=(model.njoints, 12), strides=(96, 8))
    if not np.shares_memory(view, first):
        raise VerifyError("pinocchio's joint placements cannot be read as one block")
    return view


class _KnownPlacements:
    """Placements of a robot's joints along a curve, computed once per path parameter."""

    def __init__(self, motion: Motion) -> None:
        self._curve = motion.curve
        self._forward = ForwardKinematics(motion.robot.model)
        self._rows: dict[float, int] = {}
        self._placed = self._forward.at(motion.curve(motion.curve.knots[:0]))

    def at(self, s: Float[np.ndarray, "S"]) -> tuple[Placements, Int[np.ndarray, "S"]]:
        """Return all placements that are known, and which of their rows belong to these path parameters."""
        wanted = s.tolist()
        new = [place for place in dict.fromkeys(wanted) if place not in self._rows]
        if new:
            self._append(new)
        return self._placed, np.array([self._rows[place] for place in wanted], dtype=int)

    def _append(self, new: list[float]) -> None:
        """Append placements at new path parameters; memory that is full is doubled."""
        placed, first = self._forward.at(self._curve(np.array(new))), len(self._rows)
        last = first + len(new)
        if last > len(self._placed.translation):
            larger = [np.empty((2 * last, *part.shape[1:])) for part in (placed.rotation, placed.translation)]
            larger[0][:first], larger[1][:first] = self._placed.rotation[:first], self._placed.translation[:first]
            self._placed = Placements(larger[0], larger[1])
        self._placed.rotation[first:last], self._placed.translation[first:last] = placed.rotation, placed.translation
        self._rows.update(zip(new, range(first, last), strict=True))


class PreparedMotion:
    """A motion with what every proof about it uses, prepared once.

    Attributes:
        motion: the motion; that of ``in_phase`` has objects as links of its robot.
        phases: its phases in order, or a single one without promises.
        edges: (E,) knots and phase boundaries in order.
        edge_phase: (E-1,) index of the phase between two neighbouring edges.
        range: smallest and largest value of every coordinate on every knot interval, (K-1, n) each.
        tree: the robot's joints, with the range that its sliding joints use.
    """

    def __init__(self, motion: Motion) -> None:
        """Prepare.

        Raises:
            VerifyError: for phases that do not cover the curve, joints that cannot be verified, samples that leave
                out a knot, or carriers that the motion lacks.
        """
        self.motion = motion
        self.phases = list_phases(motion)
        self.edges, self.edge_phase = split_at_phases(motion, self.phases)
        self.range = low, high = position_range(motion.curve)
        travel = np.maximum(np.abs(low).max(axis=0), np.abs(high).max(axis=0))
        self.tree = JointTree(motion.robot.model, travel, 6 if motion.robot.is_floating else 0)
        self._rates = Rates(motion.curve, motion.samples)
        self._known = _KnownPlacements(motion)
        self._parts = split_motion(motion)

    def in_phase(self, phase: Phase) -> PreparedMotion:
        """Return the same with the objects where they are during a phase: coordinates and joints do not change."""
        number = next(k for k, own in enumerate(self.phases) if own is phase)
        part = self._parts[number]
        if part is self.motion:
            return self
        placed = copy(self)
        placed.motion = part
        return placed

    def at(self, s: Float[np.ndarray, "S"]) -> tuple[Placements, Int[np.ndarray, "S"]]:
        """Return joint placements, and which of their rows belong to these path parameters.

        Placements are kept: ends of intervals are middles of longer ones, and many proofs use the same poses.
        """
        return self._known.at(s)

    def over(self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]) -> RateBounds:
        """Return bounds of the curve's derivatives on intervals, none of which may cross a knot."""
        return self._rates.over(first, last)
