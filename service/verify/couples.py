"""Which pairs are checked: bodies against pieces, and bodies against bodies that can move towards them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from costs.allowance import Allowance
from service.verify.chain import Chain, JointTree
from service.verify.motion import Motion
from service.verify.narrow import Solid, extreme_points


@dataclass(frozen=True)
class Couples:
    """All checked pairs; the mover is swept in the frame of the holder.

    Attributes:
        solids: bodies, then pieces.
        n_bodies: how many of them are bodies.
        mover, holder: (C,) indices into ``solids``.
        chains: per pair, the joints that move the mover in the holder's frame.
        allowed: (C, phases) greatest penetration allowed [m]; NaN where the pair may not touch.
    """

    solids: tuple[Solid, ...]
    n_bodies: int
    mover: Int[np.ndarray, "C"]
    holder: Int[np.ndarray, "C"]
    chains: tuple[Chain, ...]
    allowed: Float[np.ndarray, "C F"]

    def names(self, couple: int) -> tuple[str, str]:
        """Names of mover and holder."""
        return self.solids[self.mover[couple]].name, self.solids[self.holder[couple]].name


def collect(motion: Motion, tree: JointTree) -> Couples:
    """Every pair whose two members can move against each other, less the ignored ones.

    The links of ``motion.mechanism_links`` are checked against the robot's links only, those that stand still included.
    """
    solids = _solids(motion)
    n_bodies = len(motion.robot.bodies)
    known: dict[tuple[int, int], Chain] = {}

    def chain_of(holder_joint: int, mover: int) -> Chain:
        """One chain for all pairs of a mover and a frame, so that its bounds are computed once."""
        if (holder_joint, mover) not in known:
            known[holder_joint, mover] = tree.chain(holder_joint, solids[mover].joint, solids[mover].vertices)
        return known[holder_joint, mover]

    movers: list[int] = []
    holders: list[int] = []
    chains: list[Chain] = []
    for i in range(n_bodies):
        if solids[i].joint == 0 or solids[i].link in motion.mechanism_links:
            continue
        world = chain_of(0, i)
        movers += [i] * (len(solids) - n_bodies)
        holders += range(n_bodies, len(solids))
        chains += [world] * (len(solids) - n_bodies)
    for i in range(n_bodies):
        for j in range(i + 1, n_bodies):
            if not _is_checked(motion, solids[i], solids[j]):
                continue
            forward, backward = chain_of(solids[j].joint, i), chain_of(solids[i].joint, j)
            mover, holder, chain = (i, j, forward) if _weight(forward) <= _weight(backward) else (j, i, backward)
            movers.append(mover)
            holders.append(holder)
            chains.append(chain)
    mover_rows, holder_rows = np.array(movers, dtype=int), np.array(holders, dtype=int)
    phases = [_allowed(phase.allowances, solids, mover_rows, holder_rows) for phase in motion.phases]
    allowed = np.stack(phases, axis=1) if phases else np.full((len(movers), 1), np.nan)
    return Couples(tuple(solids), n_bodies, mover_rows, holder_rows, tuple(chains), allowed)


def _solids(motion: Motion) -> list[Solid]:
    bodies = [
        Solid(
            body.name, body.link, body.joint, body.vertices, body.vertices if len(body.vertices) <= 32 else body.outer
        )
        for body in motion.robot.bodies
    ]
    pieces = [
        Solid(piece.name, "", 0, piece.vertices, extreme_points(piece.vertices, 32)) for piece in motion.scene.pieces
    ]
    return bodies + pieces


def _is_checked(motion: Motion, a: Solid, b: Solid) -> bool:
    if (
        a.joint == b.joint
        or a.link == b.link
        or (min(a.link, b.link), max(a.link, b.link)) in motion.robot.ignored_pairs
    ):
        return False
    return not (a.link in motion.mechanism_links and b.link in motion.mechanism_links)


def _weight(chain: Chain) -> float:
    """The rotation bound for equal rates, to choose in whose frame a pair is swept."""
    turning = chain.is_revolute.astype(float)
    return float((chain.reach * (2.0 * np.cumsum(turning) - turning)).sum())


def _allowed(
    allowances: Sequence[Allowance], solids: Sequence[Solid], mover: Int[np.ndarray, "C"], holder: Int[np.ndarray, "C"]
) -> Float[np.ndarray, "C"]:
    """Greatest allowed depth per pair, NaN without an allowance."""
    depth = np.full(len(mover), np.nan)
    for allowance in allowances:
        link = np.array([allowance.names_link(solid.name, solid.link) for solid in solids], dtype=bool)
        other = np.array([allowance.names_other(solid.name, solid.link) for solid in solids], dtype=bool)
        covered = (link[mover] & other[holder]) | (link[holder] & other[mover])
        depth[covered] = np.fmax(depth[covered], allowance.depth)
    return depth
