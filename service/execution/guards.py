"""Guards of an execution: forces that a phase expects, caps and thresholds at which it is aborted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from service.errors import ExecutionError
from service.execution.reference import ReferencePhase


class Severity(Enum):
    """What a finding means for the execution."""

    NOTE = "note"  # reported only
    WAIT = "wait"  # the next phase may not begin
    ABORT = "abort"
    STOP = "stop"  # the robot falls: no way back


@dataclass(frozen=True)
class Finding:
    """One thing that a guard found.

    Attributes:
        severity: what follows.
        link: the foot or the hand.
        force_n: measured force [N].
        limit_n: the limit that it is compared with [N].
        sentence: for the operator.
        is_lost: whether the link should be planted and is not.
    """

    severity: Severity
    link: str
    force_n: float
    limit_n: float
    sentence: str
    is_lost: bool = False


@dataclass(frozen=True)
class GuardSettings:
    """Limits of the guards.

    Attributes:
        touch_n: upright force at which a foot counts as put down [N].
        lost_share: a foot counts as lost below this share of the upright force that the plan expects of it.
        lost_n: feet that the plan expects less of are not compared [N].
        hold_s: time for which a limit must be exceeded [s].
        fall_rad: angle between the pelvis and that of the plan at which the robot falls [rad].
    """

    touch_n: float = 25.0
    lost_share: float = 0.05
    lost_n: float = 400.0
    hold_s: float = 0.25
    fall_rad: float = 0.35

    def __post_init__(self) -> None:
        if not (self.touch_n > 0.0 and 0.0 <= self.lost_share < 1.0 and self.lost_n > 0.0 and self.hold_s >= 0.0):
            raise ExecutionError(
                f"guards: touch_n {self.touch_n:g}, lost_share {self.lost_share:g}, lost_n {self.lost_n:g}, hold_s "
                f"{self.hold_s:g}; expected positive forces, a share below 1 and a time of 0 or more"
            )


@dataclass(frozen=True)
class Guards:
    """Guards with the time for which each limit has been exceeded.

    Attributes:
        settings: limits.
        exceeded_s: by link and limit [s].
    """

    settings: GuardSettings = field(default_factory=GuardSettings)
    exceeded_s: Mapping[tuple[str, str], float] = field(default_factory=dict)

    def check(
        self,
        phase: ReferencePhase,
        following: ReferencePhase | None,
        upright: Mapping[str, float],
        hands: Mapping[str, float],
        expected: Mapping[str, float],
        period_s: float,
    ) -> tuple[tuple[Finding, ...], Guards]:
        """Return what is wrong in this cycle, and the guards of the next one.

        Args:
            phase, following: the present phase and the next one, if any.
            upright: measured upright force per foot [N]; links without a sensor are missing and not guarded.
            hands: measured size of the force per tool that presses on a mechanism [N].
            expected: upright force that the plan expects per link [N].
            period_s: of the cycle [s].
        """
        limits = self.settings
        over: dict[tuple[str, str], Finding] = {}
        planted = {contact.link for contact in phase.contacts}
        for contact in phase.contacts:
            if contact.link not in upright:
                continue
            force, cap = upright[contact.link], contact.force_cap_n * len(contact.sole)
            wanted = expected.get(contact.link, 0.0)
            if force > cap:
                words = f"{contact.link} carries {force:.0f} N in '{phase.name}', its cap is {cap:.0f} N"
                over[contact.link, "cap"] = Finding(Severity.ABORT, contact.link, force, cap, words)
            if wanted >= limits.lost_n and force < limits.lost_share * wanted:
                least = limits.lost_share * wanted
                words = f"{contact.link} carries {force:.0f} N in '{phase.name}'; the plan expects {wanted:.0f} N"
                over[contact.link, "lost"] = Finding(Severity.ABORT, contact.link, force, least, words, True)
        for load in phase.loads:
            force = hands.get(load.tool, 0.0)
            if force > load.abort_n:
                words = (
                    f"{load.tool} presses with {force:.0f} N in '{phase.name}'; expected {load.expected_n:.0f} N, "
                    f"abort at {load.abort_n:.0f} N, cap {load.cap_n:.0f} N"
                )
                over[load.tool, "load"] = Finding(Severity.ABORT, load.tool, force, load.abort_n, words)
        exceeded = {key: self.exceeded_s.get(key, 0.0) + period_s for key in over}
        findings = [finding for key, finding in over.items() if exceeded[key] > limits.hold_s]
        if following is not None:
            for contact in following.contacts:
                if contact.link in planted or contact.link not in upright:
                    continue
                force = upright[contact.link]
                if force < limits.touch_n:
                    words = (
                        f"{contact.link} carries {force:.0f} N; '{following.name}' needs it on the ground with "
                        f"{limits.touch_n:.0f} N"
                    )
                    findings.append(Finding(Severity.WAIT, contact.link, force, limits.touch_n, words, True))
        return tuple(findings), replace(self, exceeded_s=exceeded)
