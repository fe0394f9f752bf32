"""Writer and reader of phases in ``result.json``: contacts, allowances, targets, support polygon."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.rotation import quaternion_matrix
from service.verify import (
    AxisTarget,
    Carrier,
    CircleTarget,
    Grip,
    HandContact,
    HandLoad,
    HandPush,
    HeldJoint,
    HoleTarget,
    JointTarget,
    JointWayTarget,
    LoadedRegion,
    Phase,
    PlantedContact,
    PoseTarget,
    PressedPart,
    RegionTarget,
    RelativePoseTarget,
    SupportPolygon,
    Target,
    WayTarget,
)

FORCE_DIGITS = 8  # of the witnesses in newtons, as they are written


def sample_index(s: Float[np.ndarray, "S"], at: float) -> int:
    """Return the index of the sample nearest to a path parameter."""
    return int(np.abs(s - at).argmin())


def phase_json(phase: Phase, s: Float[np.ndarray, "S"]) -> dict[str, Any]:
    """Write a phase; path parameters become indices of the samples ``s``."""
    return {
        "name": phase.name,
        "first": sample_index(s, phase.first),
        "last": sample_index(s, phase.last),
        "contacts": [_write_contact(contact) for contact in phase.contacts],
        "allowances": [_write_allowance(allowance) for allowance in phase.allowances],
        "targets": targets_json(phase.targets, s),
        "support": None if phase.support is None else _write_support(phase.support),
        "loads": [_write_load(load) for load in phase.loads],
        "pushes": [_write_push(push) for push in phase.pushes],
        "regions": [_write_region(region, s) for region in phase.regions],
        "region_margin_m": phase.region_margin_m,
        "pressed": None if phase.pressed is None else [asdict(part) for part in phase.pressed],
        "carriers": [_write_carrier(carrier) for carrier in phase.carriers],
    }


def phase_from_json(data: Mapping[str, Any], s: Float[np.ndarray, "S"]) -> Phase:
    """Read a phase that ``phase_json`` wrote.

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
        loads=tuple(_read_load(load) for load in data["loads"]),
        pushes=tuple(_read_push(push) for push in data.get("pushes", ())),
        regions=tuple(_read_region(region, s) for region in data["regions"]),
        region_margin_m=None if data["region_margin_m"] is None else float(data["region_margin_m"]),
        pressed=_read_pressed(data.get("pressed")),
        carriers=tuple(_read_carrier(carrier) for carrier in data.get("carriers", ())),
    )


def _write_carrier(carrier: Carrier) -> dict[str, Any]:
    return {
        "object": carrier.item,
        "link": carrier.link,
        "grips": [
            {"fingers": list(grip.fingers), "force_n": grip.force_n, "friction": grip.friction}
            for grip in carrier.grips
        ],
    }


def _read_carrier(data: Mapping[str, Any]) -> Carrier:
    grips = (Grip(tuple(g["fingers"]), float(g["force_n"]), float(g["friction"])) for g in data["grips"])
    return Carrier(str(data["object"]), data["link"], tuple(grips))


def _read_pressed(parts: Sequence[Mapping[str, Any]] | None) -> tuple[PressedPart, ...] | None:
    """Read the pressed parts of a phase; None where an earlier release wrote none."""
    return None if parts is None else tuple(PressedPart(**part) for part in parts)


def _write_allowance(allowance: Allowance) -> dict[str, Any]:
    first, second = ({"owner": r.owner, "link": r.link, "body": r.body} for r in (allowance.first, allowance.second))
    return {"first": first, "second": second, "depth": allowance.depth}


def _read_allowance(data: Mapping[str, Any]) -> Allowance:
    first, second = (BodyRef(r["owner"], r["link"], r["body"]) for r in (data["first"], data["second"]))
    return Allowance(first, second, float(data["depth"]))


def targets_json(targets: Iterable[Target], s: Float[np.ndarray, "S"]) -> list[dict[str, Any]]:
    """Write targets; path parameters become indices of the samples ``s``."""
    return [_write_target(target, s) for target in targets]


