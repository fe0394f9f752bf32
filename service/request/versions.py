"""Formats of request data: the fields and defaults that each one brought, and a request's data as each one wrote them.

A new field of the schema gets one entry in ``ADDED``, a changed default one in ``FORMER_DEFAULTS``.  A request that
leaves such a field at its default keeps the data, and with them the hash, that it had before.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

from service.errors import RequestError, shown
from service.request.fields import Section
from service.request.formats import FORMAT
from service.request.schema import PlanRequest
from service.request.tasks.registry import ADDED as ADDED_KINDS

COMPLETE = 2
"""Last format that wrote every default.  A field that came later is left out where it has its default."""

ADDED = {
    2: (
        "DoorRequest.opens",
        "DoorRequest.leaf",
        "DoorRequest.handle",
        "DoorRequest.release_deg",
        "DoorRequest.press_m",
        "DoorRequest.lever_nm",
        "DoorRequest.hinge_nm",
        "DoorRequest.push_bar_n",
        "DoorRequest.stays",
        "DoorRequest.hinge",
        "EgressRequest.surfaces",
        "EgressRequest.phases",
        "EgressRequest.phases_file",
        "EgressRequest.until",
        "EgressRequest.samples",
        "EgressRequest.torque_share",
        "EgressRequest.margin_n",
        "PlanRequest.resume",
        "RobotRequest.contacts",
        "RobotRequest.hand",
        "RobotRequest.hands",
        "RobotRequest.servo",
        "RobotRequest.locked",
        "RobotRequest.torque",
        "RobotRequest.drawn_links",
        "SceneRequest.cuts",
        "TaskRequest.contacts",
        "TaskRequest.mechanism",
        "ValveRequest.torque_nm",
        "ValveRequest.spokes_deg",
        "ValveRequest.spoke_width_m",
        "ValveRequest.sense",
        "ValveRequest.stuck",
        "ValveRequest.lever",
        "ValveRequest.stops_deg",
        "_Obstacle.in_scan",
    ),
    3: (
        "DoorRequest.moved_m",
        "GoalRequest.any_of",
        "GoalRequest.rates",
        "GoalRequest.via",
        "KeepRequest.after",
        "KeepRequest.look_at",
        "KeepRequest.look_axis",
        "KeepRequest.region",
        "KeepRequest.until",
        "MeshRequest.scale_xyz",
        "LeafChoice.slant_rad",
        "Options.clearance_m",
        "Options.hand_friction",
        "Options.jerk_scale",
        "Options.pace",
        "Options.padding",
        "Options.sway_deg",
        "Options.sway_m",
        "Options.tool_speed_m_s",
        "PoseGoalRequest.look_at",
        "PoseGoalRequest.look_axis",
        "PoseGoalRequest.region",
        "PoseGoalRequest.relative_to",
        "RobotHandRequest.fingers",
        "RobotRequest.decompose",
        "RobotServoRequest.force_noise_n",
        "RobotServoRequest.hand_stiffness_n_m",
        "RobotServoRequest.hand_turn_stiffness_n_m_rad",
        "RobotServoRequest.reaction_s",
        "SceneRequest.objects",
        "SceneRequest.level",
        "SceneRequest.sensor_model",
        "SceneRequest.sensor_sigma",
        "StartRequest.rates",
        "TaskRequest.pick_place",
        "TaskRequest.steps",
        "ValveRequest.moved_m",
    ),
}
"""Fields by the format that brought them: ``CLASS.FIELD``, with the class of the schema that declares the field.

The fields of a class need no entries where only a new field leads to it.
"""

FORMER_DEFAULTS: dict[int, dict[str, Any]] = {
    2: {
        "DoorRequest.open_deg": 80.0,
        "Options.starts": 16,
    },
    3: {"MechanismJointRequest.friction": 0.0, "Options.time_limit_s": 60.0},
}
"""Defaults that a format changed, each with the value that it had in the formats before."""

_REQUEST: TypeAdapter[PlanRequest] = TypeAdapter(PlanRequest)


@dataclasses.dataclass(frozen=True)
class _VersionedField:
    """A field that is not the same in every format.

    Attributes:
        name: of the field.
        key: ``CLASS.FIELD`` of the tables.
        added: format that brought it.
        default: today's.
        former: defaults that the format in the key changed.
    """

    name: str
    key: str
    added: int
    default: Any
    former: Mapping[int, Any]

    def default_in(self, version: int) -> Any:
        """Return the default that a format had."""
        return next((value for changed, value in sorted(self.former.items()) if version < changed), self.default)

    @property
    def defaults(self) -> list[Any]:
        """All defaults that it ever had, as JSON data."""
        return to_jsonable_python([self.default, *self.former.values()])  # type: ignore[no-any-return]


def write_as(request: PlanRequest, version: int) -> dict[str, Any]:
    """Return a request's JSON data as a format wrote them, without the folder.

    A default that the request leaves to the planner is that of the format.

    Args:
        request: any request.
        version: from ``find_first_format`` to ``FORMAT``.
    """
    data = _drop_kinds_of_others(request, dict(_REQUEST.dump_python(request, mode="json")))
    for section, part in list(_list_sections(request, data)):
        for field in _list_versioned_fields(section):
            value, default = getattr(section, field.name), field.default_in(version)
            if value == field.default and not section.is_given(field.name):
                value = default
                part[field.name] = to_jsonable_python(default)
            if field.added > version or (field.added > COMPLETE and value == default):
                del part[field.name]
    return data


def _drop_kinds_of_others(request: PlanRequest, data: dict[str, Any]) -> dict[str, Any]:
    """Remove the kinds that other packages add where a request does not use them: its data are the same without."""
    if request.task is None:
        return data
    unused = [kind.name for kind in ADDED_KINDS if getattr(request.task, kind.name) is None]
    return {**data, "task": {name: value for name, value in data["task"].items() if name not in unused}}


def find_first_format(request: PlanRequest) -> int:
    """Return the first format that has a field for every part of a request."""
    used = [
        field.added
        for section, _ in _list_sections(request, None)
        for field in _list_versioned_fields(section)
        if getattr(section, field.name) != field.default
    ]
    return max(used, default=1)


def find_format(request: PlanRequest) -> int:
    """Return the format of a request's data (``write_as`` of ``FORMAT``): the first one whose fields suffice."""
    return max(COMPLETE, find_first_format(request))


