"""All edits of result folders, and false data that only the user's own request or scan reveals."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.attack import bases, judges
from benchmarks.attack.edits_carried import CARRIED
from benchmarks.attack.edits_certificate import CERTIFICATE
from benchmarks.attack.edits_contacts import CONTACTS
from benchmarks.attack.edits_holds import HOLDS
from benchmarks.attack.edits_invented import INVENTED
from benchmarks.attack.edits_lever import LEVER
from benchmarks.attack.edits_motion import MOTION
from benchmarks.attack.edits_pace import PACE
from benchmarks.attack.edits_promises import PROMISES
from benchmarks.attack.edits_rare import RARE_EDITS
from benchmarks.attack.edits_request import REQUEST
from benchmarks.attack.edits_stances import STANCES
from benchmarks.attack.edits_world import WORLD
from benchmarks.attack.forgery import Edit, Level
from benchmarks.attack.outcome import Answer, Attack

ABSENT = object()
STRANGERS = (
    "arm",
    "untimed",
    "program",
    "reach",
    "carry",
    "valve",
    "lever",
    "gripper",
    "drawer",
    "door",
    "steps",
    "chair",
    "stair",
    "egress",
    "resume",
    "compliant",
)
QUICK = ("arm", "reach", "carry")
REPLANNED = ("drawer", "door", "lever", "stair", "chair", "carry")
HAND_POSE = {"link": "l_hand", "position": [0.55, 0.25, 1.2], "position_tolerance_m": 0.05}


def attacks() -> list[Attack]:
    """Return edits by kind, texts that are not valid results, replaced files, and scans of something else."""
    edits: list[Edit] = [
        edit
        for registry in (
            CARRIED,
            CERTIFICATE,
            REQUEST,
            PROMISES,
            CONTACTS,
            HOLDS,
            INVENTED,
            LEVER,
            STANCES,
            WORLD,
            MOTION,
            PACE,
            RARE_EDITS,
        )
        for edit in registry.edits
    ]
    return [
        *(attack for edit in edits for attack in edit.attacks()),
        *(Attack("folders", f"arm: {name}", _spoil(change)) for name, change in TEXTS.items()),
        *(
            Attack("request", f"{base}: {name}", _substitute(base, change), name in SHORT)
            for name, (base, change) in SUBSTITUTES.items()
        ),
        *(
            Attack("request", f"arm: {edit.name}, held against the user's request", partial(_with_request, edit), False)
            for edit in WORLD.edits
            if edit.bases[0] == "arm" and edit.level is Level.REMADE
        ),
        *(
            Attack("request", f"{base}: the user's own request", _own(base), base in QUICK)
            for base in ("arm", "reach", "valve", "carry", "drawer", "door", "stair", "resume", "compliant")
        ),
        *(Attack("harmless", f"{base}: planned anew", _plan_anew(base), False) for base in REPLANNED),
        Attack("request", "scan: another scan", _another_scan, False),
        Attack("request", "scan: the user's own scan", _own_scan, False),
        Attack("harmless", "arm: white space changed", _indent),
        *(Attack("stranger", f"{base}: as it is", _as_it_is(base), False) for base in STRANGERS),
    ]


TEXTS: dict[str, Callable[[str], str]] = {
    "NaN among the samples": lambda text: text.replace('"positions": [[', '"positions": [[NaN, ', 1),
    "infinity by overflow": lambda text: text.replace('"tangents": [[', '"tangents": [[1e999, ', 1),
    "a key given twice": lambda text: text[:-1] + ', "verdict": "CERTIFIED", "pieces": []}',
    "cut off": lambda text: text[: len(text) // 2],
    "no JSON": lambda text: "verdict: CERTIFIED",
    "a list": lambda text: f"[{text}]",
    "empty": lambda text: "",
}


def _spoil(change: Callable[[str], str]) -> Callable[[Path], tuple[Answer, str]]:
    def run(scratch: Path) -> tuple[Answer, str]:
        folder = bases.copy_of("arm", scratch)
        path = folder / "result.json"
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
        return judges.verify(folder)

    return run


def _indent(scratch: Path) -> tuple[Answer, str]:
    folder = bases.copy_of("arm", scratch)
    path = folder / "result.json"
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")), indent=1), encoding="utf-8")
    return judges.harmless(*judges.verify(folder))


# Correct results, submitted as the answer to a request that demands more.
SUBSTITUTES: dict[str, tuple[str, dict[str, Any]]] = {
    "a goal 30 cm away": ("reach", {"goal.poses.0.position": [0.60, 0.25, 1.35]}),
    "a goal with a wide tolerance": ("reach", {"goal.poses.0.position_tolerance_m": 0.1}),
    "without the table": ("reach", {"scene.obstacles.0": ABSENT}),
    "a table 5 cm lower": ("reach", {"scene.obstacles.0.position": [0.75, 0.0, 0.75]}),
    "from another start": ("reach", {"start.posture": "reach_ready"}),
    "with a shorter hook": ("reach", {"robot.tool_distance_m": 0.08}),
    "another goal of the joints": ("arm", {"goal.joints.roll": -0.8}),
    "without the post": ("arm", {"scene.obstacles.0": ABSENT}),
    "twice as fast": ("arm", {"options.velocity_scale": 1.0, "options.acceleration_scale": 1.0}),
    "untimed": ("arm", {"options.timed": False}),
    "half the turn": ("valve", {"task.valve.turn_deg": 30.0}),
    "turned the other way": ("valve", {"task.valve.turn_deg": -60.0}),
    "a valve 4 mm lower": ("valve", {"task.valve.centre": [0.75, 0.15, 1.146]}),
    "with a loosely kept pose": ("carry", {"keep.0.position_tolerance_m": 0.05, "keep.0.rotation_tolerance_deg": 10.0}),
    "without the beam": ("carry", {"attached": ABSENT, "goal.poses.0": HAND_POSE}),
    "a lighter beam": ("carry", {"attached.0.mass_kg": 0.0}),
    "a drawer that runs lightly": ("drawer", {"task.mechanism.joints.slide.friction": 3.0}),
    "a drawer that is half open": ("drawer", {"task.mechanism.moves.0.to": 0.12}),
    "a drawer 4 mm nearer": ("drawer", {"task.mechanism.position": [0.746, -0.25, 0]}),
    "hands that hold better": ("drawer", {"options.hand_friction": [0.5, 0.6]}),
    "stiffer servos": ("drawer", {"robot.servo": {"stiffness": {"r_arm_elx": 9000.0}}}),
    "a lever that turns lightly": ("door", {"task.door.lever_nm": 0.5}),
    "a door that is less open": ("door", {"task.door.open_deg": 45.0}),
    "a step with another friction": ("stair", {"task.contacts.surfaces.step.friction": 0.55}),
    "half the turn of the gripper": ("gripper", {"task.valve.turn_deg": 30.0}),
}


SHORT = (
    "a goal 30 cm away",
    "without the table",
    "another goal of the joints",
    "twice as fast",
    "untimed",
)


def _substitute(base: str, changes: dict[str, Any]) -> Callable[[Path], tuple[Answer, str]]:
    def run(scratch: Path) -> tuple[Answer, str]:
        request = bases.request_of(base, bases.original(base) / "files")
        for path, value in changes.items():
            _set(request, path.split("."), value)
        bases.write_plan(request, scratch)
        return judges.verify(scratch / "result", request=bases.original(base) / "request.yaml")

    return run


def _set(data: Any, path: list[str], value: object) -> None:
    """Set a value at a path in nested data; ``ABSENT`` removes the value there."""
    *way, last = path
    for step in way:
        data = data[int(step)] if isinstance(data, list) else data.setdefault(step, {})
    if value is ABSENT:
        data.pop(int(last) if isinstance(data, list) else last)
    elif isinstance(data, list):
        data[int(last)] = value
    else:
        data[last] = value


def _as_it_is(base: str) -> Callable[[Path], tuple[Answer, str]]:
    """Check that the independent program confirms an unedited folder."""

    def run(scratch: Path) -> tuple[Answer, str]:
        answer, text = judges.ask_stranger(bases.copy_of(base, scratch))
        if answer is Answer.BELIEVED:
            return Answer.TRUE, "the stranger confirms the certificate"
        return answer if answer is Answer.CRASHED else Answer.ALARM, text

    return run


def _with_request(edit: Edit, scratch: Path) -> tuple[Answer, str]:
    """Verify an edited folder of the arm against the user's own request."""
    return edit.run(
        "arm", scratch, lambda folder: judges.verify(folder, request=bases.original("arm") / "request.yaml")
    )


