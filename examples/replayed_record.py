"""Agreement of facts that a result folder states more than once: hashes, samples, the CSV table, times and speeds.

A part of `check_certificate.py`; imports only numpy and pinocchio.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from replayed_motion import Array, Replay

SAME = 1e-6  # tolerance of numbers that are written twice [m, rad, s]
Claim = tuple[bool, str]


def hashes(folder: Path, data: dict[str, Any]) -> Claim:
    """Check the recorded hashes of the request, the URDF, the pieces, the bodies and the promises."""
    canonical = json.dumps(data["request"], sort_keys=True, separators=(",", ":"))
    moved = [(b["name"], b["vertices"] - np.array(m["origin"])) for m in data["movables"] for b in m["bodies"]]
    own = [(b["name"], b["vertices"]) for b in [*data["bodies"], *(data.get("objects") or [])]]
    bodies = sorted(own + moved, key=lambda b: b[0])
    proof = data["certificate"]
    expected = {
        "request_hash": (data["request_hash"], _sha(canonical.encode())),
        "robot_sha256": (proof["robot_sha256"], _sha((folder / data["robot"]["urdf"]).read_bytes())),
        "scene_sha256": (proof["scene_sha256"], _of_shapes(sorted((p["name"], p["vertices"]) for p in data["pieces"]))),
        "promises_sha256": (proof["promises_sha256"], _of_promises(data)),
    }
    pairs = [tuple(pair) for pair in data["ignored_pairs"]]
    if not data["movables"]:  # a mechanism adds ignored pairs that the folder does not list
        named = [(f"{a}|{b}", np.empty((0, 3))) for a, b in sorted(pairs)]
        expected["bodies_sha256"] = (proof["bodies_sha256"], _of_shapes(bodies + named))
    wrong = [name for name, (written, made) in expected.items() if written != made]
    return not wrong, f"{', '.join(wrong)} do not fit" if wrong else f"{len(expected)} made anew"


def samples(folder: Path, replay: Replay, data: dict[str, Any]) -> Claim:
    """Check that the samples and the CSV table are points of the curve at the times of its law."""
    is_floating, n = bool(replay.base.any()), len(data["curve"]["joint_names"]) - len(data["movables"])
    rows, times = np.array(data["trajectory"]["positions"], float), np.array(data["trajectory"]["times"], float)
    q = np.array([replay.q(s)[replay.own][:n] for s in replay.samples])
    header, *lines = (folder / "trajectory.csv").read_text().splitlines() or [""]
    written = np.column_stack([times, rows])
    table = np.loadtxt(lines, delimiter=",", ndmin=2, comments=None)[:, : written.shape[1]]  # speeds follow
    off = [len(rows) != len(q) or table.shape != written.shape or not np.allclose(table, written, atol=SAME, rtol=0.0)]
    off[0] = off[0] or not (header + ",").startswith(",".join(("time", *data["trajectory"]["joint_names"], "")))
    if not off[0]:
        own = rows[:, 7:] if is_floating else rows
        off.append(not np.allclose(own, q[:, 6 if is_floating else 0 :], atol=SAME, rtol=0.0))
        if is_floating:
            for row, place in zip(rows, q, strict=True):
                z, y, x = place[3:6]
                turn = pin.rpy.rpyToMatrix(x, y, z)
                written = pin.Quaternion(np.roll(row[3:7], -1)).matrix()
                off.append(np.abs(written - turn).max() > SAME or np.abs(row[:3] - place[:3]).max() > SAME)
        off.append(not np.allclose(times, [_time(data, s) for s in replay.samples], atol=SAME, rtol=0.0))
    return not any(off), f"{len(rows)} on the curve and in trajectory.csv" if not any(off) else "not on the curve"


def rates(folder: Path, replay: Replay, data: dict[str, Any]) -> Claim:
    """Check velocities and accelerations of the CSV table; where the law or the spline has a corner, either side's."""
    header, *lines = (folder / "trajectory.csv").read_text().splitlines() or [""]
    law, columns = data["curve"]["law"], header.split(",")[1 + len(data["trajectory"]["joint_names"]) :]
    names = data["curve"]["joint_names"][: len(replay.own) - len(data["movables"])]
    if law is None or not columns:
        return not columns, "there are none" if not columns else "an untimed motion has rates"
    if columns != [f"{kind}.{name}" for kind in ("velocity", "acceleration") for name in names]:
        return False, "columns of rates are not those of the joints"
    table = np.loadtxt(lines, delimiter=",", ndmin=2, comments=None)[:, -len(columns) :]
    worst = 0.0
    for row, s in zip(table, replay.samples, strict=True):
        off = [np.abs(row - made) / (1.0 + np.abs(row)) for made in _sides(replay, law, s, len(names))]
        worst = max(worst, float(np.min(off, axis=0).max()))
    return worst <= 1e-4, f"{worst:.1e} off, relative above 1"