def _write_contact(contact: PlantedContact) -> dict[str, Any]:
    pose = contact.pose_world_link
    return {
        "link": contact.link,
        "position": pose[:3, 3].tolist(),
        "quaternion_wxyz": write_rotation(pose[:3, :3]),
        "sole": contact.points.tolist(),
        "tolerance_m": contact.tolerance_m,
        "knot_tolerance_m": contact.knot_tolerance_m,
        "friction": contact.friction,
        "force_cap_n": contact.force_cap_n,
        "normal": None if contact.normal is None else contact.normal.tolist(),
        "tilt_rad": contact.tilt_rad,
    }


def _read_contact(data: Mapping[str, Any]) -> PlantedContact:
    pose = np.eye(4)
    pose[:3, :3] = read_rotation(data["quaternion_wxyz"])
    pose[:3, 3] = data["position"]
    sole = (np.array(data["sole"]) - pose[:3, 3]) @ pose[:3, :3]
    numbers = (float(data[key]) for key in ("tolerance_m", "knot_tolerance_m", "friction", "force_cap_n"))
    normal = None if data["normal"] is None else np.array(data["normal"], dtype=float)
    tolerance, knot_tolerance, friction, cap = numbers
    return PlantedContact(
        data["link"], pose, sole, tolerance, knot_tolerance, friction, cap, normal, float(data["tilt_rad"])
    )


def _write_support(support: SupportPolygon) -> dict[str, Any]:
    return {"polygon": support.polygon.tolist(), "margin_m": support.margin_m, "height": support.height}


def _write_load(load: HandLoad) -> dict[str, Any]:
    return {
        "tool": load.tool,
        "link": load.link,
        "place": load.place.tolist(),
        "force_n": load.force.tolist(),
        "slide": None if load.slide is None else load.slide.tolist(),
        "drift_m": load.drift_m,
        "across_n": load.across_n,
        "twist_nm": load.twist_nm,
    }


def _read_load(data: Mapping[str, Any]) -> HandLoad:
    place, force = np.array(data["place"], dtype=float), np.array(data["force_n"], dtype=float)
    slide = None if data["slide"] is None else np.array(data["slide"], dtype=float)
    more = (float(data.get(name, 0.0)) for name in ("across_n", "twist_nm"))
    return HandLoad(data["tool"], data["link"], place, force, slide, float(data["drift_m"]), *more)


def _write_push(push: HandPush) -> dict[str, Any]:
    return {
        "joint": push.joint,
        "sense": push.sense,
        "force_n": push.force_n,
        "friction": list(push.friction),
        "held": [{"joint": held.joint, "low": _finite(held.low), "high": _finite(held.high)} for held in push.held],
        "contacts": [
            {
                "frame": contact.frame,
                "surface": contact.surface,
                "core": contact.core.tolist(),
                "radius": contact.radius,
                "link": contact.link,
                "body": contact.body,
                "cap_n": contact.cap_n,
            }
            for contact in push.contacts
        ],
    }


def _read_push(data: Mapping[str, Any]) -> HandPush:
    contacts = tuple(
        HandContact(
            contact["frame"],
            contact["surface"],
            np.array(contact["core"], dtype=float),
            float(contact["radius"]),
            contact["link"],
            contact["body"],
            float(contact["cap_n"]),
        )
        for contact in data["contacts"]
    )
    held = tuple(
        HeldJoint(
            entry["joint"],
            -np.inf if entry["low"] is None else float(entry["low"]),
            np.inf if entry["high"] is None else float(entry["high"]),
        )
        for entry in data["held"]
    )
    low, high = data["friction"]
    friction = (float(low), float(high))
    return HandPush(data["joint"], float(data["sense"]), float(data["force_n"]), contacts, friction, held)


def _finite(value: float) -> float | None:
    """Return a number for JSON, which lacks infinity: null."""
    return float(value) if np.isfinite(value) else None


