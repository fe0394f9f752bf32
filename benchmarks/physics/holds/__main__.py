"""Random holds: planned, carried out in physics at both ends of the hands' friction, and compared.

``python -m benchmarks.physics.holds [--count N] [--seed S] [--first K] [--time-limit T] [--out FOLDER] [--only KIND]``

Holds are pegs on any side of bars that slide or turn, tips on buttons, pegs under hatches, rings on sliding carriers,
hooks and grippers on wheels, and doors, moved in either direction; a third of them cannot work.  The table has one line
per hold: verdict of the plan, angles between the rod's normal and the load, the friction with which a single force in
the contact's cone would do, and verdict and least share of travel in physics at each friction.  ``--out`` keeps
request and figures of each hold, so that two versions of the planner can be compared (``--against FOLDER``): what the
one certifies and physics does, and the other refuses.
"""

from __future__ import annotations

import argparse
import copy
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks.physics.holds.draws import Draw, make_draws
from benchmarks.physics.holds.faces import list_faces
from benchmarks.tables import print_table
from benchmarks.tasks.given import stand
from service.demands.kind import read_mechanism_physics
from service.errors import ServiceError
from service.planner import plan
from service.request.file import parse_request, request_hash
from service.request.schema import PlanRequest
from service.result.result import PlanResult, Verdict
from service.simulation.report import make_report
from service.simulation.run import execute_motion
from service.tasks.stances.search import find_stance

TIME_LIMIT_S, STANCE_LIMIT_S = 20.0, 20.0
HEADER = ("hold", "plan", "normal to load [deg]", "needs friction", "physics", "share of travel", "why")


@dataclass(frozen=True)
class Outcome:
    """What became of a hold.

    Attributes:
        number, kind: of the draw.
        verdict: of the plan; ERROR where the request is refused.
        why: first sentence of the plan's explanation, or of the worst run in physics.
        stiffer: whether the plan needs stiffer servos where, other than here, no torques are fed forward.
        angles: least and greatest angle between normal and load [deg]; None without a rod.
        friction: greatest coefficient that one force at the contact needs; None where unknown.
        runs: by friction of the hand the verdict in physics and the least share of a move.
        seconds: processor time of plan and physics.
    """

    number: int
    kind: str
    verdict: str
    why: str = ""
    stiffer: bool = False
    angles: tuple[float, float] | None = None
    friction: float | None = None
    runs: tuple[tuple[float, str, float], ...] = ()
    seconds: float = 0.0

    @property
    def is_done(self) -> bool:
        """Whether the hold works in physics at every friction."""
        return bool(self.runs) and all(verdict == "DONE" for _, verdict, _ in self.runs)


def run_draw(draw: Draw, time_limit_s: float) -> Outcome:
    """Plan a hold and carry it out."""
    began = time.process_time()
    try:
        request = make_request(draw, time_limit_s)
        result = plan(request)
    except ServiceError as error:
        return Outcome(draw.number, draw.kind, "ERROR", str(error).splitlines()[0])
    why = next(iter(result.explanation), "")
    if result.verdict is not Verdict.CERTIFIED or result.motion is None:
        return Outcome(
            draw.number, draw.kind, result.verdict.value, why, seconds=time.process_time() - began
        )  # fmt: skip
    return measure(draw, result, began)


def make_request(draw: Draw, time_limit_s: float) -> PlanRequest:
    """Return the request of a hold, from a place to stand where it needs one."""
    data = copy.deepcopy(draw.request)
    data["options"] = {"time_limit_s": time_limit_s}
    request = parse_request(data)
    return stand(request, find_stance(request, STANCE_LIMIT_S)) if draw.needs_place else request


