"""Coverage of a verification, and unproven checks for what was left unchecked and rules out a certificate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.verify.certificate import SMALL_LINK_M, Basis, Check, Coverage, Shapeless
from service.verify.clearance.checks import Clearance
from service.verify.clearance.pairs import PairTable
from service.verify.coverage.apart import SurfaceProofs
from service.verify.coverage.left_out import LeftOutPairs, check_overlaps
from service.verify.coverage.pressed import check_pressed
from service.verify.coverage.required import (
    find_joints_without_torque_limit,
    list_required_checks,
    report_missing_checks,
)
from service.verify.coverage.shapeless import find_shapeless_links, list_drawn_links
from service.verify.prepared_motion import PreparedMotion
from service.verify.rounding import round_down


def check_coverage(
    prepared: PreparedMotion, pairs: LeftOutPairs, clearance: Clearance, checks: Sequence[Check]
) -> tuple[Coverage, tuple[Check, ...]]:
    """Return what was checked, an unproven check for everything that rules out a certificate, and pressed parts.

    Args:
        prepared: the motion.
        pairs: of links that are not checked.
        clearance: of the others, and which of these are not shown to keep apart.
        checks: that were made.
    """
    motion, tree = prepared.motion, pairs.tree
    required = list_required_checks(motion, prepared.phases)
    proofs = SurfaceProofs(prepared)
    left_out = pairs.list_left_out(clearance.touching, proofs)
    shapeless = find_shapeless_links(prepared, tree)
    own = [link for link in tree.joint if link not in motion.mechanism_links]
    counts = [_count_pairs(table) for table in clearance.tables]
    n_link_pairs, n_piece_pairs = (max(count[kind] for count in counts) for kind in (0, 1))
    objects = tuple(item.name for item in motion.objects)
    starts_inside = sum(check.name.startswith("start.") for check in checks)
    waived = (*required.waived, *([f"{starts_inside} pairs that overlap at the start"] if starts_inside else []))
    coverage = Coverage(
        (*(link for link in own if link in tree.shaped), *objects),
        tuple(item.link for item in shapeless if item.link not in tree.shaped),
        shapeless,
        n_link_pairs,
        n_piece_pairs,
        left_out,
        find_joints_without_torque_limit(motion),
        waived,
    )
    against = [*report_missing_checks(required, checks), *check_overlaps(left_out), *check_pressed(prepared.phases)]
    drawn = list_drawn_links(prepared) - tree.shaped
    large = [item for item in shapeless if not item.is_small]
    remedy = [item.link for item in large if item.link in drawn]
    against += [
        _size_check(item, item.link in tree.shaped, remedy if item.link in remedy[:1] else ()) for item in large
    ]
    against += [_surfaces_check(proofs)] if proofs.gaps else []
    if n_link_pairs + n_piece_pairs == 0:
        against.append(_no_pair_check(coverage))
    return coverage, tuple(against)


def _count_pairs(table: PairTable) -> tuple[int, int]:
    """Count the pairs of links, and of a link and a piece, of which some bodies were checked."""
    number = {link: k for k, link in enumerate(dict.fromkeys(solid.link for solid in table.solids))}
    link = np.array([number[solid.link] for solid in table.solids], dtype=int)
    is_own = table.holder < table.n_bodies
    first, second = link[table.mover[is_own]], link[table.holder[is_own]]
    links = np.minimum(first, second) * len(number) + np.maximum(first, second)
    pieces = link[table.mover[~is_own]] * len(table.solids) + table.holder[~is_own]
    return len(np.unique(links)), len(np.unique(pieces))


def _surfaces_check(proofs: SurfaceProofs) -> Check:
    """Make the check of pairs whose hulls overlap, while their surfaces are proven to keep apart."""
    gap, (a, b) = min((gap, pair) for pair, gap in proofs.gaps.items())
    n = len(proofs.gaps)
    text = (
        f"the meshes of {n} {'pair' if n == 1 else 'pairs'} of links that are left out keep at least "
        f"{round_down(1e3 * gap, 2)} mm apart, while their hulls overlap ({a} and {b})"
    )
    return Check("coverage.surfaces", True, gap, 0.0, "m", text, None, Basis.PROOF)


def _no_pair_check(coverage: Coverage) -> Check:
    n_shapes = len(coverage.links_with_shape)
    text = f"no pair was checked: {n_shapes} links with a shape, {len(coverage.left_out)} pairs left out, no piece"
    return Check("coverage.pairs", True, 0.0, 1.0, "pairs", text, None, Basis.UNPROVEN)


def _size_check(item: Shapeless, has_token: bool, drawn: Sequence[str]) -> Check:
    """Make the check of a link; ``drawn`` are all links whose drawn shapes may be taken, which the first one names."""
    where = {"between": "between links with shapes", "end": "at an end", "root": "at the root"}[item.place]
    size = "is of unknown size" if np.isnan(item.reach_m) else f"{1e3 * item.reach_m:.0f} mm of it are in no shape"
    lack = "a collision shape far smaller than the link" if has_token else "no collision shape"
    text = f"{item.link} ({where}) has {lack} and {size}; at most {1e3 * SMALL_LINK_M:.0f} mm go unchecked"
    if drawn:
        whose = "its drawn shapes" if len(drawn) == 1 else "their drawn shapes"
        text += f"; robot.drawn_links: [{', '.join(drawn)}] checks {whose}"
    return Check(f"coverage.shape.{item.link}", True, item.reach_m, SMALL_LINK_M, "m", text, None, Basis.UNPROVEN)
