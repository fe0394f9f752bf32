"""Problem documents for tests: the example arm and Atlas, and the shortest way from a document to a program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from costs.robot import RobotModel, load_robot
from service.request.schema import StartRequest
from service.start.configuration import make_start_configuration
from service.trajopt.program import Program
from service.trajopt.reader import read_problem
from service.trajopt.resolve import Resolved, resolve

EXAMPLES = Path(__file__).parents[3] / "examples" / "trajopt"
ARM_FILES = {"urdf": str(EXAMPLES / "arm7.urdf"), "srdf": str(EXAMPLES / "arm7.srdf")}


@cache
def arm() -> RobotModel:
    """The example arm: seven joints on a pedestal."""
    return load_robot(urdf=EXAMPLES / "arm7.urdf", srdf=EXAMPLES / "arm7.srdf")


def document(
    manip: str = "right_arm",
    n_steps: int = 5,
    costs: Sequence[Mapping[str, Any]] = (),
    constraints: Sequence[Mapping[str, Any]] = (),
    init: Mapping[str, Any] | None = None,
    **basic: Any,
) -> dict[str, Any]:
    """A problem that stands still unless told otherwise."""
    return {
        "basic_info": {"n_steps": n_steps, "manip": manip, **basic},
        "costs": [dict(term) for term in costs],
        "constraints": [dict(term) for term in constraints],
        "init_info": dict(init or {"type": "stationary"}),
    }


def term(kind: str, **params: Any) -> dict[str, Any]:
    """A term of that type."""
    return {"type": kind, "params": params}


def resolved(robot: RobotModel, data: Mapping[str, Any], start: StartRequest | None = None) -> Resolved:
    """The document held to the robot; it must be readable."""
    reading = read_problem(data)
    assert reading.findings == ()
    assert reading.problem is not None
    given = start or StartRequest()
    return resolve(reading.problem, robot, make_start_configuration(robot, given)[0], given)


def program_of(robot: RobotModel, data: Mapping[str, Any], start: StartRequest | None = None) -> Program:
    """The program of a document without findings."""
    result = resolved(robot, data, start)
    assert result.findings == ()
    assert result.program is not None
    return result.program


def findings_of(robot: RobotModel, data: Mapping[str, Any], start: StartRequest | None = None) -> tuple[str, ...]:
    """What is wrong with a document for that robot."""
    return resolved(robot, data, start).findings


def straight_rows(first: Sequence[float], last: Sequence[float], count: int) -> list[list[float]]:
    """Rows of a ``given_traj`` on a straight line."""
    return np.linspace(first, last, count).tolist()
