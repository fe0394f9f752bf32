"""Reports of ``scopt simulate`` that were edited, with hashes that fit: refused, or named as not computed anew.

The last ones carry out plans whose work cannot be done: physics has to say so.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

from benchmarks.attack import bases
from benchmarks.attack.edits_holds import the_hand_lets_go_half_way, the_object_moves_while_the_hand_rests
from benchmarks.attack.forgery import Folder, Level
from benchmarks.attack.outcome import Answer, Attack
from service.errors import RequestError, ResultError
from service.replay.replay import verify_result
from service.result.manifest import record_files
from service.simulation.simulate import simulate

FILES = ("simulation.json", "simulation.html")
REPORT = FILES[0]
Report = dict[str, Any]
Change = Callable[[Report], object]


def attacks() -> list[Attack]:
    """Return lies about simulations, honest ones, and plans that physics cannot carry out."""
    return [
        *(
            Attack("simulations", f"{base}: {name}", partial(_lie, base, change), base == "arm")
            for name, (base, change) in LIES.items()
        ),
        *(Attack("harmless", f"{base}: a simulation", partial(_honest, base), base == "arm") for base in BASES),
        *(
            Attack("simulations", f"drawer: carried out: {name}", partial(_carry_out, change), False)
            for name, change in IMPOSSIBLE.items()
        ),
    ]


@cache
def _simulated(base: str) -> Path:
    """Return a folder of a base with its simulation, which is DONE."""
    folder = bases.original(base) / "simulated"
    shutil.copytree(bases.original(base) / "result", folder)
    made = simulate(folder)
    if made["verdict"] != "DONE":
        raise RuntimeError(f"the honest plan '{base}' is not DONE: {made['explanation']}")
    return folder


def _copy(base: str, scratch: Path) -> Path:
    folder = scratch / "result"
    shutil.copytree(_simulated(base), folder)
    return folder


def _lie(base: str, change: Change, scratch: Path) -> tuple[Answer, str]:
    """Edit a report and its hash; the answer has to name it."""
    folder = _copy(base, scratch)
    told = json.loads((folder / REPORT).read_text(encoding="utf-8"))
    change(told)
    (folder / REPORT).write_text(json.dumps(told), encoding="utf-8")
    record_files(folder, FILES)
    try:
        summary = verify_result(folder)
    except (ResultError, RequestError) as error:
        lines = [line for line in str(error).splitlines() if REPORT in line]
        return (Answer.REFUSED, lines[0]) if lines else (Answer.CRASHED, str(error).splitlines()[0])
    named = [note for note in summary["notes"] if REPORT in note and "not computed anew" in note]
    return (Answer.REPORTED, named[0]) if named else (Answer.BELIEVED, f"no note names {REPORT}")


def _honest(base: str, scratch: Path) -> tuple[Answer, str]:
    try:
        summary = verify_result(_copy(base, scratch))
    except (ResultError, RequestError) as error:
        return Answer.ALARM, str(error).splitlines()[0]
    return (Answer.TRUE if summary["verdict"] == "CERTIFIED" else Answer.ALARM), str(summary["verdict"])


def _carry_out(change: Callable[[Folder], object], scratch: Path) -> tuple[Answer, str]:
    """Carry out an edited plan; the work that its motion does not do is not DONE."""
    folder = Folder(bases.copy_of("drawer", scratch))
    change(folder)
    folder.save(Level.REMADE)
    try:
        made = simulate(folder.path)
    except ResultError as error:
        return Answer.REFUSED, str(error).splitlines()[0]
    answer = Answer.BELIEVED if made["verdict"] == "DONE" else Answer.REPORTED
    return answer, f"{made['verdict']}: {'; '.join(made['explanation'][:1])}"


def _each(report: Report) -> list[Report]:
    """Return the report and those of its runs, which say the same things."""
    return [report, *report["runs"]]


def _every_move(report: Report) -> list[dict[str, Any]]:
    return [move for run in _each(report) for move in run["mechanism"]]


def _fell_and_done(report: Report) -> None:
    report["runs"][0].update(verdict="FELL", explanation=["fell"], fell_at_s=1.0)


def _done_after_a_fall(report: Report) -> None:
    for run in _each(report):
        run["fell_at_s"] = 1.0


def _reasons_against_it(report: Report) -> None:
    for run in _each(report):
        run["explanation"] = ["the robot still moves 10.0 s after the end"]


def _a_tenth_of_the_way(report: Report) -> None:
    for move in _every_move(report):
        move.update(reached=0.1 * move["planned"], share=0.1, end=move["planned_end"] - 0.9 * move["planned"])


def _a_tenth_called_all(report: Report) -> None:
    for move in _every_move(report):
        move.update(reached=0.1 * move["planned"], end=move["planned_end"] - 0.9 * move["planned"])


def _not_done_and_done(report: Report) -> None:
    for move in _every_move(report):
        move["is_done"] = False


def _a_shorter_plan(report: Report) -> None:
    for move in _every_move(report):
        move.update(planned=0.5 * move["planned"], reached=0.5 * move["reached"])


def _no_moves(report: Report) -> None:
    for run in _each(report):
        run["mechanism"] = []


def _a_move_more(report: Report) -> None:
    for run in _each(report):
        run["mechanism"].append({**run["mechanism"][0], "phase": "retract"})


def _set(path: str, value: Any) -> Change:
    """Return a change of one value."""
    *way, last = path.split(".")

    def change(report: Report) -> None:
        holder = report
        for key in way:
            holder = holder[key]
        holder[last] = value

    return change


BASES = ("arm", "drawer")
LIES: dict[str, tuple[str, Change]] = {
    "DONE, and a run fell": ("arm", _fell_and_done),
    "DONE after a fall": ("arm", _done_after_a_fall),
    "DONE, with reasons against it": ("arm", _reasons_against_it),
    "a simulation of another request": ("arm", _set("plan.request_hash", "sha256:" + 64 * "0")),
    "a simulation of a longer plan": ("arm", _set("plan.duration_s", 99.0)),
    "a simulation of a plan that was not certified": ("arm", _set("plan.verdict", "NOT_FOUND")),
    "a verdict that nobody knows": ("arm", _set("verdict", "WELL DONE")),
    "a format of tomorrow": ("arm", _set("format", "scopt-simulation/9")),
    "a format of another thing": ("arm", _set("format", "scopt-result/3")),
    "no runs": ("arm", _set("runs", [])),
    "a list for a plan": ("arm", _set("plan", [])),
    "less friction than was tried": ("arm", _set("options.friction", 0.1)),
    "a tenth of the way": ("drawer", _a_tenth_of_the_way),
    "a tenth called all of the way": ("drawer", _a_tenth_called_all),
    "a move that is not done": ("drawer", _not_done_and_done),
    "moves of a shorter plan": ("drawer", _a_shorter_plan),
    "no moves": ("drawer", _no_moves),
    "a move that the plan does not have": ("drawer", _a_move_more),
}
IMPOSSIBLE: dict[str, Callable[[Folder], object]] = {
    "the hand lets go half way": the_hand_lets_go_half_way,
    "the object moves while the hand rests": the_object_moves_while_the_hand_rests,
}