def measure(draw: Draw, result: PlanResult, began: float) -> Outcome:
    """Carry out a certified plan, and measure its contacts."""
    assert result.motion is not None
    executions = execute_motion(
        result.motion, result.request, result.verdict.value, request_hash(result.request)
    )  # fmt: skip
    made, _ = make_report(executions)
    physics = read_mechanism_physics(result.request)
    names = result.motion.robot.joint_names[result.motion.robot.n - len(executions[0].reference.mechanism_names) :]
    frictions = {name: physics.joints[name].friction if name in physics.joints else 0.0 for name in names}
    faces = list(list_faces(result.motion, frictions))
    runs = tuple(
        (run["hand_friction"], run["verdict"], min((move["share"] for move in run["mechanism"]), default=0.0))
        for run in made["runs"]
    )
    return Outcome(
        draw.number,
        draw.kind,
        result.verdict.value,
        next(iter(made["explanation"]), ""),
        any("needs torque feed-forward" in line for line in (*result.explanation, *result.notes)),
        (min(face.angle for face in faces), max(face.angle for face in faces)) if faces else None,
        max((face.friction for face in faces), default=None),
        runs,
        time.process_time() - began,
    )


def list_row(outcome: Outcome) -> tuple[str, ...]:
    """Return the cells of one hold."""
    angles = "" if outcome.angles is None else f"{outcome.angles[0]:.0f} to {outcome.angles[1]:.0f}"
    return (
        f"{outcome.number} {outcome.kind}",
        outcome.verdict + (" (stiffer)" if outcome.stiffer else ""),
        angles,
        "" if outcome.friction is None else f"{outcome.friction:.2f}",
        ", ".join(f"{friction:g} {verdict}" for friction, verdict, _ in outcome.runs),
        ", ".join(f"{100.0 * share:.0f} %" for _, _, share in outcome.runs),
        outcome.why[:110],
    )


def write_outcome(folder: Path, draw: Draw, outcome: Outcome) -> None:
    """Keep request and outcome of a hold."""
    folder.mkdir(parents=True, exist_ok=True)
    data = {**asdict(outcome), "request": draw.request}
    (folder / f"hold_{draw.number:04d}.json").write_text(json.dumps(data))


def compare(outcomes: Sequence[Outcome], folder: Path) -> list[str]:
    """Return a line per hold that another version of the planner certified, that physics does, and that is refused."""
    lines = []
    for outcome in outcomes:
        path = folder / f"hold_{outcome.number:04d}.json"
        other: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
        was_done = bool(other.get("runs")) and all(verdict == "DONE" for _, verdict, _ in other["runs"])
        if was_done and outcome.verdict != "CERTIFIED":
            lines.append(f"{outcome.number} {outcome.kind}: {outcome.verdict} {outcome.why}")
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, plan, carry out and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.physics.holds", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first hold")
    parser.add_argument("--time-limit", type=float, default=TIME_LIMIT_S)
    parser.add_argument("--only", default="", help="kinds whose name contains this")
    parser.add_argument("--out", type=Path, help="folder for request and figures of each hold")
    parser.add_argument("--against", type=Path, help="such a folder of another version of the planner")
    given = parser.parse_args(arguments)
    outcomes: list[Outcome] = []
    for draw in islice(make_draws(given.seed), given.first, given.first + given.count):
        if given.only not in draw.kind:
            continue
        outcomes.append(run_draw(draw, given.time_limit))
        print("  ".join(list_row(outcomes[-1])), flush=True)
        if given.out is not None:
            write_outcome(given.out, draw, outcomes[-1])
    print_table(f"Random holds of seed {given.seed}", HEADER, [list_row(outcome) for outcome in outcomes])
    certified = [outcome for outcome in outcomes if outcome.verdict == "CERTIFIED"]
    done = sum(o.is_done for o in certified)
    print(f"\n{len(outcomes)} holds: {len(certified)} certified, {done} of them done, {len(certified) - done} not")
    if given.against is not None:
        lines = compare(outcomes, given.against)
        print(f"{len(lines)} refused although the other planner's hold is done in physics")
        print("\n".join(f"  {line}" for line in lines))
    print(f"{sum(o.seconds for o in outcomes):.0f} s of processor time")


if __name__ == "__main__":
    main()
