"""Hands that press on a mechanism give way to forces that the plan does not expect, beside the mechanism's own way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from service.errors import ExecutionError
from service.execution.offset import OffsetFilter
from service.request.fields import HAND_FRICTION
from service.verify import HandLoad, Phase, find_loaded_hand

WORKING = 0.1  # cosine between a load and the way of its place from which on it moves the mechanism


@dataclass(frozen=True)
class ReliefSettings:
    """How a hand gives way.

    Attributes:
        gain: speed of its target per newton beyond what is left to it [m/(N s)].
        dead_n: force beside the mechanism's way that is left to it, besides friction and the loads of the plan [N].
        most_m: largest displacement [m].
        fade_s: in which it goes back, once the hand carries no load [s].
    """

    gain: float = 5e-4
    dead_n: float = 15.0
    most_m: float = 0.03
    fade_s: float = 3.0

    def __post_init__(self) -> None:
        if not (self.gain >= 0.0 and self.dead_n >= 0.0 and self.most_m >= 0.0 and self.fade_s > 0.0):
            raise ExecutionError(
                f"relief: gain {self.gain:g}, dead_n {self.dead_n:g}, most_m {self.most_m:g}, fade_s "
                f"{self.fade_s:g}; expected 0 or more, and a positive time"
            )

    @property
    def offset(self) -> OffsetFilter:
        """Limit of the displacements, and their way back."""
        return OffsetFilter(self.most_m, self.fade_s)


@dataclass(frozen=True)
class _Load:
    """A load of a phase, the hand that carries it, and whether it moves the mechanism."""

    hand: str
    load: HandLoad
    is_working: bool


class HandRelief:
    """Displacements of hands whose measured force is not that of the plan.

    Along the way of the mechanism the force is what moves it, and the hand follows the plan.  Beside it a hand that is
    a few millimetres off, because the body came back from where it leaned or the mechanism is elsewhere, presses with
    hundreds of newtons on stiff servos and moves nothing.
    """

    def __init__(
        self, robot: RobotModel, phases: Sequence[Phase], hands: Sequence[str], settings: ReliefSettings
    ) -> None:
        """Sort the loads of all phases.

        Args:
            robot: of the plan, with the mechanism's joints.
            phases: of the plan.
            hands: links whose targets may be displaced.
            settings: how they give way.
        """
        self.settings = settings
        self._model: pin.Model = robot.model
        self._data = robot.model.createData()
        moved = {load.link for phase in phases for load in phase.loads}
        self._columns = self._list_columns(moved)
        self._phases = [self._sort_loads(phase, hands) for phase in phases]
        # A request has one interval for all hands. Plans that know no contact, as of assumed parts, state none.
        self._friction = min((push.friction[0] for phase in phases for push in phase.pushes), default=HAND_FRICTION[0])

    def step(
        self,
        offsets: Mapping[str, Float[np.ndarray, "3"]],
        number: int,
        planned: Float[np.ndarray, "n"],
        forces: Mapping[str, Float[np.ndarray, "3"]],
        period_s: float,
    ) -> dict[str, Float[np.ndarray, "3"]]:
        """Return the displacements of the hands one step later [m].

        Args:
            offsets: the earlier ones, by hand.
            number: of the phase.
            planned: configuration (n,) of the plan, mechanism included.
            forces: measured force on each tool, world axes [N].
            period_s: of the step [s].
        """
        made = {hand: self.settings.offset.fade(offset, period_s) for hand, offset in offsets.items()}
        loads = self._phases[number]
        if not loads:
            return made
        pin.framesForwardKinematics(self._model, self._data, planned)
        for hand in dict.fromkeys(entry.hand for entry in loads):
            own = [entry for entry in loads if entry.hand == hand and entry.load.tool in forces]
            if own:
                excess = self._find_excess(own, forces[own[0].load.tool])
                before = offsets.get(hand, np.zeros(3))
                made[hand] = self.settings.offset.move(before, self.settings.gain * excess, period_s)
        return made

    def _find_excess(self, loads: Sequence[_Load], force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Return the force on a hand beside the mechanism's way, beyond friction and the loads of the plan [N]."""
        acting = [self._turn(entry.load) for entry in loads]
        working = [axis for axis, entry in zip(acting, loads, strict=True) if entry.is_working]
        beside, left = -force, self.settings.dead_n
        if working:
            ways = np.linalg.svd(np.array(working), full_matrices=False)[2]
            beside = beside - ways.T @ (ways @ beside)
            left += self._friction * float(np.linalg.norm(np.sum(working, axis=0)))
        for axis, entry in zip(acting, loads, strict=True):
            if not entry.is_working:  # of any size up to its largest
                size = float(np.linalg.norm(axis))
                beside = beside - np.clip(beside @ axis / size, 0.0, size) * axis / size
        size = float(np.linalg.norm(beside))
        return np.zeros(3) if size <= left else -beside * (1.0 - left / size)

    def _turn(self, load: HandLoad) -> Float[np.ndarray, "3"]:
        """Return a load's force on the mechanism in world axes [N]."""
        return np.asarray(self._data.oMf[self._model.getFrameId(load.link)].rotation @ load.force)

    def _list_columns(self, links: set[str]) -> list[int]:
        """Return the coordinates that move links of the mechanism."""
        joints = {
            int(joint)
            for link in links
            for joint in self._model.supports[self._model.frames[self._model.getFrameId(link)].parentJoint]
        }
        return [int(self._model.joints[joint].idx_v) for joint in sorted(joints) if joint > 0]

    def _sort_loads(self, phase: Phase, hands: Sequence[str]) -> tuple[_Load, ...]:
        loads = []
        at_hands = (replace(load, tool=find_loaded_hand(phase, load)) for load in phase.loads)  # where it is measured
        for load in at_hands:
            joint = self._model.frames[self._model.getFrameId(load.tool)].parentJoint
            carried = list(self._model.supports[joint])
            hand = next(
                (h for h in hands if self._model.frames[self._model.getFrameId(h)].parentJoint in carried), None
            )
            if hand is not None:
                loads.append(_Load(hand, load, self._is_working(load)))
        return tuple(loads)

    def _is_working(self, load: HandLoad) -> bool:
        """Return whether a load's place moves along the load with some joint of the mechanism."""
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, pin.neutral(model))
        pin.updateFramePlacements(model, data)
        frame = model.getFrameId(load.link)
        jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL)[:, self._columns]
        ways = jacobian[:3] - np.cross(load.place, jacobian[3:].T).T
        sizes = np.linalg.norm(ways, axis=0) * np.linalg.norm(load.force)
        return bool(np.any(np.abs(load.force @ ways) > WORKING * np.maximum(sizes, 1e-12)))
