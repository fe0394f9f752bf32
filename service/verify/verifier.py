"""The verifier: a motion goes in, a certificate comes out."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from service.verify.admission import admit
from service.verify.beginning import rests_on_floor, start_checks
from service.verify.broad import clearance_floors, open_stretches
from service.verify.certificate import (
    Basis,
    Certificate,
    Check,
    Exempt,
    Status,
    Stretches,
    Where,
    bodies_hash,
    promises_hash,
    robot_hash,
    scene_hash,
)
from service.verify.chain import JointTree
from service.verify.clearance import ClearanceProof, ClearanceSearch, Meeting, Unproven
from service.verify.couples import Couples, collect
from service.verify.dynamics import dynamics_checks
from service.verify.limits import position_check, timed_checks
from service.verify.motion import Motion, Phase
from service.verify.promises import PhaseChecks
from service.verify.rates import position_range
from service.verify.settings import VerifySettings
from service.verify.timeline import edges_of, phases_of, time_of


def verify(motion: Motion, settings: VerifySettings | None = None) -> Certificate:
    """Prove or refute what the motion promises.

    Clearance, balance, planted feet, targets, position, speed and acceleration limits hold on the whole curve (and,
    with ``motion.samples``, on the exported samples read linearly); ZMP and torques hold at samples.

    Raises:
        VerifyError: when the motion is malformed (phases that leave a gap, an unknown frame, an inconsistent law).
    """
    settings = settings or VerifySettings()
    admit(motion)
    phases = phases_of(motion)
    edges, phase_rows = edges_of(motion, phases)
    tree = joint_tree(motion)
    checks = [position_check(motion)]
    if motion.law is not None:
        checks += timed_checks(motion, motion.law, phases, settings)
    promises = PhaseChecks(motion, tree, edges, settings)
    for phase in phases:
        checks += promises.run(phase)
        if motion.law is not None:
            checks += dynamics_checks(motion, motion.law, phase, settings)
    couples = collect(motion, tree)
    floors = clearance_floors(motion, couples, edges, settings)
    start = open_stretches(couples, edges, phase_rows, floors, settings.clearance_horizon_m)
    proof = ClearanceSearch(motion, couples, settings).run(start)
    smallest, pair = _min_clearance(couples, proof, phases, settings)
    checks += _clearance_checks(motion, couples, proof, phases, smallest, pair)
    checks += start_checks(motion, couples, phases[0], settings)
    balance = [check.value for check in checks if check.name.startswith("balance.")]
    return Certificate(
        _status(checks),
        tuple(checks),
        smallest,
        pair,
        min(balance) if balance else float("nan"),
        _exempt(couples, proof, phases),
        _columns(couples, proof, edges, phase_rows, floors),
        scene_hash(motion.scene),
        bodies_hash(motion.robot),
        robot_hash(motion.robot),
        promises_hash(phases),
        _notes(motion, phases),
    )


def joint_tree(motion: Motion) -> JointTree:
    """The motion's joints with the range that its sliding joints use."""
    low, high = position_range(motion.curve)
    travel = np.maximum(np.abs(low).max(axis=0), np.abs(high).max(axis=0))
    return JointTree(motion.robot.model, travel, 6 if motion.robot.is_floating else 0)


def _min_clearance(
    couples: Couples, proof: ClearanceProof, phases: tuple[Phase, ...], settings: VerifySettings
) -> tuple[float, tuple[str, str] | None]:
    """Smallest proven clearance of pairs that may not touch; the horizon and None when none is nearer."""
    if len(couples.mover) == 0:
        return float("nan"), None
    couple = np.array(proof.couple, dtype=int)
    lower = np.array(proof.distance) - np.array(proof.bound)
    lasts = np.array([phase.last for phase in phases])
    middle = 0.5 * (np.array(proof.first) + np.array(proof.last))
    phase = np.clip(np.searchsorted(lasts, middle), 0, len(phases) - 1)
    lower = np.where(np.isnan(couples.allowed[couple, phase]), lower, np.inf) if len(couple) else lower
    nearest: list[tuple[float, int]] = [(settings.clearance_horizon_m, -1)]
    if len(lower):
        nearest.append((float(lower.min()), int(couple[lower.argmin()])))
    # What resisted counts with its lower bound, what collides with its depth.
    nearest += [(row.lower, row.couple) for row in proof.unproven if np.isnan(row.allowed)]
    nearest += [(m.distance, m.couple) for m in proof.refuted.values() if np.isnan(m.allowed)]
    distance, best = min(nearest)
    return distance, None if best < 0 else couples.names(best)


