"""The short version of ``make attack``: no lie is believed, no honest deed refused, and nothing crashes."""

from __future__ import annotations

import pytest

from benchmarks.attack.__main__ import PARTS, Extent, attacks_of
from benchmarks.attack.outcome import Attack, carry_out

ATTACKS = attacks_of(PARTS, Extent.SHORT)


@pytest.mark.parametrize("attack", ATTACKS, ids=[attack.label for attack in ATTACKS])
def test_no_lie_is_believed_and_nothing_crashes(attack: Attack) -> None:
    outcome = carry_out(attack)
    assert not outcome.has_failed, f"{outcome.answer.value}: {outcome.text}"


def test_the_suite_is_as_large_as_it_claims_to_be() -> None:
    names = [attack.label for attack in attacks_of(PARTS, Extent.LONG)]
    assert len(names) == len(set(names))
    kinds = ("folders", "files", "simulations", "approvals", "certify", "robots", "scenes", "laws")
    counts = {kind: sum(name.startswith(f"{kind}: ") for name in names) for kind in kinds}
    assert counts["folders"] >= 60
    assert min(counts["files"], counts["simulations"], counts["approvals"], counts["certify"]) >= 20
    assert counts["robots"] + counts["scenes"] + counts["laws"] >= 40


def test_another_seed_draws_another_sample_and_the_same_seed_the_same() -> None:
    first, again, other = (
        [attack.label for attack in attacks_of(["folders"], Extent.SAMPLE, seed)] for seed in (0, 0, 1)
    )
    assert first == again
    assert set(first) != set(other)
    assert {attack.label for attack in ATTACKS if attack.kind == "folders"} <= set(first) & set(other)
