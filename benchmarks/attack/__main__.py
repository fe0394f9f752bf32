"""Attack scopt: ``python -m benchmarks.attack [--short] [--only KIND ...] [--json FILE] [--seed N]``.

The exit code is 1 if false data was believed, honest data was refused, or anything crashed.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import resource
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from benchmarks.attack.outcome import Answer, Attack, Outcome, carry_out
from benchmarks.tables import print_table

MOST_BYTES = 8 * 2**30  # of address space: what asks for more is a crash
PARTS = ("folders", "fields", "files", "approvals", "certify", "robots", "scenes", "laws", "random_edits", "cancels")


def main() -> int:
    """Run the parts and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true", help="the version of `make test`")
    parser.add_argument("--only", action="append", choices=PARTS, help="only this part; may be given again")
    parser.add_argument("--match", default="", help="only attacks whose label holds this text")
    parser.add_argument("--json", type=Path, help="file for what came of every attack")
    parser.add_argument("--verbose", action="store_true", help="print every attack")
    parser.add_argument("--seed", type=int, default=0)
    told = parser.parse_args()
    faulthandler.enable()
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]))
    outcomes = []
    for outcome in _outcomes(told.only or PARTS, told.short, told.match, told.seed):
        outcomes.append(outcome)
        if told.verbose or outcome.has_failed:
            print(f"{outcome.answer.value:12} {outcome.kind}: {outcome.name}: {outcome.text}", flush=True)
    if told.json is not None:
        rows = [
            {"kind": o.kind, "name": o.name, "answer": o.answer.name, "text": o.text, "cpu_s": round(o.cpu_s, 3)}
            for o in outcomes
        ]
        told.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    _print(outcomes)
    return int(any(outcome.has_failed for outcome in outcomes))


def attacks_of(parts: tuple[str, ...] | list[str], is_short: bool, seed: int = 0) -> list[Attack]:
    """Return the attacks of some parts, without the cancels."""
    found: list[Attack] = []
    for part in parts:
        if part == "cancels":
            continue
        module = import_module(f"benchmarks.attack.{part}")
        found += module.attacks(seed, 8 if is_short else 150) if part == "random_edits" else module.attacks()
    return [attack for attack in found if attack.is_short or not is_short]


def _outcomes(parts: tuple[str, ...] | list[str], is_short: bool, match: str, seed: int) -> Iterator[Outcome]:
    for attack in attacks_of(parts, is_short, seed):
        if match in attack.label:
            yield carry_out(attack)
    if "cancels" in parts and match in "cancels":
        from benchmarks.attack.cancels import outcomes

        yield from outcomes(20 if is_short else 500, seed, is_short=is_short)


def _print(outcomes: list[Outcome]) -> None:
    kinds = list(dict.fromkeys(outcome.kind for outcome in outcomes))
    rows = []
    for kind in [*kinds, "all"]:
        own = [outcome for outcome in outcomes if kind in ("all", outcome.kind)]
        rows.append((kind, str(len(own)), *(str(sum(o.answer is answer for o in own)) for answer in Answer)))
    print_table("Attacks", ("kind", "attacks", *(answer.value for answer in Answer)), rows)
    for answer in (Answer.BELIEVED, Answer.ALARM, Answer.CRASHED):
        names = [f"{outcome.kind}: {outcome.name}" for outcome in outcomes if outcome.answer is answer]
        if names:
            print(f"{answer.value}: " + "; ".join(names))


if __name__ == "__main__":
    sys.exit(main())
