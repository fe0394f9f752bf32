"""Consistency of a result folder: samples and curve, files and hashes, recorded and recomputed claims."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from service.demands import Demands
from service.demands.rest.displacement import DISPLACED_MM
from service.errors import shown
from service.motion.expected_sag import expect_sag
from service.replay.standing import is_comparable
from service.request.file import hash_request_data
from service.request.formats import FORMAT
from service.result.motion_json import file_columns, file_positions, motion_json, rates_at, sample_times, samples_of
from service.result.result_json import links_without_shape
from service.result.versions import find_format
from service.scan.json_data import to_json_data
from service.verify import (
    Certificate,
    Motion,
    Status,
    bodies_hash,
    link_vertices,
    outside_polygon,
    promises_hash,
    robot_hash,
    scene_hash,
    split_motion,
)

TOLERANCE = 1e-6  # of numbers that are written and recomputed [m, rad, s]
CLAIM_TOLERANCE = 1e-4  # of a clearance or balance margin proven on another machine [m]
RATE_TOLERANCE = 1e-4  # of velocities and accelerations, relative above 1 [rad/s, rad/s^2]
JUMP_S = 1e-7  # from a sample, where the acceleration may jump
CHANGED = "the result was changed after it was written"


def find_contradictions(
    data: Mapping[str, Any], motion: Motion, robot: RobotModel, certificate: Certificate | None, table: Path | None
) -> tuple[str, ...]:
    """Return a sentence for every part of a result that contradicts another.

    Args:
        data: the parsed ``result.json``, with a certificate.
        motion: the motion read from it.
        robot: its robot, without the joints that the task moves.
        certificate: a new certificate of the motion: held to the request, or, of an earlier format, to the record. None
            where the verifier cannot make one of an earlier format's promises.
        table: its ``trajectory.csv``, if there is one.

    Raises:
        KeyError, TypeError, ValueError, IndexError: the data do not follow docs/result-format.md.
    """
    recorded, version = data["certificate"], find_format(data) or FORMAT
    parts = (
        *_check_hashes(data, recorded, motion, version),
        *_check_bodies(data, motion),
        *_check_samples(data, motion, table),
        *_check_drawing(data, motion, robot),
        *(_check_form(data, motion, robot) if version == FORMAT else ()),
        *_check_copies(data, recorded),
    )
    if certificate is None:
        return parts
    return (
        *parts,
        *_check_limits(recorded, certificate, version),
        *_check_claims({"result.json": data, "the recorded certificate": recorded}, certificate),
        *_check_lists(recorded, certificate, version),
    )


def compare_servos(
    recorded: Mapping[str, Any] | None, motion: Motion, demands: Demands, certificate: Certificate
) -> Iterator[str]:
    """Yield a sentence where a result's ``servo`` is not the sag of the request's servos along the motion."""
    servo = to_json_data(expect_sag(motion, demands.robot, demands.request, certificate)[0])
    is_same = recorded is servo is None
    if recorded is not None and servo is not None:  # the time of the largest sag is free where two are equal
        is_same = _is_plausible({**recorded, "at_s": None}, {**servo, "at_s": None})
    if not is_same:
        yield "servo is not the sag of the request's servos along the motion"


def compare_figures(recorded: Mapping[str, Any], demands: Demands, motion: Motion) -> Iterator[str]:
    """Yield a sentence where a result's figures are not those of its motion."""
    figures = dict(demands.task.measure(motion))
    resume = demands.request.resume
    if DISPLACED_MM in recorded and resume is not None and resume.nominal is not None and resume.is_compliant:
        # A plan that could not keep the earlier motion says nothing of it.
        figures |= demands.task.measure_displacement(motion, resume.nominal)
    if recorded.keys() != figures.keys():
        yield f"figures are {', '.join(recorded) or 'none'}; those of the motion are {', '.join(figures) or 'none'}"
    for name in recorded.keys() & figures.keys():
        if not _is_plausible(recorded[name], figures[name]):
            yield f"figures.{name} is {shown(recorded[name])}, measured on the motion {figures[name]:.4g}"


