"""Static equilibrium regions of random stances: ``python -m benchmarks.tasks.static_region [--count N]``.

Every vertex of every region is checked twice: its witness by sums and dot products, and the place itself by a program
with exact friction cones (Clarabel).  A stance without a region is given to both independent solvers: ``empty although
held`` counts those that the product's pyramids (scipy) hold, ``only exact cones hold`` those that need the friction
between the pyramid's edges.  The corner of the region in a random direction is compared with scipy's.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np
from jaxtyping import Float

from benchmarks.tables import print_table
from benchmarks.tasks.stances import random_load, random_stance, solve_cone, solve_pyramid, witness_defects
from costs.contact import WorldContacts
from costs.static_region import DegenerateRegionError, NothingHoldsError, find_static_region

N_STANCES = 1000
WITNESS_TOLERANCE = 1e-6  # of the weight


def judge_region(contacts: WorldContacts, mass: float, wrench: Float[np.ndarray, "6"], counts: Counter[str]) -> float:
    """Find and check the region of one stance; return the time to find it [s]."""
    began = time.perf_counter()
    try:
        region = find_static_region(contacts, mass, wrench[None])
    except NothingHoldsError:
        took = time.perf_counter() - began
        counts["empty"] += 1
        if solve_pyramid(contacts, mass, wrench) is not None:
            counts["empty although held"] += 1
        elif solve_cone(contacts, mass, wrench) is not None:
            counts["only exact cones hold"] += 1
        return took
    except DegenerateRegionError:
        counts["degenerate"] += 1
        return time.perf_counter() - began
    took = time.perf_counter() - began
    counts["regions"] += 1
    counts["vertices"] += len(region.vertices)
    counts["witnesses refuted"] += bool(witness_defects(contacts, mass, region).max() > WITNESS_TOLERANCE)
    middle = region.vertices.mean(axis=0)
    for vertex in region.vertices:
        inside = vertex + 1e-4 * (middle - vertex)  # an interior point solver needs room
        counts["vertices refuted"] += solve_cone(contacts, mass, wrench, com=inside) is None
    direction = middle / np.linalg.norm(middle)
    farthest = solve_pyramid(contacts, mass, wrench, direction)
    short = np.inf if farthest is None else direction @ farthest - (region.vertices @ direction).max()
    counts["corners short by over 1 mm"] += bool(short > 1e-3)
    counts["corners too far"] += bool(short < -1e-5)
    return took


def main() -> None:
    """Print what was found, what was refuted, and times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=N_STANCES)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    counts: Counter[str] = Counter()
    times: dict[str, list[float]] = {"no load": [], "load": [], "load, drift 1 mm": []}
    for _ in range(given.count):
        contacts, mass = random_stance(rng)
        wrench = random_load(rng, mass) if rng.random() < 0.7 else np.zeros(6)
        is_loaded = bool(wrench.any())
        times["load" if is_loaded else "no load"].append(judge_region(contacts, mass, wrench, counts))
        if is_loaded:
            began = time.perf_counter()
            try:
                find_static_region(contacts, mass, wrench[None], drift_m=1e-3)
            except (NothingHoldsError, DegenerateRegionError):
                continue
            times["load, drift 1 mm"].append(time.perf_counter() - began)
    names = (
        "regions",
        "vertices",
        "vertices refuted",
        "witnesses refuted",
        "corners too far",
        "corners short by over 1 mm",
    )
    names += ("empty", "empty although held", "only exact cones hold", "degenerate")
    print_table(f"{given.count} random stances", ("", "count"), [(name, str(counts[name])) for name in names])
    rows = [
        (name, str(len(taken)), *(f"{1e3 * np.percentile(taken, p):.1f}" for p in (50, 95, 100)))
        for name, taken in times.items()
    ]
    print_table("Time of a region [ms]", ("", "stances", "median", "p95", "largest"), rows)


if __name__ == "__main__":
    main()
