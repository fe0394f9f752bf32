"""What a result folder says twice must agree: samples and curve, files and hashes, recorded claims and fresh ones."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from service.errors import shown
from service.motion_json import file_columns, file_positions, sample_times, samples_of
from service.verify import Certificate, Motion, Status
from service.verify.certificate import bodies_hash, link_vertices, promises_hash, robot_hash, scene_hash

TOLERANCE = 1e-6  # of numbers written twice [m, rad, s]
CLAIM_TOLERANCE = 1e-4  # of a clearance or balance margin proven on another machine [m]
CHANGED = "the result was changed after it was written"


def contradictions(
    data: Mapping[str, Any], motion: Motion, certificate: Certificate, table: Path | None
) -> tuple[str, ...]:
    """One sentence for everything in a result that does not fit the rest of it.

    Args:
        data: the parsed ``result.json``, with a certificate.
        motion: the motion read from it.
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
        *_promises(recorded, certificate),
        *_claims({"result.json": data, "the recorded certificate": recorded}, certificate),
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
    if table is not None and not _agree(_rows(table), np.column_stack([times, positions])):
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


def _rows(table: Path) -> np.ndarray:
    with table.open(encoding="utf-8") as file:
        next(file)
        return np.loadtxt(file, delimiter=",", ndmin=2)


def _agree(written: np.ndarray, expected: np.ndarray) -> bool:
    return written.shape == expected.shape and bool(np.allclose(written, expected, rtol=0.0, atol=TOLERANCE))
