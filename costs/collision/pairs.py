"""Which pairs are checked, and how far apart they shall be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from costs.allowance import Allowance, BodyIndex, BodyRef
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
        overrides: Sequence[tuple[BodyRef, BodyRef, float]] = (),
        self_margin: float | None = None,
    ) -> PairMargins:
        """Margins of all pairs of a robot in a scene.

        Args:
            robot: its ignored pairs, fixed links and mechanism links are left out as far as they are exempt.
            scene: the pieces.
            margin: distance asked of a link and a piece [m].
            allowances: pairs that may touch; asked of them is minus the depth they may reach.
            overrides: ``(one, other, margin)`` for single pairs; the last that covers a pair counts.
            self_margin: distance asked of two links; ``margin`` if None.
        """
        index = BodyIndex(robot.bodies, robot.mechanism_links, scene.pieces)
        asked = np.full(index.shape, margin if self_margin is None else self_margin)
        asked[:, index.n_bodies :] = margin
        for first, second, value in overrides:
            index.fill(asked, first, second, value)
        for allowance in allowances:
            index.fill(asked, allowance.first, allowance.second, -allowance.depth)
        world, self_pairs = asked[:, index.n_bodies :].copy(), _pairs_of(robot)
        own = asked[self_pairs[:, 0], self_pairs[:, 1]]
        exempt = robot.fixed_links | robot.mechanism_links
        world[[body.link in exempt for body in robot.bodies]] = -np.inf
        return PairMargins(world, self_pairs, own)

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


def _pairs_of(robot: RobotModel) -> Int[np.ndarray, "K 2"]:
    """Bodies that can move against each other, less the pairs that the robot ignores."""
    links = {body.link: row for row, body in enumerate(robot.bodies)}
    number = np.array([links[body.link] for body in robot.bodies], dtype=int)
    joint = np.array([body.joint for body in robot.bodies], dtype=int)
    ignored = np.zeros((len(robot.bodies), len(robot.bodies)), dtype=bool)
    for one, other in robot.ignored_pairs:
        if one in links and other in links:
            ignored[links[one], links[other]] = ignored[links[other], links[one]] = True
    first, second = np.triu_indices(len(robot.bodies), 1)
    is_checked = (joint[first] != joint[second]) & ~ignored[number[first], number[second]]
    return np.stack([first[is_checked], second[is_checked]], axis=1)
