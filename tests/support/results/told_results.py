"""Results of every kind, made fast: what their pages say is held against their certificates."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from planar_arm import write_planar_arm
from small_plan import small_plan
from trajopt_problems import ARM_FILES, document, term

from costs.curve import TimeLaw
from service.planner import plan
from service.request.file import parse_request
from service.result.result import PlanResult, Verdict
from service.verify import Status, SupportPolygon, VerifySettings, verify

DATA = Path(os.environ.get("SCOPT_DATA", Path(__file__).parents[4] / "shared" / "data"))
PANDA = DATA / "robots" / "panda" / "panda.urdf"
LOW_TABLE = {"name": "table", "type": "box", "size": [0.8, 1.2, 0.04], "position": [0.6, 0.0, 0.2]}
STRAIGHT = {"j0": 0.0, "j1": 0.0, "j2": 0.0}
TURNED = {"j0": 1.5, "j1": 0.0, "j2": 0.0}
POST = {"name": "post", "type": "box", "size": [0.05, 0.05, 0.4], "position": [0.35, 0.35, 0.0]}
# Across the way of the whole arm.
WALL = {"name": "wall", "type": "box", "size": [1.0, 0.15, 0.4], "position": [0.45, 0.45, 0.0],
        "quaternion_wxyz": [0.9238795, 0.0, 0.0, 0.3826834]}  # fmt: skip
BLOCK = {"name": "block", "type": "box", "size": [0.1, 0.1, 0.1], "position": [0.5, 0.06, 0.0]}
TABLE = {"name": "table", "type": "box", "size": [0.5, 1.2, 0.05], "position": [0.75, 0.0, 0.9]}
TABLE_TOP = {"name": "table_top", "type": "box", "size": [0.7, 1.0, 0.04], "position": [0.85, 0.0, 0.85]}
GOAL = [0.1, -0.4, 0.0, 0.9, 0.0, -0.2, 0.0]


def told_results(folder: Path) -> Mapping[str, Callable[[], PlanResult]]:
    """How to make each result, by name; robot files go to ``folder``."""
    urdf = str(write_planar_arm(folder, 3, 0.2, 0.04, limit=3.0))

    def arm(goal: Mapping[str, Any], *obstacles: Mapping[str, Any], **options: Any) -> PlanResult:
        stop = options.pop("should_stop", None)
        scene = {"obstacles": list(obstacles), "floor": False}
        goal = goal if "poses" in goal else {"joints": dict(goal)}
        start = {"joints": STRAIGHT}
        data = {"robot": {"urdf": urdf}, "start": start, "scene": scene, "goal": goal, "options": options}
        return plan(parse_request(data), should_stop=stop)

    def tool(*position: float) -> dict[str, Any]:
        return {"poses": [{"link": "l2", "position": list(position)}]}

    return {
        "free": lambda: arm(TURNED),
        "past a post": lambda: arm({**TURNED, "j1": 0.3}, POST),
        "past a post, untimed": lambda: arm({**TURNED, "j1": 0.3}, POST, timed=False),
        "past a post, proof cut short": lambda: _proof_cut_short(arm({**TURNED, "j1": 0.3}, POST)),
        "through a wall": lambda: arm(TURNED, WALL, starts=1),
        "through a wall, untimed": lambda: arm(TURNED, WALL, starts=1, timed=False),
        "through a wall, late": lambda: _late(arm(TURNED, WALL, starts=1)),
        "late before anything": lambda: arm(TURNED, WALL, time_limit_s=1e-3),
        "cancelled": lambda: arm(TURNED, WALL, should_stop=lambda: True),
        "into a wall": lambda: arm({**TURNED, "j0": 0.8}, WALL),
        "out of reach": lambda: arm(tool(0.9, 0.2, 0.0)),
        "to a place in a block": lambda: arm(tool(0.2, 0.3, 0.0), {**BLOCK, "position": [0.2, 0.3, 0.0]}),
        "out of a block": lambda: arm({**TURNED, "j0": -1.0}, BLOCK, escape=True),
        "out of a block, forbidden": lambda: _without_allowances(arm({**TURNED, "j0": -1.0}, BLOCK, escape=True)),
        "an arm over a table": lambda: _problem(document(constraints=[term("joint", vals=GOAL)], n_steps=6)),
        "an arm into a table": lambda: _problem(
            document(constraints=[term("joint", vals=[0, 0.2, 0, 0.2, 0, 0, 0])], n_steps=6)
        ),
        "atlas waves": lambda: _atlas({"joints": {"l_arm_elx": 1.2, "r_arm_elx": -1.2}}),
        "atlas settles": lambda: _atlas({"joints": {"l_arm_elx": 1.2}}, balance_margin_m=0.128),
        "atlas in a table": lambda: _atlas({"poses": [{"link": "l_tool", "position": [0.75, 0.0, 0.9]}]}, TABLE),
        "atlas far away": lambda: _atlas({"poses": [{"link": "l_tool", "position": [3.6, 0.2, 1.15]}]}),
        "a wheel": small_plan,
        "a wheel, too fast": lambda: _judged(_faster(small_plan(), 25.0)),
        "a wheel, leaning": lambda: _judged(_on_narrow_feet(small_plan())),
        **(_panda_results() if PANDA.is_file() else {}),
    }


def _panda_results() -> dict[str, Callable[[], PlanResult]]:
    def panda(goal: Mapping[str, Any]) -> PlanResult:
        start = {"joints": {"panda_joint4": -1.5, "panda_joint6": 1.5}}
        scene = {"obstacles": [LOW_TABLE], "floor": False}
        return plan(parse_request({"robot": {"urdf": str(PANDA)}, "start": start, "scene": scene, "goal": goal}))

    def hand(*position: float) -> dict[str, Any]:
        return {"poses": [{"link": "panda_hand", "position": list(position)}]}

    return {
        "panda turns": lambda: panda({"joints": {"panda_joint1": 0.8}}),
        "panda reaches": lambda: panda(hand(0.5, 0.2, 0.4)),
        "panda in a table": lambda: panda(hand(0.6, 0.0, 0.2)),
    }


def _atlas(goal: Mapping[str, Any], *obstacles: Mapping[str, Any], **options: Any) -> PlanResult:
    scene = {"obstacles": list(obstacles)}
    return plan(parse_request({"robot": {"name": "atlas"}, "scene": scene, "goal": goal, "options": options}))


def _problem(data: Mapping[str, Any]) -> PlanResult:
    scene = {"obstacles": [TABLE_TOP]}
    return plan(parse_request({"robot": ARM_FILES, "scene": scene, "task": {"trajopt": data}}))


def _judged(result: PlanResult, settings: VerifySettings | None = None) -> PlanResult:
    """The result with a certificate made anew and the verdict that follows from it."""
    assert result.motion is not None
    certificate = verify(result.motion, settings)
    verdict = {
        Status.CERTIFIED: Verdict.CERTIFIED,
        Status.FEASIBLE_AT_SAMPLES: Verdict.FEASIBLE_AT_SAMPLES,
        Status.VIOLATED: Verdict.NOT_FOUND,
    }[certificate.status]
    return replace(result, verdict=verdict, certificate=certificate)


def _proof_cut_short(result: PlanResult) -> PlanResult:
    return _judged(result, VerifySettings(max_halvings=0))


def _late(result: PlanResult) -> PlanResult:
    """As a time limit leaves it: the best attempt, verified."""
    return replace(result, verdict=Verdict.TIME_LIMIT, explanation=("the time limit of 1 s was reached",))


def _without_allowances(result: PlanResult) -> PlanResult:
    assert result.motion is not None
    phases = tuple(replace(phase, allowances=()) for phase in result.motion.phases)
    return _judged(replace(result, motion=replace(result.motion, phases=phases)))


def _faster(result: PlanResult, factor: float) -> PlanResult:
    assert result.motion is not None
    assert result.motion.law is not None
    law = result.motion.law
    faster = TimeLaw(law.times / factor, law.path, law.speed * factor)
    return replace(result, motion=replace(result.motion, law=faster))


def _on_narrow_feet(result: PlanResult) -> PlanResult:
    """The support polygon shrunk to where the centre of mass is outside."""
    assert result.motion is not None
    phases = []
    for phase in result.motion.phases:
        assert phase.support is not None
        polygon = phase.support.polygon
        corner = polygon[np.argmax(polygon.sum(axis=1))]
        phases.append(replace(phase, support=SupportPolygon(corner + 0.3 * (polygon - corner), phase.support.margin_m)))
    return replace(result, motion=replace(result.motion, phases=tuple(phases)))
