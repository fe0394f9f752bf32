"""A wheel to turn, as the search for a place to stand sees it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from costs.allowance import BodyRef
from costs.kinematics import locate_links
from costs.robot import Mechanism
from service.body.phases import PhaseSolver
from service.body.whole_body import WholeBody
from service.demands.hands import Hand
from service.demands.phase import TaskPhase
from service.demands.valve.strokes import TurnChoice, find_least_count, list_strokes, list_usable_entries
from service.demands.valve.wheel import Wheel, make_wheel_mechanism
from service.request.tasks.valve import ValveRequest
from service.tasks.stances.poses import (
    N_RANDOM,
    Outcome,
    StancePose,
    StancePoseFinder,
    place_turned,
)
from service.tasks.valve.turn import ValveTurn

WHEEL_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the turn at which a pose is tried
ASIDE_COST, LEAST_SIDEWAYS = 0.15, 0.3  # of standing beside a wheel's axis [1/rad^2]; unless it points up
MOST_NEAR = 3  # poses of a stroke from which one that is missing is guessed
MOST_ENTRIES = 2  # of a wheel, the nearest first


@dataclass(frozen=True)
class ValveStance:
    """A wheel to turn.

    Attributes:
        wheel: the wheel.
        hands: that may be used.
        request: the task.
        near: required clearances between hooks and wheel [m].
    """

    wheel: Wheel
    hands: tuple[Hand, ...]
    request: ValveRequest
    near: tuple[tuple[BodyRef, BodyRef, float], ...]

    @property
    def mechanism(self) -> Mechanism:
        """The wheel as a mechanism."""
        return make_wheel_mechanism(self.wheel, self.target)

    @property
    def target(self) -> float:
        """Angle to turn by [rad]."""
        return float(np.deg2rad(self.request.turn_deg))

    def list_ways(self) -> tuple[tuple[tuple[Hand, Float[np.ndarray, "P 3"]], ...], ...]:
        """Return the ways: either hand, all round the rim."""
        rim = np.array([self.wheel.rim_point(angle) for angle in np.linspace(0.0, 2.0 * np.pi, 4, endpoint=False)])
        return tuple(((hand, rim),) for hand in self.hands)

    def rate_places(self, poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N"]:
        """Return the cost of standing beside the wheel's axis, by the angle between them as seen from above."""
        axis, centre = self.wheel.axis, self.wheel.centre
        if np.hypot(*axis[:2]) < LEAST_SIDEWAYS:
            return np.zeros(len(poses))
        away = np.arctan2(*(poses[:, :2] - centre[:2]).T[::-1]) - np.arctan2(axis[1], axis[0])
        return np.asarray(ASIDE_COST * ((away + np.pi) % (2.0 * np.pi) - np.pi) ** 2)

    def is_in_the_way(
        self, poses: Float[np.ndarray, "N 3"], soles: Float[np.ndarray, "N C 2"], body_m: float
    ) -> Bool[np.ndarray, "N"]:
        """Return nowhere: a wheel turns in its place."""
        return np.zeros(len(poses), dtype=bool)

    @property
    def whole(self) -> float:
        """Size of the angle to turn by [rad]."""
        return abs(self.target)

    @property
    def is_angle(self) -> bool:
        """Yes."""
        return True

    def place_parts(self, *, is_end: bool) -> list[Float[np.ndarray, "V 3"]]:
        """Return the wheel."""
        return place_turned(self.mechanism, self.target if is_end else float(self.mechanism.start[0]))

    def find_in_the_way(self, body: WholeBody) -> Iterator[str]:
        """Yield nothing: a wheel turns in its place."""
        yield from ()

    def try_stance(self, solver: PhaseSolver) -> Outcome:
        """Return the largest part of the turn along which poses exist, with the better hand and entry."""
        best = Outcome(0.0, (), "", "pose at the wheel")
        for hand in self.hands:
            tool = locate_links(solver.body.engine, solver.body.nominal, [hand.tool])[hand.tool][:3, 3]

            def distance(angle: float, tool: Float[np.ndarray, "3"] = tool) -> float:
                return float(np.linalg.norm(self.wheel.rim_point(angle) - tool))

            sense = list_strokes(self.request, 1)[0].sense
            entries = list_usable_entries(self.wheel, hand, self.request.mode, sense)
            for entry in sorted(entries, key=distance)[:MOST_ENTRIES]:
                outcome = self._try_entry(solver, hand, entry)
                if outcome.reached > best.reached or not best.hold:
                    best = outcome
                if not outcome.missing:
                    return outcome
        return best

    def _try_entry(self, solver: PhaseSolver, hand: Hand, entry: float) -> Outcome:
        hold = f"{hand.side} hand in {self.request.mode} mode"
        choice = TurnChoice(hand, entry, find_least_count(self.request))
        turn = ValveTurn(solver, self.wheel, self.request, choice)
        finder = StancePoseFinder(solver, self.mechanism, turn.hints)
        poses: list[StancePose] = []
        missing: list[str] = []
        done = total = 0.0
        for stroke in _split_strokes(turn.list_phases()):
            anchor = next(spec for spec in stroke if spec.moving)
            weight = abs(float(anchor.last[0] - anchor.first[0])) / len(WHEEL_SHARES)
            values = [anchor.first + share * (anchor.last - anchor.first) for share in WHEEL_SHARES]
            before = {spec.name: finder.find(spec, poses) for spec in stroke[: stroke.index(anchor)]}
            known = [*poses, *(pose for pose in before.values() if pose is not None)]
            held = self._follow(finder, [replace(anchor, first=value) for value in values], known)
            total += weight * len(held)
            done += weight * sum(pose is not None for pose in held)
            missing += [
                f"{np.rad2deg(abs(float(value[0]))):.0f} deg"
                for value, pose in zip(values, held, strict=True)
                if pose is None
            ]
            found = [pose for pose in held if pose is not None]
            if missing and self.request.mode == "grasp":
                return Outcome(done, (*poses, *found), hold, f"no pose at {missing[0]} of the turn")
            for spec in stroke:
                begun = held[0]
                if spec is anchor or begun is None:
                    continue
                pose = before.get(spec.name) or finder.find(spec, (begun,))
                if pose is None:
                    words = f"no pose before the hold at {np.rad2deg(abs(float(spec.first[0]))):.0f} deg of the turn"
                    return Outcome(0.0, (*poses, *found), hold, words)
                poses.append(pose)
            poses += found
        words = f"no pose at {', '.join(missing)} of the turn" if missing else ""
        return Outcome(abs(self.target) * (done / total), tuple(poses), hold, words)

    def _follow(
        self, finder: StancePoseFinder, specs: Sequence[TaskPhase], before: Sequence[StancePose]
    ) -> list[StancePose | None]:
        """Return poses along a stroke, each guessed from its neighbour; None where there is none.

        Where the first is not found from the poses before, random configurations are guessed as well.
        """
        held: list[StancePose | None] = []
        known = list(before)
        for spec in specs:
            pose = finder.find(spec, known, 0 if any(held) else N_RANDOM)
            held.append(pose)
            known += [] if pose is None else [pose]
        for index in range(len(specs) - 1, -1, -1):  # what was not found forwards may be found backwards, or from afar
            near = sorted((abs(index - at), at) for at, pose in enumerate(held) if pose is not None)
            for _, at in [] if held[index] is not None else near[:MOST_NEAR]:
                held[index] = held[index] or finder.find(specs[index], [pose for pose in held[at : at + 1] if pose])
        return held


def _split_strokes(specs: Sequence[TaskPhase]) -> list[list[TaskPhase]]:
    """Return the phases of each stroke in which the hand holds the wheel and does not leave."""
    strokes: list[list[TaskPhase]] = []
    for spec in specs:
        if spec.hand is None:
            strokes.append([])
        elif not spec.hand.leaves:
            strokes[-1].append(spec)
    return strokes