def _sides(replay: Replay, law: dict[str, Any], s: float, n: int) -> Iterator[Array]:
    """Yield velocities and accelerations at s, by the steps of the law and the pieces of the spline around it."""
    times, path, speed = (np.array(law[key], float) for key in ("times", "path", "speed"))
    step, piece = (int(np.searchsorted(grid, s, side="left")) for grid in (path, replay.knots))
    for i in {int(np.clip(i, 0, len(path) - 2)) for i in (step - 1, step)}:
        gain = (speed[i + 1] - speed[i]) / (times[i + 1] - times[i])
        pace = np.sqrt(max(speed[i] ** 2 + 2 * gain * (s - path[i]), 0.0))
        for k in {int(np.clip(k, 0, len(replay.knots) - 2)) for k in (piece - 1, piece)}:
            slope, bend = replay.q(s, 1, k)[replay.own][:n], replay.q(s, 2, k)[replay.own][:n]
            yield np.concatenate([slope * pace, slope * gain + bend * pace**2])


def speeds(replay: Replay, data: dict[str, Any]) -> Claim:
    """Check the joint speeds against the URDF, at the ends of the law's steps and from sample to sample."""
    law, model = data["curve"]["law"], replay.model
    if law is None:
        return True, "the motion is untimed"
    first = 6 if replay.base.any() else 0
    last = model.nv - len(data["movables"])
    limit = np.asarray(model.velocityLimit)[first:last]
    limit = np.where(limit > 0.0, limit, np.inf)
    fastest = 0.0
    for s, rate in zip(law["path"], law["speed"], strict=True):
        piece = int(np.clip(np.searchsorted(replay.knots, s, side="right") - 1, 0, len(replay.knots) - 2))
        for one in {piece, max(piece - 1, 0)} if s in replay.knots else {piece}:
            fastest = max(fastest, float((np.abs(replay.q(s, 1, one)[first:last]) * rate / limit).max(initial=0.0)))
    times = np.array(data["trajectory"]["times"], float)
    q = np.array([replay.q(s)[first:last] for s in replay.samples])
    steps = np.abs(np.diff(q, axis=0)) / np.diff(times)[:, None]
    fastest = max(fastest, float((steps / limit).max(initial=0.0)))
    return fastest <= 1.0 + SAME, f"{100 * fastest:.1f} % of the nearest speed limit"


def _time(data: dict[str, Any], s: float) -> float:
    """Return the time at path parameter s; between two nodes of the law the path acceleration is constant."""
    law = data["curve"]["law"]
    if law is None:
        return float(s)
    times, path, speed = (np.array(law[key], float) for key in ("times", "path", "speed"))
    i = int(np.clip(np.searchsorted(path, s, side="left") - 1, 0, len(path) - 2))
    duration, ahead = times[i + 1] - times[i], max(s - path[i], 0.0)
    gain = (speed[i + 1] - speed[i]) / duration
    mean = 0.5 * (speed[i] + np.sqrt(max(speed[i] ** 2 + 2 * gain * ahead, 0.0)))
    return float(times[i] + min(ahead / mean if mean > 0 else 0.0, duration))


