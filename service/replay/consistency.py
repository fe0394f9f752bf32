"""What a result folder says twice must agree: samples and curve, files and hashes, recorded claims and fresh ones."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from service.errors import shown
from service.result.motion_json import file_columns, file_positions, motion_json, sample_times, samples_of
from service.verify import Certificate, Motion, Status
from service.verify.hashes import bodies_hash, link_vertices, promises_hash, robot_hash, scene_hash
from service.verify.stance_checks import outside_polygon

TOLERANCE = 1e-6  # of numbers written twice [m, rad, s]
CLAIM_TOLERANCE = 1e-4  # of a clearance or balance margin proven on another machine [m]
CHANGED = "the result was changed after it was written"


def find_contradictions(
    data: Mapping[str, Any], motion: Motion, robot: RobotModel, certificate: Certificate, table: Path | None
) -> tuple[str, ...]:
    """One sentence for everything in a result that does not fit the rest of it.

    Args:
        data: the parsed ``result.json``, with a certificate.
        motion: the motion read from it.
        robot: its robot, without what the task moves.
        certificate: made anew, of the motion as the request has it.
        table: its ``trajectory.csv``, if there is one.

    Raises:
        KeyError, TypeError, ValueError, IndexError: the data do not follow docs/result-format.md.
    """
    recorded = data["certificate"]
    return (
        *_hashes(data, recorded, motion),
        *_bodies(data, motion),
        *_samples(data, motion, table),
        *_drawn(data, motion, robot),
        *_promises(recorded, certificate),
        *_claims({"result.json": data, "the recorded certificate": recorded}, certificate),
        *_said(data, recorded, certificate),
    )


def _hashes(data: Mapping[str, Any], recorded: Mapping[str, Any], motion: Motion) -> Iterator[str]:
    made = {
        "scene_sha256": scene_hash(motion.scene),
        "bodies_sha256": bodies_hash(motion.robot),
        "robot_sha256": robot_hash(motion.robot),
        "promises_sha256": promises_hash(motion.phases),
    }
    for name, value in made.items():
        if recorded[name] != value:
            yield f"{name} of the recorded certificate does not fit these files"
    if data["robot"]["sha256"] != made["robot_sha256"]:
        yield "robot.sha256 does not fit the robot's file"
    canonical = json.dumps(data["request"], sort_keys=True, separators=(",", ":"))
    if data["request_hash"] != "sha256:" + hashlib.sha256(canonical.encode()).hexdigest():
        yield "request_hash does not fit the request"
    if data["verdict"] == Status.CERTIFIED.value != recorded["status"]:
        yield f"the verdict is CERTIFIED, and the recorded certificate says {shown(recorded['status'])}"


def _bodies(data: Mapping[str, Any], motion: Motion) -> Iterator[str]:
    """The bodies and ignored pairs that a stranger reads must be those of the robot's files, which are verified."""
    moved = {movable["name"] for movable in data["movables"]}
    robot = motion.robot
    own = {b.name: link_vertices(robot, b.link, b.vertices) for b in robot.bodies if b.link not in moved}
    written = {body["name"]: np.array(body["vertices"], dtype=float) for body in data["bodies"]}
    is_told_once = len(written) == len(data["bodies"])
    if not is_told_once or own.keys() != written.keys() or not all(_agree(own[name], written[name]) for name in own):
        yield "bodies are not those of the robot's files"
    pairs = {pair for pair in robot.ignored_pairs if moved.isdisjoint(pair)}
    if pairs != {tuple(pair) for pair in data["ignored_pairs"]}:
        yield "ignored_pairs are not those of the robot's files"


def _samples(data: Mapping[str, Any], motion: Motion, table: Path | None) -> Iterator[str]:
    """The samples are points of the curve, which is what is verified."""
    trajectory, n = data["trajectory"], motion.robot.n - len(data["movables"])
    q = motion.curve(samples_of(motion))
    columns = file_columns(motion.robot)
    if tuple(trajectory["joint_names"]) != columns[: len(columns) - len(data["movables"])]:
        yield "trajectory.joint_names are not the robot's"
    positions, times = file_positions(motion.robot, q[:, :n]), sample_times(motion)
    if not _agree(np.array(trajectory["positions"], dtype=float), positions):
        yield "trajectory.positions are not on the curve"
    if not _agree(np.array(trajectory["times"], dtype=float), times):
        yield "trajectory.times are not those of the curve's time law"
    for column, movable in enumerate(data["movables"], start=n):
        if not _agree(np.array(movable["angles"], dtype=float), q[:, column]):
            yield f"movables: the angles of {movable['name']} are not on the curve"
    if table is not None and not _holds_samples(table, trajectory["joint_names"], np.column_stack([times, positions])):
        yield f"{table.name} does not hold samples of the curve"


def _promises(recorded: Mapping[str, Any], certificate: Certificate) -> Iterator[str]:
    """What was checked when the result was written is checked again, and as strictly."""
    limits: dict[str, list[float]] = {}
    for check in certificate.checks:
        limits.setdefault(check.name, []).append(check.limit)
    for check in recorded["checks"]:
        name, limit = check["name"], check["limit"]
        if name not in limits:
            yield f"check {name} of the recorded certificate is no longer asked for"
        elif limit is not None and not np.any(np.isclose(limit, limits[name], rtol=TOLERANCE)):
            yield f"check {name} has the limit {limits[name][-1]:.6g}, recorded is {limit:.6g}"


