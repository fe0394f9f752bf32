"""Forged result folders: edits, with hashes and claims computed again so that they fit.

The forger has scopt's source code: ``REMADE`` runs the verifier on the edited motion and writes its certificate, its
samples and its table as scopt would have, every check green.
"""

from __future__ import annotations

import enum
import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from benchmarks.attack import bases, judges
from benchmarks.attack.outcome import Answer, Attack
from benchmarks.attack.rare_bases import RARE
from costs.robot import RobotError, RobotModel, load_robot
from service.result.manifest import write_manifest
from service.result.motion_json import motion_from_json, motion_json
from service.result.phase_report import PhaseReport, PhaseStatus, report_phases
from service.result.result_json import add_reports
from service.verify import (
    Motion,
    VerifyError,
    bodies_hash,
    link_vertices,
    promises_hash,
    robot_hash,
    scene_hash,
    split_motion,
    verify,
)

ROBOT_HERE = "the robot in this folder"
LONG_BASES = (
    "valve",
    "lever",
    "scan",
    "steps",
    "chair",
    "stair",
    "rail",
    "door",
    "drawer",
    "gripper",
    "egress",
    "resume",
    "compliant",
    "walk",
    "moving",
    *RARE,
)  # slow: the short version has few edits of them
SHORT = (
    "turn backwards",
    "phases merged into one",
    "contacts that change while the robot moves",
    "the rod is off the face during the move",
    "the object moves while the hand rests",
    "hands that slip",
    "servos that give way less",
    "a base on wheels that slides sideways",
    "a fork of one prong",
)
LONG = (
    "a place moved by 20 mm",
    "an object of twenty times the mass",
    "an object carried by the column",
    "fingers that do not slip",
    "half of the object s mass",
    "an object taken before the fingers close",
    "an object that is smaller than the request s",
    "an object that was 3 mm beside its grasp",
    "no objects",
    "fingers that press harder than they can",
    "an allowance of the object for the wall",
    "kept pose removed",
    "kept pose relative to itself",
    "kept pose demanded elsewhere",
    "carried beam of 60 kg",
    "floor of the request removed",
    "floor deleted",
    "goal of the other hand",
    "goal becomes a posture",
    "start posture of the request changed",
    "feet removed from contacts",
    "feet and balance removed",
    "pace of the record is fast",
    "pace of nobody",
    "tool speed left out of the record",
    "jerk limit left out of the record",
    "law and tool speed half as fast again",
    "pace of the request is careful",
    "sway of the request doubled",
    "tool speed of the request lowered",
    "balance margin lowered",
    "target moved by 12 mm",
    "target of another link",
    "pose goal moved by 30 cm",
    "support polygon removed",
    "sole and polygon enlarged",
    "fingers open as they carry",
    "one finger holds alone",
    "floor of the request raised by 10 cm",
    "planted elsewhere",
    "balance margin negative",
    "sole reduced to one corner",
    "support polygon enlarged",
    "allowance retargeted",
    "kept pose about a free axis",
    "target free along one axis",
    "orientation added to the goal",
    "start base of the request moved",
    "goal that was missed loosened",
    "goal that was missed loosened in the request but not enough",
    "pose goal moved by 12 mm",
    "target tolerance loosened",
    "box moved into the hand",
    "floor shrunk to the size of a coin",
    "zmp taken on another plane",
    "standing on one foot demanded",
    "target moved by 4 mm",
    "contact tolerance loosened",
    "one foot removed from contacts",
    "allowance deepened",
    "exempt pairs no longer listed",
    "zmp drawn in the middle",
    "centre of mass drawn in the middle",
    "balance claimed too large",
    "kept pose loosened",
    "support polygons drawn larger",
    "a second goal pose",
)  # of quick bases: the short version or tests/results/test_replay.py has another lie about the same values


class Level(enum.Enum):
    """How much of the folder is made consistent with the edit."""

    RAW = "as it is"
    HASHED = "hashed"
    """The hashes of request, robot, bodies, pieces and promises."""
    FITTED = "fitted"
    """These, and what is drawn of the motion; what the honest certificate says is kept."""
    REMADE = "remade"
    """Everything that the verifier and the planner write."""


