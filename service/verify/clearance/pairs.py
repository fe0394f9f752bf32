"""Pairs of solids whose clearance is checked, and the intervals on which it is still open."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.allowance import Allowance, BodyIndex
from costs.native import HullSet
from service.verify.clearance.swaying import bound_sways
from service.verify.joint_chain import JointChain, JointTree
from service.verify.motion import Motion
from service.verify.solids import CoalSolid


@dataclass(frozen=True)
class PairTable:
    """Checked pairs; the mover is swept in the frame of the holder.

    Attributes:
        solids: bodies, then pieces.
        n_bodies: how many of them are bodies.
        mover, holder: (C,) indices into ``solids``.
        allowed: (C, phases) greatest penetration allowed [m]; NaN where the pair may not touch.
        demanded: (C,) least distance of a pair that may not touch [m].
        world: per body, the joints that move it in the world.
        chain: (C,) row of ``chains`` of pairs near each other, else -1.
        chains: row by row, the joints that move a mover in its holder's frame.
        is_left_out: (C,) pairs that are only shown to keep apart: no check is about them, and they come last.
    """

    solids: tuple[CoalSolid, ...]
    n_bodies: int
    mover: Int[np.ndarray, "C"]
    holder: Int[np.ndarray, "C"]
    allowed: Float[np.ndarray, "C F"]
    demanded: Float[np.ndarray, "C"]
    world: tuple[JointChain, ...]
    chain: Int[np.ndarray, "C"]
    chains: JointChain
    is_left_out: Bool[np.ndarray, "C"]

    def names(self, pair: int) -> tuple[str, str]:
        """Return the names of mover and holder."""
        return self.solids[self.mover[pair]].name, self.solids[self.holder[pair]].name

    @cached_property
    def world_rows(self) -> JointChain:
        """Row by row, the joints that move each body in the world."""
        return JointChain.stack(self.world)

    @cached_property
    def hulls(self) -> HullSet:
        """Vertices of all solids in one array."""
        return HullSet.of([solid.vertices for solid in self.solids])

    @cached_property
    def joint(self) -> Int[np.ndarray, "S"]:
        """Joint of every solid."""
        return np.array([solid.joint for solid in self.solids], dtype=int)

    @cached_property
    def centre(self) -> Float[np.ndarray, "B 3"]:
        """Centre of every body's sphere, in the frame of its joint [m]."""
        return np.array([solid.sphere[0] for solid in self.solids[: self.n_bodies]]).reshape(-1, 3)

    @cached_property
    def radius(self) -> Float[np.ndarray, "B"]:
        """Radius of every body's sphere [m]."""
        return np.array([solid.sphere[1] for solid in self.solids[: self.n_bodies]])

    def with_left_out(self, links: Collection[tuple[str, str]]) -> PairTable:
        """Return the table with all pairs of bodies of these links, given by names in order, as pairs left out."""
        if not links:
            return self
        bodies, joint = self.solids[: self.n_bodies], self.joint[: self.n_bodies]
        i, j = np.triu_indices(self.n_bodies, 1)
        chosen = _are_listed(bodies, links)[i, j] & (joint[i] != joint[j])
        mover, holder = i[chosen], j[chosen]
        none = np.full(len(mover), -1)
        return replace(
            self,
            mover=np.concatenate([self.mover, mover]),
            holder=np.concatenate([self.holder, holder]),
            allowed=np.concatenate([self.allowed, np.full((len(mover), self.allowed.shape[1]), np.nan)]),
            demanded=np.concatenate([self.demanded, np.zeros(len(mover))]),
            chain=np.concatenate([self.chain, none]),
            is_left_out=np.concatenate([self.is_left_out, none < 0]),
        )

    def without_left_out(self) -> PairTable:
        """Return the table of the pairs that are checked; their numbers stay the same."""
        n = int(np.count_nonzero(~self.is_left_out))
        return replace(
            self,
            mover=self.mover[:n],
            holder=self.holder[:n],
            allowed=self.allowed[:n],
            demanded=self.demanded[:n],
            chain=self.chain[:n],
            is_left_out=self.is_left_out[:n],
        )

    def link_names(self, pair: int) -> tuple[str, str]:
        """Return the links of two bodies, in order."""
        a, b = (self.solids[side[pair]].link for side in (self.mover, self.holder))
        return (a, b) if a < b else (b, a)

    def with_chains(self, tree: JointTree, near: Int[np.ndarray, "K"]) -> PairTable:
        """Return the table with chains of the pairs ``near``, each swept in the frame that gives the tighter bound."""
        chains, known = list(self.world), dict[tuple[int, int], int]()

        def row_of(frame: int, mover: int) -> int:
            """Return the row of a chain shared by all pairs of a mover and a frame."""
            if frame == 0:
                return mover
            if (frame, mover) not in known:
                known[frame, mover] = len(chains)
                chains.append(tree.chain_of_body(frame, self.solids[mover].joint, self.solids[mover].vertices))
            return known[frame, mover]

        mover, holder = self.mover.copy(), self.holder.copy()
        rows = np.where(holder >= self.n_bodies, mover, -1)
        for c in near[holder[near] < self.n_bodies].tolist():
            a, b = int(mover[c]), int(holder[c])
            forward, backward = row_of(int(self.joint[b]), a), row_of(int(self.joint[a]), b)
            rows[c] = forward
            if chains[backward].weight < chains[forward].weight:
                mover[c], holder[c], rows[c] = b, a, backward
        return replace(self, mover=mover, holder=holder, chain=rows, chains=JointChain.stack(chains))


