"""Whole plans of getting out: other draws of places, other vehicles, and disturbed objects.

``python -m benchmarks.tasks.egress_plans [--seeds N] [--cars N] [--scanned] [--disturbed N] [--again] [--seed S]
[--limit SECONDS] [--out FOLDER]``

- ``--seeds``: the shipped request with that many other seeds, so that other places are drawn.
- ``--cars``: vehicles with bar, platform, seat and pillars drawn around the shipped ones; the robot is seated anew.
- ``--scanned``: a vehicle known only from a scan, of the folder ``SCOPT_DATA`` (default: ``../shared/data``): until the
  right foot is out, and as far as it goes.
- ``--disturbed``: a certified plan, planned again from its motion with chest plate, bar, platform and friction drawn
  (``benchmarks.tasks.egress_cases``); ``--out`` gets a picture of these.
- ``--again``: a certified plan, planned again from one of its phases on, with a target displaced by the operator.

Processor time is of this process.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.clouds.cases import data_folder
from benchmarks.tables import print_table
from benchmarks.tasks.egress_cases import MODEL, disturb, draw_car, load_model
from costs.robot import BASE_NAMES
from costs.rotation import make_quaternions
from service.errors import RequestError
from service.planner import plan
from service.replay.adjust import adjust_request, read_adjustment
from service.replay.rest import make_rest_request
from service.request.file import parse_request, to_json
from service.request.schema import PlanRequest
from service.result.output import write_result
from service.result.result import PlanResult, Verdict

SCANNED = Path(__file__).with_name("requests") / "egress_scanned.yaml"
HEADER = ("case", "verdict", "CPU [s]", "clearance [mm]", "torque", "balance [mm]", "why not")
AGAIN = (  # phase, and what is displaced
    ("left foot out: swing", ()),
    ("left foot out: swing", ("left_foot:0.02,0,0",)),
    ("right foot out: swing", ()),
    ("right foot out: swing", ("right_foot:0.02,0,0",)),
    ("right foot out: swing", ("wooden_bar:0.01,0,0",)),
)
COLOURS = {"CERTIFIED": "#15803d"}
FAILED_COLOUR = "#b91c1c"


def run(name: str, request: PlanRequest) -> tuple[tuple[str, ...], PlanResult | None]:
    """Plan a request; return a row of the table, and the result unless the request was refused."""
    started = time.process_time()
    try:
        result = plan(request)
    except RequestError as error:
        return (name, "INVALID_REQUEST", "", "", "", "", str(error.problems[0])), None
    spent = time.process_time() - started
    proof = result.certificate
    torque = "" if proof is None else f"{100.0 * max_torque(result):.0f} %"
    clearance = "" if proof is None or proof.min_clearance_m is None else f"{1e3 * proof.min_clearance_m:.1f}"
    balance = "" if proof is None or proof.min_balance_margin_m is None else f"{1e3 * proof.min_balance_margin_m:.1f}"
    why = result.explanation[0] if result.explanation else ""
    return (name, result.verdict.value, f"{spent:.1f}", clearance, torque, balance, why[:90]), result


def max_torque(result: PlanResult) -> float:
    """Return the largest joint torque as a share of its limit; NaN where it was not checked."""
    checks = () if result.certificate is None else result.certificate.checks
    return max((check.value for check in checks if check.name.startswith("torque.")), default=float("nan"))


def list_seeds(count: int, first: int, limit_s: float) -> Iterator[tuple[str, PlanRequest]]:
    """Yield the shipped request with other seeds."""
    for seed in range(first, first + count):
        request = parse_request(load_model(), MODEL.parent)
        yield f"seed {seed}", replace(request, options=replace(request.options, seed=seed, time_limit_s=limit_s))


def list_cars(count: int, first: int, limit_s: float) -> Iterator[tuple[str, PlanRequest | str]]:
    """Yield drawn vehicles, or a sentence where the robot cannot sit in one."""
    for seed in range(first, first + count):
        try:
            data = draw_car(np.random.default_rng(seed))
        except ValueError as error:
            yield f"car {seed}", str(error)
            continue
        request = parse_request(data, MODEL.parent)
        yield f"car {seed}", replace(request, options=replace(request.options, time_limit_s=limit_s))


def list_scanned(limit_s: float) -> Iterator[tuple[str, PlanRequest]]:
    """Yield the scanned vehicle until the right foot is out, and all phases; nothing without its scan."""
    folder = data_folder() / "scenes" / "car_ev"
    if not folder.is_dir():
        print(f"no scan at {folder} (set SCOPT_DATA)")
        return
    data = yaml.safe_load(SCANNED.read_text())
    data["options"]["time_limit_s"] = limit_s
    yield f"scanned, until '{data['task']['egress']['until']}'", parse_request(data, folder)
    del data["task"]["egress"]["until"]
    yield "scanned, all phases", parse_request(data, folder)


def run_disturbed(count: int, first: int, limit_s: float, out: Path) -> list[tuple[str, ...]]:
    """Plan once, then again from that motion for drawn disturbances; write a picture."""
    nominal = parse_request(load_model(), MODEL.parent)
    row, result = run("nominal", replace(nominal, options=replace(nominal.options, time_limit_s=limit_s)))
    rows = [row]
    if result is None or result.motion is None or row[1] != "CERTIFIED":
        return rows
    out.mkdir(parents=True, exist_ok=True)
    write_result(result, out / "nominal")
    state = out / "state.json"
    state.write_text(json.dumps(describe_start(result)))
    rest = to_json(make_rest_request(out / "nominal", result.motion.phases[0].name, state))
    seen: list[tuple[Mapping[str, float], str]] = []
    for seed in range(first, first + count):
        data: dict[str, Any] = json.loads(json.dumps(rest))
        drawn = disturb(data, np.random.default_rng(seed))
        row, _ = run(f"disturbed {seed}", parse_request(data, MODEL.parent))
        print("  " + "  ".join(row), flush=True)
        rows.append(row)
        seen.append((drawn, row[1]))
    (out / "robustness.svg").write_text(draw(seen))
    return rows


def list_again(out: Path, limit_s: float) -> Iterator[tuple[str, PlanRequest]]:
    """Plan once; yield requests for the rest from a phase on, as ``scopt plan --from-phase --adjust`` makes them."""
    nominal = parse_request(load_model(), MODEL.parent)
    result = plan(replace(nominal, options=replace(nominal.options, time_limit_s=limit_s)))
    if result.verdict is not Verdict.CERTIFIED:
        print(f"the nominal plan is {result.verdict.value}")
        return
    write_result(result, out / "nominal")
    for phase, displaced in AGAIN:
        request = make_rest_request(out / "nominal", phase, None)
        for target, offset in map(read_adjustment, displaced):
            request, _ = adjust_request(request, None, target, offset)
        yield f"{phase} {' '.join(displaced)}", request


def describe_start(result: PlanResult) -> dict[str, Any]:
    """Return the state at the start of a plan, as ``scopt plan --state`` reads it."""
    n, q, names = len(BASE_NAMES), result.start, result.robot.joint_names
    base = {"position": q[:3].tolist(), "quaternion_wxyz": make_quaternions(q[None, 3:n])[0].tolist()}
    return {"joints": dict(zip(names[n:], q[n:].tolist(), strict=True)), "base": base}


def draw(seen: list[tuple[Mapping[str, float], str]]) -> str:
    """Return a picture (SVG): a line per disturbance, a dot per draw, green where it was certified."""
    if not seen:
        return "<svg xmlns='http://www.w3.org/2000/svg'/>"
    parts = []
    for row, name in enumerate(seen[0][0]):
        values = np.array([drawn[name] for drawn, _ in seen])
        low, high = float(values.min()), float(values.max())
        y = 30 + 40 * row
        parts.append(f"<text x='10' y='{y + 4}'>{name}</text><line x1='140' x2='560' y1='{y}' y2='{y}' stroke='#999'/>")
        parts.append(f"<text x='140' y='{y + 18}'>{low:.3g}</text><text x='530' y='{y + 18}'>{high:.3g}</text>")
        for value, (_, verdict) in zip(values.tolist(), seen, strict=True):
            x = 140 + 420 * (value - low) / max(high - low, 1e-12)
            parts.append(f"<circle cx='{x:.1f}' cy='{y}' r='5' fill='{COLOURS.get(verdict, FAILED_COLOUR)}'/>")
    height = 40 * len(seen[0][0]) + 30
    style = "font-family='sans-serif' font-size='11'"
    return f"<svg xmlns='http://www.w3.org/2000/svg' width='600' height='{height}' {style}>{''.join(parts)}</svg>"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=0)
    parser.add_argument("--cars", type=int, default=0)
    parser.add_argument("--scanned", action="store_true")
    parser.add_argument("--disturbed", type=int, default=0)
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--seed", type=int, default=1, help="first seed")
    parser.add_argument("--limit", type=float, default=300.0, help="time limit of each plan [s]")
    parser.add_argument("--out", type=Path, default=Path("out/egress_plans"))
    options = parser.parse_args()
    lists: dict[str, Iterable[tuple[str, PlanRequest | str]]] = {
        "Other draws of places": list_seeds(options.seeds, options.seed, options.limit),
        "Other vehicles": list_cars(options.cars, options.seed, options.limit),
        "A scanned vehicle": list_scanned(options.limit) if options.scanned else (),
        "Planned again": list_again(options.out, options.limit) if options.again else (),
    }
    for title, cases in lists.items():
        rows = []
        for name, request in cases:
            row = (name, "NO SEAT", "", "", "", "", request) if isinstance(request, str) else run(name, request)[0]
            print("  " + "  ".join(row), flush=True)
            rows.append(row)
        if rows:
            certified = sum(row[1] == "CERTIFIED" for row in rows)
            print_table(f"{title}: {certified} of {len(rows)} certified", HEADER, rows)
    if options.disturbed:
        rows = run_disturbed(options.disturbed, options.seed, options.limit, options.out)
        certified = sum(row[1] == "CERTIFIED" for row in rows[1:])
        print_table(f"Disturbed: {certified} of {len(rows) - 1} planned again and certified", HEADER, rows)


if __name__ == "__main__":
    main()
