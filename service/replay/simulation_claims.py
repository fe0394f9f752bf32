"""What a folder's ``simulation.json`` says, against itself and against the plan; physics is not computed anew."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from service.errors import shown
from service.result.folder import SIMULATION_NAME
from service.verify import Motion, list_phases

NAME, VERSIONS = "scopt-simulation", (1, 2)
FORMAT = f"{NAME}/{VERSIONS[-1]}"
Verdict = Literal["DONE", "STOOD", "FELL"]
DONE: Verdict = "DONE"
STOOD: Verdict = "STOOD"
FELL: Verdict = "FELL"
WORSE = (DONE, STOOD, FELL)
TRAVEL_SHARE = 0.05  # of a planned travel, by which a joint may fall short
LEAST_TRAVEL = 1e-3  # of a joint that counts as moved [rad, m]
SAME = 1e-3  # difference of two values that are the same [rad, m, s, 1]


def check_simulation(folder: Path, data: Mapping[str, Any], motion: Motion) -> list[str]:
    """Return a sentence for each thing that the folder's simulation says and that contradicts itself or the plan.

    Args:
        folder: with the file.
        data: content of ``result.json``.
        motion: the plan's.
    """
    try:
        made = json.loads((folder / SIMULATION_NAME).read_bytes())
        problems = list(_check(made, data, motion))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        problems = ["is no report of a simulation"]
    return [f"{SIMULATION_NAME}: {problem}" for problem in problems]


def _check(made: Mapping[str, Any], data: Mapping[str, Any], motion: Motion) -> Iterator[str]:
    if made["format"] not in {f"{NAME}/{version}" for version in VERSIONS}:
        yield f"format {shown(made['format'])}; expected {FORMAT}"
        return
    plan = made["plan"]
    for key in ("request_hash", "verdict"):
        if plan[key] != data[key]:
            yield f"plan.{key} is {shown(plan[key])}; the result has {shown(data[key])}"
    duration = float(data["trajectory"]["times"][-1])
    if not abs(float(plan["duration_s"]) - duration) <= SAME:
        yield f"plan.duration_s is {float(plan['duration_s']):.3f}; the result has {duration:.3f}"
    if made["format"] != FORMAT:
        return  # its words and measures were other ones
    runs: Sequence[Mapping[str, Any]] = made["runs"]
    worst = max((run["verdict"] for run in runs), key=WORSE.index)
    if made["verdict"] != worst:
        yield f"the verdict is {shown(made['verdict'])}; the worst of its runs is {worst}"
    moves = {} if worst == FELL else _list_moves(motion)
    for run in ({**made, "hand_friction": None}, *runs):
        yield from check_run(run, moves, {release.latch for release in motion.releases})


def check_run(run: Mapping[str, Any], moves: Mapping[tuple[str, str], float], latches: set[str]) -> Iterator[str]:
    """Yield what contradicts in one run, given the travels of the plan by phase and joint."""
    where = "" if run["hand_friction"] is None else f"hand friction {run['hand_friction']:g}: "
    has_fallen = run["fell_at_s"] is not None
    if has_fallen and run["verdict"] != FELL:
        yield f"{where}{run['verdict']}, and it fell at {run['fell_at_s']:.2f} s"
    if (run["verdict"] == DONE) == bool(run["explanation"]):
        yield f"{where}{run['verdict']}, with {len(run['explanation'])} reasons against it"
    told = {(move["phase"], move["joint"]): move for move in run["mechanism"]}
    missing = [] if run["verdict"] == FELL else [key for key in moves if key not in told]
    for phase, joint in missing:
        yield f"{where}says nothing of {joint} in phase '{phase}', where the plan moves it"
    for (phase, joint), move in told.items():
        name, planned = f"{where}{joint} in phase '{phase}'", float(move["planned"])
        if moves and not abs(planned - moves.get((phase, joint), np.inf)) <= SAME:
            yield f"{name}: planned {planned:.4g}; the plan has {moves.get((phase, joint), 0.0):.4g}"
        if not abs(float(move["share"]) - float(move["reached"]) / planned) <= SAME:
            yield f"{name}: share {move['share']:.3f}; {move['reached']:.4g} of {planned:.4g} were reached"
        off = np.sign(planned) * (float(move["end"]) - float(move["planned_end"]))
        is_short = (
            float(move["share"]) < 1.0 - TRAVEL_SHARE
            and not abs(off) <= TRAVEL_SHARE * abs(planned)
            and joint not in latches
        )
        if move["is_done"] and is_short:
            yield f"{name}: done, with {100.0 * move['share']:.0f} % of its travel"
        if run["verdict"] == DONE and not move["is_done"]:
            yield f"{name}: not done, and the verdict is {DONE}"


def _list_moves(motion: Motion) -> dict[tuple[str, str], float]:
    """Return the signed travel of each joint of the mechanism, by phase and joint, where it moves [rad, m]."""
    model, moves = motion.robot.model, {}
    joints = [str(model.names[body.joint]) for body in motion.robot.bodies if body.link in motion.mechanism_links]
    for phase in list_phases(motion):
        first, last = motion.curve(np.array([phase.first, phase.last]))
        for joint in dict.fromkeys(joints):
            column = int(model.joints[model.getJointId(joint)].idx_q)
            if abs(last[column] - first[column]) >= LEAST_TRAVEL:
                moves[phase.name, joint] = float(last[column] - first[column])
    return moves