def collect_pairs(motion: Motion, tree: JointTree) -> PairTable:
    """Collect the pairs whose two members can move against each other, without the ignored ones.

    The links of a mechanism are checked like the robot's: against all pieces, the robot's links and each other.
    """
    bodies = [CoalSolid.of_body(body) for body in motion.robot.bodies]
    pieces = [CoalSolid.of_piece(piece) for piece in motion.scene.pieces]
    solids = (*bodies, *pieces)
    joint = np.array([solid.joint for solid in bodies], dtype=int)
    moving = np.flatnonzero(joint > 0)
    i, j = np.triu_indices(len(bodies), 1)
    apart = ~_are_ignored(bodies, motion.robot.ignored_pairs)[i, j] & (joint[i] != joint[j])
    mover = np.concatenate([np.repeat(moving, len(pieces)), i[apart]])
    holder = np.concatenate([np.tile(np.arange(len(bodies), len(solids)), len(moving)), j[apart]])
    index = BodyIndex(motion.robot.bodies, motion.mechanism_links, motion.scene.pieces)
    phases = [_allowed(phase.allowances, index)[mover, holder] for phase in motion.phases]
    allowed = np.stack(phases, axis=1) if phases else np.full((len(mover), 1), np.nan)
    is_own = np.array([solid.link not in motion.mechanism_links for solid in bodies], dtype=bool)
    sways = bound_sways(tree, motion.robot.bodies, motion.sway)
    # Names of links and pieces differ, so that one table has both.
    added = np.array([motion.padding.get(s.link if s.link else s.name, 0.0) for s in solids])
    least = np.maximum(motion.clearance_m, added[mover] + added[holder])
    demanded = np.where(is_own[mover] & (holder >= len(bodies)), least + sways[mover], 0.0)
    world = tuple(tree.chain_of_body(0, solid.joint, solid.vertices) for solid in bodies)
    none = np.full(len(mover), -1)
    return PairTable(solids, len(bodies), mover, holder, allowed, demanded, world, none, JointChain.stack(()), none > 0)


def _are_ignored(bodies: Sequence[CoalSolid], pairs: frozenset[tuple[str, str]]) -> Bool[np.ndarray, "B B"]:
    """Return a mask of the bodies of the same link and of two links that are not checked against each other."""
    link = np.array([solid.link for solid in bodies])
    return np.asarray(_are_listed(bodies, pairs) | (link[:, None] == link))


