"""Requests without a solution, drawn: whether each gets a reason, whether it names the cause, and what it costs.

``python -m benchmarks.planning.hopeless [--count N] [--seed S] [--each]``

A Panda from the folder ``SCOPT_DATA``; every kind is hopeless by construction, and has words of which a true reason
contains one.  A refusal of the request counts as a reason.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.planning.starts import find_panda
from benchmarks.tables import print_table
from scopt import EffortClock
from service.errors import RequestError
from service.planner import plan
from service.request.file import parse_request

HAND = "panda_hand"
READY = {"panda_joint2": -0.5, "panda_joint4": -2.2, "panda_joint6": 1.7, "panda_joint7": 0.8}
COLUMNS = ("kind", "requests", "with a reason", "true", "CPU median [s]", "CPU max [s]")
Data = dict[str, Any]


@dataclass(frozen=True)
class Hopeless:
    """A kind of request without a solution.

    Attributes:
        draw: changes the request.
        words: of which a true reason contains one.
    """

    draw: Callable[[np.random.Generator, Data], None]
    words: tuple[str, ...]


def _place(rng: np.random.Generator) -> np.ndarray:
    """Return a place within reach [m]."""
    turn, far = rng.uniform(-0.8, 0.8), rng.uniform(0.45, 0.6)
    return np.array([far * np.cos(turn), far * np.sin(turn), rng.uniform(0.3, 0.6)])


def _far(rng: np.random.Generator, data: Data) -> None:
    data["goal"] = {"poses": [{"link": HAND, "position": (_place(rng) * rng.uniform(2.5, 8.0)).tolist()}]}


def _inside(rng: np.random.Generator, data: Data) -> None:
    place = _place(rng)
    data["goal"] = {"poses": [{"link": HAND, "position": place.tolist()}]}
    size = rng.uniform(0.15, 0.25, 3)
    data["scene"]["obstacles"].append(
        {"name": "block", "type": "box", "size": size.tolist(), "position": place.tolist()}
    )


def _caged(rng: np.random.Generator, data: Data) -> None:
    """Close a room around the goal."""
    place, side, thick = _place(rng), float(rng.uniform(0.26, 0.34)), 0.02
    data["goal"] = {"poses": [{"link": HAND, "position": place.tolist(), "position_tolerance_m": 0.01}]}
    for k in range(3):
        for sign in (-1.0, 1.0):
            size, middle = np.full(3, side), place.copy()
            size[k], middle[k] = thick, middle[k] + sign * 0.5 * side
            data["scene"]["obstacles"].append(
                {"name": f"wall{k}{'ab'[sign > 0]}", "type": "box", "size": size.tolist(), "position": middle.tolist()}
            )


def _leaves_keep(rng: np.random.Generator, data: Data) -> None:
    data["keep"] = [{"link": HAND, "region": {"z_min_m": -0.05, "z_max_m": 0.05}}]
    far = _place(rng)
    far[2] = rng.uniform(0.05, 0.2)
    data["goal"] = {"poses": [{"link": HAND, "position": far.tolist(), "position_tolerance_m": 0.01}]}


def _joints_leave_keep(rng: np.random.Generator, data: Data) -> None:
    data["keep"] = [{"link": HAND, "free_axis": "z", "rotation_tolerance_deg": 10.0, "position_tolerance_m": 1.0}]
    joints = {**READY, "panda_joint1": float(rng.uniform(-1, 1)), "panda_joint3": 0.0, "panda_joint5": 0.0}
    data["goal"] = {"joints": {**joints, "panda_joint6": READY["panda_joint6"] + float(rng.uniform(0.5, 1.2))}}


def _apart(rng: np.random.Generator, data: Data) -> None:
    first = _place(rng)
    other = first + np.array([0.0, 0.0, 0.3]) + rng.uniform(0.0, 0.1, 3)
    poses = [{"link": HAND, "position": first.tolist()}, {"link": "panda_link7", "position": other.tolist()}]
    data["goal"] = {"poses": poses}


def _none_of(rng: np.random.Generator, data: Data) -> None:
    far = [(_place(rng) * rng.uniform(2.5, 5.0)).tolist() for _ in range(3)]
    data["goal"] = {"any_of": [{"poses": [{"link": HAND, "position": place}]} for place in far]}


def _via(rng: np.random.Generator, data: Data) -> None:
    far = {"poses": [{"link": HAND, "position": (_place(rng) * 3.0).tolist()}]}
    data["goal"] = {"poses": [{"link": HAND, "position": _place(rng).tolist()}], "via": [far]}


def _heavy(rng: np.random.Generator, data: Data) -> None:
    load = {"name": "load", "link": HAND, "type": "box", "size": [0.05, 0.05, 0.05], "position": [0.0, 0.0, 0.14]}
    data["attached"] = [{**load, "mass_kg": float(rng.uniform(25.0, 80.0))}]
    data["goal"] = {"poses": [{"link": HAND, "position": _place(rng).tolist()}]}


def _hits(rng: np.random.Generator, data: Data) -> None:
    """Demand joints at which the hand is in a block."""
    data["goal"] = {"joints": {**READY, "panda_joint1": 1.0, "panda_joint3": 0.0, "panda_joint5": 0.0}}
    place = [0.3, 0.45, float(rng.uniform(0.3, 0.6))]
    data["scene"]["obstacles"].append({"name": "block", "type": "box", "size": [0.3, 0.3, 0.4], "position": place})


KINDS: Mapping[str, Hopeless] = {
    "beyond reach": Hopeless(_far, ("cannot reach", "beyond")),
    "goal inside a block": Hopeless(_inside, ("block",)),
    "goal in a closed room": Hopeless(_caged, ("wall", "collision")),
    "goal outside a kept region": Hopeless(_leaves_keep, ("keep", "place of", "position of")),
    "joints outside a kept cone": Hopeless(_joints_leave_keep, ("keep",)),
    "two links too far apart": Hopeless(_apart, ("cannot be at their targets at once",)),
    "none of several goals": Hopeless(_none_of, ("any_of[0]", "cannot reach")),
    "place on the way beyond reach": Hopeless(_via, ("via[0]",)),
    "load beyond effort": Hopeless(_heavy, ("N m", "effort")),
    "joints in a block": Hopeless(_hits, ("block",)),
}


def main() -> None:
    """Print a line per request if asked for, and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=4, help="requests of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--each", action="store_true")
    given = parser.parse_args()
    known = find_panda()
    if known is None:
        print("no Panda: SCOPT_DATA has no mbm_panda")
        return
    rows, everything = [], []
    for number, (name, kind) in enumerate(KINDS.items()):
        seconds, reasons, true = [], 0, 0
        for k in range(given.count):
            data: Data = {"robot": known[1].to_request(), "start": {"joints": READY}}
            data["scene"] = {"floor": False, "obstacles": []}
            kind.draw(np.random.default_rng([given.seed, number, k]), data)
            began = time.process_time()
            try:
                result = plan(parse_request(data), clock=EffortClock())
                verdict, lines = result.verdict.value, result.explanation
            except RequestError as error:
                verdict, lines = "refused", error.problems
            seconds.append(time.process_time() - began)
            text = "; ".join(lines)
            reasons += bool(lines)
            true += verdict != "CERTIFIED" and any(word in text for word in kind.words)
            if given.each or not lines:
                print(f"  {name} {k}: {verdict} {seconds[-1]:.1f} s: {text[:160]}", flush=True)
        everything += seconds
        figures = (len(seconds), reasons, true, f"{statistics.median(seconds):.2f}", f"{max(seconds):.2f}")
        rows.append((name, *map(str, figures)))
    total = (len(everything), sum(int(row[2]) for row in rows), sum(int(row[3]) for row in rows))
    rows.append(("all", *map(str, total), f"{statistics.median(everything):.2f}", f"{max(everything):.2f}"))
    print_table("Requests without a solution", COLUMNS, rows)


if __name__ == "__main__":
    main()
