"""Attack scopt: ``python -m benchmarks.attack [--short | --long] [--only KIND ...] [--json FILE] [--seed N]``.

The short version is that of `make test`, the long one has every attack.  Between them a seed draws a sample of the
attacks that only the long one has, and of the fields that are falsified; another seed draws another one.

The exit code is 1 if false data was believed, honest data was refused, or anything crashed.
"""

from __future__ import annotations

import argparse
import enum
import faulthandler
import json
import random
import resource
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path

from benchmarks.attack.outcome import Answer, Attack, Outcome, carry_out
from benchmarks.tables import print_table

MOST_BYTES = 8 * 2**30  # of address space: what asks for more is a crash
PARTS = (
    "folders",
    "fields",
    "asked",
    "files",
    "simulations",
    "approvals",
    "certify",
    "robots",
    "scenes",
    "laws",
    "random_edits",
    "cancels",
)


class Extent(enum.Enum):
    """How many attacks there are."""

    SHORT = "short"
    SAMPLE = "sample"
    LONG = "long"

    @staticmethod
    def of(is_short: bool, is_long: bool) -> Extent:
        """Return the extent that two options ask for."""
        return Extent.SHORT if is_short else Extent.LONG if is_long else Extent.SAMPLE


SHARE = {Extent.SHORT: 0.0, Extent.SAMPLE: 0.25, Extent.LONG: 1.0}  # of the attacks that are not in the short version
FIELDS = {
    Extent.SHORT: 4,
    Extent.SAMPLE: 3,
    Extent.LONG: None,
}  # kinds of fields of a base and a group that are falsified
RANDOM_EDITS = {Extent.SHORT: 2, Extent.SAMPLE: 50, Extent.LONG: 150}
CANCELS = {Extent.SHORT: 20, Extent.SAMPLE: 100, Extent.LONG: 500}


def main() -> int:
    """Run the parts and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true", help="the version of `make test`")
    parser.add_argument("--long", action="store_true", help="every attack, and every kind of field")
    parser.add_argument("--only", action="append", choices=PARTS, help="only this part; may be given again")
    parser.add_argument("--match", default="", help="only attacks whose label holds this text")
    parser.add_argument("--json", type=Path, help="file for what came of every attack")
    parser.add_argument("--verbose", action="store_true", help="print every attack")
    parser.add_argument("--seed", type=int, default=0)
    told = parser.parse_args()
    faulthandler.enable()
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]))
    outcomes = []
    for outcome in _outcomes(told.only or PARTS, Extent.of(told.short, told.long), told.match, told.seed):
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


def attacks_of(parts: Sequence[str], extent: Extent, seed: int = 0) -> list[Attack]:
    """Return the attacks of some parts, without the cancels."""
    rng = random.Random(seed)
    return [attack for part in parts if part != "cancels" for attack in _choose(part, extent, seed, rng)]


def _choose(part: str, extent: Extent, seed: int, rng: random.Random) -> list[Attack]:
    """Return the attacks of a part: all, the short ones, or these and some of the others."""
    module = import_module(f"benchmarks.attack.{part}")
    match part:
        case "random_edits":
            return list(module.attacks(seed, RANDOM_EDITS[extent]))
        case "fields" | "asked":
            found = list(module.attacks(seed, FIELDS[extent]))
            return [attack for attack in found if attack.is_short] if extent is Extent.SHORT else found
        case _:
            found = list(module.attacks())
    others = [attack.label for attack in found if not attack.is_short]
    drawn = set(rng.sample(others, round(SHARE[extent] * len(others))))
    return [attack for attack in found if attack.is_short or attack.label in drawn]


def _outcomes(parts: Sequence[str], extent: Extent, match: str, seed: int) -> Iterator[Outcome]:
    for attack in attacks_of(parts, extent, seed):
        if match in attack.label:
            yield carry_out(attack)
    if "cancels" in parts and match in "cancels":
        from benchmarks.attack.cancels import outcomes

        yield from outcomes(CANCELS[extent], seed, is_short=extent is Extent.SHORT)


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
