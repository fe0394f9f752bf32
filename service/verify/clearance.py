"""Clearance along the motion: proof, checks, and the columns with which a stranger can replay it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from service.verify.beginning import rests_on_floor, start_checks
from service.verify.broad import clearance_floors, open_stretches, refined
from service.verify.certificate import Basis, Check, Exempt, Stretches, Where
from service.verify.couples import Couples, collect
from service.verify.gaps import Gaps, gaps_of
from service.verify.motion import Motion, Phase
from service.verify.samples import Meeting
from service.verify.search import ClearanceProof, Shown, search
from service.verify.settings import VerifySettings
from service.verify.timeline import edges_of, time_of
from service.verify.track import Track


@dataclass(frozen=True)
class Clearance:
    """What is known of the clearance of all pairs.

    Attributes:
        checks: one per refuted and per unproven pair, or the summary when there is none; and what overlaps at first.
        smallest: proven lower bound for pairs that may not touch, up to the horizon looked at [m]; NaN if none.
        pair: the pair that has it, or None when all are beyond the horizon.
        exempt: pairs allowed to touch that came near enough to matter.
        stretches: the proof.
        gaps: what it leaves open.
        couples: the pairs of bodies that were looked at.
    """

    checks: tuple[Check, ...]
    smallest: float
    pair: tuple[str, str] | None
    exempt: tuple[Exempt, ...]
    stretches: Stretches
    gaps: Gaps
    couples: Couples


def clearance_of(track: Track, phases: tuple[Phase, ...], settings: VerifySettings) -> Clearance:
    """Prove or refute that every pair keeps clear, or within its allowed depth, along the whole motion."""
    couples = collect(track.motion, track.tree)
    edges, phase_rows = refined(track, couples, *edges_of(track.motion, phases))
    floors = clearance_floors(track, couples, edges, settings)
    start = open_stretches(couples, edges, phase_rows, floors, settings.clearance_horizon_m)
    couples = couples.with_chains(track.tree, np.unique(start.couple))
    proof = search(track, couples, start, settings)
    lowest = _lowest_floors(couples, proof, edges, phase_rows, floors)
    smallest, pair = _min_clearance(couples, proof, lowest, settings)
    checks = _checks(track.motion, couples, proof, phases, smallest, pair)
    checks += start_checks(track, couples, phases[0], settings)
    columns = _columns(couples, proof, edges, lowest)
    gaps = gaps_of(couples, Shown.join([proof.unproven, proof.abandoned]))
    return Clearance(tuple(checks), smallest, pair, _exempt(couples, proof, phases), columns, gaps, couples)


def _min_clearance(
    couples: Couples, proof: ClearanceProof, lowest: Float[np.ndarray, "I"], settings: VerifySettings
) -> tuple[float, tuple[str, str] | None]:
    """Smallest proven clearance of pairs that may not touch; the horizon and None when none is nearer."""
    if len(couples.mover) == 0:
        return float("nan"), None
    # What resisted counts with its lower bound, what collides with its depth.
    nearest: list[tuple[float, int]] = [(float(lowest.min(initial=settings.clearance_horizon_m)), -1)]
    for shown in (proof.proven, proof.unproven):
        lower = np.where(np.isnan(couples.allowed[shown.couple, shown.phase]), shown.lower, np.inf)
        if len(lower):
            nearest.append((float(lower.min()), int(shown.couple[lower.argmin()])))
    nearest += [(m.distance, m.couple) for m in proof.refuted.values() if np.isnan(m.allowed)]
    distance, best = min(nearest)
    return distance, None if best < 0 else couples.names(best)


def _checks(
    motion: Motion,
    couples: Couples,
    proof: ClearanceProof,
    phases: tuple[Phase, ...],
    smallest: float,
    pair: tuple[str, str] | None,
) -> list[Check]:
    """One check per refuted pair and phase, one per unproven pair, and the summary when neither exists."""
    checks = []
    for meeting in sorted(proof.refuted.values(), key=lambda meeting: meeting.distance):
        names = couples.names(meeting.couple)
        limit = 0.0 if np.isnan(meeting.allowed) else -meeting.allowed
        text = f"{names[0]} penetrates {names[1]} by {-1e3 * meeting.distance:.1f} mm"
        place = _place(motion, meeting, names)
        checks.append(Check("clearance", False, meeting.distance, limit, "m", text, place, Basis.SAMPLES))
    refuted = {couple for couple, _ in proof.refuted}
    unproven, told = proof.unproven, set(refuted)
    lowers = unproven.lower
    for row in np.argsort(lowers, kind="stable").tolist():
        couple = int(unproven.couple[row])
        if couple in told:
            continue
        told.add(couple)
        names = couples.names(couple)
        lower, middle = float(lowers[row]), float(0.5 * (unproven.first[row] + unproven.last[row]))
        limit = -float(np.nan_to_num(couples.allowed[couple, unproven.phase[row]]))
        text = f"clearance of {names[0]} and {names[1]} not shown: {1e3 * lower:.3f} mm at least"
        where = Where(middle, time_of(motion.law, middle), None, names)
        checks.append(Check("clearance", True, lower, limit, "m", text, where, Basis.UNPROVEN))
    if not checks:
        shown = "no pair is checked" if np.isnan(smallest) else f"clearance is at least {1e3 * smallest:.1f} mm"
        between = f" ({pair[0]} and {pair[1]})" if pair else ""
        touching = any(
            distance < 0.0 and not rests_on_floor(motion, couples, couple, phases[phase])
            for (couple, phase), distance in proof.deepest.items()
        )
        shown += between + (", pairs that may touch aside" if touching else "")
        checks.append(Check("clearance", True, smallest, 0.0, "m", shown, None, Basis.PROOF))
    return checks


def _place(motion: Motion, meeting: Meeting, names: tuple[str, str]) -> Where:
    x, y, z = (float(value) for value in meeting.position)
    return Where(meeting.s, time_of(motion.law, meeting.s), (x, y, z), names)


def _exempt(couples: Couples, proof: ClearanceProof, phases: tuple[Phase, ...]) -> tuple[Exempt, ...]:
    """Pairs allowed to touch that were looked at, per phase."""
    proven, found = proof.proven, dict[tuple[int, int], float]()
    lowers = proven.lower
    for row in np.flatnonzero(~np.isnan(couples.allowed[proven.couple, proven.phase])).tolist():
        key = int(proven.phase[row]), int(proven.couple[row])
        found[key] = min(found.get(key, np.inf), float(lowers[row]))
    exempt = []
    for (phase, couple), lower in sorted(found.items()):
        depth = max(0.0, -proof.deepest.get((couple, phase), 0.0))
        allowed = float(couples.allowed[couple, phase])
        exempt.append(Exempt(couples.names(couple), phases[phase].name, allowed, depth, max(0.0, -lower)))
    return tuple(exempt)


def _lowest_floors(
    couples: Couples,
    proof: ClearanceProof,
    edges: Float[np.ndarray, "E"],
    phase_rows: Int[np.ndarray, "E-1"],
    floors: Float[np.ndarray, "E-1 C"],
) -> Float[np.ndarray, "E-1"]:
    """On each stretch of the broad phase, the smallest floor of the pairs that were not looked at there [m]."""
    unseen = np.where(np.isnan(couples.allowed[:, phase_rows].T), floors, np.inf)
    unseen[np.searchsorted(edges, proof.looked.first), proof.looked.couple] = np.inf
    return np.asarray(unseen.min(axis=1, initial=np.inf))


def _columns(
    couples: Couples, proof: ClearanceProof, edges: Float[np.ndarray, "E"], lowest: Float[np.ndarray, "E-1"]
) -> Stretches:
    """The proof as columns; distances rounded down and bounds up to 1e-7 m."""
    proven = proof.proven
    used, pair = np.unique(proven.couple, return_inverse=True)
    return Stretches(
        tuple(couples.names(int(c)) for c in used),
        tuple(edges.tolist()),
        tuple((np.floor(lowest * 1e7) / 1e7).tolist()),
        tuple(pair.tolist()),
        tuple(proven.first.tolist()),
        tuple(proven.last.tolist()),
        tuple(np.round(np.floor(proven.distance * 1e7) / 1e7, 7).tolist()),
        tuple(np.round(np.ceil(proven.bound * 1e7) / 1e7, 7).tolist()),
    )