def _check_hashes(data: Mapping[str, Any], recorded: Mapping[str, Any], motion: Motion, version: int) -> Iterator[str]:
    computed = {
        "scene_sha256": scene_hash(motion.scene),
        "bodies_sha256": bodies_hash(split_motion(motion)[0].robot),
        "robot_sha256": robot_hash(motion.robot),
        "promises_sha256": promises_hash(motion.phases, motion.releases, version, motion.objects),
    }
    for name, value in computed.items():
        if recorded[name] != value:
            yield f"{name} of the recorded certificate does not fit these files"
    if recorded.get("continues_sha256") != motion.continues:
        yield "the recorded certificate continues another plan than the motion"
    if data["robot"]["sha256"] != computed["robot_sha256"]:
        yield "robot.sha256 does not fit the robot's file"
    if data["request_hash"] != hash_request_data(data["request"]):
        yield "request_hash does not fit the request"
    if data["verdict"] == Status.CERTIFIED.value != recorded["status"]:
        yield f"the verdict is CERTIFIED, and the recorded certificate says {shown(recorded['status'])}"


def _check_bodies(data: Mapping[str, Any], motion: Motion) -> Iterator[str]:
    """Compare bodies and ignored pairs with those of the robot's files, which are verified."""
    moved = {movable["name"] for movable in data["movables"]}
    robot = motion.robot
    own = {b.name: link_vertices(robot, b.link, b.vertices) for b in robot.bodies if b.link not in moved}
    written = {body["name"]: np.array(body["vertices"], dtype=float) for body in data["bodies"]}
    is_unique = len(written) == len(data["bodies"])
    if not is_unique or own.keys() != written.keys() or not all(_agree(own[name], written[name]) for name in own):
        yield "bodies are not those of the robot's files"
    pairs = {pair for pair in robot.ignored_pairs if moved.isdisjoint(pair)}
    if pairs != {tuple(pair) for pair in data["ignored_pairs"]}:
        yield "ignored_pairs are not those of the robot's files"


def _check_samples(data: Mapping[str, Any], motion: Motion, table: Path | None) -> Iterator[str]:
    """Compare the samples with the curve, which is verified."""
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
        if not _agree(np.array([movable["start"]], dtype=float), q[:1, column]):
            yield f"movables: {movable['name']} does not start where the curve has it"
    if table is not None:
        rates = _expect_rates(motion, n)
        if not _holds_samples(table, trajectory["joint_names"], np.column_stack([times, positions]), rates):
            yield f"{table.name} does not hold samples of the curve"


def _check_limits(recorded: Mapping[str, Any], certificate: Certificate, version: int) -> Iterator[str]:
    """Require every recorded check, with the same limit, in the new certificate; of an earlier format what is there."""
    limits: dict[str, list[float]] = {}
    for check in certificate.checks:
        limits.setdefault(check.name, []).append(check.limit)
    for check in recorded["checks"]:
        name, limit = check["name"], check["limit"]
        if version < FORMAT and not (name in limits and is_comparable(name, version)):
            continue
        if name not in limits:
            yield f"check {name} of the recorded certificate is no longer required"
        elif not any(_is_limit(limit, known) for known in limits[name]):
            yield f"check {name} has the limit {limits[name][-1]:.6g}, recorded is {shown(limit)}"


def _is_limit(written: float | None, known: float) -> bool:
    """Return whether a recorded limit is that of a check; one that is not finite is written as null."""
    return not np.isfinite(known) if written is None else bool(np.isclose(written, known, rtol=TOLERANCE))


def _check_claims(claims: Mapping[str, Mapping[str, Any]], certificate: Certificate) -> Iterator[str]:
    for source, claim in claims.items():
        for name in ("min_clearance_m", "min_balance_margin_m"):
            value, proven = claim.get(name), getattr(certificate, name)
            if np.isfinite(proven) if value is None else not value <= proven + CLAIM_TOLERANCE:
                yield f"{name} of {source} is {shown(value)}, proven is {proven:.6g}"


