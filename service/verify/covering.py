"""What of a motion was checked, and what keeps it from being certified because it was not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from service.verify.certificate import Basis, Check
from service.verify.couples import Couples
from service.verify.coverage import SMALL_M, Coverage, Shapeless
from service.verify.duties import duties_of, joints_without_torque_limit, missing_checks
from service.verify.left_out import left_out_pairs, overlap_checks
from service.verify.link_tree import LinkTree
from service.verify.motion import Phase
from service.verify.settings import VerifySettings
from service.verify.shapeless import shapeless_links
from service.verify.track import Track


def cover(
    track: Track, couples: Couples, phases: Sequence[Phase], checks: Sequence[Check], settings: VerifySettings
) -> tuple[Coverage, tuple[Check, ...]]:
    """What was checked, and an unproven check for everything that stands against a certificate.

    Args:
        track: the motion.
        couples: the pairs of bodies whose clearance was looked at.
        phases: of the motion.
        checks: that were made.
        settings: how closely left out pairs are looked at.
    """
    motion = track.motion
    tree = LinkTree(motion.robot)
    duties = duties_of(motion, phases)
    left_out = left_out_pairs(track, tree, phases, settings)
    shapeless = shapeless_links(track, tree)
    own = [link for link in tree.joint if link not in motion.mechanism_links]
    n_link_pairs, n_piece_pairs = _counts(couples)
    starts_inside = sum(check.name.startswith("start.") for check in checks)
    waived = (*duties.waived, *([f"{starts_inside} pairs that overlap at the start"] if starts_inside else []))
    coverage = Coverage(
        tuple(link for link in own if link in tree.shaped),
        tuple(one.link for one in shapeless),
        shapeless,
        n_link_pairs,
        n_piece_pairs,
        left_out,
        joints_without_torque_limit(motion),
        waived,
    )
    against = [*missing_checks(duties, checks), *overlap_checks(left_out)]
    against += [_too_large(one) for one in shapeless if not one.is_small]
    if n_link_pairs + n_piece_pairs == 0:
        against += _nothing_checked(coverage)
    return coverage, tuple(against)


def _counts(couples: Couples) -> tuple[int, int]:
    """Pairs of links, and of a link and a piece, of which some bodies were checked."""
    solids, links, pieces = couples.solids, set(), set()
    for mover, holder in np.stack([couples.mover, couples.holder], axis=1).tolist():
        if holder < couples.n_bodies:
            links.add(frozenset((solids[mover].link, solids[holder].link)))
        else:
            pieces.add((solids[mover].link, holder))
    return len(links), len(pieces)


def _nothing_checked(coverage: Coverage) -> Iterator[Check]:
    n_shapes = len(coverage.links_with_shape)
    text = f"no pair was checked: {n_shapes} links with a shape, {len(coverage.left_out)} pairs left out, no piece"
    yield Check("coverage.pairs", True, 0.0, 1.0, "pairs", text, None, Basis.UNPROVEN)


def _too_large(one: Shapeless) -> Check:
    where = {"between": "between links with shapes", "end": "at an end", "root": "at the root"}[one.place]
    size = "is of unknown size" if np.isnan(one.reach_m) else f"{1e3 * one.reach_m:.0f} mm of it are in no shape"
    text = f"{one.link} ({where}) has no collision shape and {size}; at most {1e3 * SMALL_M:.0f} mm go unchecked"
    return Check(f"coverage.shape.{one.link}", True, one.reach_m, SMALL_M, "m", text, None, Basis.UNPROVEN)
