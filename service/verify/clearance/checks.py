"""Checks of the clearance along the motion, the columns of its proof, its gaps, and overlaps at the start."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np
from jaxtyping import Float

from service.verify.certificate import Basis, Check, Exempt, Gaps, Stretches, Where
from service.verify.clearance.pairs import PairTable, collect_pairs
from service.verify.clearance.search import ClearanceBounds, Examination, examine_pairs
from service.verify.motion import Phase, VerifySettings
from service.verify.prepared_motion import PreparedMotion
from service.verify.rounding import round_down
from service.verify.solids import DistanceQuery
from service.verify.timeline import find_time

FLOOR_KIND = "floor"


@dataclass(frozen=True)
class Clearance:
    """Clearance of all pairs along the motion.

    Attributes:
        checks: one per refuted and per unproven pair, or the summary when there is none; and overlaps at the start.
        smallest: proven lower bound for pairs that may not touch, up to the horizon [m]; NaN without pairs.
        pair: the pair that has it, or None when all are beyond the horizon.
        exempt: pairs allowed to touch that came near enough to matter.
        stretches: the proof.
        gaps: intervals on which it leaves a pair open.
        tables: the pairs of bodies that were examined, one for each set of carriers of the motion's objects.
        touching: links left out that are not shown to keep apart: deepest sampled overlap [m], and where.
    """

    checks: tuple[Check, ...]
    smallest: float
    pair: tuple[str, str] | None
    exempt: tuple[Exempt, ...]
    stretches: Stretches
    gaps: Gaps
    tables: tuple[PairTable, ...]
    touching: Mapping[tuple[str, str], tuple[float, float]]


@dataclass(frozen=True)
class _Stretch:
    """Clearance of all pairs while nothing changes its carrier.

    Attributes:
        prepared: the motion with its objects as they are carried.
        examined: the checked pairs on these intervals.
        touching: of the links left out, those that are not shown to keep apart.
        lowest: (I,) smallest floor of the pairs that the search did not examine [m].
    """

    prepared: PreparedMotion
    examined: Examination
    touching: Mapping[tuple[str, str], tuple[float, float]]
    lowest: Float[np.ndarray, "I"]


def prove_clearance(
    prepared: PreparedMotion, settings: VerifySettings, left_out: Collection[tuple[str, str]]
) -> Clearance:
    """Prove or refute that every pair keeps clear, or within its allowed depth, along the whole motion.

    Args:
        prepared: the motion.
        settings: of the proof.
        left_out: names of two links each, in order, of which only whether they keep apart is asked.
    """
    parts = list(_examine_parts(prepared, settings, left_out))
    smallest, pair = min(
        (_min_clearance(part.examined, part.lowest, settings) for part in parts),
        key=lambda found: np.nan_to_num(found[0], nan=np.inf),
    )
    checks = [check for part in parts for check in _refuted_checks(part.prepared, part.examined)]
    checks += [check for part in parts for check in _unproven_checks(part.prepared, part.examined)]
    if not checks:
        checks = [_summary_check(parts, smallest, pair)]
    checks += check_start(parts[0].prepared, parts[0].examined.table, settings)
    return Clearance(
        tuple(checks),
        smallest,
        pair,
        tuple(exempt for part in parts for exempt in _list_exempt(part.examined, prepared.phases)),
        _join_columns([_proof_columns(part.examined, part.lowest) for part in parts]),
        _join_gaps([list_gaps(part.examined) for part in parts]),
        tuple(part.examined.table for part in parts),
        _join_touching([part.touching for part in parts]),
    )


def _join_touching(
    parts: Sequence[Mapping[tuple[str, str], tuple[float, float]]],
) -> Mapping[tuple[str, str], tuple[float, float]]:
    """Return the deepest overlap of each pair of links in all parts, and where."""
    touching: dict[tuple[str, str], tuple[float, float]] = {}
    for part in parts:
        for links, overlap in part.items():
            touching[links] = max(touching.get(links, overlap), overlap, key=lambda found: found[0])
    return touching


def _examine_parts(
    prepared: PreparedMotion, settings: VerifySettings, left_out: Collection[tuple[str, str]]
) -> Iterator[_Stretch]:
    """Yield the parts of the motion between changes of carriers."""
    placed = [prepared.in_phase(phase) for phase in prepared.phases]
    begins = [k for k, own in enumerate(placed) if k == 0 or own.motion is not placed[k - 1].motion]
    for first, last in pairwise([*begins, len(placed)]):
        rows = np.flatnonzero((prepared.edge_phase >= first) & (prepared.edge_phase < last))
        own = placed[first]
        edges = prepared.edges[rows[0] : rows[-1] + 2]
        table = collect_pairs(own.motion, own.tree).with_left_out(left_out)
        every = examine_pairs(own, table, edges, prepared.edge_phase[rows], settings)
        examined = every.without_left_out()
        yield _Stretch(own, examined, every.list_touching(), _lowest_floors(examined))


def _join_columns(parts: Sequence[Stretches]) -> Stretches:
    """Return the proofs of parts of a motion as one; neighbouring parts share an edge."""
    if len(parts) == 1:
        return parts[0]
    starts = np.cumsum([0, *(len(part.pairs) for part in parts)]).tolist()
    return Stretches(
        tuple(chain.from_iterable(part.pairs for part in parts)),
        (*chain.from_iterable(part.edges[:-1] for part in parts), parts[-1].edges[-1]),
        tuple(chain.from_iterable(part.floors for part in parts)),
        tuple(start + pair for start, part in zip(starts, parts, strict=False) for pair in part.pair),
        *(
            tuple(chain.from_iterable(getattr(part, name) for part in parts))
            for name in ("first", "last", "distance", "bound")
        ),
    )


def _join_gaps(parts: Sequence[Gaps]) -> Gaps:
    """Return the gaps of parts of a motion as one."""
    starts = np.cumsum([0, *(len(part.pairs) for part in parts)]).tolist()
    return Gaps(
        tuple(chain.from_iterable(part.pairs for part in parts)),
        tuple(start + pair for start, part in zip(starts, parts, strict=False) for pair in part.pair),
        *(tuple(chain.from_iterable(getattr(part, name) for part in parts)) for name in ("first", "last", "lower")),
    )


def _lowest_floors(examined: Examination) -> Float[np.ndarray, "E-1"]:
    """Smallest floor on each interval of the broad phase, of the pairs that the search did not examine there [m]."""
    table, left = examined.table, examined.proof.examined
    unseen = np.where(np.isnan(table.allowed[:, examined.phase_rows].T), examined.floors, np.inf)
    unseen[np.searchsorted(examined.edges, left.first), left.pair] = np.inf
    return np.asarray(unseen.min(axis=1, initial=np.inf))


def _min_clearance(
    examined: Examination, lowest: Float[np.ndarray, "I"], settings: VerifySettings
) -> tuple[float, tuple[str, str] | None]:
    """Smallest proven clearance of pairs that may not touch; the horizon and None when none is nearer."""
    table, proof = examined.table, examined.proof
    if len(table.mover) == 0:
        return float("nan"), None
    # An unproven interval counts with its lower bound, a collision with its depth.
    nearest: list[tuple[float, int]] = [(float(lowest.min(initial=settings.clearance_horizon_m)), -1)]
    for bounds in (proof.proven, proof.unproven):
        lower = np.where(np.isnan(table.allowed[bounds.pair, bounds.phase]), bounds.lower, np.inf)
        if len(lower):
            nearest.append((float(lower.min()), int(bounds.pair[lower.argmin()])))
    nearest += [(sample.distance, sample.pair) for sample in proof.refuted.values() if np.isnan(sample.allowed)]
    distance, best = min(nearest)
    return distance, None if best < 0 else table.names(best)


def _refuted_checks(prepared: PreparedMotion, examined: Examination) -> Iterator[Check]:
    """Make one failed check per refuted pair and phase, the deepest first."""
    for sample in sorted(examined.proof.refuted.values(), key=lambda sample: sample.distance):
        names = examined.table.names(sample.pair)
        limit = sample.need
        text = f"{names[0]} penetrates {names[1]} by {-1e3 * sample.distance:.1f} mm"
        if sample.distance >= 0.0:
            text = f"{names[0]} is {1e3 * sample.distance:.1f} mm from {names[1]}, {1e3 * limit:g} mm are demanded"
        x, y, z = (float(value) for value in sample.position)
        where = Where(sample.s, find_time(prepared.motion.law, sample.s), (x, y, z), names)
        yield Check("clearance", False, sample.distance, limit, "m", text, where, Basis.SAMPLES)


def _unproven_checks(prepared: PreparedMotion, examined: Examination) -> Iterator[Check]:
    """Make one unproven check per pair that is open and not refuted, the nearest first."""
    table, unproven = examined.table, examined.proof.unproven
    reported = {pair for pair, _ in examined.proof.refuted}
    lowers = unproven.lower
    for row in np.argsort(lowers, kind="stable").tolist():
        pair = int(unproven.pair[row])
        if pair in reported:
            continue
        reported.add(pair)
        names = table.names(pair)
        lower, middle = float(lowers[row]), float(0.5 * (unproven.first[row] + unproven.last[row]))
        allowed = float(table.allowed[pair, unproven.phase[row]])
        limit = float(table.demanded[pair]) if np.isnan(allowed) else -allowed
        text = f"clearance of {names[0]} and {names[1]} not shown: {round_down(1e3 * lower, 3)} mm at least"
        where = Where(middle, find_time(prepared.motion.law, middle), None, names)
        yield Check("clearance", True, lower, limit, "m", text, where, Basis.UNPROVEN)


def _summary_check(parts: Sequence[_Stretch], smallest: float, names: tuple[str, str] | None) -> Check:
    """Make the check of a motion whose pairs are all proven."""
    text = "no pair is checked" if np.isnan(smallest) else f"clearance is at least {round_down(1e3 * smallest, 1)} mm"
    text += f" ({names[0]} and {names[1]})" if names else ""
    is_touching = any(
        distance < 0.0 and not _rests_on_floor(part.prepared, part.examined.table, pair, part.prepared.phases[phase])
        for part in parts
        for (pair, phase), distance in part.examined.proof.deepest.items()
    )
    motion = parts[0].prepared.motion
    demanded = motion.clearance_m
    text += f", {1e3 * demanded:g} mm from the world as demanded" if demanded else ""
    sway = motion.sway
    if sway:
        text += f", also while the base sways by {1e3 * sway.distance_m:g} mm and {sway.angle_deg:g} deg"
    text += ", the padding of links and obstacles kept" if motion.padding else ""
    text += ", pairs that may touch aside" if is_touching else ""
    return Check("clearance", True, smallest, 0.0, "m", text, None, Basis.PROOF)


def check_start(prepared: PreparedMotion, table: PairTable, settings: VerifySettings) -> Iterator[Check]:
    """Check each pair that overlaps at the first pose and that the first phase allows to touch.

    Not listed are planted links that rest on the floor, and overlaps of a mechanism with itself or with its
    surroundings (a leaf in its frame), in which the robot has no part; the clearance proof bounds their depth.
    """
    s, phase = float(prepared.motion.curve.knots[0]), prepared.phases[0]
    placed, row = prepared.at(np.array([s]))
    query = DistanceQuery()
    for pair in np.flatnonzero(~np.isnan(table.allowed[:, 0])).tolist():
        if _rests_on_floor(prepared, table, pair, phase) or not _has_own_link(prepared, table, pair):
            continue
        mover, holder = table.solids[table.mover[pair]], table.solids[table.holder[pair]]
        distances, _ = query.closest([mover.convex], *placed.relative(holder.joint, mover.joint, row), [holder.convex])
        distance = float(distances[0])
        if distance >= -settings.contact_tolerance_m:
            continue
        allowed = float(table.allowed[pair, 0])
        names = table.names(pair)
        text = (
            f"starts in collision: {names[0]} is {-1e3 * distance:.1f} mm inside {names[1]}, "
            f"which '{phase.name}' allows down to {1e3 * allowed:.1f} mm"
        )
        is_ok = distance >= -allowed - settings.contact_tolerance_m
        where = Where(s, find_time(prepared.motion.law, s), None, names)
        yield Check(f"start.{names[0]}.{names[1]}", is_ok, distance, -allowed, "m", text, where, Basis.SAMPLES)


def _has_own_link(prepared: PreparedMotion, table: PairTable, pair: int) -> bool:
    """Return whether a member of a pair is a link of the robot itself."""
    members = (int(table.mover[pair]), int(table.holder[pair]))
    moved = prepared.motion.mechanism_links
    return any(member < table.n_bodies and table.solids[member].link not in moved for member in members)


def _rests_on_floor(prepared: PreparedMotion, table: PairTable, pair: int, phase: Phase) -> bool:
    """Return whether a pair is a planted link and a floor."""
    mover, piece = table.mover[pair], int(table.holder[pair]) - table.n_bodies
    planted = {contact.link for contact in phase.contacts}
    is_floor = piece >= 0 and prepared.motion.scene.pieces[piece].kind == FLOOR_KIND
    return is_floor and table.solids[mover].link in planted


def _list_exempt(examined: Examination, phases: tuple[Phase, ...]) -> tuple[Exempt, ...]:
    """List pairs allowed to touch that the search examined, per phase."""
    table, proof = examined.table, examined.proof
    proven, lowest = proof.proven, dict[tuple[int, int], float]()
    lowers = proven.lower
    for row in np.flatnonzero(~np.isnan(table.allowed[proven.pair, proven.phase])).tolist():
        key = int(proven.phase[row]), int(proven.pair[row])
        lowest[key] = min(lowest.get(key, np.inf), float(lowers[row]))
    exempt = []
    for (phase, pair), lower in sorted(lowest.items()):
        depth = max(0.0, -proof.deepest.get((pair, phase), 0.0))
        allowed = float(table.allowed[pair, phase])
        exempt.append(Exempt(table.names(pair), phases[phase].name, allowed, depth, max(0.0, -lower)))
    return tuple(exempt)


def _proof_columns(examined: Examination, lowest: Float[np.ndarray, "E-1"]) -> Stretches:
    """Return the proof as columns; distances rounded down and bounds up to 1e-7 m."""
    proven = examined.proof.proven
    used, pair = np.unique(proven.pair, return_inverse=True)
    return Stretches(
        tuple(examined.table.names(int(index)) for index in used),
        tuple(examined.edges.tolist()),
        tuple((np.floor(lowest * 1e7) / 1e7).tolist()),
        tuple(pair.tolist()),
        tuple(proven.first.tolist()),
        tuple(proven.last.tolist()),
        tuple(np.round(np.floor(proven.distance * 1e7) / 1e7, 7).tolist()),
        tuple(np.round(np.ceil(proven.bound * 1e7) / 1e7, 7).tolist()),
    )


def list_gaps(examined: Examination) -> Gaps:
    """Intervals without a proof as columns, neighbouring ones of a pair as one row."""
    rows = list(_join_neighbours(ClearanceBounds.join([examined.proof.unproven, examined.proof.abandoned])))
    used = sorted({pair for pair, *_ in rows})
    index = {pair: number for number, pair in enumerate(used)}
    return Gaps(
        tuple(examined.table.names(pair) for pair in used),
        tuple(index[pair] for pair, *_ in rows),
        tuple(first for _, first, _, _ in rows),
        tuple(last for _, _, last, _ in rows),
        tuple(np.floor(lower * 1e7) / 1e7 if np.isfinite(lower) else float("nan") for *_, lower in rows),
    )


def _join_neighbours(bounds: ClearanceBounds) -> Iterator[tuple[int, float, float, float]]:
    """Yield pair, first, last and lower bound of the intervals, in order; those that touch are one."""
    order = np.lexsort([bounds.first, bounds.pair])
    current: tuple[int, float, float, float] | None = None
    for row in order.tolist():
        pair, lower = int(bounds.pair[row]), float(bounds.lower[row])
        first, last = float(bounds.first[row]), float(bounds.last[row])
        if current is not None and current[0] == pair and first <= current[2]:
            current = pair, current[1], max(current[2], last), min(current[3], lower)
            continue
        if current is not None:
            yield current
        current = pair, first, last, lower
    if current is not None:
        yield current
