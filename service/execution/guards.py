"""Guards of an execution: forces that a phase expects, caps and thresholds at which it is aborted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from jaxtyping import Float

from service.errors import ExecutionError
from service.execution.reference import ReferencePhase
from service.verify import PlantedContact

TREND_S = 0.03  # over which the growth of a force is measured [s]


class Severity(Enum):
    """What a finding means for the execution."""

    NOTE = "note"  # reported only
    SLOW = "slow"  # the plan's clock goes slowly as long as it is found
    WAIT = "wait"  # the next phase may not begin
    ABORT = "abort"  # back to the last pose in balance
    HOLD = "hold"  # the robot stays where it is: no way back can be trusted
    STOP = "stop"  # the robot falls: no way back


@dataclass(frozen=True)
class Finding:
    """One thing that a guard found.

    Attributes:
        severity: what follows.
        link: the foot or the hand, or the joint or sensor.
        value: measured force [N]; of joints their torque or angle [N m, rad], of times seconds.
        limit: the limit that it is compared with, in the same unit.
        sentence: for the operator.
        is_lost: whether the link should be planted and is not.
        is_load: whether it is a hand that presses too hard on what it moves.
        name: kind of fault, by which reports count; ``force`` of a measured force.
    """

    severity: Severity
    link: str
    value: float
    limit: float
    sentence: str
    is_lost: bool = False
    is_load: bool = False
    name: str = "force"


@dataclass(frozen=True)
class GuardSettings:
    """Limits of the guards.

    Attributes:
        touch_n: upright force at which a foot counts as put down [N].
        hand_touch_n: the same of any other link, along the normal of what it is put on [N].
        cap_share: of the cap of a planted link, at which it aborts; plans use caps fully.
        load_share: where between expected force and cap a hand's force aborts.
        lost_share: a foot counts as lost below this share of the upright force that the plan expects of it.
        lost_n: feet that the plan expects less of are not compared [N].
        hold_s: time for which a limit must be exceeded [s].
        stop_s: in which a hand that is stopped still presses on; a force that grows to its cap in that time aborts
            at once [s].
        fall_rad: angle between the pelvis and that of the plan at which the robot falls [rad].
    """

    touch_n: float = 25.0
    hand_touch_n: float = 5.0
    cap_share: float = 1.5
    load_share: float = 0.5
    lost_share: float = 0.05
    lost_n: float = 400.0
    hold_s: float = 0.25
    stop_s: float = 0.2
    fall_rad: float = 0.35

    def __post_init__(self) -> None:
        if not 0.0 <= self.load_share <= 1.0 or not self.cap_share > 0.0:
            raise ExecutionError(
                f"guards: load_share {self.load_share:g}, cap_share {self.cap_share:g}; expected 0 to 1, and above 0"
            )
        if not (
            min(self.touch_n, self.hand_touch_n) > 0.0
            and 0.0 <= self.lost_share < 1.0
            and self.lost_n > 0.0
            and min(self.hold_s, self.stop_s) >= 0.0
        ):
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
        slow: filtered force by tool, from which follows how fast it grows [N].
    """

    settings: GuardSettings = field(default_factory=GuardSettings)
    exceeded_s: Mapping[tuple[str, str], float] = field(default_factory=dict)
    slow: Mapping[str, float] = field(default_factory=dict)

    def check(
        self,
        phase: ReferencePhase,
        following: ReferencePhase | None,
        contacts: Mapping[str, Float[np.ndarray, "3"]],
        hands: Mapping[str, float],
        expected: Mapping[str, Float[np.ndarray, "6"]],
        period_s: float,
    ) -> tuple[tuple[Finding, ...], Guards]:
        """Return what is wrong in this cycle, and the guards of the next one.

        Args:
            phase, following: the present phase and the next one, if any.
            contacts: measured force (3,) per link, world axes [N]; links without a sensor are missing and not guarded.
            hands: measured size of the force per tool that presses on a mechanism [N].
            expected: wrench (6,) that the plan expects per link [N, N m].
            period_s: of the cycle [s].
        """
        share = min(period_s / TREND_S, 1.0)
        slow = {tool: (1.0 - share) * self.slow.get(tool, force) + share * force for tool, force in hands.items()}
        over = {**self._check_contacts(phase, contacts, expected), **self._check_loads(phase, hands, slow)}
        exceeded = {key: self.exceeded_s.get(key, 0.0) + period_s for key in over}
        for tool, kind in over:
            if kind == "soon" and exceeded[tool, kind] > TREND_S:  # presses too hard until it is below its threshold
                exceeded[tool, "load"] = max(exceeded[tool, "load"], self.settings.hold_s)
        findings = [
            f for key, f in over.items() if exceeded[key] > (TREND_S if key[1] == "soon" else self.settings.hold_s)
        ]
        findings += self._list_missing(phase, following, contacts)
        return tuple(findings), replace(self, exceeded_s=exceeded, slow=slow)

    def _check_contacts(
        self,
        phase: ReferencePhase,
        contacts: Mapping[str, Float[np.ndarray, "3"]],
        expected: Mapping[str, Float[np.ndarray, "6"]],
    ) -> dict[tuple[str, str], Finding]:
        """Return the links that press with more than their cap, or with much less than expected.

        Where other links than feet hold the robot as well, a foot has time to find its ground until the next phase.
        """
        limits, over = self.settings, {}
        is_held = any(contact.normal is not None for contact in phase.contacts)
        lost = Severity.WAIT if is_held else Severity.ABORT
        for contact in phase.contacts:
            link = contact.link
            if link not in contacts:
                continue
            force, cap = press_on(contact, contacts[link]), contact.force_cap_n * len(contact.sole)
            wanted = press_on(contact, expected[link][:3]) if link in expected else 0.0
            most = limits.cap_share * cap
            if force > most:
                words = f"{link} carries {force:.0f} N in '{phase.name}'; its cap is {cap:.0f} N, abort at {most:.0f} N"
                over[link, "cap"] = Finding(Severity.ABORT, link, force, most, words)
            least = limits.lost_share * wanted
            if wanted >= limits.lost_n and force < least:
                words = f"{link} carries {force:.0f} N in '{phase.name}'; the plan expects {wanted:.0f} N"
                over[link, "lost"] = Finding(lost, link, force, least, words, True)
        return over

    def _check_loads(
        self, phase: ReferencePhase, hands: Mapping[str, float], slow: Mapping[str, float]
    ) -> dict[tuple[str, str], Finding]:
        """Return the hands that press harder on a mechanism than they may, or will before they can be stopped."""
        over = {}
        for load in phase.loads:
            force = hands.get(load.tool, 0.0)
            limit = load.expected_n + self.settings.load_share * (load.cap_n - load.expected_n)
            if force > limit:
                words = (
                    f"{load.tool} presses with {force:.0f} N in '{phase.name}'; expected {load.expected_n:.0f} N, "
                    f"abort at {limit:.0f} N, cap {load.cap_n:.0f} N"
                )
                over[load.tool, "load"] = Finding(Severity.ABORT, load.tool, force, limit, words, is_load=True)
            soon = force + (force - slow.get(load.tool, force)) / TREND_S * self.settings.stop_s
            if force > limit and soon > load.cap_n:
                words = (
                    f"{load.tool} presses with {force:.0f} N in '{phase.name}' and soon with {soon:.0f} N; expected "
                    f"{load.expected_n:.0f} N, cap {load.cap_n:.0f} N"
                )
                over[load.tool, "soon"] = Finding(Severity.ABORT, load.tool, soon, load.cap_n, words, is_load=True)
        return over

    def _list_missing(
        self,
        phase: ReferencePhase,
        following: ReferencePhase | None,
        contacts: Mapping[str, Float[np.ndarray, "3"]],
    ) -> list[Finding]:
        """Return the links that the next phase plants and that do not press on anything yet."""
        planted, missing = {contact.link for contact in phase.contacts}, []
        if following is None:
            return []
        for contact in following.contacts:
            link = contact.link
            if link in planted or link not in contacts:
                continue
            force = press_on(contact, contacts[link])
            least = self.settings.touch_n if contact.normal is None else self.settings.hand_touch_n
            if force < least:
                words = f"{link} carries {force:.0f} N; '{following.name}' needs it in contact with {least:.0f} N"
                missing.append(Finding(Severity.WAIT, link, force, least, words, True))
        return missing


def press_on(contact: PlantedContact, force: Float[np.ndarray, "3"]) -> float:
    """Return the part of a force along the normal of a contact [N]; of a sole on level ground the upright part."""
    return float(force[2] if contact.normal is None else force @ contact.normal)