def _plan_anew(base: str) -> Callable[[Path], tuple[Answer, str]]:
    """Plan with another seed: the plan answers the user's request as well."""

    def run(scratch: Path) -> tuple[Answer, str]:
        request = bases.request_of(base, bases.original(base) / "files")
        _set(request, ["options", "seed"], 7)
        verdict = bases.write_plan(request, scratch)
        if verdict != judges.CERTIFIED:
            return Answer.REPORTED, f"no plan to compare: {verdict}"
        return judges.harmless(*judges.verify(scratch / "result", request=bases.original(base) / "request.yaml"))

    return run


def _own(base: str) -> Callable[[Path], tuple[Answer, str]]:
    def run(scratch: Path) -> tuple[Answer, str]:
        folder = bases.copy_of(base, scratch)
        return judges.harmless(*judges.verify(folder, request=bases.original(base) / "request.yaml"))

    return run


def _another_scan(scratch: Path) -> tuple[Answer, str]:
    """Replace the scan of a valve by the scan of a door."""
    scan = scratch / "scan.pcd"
    shutil.copyfile(bases.ROOT / "examples" / "data" / "door_scan.pcd", scan)
    return judges.verify(bases.copy_of("scan", scratch), cloud=scan)


def _own_scan(scratch: Path) -> tuple[Answer, str]:
    scan = bases.original("scan") / "files" / "scan.pcd"
    return judges.harmless(*judges.verify(bases.copy_of("scan", scratch), cloud=scan))