class Folder:
    """A copy of a result folder, its ``result.json`` parsed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data: dict[str, Any] = json.loads((path / "result.json").read_text(encoding="utf-8"))

    @property
    def request(self) -> dict[str, Any]:
        found: dict[str, Any] = self.data["request"]
        return found

    @property
    def certificate(self) -> dict[str, Any]:
        found: dict[str, Any] = self.data["certificate"]
        return found

    @property
    def phases(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.data["phases"]
        return found

    @property
    def curve(self) -> dict[str, Any]:
        found: dict[str, Any] = self.data["curve"]
        return found

    def targets(self, kind: str) -> list[dict[str, Any]]:
        """Return all targets of a kind in all phases."""
        return [target for phase in self.phases for target in phase["targets"] if target["kind"] == kind]

    def piece(self, name: str) -> dict[str, Any]:
        return next(piece for piece in self.data["pieces"] if piece["name"] == name)

    def edit_urdf(self, change: Callable[[ET.Element], object]) -> None:
        """Change the parsed copy of the robot's URDF."""
        path = self.path / self.data["robot"]["urdf"]
        root = ET.fromstring(path.read_text(encoding="utf-8"))
        change(root)
        path.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")

    def edit_text(self, name: str, change: Callable[[str], str]) -> None:
        """Change a file's text."""
        path = self.path / name
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")

    def edit_table(self, change: Callable[[np.ndarray], np.ndarray]) -> None:
        """Change the rows of ``trajectory.csv``."""
        path = self.path / "trajectory.csv"
        header = path.read_text(encoding="utf-8").splitlines()[0]
        np.savetxt(path, change(np.loadtxt(path, delimiter=",", skiprows=1)), "%.10g", ",", header=header, comments="")

    def save(self, level: Level) -> None:
        """Write ``result.json`` with everything that the level makes consistent, as far as it is still readable."""
        canonical = json.dumps(self.data["request"], sort_keys=True, separators=(",", ":"))
        if level is not Level.RAW:
            self.data["request_hash"] = "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
            with suppress(ValueError, KeyError, TypeError, IndexError, AttributeError, RobotError, VerifyError):
                self._make_fit(level)
        (self.path / "result.json").write_text(json.dumps(self.data), encoding="utf-8")
        if level is not Level.RAW and (self.path / "manifest.json").is_file():
            write_manifest(self.path, self.data)

    def robot(self) -> RobotModel:
        """Return the robot read from the files of the folder."""
        robot = self.data["robot"]
        srdf = None if robot["srdf"] is None else self.path / robot["srdf"]
        packages = [self.path / name for name in robot["package_dirs"]]
        return load_robot(urdf=self.path / robot["urdf"], srdf=srdf, package_dirs=packages, root=robot["root"])

    def _make_fit(self, level: Level) -> None:
        robot = self.robot()
        self.data["bodies"] = [
            {"name": b.name, "link": b.link, "vertices": link_vertices(robot, b.link, b.vertices).tolist()}
            for b in robot.bodies
        ]
        self.data["ignored_pairs"] = sorted(list(pair) for pair in robot.ignored_pairs)
        motion = motion_from_json(self.data, robot)
        if level is Level.FITTED:
            self._fit_hashes(motion, robot)
            return
        certificate = verify(motion)
        fresh = certificate.to_dict()
        self.data["robot"]["sha256"] = fresh["robot_sha256"]
        if level is Level.REMADE:
            self._remake(motion, robot, fresh, report_phases(motion, certificate))
        elif self.data.get("certificate"):
            self.certificate.update({key: value for key, value in fresh.items() if key.endswith("_sha256")})

    def _fit_hashes(self, motion: Motion, robot: RobotModel) -> None:
        hashes = {
            "scene_sha256": scene_hash(motion.scene),
            "bodies_sha256": bodies_hash(split_motion(motion)[0].robot),
            "robot_sha256": robot_hash(motion.robot),
            "promises_sha256": promises_hash(motion.phases, motion.releases, objects=motion.objects),
        }
        made = motion_json(motion, robot)
        self.data.update({name: made[name] for name in ("waypoints", "support_polygons", "com", "zmp")})
        self.data["robot"]["sha256"] = hashes["robot_sha256"]
        self.certificate.update(hashes)

    def _remake(
        self, motion: Motion, robot: RobotModel, certificate: dict[str, Any], reports: Sequence[PhaseReport]
    ) -> None:
        certificate["status"] = "CERTIFIED"
        for check in certificate["checks"]:
            check["ok"] = True
        claims = ("min_clearance_m", "min_clearance_pair", "min_balance_margin_m", "checks", "exempt", "coverage")
        self.data.update({key: certificate[key] for key in claims if key in certificate})
        self.data.update(motion_json(motion, robot), certificate=certificate, verdict="CERTIFIED", explanation=[])
        claimed = [replace(report, status=PhaseStatus.CERTIFIED) for report in reports]
        self.data["phases"] = add_reports(self.data["phases"], claimed)
        trajectory = self.data["trajectory"]
        header = ",".join(("time", *trajectory["joint_names"]))
        rows = np.column_stack([trajectory["times"], np.array(trajectory["positions"])])
        np.savetxt(self.path / "trajectory.csv", rows, "%.10g", ",", header=header, comments="")


