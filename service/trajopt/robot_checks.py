"""Checks of a problem against its robot: ``manip``, names of links and joints, lengths of lists."""

from __future__ import annotations

import re
from collections.abc import Iterator

from costs.robot import BASE_NAMES, PLANAR_NAMES, RobotModel
from service.errors import would_do
from service.trajopt.problem import (
    CartVelTerm,
    CollisionTerm,
    FootHeightTerm,
    JointStepTerm,
    JointTerm,
    PoseTerm,
    ProblemFile,
    Vector,
    ZmpTerm,
)

ACTIVE, BASE = "active", "base"
PATH = "basic_info.manip"
MAX_PARTS = 100  # each unknown part is compared with all known names


def parse_manip(robot: RobotModel, manip: str) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Return the coordinates named by ``manip``, in its order, and one line per error.

    Parts are joined by ``+``: a group of the SRDF (``leftarm`` also finds ``left_arm``), a joint, ``base`` (x, y and
    yaw of a free or planar base), or ``active`` (every joint, then the six coordinates of a free base).
    """
    names: list[str] = []
    problems: list[str] = []
    parts = [part.strip() for part in manip.split("+")]
    if len(parts) > MAX_PARTS:
        return (), (f"{PATH}: expected at most {MAX_PARTS} groups and joints, got {len(parts)}",)
    for part in parts:
        joints = _find_joints(robot, part)
        if joints is None:
            known = [*(group for group, members in robot.groups.items() if members), *robot.joint_names, ACTIVE]
            problems.append(
                f"{PATH}: {robot.name} has no group or joint {part!r}; expected {would_do(part, known)}",
            )
        elif not joints:
            problems.append(f"{PATH}: the base of {robot.name} is fixed; leave 'base' out")
        else:
            names += joints
    repeated = sorted({name for name in names if names.count(name) > 1})
    problems += [f"{PATH}: {name} is named twice" for name in repeated]
    return tuple(robot.joint_names.index(name) for name in names), tuple(problems)


def _find_joints(robot: RobotModel, part: str) -> tuple[str, ...] | None:
    """Return the joint names of one part; empty for the base of a robot with a fixed base, None if unknown."""
    if part in robot.joint_names:
        return (part,)
    if part == BASE and BASE not in robot.groups:
        return PLANAR_NAMES if robot.is_floating or robot.is_planar else ()
    if robot.groups.get(part):
        return tuple(robot.groups[part])
    if part == ACTIVE:
        n_base = len(BASE_NAMES) if robot.is_floating else 0
        return (*robot.joint_names[n_base:], *robot.joint_names[:n_base])
    alike = (joints for group, joints in robot.groups.items() if joints and _simplify(group) == _simplify(part))
    return next((tuple(joints) for joints in alike), None)


def _simplify(name: str) -> str:
    """Drop case and separators: ``left_arm`` equals ``leftarm``."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def find_unknown_links(problem: ProblemFile, robot: RobotModel) -> Iterator[str]:
    """Yield a line for each named link that the robot lacks, or that lacks a shape to stand on."""
    known = [frame.name for frame in robot.model.frames if frame.name != "universe"]
    with_shape = {body.link for body in robot.bodies}
    for path, link, needs_shape in _list_named_links(problem):
        if link not in known:
            yield f"{path}: {robot.name} has no link {link!r}; expected {would_do(link, known)}"
        elif needs_shape and link not in with_shape:
            yield f"{path}: link {link!r} has no collision shape; expected {would_do(link, with_shape) or 'none'}"


def _list_named_links(problem: ProblemFile) -> Iterator[tuple[str, str, bool]]:
    """Yield path and name of each link or frame, and whether it needs a shape."""
    for term in problem.terms:
        params = f"{term.path}.params"
        match term:
            case PoseTerm():
                yield f"{params}.{term.frame_key}", term.frame, False
                if term.reference is not None:
                    yield f"{params}.{term.reference_key}", term.reference, False
            case CartVelTerm() | FootHeightTerm():
                yield f"{params}.link", term.link, isinstance(term, FootHeightTerm)
            case ZmpTerm():
                for k, link in enumerate(term.links):
                    yield f"{params}.planted_links[{k}]", link, True
            case CollisionTerm():
                for pair in term.pairs:
                    yield f"{pair.path}.link", pair.link, True


def find_wrong_lengths(problem: ProblemFile, n_dof: int) -> Iterator[str]:
    """Yield a line for each list that does not have one entry per degree of freedom."""
    for index in problem.basic.fixed_dofs:
        if index >= n_dof:
            key = problem.basic.fixed_dofs_key
            yield f"basic_info.{key}: {index} is no degree of freedom; expected 0 to {n_dof - 1}"
    rows: list[tuple[str, Vector]] = []
    if problem.init.kind == "straight_line":
        rows.append(("init_info.endpoint", problem.init.endpoint))
    rows += [(f"init_info.data[{k}]", row) for k, row in enumerate(problem.init.data)]
    params: list[tuple[str, Vector]] = []
    for term in problem.terms:
        prefix = f"{term.path}.params"
        if isinstance(term, JointTerm):
            params += [
                (f"{prefix}.{term.targets_key}", term.targets),
                (f"{prefix}.coeffs", term.coeffs),
                (f"{prefix}.lower_tols", term.lower_tols),
                (f"{prefix}.upper_tols", term.upper_tols),
            ]
        elif isinstance(term, JointStepTerm):
            params.append((f"{prefix}.vals", term.vals))
    # In parameters of terms a single number stands for all degrees of freedom.
    for path, values in [*rows, *((path, values) for path, values in params if len(values) != 1)]:
        if len(values) != n_dof:
            yield f"{path}: {n_dof} numbers are needed (one per degree of freedom of manip), got {len(values)}"
