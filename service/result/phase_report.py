"""Status and checks of each phase of a plan, read from its certificate."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from service.verify import Basis, Certificate, Check, Motion, Phase

MISSING = "coverage.missing."
OF_ALL_PHASES = ("limits", "release", "clearance", "start", "coverage")  # beginnings of names of checks
BORDER = 1e-9  # of path parameters that count as the same


class PhaseStatus(Enum):
    """Outcome of one phase."""

    CERTIFIED = "CERTIFIED"  # every check that concerns it is proven, or holds at the samples that the check looks at
    FEASIBLE_AT_SAMPLES = "FEASIBLE_AT_SAMPLES"  # a proof is missing
    VIOLATED = "VIOLATED"
    UNVERIFIED = "UNVERIFIED"  # the motion has no certificate
    NOT_FOUND = "NOT_FOUND"  # the best attempt at a phase without a solution
    NOT_PLANNED = "NOT_PLANNED"  # the task did not get that far


@dataclass(frozen=True)
class PhaseReport:
    """One phase of a task in a result.

    Attributes:
        name: of the phase.
        status: its outcome.
        checks: indices of the certificate's checks of this phase, and of those of the whole motion that fail or lack a
            proof in it.
    """

    name: str
    status: PhaseStatus
    checks: tuple[int, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {"name": self.name, "status": self.status.value, "checks": list(self.checks)}


def report_phases(
    motion: Motion | None,
    certificate: Certificate | None,
    unsolved: Collection[str] = (),
    order: Sequence[str] = (),
) -> tuple[PhaseReport, ...]:
    """Report every phase of a plan in the order of execution.

    Args:
        motion: the motion, or None.
        certificate: its certificate, or None.
        unsolved: names of phases in the motion that are the best attempts at steps without a solution.
        order: names of the task's phases as far as they are known; those that are not in the motion were not planned.
    """
    planned = () if motion is None else motion.phases
    reports = [_report(phase, certificate, planned, phase.name in unsolved) for phase in planned]
    known = {report.name for report in reports}
    if not known.isdisjoint(order):
        lead = [report for report in reports if report.name not in order]
        task = {report.name: report for report in reports if report.name in order}
        return (*lead, *(task.get(name, PhaseReport(name, PhaseStatus.NOT_PLANNED)) for name in order))
    return (*reports, *(PhaseReport(name, PhaseStatus.NOT_PLANNED) for name in order))


def _report(phase: Phase, certificate: Certificate | None, planned: Sequence[Phase], is_unsolved: bool) -> PhaseReport:
    if certificate is None:
        return PhaseReport(phase.name, PhaseStatus.NOT_FOUND if is_unsolved else PhaseStatus.UNVERIFIED)
    rows = tuple(_select_checks(phase, certificate, planned))
    if is_unsolved:
        return PhaseReport(phase.name, PhaseStatus.NOT_FOUND, rows)
    checks = [certificate.checks[row] for row in rows]
    if not all(check.ok for check in checks):
        return PhaseReport(phase.name, PhaseStatus.VIOLATED, rows)
    is_open = any(check.basis is Basis.UNPROVEN for check in checks) or _has_gap(phase, certificate)
    return PhaseReport(phase.name, PhaseStatus.FEASIBLE_AT_SAMPLES if is_open else PhaseStatus.CERTIFIED, rows)


def _select_checks(phase: Phase, certificate: Certificate, planned: Sequence[Phase]) -> Iterator[int]:
    """Yield the indices of the checks that concern a phase.

    A clearance counts where it fails. Of another check of the whole motion only the worst place is known, so that it
    counts in every phase when it fails or lacks a proof.
    """
    names = [other.name for other in planned]
    for index, check in enumerate(certificate.checks):
        owner = find_phase(check.name, names)
        if owner is not None:
            if owner == phase.name:
                yield index
        elif (not check.ok or check.basis is Basis.UNPROVEN) and (check.name != "clearance" or _is_in(check, phase)):
            yield index


def find_phase(check: str, phases: Sequence[str]) -> str | None:
    """Return the phase that a check is named after (``planted.turn.l_foot``); None for one of the whole motion."""
    kind, _, rest = check.removeprefix(MISSING).partition(".")
    if kind in OF_ALL_PHASES:
        return None
    owners = [name for name in phases if rest == name or rest.startswith(f"{name}.")]
    return max(owners, key=len, default=None)


def _is_in(check: Check, phase: Phase) -> bool:
    where = check.where
    return where is None or phase.first - BORDER <= where.s <= phase.last + BORDER


def _has_gap(phase: Phase, certificate: Certificate) -> bool:
    """Return whether the clearance proof leaves a pair open on a part of the phase."""
    gaps = certificate.gaps
    return any(
        first < phase.last - BORDER and last > phase.first + BORDER
        for first, last in zip(gaps.first, gaps.last, strict=True)
    )
