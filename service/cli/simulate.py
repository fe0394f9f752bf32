"""``scopt simulate``: a plan carried out in a physics engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from costs.stopping import stops_when
from service.cli.command import command
from service.cli.options import Json
from service.cli.report import print_findings, print_line, print_table, print_verdict
from service.cli.run import cancellable, consoles, print_json, progress

TABLE = ("phase", "from", "to", "ground at most", "hand at most", "expected", "abort at", "on")


@command(has_verdict=True)
def simulate_command(
    result: Annotated[Path, typer.Argument(help="Result folder or its result.json.", metavar="RESULT")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write; by default simulation.json in the folder.")
    ] = None,
    friction: Annotated[float, typer.Option(help="Coefficient of friction between robot and world.")] = 0.8,
    hand_friction: Annotated[
        float | None,
        typer.Option(help="Between hands and what they move; by default both ends of the request's interval."),
    ] = None,
    feed_forward: Annotated[
        float, typer.Option(help="Share of the planned torques that the servos add: 0 for pure position servos.")
    ] = 1.0,
    stiffness_scale: Annotated[float, typer.Option(help="Factor on the stiffness and damping of all servos.")] = 1.0,
    noise: Annotated[float, typer.Option(help="Size of the sensors' noise; 1 is usual, 0 is none.")] = 0.0,
    delay: Annotated[float, typer.Option(help="Time from a command to its servo, in milliseconds.")] = 0.0,
    joint_friction: Annotated[
        float, typer.Option(help="Dry friction in every joint, as a share of its torque limit.")
    ] = 0.0,
    perturb: Annotated[
        float, typer.Option(help="Size of random errors of surfaces, masses, friction and first pose; 1: 1 cm, 5 %.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Of noise and errors.")] = 0,
    as_json: Json = False,
) -> str:
    """Carry out a plan in physics: does the robot stand, and is the work done?

    Servos follow the plan without balance control. The verdict is DONE, STOOD (the robot stands, the work is not done)
    or FELL; the table compares the forces with those that the plan expects. Needs MuJoCo: pip install 'scopt[sim]'.
    """
    stdout, stderr = consoles()
    with progress(stderr, "read result") as report, cancellable(stderr) as should_stop:
        report("read result", 0.0)
        from service.simulation.options import SimulationOptions
        from service.simulation.simulate import simulate

        options = SimulationOptions(
            friction=friction,
            hand_friction=hand_friction,
            feed_forward=feed_forward,
            stiffness_scale=stiffness_scale,
            noise=noise,
            delay_ms=delay,
            joint_friction=joint_friction,
            perturb=perturb,
            seed=seed,
        )
        with stops_when(should_stop):
            made = simulate(result, options, output=output, report=report)
    if as_json:
        print_json({key: value for key, value in made.items() if key != "track"})
    else:
        file = output or (result if result.is_dir() else result.parent) / "simulation.json"
        print_simulation(stdout, made, {"page": file.with_suffix(".html")})
    return str(made["verdict"])


def print_simulation(out: Console, made: Mapping[str, Any], lines: Mapping[str, object] | None = None) -> None:
    """Print what ``service.simulate`` returned: phases with forces, errors, notes, ``lines`` and the verdict."""
    print_table(out, TABLE, [row for phase in made["phases"] for row in _list_rows(phase)])
    print_findings(out, {"explanation": made["explanation"], "notes": made["notes"]})
    print_travel(out, made["runs"])
    if made["slip"]:
        slips = (f"{slip['link']} {1e3 * slip['worst_m']:.1f} mm" for slip in made["slip"])
        print_line(out, "slip", ", ".join(slips))
    if made["hands"]:
        hands = (f"{hand['frame']} {1e3 * hand['worst_m']:.1f} mm" for hand in made["hands"])
        print_line(out, "off the plan", ", ".join(hands))
    balance = made["balance"]
    if balance["margin_m"] is not None:
        planned, true = 1e3 * balance["planned_margin_m"], 1e3 * balance["margin_m"]
        print_line(out, "balance margin", f"{true:.1f} mm, planned {planned:.1f} mm")
    saturated = [joint["joint"] for joint in made["saturation"]]
    print_line(out, "torque limit", ", ".join(saturated) if saturated else "never reached")
    for label, value in (lines or {}).items():
        print_line(out, label, value)
    speed = f"computed in {made['computing_s']:.2f} s, {made['times_real_time']:.1f} times real time"
    ended = made["explanation"] or [f"to the end of {made['plan']['duration_s']:.1f} s; {speed}"]
    print_verdict(out, {"verdict": made["verdict"], "explanation": ended})


def _list_rows(phase: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the lines of a phase: one per load, or one without."""
    ground = "" if phase["ground_peak_n"] is None else f"{phase['ground_peak_n']:.0f} N"
    head = (phase["name"], f"{phase['begin_s']:.2f} s", f"{phase['end_s']:.2f} s", ground)
    if not phase["loads"]:
        return [(*head, "", "", "", "")]
    rows = []
    for load in phase["loads"]:
        forces = (f"{load[key]:.0f} N" for key in ("peak_n", "expected_n", "abort_n"))
        rows.append((*head, *forces, f"{load['tool']} on {', '.join(load['links'])}"))
        head = ("", "", "", "")
    return rows


def print_travel(out: Console, runs: Sequence[Mapping[str, Any]]) -> None:
    """Print per run with a mechanism its friction, verdict and moves."""
    for run in runs:
        if not run["mechanism"]:
            continue
        print_line(out, "hand friction", f"{run['hand_friction']:g}: {run['verdict']}")
        print_moves(out, run["mechanism"])


def print_moves(out: Console, moves: Sequence[Mapping[str, Any]]) -> None:
    """Print a line per move of a mechanism's joint."""
    for move in moves:
        reached, planned = (_format_travel(move[key], move["unit"]) for key in ("reached", "planned"))
        line = f"{reached} of {planned} planned ({round(100.0 * move['share'], 1) + 0.0:.1f} %)"
        print_line(out, move["joint"], f"{line}, to {_format_travel(move['end'], move['unit'])}  {move['phase']}")


def _format_travel(value: float, unit: str) -> str:
    factor, name = (1e3, "mm") if unit == "m" else (57.29577951308232, "deg")
    return f"{round(factor * value, 1) + 0.0:.1f} {name}"
