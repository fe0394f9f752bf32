"""What a run with online pose control shows of the work of a plan."""

from __future__ import annotations

import numpy as np

from service.execution.execution import Execution
from service.execution.reference import PlannedReference
from service.simulation.robot import SimulatedRobot
from service.simulation.run import has_fallen
from service.simulation.seen import Seen
from service.simulation.verdict import Judgement, judge

SAMPLE_S = 0.02


class WorkWatch:
    """Samples of a simulated robot that follows a plan, and their verdict.

    Where another plan takes over, the samples begin anew: the verdict is on the last plan.
    """

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        self._every = max(round(SAMPLE_S / robot.period_s), 1)
        self._count = 0
        self._begin(None)

    def _begin(self, reference: PlannedReference | None) -> None:
        self._reference = reference
        self._times: list[float] = []
        self._configuration: list[np.ndarray] = []
        self._planned: list[np.ndarray] = []
        self._latched: list[tuple[bool, ...]] = []
        self._objects: dict[str, list[np.ndarray]] = {name: [] for name in self._robot.model.objects}
        self._after_s = 0.0
        self._fell_at_s: float | None = None

    def look(self, execution: Execution) -> None:
        """Take one cycle of an execution."""
        if execution.reference is not self._reference:
            self._begin(execution.reference)
        self._after_s += self._robot.period_s if execution.state.is_over else 0.0
        self._count += 1
        if self._count % self._every:
            return
        time_s = execution.state.time_s + self._after_s
        wanted = execution.reference.at(time_s)
        self._times.append(max(time_s, self._times[-1]) if self._times else time_s)  # an abort goes back
        self._configuration.append(self._robot.configuration())
        self._planned.append(wanted.configuration)
        self._latched.append(self._robot.is_latched)
        for name, pose in self._robot.locate_objects().items():
            self._objects[name].append(pose)
        if self._fell_at_s is None and has_fallen(self._robot.pose_world_base, wanted):
            self._fell_at_s = time_s

    def judge(self) -> Judgement:
        """Return the verdict on the plan."""
        if self._reference is None or not self._times:
            raise ValueError("no cycle was carried out")
        seen = Seen(
            np.array(self._times),
            np.stack(self._configuration),
            np.stack(self._planned),
            np.array(self._latched, dtype=bool).reshape(len(self._times), -1),
            self._fell_at_s,
            objects={name: np.stack(poses) for name, poses in self._objects.items()},
        )
        return judge(self._reference, seen, self._robot.model.physics)