def _sha(content: bytes) -> str:
    return "sha256:" + hashlib.sha256(content).hexdigest()


def _of_shapes(named: list[tuple[str, Any]]) -> str:
    """Hash name, number of vertices, and vertices in whole micrometres, one shape after the other."""
    content = b""
    for name, vertices in named:
        content += name.encode() + b"\0" + len(vertices).to_bytes(8, "little")
        content += np.rint(np.array(vertices, float) * 1e6).astype("<i8").tobytes()
    return _sha(content)


def _of_promises(data: dict[str, Any]) -> str:
    """Hash the texts and numbers of all promises in the order of docs/result-format.md."""
    s, content = data["curve"]["samples"], b""
    parts: list[str | Array] = [part for phase in data["phases"] for part in _promises(phase, s)]
    for rule in data["releases"]:
        parts += ["release", rule["joint"], rule["latch"], np.array(rule["latch_at"]), np.array(rule["free_beyond"])]
    for item in data.get("objects") or []:
        start = np.eye(4)
        start[:3, :3], start[:3, 3] = _rotation(item["start"]["quaternion_wxyz"]), item["start"]["position"]
        parts += ["object", item["name"], start]
        parts += [np.array(item[key]) for key in ("mass_kg", "centre", "moments")]
    for part in parts:
        if isinstance(part, str):
            content += b"t" + part.encode() + b"\0"
            continue
        numbers = np.asarray(part, float).ravel()
        steps = np.floor(np.where(np.isinf(numbers), -1.0, numbers) * 1e6 + 0.381966)
        content += b"n" + steps.size.to_bytes(8, "little") + steps.astype("<i8").tobytes()
    return _sha(content)


def _promises(phase: dict[str, Any], s: list[float]) -> Iterator[str | Array]:
    none = np.empty(0)
    yield from ("phase", phase["name"], np.array([s[phase["first"]], s[phase["last"]]]))
    for one in phase["allowances"]:
        refs = [one[which][key] for which in ("first", "second") for key in ("owner", "link", "body")]
        yield from ("allowance", *(none if ref is None else ref for ref in refs), np.array(one["depth"]))
    for one in phase["contacts"]:
        turn, place = _rotation(one["quaternion_wxyz"]), np.array(one["position"])
        pose = np.vstack([np.column_stack([turn, place]), [0, 0, 0, 1]])
        sole = (np.array(one["sole"]) - place) @ turn
        yield from ("contact", one["link"], pose, sole)
        yield from (np.array(one[key]) for key in ("tolerance_m", "knot_tolerance_m", "friction", "force_cap_n"))
        yield none if one["normal"] is None else np.array(one["normal"])
        yield np.array(one["tilt_rad"])
    if phase["support"] is not None:
        support = phase["support"]
        yield from ("support", *(np.array(support[key]) for key in ("polygon", "margin_m", "height")))
    if phase["region_margin_m"] is not None:
        yield from ("region margin", np.array([phase["region_margin_m"]]))
    for one in phase["targets"]:
        yield from _target(one, s)
    for one in phase["loads"]:
        slide = none if one["slide"] is None else np.array(one["slide"])
        yield from ("load", one["tool"], one["link"], np.array(one["place"]), np.array(one["force_n"]), slide)
        yield from (np.array(one.get(key, 0.0)) for key in ("drift_m", "across_n", "twist_nm"))
    for one in phase["pushes"]:
        yield from _push(one)
    for one in phase.get("carriers", ()):
        yield from ("carrier", one["object"], one["link"] or "")
        for grip in one["grips"]:
            yield from ("grip", *grip["fingers"], np.array([grip["force_n"], grip["friction"]]))


def _push(one: dict[str, Any]) -> Iterator[str | Array]:
    yield from ("push", one["joint"], np.array(one["sense"]), np.array(one["force_n"]))
    for part in one["contacts"]:
        yield from (part["frame"], part["surface"], np.array(part["core"]), np.array(part["radius"]))
        yield from (part["link"], part["body"], np.array(part["cap_n"]))
    yield np.array(one["friction"])
    for part in one["held"]:
        yield from (part["joint"], *(np.array(np.inf if part[k] is None else part[k]) for k in ("low", "high")))


