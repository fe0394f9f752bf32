"""The problem of a request, held to the request's robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES, RobotModel
from service.errors import RequestError
from service.request.schema import PlanRequest, StartRequest
from service.trajopt.manip import manip_columns
from service.trajopt.program import Program
from service.trajopt.reader import read_problem
from service.trajopt.resolve import is_given, resolve


def requested_start(request: PlanRequest, robot: RobotModel) -> StartRequest:
    """The start of a request; where it is silent, joints start at the first row of the problem's trajectory."""
    document = None if request.task is None else request.task.trajopt
    problem = None if document is None else read_problem(document).problem
    if problem is None or not problem.init.data:
        return request.start
    row, (columns, _) = problem.init.data[0], manip_columns(robot, problem.basic.manip)
    if len(row) != len(columns):
        return request.start
    joints = {
        robot.joint_names[column]: value
        for column, value in zip(columns, row, strict=True)
        if robot.joint_names[column] not in BASE_NAMES
        and robot.lower[column] <= value <= robot.upper[column]
        and not is_given(request.start, robot.joint_names[column])
    }
    return replace(request.start, joints={**request.start.joints, **joints})


def requested_program(request: PlanRequest, robot: RobotModel, start: Float[np.ndarray, "n"]) -> Program | None:
    """The program of ``task.trajopt``, if that is what a request asks for.

    Args:
        request: what is asked.
        robot: its robot.
        start: (n,) where the request puts it.

    Raises:
        RequestError: one line for everything wrong with the problem.
    """
    document = None if request.task is None else request.task.trajopt
    if document is None:
        return None
    reading = read_problem(document)
    findings = list(reading.findings)
    if request.options.waypoints is not None:
        findings.append("options.waypoints: basic_info.n_steps says how many; leave it out")
    if request.options.feet is not None:
        findings.append("options.feet: pose constraints and zmp of the problem say what is planted; leave it out")
    program = None
    if reading.problem is not None:
        # Also of a problem with findings: what is wrong with the rest of it is told at the same time.
        resolved = resolve(reading.problem, robot, start, request.start)
        program, findings = resolved.program, [*findings, *resolved.findings]
    if findings or program is None:
        raise RequestError(findings)
    return program
