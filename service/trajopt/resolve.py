"""A problem resolved for its robot: moving coordinates, initial trajectory, joint ranges and planted links."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from costs.kinematics import KinematicsEngine, locate_frame, locate_links
from costs.robot import RobotModel
from service.request.schema import StartRequest
from service.trajopt.planted_links import PlantedLinks, find_planted_links
from service.trajopt.problem import JointTerm, PoseTerm, ProblemFile, Vector
from service.trajopt.program import JointRange, Program
from service.trajopt.robot_checks import find_unknown_links, find_wrong_lengths, parse_manip

SAME_START = 1e-4  # largest difference of the request's start and the file's first row, as in TrajOpt [rad, m]
WORLD_FRAMES = ("world", "universe", "map")


@dataclass(frozen=True)
class Resolved:
    """A program, or one line per error."""

    program: Program | None
    findings: tuple[str, ...]


def resolve(problem: ProblemFile, robot: RobotModel, start: Float[np.ndarray, "n"], request: StartRequest) -> Resolved:
    """Check a problem against a robot and make it a program.

    Args:
        start: (n,) configuration at the requested start.
        request: that start; joints it does not name start at the first row of a given trajectory.
    """
    problem = _express_in_world(problem, robot, start)
    columns, findings = parse_manip(robot, problem.basic.manip)
    problems = [*findings, *find_unknown_links(problem, robot)]
    if not findings:
        problems += find_wrong_lengths(problem, len(columns))
    if problems:
        return Resolved(None, tuple(problems))
    resolver = _Resolver(problem, robot, np.array(columns, dtype=int))
    start, notes, start_problems = resolver.merge_starts(start, request)
    standing = find_planted_links(problem, robot, start, resolver.free)
    ranges, range_problems = resolver.collect_ranges(start)
    problems = [*start_problems, *standing.problems, *range_problems, *resolver.find_beyond_limits(start)]
    if problems:
        return Resolved(None, tuple(problems))
    return Resolved(resolver.make_program(start, ranges, standing, (*problem.notes, *notes)), ())


def is_start_given(request: StartRequest, name: str) -> bool:
    """Return whether a request gives the start of a coordinate."""
    if name.startswith("base_"):
        return request.base is not None or request.posture is not None
    return request.posture is not None or name in request.positions_by_joint


def _express_in_world(problem: ProblemFile, robot: RobotModel, start: Float[np.ndarray, "n"]) -> ProblemFile:
    """Convert poses relative to the world, or to a frame that no joint moves, to poses in the world."""
    terms = [
        _express_pose_in_world(term, robot, start) if isinstance(term, PoseTerm) else term for term in problem.terms
    ]
    return replace(problem, terms=tuple(terms))


def _express_pose_in_world(term: PoseTerm, robot: RobotModel, start: Float[np.ndarray, "n"]) -> PoseTerm:
    if term.reference is None or not robot.model.existFrame(term.reference):
        return replace(term, reference=None) if term.reference in WORLD_FRAMES else term
    if locate_frame(robot, term.reference)[0] != 0:
        return term
    pose = locate_links(KinematicsEngine(robot), start, [term.reference])[term.reference] @ term.target
    wxyz = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
    return replace(term, reference=None, xyz=tuple(pose[:3, 3].tolist()), wxyz=tuple(wxyz.tolist()))


@dataclass(frozen=True)
class _Resolver:
    """Steps that turn a problem with valid names and lengths into a program.

    Attributes:
        columns: (k,) coordinates of ``manip``, in the file's order.
    """

    problem: ProblemFile
    robot: RobotModel
    columns: Int[np.ndarray, "k"]

    @property
    def still(self) -> Int[np.ndarray, "s"]:
        """Coordinates of ``manip`` that the file fixes."""
        return self.columns[list(self.problem.basic.fixed_dofs)]

    @property
    def free(self) -> Int[np.ndarray, "f"]:
        """Coordinates that may move, ascending."""
        return np.setdiff1d(self.columns, self.still)

    def merge_starts(
        self, start: Float[np.ndarray, "n"], request: StartRequest
    ) -> tuple[Float[np.ndarray, "n"], tuple[str, ...], list[str]]:
        """Return the start as requested, completed by the first row of the file; notes; and errors."""
        rows = self.problem.init.data
        if not rows:
            return start, (), []
        merged, n_taken, problems = start.copy(), 0, []
        for k, column in enumerate(self.columns.tolist()):
            value, name = rows[0][k], self.robot.joint_names[column]
            if not is_start_given(request, name):
                merged[column] = value
                n_taken += 1
            elif self.problem.basic.is_start_fixed and abs(value - float(start[column])) > SAME_START:
                problems.append(
                    f"init_info.data[0][{k}]: {value:g}, but {name} starts at {float(start[column]):g}; the two must "
                    f"agree, or the start must leave {name} out"
                )
        notes = (f"{n_taken} joints start at the first row of init_info.data",) if n_taken else ()
        return merged, notes, problems

    def find_beyond_limits(self, start: Float[np.ndarray, "n"]) -> Iterator[str]:
        """Yield a line for each joint value of the start or a fixed waypoint that is outside its limits."""
        init = self._make_init(start)
        for step in sorted({0, *self.problem.basic.fixed_steps}):
            for k, column in enumerate(self.columns.tolist()):
                value = float(init[step, column])
                lower, upper = self._limits(column)
                if not lower - SAME_START <= value <= upper + SAME_START:
                    is_row = self.problem.init.kind == "given_traj"
                    path = f"init_info.data[{step}][{k}]" if is_row else f"init_info.endpoint[{k}]"
                    yield f"{path}: {self._describe_excess(value, column)}"

    def collect_ranges(self, start: Float[np.ndarray, "n"]) -> tuple[Mapping[int, Mapping[int, JointRange]], list[str]]:
        """Return the ranges of constraints on joint values by step and coordinate, and errors."""
        ranges: dict[int, dict[int, JointRange]] = {}
        problems: list[str] = []
        for term in self.problem.terms:
            if not isinstance(term, JointTerm) or term.order or term.is_cost:
                continue
            for k, column in enumerate(self.columns.tolist()):
                if _entry(term.coeffs, k) == 0.0:
                    continue
                wanted = _make_range(term, k)
                lower, upper = self._limits(column)
                is_beyond = wanted.lower > upper or wanted.upper < lower
                problem = self._describe_excess(wanted.target, column) if is_beyond else ""
                for step in range(term.first, term.last + 1):
                    problem = problem or self._find_conflict(wanted, column, step, start, ranges)
                    ranges.setdefault(step, {})[column] = wanted
                if problem:
                    problems.append(f"{wanted.path}: {problem}")
        return ranges, problems

    def make_program(
        self,
        start: Float[np.ndarray, "n"],
        ranges: Mapping[int, Mapping[int, JointRange]],
        standing: PlantedLinks,
        notes: tuple[str, ...],
    ) -> Program:
        """Make the program of a problem without errors."""
        basic = self.problem.basic
        start = np.clip(start, self.robot.lower, self.robot.upper)
        init = self._make_init(start)
        beyond = (init < self.robot.lower) | (init > self.robot.upper)
        if np.any(beyond):
            notes += (f"init_info: {int(beyond.sum())} values beyond the joints' limits are brought to them",)
        init = np.clip(init, self.robot.lower, self.robot.upper)
        if basic.robot not in ("", self.robot.name):
            notes += (f"basic_info.robot: {basic.robot!r} has no effect; the robot is {self.robot.name}",)
        if not basic.is_start_fixed:
            notes += ("start_fixed is false: the motion begins at its own first waypoint, not where the robot starts",)
        still, free = self.still, self.free
        fixed = {step: init[step].copy() for step in basic.fixed_steps}
        if basic.is_start_fixed:
            fixed[0] = start.copy()
        for step, values in ranges.items():
            if step not in fixed and all(c in values and values[c].lower == values[c].upper for c in free.tolist()):
                fixed[step] = start.copy()
                fixed[step][free] = [values[c].target for c in free.tolist()]
        for q in (*fixed.values(), *init):
            q[still] = start[still]
        return Program(
            problem=standing.problem,
            start=start,
            columns=self.columns,
            free=free,
            init=init,
            fixed=fixed,
            ranges=ranges,
            planted=standing.planted,
            is_balanced=standing.is_balanced,
            notes=(*notes, *standing.notes),
        )

    def _limits(self, column: int) -> tuple[float, float]:
        return float(self.robot.lower[column]), float(self.robot.upper[column])

    def _describe_excess(self, value: float, column: int) -> str:
        lower, upper = self._limits(column)
        return f"{value:g} is outside the limits of {self.robot.joint_names[column]}; expected {lower:g} to {upper:g}"

    def _make_init(self, start: Float[np.ndarray, "n"]) -> Float[np.ndarray, "T n"]:
        """Make the initial trajectory."""
        init = self.problem.init
        q = np.tile(start, (self.problem.basic.n_steps, 1))
        if init.kind == "given_traj":
            q[:, self.columns] = init.data
        elif init.kind == "straight_line":
            share = np.linspace(0.0, 1.0, len(q))[:, None]
            q[:, self.columns] += share * (np.array(init.endpoint) - start[self.columns])
        return q

    def _find_conflict(
        self,
        wanted: JointRange,
        column: int,
        step: int,
        start: Float[np.ndarray, "n"],
        ranges: Mapping[int, Mapping[int, JointRange]],
    ) -> str:
        """Describe the constraint or fixed value that contradicts a range; "" if there is none."""
        basic, name = self.problem.basic, self.robot.joint_names[column]
        other = ranges.get(step, {}).get(column)
        if (
            other is not None
            and other.path != wanted.path
            and (other.lower, other.upper) != (wanted.lower, wanted.upper)
        ):
            return f"{name} at waypoint {step} has a different range in {other.path}; leave one out"
        if (step == 0 and basic.is_start_fixed) or column in self.still.tolist():
            value, reason = float(start[column]), "is fixed at its start"
        elif step in basic.fixed_steps:
            value, reason = float(self._make_init(start)[step, column]), f"is fixed at waypoint {step}"
        else:
            return ""
        if wanted.lower - SAME_START <= value <= wanted.upper + SAME_START:
            return ""
        return f"{wanted.target:g} is impossible: {name} {reason}, {value:g}"


def _make_range(term: JointTerm, k: int) -> JointRange:
    """Return the range of a term for the k-th degree of freedom."""
    target = _entry(term.targets, k)
    path = f"{term.path}.params.{term.targets_key}[{k if len(term.targets) > 1 else 0}]"
    return JointRange(path, target, target + _entry(term.lower_tols, k), target + _entry(term.upper_tols, k))


def _entry(values: Vector, k: int) -> float:
    """Return the k-th number; a single number stands for all."""
    return values[0] if len(values) == 1 else values[k]