Change = Callable[[Folder], object]


@dataclass(frozen=True)
class Edit:
    """Edit of copies of some bases' folders.

    Attributes:
        name: of the edit.
        bases: names in :mod:`benchmarks.attack.bases`.
        change: makes the edit.
        level: how much is made consistent.
        is_harmless: whether the folder must still be certified.
        asks_stranger: whether the independent program must notice it too.
        asks_verifier: whether ``scopt verify`` must notice it.
        is_of_robot: whether only the robot's files are edited. Where the request names them by path, a verdict that
            says it rests on the folder's copy is honest, and with the user's own request there must be none.
    """

    name: str
    bases: tuple[str, ...]
    change: Change
    level: Level
    is_harmless: bool = False
    asks_stranger: bool = False
    asks_verifier: bool = True
    is_of_robot: bool = False

    def attacks(self) -> list[Attack]:
        """Return one attack for every base and judge."""
        found = []
        for base in self.bases:
            label = f"{base}: {self.name}" + ("" if self.level is Level.RAW else f" [{self.level.value}]")
            kind = "harmless" if self.is_harmless else "folders"
            if self.asks_verifier:
                is_short = base == self.bases[0] and (
                    self.name in SHORT if base in LONG_BASES else self.name not in LONG
                )
                found.append(Attack(kind, label, partial(self.run, base), is_short))
            if self.asks_stranger:
                found.append(Attack("stranger", label, partial(self.run, base, judge=judges.ask_stranger), False))
        return found

    def run(
        self, base: str, scratch: Path, judge: Callable[[Path], tuple[Answer, str]] = judges.verify
    ) -> tuple[Answer, str]:
        """Edit a fresh copy and judge it."""
        folder = Folder(bases.copy_of(base, scratch))
        before = fingerprint(folder.path)
        self.change(folder)
        folder.save(self.level)
        if fingerprint(folder.path) == before:
            raise AssertionError(f"the edit {self.name!r} changed nothing in {base}")
        answer, text = judge(folder.path)
        if self.is_of_robot and answer is Answer.BELIEVED and ROBOT_HERE in text:
            # The verdict names the robot it is for; a check against the user's own request reveals more.
            answer, text = judges.verify(folder.path, request=bases.original(base) / "request.yaml")
        return judges.harmless(answer, text) if self.is_harmless else (answer, text)


def fingerprint(folder: Path) -> str:
    """Return a digest of all files of a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            name = f"{path.relative_to(folder)} {path.is_symlink()}"
            digest.update(name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


class Registry:
    """Edits in the order of their definitions."""

    def __init__(self) -> None:
        self.edits: list[Edit] = []

    def lie(
        self, *bases: str, level: Level = Level.REMADE, stranger: bool = False, robot: bool = False
    ) -> Callable[[Change], Change]:
        """Register an edit whose folder must not be certified; its name is the function's."""

        def register(change: Change) -> Change:
            self.edits.append(Edit(_name(change), bases, change, level, False, stranger, True, robot))
            return change

        return register

    def for_stranger(self, *bases: str) -> Callable[[Change], Change]:
        """Register an edit of data that only the independent program reads."""

        def register(change: Change) -> Change:
            self.edits.append(Edit(_name(change), bases, change, Level.RAW, False, True, False))
            return change

        return register

    def harmless(self, *bases: str, level: Level = Level.RAW) -> Callable[[Change], Change]:
        """Register an edit after which the folder must still be certified."""

        def register(change: Change) -> Change:
            self.edits.append(Edit(_name(change), bases, change, level, True))
            return change

        return register


def _name(change: Change) -> str:
    return str(getattr(change, "__name__", change)).strip("_").replace("_", " ")