def _write_region(region: LoadedRegion, s: Float[np.ndarray, "S"]) -> dict[str, Any]:
    return {
        "first": sample_index(s, region.first),
        "last": sample_index(s, region.last),
        "polygon": region.vertices.tolist(),
        "wrenches": region.wrenches.tolist(),
        "witnesses": np.round(region.witnesses, FORCE_DIGITS).tolist(),
    }


def _read_region(data: Mapping[str, Any], s: Float[np.ndarray, "S"]) -> LoadedRegion:
    polygon, wrenches, witnesses = (np.array(data[key], dtype=float) for key in ("polygon", "wrenches", "witnesses"))
    return LoadedRegion(float(s[data["first"]]), float(s[data["last"]]), polygon, wrenches, witnesses)


def write_rotation(rotation: Float[np.ndarray, "3 3"]) -> list[float]:
    """Return a rotation as a quaternion (w, x, y, z) with w >= 0."""
    from scipy.spatial.transform import Rotation  # slow to import

    quaternion: list[float] = Rotation.from_matrix(rotation).as_quat(scalar_first=True, canonical=True).tolist()
    return quaternion


def read_rotation(quaternion_wxyz: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation matrix of a quaternion."""
    return quaternion_matrix(quaternion_wxyz)


@dataclass(frozen=True)
class _Codec:
    """Writer and reader of a target's field; both also take the samples' path parameters."""

    write: Callable[[Any, Float[np.ndarray, "S"]], Any]
    read: Callable[[Any, Float[np.ndarray, "S"]], Any]


def _or_null(codec: _Codec) -> _Codec:
    return _Codec(
        lambda value, s: None if value is None else codec.write(value, s),
        lambda data, s: None if data is None else codec.read(data, s),
    )


_TEXT = _Codec(lambda value, s: value, lambda data, s: data)
_NUMBER = _Codec(lambda value, s: value, lambda data, s: float(data))
_ANGLE = _Codec(lambda value, s: float(np.degrees(value)), lambda data, s: float(np.radians(data)))
_VECTOR = _Codec(lambda value, s: value.tolist(), lambda data, s: np.array(data, dtype=float))
_ROTATION = _Codec(lambda value, s: write_rotation(value), lambda data, s: read_rotation(data))
_SAMPLE = _Codec(lambda value, s: sample_index(s, value), lambda data, s: float(s[data]))
# JSON lacks infinity: a free axis has a tolerance of null.
_TOLERANCES = _Codec(
    lambda value, s: [float(entry) if np.isfinite(entry) else None for entry in value],
    lambda data, s: np.array([np.inf if entry is None else float(entry) for entry in data]),
)
_FREE_ANGLES = _Codec(
    lambda value, s: _TOLERANCES.write(np.degrees(value), s), lambda data, s: np.radians(_TOLERANCES.read(data, s))
)
_FREE_ANGLE = _Codec(
    lambda value, s: _FREE_ANGLES.write([value], s)[0], lambda data, s: float(_FREE_ANGLES.read([data], s)[0])
)
_FREE_NUMBER = _Codec(lambda value, s: _finite(value), lambda data, s: np.inf if data is None else float(data))
_BOUNDS_BELOW = _Codec(
    lambda value, s: _TOLERANCES.write(value, s), lambda data, s: -_TOLERANCES.read(_negate(data), s)
)
_TARGETS: Mapping[str, tuple[type[Target], Mapping[str, _Codec]]] = {
    "pose": (
        PoseTarget,
        {
            "frame": _TEXT,
            "position": _VECTOR,
            "quaternion_wxyz": _or_null(_ROTATION),
            "position_tolerance_m": _TOLERANCES,
            "rotation_tolerance_deg": _FREE_ANGLES,
            "at": _or_null(_SAMPLE),
        },
    ),
    "circle": (
        CircleTarget,
        {
            "frame": _TEXT,
            "centre": _VECTOR,
            "axis": _VECTOR,
            "radius": _NUMBER,
            "tolerance_m": _NUMBER,
            "frame_axis": _or_null(_VECTOR),
            "axis_tolerance_deg": _FREE_ANGLE,
        },
    ),
    "axis": (
        AxisTarget,
        {"frame": _TEXT, "frame_axis": _VECTOR, "axis": _VECTOR, "axis_tolerance_deg": _ANGLE, "at": _or_null(_SAMPLE)},
    ),
    "relative_pose": (
        RelativePoseTarget,
        {
            "frame": _TEXT,
            "reference": _TEXT,
            "position": _VECTOR,
            "quaternion_wxyz": _ROTATION,
            "position_tolerance_m": _NUMBER,
            "rotation_tolerance_deg": _ANGLE,
            "free_axis": _or_null(_VECTOR),
            "slide": _or_null(_VECTOR),
        },
    ),
    "region": (
        RegionTarget,
        {
            "frame": _TEXT,
            "reference": _TEXT,
            "position": _VECTOR,
            "quaternion_wxyz": _ROTATION,
            "lower_m": _BOUNDS_BELOW,
            "upper_m": _TOLERANCES,
            "radius_m": _FREE_NUMBER,
            "distance_m": _FREE_NUMBER,
            "turn_deg": _FREE_ANGLE,
            "turns_deg": _FREE_ANGLES,
            "axis": _or_null(_VECTOR),
            "look": _or_null(_VECTOR),
            "lean_deg": _FREE_ANGLE,
            "during": _VECTOR,
            "at": _or_null(_SAMPLE),
        },
    ),
    "hole": (
        HoleTarget,
        {
            "frame": _TEXT,
            **dict.fromkeys(("position", "axis", "frame_axis"), _VECTOR),
            **dict.fromkeys(("depth_m", "radius_m", "length_m", "play_m", "friction", "force_n"), _NUMBER),
            **dict.fromkeys(("stiffness_n_m", "turn_stiffness_n_m_rad"), _NUMBER),
        },
    ),
    "way": (
        WayTarget,
        {
            "frame": _TEXT,
            "position": _VECTOR,
            "quaternion_wxyz": _ROTATION,
            "centre": _VECTOR,
            "axis": _VECTOR,
            "angle_rad": _NUMBER,
            "shift": _VECTOR,
            "turn_rad": _VECTOR,
            "tolerance_m": _FREE_NUMBER,
            "rotation_tolerance_deg": _FREE_ANGLE,
            "free_axis": _or_null(_VECTOR),
            "speed_m_s": _or_null(_NUMBER),
            "speed_share": _NUMBER,
            "ramp_m": _NUMBER,
        },
    ),
    "joint_way": (
        JointWayTarget,
        {
            "joints": _Codec(lambda value, s: list(value), lambda data, s: tuple(data)),
            "first": _VECTOR,
            "last": _VECTOR,
            "tolerance": _NUMBER,
            "profile": _TEXT,
            "duration_s": _or_null(_NUMBER),
        },
    ),
    "joint": (JointTarget, {"joint": _TEXT, "value": _NUMBER, "tolerance": _NUMBER, "at": _SAMPLE}),
}
"""Class of each kind of target, and key and codec of each of its fields, in their order."""


def _negate(bounds: Sequence[float | None]) -> list[float | None]:
    return [None if bound is None else -bound for bound in bounds]


def _write_target(target: Target, s: Float[np.ndarray, "S"]) -> dict[str, Any]:
    kind, codecs = next((kind, codecs) for kind, (cls, codecs) in _TARGETS.items() if isinstance(target, cls))
    values = (getattr(target, field.name) for field in fields(target))
    return {"kind": kind, **{key: codecs[key].write(value, s) for key, value in zip(codecs, values, strict=True)}}


def _read_target(data: Mapping[str, Any], s: Float[np.ndarray, "S"]) -> Target:
    if data["kind"] not in _TARGETS:
        raise ValueError(f"unknown target kind {data['kind']!r}; expected {', '.join(_TARGETS)}")
    cls, codecs = _TARGETS[data["kind"]]
    return cls(*(codec.read(data[key], s) for key, codec in codecs.items()))
