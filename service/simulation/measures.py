"""What a record is measured by: poses and centres of mass along it, slip of planted links, forces of hands."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from service.execution.reference import PlannedReference, ReferencePhase
from service.simulation.run import Record

FILTER_SAMPLES = 3  # samples of 20 ms whose mean is a force's value


class Frames:
    """Poses of frames and the centre of mass along the record, simulated and planned."""

    def __init__(self, reference: PlannedReference, record: Record, names: Iterable[str]) -> None:
        model: pin.Model = reference.robot.model
        self._index = {name: k for k, name in enumerate(dict.fromkeys(names))}
        frames = [model.getFrameId(name) for name in self._index]
        self._poses = np.zeros((2, len(record.times), len(frames), 4, 4))
        self._com = np.zeros((2, len(record.times), 3))
        data = model.createData()
        for k, table in enumerate((record.configuration, record.planned)):
            for i, q in enumerate(table):
                self._com[k, i] = pin.centerOfMass(model, data, q, False)
                for j, frame in enumerate(frames):
                    self._poses[k, i, j] = pin.updateFramePlacement(model, data, frame).homogeneous

    def place(self, frame: str, planned: bool = False) -> Float[np.ndarray, "S 4 4"]:
        """Return the poses of a frame."""
        return np.asarray(self._poses[int(planned), :, self._index[frame]])

    def locate(self, frame: str, planned: bool = False) -> Float[np.ndarray, "S 3"]:
        """Return the origins of a frame [m]."""
        return self.place(frame, planned)[:, :3, 3]

    def com(self, planned: bool = False) -> Float[np.ndarray, "S 3"]:
        """Return the centres of mass [m]."""
        return np.asarray(self._com[int(planned)])


def list_planted(reference: PlannedReference) -> list[str]:
    """Return the links that the plan plants in any phase."""
    return list(dict.fromkeys(contact.link for phase in reference.phases for contact in phase.contacts))


def list_rows(record: Record, phase: ReferencePhase) -> np.ndarray:
    """Return the samples of a phase."""
    return np.flatnonzero((record.times >= phase.begin_s - 1e-9) & (record.times <= phase.end_s + 1e-9))


def smooth(values: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
    """Return the mean of neighbouring samples, which leaves out the impacts of a single instant."""
    width = min(FILTER_SAMPLES, len(values))
    return np.convolve(values, np.ones(width) / width, mode="same") if len(values) else values


def measure_hand_force(robot: RobotModel, record: Record, tool: str) -> Float[np.ndarray, "S"]:
    """Return the size of the force of hand, rod and fingers of a tool on the mechanism, mean of 60 ms [N]."""
    model: pin.Model = robot.model
    carrier = int(model.frames[model.getFrameId(tool)].parentJoint)
    total = np.zeros((len(record.times), 3))
    for (frame, _), force in record.mechanism_force.items():
        if carrier in list(model.supports[model.frames[model.getFrameId(frame)].parentJoint]):
            total += force
    return np.asarray(np.linalg.norm([smooth(column) for column in total.T], axis=0))


def measure_slips(
    reference: PlannedReference, record: Record, frames: Frames
) -> dict[str, tuple[Float[np.ndarray, "S"], Float[np.ndarray, "S"]]]:
    """Return per planted link times and distances along the ground from where it was planted [s, m].

    Measured at the middle of its contact points, from a fifth of a second after it came.
    """
    slips: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for link in list_planted(reference):
        poses = frames.place(link)
        times, distances = [], []
        rows: list[int] = []
        for k, phase in enumerate(reference.phases):
            contact = next((c for c in phase.contacts if c.link == link), None)
            if contact is not None:
                rows += [row for row in list_rows(record, phase).tolist() if not rows or row > rows[-1]]
                after = reference.phases[k + 1].contacts if k + 1 < len(reference.phases) else ()
                if any(c.link == link for c in after):
                    continue
                held = [row for row in rows if record.times[row] >= record.times[rows[0]] + 0.2] or rows
                middle = contact.sole.mean(axis=0)
                at = poses[held][:, :3, :3] @ middle + poses[held][:, :3, 3]
                normal = contact.pose_world_link[:3, 2] if contact.normal is None else contact.normal
                moved = at - at[:1] if len(at) else at
                along = moved - (moved @ normal)[:, None] * normal
                times.append(record.times[held])
                distances.append(np.linalg.norm(along, axis=1))
            rows = []
        if times and sum(len(part) for part in times):
            slips[link] = (np.concatenate(times), np.concatenate(distances))
    return slips
