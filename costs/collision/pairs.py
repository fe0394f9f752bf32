"""Which pairs are checked, and how far apart they shall be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from costs.allowance import Allowance
from costs.collision.contacts import Contacts
from costs.robot.model import RobotModel
from costs.scene import Scene


@dataclass(frozen=True)
class PairMargins:
    """Distance asked of every pair [m]; ``-inf`` where a pair is not checked.

    Attributes:
        world: (B, P) bodies against pieces.
        self_pairs: (K, 2) body indices; the second is swept in the frame of the first.
        own: (K,) bodies against bodies.
    """

    world: Float[np.ndarray, "B P"]
    self_pairs: Int[np.ndarray, "K 2"]
    own: Float[np.ndarray, "K"]

    @staticmethod
    def of(
        robot: RobotModel,
        scene: Scene,
        margin: float,
        allowances: Sequence[Allowance] = (),
        overrides: Sequence[tuple[str, str, float]] = (),
        self_margin: float | None = None,
    ) -> PairMargins:
        """Margins of all pairs of a robot in a scene.

        Args:
            robot: its ignored pairs, fixed links and mechanism links are left out as far as they are exempt.
            scene: the pieces.
            margin: distance asked of a link and a piece [m].
            allowances: pairs that may touch; asked of them is minus the depth they may reach.
            overrides: ``(link, other, margin)`` for single pairs, names as in an allowance.
            self_margin: distance asked of two links; ``margin`` if None.
        """
        bodies = robot.bodies
        rules = [(Allowance(link, other, 0.0), value) for link, other, value in overrides]
        rules += [(allowance, -allowance.depth) for allowance in allowances]
        world = np.full((len(bodies), len(scene.pieces)), margin)
        exempt = robot.fixed_links | robot.mechanism_links
        for b, body in enumerate(bodies):
            if body.link in exempt:
                world[b] = -np.inf
                continue
            for rule, value in rules:
                for p, piece in enumerate(scene.pieces):
                    if rule.covers(body.name, body.link, piece.name):
                        world[b, p] = value
        pairs, own = [], []
        for a, first in enumerate(bodies):
            for b in range(a + 1, len(bodies)):
                second = bodies[b]
                names = tuple(sorted((first.link, second.link)))
                if first.joint == second.joint or names in robot.ignored_pairs:
                    continue
                value = margin if self_margin is None else self_margin
                for rule, asked in rules:
                    if rule.covers(first.name, first.link, second.name, second.link):
                        value = asked
                pairs.append((a, b))
                own.append(value)
        return PairMargins(world, np.array(pairs, dtype=int).reshape(-1, 2), np.array(own))

    def relaxed_to(self, contacts: Contacts, reserve: float) -> PairMargins:
        """Margins no larger than the distances of the given contacts less ``reserve`` [m]."""
        world, own = self.world.copy(), self.own.copy()
        reach = contacts.distance - reserve
        rows = ~contacts.is_self
        np.minimum.at(world, (contacts.body[rows], contacts.other[rows]), reach[rows])
        index = {(int(a), int(b)): k for k, (a, b) in enumerate(self.self_pairs)}
        for body, other, limit in zip(
            contacts.body[~rows].tolist(), contacts.other[~rows].tolist(), reach[~rows].tolist(), strict=True
        ):
            pair = index[(min(body, other), max(body, other))]
            own[pair] = min(own[pair], limit)
        return PairMargins(world, self.self_pairs, own)
