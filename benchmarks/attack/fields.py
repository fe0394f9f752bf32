"""Every field of what a result promises and claims, falsified one at a time, with hashes that fit.

Nothing here knows what a field means: a number is made larger or smaller, a text gets one more letter, an entry is left
out or given twice, a value is null.  The certificate stays the honest one, so that only a comparison with the request,
or with the motion, reveals the edit.  Fields of equal entries (contacts, phases, bodies) are one kind, of which chance
chooses one, and one edit of it; another base has others.
"""

from __future__ import annotations

import json
import pickle
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any, cast
from unittest import mock

from benchmarks.attack import bases, forgery, judges
from benchmarks.attack.forgery import Folder, Level
from benchmarks.attack.outcome import Answer, Attack
from benchmarks.attack.rare_bases import RARE
from costs.robot import RobotModel, Root, load_robot
from service.replay import replay
from service.verify import Certificate, Motion, bodies_hash, robot_hash, scene_hash, verify

BASES = (
    "drawer",
    "door",
    "lever",
    "valve",
    "gripper",
    "steps",
    "stair",
    "chair",
    "egress",
    "carry",
    "reach",
    "resume",
    "compliant",
    "moves",
    "peg",
    "paths",
    "presses",
    "touches",
    "walk",
    "moving",
    *RARE,
)
GROUPS = ("pushes", "contacts", "targets", "promises", "mechanism", "certificate", "servo", "others")
FREE = {  # no verdict rests on it
    "timings": "how long it took",
    "planning_time_s": "how long it took",
    "notes": "of the planner",
    "found_from": "of the planner",
    "conflict": "of the planner, where nothing was found",
    "obstruction": "of the planner, where nothing was found",
    "pose_graph": "of the planner, where nothing was found",
    "cloud": "a picture",
    "robot.name": "of the bundled robot, whose files are in the folder",
}
ELSEWHERE = {  # attacked by modules of its own
    "request",
    "request_hash",  # and what the forger writes anew
    "certificate",
    "trajectory",
    "curve",
    "bodies",
    "pieces",
    "com",
    "zmp",
    "support_polygons",
    "waypoints",
    "ignored_pairs",
    "robot.sha256",
    "robot.urdf",
    "robot.srdf",
    "robot.package_dirs",
}
UNCOMPARED = (".text", ".where", ".s", ".time_s")  # of checks and pairs: the worst of equal places is free
TRUE = (  # less than is proven, one of several nearest pairs, and a polygon without a corner that is on its edge
    "min_clearance_m smaller",
    "min_balance_margin_m smaller",
    "min_clearance_pair",
    "phases.*.support.polygon without its first",
)
DEFAULT = ("null", "fixed")  # of the base of a robot given by its files: nothing is changed
MOST_PLACES = 8  # of a kind of field, among which chance chooses
MOST_S = 900  # for all edits of a group
SHARE, LEAST = 0.2, 4e-3  # by which numbers are changed

Steps = tuple[str | int, ...]
Change = Callable[[Any], Any]


@dataclass
class Kind:
    """A kind of field of a result.

    Attributes:
        name: its path without indices.
        places: the paths of its fields.
    """

    name: str
    places: list[Steps] = field(default_factory=list)

    @property
    def group(self) -> str:
        """The group that it belongs to."""
        top = self.name.partition(".")[0]
        if top == "phases":
            part = self.name.split(".")[2] if self.name.count(".") > 1 else ""
            named = {"pushes": "pushes", "pressed": "pushes", "contacts": "contacts", "targets": "targets"}
            return named.get(part, "promises")
        if top in ("movables", "releases", "figures", "detections"):
            return "mechanism"
        if top in ("checks", "coverage", "exempt", "min_clearance_m", "min_balance_margin_m"):
            return "certificate"
        return "servo" if top == "servo" else "others"


def attacks(seed: int = 0, most: int | None = None) -> list[Attack]:
    """Return one attack for each base and group of fields: all edits of it, of which none may be believed.

    Args:
        seed: chooses place and edit of each kind, and the kinds where there are more than ``most``.
        most: kinds of fields of a group that are falsified; None for all.
    """
    return [
        Attack(
            "fields",
            f"{base}: {group}",
            partial(_attack, base, group, seed, most),
            (base, group) == ("drawer", "pushes"),
            MOST_S,
        )
        for base in BASES
        for group in GROUPS
    ]


def _attack(base: str, group: str, seed: int, most: int | None, scratch: Path) -> tuple[Answer, str]:
    """Edit every kind of field of a group; the answer names the fields whose edit is believed."""
    told, believed = 0, []
    rng = random.Random(f"{seed} {base} {group}")
    edits = list(_list_edits(base, group, rng))
    chosen = edits if most is None else rng.sample(edits, min(len(edits), most))
    for index, (steps, name, change) in enumerate(chosen):
        told += 1
        if _is_believed(base, steps, change, scratch / str(index)):
            believed.append(f"{'.'.join(map(str, steps))} {name}")
    text = f"{told} told" + (f", {len(believed)} believed: {'; '.join(believed)}" if believed else "")
    return (Answer.BELIEVED if believed else Answer.REFUSED), text