def _clearance_checks(
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
    worst: dict[int, Unproven] = {}
    for row in proof.unproven:
        if row.couple not in refuted and (row.couple not in worst or row.lower < worst[row.couple].lower):
            worst[row.couple] = row
    for couple, row in worst.items():
        names = couples.names(couple)
        middle = 0.5 * (row.first + row.last)
        limit = 0.0 if np.isnan(row.allowed) else -row.allowed
        text = f"clearance of {names[0]} and {names[1]} not shown: {1e3 * row.lower:.3f} mm at least"
        where = Where(middle, time_of(motion.law, middle), None, names)
        checks.append(Check("clearance", True, row.lower, limit, "m", text, where, Basis.UNPROVEN))
    if not checks:
        shown = "no pair is checked" if np.isnan(smallest) else f"clearance is at least {1e3 * smallest:.1f} mm"
        between = f" ({pair[0]} and {pair[1]})" if pair else ""
        touching = any(
            meeting.distance < 0.0 and not rests_on_floor(motion, couples, couple, phases[phase])
            for (couple, phase), meeting in proof.deepest.items()
        )
        shown += between + (", pairs that may touch aside" if touching else "")
        checks.append(Check("clearance", True, smallest, 0.0, "m", shown, None, Basis.PROOF))
    return checks


def _place(motion: Motion, meeting: Meeting, names: tuple[str, str]) -> Where:
    x, y, z = (float(value) for value in meeting.second)
    return Where(meeting.s, time_of(motion.law, meeting.s), (x, y, z), names)


def _exempt(couples: Couples, proof: ClearanceProof, phases: tuple[Phase, ...]) -> tuple[Exempt, ...]:
    """Pairs allowed to touch that were looked at, per phase."""
    lasts = np.array([phase.last for phase in phases])
    found: dict[tuple[int, int], float] = {}
    rows = zip(proof.couple, proof.first, proof.last, proof.distance, proof.bound, strict=True)
    for couple, first, last, distance, bound in rows:
        phase = int(np.clip(np.searchsorted(lasts, 0.5 * (first + last)), 0, len(phases) - 1))
        if not np.isnan(couples.allowed[couple, phase]):
            found[couple, phase] = min(found.get((couple, phase), np.inf), distance - bound)
    exempt = []
    for (couple, phase), lower in sorted(found.items(), key=lambda item: (item[0][1], item[1])):
        deepest = proof.deepest.get((couple, phase))
        depth = max(0.0, -deepest.distance) if deepest is not None else 0.0
        allowed = float(couples.allowed[couple, phase])
        exempt.append(Exempt(couples.names(couple), phases[phase].name, allowed, depth, max(0.0, -lower)))
    return tuple(exempt)


def _columns(
    couples: Couples,
    proof: ClearanceProof,
    edges: Float[np.ndarray, "E"],
    phase_rows: Int[np.ndarray, "E-1"],
    floors: Float[np.ndarray, "E-1 C"],
) -> Stretches:
    """The proof as columns; distances rounded down and bounds up to 1e-7 m."""
    used, pair = np.unique(np.array(proof.couple, dtype=int), return_inverse=True)
    may_touch = ~np.isnan(couples.allowed[:, phase_rows].T)
    known = np.where(may_touch | (floors < min(proof.nearest, np.inf)), np.inf, floors) if floors.size else floors
    lowest = known.min(axis=1) if floors.size else np.full(len(edges) - 1, np.inf)
    return Stretches(
        tuple(couples.names(int(c)) for c in used),
        tuple(edges.tolist()),
        tuple(np.round(lowest, 7).tolist()),
        tuple(int(p) for p in pair),
        tuple(proof.first),
        tuple(proof.last),
        tuple(np.round(np.floor(np.array(proof.distance) * 1e7) / 1e7, 7).tolist()),
        tuple(np.round(np.ceil(np.array(proof.bound) * 1e7) / 1e7, 7).tolist()),
    )


def _status(checks: list[Check]) -> Status:
    if any(not check.ok for check in checks):
        return Status.VIOLATED
    is_proven = all(check.basis is not Basis.UNPROVEN for check in checks)
    return Status.CERTIFIED if is_proven else Status.FEASIBLE_AT_SAMPLES


def _notes(motion: Motion, phases: tuple[Phase, ...]) -> tuple[str, ...]:
    notes = ["ZMP and joint torques are checked at samples of the timed curve, not proven between them"]
    if motion.law is None:
        notes = ["the motion is untimed: speeds, accelerations and forces were not checked"]
    if motion.samples is None:
        notes.append("the curve itself is certified; no exported samples were given")
    if motion.robot.ignored_pairs:
        notes.append(
            f"{len(motion.robot.ignored_pairs)} pairs of links are not checked against each other: ignored_pairs"
        )
    if motion.robot.is_floating:
        without = [phase.name for phase in phases if phase.support is None]
        notes += [f"balance was not checked in {', '.join(without)}"] if without else []
        given = [phase.name for phase in phases if phase.support is not None and not phase.contacts]
        notes += [f"the support polygon was taken as given in {', '.join(given)}"] if given else []
    return tuple(notes)
