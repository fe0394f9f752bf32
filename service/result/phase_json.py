"""What holds along a phase as plain data, and back: contacts, allowances, targets, support polygon."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.allowance import Allowance, BodyRef
from service.verify import (
    AxisTarget,
    CircleTarget,
    JointTarget,
    Phase,
    PlantedContact,
    PoseTarget,
    RelativePoseTarget,
    SupportPolygon,
    Target,
)


def sample_index(s: Float[np.ndarray, "S"], at: float) -> int:
    """The sample nearest to a path parameter."""
    return int(np.abs(s - at).argmin())


def phase_json(phase: Phase, s: Float[np.ndarray, "S"]) -> dict[str, Any]:
    """A phase whose places on the path are indices of the samples ``s``."""
    return {
        "name": phase.name,
        "first": sample_index(s, phase.first),
        "last": sample_index(s, phase.last),
        "contacts": [_contact(contact) for contact in phase.contacts],
        "allowances": [_allowance(allowance) for allowance in phase.allowances],
        "targets": [_target(target, s) for target in phase.targets],
        "support": None if phase.support is None else _support(phase.support),
    }


def phase_from_json(data: Mapping[str, Any], s: Float[np.ndarray, "S"]) -> Phase:
    """The phase that ``phase_json`` wrote.

    Raises:
        KeyError, TypeError, ValueError, IndexError: the data do not follow docs/result-format.md.
    """
    support = data["support"]
    return Phase(
        name=data["name"],
        first=float(s[data["first"]]),
        last=float(s[data["last"]]),
        contacts=tuple(_read_contact(contact) for contact in data["contacts"]),
        allowances=tuple(_read_allowance(allowance) for allowance in data["allowances"]),
        targets=tuple(_read_target(target, s) for target in data["targets"]),
        support=None
        if support is None
        else SupportPolygon(np.array(support["polygon"]), float(support["margin_m"]), float(support["height"])),
    )


def _allowance(allowance: Allowance) -> dict[str, Any]:
    first, second = ({"owner": r.owner, "link": r.link, "body": r.body} for r in (allowance.first, allowance.second))
    return {"first": first, "second": second, "depth": allowance.depth}


def _read_allowance(data: Mapping[str, Any]) -> Allowance:
    first, second = (BodyRef(r["owner"], r["link"], r["body"]) for r in (data["first"], data["second"]))
    return Allowance(first, second, float(data["depth"]))


def targets_json(targets: Iterable[Target], s: Float[np.ndarray, "S"]) -> list[dict[str, Any]]:
    """Targets as a phase holds them, their places on the path as indices of the samples ``s``."""
    return [_target(target, s) for target in targets]


def _contact(contact: PlantedContact) -> dict[str, Any]:
    pose = contact.pose_world_link
    return {
        "link": contact.link,
        "position": pose[:3, 3].tolist(),
        "quaternion_wxyz": _quaternion(pose[:3, :3]),
        "sole": (contact.sole @ pose[:3, :3].T + pose[:3, 3]).tolist(),
        "tolerance_m": contact.tolerance_m,
        "knot_tolerance_m": contact.knot_tolerance_m,
    }


def _read_contact(data: Mapping[str, Any]) -> PlantedContact:
    pose = np.eye(4)
    pose[:3, :3] = _rotation(data["quaternion_wxyz"])
    pose[:3, 3] = data["position"]
    sole = (np.array(data["sole"]) - pose[:3, 3]) @ pose[:3, :3]
    return PlantedContact(data["link"], pose, sole, float(data["tolerance_m"]), float(data["knot_tolerance_m"]))


def _target(target: Target, s: Float[np.ndarray, "S"]) -> dict[str, Any]:
    match target:
        case PoseTarget():
            return {
                "kind": "pose",
                "frame": target.frame,
                "position": target.position.tolist(),
                "quaternion_wxyz": None if target.rotation is None else _quaternion(target.rotation),
                "position_tolerance_m": _finite(target.position_tolerance_m),
                "rotation_tolerance_deg": _finite(np.degrees(target.rotation_tolerance)),
                "at": None if target.at is None else sample_index(s, target.at),
            }
        case CircleTarget():
            return {
                "kind": "circle",
                "frame": target.frame,
                "centre": target.centre.tolist(),
                "axis": target.axis.tolist(),
                "radius": target.radius,
                "tolerance_m": target.tolerance_m,
                "frame_axis": None if target.frame_axis is None else target.frame_axis.tolist(),
                "axis_tolerance_deg": _finite(np.degrees(np.array([target.axis_tolerance_rad])))[0],
            }
        case AxisTarget():
            return {
                "kind": "axis",
                "frame": target.frame,
                "frame_axis": target.frame_axis.tolist(),
                "axis": target.axis.tolist(),
                "axis_tolerance_deg": float(np.degrees(target.tolerance_rad)),
                "at": None if target.at is None else sample_index(s, target.at),
            }
        case RelativePoseTarget():
            return {
                "kind": "relative_pose",
                "frame": target.frame,
                "reference": target.reference,
                "position": target.position.tolist(),
                "quaternion_wxyz": _quaternion(target.rotation),
                "position_tolerance_m": target.position_tolerance_m,
                "rotation_tolerance_deg": float(np.degrees(target.rotation_tolerance_rad)),
                "free_axis": None if target.free_axis is None else target.free_axis.tolist(),
            }
        case JointTarget():
            return {
                "kind": "joint",
                "joint": target.joint,
                "value": target.value,
                "tolerance": target.tolerance,
                "at": sample_index(s, target.at),
            }


def _read_target(data: Mapping[str, Any], s: Float[np.ndarray, "S"]) -> Target:
    match data["kind"]:
        case "pose":
            quaternion = data["quaternion_wxyz"]
            return PoseTarget(
                data["frame"],
                np.array(data["position"], dtype=float),
                None if quaternion is None else _rotation(quaternion),
                _read_finite(data["position_tolerance_m"]),
                np.radians(_read_finite(data["rotation_tolerance_deg"])),
                None if data["at"] is None else float(s[data["at"]]),
            )
        case "circle":
            return CircleTarget(
                data["frame"],
                np.array(data["centre"], dtype=float),
                np.array(data["axis"], dtype=float),
                float(data["radius"]),
                float(data["tolerance_m"]),
                None if data["frame_axis"] is None else np.array(data["frame_axis"], dtype=float),
                float(np.radians(_read_finite([data["axis_tolerance_deg"]])[0])),
            )
        case "axis":
            frame_axis, axis = (np.array(data[key], dtype=float) for key in ("frame_axis", "axis"))
            tolerance, at = float(np.radians(data["axis_tolerance_deg"])), data["at"]
            return AxisTarget(data["frame"], frame_axis, axis, tolerance, None if at is None else float(s[at]))
        case "relative_pose":
            free = data["free_axis"]
            return RelativePoseTarget(
                data["frame"],
                data["reference"],
                np.array(data["position"], dtype=float),
                _rotation(data["quaternion_wxyz"]),
                float(data["position_tolerance_m"]),
                float(np.radians(data["rotation_tolerance_deg"])),
                None if free is None else np.array(free, dtype=float),
            )
        case "joint":
            return JointTarget(data["joint"], float(data["value"]), float(data["tolerance"]), float(s[data["at"]]))
        case kind:
            raise ValueError(f"unknown target kind {kind!r}; pose, circle, axis, relative_pose or joint would do")


def _support(support: SupportPolygon) -> dict[str, Any]:
    return {"polygon": support.polygon.tolist(), "margin_m": support.margin_m, "height": support.height}


def _quaternion(rotation: Float[np.ndarray, "3 3"]) -> list[float]:
    quaternion: list[float] = Rotation.from_matrix(rotation).as_quat(scalar_first=True, canonical=True).tolist()
    return quaternion


def _rotation(quaternion_wxyz: list[float]) -> Float[np.ndarray, "3 3"]:
    return np.asarray(Rotation.from_quat(quaternion_wxyz, scalar_first=True).as_matrix())


def _finite(values: Float[np.ndarray, "k"]) -> list[float | None]:
    """Infinite tolerances, which JSON lacks, as null."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _read_finite(values: list[float | None]) -> Float[np.ndarray, "k"]:
    return np.array([np.inf if value is None else float(value) for value in values])