def _is_believed(base: str, steps: Steps, change: Change, scratch: Path) -> bool:
    """Edit a field of a fresh copy, and what the certificate repeats of it, and return whether it is certified."""
    folder = Folder(bases.copy_of(base, scratch, is_drawn=False))
    for data in (folder.data, folder.certificate):
        if steps[0] in data:
            *way, last = steps
            holder = data
            for step in way:
                holder = holder[step]
            holder[last] = change(holder[last])
    with remembering():
        folder.save(Level.FITTED)
        answer, _ = judges.verify(folder.path)
    seen = _find_scan(folder.data) if steps[0] == "detections" else {}
    return answer is Answer.BELIEVED and judges.verify(folder.path, **seen)[0] is Answer.BELIEVED


def _find_scan(data: Mapping[str, Any]) -> dict[str, Path]:
    """Return the scan of a request: only it shows what was detected."""
    cloud = data["request"]["scene"].get("cloud")
    return {} if cloud is None else {"cloud": bases.ROOT / "examples" / "requests" / str(cloud)}


def _list_edits(base: str, group: str, rng: random.Random) -> Iterator[tuple[Steps, str, Change]]:
    """Yield path, name and change of an edit of every kind of field of a group."""
    honest, kinds = _read_kinds(base)
    for kind in kinds:
        edits = [
            (steps, name)
            for steps in rng.sample(kind.places, min(len(kind.places), MOST_PLACES))
            for name in list_changes(read_at(honest, steps))
            if not f"{kind.name} {name}".startswith(TRUE) and (name, read_at(honest, steps)) != DEFAULT
        ]
        if kind.group == group and edits:
            steps, name = rng.choice(edits)
            yield steps, name, list_changes(read_at(honest, steps))[name]


@cache
def _read_kinds(base: str) -> tuple[dict[str, Any], list[Kind]]:
    """Return the honest result of a base and the kinds of its fields."""
    honest = json.loads((bases.original(base) / "result" / "result.json").read_text(encoding="utf-8"))
    return honest, _list_kinds(honest)


def _list_kinds(honest: Mapping[str, Any]) -> list[Kind]:
    found: dict[str, Kind] = {}
    for steps, _ in walk(honest, ()):
        name = ".".join("*" if isinstance(step, int) else step for step in steps)
        parts = [".".join(name.split(".")[:size]) for size in range(1, 3)]
        if not name or any(part in FREE or part in ELSEWHERE for part in parts):
            continue
        if any(f"{word}." in f"{name}." for word in UNCOMPARED) and parts[0] in ("checks", "coverage"):
            continue
        if ".regions.*." in f"{name}." and not name.endswith(("first", "last")):
            continue  # evidence, which the verifier proves: other evidence may be as good
        if parts[0] == "servo" and name.endswith("at_s"):
            continue
        found.setdefault(name, Kind(name)).places.append(steps)
    return list(found.values())


def walk(value: Any, steps: Steps) -> Iterator[tuple[Steps, Any]]:
    yield steps, value
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in entries:
        yield from walk(inner, (*steps, key))


def read_at(data: Any, steps: Steps) -> Any:
    for step in steps:
        data = data[step]
    return data


def list_changes(value: Any) -> dict[str, Change]:
    """Return what can be done to a value."""
    match value:
        case bool():
            return {"flipped": lambda old: not old}
        case int():
            return {"larger": lambda old: old + 1, "smaller": lambda old: old - 1, "null": lambda old: None}
        case float():
            amount = SHARE * abs(value) + LEAST
            return {
                "larger": lambda old: old + amount,
                "smaller": lambda old: old - amount,
                "null": lambda old: None,
            }
        case str():
            return {"otherwise": lambda old: f"{old}x", "null": lambda old: None}
        case list() if value:
            return {
                "without its first": lambda old: old[1:],
                "with its last twice": lambda old: [*old, old[-1]],
                "emptied": lambda old: [],
            }
        case None:
            return {"a number": lambda old: 0.1}
    return {}


@contextmanager
def remembering() -> Iterator[None]:
    """Make each robot and certificate once in the body, where no lie is about files of robots."""
    with (
        mock.patch.object(replay, "verify", _remember_certificate),
        mock.patch.object(replay, "load_robot", _remember_robot),
        mock.patch.object(forgery, "load_robot", _remember_robot),
    ):
        yield


@cache
def _known() -> dict[bytes, Any]:
    return {}


def _remember_certificate(motion: Motion) -> Certificate:
    """Return the certificate of a motion, made once for equal ones."""
    robot = motion.robot
    hashes = (robot_hash(robot), bodies_hash(robot), scene_hash(motion.scene))
    limits = (robot.lower, robot.upper, robot.velocity, robot.acceleration, robot.effort)
    promises = (motion.curve, motion.law, motion.phases, motion.samples, motion.releases, motion.continues)
    key = pickle.dumps((hashes, limits, promises, sorted(motion.waived or ()), robot.model))
    known = _known()
    if key not in known:
        known[key] = verify(motion)
    return cast(Certificate, known[key])


def _remember_robot(*, urdf: Path, srdf: Path | None, package_dirs: Sequence[Path], root: Root) -> RobotModel:
    """Return the robot of a folder's files, loaded once for equal URDF and SRDF."""
    texts = [path.read_bytes() for path in (urdf, srdf) if path is not None]
    key = pickle.dumps((texts, srdf is None, sorted(path.name for path in package_dirs), root))
    known = _known()
    if key not in known:
        known[key] = load_robot(urdf=urdf, srdf=srdf, package_dirs=package_dirs, root=root)
    return cast(RobotModel, known[key])
