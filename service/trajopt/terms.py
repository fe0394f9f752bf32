"""The terms of a program as costs and constraints, over waypoints that may be denser than its steps."""

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
    Asked,
    AskedOfPairs,
    AxisDirection,
    Between,
    CentreOfMassInPolygon,
    FrameDisplacement,
    FramePose,
    JointDifference,
    JointTarget,
    PairClearance,
    PointHalfSpace,
    Scaled,
    WithinTolerance,
)
from scopt import Constraint, Cost, Penalty, Residual, Sense
from service.body.whole_body import CLEARANCE_TOLERANCE, WholeBody
from service.start.standing import sole_corners
from service.trajopt.demanded import pose_matrix
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

DISTANCE_TOLERANCE = 1e-3  # by which a clearance that is a constraint may fall short [m]
PLACE, TURN = (True,) * 3 + (False,) * 3, (False,) * 3 + (True,) * 3


@dataclass(frozen=True)
class Builder:
    """Makes the terms of one program on one timeline.

    Attributes:
        program: whose terms they are.
        timeline: where its steps are.
        body: the robot on its planted links in its scene.
        checker: finds the contacts; it must see as far as any term asks.
    """

    program: Program
    timeline: Timeline
    body: WholeBody
    checker: SweptCollisionChecker

    @property
    def robot(self) -> RobotModel:
        """The robot."""
        return self.body.robot

    def costs(self) -> tuple[Cost[MotionState], ...]:
        """All costs that weigh anything."""
        return tuple(cost for term in self.program.problem.terms if term.is_cost for cost in self._costs_of(term))

    def constraints(self) -> tuple[Constraint[MotionState], ...]:
        """All constraints that are neither bounds nor held by the stance."""
        terms = self.program.problem.terms
        return tuple(found for term in terms if not term.is_cost for found in self._constraints_of(term))

    def bound(self, lower: Float[np.ndarray, "T n"], upper: Float[np.ndarray, "T n"]) -> None:
        """Narrow the bounds: what does not move, where waypoints are fixed, what joint constraints leave."""
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
                asked = ranges[column]
                low, high = max(asked.lower, self.robot.lower[column]), min(asked.upper, self.robot.upper[column])
                # The reserve that is kept from the limits elsewhere gives way to what is asked for.
                within = max(low, float(lower[row, column])), min(high, float(upper[row, column]))
                lower[row, column], upper[row, column] = within if within[0] <= within[1] else (low, high)

    def _costs_of(self, term: object) -> Iterator[Cost[MotionState]]:
        match term:
            case PoseTerm():
                gains = np.array([*term.pos_coeffs, *(term.turn_gain * c for c in term.rot_coeffs)])
                axes = gains > 0.0
                if np.any(axes):
                    yield Cost(term.title, Scaled(self._pose(term, axes), gains[axes]), penalty=Penalty.ABS)
            case JointTerm():
                columns, gains = self._weighed(term)
                if not len(columns):
                    return
                residual = self._joint_rows(term, columns)
                if not term.has_tolerance:
                    yield Cost(term.title, Scaled(residual, np.sqrt(gains), self._per_column(term.targets, columns)))
                    return
                between = self._between(term, residual, columns)
                yield Cost(term.title, Scaled(between, gains), penalty=Penalty.HINGE)
            case CartVelTerm():
                yield Cost(term.title, self._steps_of(term), penalty=Penalty.ABS)
            case CollisionTerm():
                clearance = PairClearance(self.robot, self._asked(term, is_cost=True), self._poses(term))
                yield Cost(term.title, clearance, penalty=Penalty.HINGE)

    def _constraints_of(self, term: object) -> Iterator[Constraint[MotionState]]:
        tolerance = self.program.problem.opt.tolerance
        match term:
            case PoseTerm():
                yield from self._pose_constraints(term, tolerance)
            case JointTerm() if term.order:
                columns, gains = self._weighed(term)
                if not len(columns):
                    return
                residual = self._joint_rows(term, columns)
                scale = float(gains.max())
                if term.has_tolerance:
                    between = self._between(term, residual, columns)
                    yield Constraint(term.title, between, tolerance=tolerance, scale=scale, unit="rad")
                else:
                    off = Scaled(residual, 1.0, self._per_column(term.targets, columns))
                    yield Constraint(term.title, off, Sense.EQUAL_ZERO, tolerance, scale, "rad")
            case JointStepTerm():
                columns = np.sort(self.program.columns)
                limits = WithinTolerance(self._differences(columns, term.first, term.last, 1, 1.0), self._vals(term))
                yield Constraint(term.title, limits, tolerance=tolerance, unit="rad")
            case CartVelTerm():
                yield Constraint(term.title, self._steps_of(term), tolerance=tolerance, unit="m")
            case CollisionTerm():
                scale = max(term.coeffs)
                if scale > 0.0:
                    clearance = PairClearance(self.robot, self._asked(term, is_cost=False), self._poses(term))
                    yield Constraint(term.title, clearance, tolerance=DISTANCE_TOLERANCE, scale=scale, unit="m")
            case ZmpTerm():
                soles = [sole_corners(self.robot, self.program.start, link) for link in term.links]
                row = [int(self.timeline.rows[term.step])]
                inside = CentreOfMassInPolygon(SupportPolygon.of_soles(soles), row)
                yield Constraint(term.title, inside, tolerance=tolerance, unit="m")
            case FootHeightTerm():
                yield from self._foot_height(term, tolerance)

    def _pose(self, term: PoseTerm, axes: Sequence[bool] | np.ndarray) -> FramePose:
        return FramePose(
            self.robot,
            term.frame,
            [int(self.timeline.rows[term.step])],
            pose_matrix(term.xyz, term.wxyz),
            tuple(bool(axis) for axis in axes),
            term.reference,
            pose_matrix(term.offset_xyz, term.offset_wxyz),
        )

    def _pose_constraints(self, term: PoseTerm, tolerance: float) -> Iterator[Constraint[MotionState]]:
        """Place and turn apart, since their units differ; one free axis of rotation as a direction."""
        if any(term.pos_coeffs):
            place = self._pose(term, [*(c > 0.0 for c in term.pos_coeffs), False, False, False])
            title = f"{term.title}: position of {term.frame}"
            yield Constraint(title, place, Sense.EQUAL_ZERO, tolerance, max(term.pos_coeffs), "m")
        turn = turn_residual(self.robot, term, np.array([int(self.timeline.rows[term.step])]))
        if turn is not None:
            title = f"{term.title}: orientation of {term.frame}"
            yield Constraint(title, turn, Sense.EQUAL_ZERO, tolerance, max(term.rot_coeffs), "rad")

    def _foot_height(self, term: FootHeightTerm, tolerance: float) -> Iterator[Constraint[MotionState]]:
        start = self.program.start
        pose = self.body.engine(start[None])
        body = next(body for body in self.robot.bodies if body.link == term.link)
        rotation, position = pose.rotation[0, body.joint], pose.position[0, body.joint]
        for k, corner in enumerate((sole_corners(self.robot, start, term.link) - position) @ rotation):
            above = PointHalfSpace(
                self.robot,
                term.link,
                [int(self.timeline.rows[term.step])],
                np.array([0.0, 0.0, -1.0]),
                -term.height,
                _in_frame(self.robot, term.link, corner),
            )
            yield Constraint(f"{term.title}: corner {k} of {term.link}", above, tolerance=tolerance, unit="m")

    def _steps_of(self, term: CartVelTerm) -> Residual[MotionState]:
        intervals = self.timeline.between(term.first, term.last)[:-1]
        return WithinTolerance(FrameDisplacement(self.robot, term.link, intervals), term.limit)

    def _weighed(self, term: JointTerm) -> tuple[Int[np.ndarray, "c"], Float[np.ndarray, "c"]]:
        """Coordinates whose coefficient is not zero, ascending, and their coefficients."""
        columns = np.sort(self.program.columns)
        gains = self._per_column(term.coeffs, columns)
        return columns[gains > 0.0], gains[gains > 0.0]

    def _joint_rows(self, term: JointTerm, columns: Int[np.ndarray, "c"]) -> Residual[MotionState]:
        if term.order:
            return self._differences(columns, term.first, term.last, term.order, term.rate)
        rows = self.timeline.rows[term.first : term.last + 1]
        return JointTarget(self.timeline.n_waypoints, self.robot.n, rows, columns, np.zeros(len(columns)))

    def _differences(
        self, columns: Int[np.ndarray, "c"], first: int, last: int, order: int, rate: float
    ) -> JointDifference:
        weights = np.zeros(self.robot.n)
        weights[columns] = 1.0
        rows = self.timeline.between(first, last)
        return JointDifference(self.timeline.n_waypoints, weights, order, 1.0 / rate, rows[: len(rows) - order])

    def _between(
        self, term: JointTerm, residual: Residual[MotionState], columns: Int[np.ndarray, "c"]
    ) -> Between[MotionState]:
        targets = self._per_column(term.targets, columns)
        lower = targets + self._per_column(term.lower_tols, columns)
        return Between(residual, lower, targets + self._per_column(term.upper_tols, columns))

    def _vals(self, term: JointStepTerm) -> Float[np.ndarray, "k"]:
        return self._per_column(term.vals, np.sort(self.program.columns))

    def _per_column(self, values: Vector, columns: Int[np.ndarray, "c"]) -> Float[np.ndarray, "c"]:
        """The entries of one of the file's lists for the given coordinates."""
        own = self.program.columns
        full = np.full(len(own), values[0]) if len(values) == 1 else np.array(values)
        return np.asarray(full[[int(np.flatnonzero(own == column)[0]) for column in columns.tolist()]])

    def _poses(self, term: CollisionTerm) -> SweptCollisionChecker | None:
        return None if term.is_swept else self.checker

    def _asked(self, term: CollisionTerm, is_cost: bool) -> AskedOfPairs:
        """What a collision term asks: as a cost weighed, as a constraint without weights and no more than can be."""
        everywhere = self._over_time(term, term.dist_pen, term.coeffs, is_cost)
        pairs = [
            (BodyRef.of_link(pair.link), self._named(other), self._over_time(term, pair.dist_pen, pair.coeffs, is_cost))
            for pair in term.pairs
            for other in pair.others
        ]
        asked = AskedOfPairs.of(self.checker, everywhere, pairs, self.body.standing_allowances())
        if is_cost:
            return asked
        for q in self.program.fixed.values():
            contacts = self.checker(self.body.engine(q[None]))
            asked = asked.relaxed_to(contacts, CLEARANCE_TOLERANCE)
        return asked

    def _named(self, name: str) -> BodyRef:
        """What a pair of the file names: a link, a body of one, or else a piece of the scene."""
        bodies = self.robot.bodies
        if any(body.link == name for body in bodies):
            return BodyRef.of_link(name)
        own = (BodyRef.of_body(body, self.robot.mechanism_links) for body in bodies if body.name == name)
        return next(own, BodyRef.of_piece(name))

    def _over_time(self, term: CollisionTerm, dist_pen: Vector, coeffs: Vector, is_cost: bool) -> Asked:
        """Per interval between waypoints (per waypoint, for poses); none where the term does not reach."""
        timeline = self.timeline
        count = max(timeline.n_waypoints - 1, 1) if term.is_swept else timeline.n_waypoints
        where = timeline.between(term.first, term.last)
        where = where[:-1] if term.is_swept else where
        index = np.minimum(timeline.step_of(where) - term.first, term.last - term.first)
        distance, gain = np.zeros(count), np.zeros(count)
        distance[where] = dist_pen[0] if len(dist_pen) == 1 else np.array(dist_pen)[index]
        weights = coeffs[0] if len(coeffs) == 1 else np.array(coeffs)[index]
        gain[where] = weights if is_cost else np.where(np.asarray(weights) > 0.0, 1.0, 0.0)
        return Asked(distance, gain)


def turn_residual(robot: RobotModel, term: PoseTerm, waypoints: Int[np.ndarray, "S"]) -> Residual[MotionState] | None:
    """The rotation that a pose constraint asks for; None if it leaves all axes free.

    Two axes asked for are a direction of the third: masking the rotation vector is right for small turns only.
    """
    axes = [c > 0.0 for c in term.rot_coeffs]
    target, offset = pose_matrix(term.xyz, term.wxyz), pose_matrix(term.offset_xyz, term.offset_wxyz)
    if not any(axes):
        return None
    if sum(axes) == 2:
        free = axes.index(False)
        axis, direction = offset[:3, free], target[:3, free]
        return AxisDirection(robot, term.frame, waypoints, axis, direction, term.reference)
    return FramePose(robot, term.frame, waypoints, target, (False, False, False, *axes), term.reference, offset)


def _in_frame(robot: RobotModel, link: str, point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """A point given in the frame of the joint that carries a link, in the frame of the link [m]."""
    placement = robot.model.frames[robot.model.getFrameId(link)].placement
    return np.asarray(placement.inverse().act(point))