def write_given(request: PlanRequest) -> dict[str, Any]:
    """Return a request's JSON data without the defaults that differ among formats: its reader inserts its own."""
    data = write_as(request, FORMAT)
    for section, part in list(_list_sections(request, data)):
        for field in _list_versioned_fields(section):
            if field.former and not section.is_given(field.name):
                part.pop(field.name, None)
    return data


def list_defaults(request: PlanRequest) -> dict[str, Any]:
    """Return the defaults that are not in a request's data, by ``CLASS.FIELD``."""
    return {
        field.key: to_jsonable_python(field.default)
        for section, _ in _list_sections(request, None)
        for field in _list_versioned_fields(section)
        if field.added > COMPLETE and getattr(section, field.name) == field.default
    }


def insert_defaults(request: PlanRequest, recorded: object) -> dict[str, Any]:
    """Return the data of a request that was planned with the recorded defaults (``list_defaults``).

    Raises:
        RequestError: a value is no default that its field ever had.
    """
    if not isinstance(recorded, Mapping):
        raise RequestError(f"request_defaults: a mapping is needed, got {shown(recorded)}")
    data, unknown = write_as(request, FORMAT), dict(recorded)
    for section, part in list(_list_sections(request, data)):
        for field in _list_versioned_fields(section):
            if field.key not in recorded:
                continue
            value = recorded[field.key]
            unknown.pop(field.key, None)
            if value not in field.defaults:
                known = ", ".join(shown(default) for default in field.defaults)
                raise RequestError(f"request_defaults.{field.key}: expected {known}, got {shown(value)}")
            if field.name not in part:
                part[field.name] = value
    for key in unknown:
        raise RequestError(f"request_defaults: {shown(key)} is no field of this request with a later default")
    return data


def list_declared_fields(section: type) -> dict[str, str]:
    """Return the ``CLASS.FIELD`` of each field of a class of the schema, by its name."""
    declared = {
        name: f"{cls.__name__}.{name}" for cls in reversed(section.__mro__) for name in inspect.get_annotations(cls)
    }
    return {field.name: declared[field.name] for field in dataclasses.fields(section)}


def _list_versioned_fields(section: Section) -> tuple[_VersionedField, ...]:
    return _find_versioned_fields(type(section))  # type: ignore[arg-type]  # a class can be hashed


@cache
def _find_versioned_fields(section: type) -> tuple[_VersionedField, ...]:
    added = {key: version for version, keys in ADDED.items() for key in keys}
    keys = list_declared_fields(section)
    versioned = []
    for field in dataclasses.fields(section):
        key = keys[field.name]
        former = {version: values[key] for version, values in FORMER_DEFAULTS.items() if key in values}
        if key in added or former:
            default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
            versioned.append(_VersionedField(field.name, key, added.get(key, 1), default, former))
    return tuple(versioned)


def _list_sections(value: object, data: Any) -> Iterator[tuple[Section, Any]]:
    """Yield every section within a value, outer ones first, with its part of the value's JSON data (None without)."""
    if isinstance(value, Section):
        yield value, data
        for field in dataclasses.fields(value):  # type: ignore[arg-type]  # every section is a dataclass
            inner = getattr(value, field.name)
            if isinstance(inner, Section | Mapping | tuple) and inner:
                yield from _list_sections(inner, None if data is None else data.get(field.name))
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _list_sections(inner, None if data is None else data[key])
    elif isinstance(value, tuple) and isinstance(value[0], Section):
        for index, inner in enumerate(value):
            yield from _list_sections(inner, None if data is None else data[index])