def _claims(claims: Mapping[str, Mapping[str, Any]], certificate: Certificate) -> Iterator[str]:
    for source, claim in claims.items():
        for name in ("min_clearance_m", "min_balance_margin_m"):
            value, proven = claim.get(name), getattr(certificate, name)
            if value is not None and not value <= proven + CLAIM_TOLERANCE:
                yield f"{name} of {source} is {value:.6g}, proven is {proven:.6g}"


def _holds_samples(table: Path, names: Sequence[str], expected: Float[np.ndarray, "S k"]) -> bool:
    """Whether a table has the columns of the samples, and their rows."""
    header, *rows = table.read_text(encoding="utf-8").splitlines() or [""]
    if header != ",".join(("time", *names)) or len(rows) != len(expected):
        return False
    return _agree(np.loadtxt(rows, delimiter=",", ndmin=2, comments=None), expected)


def _drawn(data: Mapping[str, Any], motion: Motion, robot: RobotModel) -> Iterator[str]:
    """What the pages draw is the motion's: waypoints, centre of mass, support polygons and ZMP."""
    made = motion_json(motion, robot)
    if data["waypoints"] != made["waypoints"]:
        yield "waypoints are not the curve's knots"
    if not _is_near(data["com"], made["com"]):
        yield "com is not the motion's centre of mass"
    if not _is_near(_bare(data["support_polygons"]), _bare(made["support_polygons"])):
        yield "support_polygons are not those of the phases"
    elif not all(_same_zmp(one, source) for one, source in zip(_zmp(data), _zmp(made), strict=True)):
        yield "zmp is not the motion's"


def _bare(supports: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Support polygons without the ZMP that is drawn in them."""
    return [{name: value for name, value in support.items() if name != "zmp"} for support in supports]


def _zmp(data: Mapping[str, Any]) -> Iterator[tuple[np.ndarray, list[Any]]]:
    """Support polygon and ZMP that are drawn of each phase: at the samples, and as its check saw it."""
    for support in data["support_polygons"]:
        polygon = np.array(support["polygon"], dtype=float)
        yield polygon, data["zmp"][support["first"] : support["last"] + 1]
        yield polygon, support["zmp"]["points"]


def _same_zmp(one: tuple[np.ndarray, list[Any]], other: tuple[np.ndarray, list[Any]]) -> bool:
    """Whether two tracks come equally near to their polygon's edge; of points alike either may be drawn."""
    worst = []
    for polygon, points in (one, other):
        known = np.array([point for point in points if point is not None], dtype=float).reshape(-1, 2)
        worst.append((len(points), len(known), float(outside_polygon(polygon, known).max(initial=-np.inf))))
    return worst[0][:2] == worst[1][:2] and bool(np.isclose(worst[0][2], worst[1][2], rtol=0.0, atol=CLAIM_TOLERANCE))


def _said(data: Mapping[str, Any], recorded: Mapping[str, Any], certificate: Certificate) -> Iterator[str]:
    """The recorded checks, pairs that may touch and coverage are those of the motion, and told alike in both places."""
    fresh = certificate.to_dict()
    for name in ("checks", "exempt", "coverage", "min_clearance_pair"):
        if data[name] != recorded[name]:
            yield f"{name} of result.json and of the recorded certificate differ"
    if not _same_rows(recorded["checks"], fresh["checks"], ("name", "ok", "basis"), "value"):
        yield "checks are not those of the motion"
    if not _same_rows(recorded["exempt"], fresh["exempt"], ("pair", "phase"), "deepest_m"):
        yield "exempt pairs are not those of the motion"
    if not _same_rows(recorded["coverage"]["left_out"], fresh["coverage"]["left_out"], ("pair", "reason"), "deepest_m"):
        yield "coverage.left_out is not what the verifier leaves out"
    names = [name for name in fresh["coverage"] if name != "left_out"]
    if any(not _is_near(recorded["coverage"][name], fresh["coverage"][name]) for name in names):
        yield "coverage is not the verifier's"


def _same_rows(
    written: Sequence[Mapping[str, Any]], made: Sequence[Mapping[str, Any]], names: Sequence[str], value: str
) -> bool:
    """Whether two lists have the same entries, each with about the same value."""
    if [[one[name] for name in names] for one in written] != [[one[name] for name in names] for one in made]:
        return False
    return all(_is_claim(a[value], b[value]) for a, b in zip(written, made, strict=True))


def _is_claim(written: float | None, made: float | None) -> bool:
    """Whether a value may have come out so on another machine."""
    if written is None or made is None:
        return written is made
    return bool(np.isclose(written, made, rtol=0.01, atol=CLAIM_TOLERANCE))


def _is_near(written: object, made: object) -> bool:
    """Whether two pieces of JSON data are the same but for rounding."""
    if isinstance(written, Mapping) and isinstance(made, Mapping):
        return written.keys() == made.keys() and all(_is_near(written[key], made[key]) for key in made)
    if isinstance(written, list | tuple) and isinstance(made, list | tuple):
        return len(written) == len(made) and all(_is_near(a, b) for a, b in zip(written, made, strict=True))
    if isinstance(written, float | int) and isinstance(made, float | int):
        return bool(abs(written - made) <= TOLERANCE)
    return written == made


def _agree(written: np.ndarray, expected: np.ndarray) -> bool:
    return written.shape == expected.shape and bool(np.allclose(written, expected, rtol=0.0, atol=TOLERANCE))
