"""What taking an object and putting it down demands of any motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from costs.robot import RobotModel
from costs.robot.carried import MovableObject
from service.demands.grasping.gripper import Gripper
from service.demands.pick_place.hands import make_closed_chain, make_grasp_targets
from service.demands.pick_place.work import LIFT, LOWER, PHASES, TOGETHER, PickPlace
from service.demands.stance import UNSETTLED
from service.demands.task_demand import RecordDemand, TaskDemand, World
from service.verify import Motion, Target, place_frames, split_motion


@dataclass(frozen=True)
class PickPlaceDemand(TaskDemand):
    """An object that is taken, carried, and put down where it rests.

    Attributes:
        work: of the request.
        grippers: that the request permits.
    """

    work: PickPlace
    grippers: tuple[Gripper, ...]

    @property
    def objects(self) -> tuple[MovableObject, ...]:
        """The object."""
        return (self.work.item,)

    @property
    def can_escape(self) -> bool:
        """Not yet."""
        return False

    def demand_phases(self, world: World, robot: RobotModel, recorded: Motion) -> RecordDemand:
        """Demand the phases of the work with the hands of the record."""
        names = [phase.name for phase in recorded.phases]
        work = [name for name in names if name not in UNSETTLED]
        problems = []
        if tuple(work) != PHASES:
            problems.append(f"the phases are {', '.join(work)}; the task has {', '.join(PHASES)}")
        chosen = self.find_grippers(recorded)
        if isinstance(chosen, str):
            problems.append(chosen)
            chosen = self.grippers[: 2 if self.work.request.hand == "both" else 1]
        demands = []
        for phase in recorded.phases:
            targets: list[Target] = []
            if phase.name == LIFT and self.work.given.grasps:
                targets += make_grasp_targets(self.work, recorded, phase, chosen)
            if phase.name == LOWER:
                targets.append(self.work.make_place_target(phase.last))
            if phase.name in TOGETHER:
                targets += make_closed_chain(recorded, chosen)
            demands.append(self.work.make_phase(phase.name, chosen, tuple(targets)))
        return RecordDemand(tuple(demands), tuple(problems))

    def find_grippers(self, recorded: Motion) -> tuple[Gripper, ...] | str:
        """Return the grippers that a record uses, the leading one first, or a sentence why the request forbids them."""
        phase = next((phase for phase in recorded.phases if phase.name == LIFT), None)
        links = [carrier.link for carrier in phase.carriers if carrier.link] if phase is not None else []
        leading = [gripper for gripper in self.grippers if gripper.link in links]
        if len(links) != 1 or not leading:
            return "the hand that lifts the object is not one that the request permits"
        if self.work.request.hand != "both":
            return (leading[0],)
        return (leading[0], *(gripper for gripper in self.grippers if gripper.link != leading[0].link))

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure how far the object is moved, and how far it ends from its place."""
        last = split_motion(motion)[-1]
        pose = place_frames(last.robot, last.curve.positions[-1], [self.work.item.name])[self.work.item.name]
        moved = float(np.linalg.norm(pose[:3, 3] - self.work.item.start[:3, 3]))
        off = float(np.linalg.norm(pose[:3, 3] - self.work.place[:3, 3]))
        return {"moved_m": moved, "off_place_mm": 1e3 * off}
