"""A given mechanism to move, as the search for a place to stand sees it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from costs.allowance import BodyRef
from costs.robot import Mechanism
from service.body.phases import PhaseSolver
from service.body.whole_body import WholeBody
from service.demands.hands import Hand
from service.demands.mechanism.given import GivenMechanism
from service.demands.mechanism.phases import make_mechanism_phases
from service.tasks.hints import measure_way
from service.tasks.mechanism.plan import check_hold, find_blocked_move
from service.tasks.stances.poses import (
    N_RANDOM,
    Outcome,
    StancePoseFinder,
)

MOVE_SHARES = (0.5, 1.0)  # of each move of a given mechanism at which a pose is tried


@dataclass(frozen=True)
class MechanismStance:
    """A given mechanism to move.

    Attributes:
        given: the mechanism and the task.
        hands: that may be used.
        near: required clearances between hands and mechanism [m].
    """

    given: GivenMechanism
    hands: tuple[Hand, ...]
    near: tuple[tuple[BodyRef, BodyRef, float], ...]

    @property
    def mechanism(self) -> Mechanism:
        """The joints of the URDF."""
        return self.given.mechanism

    def rate_places(self, poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N"]:
        """Return nothing: no side of a given mechanism is preferred."""
        return np.zeros(len(poses))

    def is_in_the_way(
        self, poses: Float[np.ndarray, "N 3"], soles: Float[np.ndarray, "N C 2"], body_m: float
    ) -> Bool[np.ndarray, "N"]:
        """Return nowhere: ``find_in_the_way`` looks at the links."""
        return np.zeros(len(poses), dtype=bool)

    @property
    def whole(self) -> float:
        """All of the way."""
        return 1.0

    @property
    def is_angle(self) -> bool:
        """No: several joints may move."""
        return False

    def list_ways(self) -> tuple[tuple[tuple[Hand, Float[np.ndarray, "P 3"]], ...], ...]:
        """Return the ways: either hand, at the handle before and after every move."""
        specs = [spec for spec in make_mechanism_phases(self.given, self.hands[0]) if spec.moving]
        places = []
        for values in (specs[0].first, *(spec.last for spec in specs)):
            pose = self.given.locate(self.given.handle.joint, values)
            places.append(pose[:3, :3] @ self.given.handle.place + pose[:3, 3])
        return tuple(((hand, np.array(places)),) for hand in self.hands)

    def place_parts(self, *, is_end: bool) -> list[Float[np.ndarray, "V 3"]]:
        """Return the bodies that joints move."""
        last = make_mechanism_phases(self.given, self.hands[0])[-1].last
        return self.given.place_moving(last if is_end else self.mechanism.start)

    def find_in_the_way(self, body: WholeBody) -> Iterator[str]:
        """Yield a sentence for the planted link that the mechanism would meet."""
        blocked = find_blocked_move(body, self.given)
        yield from () if blocked is None else blocked.obstacle

    def try_stance(self, solver: PhaseSolver) -> Outcome:
        """Return the largest part of the moves for which poses exist, with the better hand.

        Raises:
            RequestError: a hand does not touch what it is to hold.
        """
        check_hold(solver, self.hands, self.given)
        outcomes = []
        for hand in self.hands:
            outcomes.append(self._try_hand(StancePoseFinder(solver, self.mechanism), hand))
            if not outcomes[-1].missing:
                break
        return max(outcomes, key=lambda outcome: outcome.reached)

    def _try_hand(self, finder: StancePoseFinder, hand: Hand) -> Outcome:
        hold = f"{hand.side} hand at {self.given.request.handle.link}"
        specs = make_mechanism_phases(self.given, hand)
        moves = [spec for spec in specs if spec.moving]
        travels = [measure_way(spec, self.mechanism) for spec in moves]
        first = finder.find(moves[0], (), N_RANDOM)
        before = None if first is None else finder.find(specs[1], (first,))
        if first is None or before is None:
            return Outcome(0.0, () if first is None else (first,), hold, "pose at the handle: no pose")
        poses, done = [before, first], 0.0
        for spec, travel in zip(moves, travels, strict=True):
            for share in MOVE_SHARES:
                pose = finder.find(replace(spec, first=spec.first + share * (spec.last - spec.first)), poses)
                if pose is None:
                    words = f"no pose in '{spec.name}' at {100.0 * share:.0f} % of its way"
                    return Outcome(done / sum(travels), tuple(poses), hold, words)
                poses.append(pose)
                done += travel / len(MOVE_SHARES)
        return Outcome(1.0, tuple(poses), hold, "")
