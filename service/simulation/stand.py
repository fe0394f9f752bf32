"""A robot in physics that stands where a plan begins, for executions with online pose control."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from service.demands.kind import read_mechanism_physics
from service.execution.driver import JointCommand
from service.execution.reference import PlannedReference
from service.replay.replay import read_request
from service.request.schema import PlanRequest
from service.result.folder import read_result
from service.simulation.model import build_physics
from service.simulation.options import SimulationOptions
from service.simulation.robot import SimulatedRobot
from service.start.robot import resolve_stiffness


def stand_in_physics(
    reference: PlannedReference,
    request: PlanRequest,
    options: SimulationOptions,
    steps: int = 1,
    stands: Float[np.ndarray, "n"] | None = None,
) -> SimulatedRobot:
    """Return a simulated robot that has been told to stand at the start of a plan for ``options.settle_s``.

    Args:
        reference: the plan.
        request: of the plan, for its servos and its mechanism.
        options: of the simulation; without a friction of the hands they have the least one of the request.
        steps: of the physics, 1 ms each, per command.
        stands: configuration of the plan's model in which it stands before; None for the plan's start.

    Raises:
        ResultError: MuJoCo is not installed, or cannot use the robot.
    """
    if options.hand_friction is None:
        options = replace(options, hand_friction=request.options.hand_friction[0])
    stiffness = resolve_stiffness(reference.motion.robot, request)
    model = build_physics(reference.motion, read_mechanism_physics(request), options, stiffness)
    start = reference.at(0.0)
    robot = SimulatedRobot(model, start.configuration if stands is None else stands, options, steps)
    still = JointCommand(start.q, np.zeros_like(start.qd), start.tau)
    for _ in range(round(options.settle_s / robot.period_s)):
        robot.command(still)
    return robot


def read_recorded_request(folder: str | Path) -> PlanRequest:
    """Return the request of a result folder (ResultError: the folder cannot be read)."""
    path = Path(folder)
    return read_request(read_result(path), path.parent if path.is_file() else path)
