"""Checked pairs and the clearance they require."""

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
    """Required clearance per pair [m]; ``-inf`` where a pair is not checked.

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
        """Return the margins of all pairs of a robot in a scene.

        Args:
            robot: its ignored pairs, fixed links and mechanism links are left out as far as they are exempt.
            scene: the pieces.
            margin: required clearance of a link and a piece [m].
            allowances: pairs that may touch; their margin is minus their depth.
            overrides: ``(first, second, margin)`` for single pairs; the last that covers a pair counts.
            self_margin: required clearance of two links; ``margin`` if None.
        """
        index = BodyIndex(robot.bodies, robot.mechanism_links, scene.pieces)
        margins = np.full(index.shape, margin if self_margin is None else self_margin)
        margins[:, index.n_bodies :] = margin
        for first, second, value in overrides:
            index.fill(margins, first, second, value)
        for allowance in allowances:
            index.fill(margins, allowance.first, allowance.second, -allowance.depth)
        world, self_pairs = margins[:, index.n_bodies :].copy(), _find_pairs(robot)
        own = margins[self_pairs[:, 0], self_pairs[:, 1]]
        exempt = robot.fixed_links | robot.mechanism_links
        world[[body.link in exempt for body in robot.bodies]] = -np.inf
        return PairMargins(world, self_pairs, own)

    def relax_to(
        self, contacts: Contacts, reserve: float, touching_reserve: float | None = None, kept: float = 0.0
    ) -> PairMargins:
        """Return margins no larger than the distances of the given contacts less a reserve.

        Args:
            contacts: at a configuration.
            reserve: of pairs that keep clear [m].
            touching_reserve: of pairs that may touch, whose margin is negative; the same if None [m].
            kept: distance within which a pair that keeps clear has no reserve [m].
        """
        world, own = self.world.copy(), self.own.copy()
        touching = reserve if touching_reserve is None else touching_reserve
        clear = np.maximum(contacts.distance - reserve, np.minimum(contacts.distance, kept))
        reach = np.where(contacts.margin < 0.0, contacts.distance - touching, clear)
        rows = ~contacts.is_self
        np.minimum.at(world, (contacts.body[rows], contacts.other[rows]), reach[rows])
        index = {(int(a), int(b)): k for k, (a, b) in enumerate(self.self_pairs)}
        for body, other, limit in zip(
            contacts.body[~rows].tolist(), contacts.other[~rows].tolist(), reach[~rows].tolist(), strict=True
        ):
            pair = index[(min(body, other), max(body, other))]
            own[pair] = min(own[pair], limit)
        return PairMargins(world, self.self_pairs, own)


def _find_pairs(robot: RobotModel) -> Int[np.ndarray, "K 2"]:
    """Find pairs of bodies that can move against each other, without those that the robot ignores.

    How the links of a mechanism move against each other and the scene is prescribed by the task: no variable of the
    optimiser changes it, so they need no margin. The verifier checks them.
    """
    links = {body.link: row for row, body in enumerate(robot.bodies)}
    number = np.array([links[body.link] for body in robot.bodies], dtype=int)
    joint = np.array([body.joint for body in robot.bodies], dtype=int)
    ignored = np.zeros((len(robot.bodies), len(robot.bodies)), dtype=bool)
    for link, other in robot.ignored_pairs:
        if link in links and other in links:
            ignored[links[link], links[other]] = ignored[links[other], links[link]] = True
    first, second = np.triu_indices(len(robot.bodies), 1)
    is_checked = (joint[first] != joint[second]) & ~ignored[number[first], number[second]]
    is_moved = np.array([body.link in robot.mechanism_links for body in robot.bodies], dtype=bool)
    is_checked &= ~(is_moved[first] & is_moved[second])
    return np.stack([first[is_checked], second[is_checked]], axis=1)
