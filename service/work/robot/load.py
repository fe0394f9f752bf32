"""A stored plan made ready to be carried out: verified anew, with the hash of the very curve that will be executed."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

from service.errors import ExecutionError
from service.execution.reference import PlannedReference
from service.execution.replan import read_certified
from service.execution.settings import ExecutionSettings
from service.execution.watch.servos import ServoModel
from service.execution.watch.watch import WatchSettings
from service.result.folder import read_result
from service.result.motion_json import file_columns, file_positions, sample_times, samples_of
from service.simulation.stand import read_recorded_request
from service.start.robot import resolve_stiffness
from service.verify import Motion, find_mechanism_joints
from service.wire.hashes import hash_trajectory


@dataclass(frozen=True)
class LoadedPlan:
    """A plan that can be carried out.

    Attributes:
        reference: the plan as functions of time.
        settings: of its execution, with the servos of its request.
        folder: its result folder.
        trajectory_sha256: of the samples of the curve that is carried out.
        scene_sha256: of the pieces that the result records.
    """

    reference: PlannedReference
    settings: ExecutionSettings
    folder: Path
    trajectory_sha256: str
    scene_sha256: str


def load_plan(folder: Path, trajectory_sha256: str, *, is_proven: bool = False) -> LoadedPlan:
    """Read a result folder, verify its motion, and compare its curve with that which the operator has seen.

    Args:
        folder: of the result.
        trajectory_sha256: of the curve that the operator has seen.
        is_proven: whether the service has just certified these very files itself; they are not verified again then.

    Raises:
        ExecutionError, ResultError, RequestError: one sentence: it is not certified now, is another plan, or cannot be
            carried out.
    """
    reference = PlannedReference.read(folder) if is_proven else read_certified(folder)
    found = hash_motion(reference.motion)
    if found != trajectory_sha256:
        raise ExecutionError(
            f"trajectory_sha256: the curve of the plan's files has {found[:12]}…, not {trajectory_sha256[:12]}…; look "
            "at the plan again"
        )
    stiffness = resolve_stiffness(reference.robot, read_recorded_request(folder))
    settings = ExecutionSettings(watch=WatchSettings(servos=ServoModel(stiffness=stiffness)))
    pieces = json.dumps(read_result(folder)["pieces"], sort_keys=True).encode()
    return LoadedPlan(reference, settings, folder, found, hashlib.sha256(pieces).hexdigest())


def hash_motion(motion: Motion) -> str:
    """Return the hash of a motion's samples, as results state it: of the robot alone, without what it moves."""
    model = motion.robot.model
    n_moved = sum(int(model.joints[joint].nv) for joint in find_mechanism_joints(motion))  # the last columns
    names = file_columns(motion.robot)
    positions = file_positions(motion.robot, motion.curve(samples_of(motion))[:, : motion.robot.n])
    n_own = len(names) - n_moved
    return hash_trajectory(names[:n_own], sample_times(motion), positions[:, :n_own])
