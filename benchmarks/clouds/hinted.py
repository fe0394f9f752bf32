"""Does a click near a wheel's centre lead to its ring?  Wheels of 25 to 40 cm, by scene seed and crop radius.

From the checkout's root: ``python -m benchmarks.clouds.hinted [--seeds 0 1 2] [--radii 3 4 5] [--only NAME]
[--variant V]``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np

from benchmarks.clouds.errors import errors, is_right
from benchmarks.clouds.others import MAKERS, make_other
from benchmarks.tables import print_table
from perception import CONFIDENT, Reach, detect, make_view

_SIGMA = 0.03  # [m] how well an operator clicks
_LARGE = ("wheel_25", "wheel_30", "wheel_40")


def main(arguments: Sequence[str] | None = None) -> None:
    """Search all scans and print one row per wheel, without a hint and with one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=(0, 1, 2))
    parser.add_argument("--radii", type=float, nargs="+", default=(3.0, 4.0, 5.0))
    parser.add_argument("--only", default="", help="only wheels whose name holds this")
    parser.add_argument("--variant", default="dense")
    chosen = parser.parse_args(arguments)
    rng = np.random.default_rng(0)
    rows = []
    for name in (name for name in MAKERS if name.startswith(_LARGE) and chosen.only in name):
        found = {True: 0, False: 0}
        worst, cpu, n_runs = np.zeros(3), 0.0, 0
        for seed in chosen.seeds:
            scene = make_other(name, seed)
            truth, cloud = scene.truth[0], scene.scan(chosen.variant)
            hint = truth.pose_world_object[:3, 3] + rng.normal(0.0, _SIGMA, 3)
            for radius in chosen.radii:
                view = make_view(cloud, reach=Reach(radius=radius))
                n_runs += 1
                for place in (None, hint):
                    clock = time.process_time()
                    hits = [hit for hit in detect("valve", view, place) if hit.confidence >= CONFIDENT]
                    cpu += time.process_time() - clock
                    values = errors("valve", hits[0], truth) if hits else ()
                    is_ring = bool(hits) and is_right("valve", values)
                    found[place is not None] += is_ring
                    if is_ring:
                        worst = np.maximum(worst, [value or 0.0 for value in values[:3]])
            print(name, seed, found, file=sys.stderr)
        shown = (f"{value:.1f}" for value in worst)
        rows.append(
            (name, f"{found[False]} / {n_runs}", f"{found[True]} / {n_runs}", *shown, f"{cpu / (2 * n_runs):.1f}")
        )
    header = ("wheel", "without hint", "with hint", "worst mm", "deg", "radius mm", "CPU s")
    print_table(f"rings found, {chosen.variant}", header, rows)


if __name__ == "__main__":
    main()
