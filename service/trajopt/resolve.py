"""Holds a problem to a robot: names, lengths, limits, what stands; every finding collected."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from costs.kinematics import KinematicsEngine, locate_frame, locate_links
from costs.robot import RobotModel
from service.errors import would_do
from service.request.schema import StartRequest
from service.trajopt.demanded import pose_matrix
from service.trajopt.manip import manip_columns
from service.trajopt.problem import (
    CartVelTerm,
    CollisionTerm,
    FootHeightTerm,
    JointStepTerm,
    JointTerm,
    PoseTerm,
    Problem,
    Vector,
    ZmpTerm,
)
from service.trajopt.program import JointRange, Program
from service.trajopt.standing import Standing, standing

SAME_START = 1e-4  # as in TrajOpt: the robot and the first row of the file agree up to this [rad, m]
WORLD_FRAMES = ("world", "universe", "map")


@dataclass(frozen=True)
class Resolved:
    """A program, or what is wrong, one line each."""

    program: Program | None
    findings: tuple[str, ...]


def resolve(problem: Problem, robot: RobotModel, start: Float[np.ndarray, "n"], given: StartRequest) -> Resolved:
    """Check a problem against a robot and make it a program.

    Args:
        problem: as read.
        robot: what is to move.
        start: (n,) where a request puts it.
        given: that request; joints it does not speak of start at the first row of a given trajectory.
    """
    problem = _in_the_world(problem, robot, start)
    columns, findings = manip_columns(robot, problem.basic.manip)
    problems = [*findings, *_unknown_links(problem, robot)]
    if not findings:
        problems += _wrong_lengths(problem, len(columns))
    if problems:
        return Resolved(None, tuple(problems))
    maker = _Maker(problem, robot, np.array(columns, dtype=int))
    begin, notes, start_problems = maker.start(start, given)
    stand = standing(problem, robot, begin, maker.free)
    ranges, range_problems = maker.ranges(begin)
    problems = [*start_problems, *stand.problems, *range_problems, *maker.beyond_limits(begin)]
    if problems:
        return Resolved(None, tuple(problems))
    return Resolved(maker.program(begin, ranges, stand, (*problem.notes, *notes)), ())


def _in_the_world(problem: Problem, robot: RobotModel, start: Float[np.ndarray, "n"]) -> Problem:
    """Poses relative to what no joint moves, or to a name for the world, as poses in the world."""
    terms = [
        _pose_in_the_world(term, robot, start) if isinstance(term, PoseTerm) and term.reference is not None else term
        for term in problem.terms
    ]
    return replace(problem, terms=tuple(terms))


def _pose_in_the_world(term: PoseTerm, robot: RobotModel, start: Float[np.ndarray, "n"]) -> PoseTerm:
    if term.reference is None or not robot.model.existFrame(term.reference):
        return replace(term, reference=None) if term.reference in WORLD_FRAMES else term
    if locate_frame(robot, term.reference)[0] != 0:
        return term
    reference = locate_links(KinematicsEngine(robot), start, [term.reference])[term.reference]
    pose = reference @ pose_matrix(term.xyz, term.wxyz)
    wxyz = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
    return replace(term, reference=None, xyz=tuple(pose[:3, 3].tolist()), wxyz=tuple(wxyz.tolist()))


def _unknown_links(problem: Problem, robot: RobotModel) -> Iterator[str]:
    known = [frame.name for frame in robot.model.frames if frame.name != "universe"]
    bodied = {body.link for body in robot.bodies}
    for path, link, has_shape in _named_links(problem):
        if link not in known:
            yield f"{path}: {robot.name} has no link {link!r}; expected {would_do(link, known)}"
        elif has_shape and link not in bodied:
            yield f"{path}: link {link!r} has no collision shape; expected {would_do(link, bodied) or 'none'}"


def _named_links(problem: Problem) -> Iterator[tuple[str, str, bool]]:
    """Where a link or frame is named, its name, and whether it must have a shape."""
    for term in problem.terms:
        params = f"{term.path}.params"
        match term:
            case PoseTerm():
                yield f"{params}.{term.frame_key}", term.frame, False
                if term.reference is not None:
                    yield f"{params}.{term.reference_key}", term.reference, False
            case CartVelTerm():
                yield f"{params}.link", term.link, False
            case FootHeightTerm():
                yield f"{params}.link", term.link, True
            case ZmpTerm():
                for k, link in enumerate(term.links):
                    yield f"{params}.planted_links[{k}]", link, True
            case CollisionTerm():
                for pair in term.pairs:
                    yield f"{pair.path}.link", pair.link, True


def _wrong_lengths(problem: Problem, n_dof: int) -> Iterator[str]:
    """Lists that do not have one entry per degree of freedom."""
    for key, index in ((problem.basic.fixed_dofs_key, k) for k in problem.basic.fixed_dofs if k >= n_dof):
        yield f"basic_info.{key}: {index} is no degree of freedom; expected 0 to {n_dof - 1}"
    lists: list[tuple[str, Vector, bool]] = []
    if problem.init.kind == "straight_line":
        lists.append(("init_info.endpoint", problem.init.endpoint, False))
    lists += [(f"init_info.data[{k}]", row, False) for k, row in enumerate(problem.init.data)]
    for term in problem.terms:
        params = f"{term.path}.params"
        if isinstance(term, JointTerm):
            lists += [
                (f"{params}.{term.targets_key}", term.targets, True),
                (f"{params}.coeffs", term.coeffs, True),
                (f"{params}.lower_tols", term.lower_tols, True),
                (f"{params}.upper_tols", term.upper_tols, True),
            ]
        elif isinstance(term, JointStepTerm):
            lists.append((f"{params}.vals", term.vals, True))
    for path, values, one_will_do in lists:
        if len(values) != n_dof and not (one_will_do and len(values) == 1):
            yield f"{path}: {n_dof} numbers are needed (one per degree of freedom of manip), got {len(values)}"


@dataclass(frozen=True)
class _Maker:
    """A problem whose names and lengths are right, on its way to a program.

    Attributes:
        problem: as read.
        robot: that moves.
        columns: (k,) its coordinates, in the file's order.
    """

    problem: Problem
    robot: RobotModel
    columns: Int[np.ndarray, "k"]

    @property
    def still(self) -> Int[np.ndarray, "s"]:
        """Those that the file fixes."""
        return self.columns[list(self.problem.basic.fixed_dofs)]

    @property
    def free(self) -> Int[np.ndarray, "f"]:
        """Those that move, ascending."""
        return np.setdiff1d(self.columns, self.still)

    def start(
        self, start: Float[np.ndarray, "n"], given: StartRequest
    ) -> tuple[Float[np.ndarray, "n"], tuple[str, ...], list[str]]:
        """Where the robot starts: as requested, and where the request is silent at the first row of the file."""
        rows = self.problem.init.data
        if not rows:
            return start, (), []
        begin, taken, problems = start.copy(), [], []
        for k, column in enumerate(self.columns.tolist()):
            value, name = rows[0][k], self.robot.joint_names[column]
            if not is_given(given, name):
                begin[column] = value
                taken.append(name)
            elif self.problem.basic.is_start_fixed and abs(value - float(start[column])) > SAME_START:
                problems.append(
                    f"init_info.data[0][{k}]: {value:g}, but {name} starts at {float(start[column]):g}; the two must "
                    "agree, or the start must say nothing of it"
                )
        notes = (f"{len(taken)} joints start at the first row of init_info.data",) if taken else ()
        return begin, notes, problems

    def beyond_limits(self, begin: Float[np.ndarray, "n"]) -> Iterator[str]:
        """Start and fixed waypoints that the joints' limits do not allow."""
        init = self._init(begin)
        is_given = self.problem.init.kind == "given_traj"
        for step in sorted({0, *self.problem.basic.fixed_steps}):
            for k, column in enumerate(self.columns.tolist()):
                value = float(init[step, column])
                lower, upper = float(self.robot.lower[column]), float(self.robot.upper[column])
                if not lower - SAME_START <= value <= upper + SAME_START:
                    path = f"init_info.data[{step}][{k}]" if is_given else f"init_info.endpoint[{k}]"
                    name = self.robot.joint_names[column]
                    yield f"{path}: {value:g} is outside the limits of {name}; expected {lower:g} to {upper:g}"

    def ranges(self, begin: Float[np.ndarray, "n"]) -> tuple[Mapping[int, Mapping[int, JointRange]], list[str]]:
        """What constraints on joint values leave of each coordinate, by step and coordinate."""
        ranges: dict[int, dict[int, JointRange]] = {}
        problems: list[str] = []
        for term in self.problem.terms:
            if not isinstance(term, JointTerm) or term.order or term.is_cost:
                continue
            for k, column in enumerate(self.columns.tolist()):
                if _entry(term.coeffs, k) == 0.0:
                    continue
                asked = self._range(term, k)
                problem = self._range_problem(asked, column)
                for step in range(term.first, term.last + 1):
                    problem = problem or self._conflict(asked, column, step, begin, ranges)
                    ranges.setdefault(step, {})[column] = asked
                if problem:
                    problems.append(f"{asked.path}: {problem}")
        return ranges, problems

    def program(
        self,
        begin: Float[np.ndarray, "n"],
        ranges: Mapping[int, Mapping[int, JointRange]],
        stand: Standing,
        notes: tuple[str, ...],
    ) -> Program:
        """The program of a problem without findings."""
        basic = self.problem.basic
        begin = np.clip(begin, self.robot.lower, self.robot.upper)
        init = self._init(begin)
        beyond = (init < self.robot.lower) | (init > self.robot.upper)
        if np.any(beyond):
            notes += (f"init_info: {int(beyond.sum())} values beyond the joints' limits are brought to them",)
        init = np.clip(init, self.robot.lower, self.robot.upper)
        if basic.robot not in ("", self.robot.name):
            notes += (f"basic_info.robot: {basic.robot!r} has no bearing; the robot is {self.robot.name}",)
        if not basic.is_start_fixed:
            notes += ("start_fixed is false: the motion begins at its own first waypoint, not where the robot starts",)
        still, free = self.still, self.free
        fixed = {step: init[step].copy() for step in basic.fixed_steps}
        if basic.is_start_fixed:
            fixed[0] = begin.copy()
        for step, values in ranges.items():
            if step not in fixed and all(c in values and values[c].lower == values[c].upper for c in free.tolist()):
                fixed[step] = begin.copy()
                fixed[step][free] = [values[c].target for c in free.tolist()]
        for q in (*fixed.values(), *init):
            q[still] = begin[still]
        return Program(
            problem=stand.problem,
            start=begin,
            columns=self.columns,
            free=free,
            init=init,
            fixed=fixed,
            ranges=ranges,
            planted=stand.planted,
            is_balanced=stand.is_balanced,
            notes=(*notes, *stand.notes),
        )

    def _init(self, begin: Float[np.ndarray, "n"]) -> Float[np.ndarray, "T n"]:
        """The trajectory to start from."""
        init = self.problem.init
        q = np.tile(begin, (self.problem.basic.n_steps, 1))
        if init.kind == "given_traj":
            q[:, self.columns] = init.data
        elif init.kind == "straight_line":
            share = np.linspace(0.0, 1.0, len(q))[:, None]
            q[:, self.columns] += share * (np.array(init.endpoint) - begin[self.columns])
        return q

    def _range(self, term: JointTerm, k: int) -> JointRange:
        target = _entry(term.targets, k)
        path = f"{term.path}.params.{term.targets_key}[{k if len(term.targets) > 1 else 0}]"
        return JointRange(path, target, target + _entry(term.lower_tols, k), target + _entry(term.upper_tols, k))

    def _range_problem(self, asked: JointRange, column: int) -> str:
        lower, upper = float(self.robot.lower[column]), float(self.robot.upper[column])
        if asked.lower > upper or asked.upper < lower:
            name = self.robot.joint_names[column]
            return f"{asked.target:g} is outside the limits of {name}; expected {lower:g} to {upper:g}"
        return ""

    def _conflict(
        self,
        asked: JointRange,
        column: int,
        step: int,
        begin: Float[np.ndarray, "n"],
        ranges: Mapping[int, Mapping[int, JointRange]],
    ) -> str:
        """In what a range cannot be had besides what else is asked."""
        basic, name = self.problem.basic, self.robot.joint_names[column]
        before = ranges.get(step, {}).get(column)
        if (
            before is not None
            and before.path != asked.path
            and (before.lower, before.upper)
            != (
                asked.lower,
                asked.upper,
            )
        ):
            return f"{name} at waypoint {step} is asked for something else by {before.path}; leave one out"
        is_still = column in self.still.tolist()
        if (step == 0 and basic.is_start_fixed) or is_still:
            value, why = float(begin[column]), "is fixed at its start"
        elif step in basic.fixed_steps:
            value, why = float(self._init(begin)[step, column]), f"is fixed at waypoint {step}"
        else:
            return ""
        if asked.lower - SAME_START <= value <= asked.upper + SAME_START:
            return ""
        return f"{asked.target:g} cannot be had: {name} {why}, {value:g}"


def _entry(values: Vector, k: int) -> float:
    """The k-th number of a list in which one may stand for all."""
    return values[0] if len(values) == 1 else values[k]


def is_given(given: StartRequest, name: str) -> bool:
    """Whether a request says where a coordinate starts."""
    if name.startswith("base_"):
        return given.base is not None or given.posture is not None
    return given.posture is not None or name in given.positions_by_joint
