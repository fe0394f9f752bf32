"""TrajOpt problems as part of a request: loaded from files, and resolved for the request's robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from costs.robot import BASE_NAMES, RobotModel, bundled_robots
from service.errors import RequestError, would_do
from service.request.file import load_section, parse_request
from service.request.scene import SceneRequest
from service.request.schema import PlanRequest, StartRequest
from service.start.configuration import make_start_configuration
from service.trajopt.json_fields import read_document
from service.trajopt.problem import ProblemFile
from service.trajopt.program import Program
from service.trajopt.reader import read_problem, read_robot_name
from service.trajopt.resolve import is_start_given, resolve
from service.trajopt.robot_checks import parse_manip


@dataclass(frozen=True)
class TrajoptFiles:
    """Files and settings that a problem file lacks.

    Attributes:
        robot: a bundled robot's name, or the path of a URDF; by default the problem's ``basic_info.robot``.
        srdf: SRDF of the URDF; ``manip`` may name its groups.
        package_root: folder of package:// paths.
        is_floating: whether the base is free; by default true for bundled robots only.
        scene: file with the content of a request's ``scene``.
        start: file with the content of a request's ``start``.
        time_limit_s: wall time for the whole plan, by default that of a request.
        is_timed: whether the motion gets a time law; otherwise the path alone is planned and certified.
        checks_torque: whether joint torques are checked.
    """

    robot: str | None = None
    srdf: Path | None = None
    package_root: Path | None = None
    is_floating: bool | None = None
    scene: Path | None = None
    start: Path | None = None
    time_limit_s: float | None = None
    is_timed: bool = True
    checks_torque: bool = True


def load_trajopt_request(problem: Path, files: TrajoptFiles) -> PlanRequest:
    """Return the request for a problem file; paths in the scene file are relative to its folder.

    Raises:
        RequestError: a file is invalid; errors that need the robot are raised by ``make_program``.
    """
    document = read_document(problem)
    request = parse_request(
        {
            "robot": _make_robot_section(files, read_robot_name(document), problem.parent),
            "task": {"trajopt": document},
            # TrajOpt's balance constraint has no margin.
            "options": {"time_limit_s": files.time_limit_s, "balance_margin_m": 0.0, "timed": files.is_timed},
        },
        problem.parent if files.scene is None else files.scene.parent,
    )
    if files.scene is not None:
        request = replace(request, scene=load_section(SceneRequest, files.scene))
    if files.start is not None:
        request = replace(request, start=load_section(StartRequest, files.start))
    return request


def _make_robot_section(files: TrajoptFiles, problem_robot: str, folder: Path) -> Mapping[str, Any]:
    """Return the request's ``robot`` section; the command line overrides the problem."""
    robot, source = (problem_robot, "basic_info.robot") if files.robot is None else (files.robot, "--robot")
    if not robot:
        raise RequestError(f"--robot is missing: expected a bundled robot ({', '.join(bundled_robots())}) or a URDF")
    root: dict[str, Any] = {} if files.is_floating is None else {"root": "floating" if files.is_floating else "fixed"}
    if not files.checks_torque:
        root["torque"] = {"check": False}
    if robot in bundled_robots():
        if files.srdf is not None or files.package_root is not None:
            raise RequestError(f"--srdf and --package-root go with a URDF; {robot} brings its own")
        return {"name": robot, **root}
    path = folder / robot if files.robot is None else Path(robot)
    if not path.is_file():
        raise RequestError(
            f"{source}: {robot!r} is neither a bundled robot nor a file; expected {would_do(robot, bundled_robots())}"
        )
    section: dict[str, Any] = {"urdf": str(path.resolve()), **root}
    if files.srdf is not None:
        section["srdf"] = str(files.srdf.resolve())
    if files.package_root is not None:
        section["package_dirs"] = [str(files.package_root.resolve())]
    return section


def make_program(
    request: PlanRequest, document: Mapping[str, Any], robot: RobotModel
) -> tuple[Program, tuple[str, ...]]:
    """Return the program of ``task.trajopt`` for the request's robot, and notes on its start.

    Joints that the request's start does not name start at the first row of the problem's trajectory.

    Raises:
        RequestError: one line per error of the start, or of the problem.
    """
    reading = read_problem(document)
    start, notes = make_start_configuration(robot, _complete_start(request.start, reading.problem, robot))
    findings = list(reading.findings)
    if request.options.waypoints is not None:
        findings.append("options.waypoints: basic_info.n_steps says how many; leave it out")
    if request.options.feet is not None:
        findings.append("options.feet: pose constraints and zmp of the problem say what is planted; leave it out")
    program = None
    if reading.problem is not None:  # also with findings, so that errors of names and lengths are reported with them
        resolved = resolve(reading.problem, robot, start, request.start)
        program, findings = resolved.program, [*findings, *resolved.findings]
    if findings or program is None:
        raise RequestError(findings)
    return program, notes


def _complete_start(start: StartRequest, problem: ProblemFile | None, robot: RobotModel) -> StartRequest:
    """Add joint values of the trajectory's first row that are within the joint's limits."""
    row = () if problem is None or not problem.init.data else problem.init.data[0]
    columns = parse_manip(robot, problem.basic.manip)[0] if problem is not None and row else ()
    if len(row) != len(columns):
        return start
    joints = {
        robot.joint_names[column]: value
        for column, value in zip(columns, row, strict=True)
        if robot.joint_names[column] not in BASE_NAMES
        and robot.lower[column] <= value <= robot.upper[column]
        and not is_start_given(start, robot.joint_names[column])
    }
    return replace(start, joints={**start.joints, **joints})