def _are_listed(bodies: Sequence[CoalSolid], pairs: Collection[tuple[str, str]]) -> Bool[np.ndarray, "B B"]:
    """Return a mask of the bodies whose links are a pair of the list."""
    links = {link: row for row, link in enumerate(dict.fromkeys(solid.link for solid in bodies))}
    listed = np.zeros((len(links), len(links)), dtype=bool)
    # Names out of order denote no pair, as documented in RobotModel.
    rows = [(links[a], links[b]) for a, b in pairs if a < b and a in links and b in links]
    if rows:
        a, b = np.array(rows).T
        listed[a, b] = listed[b, a] = True
    link = np.array([links[solid.link] for solid in bodies], dtype=int)
    return np.asarray(listed[np.ix_(link, link)])


def _allowed(allowances: Sequence[Allowance], index: BodyIndex) -> Float[np.ndarray, "B B+P"]:
    """Return the greatest allowed depth per body and other body or piece [m], NaN without an allowance."""
    depth = np.full(index.shape, np.nan)
    for allowance in sorted(allowances, key=lambda allowance: allowance.depth):  # the deepest of a pair's counts
        index.fill(depth, allowance.first, allowance.second, allowance.depth)
    return depth


@dataclass(frozen=True)
class PairIntervals:
    """Pairs on intervals that are still open, with the results of earlier rounds.

    Attributes:
        pair: (E,) pair.
        first, last: (E,) path parameters.
        phase: (E,) index of the phase.
        floor: (E,) a lower bound of the pair's clearance [m] (-inf: none).
        halved: (E,) how often an interval of the broad phase was halved to this one.
        hint: (E, 3) best unit direction so far from mover to holder, in the holder's frame; NaN: none.
        ends: (E, 2) sampled distance at both ends [m] (inf: not sampled).
    """

    pair: Int[np.ndarray, "E"]
    first: Float[np.ndarray, "E"]
    last: Float[np.ndarray, "E"]
    phase: Int[np.ndarray, "E"]
    floor: Float[np.ndarray, "E"]
    halved: Int[np.ndarray, "E"]
    hint: Float[np.ndarray, "E 3"]
    ends: Float[np.ndarray, "E 2"]

    @staticmethod
    def unknown(
        pair: Int[np.ndarray, "E"],
        first: Float[np.ndarray, "E"],
        last: Float[np.ndarray, "E"],
        phase: Int[np.ndarray, "E"],
        floor: Float[np.ndarray, "E"],
    ) -> PairIntervals:
        """Return intervals that have not been examined."""
        n = len(pair)
        hint, ends = np.full((n, 3), np.nan), np.full((n, 2), np.inf)
        return PairIntervals(pair, first, last, phase, floor, np.zeros(n, dtype=int), hint, ends)

    def __len__(self) -> int:
        return len(self.pair)

    def take(self, rows: np.ndarray | slice) -> PairIntervals:
        """Return these rows."""
        return PairIntervals(*(column[rows] for column in vars(self).values()))

    @staticmethod
    def join(parts: Sequence[PairIntervals]) -> PairIntervals:
        """Concatenate at least one part."""
        if len(parts) == 1:
            return parts[0]
        return PairIntervals(
            *(np.concatenate(column) for column in zip(*(vars(part).values() for part in parts), strict=True))
        )

    def halves(self, hint: Float[np.ndarray, "E 3"], middle: Float[np.ndarray, "E"]) -> PairIntervals:
        """Return both halves of every interval.

        Args:
            hint: (E, 3) the direction that did best.
            middle: (E,) sampled distance at the intervals' middles [m] (inf: not sampled).
        """
        half = 0.5 * (self.first + self.last)
        ends = np.empty((2, len(self), 2))
        ends[0, :, 0], ends[1, :, 1] = self.ends.T
        ends[0, :, 1] = ends[1, :, 0] = middle
        return PairIntervals(
            np.concatenate([self.pair, self.pair]),
            np.concatenate([self.first, half]),
            np.concatenate([half, self.last]),
            np.concatenate([self.phase, self.phase]),
            np.full(2 * len(self), -np.inf),
            np.concatenate([self.halved, self.halved]) + 1,
            np.concatenate([hint, hint]),
            ends.reshape(-1, 2),
        )