def _target(one: dict[str, Any], s: list[float]) -> Iterator[str | Array]:
    none = np.empty(0)
    at = none if one.get("at") is None else np.array(s[one["at"]])
    turn = none if one.get("quaternion_wxyz") is None else _rotation(one["quaternion_wxyz"])
    match one["kind"]:
        case "pose":
            place, turning = (
                _tolerance(one["position_tolerance_m"]),
                np.radians(_tolerance(one["rotation_tolerance_deg"])),
            )
            yield from ("PoseTarget", one["frame"], np.array(one["position"]), turn, place, turning, at)
        case "circle":
            yield from ("CircleTarget", one["frame"], *(np.array(one[k]) for k in ("centre", "axis", "radius")))
            yield np.array(one["tolerance_m"])
            yield none if one["frame_axis"] is None else np.array(one["frame_axis"])
            yield np.radians(_tolerance([one["axis_tolerance_deg"]]))
        case "axis":
            yield from ("AxisTarget", one["frame"], np.array(one["frame_axis"]), np.array(one["axis"]))
            yield from (np.radians(one["axis_tolerance_deg"]), at)
        case "relative_pose":
            yield from ("RelativePoseTarget", one["frame"], none if one["reference"] is None else one["reference"])
            yield from (np.array(one["position"]), turn, np.array(one["position_tolerance_m"]))
            yield np.radians(one["rotation_tolerance_deg"])
            yield from (none if one[key] is None else np.array(one[key]) for key in ("free_axis", "slide"))
        case "region":
            yield from ("RegionTarget", one["frame"], none if one["reference"] is None else one["reference"])
            yield from (np.array(one["position"]), turn, -_tolerance(_negate(one["lower_m"])))
            yield from (_tolerance(one["upper_m"]), *(_tolerance([one[key]]) for key in ("radius_m", "distance_m")))
            yield from (np.radians(_tolerance([one["turn_deg"]])), np.radians(_tolerance(one["turns_deg"])))
            yield from (none if one[key] is None else np.array(one[key]) for key in ("axis", "look"))
            yield from (np.radians(_tolerance([one["lean_deg"]])), np.array(one["during"]), at)
        case "hole":
            yield from ("HoleTarget", one["frame"], *(np.array(one[k]) for k in ("position", "axis", "frame_axis")))
            yield from (np.array(one[k]) for k in ("depth_m", "radius_m", "length_m", "play_m", "friction", "force_n"))
            yield from (np.array(one[k]) for k in ("stiffness_n_m", "turn_stiffness_n_m_rad"))
        case "way":
            yield from ("WayTarget", one["frame"], np.array(one["position"]), turn)
            yield from (np.array(one[k]) for k in ("centre", "axis", "angle_rad", "shift", "turn_rad"))
            yield _tolerance([one["tolerance_m"]])
            yield np.radians(_tolerance([one["rotation_tolerance_deg"]]))
            yield from (none if one[key] is None else np.array(one[key]) for key in ("free_axis", "speed_m_s"))
            yield from (np.array(one[key]) for key in ("speed_share", "ramp_m"))
        case "joint_way":
            yield "JointWayTarget"
            yield from one["joints"] or [none]
            yield from (np.array(one[key]) for key in ("first", "last", "tolerance"))
            yield one["profile"]
            yield none if one["duration_s"] is None else np.array(one["duration_s"])
        case "joint":
            yield from ("JointTarget", one["joint"], np.array(one["value"]), np.array(one["tolerance"]), at)


def _tolerance(values: list[float | None]) -> Array:
    return np.array([np.inf if value is None else value for value in values])


def _rotation(quaternion_wxyz: list[float]) -> Array:
    return np.asarray(pin.Quaternion(np.roll(quaternion_wxyz, -1)).matrix())


def _negate(values: list[float | None]) -> list[float | None]:
    return [None if value is None else -value for value in values]
