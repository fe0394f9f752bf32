"""The short version of ``make attack``: no lie is believed, no honest deed refused, and nothing crashes."""

from __future__ import annotations

import pytest

from benchmarks.attack.__main__ import PARTS, attacks_of
from benchmarks.attack.outcome import Attack, carry_out

ATTACKS = attacks_of(PARTS, is_short=True)


@pytest.mark.parametrize("attack", ATTACKS, ids=[attack.label for attack in ATTACKS])
def test_no_lie_is_believed_and_nothing_crashes(attack: Attack) -> None:
    outcome = carry_out(attack)
    assert not outcome.has_failed, f"{outcome.answer.value}: {outcome.text}"


def test_the_suite_is_as_large_as_it_claims_to_be() -> None:
    names = [attack.label for attack in attacks_of(PARTS, is_short=False)]
    assert len(names) == len(set(names))
    kinds = ("folders", "files", "approvals", "certify", "robots", "scenes", "laws")
    counts = {kind: sum(name.startswith(f"{kind}: ") for name in names) for kind in kinds}
    assert counts["folders"] >= 60
    assert min(counts["files"], counts["approvals"], counts["certify"]) >= 20
    assert counts["robots"] + counts["scenes"] + counts["laws"] >= 40