def _expect_rates(motion: Motion, n: int) -> tuple[list[str], list[np.ndarray]]:
    """Return the columns of rates, and their values at each sample, shortly before and shortly after it."""
    if motion.law is None:
        return [], []
    times = sample_times(motion)
    tables = [np.hstack([part[:, :n] for part in rates_at(motion, times + shift)]) for shift in (0.0, -JUMP_S, JUMP_S)]
    names = motion.robot.joint_names[:n]
    return [f"{kind}.{name}" for kind in ("velocity", "acceleration") for name in names], tables


def _holds_samples(
    table: Path,
    names: Sequence[str],
    expected: Float[np.ndarray, "S k"],
    rates: tuple[list[str], list[np.ndarray]],
) -> bool:
    """Return whether a table has the columns and rows of the samples, and perhaps their rates."""
    header, *rows = table.read_text(encoding="utf-8").splitlines() or [""]
    plain, (columns, candidates) = ["time", *names], rates
    if header not in (",".join(plain), ",".join([*plain, *columns])) or len(rows) != len(expected):
        return False
    values = np.loadtxt(rows, delimiter=",", ndmin=2, comments=None)
    width = len(plain)
    if not _agree(values[:, :width], expected):
        return False
    if header == ",".join(plain):
        return bool(values.shape[1] == width)
    written = values[:, width:]
    if not np.all(np.isfinite(written)) or written.shape != candidates[0].shape:
        return False
    # Accelerations jump where the time law has a corner; a sample there may have either side's.
    off = np.min([np.abs(written - candidate) for candidate in candidates], axis=0)
    return bool(np.all(off <= RATE_TOLERANCE * (1.0 + np.abs(written))))


def _check_drawing(data: Mapping[str, Any], motion: Motion, robot: RobotModel) -> Iterator[str]:
    """Compare what pages draw with the motion: waypoints, centre of mass, support polygons and ZMP."""
    made = motion_json(motion, robot)
    if data["waypoints"] != made["waypoints"]:
        yield "waypoints are not the curve's knots"
    if not _is_near(data["com"], made["com"]):
        yield "com is not the motion's centre of mass"
    if not _is_near(_drop_zmp(data["support_polygons"]), _drop_zmp(made["support_polygons"])):
        yield "support_polygons are not those of the phases"
    elif not all(_same_zmp(*tracks) for tracks in zip(_list_zmp(data), _list_zmp(made), strict=True)):
        yield "zmp is not the motion's"


def _check_form(data: Mapping[str, Any], motion: Motion, robot: RobotModel) -> Iterator[str]:
    """Require of this format that nothing is written otherwise than it is read: no entry twice, nothing left out."""
    made = motion_json(motion, robot)
    phases = [{key: phase[key] for key in phase if key not in ("status", "checks")} for phase in data["phases"]]
    for written, phase in zip(phases, made["phases"], strict=True):
        if not _is_near(written, phase):
            yield f"phase {shown(written.get('name'))} is not written as it is read"
        elif phase["pressed"] is None:
            yield f"phase {shown(phase['name'])} does not say what is pressed"
    if not _is_near(data["objects"], made["objects"]):
        yield "objects are not written as they are read"
    if not _is_near(data["movables"], made["movables"]):
        yield "movables are not written as they are read"
    if data["robot"]["links_without_shape"] != links_without_shape(robot):
        yield "robot.links_without_shape are not those of the robot's files"


