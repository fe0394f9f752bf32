"""The verifier: a motion goes in, a certificate comes out."""

from __future__ import annotations

from collections.abc import Callable

from costs.stopping import never, stops_when
from service.verify.admission import admit
from service.verify.certificate import (
    Basis,
    Certificate,
    Check,
    Status,
    bodies_hash,
    promises_hash,
    robot_hash,
    scene_hash,
)
from service.verify.clearance import clearance_of
from service.verify.coverage import Coverage
from service.verify.covering import cover
from service.verify.duties import own_joints
from service.verify.dynamics import dynamics_checks
from service.verify.ground import ground_checks
from service.verify.limits import check_law, position_check, timed_checks
from service.verify.motion import Motion, Phase
from service.verify.promises import PhaseChecks
from service.verify.settings import VerifySettings
from service.verify.timeline import edges_of, phases_of
from service.verify.track import Track


def verify(
    motion: Motion, settings: VerifySettings | None = None, should_stop: Callable[[], bool] = never
) -> Certificate:
    """Prove or refute what the motion promises.

    Clearance, balance, planted feet, targets, position, speed and acceleration limits hold on the whole curve (and,
    with ``motion.samples``, on the exported samples read linearly); ZMP and torques hold at samples.

    Args:
        motion: the motion.
        settings: of the proofs.
        should_stop: asked at least every 100 ms, besides whatever surrounds the call (``costs.stopping``).

    Raises:
        VerifyError: when the motion is malformed (phases that leave a gap, an unknown frame, an inconsistent law).
        Stopped: it was asked to stop; there is no certificate.
    """
    with stops_when(should_stop):
        return _verify(motion, settings or VerifySettings())


def _verify(motion: Motion, settings: VerifySettings) -> Certificate:
    admit(motion)
    if motion.law is not None:
        check_law(motion.curve, motion.law)
    phases = phases_of(motion)
    track = Track(motion)
    checks = [position_check(track)]
    if motion.law is not None:
        checks += timed_checks(motion, motion.law, phases, settings)
    promises = PhaseChecks(track, edges_of(motion, phases)[0], settings)
    for phase in phases:
        checks += promises.run(phase)
        checks += ground_checks(motion, phase)
        if motion.law is not None:
            checks += dynamics_checks(motion, motion.law, phase, settings)
    clearance = clearance_of(track, phases, settings)
    checks += clearance.checks
    coverage, against = cover(track, clearance.couples, phases, checks, settings)
    checks += against
    balance = [check.value for check in checks if check.name.startswith("balance.")]
    return Certificate(
        _status(checks),
        tuple(checks),
        clearance.smallest,
        clearance.pair,
        min(balance) if balance else float("nan"),
        clearance.exempt,
        clearance.stretches,
        scene_hash(motion.scene),
        bodies_hash(motion.robot),
        robot_hash(motion.robot),
        promises_hash(phases),
        _notes(motion, phases, coverage),
        gaps=clearance.gaps,
        coverage=coverage,
    )


def _status(checks: list[Check]) -> Status:
    if any(not check.ok for check in checks):
        return Status.VIOLATED
    is_proven = all(check.basis is not Basis.UNPROVEN for check in checks)
    return Status.CERTIFIED if is_proven else Status.FEASIBLE_AT_SAMPLES


def _notes(motion: Motion, phases: tuple[Phase, ...], coverage: Coverage) -> tuple[str, ...]:
    notes = ["ZMP and joint torques are checked at samples of the timed curve, not proven between them"]
    if motion.law is None:
        notes = []
    if motion.samples is None:
        notes.append("the curve itself is certified; no exported samples were given")
    unlimited, n_joints = coverage.joints_without_torque_limit, len(own_joints(motion))
    if motion.law is not None and 0 < len(unlimited) < n_joints:
        notes.append(f"torque not checked for {', '.join(unlimited)}: their limit is 0 or missing")
    if motion.robot.is_floating:
        given = [phase.name for phase in phases if phase.support is not None and not phase.contacts]
        notes += [f"the support polygon was taken as given in {', '.join(given)}"] if given else []
    return (*notes, *coverage.sentences())
