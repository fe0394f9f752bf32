"""Requests with false data about a robot or a scene, and their correct answers."""

from __future__ import annotations

import enum
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.attack.outcome import Answer
from benchmarks.attack.truth import Truth, dense
from scopt import EffortClock
from service import RequestError, parse_request, plan
from service.result.result import PlanResult

CHECKED = ("links_with_shape", "left_out")  # of a certificate's coverage: what was checked, or is named as a pair
DEEPER_M = 1e-3  # deepest allowed overlap in a certified motion


class Expected(enum.Enum):
    """Correct answer."""

    NO_CERTIFICATE = "refused, or a verdict other than CERTIFIED"
    NAMED = "that, or CERTIFIED with notes that name all of the words"
    TRUTH = "that, or CERTIFIED where independent code sees nothing inside anything"


@dataclass(frozen=True)
class Lie:
    """A request with false data.

    Attributes:
        request: as plain data.
        expected: the correct answer.
        words: regular expressions that notes must hold (``NAMED``), or that excuse what the truth is (``TRUTH``).
        urdf: honest text of the robot, in whose folder its meshes are; of a fixed base.
        folder: of its meshes.
        tag: which of its shapes count.
        may_touch: pairs of links whose contact is ignored.
    """

    request: dict[str, Any]
    expected: Expected = Expected.TRUTH
    words: tuple[str, ...] = ()
    urdf: str = ""
    folder: Path = field(default_factory=Path)
    tag: str = "collision"
    may_touch: tuple[tuple[str, str], ...] = ()


def answer_of(lie: Lie, folder: Path) -> tuple[Answer, str]:
    """Plan the request and compare the result with the truth."""
    try:
        result = plan(parse_request(lie.request, folder), clock=EffortClock())
    except RequestError as error:
        return Answer.REFUSED, str(error).splitlines()[0]
    if result.verdict.value != "CERTIFIED":
        return Answer.REPORTED, f"{result.verdict.value}: {(result.explanation or ('no reason given',))[0]}"
    told = told_beside(result)
    is_named = bool(lie.words) and all(re.search(rf"\b{word}\b", told) for word in lie.words)
    if lie.expected is Expected.NO_CERTIFICATE:
        return Answer.BELIEVED, "CERTIFIED"
    if lie.expected is Expected.NAMED:
        return (Answer.REPORTED, f"named: {', '.join(lie.words)}") if is_named else (Answer.BELIEVED, "CERTIFIED")
    motion = result.motion
    assert motion is not None
    truth = Truth(lie.urdf, lie.folder, lie.tag)
    obstacles = lie.request.get("scene", {}).get("obstacles", [])
    depth = truth.deepest(motion.robot.joint_names, dense(motion.curve), obstacles, lie.may_touch)
    text = f"{' and '.join(depth.pair)} are {1e3 * depth.metres:.1f} mm inside each other"
    if depth.metres <= DEEPER_M:
        return Answer.TRUE, f"CERTIFIED; {-1e3 * depth.metres:.1f} mm apart at least"
    return (Answer.REPORTED, f"named, but {text}") if is_named else (Answer.BELIEVED, f"CERTIFIED, but {text}")


def told_beside(result: PlanResult) -> str:
    """Return the text beside the verdict: notes and the certificate without the columns of its proof."""
    certificate = {} if result.certificate is None else result.certificate.to_dict()
    for name in ("stretches", "checks", "exempt", "min_clearance_pair"):
        certificate.pop(name, None)
    # Mentions of checked links and pairs do not count as notes on unchecked ones.
    coverage = certificate.get("coverage")
    if isinstance(coverage, dict):
        certificate["coverage"] = {name: value for name, value in coverage.items() if name not in CHECKED}
    return json.dumps([result.notes, result.explanation, certificate])


Make = Callable[[Path], Lie]
