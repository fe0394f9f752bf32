"""The verifier: checks of a motion in sequence, and the certificate made of them.

How to add a check: write a generator of :class:`Check` with the signature of :data:`MotionCheck` or :data:`PhaseCheck`
and append it to ``MOTION_CHECKS`` or ``PHASE_CHECKS`` below.  If no motion may be certified without it, add its name to
``coverage.required.list_required_checks``; if it can be waived, ``Motion.waived`` names the group.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from costs.stopping import never, stops_when
from service.verify.carrying.checks import check_carriers
from service.verify.certificate import Basis, Certificate, Check, Coverage, Status
from service.verify.clearance.checks import prove_clearance
from service.verify.coverage.checks import check_coverage
from service.verify.coverage.left_out import LeftOutPairs
from service.verify.coverage.link_tree import LinkTree
from service.verify.coverage.pressed import note_given
from service.verify.coverage.required import list_own_joints
from service.verify.forces.dynamics import check_dynamics
from service.verify.forces.frame_speeds import check_frame_speeds
from service.verify.forces.hand_contacts import check_hand_contacts
from service.verify.forces.letting_go import check_letting_go
from service.verify.ground import check_ground
from service.verify.hashes import bodies_hash, promises_hash, robot_hash, scene_hash
from service.verify.limits import check_positions, check_timing
from service.verify.mechanism_checks import check_mechanism
from service.verify.motion import Motion, Phase, VerifySettings
from service.verify.prepared_motion import PreparedMotion
from service.verify.rolling import check_rolling
from service.verify.stance_checks import check_stance
from service.verify.targets.checks import check_targets
from service.verify.targets.swaying import check_swayed_reach
from service.verify.validation import validate_motion

MotionCheck = Callable[[PreparedMotion, VerifySettings], Iterable[Check]]
PhaseCheck = Callable[[PreparedMotion, Phase, VerifySettings], Iterable[Check]]

# Checks of the whole motion, then of each phase, in the certificate's order; clearance and coverage follow.
MOTION_CHECKS: tuple[MotionCheck, ...] = (
    check_positions, check_rolling, check_timing, check_frame_speeds, check_mechanism,
)  # fmt: skip
PHASE_CHECKS: tuple[PhaseCheck, ...] = (
    check_stance, check_targets, check_swayed_reach, check_hand_contacts, check_letting_go, check_ground,
    check_dynamics,
)  # fmt: skip


def verify(
    motion: Motion, settings: VerifySettings | None = None, should_stop: Callable[[], bool] = never
) -> Certificate:
    """Prove or refute what the motion promises.

    Clearance, balance, planted feet, targets, release rules, position, speed and acceleration limits hold on the whole
    curve (and, with ``motion.samples``, on the exported samples read linearly); ZMP and torques hold at samples.

    Args:
        should_stop: called at least every 100 ms, besides whatever surrounds the call (``costs.stopping``).

    Raises:
        VerifyError: when the motion is malformed (phases that leave a gap, an unknown frame, an inconsistent law).
        Stopped: ``should_stop`` returned True; there is no certificate.
    """
    with stops_when(should_stop):
        return _verify(motion, settings or VerifySettings())


def _verify(motion: Motion, settings: VerifySettings) -> Certificate:
    validate_motion(motion)
    prepared = PreparedMotion(motion)
    checks = list(_run_checks(prepared, settings))
    left_out = LeftOutPairs.of(prepared, LinkTree(motion.robot))
    clearance = prove_clearance(prepared, settings, left_out.open)
    checks += clearance.checks
    coverage, against = check_coverage(prepared, left_out, clearance, checks)
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
        bodies_hash(prepared.in_phase(prepared.phases[0]).motion.robot),
        robot_hash(motion.robot),
        promises_hash(prepared.phases, motion.releases, objects=motion.objects),
        _notes(prepared, coverage),
        gaps=clearance.gaps,
        coverage=coverage,
        continues_sha256=motion.continues,
    )


def _run_checks(prepared: PreparedMotion, settings: VerifySettings) -> Iterator[Check]:
    for motion_check in MOTION_CHECKS:
        yield from motion_check(prepared, settings)
    for phase in prepared.phases:
        placed = prepared.in_phase(phase)
        for phase_check in PHASE_CHECKS:
            yield from phase_check(placed, phase, settings)
        yield from check_carriers(prepared, phase, settings)


def _status(checks: list[Check]) -> Status:
    if any(not check.ok for check in checks):
        return Status.VIOLATED
    is_proven = all(check.basis is not Basis.UNPROVEN for check in checks)
    return Status.CERTIFIED if is_proven else Status.FEASIBLE_AT_SAMPLES


def _notes(prepared: PreparedMotion, coverage: Coverage) -> tuple[str, ...]:
    motion, notes = prepared.motion, list[str]()
    if motion.law is not None:
        changing = any(phase.region_margin_m is not None for phase in prepared.phases)
        sampled = "contact forces" if changing else "ZMP"
        notes.append(f"{sampled} and joint torques are checked at samples of the timed curve, not proven between them")
    if motion.samples is None:
        notes.append("the curve itself is certified; no exported samples were given")
    unlimited, n_joints = coverage.joints_without_torque_limit, len(list_own_joints(motion))
    if motion.law is not None and 0 < len(unlimited) < n_joints:
        notes.append(f"torque not checked for {', '.join(unlimited)}: their limit is 0 or missing")
    if motion.robot.is_floating:
        assumed = [phase.name for phase in prepared.phases if phase.support is not None and not phase.contacts]
        notes += [f"the support polygon was taken as given in {', '.join(assumed)}"] if assumed else []
    if motion.sway:
        notes.append(
            "something else balances the robot; links that no joint moves, and hands that make up for its sway, "
            "were not held to the scene"
        )
    return (*notes, *note_given(prepared.phases), *coverage.sentences())
