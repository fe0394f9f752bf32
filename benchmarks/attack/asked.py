"""Every field of what a request asks for, falsified one at a time under a motion that answers the honest request.

Nothing here knows what a field means.  The motion is the honest one; a certificate for the changed request must not
be given, unless the change asks for less, or for nothing of the motion.
"""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack import bases, judges
from benchmarks.attack.fields import (
    BASES,
    MOST_PLACES,
    MOST_S,
    Change,
    Kind,
    Steps,
    list_changes,
    read_at,
    remembering,
    walk,
)
from benchmarks.attack.forgery import Folder, Level
from benchmarks.attack.outcome import Answer, Attack
from service.errors import RequestError
from service.request.file import parse_request
from service.request.schema import PlanRequest

GANTRIES = ("carried", "peg", "blends", "stack", "follower", "handover")
DIRECTIONS = ("axis", "direction", "normal", "tilt_towards")  # of any length
LESS = {  # a change of a kind of field, after a base where it is of that base alone, and why it may be believed
    "robot.name": "the verdict says that it rests on the robot in the folder",
    "robot.urdf otherwise": "the same",
    "robot.srdf": "the same",
    "split: robot.decompose": "the same",
    "cart: robot.root null": "the same, whose files may have joints of a base",
    "region: goal.poses.*.rotation_tolerance_deg": "of a region alone, which demands no orientation",
    "region: keep.*.rotation_tolerance_deg": "the same",
    "scene.cloud otherwise": "the verdict says that it rests on the recorded scene",
    "scene.apply_viewpoint": "of clouds",
    "scene.message": "of clouds",
    "options.time_limit_s": "effort of the planner",
    "options.seed": "the same",
    "options.starts": "the same",
    "options.escape": "the same",
    "options.margin_m": "aim of the planner; clearance_m is proven",
    "options.velocity_scale": "a slow motion keeps less too; other attacks ask for a tenth",
    "options.acceleration_scale": "the same",
    "options.balance_margin_m": "of robots that stand; other attacks ask for more",
    "task.pick_place.opening_m": "choice of the planner, which proves that the fingers have room",
    "task.steps.*.grasp.opening_m": "the same",
    "task.steps.*.release.opening_m": "the same",
    "task.steps.*.touch.force_n smaller": "what bears the larger force bears it",
    "touches: task.steps with its last twice": "a plan ends with a touch",
    "peg: task.steps.*.move.": "errors along a way that is free; the goal has tolerances of its own",
    "handover: task.steps.*.move.rotation_tolerance_deg": "the same",
    "handover: task.steps.*.move.poses.*.rotation_tolerance_deg smaller": "what is put down is level anyhow",
    "handover: robot.hands.left.peg_radius_m": "a hand without a peg",
    **{f"{base}: robot.hands.right.peg_radius_m": "a hand without a peg" for base in GANTRIES},
    "lever: task.valve.spoke_width_m": "of wheels",
    "paths: task.steps.*.follow.tilt_towards": "of a path without tilt, or along the normal",
    "stair: task.contacts.stances.*.make.left_foot.slack_m larger": "leaves more room for the foot's place",
    "egress: robot.contacts.left_forearm": "of a contact that comes after the first foot is out",
    "pushes: task.steps.*.mechanism.handle.place.0": "along the normal on which the hand is brought to the leaf",
    "walk: task.steps.*.walk.stride_m smaller": "the same number of strides",
    "door: task.door.press_m": "of push bars; this door has a lever",
    "door: task.door.push_bar_n": "the same",
}
LESS_ENDS = ("tolerance_m larger", "tolerance_deg larger", "pieces with its last twice")
SECTIONS = ("robot", "start", "goal", "keep", "attached", "scene", "task", "options")


def attacks(seed: int = 0, most: int | None = None) -> list[Attack]:
    """Return one attack for each base: an edit of every kind of field of its request, none of which may be believed.

    Args:
        seed: chooses place and edit of each kind, and the kinds where there are more than ``most``.
        most: kinds of fields of a base that are falsified; None for all.
    """
    return [
        Attack("asked", base, partial(_attack, base, seed, most), base == "arm", MOST_S)
        for base in ("arm", "carried", *BASES)
    ]


def _attack(base: str, seed: int, most: int | None, scratch: Path) -> tuple[Answer, str]:
    """Edit every kind of field; the answer names the fields whose edit is believed."""
    folder = bases.original(base)
    honest = json.loads((folder / "result" / "result.json").read_text(encoding="utf-8"))["request"]
    rng = random.Random(f"{seed} {base} asked")
    edits = list(_list_edits(base, honest, folder, rng))
    chosen = edits if most is None else rng.sample(edits, min(len(edits), most))
    believed = []
    for index, (steps, name, change) in enumerate(chosen):
        edited = Folder(bases.copy_of(base, scratch / str(index)))
        _put(edited.request, steps, change)
        with remembering():
            edited.save(Level.FITTED)
            answer, _ = judges.verify(edited.path)
        if answer is Answer.BELIEVED:
            believed.append(f"{'.'.join(map(str, steps))} {name}")
    text = f"{len(chosen)} told" + (f", {len(believed)} believed: {'; '.join(believed)}" if believed else "")
    return (Answer.BELIEVED if believed else Answer.REFUSED), text


def _list_edits(
    base: str, honest: dict[str, Any], folder: Path, rng: random.Random
) -> Iterator[tuple[Steps, str, Change]]:
    """Yield path, name and change of an edit of every kind of field that is still a request, and another one."""
    before = _parse(honest, folder)
    kinds: dict[str, Kind] = {}
    for steps, _ in walk(honest, ()):
        name = ".".join("*" if isinstance(step, int) else step for step in steps)
        if steps and steps[0] in SECTIONS:
            kinds.setdefault(name, Kind(name)).places.append(steps)
    for kind in kinds.values():
        edits = [
            (steps, name, change)
            for steps in rng.sample(kind.places, min(len(kind.places), MOST_PLACES))
            for name, change in list_changes(read_at(honest, steps)).items()
            if not _is_less(base, f"{kind.name} {name}")
        ]
        rng.shuffle(edits)
        for steps, name, change in edits:
            data = copy.deepcopy(honest)
            _put(data, steps, change)
            asked = _parse(data, folder)
            if asked is not None and asked != before and not _is_same_way(honest, data, steps):
                yield steps, name, change
                break


def _put(data: Any, steps: Steps, change: Change) -> None:
    *way, last = steps
    holder = read_at(data, tuple(way))
    holder[last] = change(holder[last])


def _parse(data: dict[str, Any], folder: Path) -> PlanRequest | None:
    """Return the request of plain data, or None where it is refused."""
    try:
        return parse_request(copy.deepcopy(data), folder)
    except RequestError:
        return None


def _is_less(base: str, edit: str) -> bool:
    """Whether an edit, kind of field and change, asks for less than before, or for nothing of the motion."""
    return edit.endswith(LESS_ENDS) or any(text.startswith(tuple(LESS)) for text in (edit, f"{base}: {edit}"))


def _is_same_way(honest: dict[str, Any], edited: dict[str, Any], steps: Steps) -> bool:
    """Whether a component of a direction was changed so that only its length differs."""
    if len(steps) < 2 or steps[-2] not in DIRECTIONS:
        return False
    before, after = (np.asarray(read_at(data, steps[:-1]), dtype=float) for data in (honest, edited))
    return bool(np.allclose(before / np.linalg.norm(before), after / np.linalg.norm(after)))
