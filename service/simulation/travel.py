"""Travel of a mechanism's joints in physics, measured move by move in the direction of the plan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from service.demands.resistance import MechanismPhysics
from service.execution.reference import PlannedReference, ReferencePhase
from service.replay.simulation_claims import LEAST_TRAVEL, TRAVEL_SHARE
from service.simulation.seen import Seen

STRAY = {"rad": float(np.deg2rad(3.0)), "m": 5e-3}  # by which a joint may go where the plan does not move it
LATE_S = 0.25  # after a move, within which servos may still bring its end


@dataclass(frozen=True)
class JointMove:
    """One phase in which the plan moves a joint of the mechanism, and what became of it [rad, m].

    Attributes:
        phase, joint: names.
        unit: of all values.
        planned: signed travel of the plan.
        reached: farthest travel in physics along the plan's sense, signed like the plan's: from where the plan begins,
            or from where the joint was if that is elsewhere.
        planned_end: value of the plan at the end of the phase.
        end: value in physics then, the nearest to the plan within a quarter of a second before it moves again.
        range: of the plan's values of this joint so far.
        has_spring: whether the joint returns by itself, so that it may be moved farther than planned.
        freed: whether the joint freed the latch that it is there for.
    """

    phase: str
    joint: str
    unit: Literal["rad", "m"]
    planned: float
    reached: float
    planned_end: float
    end: float
    range: float
    has_spring: bool
    freed: bool

    @property
    def share(self) -> float:
        """Reached travel relative to the planned one."""
        return self.reached / self.planned

    @property
    def is_done(self) -> bool:
        """Whether the move was made, and ended where the plan ends it.

        It falls short by at most 5 % of its travel, and of its end by at most 5 % of the joint's range so far: a small
        move after a large one begins where the large one ended.  It goes too far by at most 5 mm or 3 deg more, since a
        hand is in its place to within millimetres; a joint with a spring comes back from anywhere.  A lever that frees
        a latch has done its work once the latch is free.
        """
        beyond = float(np.sign(self.planned)) * (self.end - self.planned_end)
        is_near = abs(beyond) <= TRAVEL_SHARE * abs(self.planned)
        if self.freed or is_near:
            return True
        if self.share < 1.0 - TRAVEL_SHARE or self.has_spring:
            return self.share >= 1.0 - TRAVEL_SHARE
        return -TRAVEL_SHARE * self.range <= beyond <= TRAVEL_SHARE * self.range + STRAY[self.unit]

    def describe(self) -> str:
        """Return a sentence on the travel, and on the end where the travel alone is as planned."""
        words = (
            f"{self.joint} moved by {format_value(self.reached, self.unit, bare=True)} of "
            f"{format_value(self.planned, self.unit)} in phase '{self.phase}' ({round(100.0 * self.share)} %)"
        )
        if self.share < 1.0 - TRAVEL_SHARE or self.has_spring:
            return words
        ends = (format_value(value, self.unit) for value in (self.end, self.planned_end))
        return f"{words} and ended at {' instead of '.join(ends)}"

    def to_json(self) -> dict[str, Any]:
        """Return an entry of ``mechanism`` in ``simulation.json``."""
        return {
            "phase": self.phase,
            "joint": self.joint,
            "unit": self.unit,
            "planned": self.planned,
            "reached": self.reached,
            "share": self.share,
            "planned_end": self.planned_end,
            "end": self.end,
            "is_done": self.is_done,
        }


def format_value(value: float, unit: str, *, bare: bool = False) -> str:
    """Return a value in mm or deg, ``bare`` without its unit."""
    factor, name = (1e3, "mm") if unit == "m" else (180.0 / np.pi, "deg")
    return f"{round(factor * value, 1) + 0.0:.1f}" + ("" if bare else f" {name}")


def read_unit(reference: PlannedReference, joint: str) -> Literal["rad", "m"]:
    """Return the unit of a joint of the mechanism."""
    model = reference.robot.model
    return "m" if "Prismatic" in model.joints[model.getJointId(joint)].shortname() else "rad"


def find_row(times: Float[np.ndarray, "S"], time_s: float) -> int:
    """Return the first sample at or after a time; the last sample where there is none."""
    return min(int(np.searchsorted(times, time_s - 1e-9)), len(times) - 1)


def measure_moves(reference: PlannedReference, seen: Seen, physics: MechanismPhysics) -> tuple[JointMove, ...]:
    """Return every move of every joint of the mechanism that began, in the order of the plan."""
    moves: list[JointMove] = []
    for phase in reference.phases:
        if phase.begin_s <= seen.times[-1]:
            moves += _measure_phase(reference, seen, phase, physics)
    return tuple(moves)


def _measure_phase(
    reference: PlannedReference, seen: Seen, phase: ReferencePhase, physics: MechanismPhysics
) -> Iterator[JointMove]:
    first = reference.robot.n - len(reference.mechanism_names)
    begin, end = reference.at(phase.begin_s).mechanism, reference.at(phase.end_s).mechanism
    rows = slice(find_row(seen.times, phase.begin_s), find_row(seen.times, phase.end_s + LATE_S) + 1)
    late = slice(find_row(seen.times, phase.end_s), rows.stop)
    so_far = seen.planned[: rows.stop]
    for k, joint in enumerate(reference.mechanism_names):
        travel = float(end[k] - begin[k])
        if abs(travel) < LEAST_TRAVEL:
            continue
        sense = float(np.sign(travel))
        true, unit = seen.configuration[:, first + k], read_unit(reference, joint)
        start = true[rows.start] if abs(true[rows.start] - begin[k]) > STRAY[unit] else begin[k]
        is_there = np.abs(seen.planned[late, first + k] - end[k]) <= LEAST_TRAVEL  # until the next move begins
        is_there[0] = True
        ends = true[late][is_there]
        yield JointMove(
            phase=phase.name,
            joint=joint,
            unit=unit,
            planned=travel,
            reached=sense * float((sense * (true[rows] - start)).max()),
            planned_end=float(end[k]),
            end=float(ends[np.abs(ends - end[k]).argmin()]),
            range=max(float(np.ptp(so_far[:, first + k])), abs(travel)),
            has_spring=physics.has_spring(joint),
            freed=any(
                release.latch == joint and not seen.is_latched[: rows.stop, r].all()
                for r, release in enumerate(reference.motion.releases)
            ),
        )
