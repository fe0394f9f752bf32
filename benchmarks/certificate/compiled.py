"""The compiled distances against coal's: ``python -m benchmarks.certificate.compiled [--count N] [--seed S]``.

Hulls are solid, boxes, flat, segments, points and slivers of 1 mm to 1 m; a third of the pairs touch within rounding.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support" / "mathematics"))

from compiled_oracle import compare_with_coal

BATCH = 1000


def main() -> int:
    """Compare, and print every disagreement."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    answered, left, faults = 0, 0, list[str]()
    for batch in range(max(given.count // BATCH, 1)):
        parts = compare_with_coal(np.random.default_rng([given.seed, batch]), min(BATCH, given.count))
        answered, left = answered + parts[0], left + parts[1]
        faults += [f"seed [{given.seed}, {batch}], {fault}" for fault in parts[2]]
    print(f"{answered} answered, {left} left to coal, {len(faults)} disagree", *faults[:20], sep="\n")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