def _drop_zmp(supports: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    return [{name: value for name, value in support.items() if name != "zmp"} for support in supports]


def _list_zmp(data: Mapping[str, Any]) -> Iterator[tuple[np.ndarray, list[Any]]]:
    """Yield polygon and ZMP of each phase: at the exported samples, and at those of its check."""
    for support in data["support_polygons"]:
        polygon = np.array(support["polygon"], dtype=float)
        yield polygon, data["zmp"][support["first"] : support["last"] + 1]
        yield polygon, support["zmp"]["points"]


def _same_zmp(*tracks: tuple[np.ndarray, list[Any]]) -> bool:
    """Return whether two tracks come equally near to their polygon's edge; the choice among equal points is free."""
    worst = []
    for polygon, points in tracks:
        known = np.array([point for point in points if point is not None], dtype=float).reshape(-1, 2)
        worst.append((len(points), len(known), float(outside_polygon(polygon, known).max(initial=-np.inf))))
    return worst[0][:2] == worst[1][:2] and bool(np.isclose(worst[0][2], worst[1][2], rtol=0.0, atol=CLAIM_TOLERANCE))


def _check_copies(data: Mapping[str, Any], recorded: Mapping[str, Any]) -> Iterator[str]:
    """Compare what result.json repeats of the recorded certificate."""
    for name in ("checks", "exempt", "coverage", "min_clearance_pair"):
        if data[name] != recorded[name]:
            yield f"{name} of result.json and of the recorded certificate differ"


def _check_lists(recorded: Mapping[str, Any], certificate: Certificate, version: int) -> Iterator[str]:
    """Compare checks, exempt pairs and coverage of the recorded and the new certificate.

    Of an earlier format only the checks are compared that both have and that still mean the same.
    """
    fresh = certificate.to_dict()
    written, made = recorded["checks"], fresh["checks"]
    if version < FORMAT:
        both = {row["name"] for row in written} & {row["name"] for row in made}
        both = {name for name in both if is_comparable(name, version)}
        written, made = (_select_rows(rows, both) for rows in (written, made))
    if not _same_rows(written, made, ("name", "ok", "basis", "unit"), ("value",)):
        yield "checks are not those of the motion"
    depths = ("allowed_m", "deepest_m", "proven_m")
    if not _same_rows(recorded["exempt"], fresh["exempt"], ("pair", "phase"), depths):
        yield "exempt pairs are not those of the motion"
    names = ("pair", "reason", "is_neighbour")
    if not _same_rows(recorded["coverage"]["left_out"], fresh["coverage"]["left_out"], names, ("deepest_m",)):
        yield "coverage.left_out is not what the verifier leaves out"
    counted = fresh["coverage"] if version == FORMAT else ()  # earlier formats counted other pairs
    others = [name for name in counted if name != "left_out"]
    if any(not _is_near(recorded["coverage"][name], fresh["coverage"][name]) for name in others):
        yield "coverage is not the verifier's"


def _select_rows(rows: Sequence[Mapping[str, Any]], names: Collection[str]) -> list[Mapping[str, Any]]:
    return sorted((row for row in rows if row["name"] in names), key=lambda row: str(row["name"]))


def _same_rows(
    written: Sequence[Mapping[str, Any]],
    made: Sequence[Mapping[str, Any]],
    names: Sequence[str],
    values: Sequence[str],
) -> bool:
    """Return whether two lists have the same entries, each with about the same values."""
    if [[row[name] for name in names] for row in written] != [[row[name] for name in names] for row in made]:
        return False
    return all(_is_plausible(a[value], b[value]) for a, b in zip(written, made, strict=True) for value in values)


def _is_plausible(written: object, made: object) -> bool:
    """Return whether another machine may have computed the written values: numbers agree within 1 %."""
    if isinstance(written, Mapping) and isinstance(made, Mapping):
        return written.keys() == made.keys() and all(_is_plausible(written[key], made[key]) for key in made)
    if isinstance(written, list | tuple) and isinstance(made, list | tuple):
        return len(written) == len(made) and all(_is_plausible(a, b) for a, b in zip(written, made, strict=True))
    if isinstance(written, float | int) and isinstance(made, float | int):
        return bool(np.isclose(written, made, rtol=0.01, atol=CLAIM_TOLERANCE))
    return written == made


def _is_near(written: object, made: object) -> bool:
    """Return whether two JSON values are equal up to ``TOLERANCE``."""
    if isinstance(written, Mapping) and isinstance(made, Mapping):
        return written.keys() == made.keys() and all(_is_near(written[key], made[key]) for key in made)
    if isinstance(written, list | tuple) and isinstance(made, list | tuple):
        return len(written) == len(made) and all(_is_near(a, b) for a, b in zip(written, made, strict=True))
    if isinstance(written, float | int) and isinstance(made, float | int):
        return bool(abs(written - made) <= TOLERANCE)
    return written == made


def _agree(written: np.ndarray, expected: np.ndarray) -> bool:
    return written.shape == expected.shape and bool(np.allclose(written, expected, rtol=0.0, atol=TOLERANCE))
