"""Costs and constraints of a program for the optimiser, on waypoints that may be denser than its steps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from costs.allowance import BodyRef
from costs.collision import SweptCollisionChecker
from costs.robot import RobotModel
from costs.state import MotionState
from costs.support import SupportPolygon
from costs.terms import (
    AxisDirection,
    Between,
    CentreOfMassInPolygon,
    ClearancePerPair,
    FrameDisplacement,
    FramePose,
    JointDifference,
    JointTarget,
    PairClearance,
    PointHalfSpace,
    RequiredClearance,
    Scaled,
    WithinTolerance,
)
from scopt import Constraint, Cost, Penalty, Residual, Sense
from service.body.whole_body import CLEARANCE_TOLERANCE, WholeBody
from service.start.standing import sole_corners
from service.trajopt.problem import (
    CartVelTerm,
    CollisionTerm,
    FootHeightTerm,
    JointStepTerm,
    JointTerm,
    PoseTerm,
    Vector,
    ZmpTerm,
)
from service.trajopt.program import Program, Timeline

DISTANCE_TOLERANCE = 1e-3  # allowed shortfall of a clearance constraint [m]


@dataclass(frozen=True)
class Builder:
    """Builder of the costs, constraints and bounds of one program on one timeline.

    Attributes:
        timeline: waypoints of its steps.
        body: the robot on its planted links in its scene.
        checker: finds contacts up to at least the largest ``dist_pen`` of the program.
    """

    program: Program
    timeline: Timeline
    body: WholeBody
    checker: SweptCollisionChecker

    @property
    def robot(self) -> RobotModel:
        """The robot."""
        return self.body.robot

    def make_costs(self) -> tuple[Cost[MotionState], ...]:
        """Make all costs with a weight above zero."""
        return tuple(cost for term in self.program.problem.terms if term.is_cost for cost in self._make_costs_of(term))

    def make_constraints(self) -> tuple[Constraint[MotionState], ...]:
        """Make all constraints that are neither bounds nor kept by the planted links."""
        terms = self.program.problem.terms
        return tuple(made for term in terms if not term.is_cost for made in self._make_constraints_of(term))

    def narrow_bounds(self, lower: Float[np.ndarray, "T n"], upper: Float[np.ndarray, "T n"]) -> None:
        """Narrow the bounds in place: coordinates that do not move, fixed waypoints, joint constraints."""
        program, rows = self.program, self.timeline.rows
        still = np.setdiff1d(np.arange(self.robot.n), program.free)
        lower[:, still] = upper[:, still] = program.start[still]
        for step, q in program.fixed.items():
            lower[rows[step]] = upper[rows[step]] = q
        for step, ranges in program.ranges.items():
            if step in program.fixed:
                continue
            row = int(rows[step])
            for column in set(ranges) & set(program.free.tolist()):
                wanted = ranges[column]
                low, high = max(wanted.lower, self.robot.lower[column]), min(wanted.upper, self.robot.upper[column])
                # The reserve from the joint limits is given up where the wanted range leaves no room for it.
                within = max(low, float(lower[row, column])), min(high, float(upper[row, column]))
                lower[row, column], upper[row, column] = within if within[0] <= within[1] else (low, high)

    def _make_costs_of(self, term: object) -> Iterator[Cost[MotionState]]:
        match term:
            case PoseTerm():
                gains = np.array([*term.pos_coeffs, *(term.turn_gain * c for c in term.rot_coeffs)])
                axes = gains > 0.0
                if np.any(axes):
                    pose = _make_frame_pose(self.robot, term, self._row(term), axes.tolist())
                    yield Cost(term.title, Scaled(pose, gains[axes]), penalty=Penalty.ABS)
            case JointTerm():
                columns, gains = self._select_weighted(term)
                if not len(columns):
                    return
                residual = self._make_joint_residual(term, columns)
                if not term.has_tolerance:
                    yield Cost(term.title, Scaled(residual, np.sqrt(gains), self._per_column(term.targets, columns)))
                    return
                between = self._make_between(term, residual, columns)
                yield Cost(term.title, Scaled(between, gains), penalty=Penalty.HINGE)
            case CartVelTerm():
                yield Cost(term.title, self._limit_displacement(term), penalty=Penalty.ABS)
            case CollisionTerm():
                yield Cost(term.title, self._make_clearance(term), penalty=Penalty.HINGE)

    def _make_constraints_of(self, term: object) -> Iterator[Constraint[MotionState]]:
        tolerance = self.program.problem.opt.tolerance
        match term:
            case PoseTerm():
                # Position and orientation are separate constraints, since their units differ.
                for kind, residual in make_pose_residuals(self.robot, term, self._row(term)).items():
                    gain, unit = (max(term.pos_coeffs), "m") if kind == "position" else (max(term.rot_coeffs), "rad")
                    title = f"{term.title}: {kind} of {term.frame}"
                    yield Constraint(title, residual, Sense.EQUAL_ZERO, tolerance, gain, unit)
            case JointTerm() if term.order:
                columns, gains = self._select_weighted(term)
                if not len(columns):
                    return
                residual = self._make_joint_residual(term, columns)
                scale = float(gains.max())
                if term.has_tolerance:
                    between = self._make_between(term, residual, columns)
                    yield Constraint(term.title, between, tolerance=tolerance, scale=scale, unit="rad")
                else:
                    off = Scaled(residual, 1.0, self._per_column(term.targets, columns))
                    yield Constraint(term.title, off, Sense.EQUAL_ZERO, tolerance, scale, "rad")
            case JointStepTerm():
                columns = np.sort(self.program.columns)
                steps = self._make_differences(columns, term.first, term.last, 1, 1.0)
                limits = WithinTolerance(steps, self._per_column(term.vals, columns))
                yield Constraint(term.title, limits, tolerance=tolerance, unit="rad")
            case CartVelTerm():
                yield Constraint(term.title, self._limit_displacement(term), tolerance=tolerance, unit="m")
            case CollisionTerm():
                scale = max(term.coeffs)
                if scale > 0.0:
                    yield Constraint(
                        term.title, self._make_clearance(term), tolerance=DISTANCE_TOLERANCE, scale=scale, unit="m"
                    )
            case ZmpTerm():
                soles = [sole_corners(self.robot, self.program.start, link) for link in term.links]
                inside = CentreOfMassInPolygon(SupportPolygon.of_soles(soles), self._row(term))
                yield Constraint(term.title, inside, tolerance=tolerance, unit="m")
            case FootHeightTerm():
                yield from self._make_foot_height(term, tolerance)

    def _row(self, term: PoseTerm | ZmpTerm | FootHeightTerm) -> list[int]:
        """Return the waypoint of a term at a single step."""
        return [int(self.timeline.rows[term.step])]

    def _make_foot_height(self, term: FootHeightTerm, tolerance: float) -> Iterator[Constraint[MotionState]]:
        start = self.program.start
        pose = self.body.engine(start[None])
        body = next(body for body in self.robot.bodies if body.link == term.link)
        rotation, position = pose.rotation[0, body.joint], pose.position[0, body.joint]
        for k, corner in enumerate((sole_corners(self.robot, start, term.link) - position) @ rotation):
            above = PointHalfSpace(
                self.robot,
                term.link,
                self._row(term),
                np.array([0.0, 0.0, -1.0]),
                -term.height,
                _convert_to_frame(self.robot, term.link, corner),
            )
            yield Constraint(f"{term.title}: corner {k} of {term.link}", above, tolerance=tolerance, unit="m")

    def _limit_displacement(self, term: CartVelTerm) -> Residual[MotionState]:
        intervals = self.timeline.list_waypoints(term.first, term.last)[:-1]
        return WithinTolerance(FrameDisplacement(self.robot, term.link, intervals), term.limit)

    def _select_weighted(self, term: JointTerm) -> tuple[Int[np.ndarray, "c"], Float[np.ndarray, "c"]]:
        """Return the coordinates with a coefficient above zero, ascending, and their coefficients."""
        columns = np.sort(self.program.columns)
        gains = self._per_column(term.coeffs, columns)
        return columns[gains > 0.0], gains[gains > 0.0]

    def _make_joint_residual(self, term: JointTerm, columns: Int[np.ndarray, "c"]) -> Residual[MotionState]:
        if term.order:
            return self._make_differences(columns, term.first, term.last, term.order, term.rate)
        rows = self.timeline.rows[term.first : term.last + 1]
        return JointTarget(self.timeline.n_waypoints, self.robot.n, rows, columns, np.zeros(len(columns)))

    def _make_differences(
        self, columns: Int[np.ndarray, "c"], first: int, last: int, order: int, rate: float
    ) -> JointDifference:
        weights = np.zeros(self.robot.n)
        weights[columns] = 1.0
        rows = self.timeline.list_waypoints(first, last)
        return JointDifference(self.timeline.n_waypoints, weights, order, 1.0 / rate, rows[: len(rows) - order])

    def _make_between(
        self, term: JointTerm, residual: Residual[MotionState], columns: Int[np.ndarray, "c"]
    ) -> Between[MotionState]:
        targets = self._per_column(term.targets, columns)
        lower = targets + self._per_column(term.lower_tols, columns)
        return Between(residual, lower, targets + self._per_column(term.upper_tols, columns))

    def _per_column(self, values: Vector, columns: Int[np.ndarray, "c"]) -> Float[np.ndarray, "c"]:
        """Return the entries of a list of the file for the given coordinates."""
        full = np.broadcast_to(np.array(values), len(self.program.columns))
        index = {column: k for k, column in enumerate(self.program.columns.tolist())}
        return full[[index[column] for column in columns.tolist()]]

    def _make_clearance(self, term: CollisionTerm) -> PairClearance:
        """Make the residual of a collision term.

        A cost is weighted by ``coeffs``; a constraint requires no more than the fixed waypoints have.
        """
        everywhere = self._spread_over_time(term, term.dist_pen, term.coeffs)
        pairs = [
            (
                BodyRef.of_link(pair.link),
                self._find_body(other),
                self._spread_over_time(term, pair.dist_pen, pair.coeffs),
            )
            for pair in term.pairs
            for other in pair.others
        ]
        required = ClearancePerPair.of(self.checker, everywhere, pairs, self.body.standing_allowances())
        if not term.is_cost:
            for q in self.program.fixed.values():
                required = required.relax_to(self.checker(self.body.engine(q[None])), CLEARANCE_TOLERANCE)
        return PairClearance(self.robot, required, None if term.is_swept else self.checker)

    def _find_body(self, name: str) -> BodyRef:
        """Return the link, the body of a link, or else the piece of the scene that has a name."""
        bodies = self.robot.bodies
        if any(body.link == name for body in bodies):
            return BodyRef.of_link(name)
        own = (BodyRef.of_body(body, self.robot.mechanism_links) for body in bodies if body.name == name)
        return next(own, BodyRef.of_piece(name))

    def _spread_over_time(self, term: CollisionTerm, dist_pen: Vector, coeffs: Vector) -> RequiredClearance:
        """Return distance and gain per interval between waypoints (if swept) or per waypoint; 0 outside the term."""
        timeline = self.timeline
        count = max(timeline.n_waypoints - 1, 1) if term.is_swept else timeline.n_waypoints
        where = timeline.list_waypoints(term.first, term.last)
        where = where[:-1] if term.is_swept else where
        index = np.minimum(timeline.find_steps(where) - term.first, term.last - term.first)
        distance, gain = np.zeros(count), np.zeros(count)
        distance[where] = dist_pen[0] if len(dist_pen) == 1 else np.array(dist_pen)[index]
        weights = np.array(coeffs)[np.zeros_like(index) if len(coeffs) == 1 else index]
        gain[where] = weights if term.is_cost else weights > 0.0
        return RequiredClearance(distance, gain)


def make_pose_residuals(
    robot: RobotModel, term: PoseTerm, waypoints: Sequence[int] | Int[np.ndarray, "S"]
) -> dict[str, Residual[MotionState]]:
    """Make the residuals of a pose term's constrained axes: ``position``, ``orientation``, or both.

    Two constrained rotations become the direction of the third axis: masking the rotation vector is accurate for
    small angles only.
    """
    residuals: dict[str, Residual[MotionState]] = {}
    axes = term.rotation_axes
    if any(term.position_axes):
        residuals["position"] = _make_frame_pose(robot, term, waypoints, (*term.position_axes, False, False, False))
    if sum(axes) == 2:
        axis, direction = (pose[:3, axes.index(False)] for pose in (term.offset, term.target))
        residuals["orientation"] = AxisDirection(robot, term.frame, waypoints, axis, direction, term.reference)
    elif any(axes):
        residuals["orientation"] = _make_frame_pose(robot, term, waypoints, (False, False, False, *axes))
    return residuals


def _make_frame_pose(
    robot: RobotModel, term: PoseTerm, waypoints: Sequence[int] | Int[np.ndarray, "S"], axes: Sequence[bool]
) -> FramePose:
    return FramePose(robot, term.frame, waypoints, term.target, tuple(axes), term.reference, term.offset)


def _convert_to_frame(robot: RobotModel, link: str, point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Convert a point from the frame of the joint that carries a link to the frame of the link [m]."""
    placement = robot.model.frames[robot.model.getFrameId(link)].placement
    return np.asarray(placement.inverse().act(point))
