"""Field types of a request: numbers, points, quaternions, names, and sections that refuse unknown keys."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sized
from dataclasses import fields
from functools import cache
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    JsonValue,
    ModelWrapValidatorHandler,
    StrictStr,
    model_validator,
)
from pydantic.dataclasses import rebuild_dataclass
from pydantic_core import ArgsKwargs, CoreSchema, PydanticCustomError, PydanticKnownError, core_schema

from service.errors import shown, would_do

QUATERNION_NORM_TOLERANCE = 1e-3  # allows for rounding to a few digits
QUATERNION_ROUNDING = 1e-15
WORKSPACE_M = 1000.0  # a coordinate beyond this is a unit mistake (millimetres)
LARGEST_M = 100.0  # a larger obstacle is in another unit
# Least and largest coefficient between hands and what they move: steel on steel to rubber.
HAND_FRICTION = (0.3, 0.6)
MAX_JOINTS = 1000
MAX_DEPTH = 30  # levels of plain data in a request
MAX_BITS = 1023  # size of an integer in plain data
MAP_M = 1e8  # map coordinates are offset from zero by thousands of kilometres

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


def _check_workspace(value: object) -> object:
    """Refuse a coordinate or length so large that its unit must be wrong."""
    if isinstance(value, int | float) and not isinstance(value, bool) and WORKSPACE_M < abs(value) < math.inf:
        raise PydanticCustomError(
            "unit",
            "{value} m is beyond {most} m; are these millimetres? Use {metres}.",
            {"value": f"{value:g}", "most": f"{WORKSPACE_M:g}", "metres": f"{value / 1000.0:g}"},
        )
    return value


_IN_METRES = BeforeValidator(_check_workspace)
Coordinate = Annotated[Number, Field(ge=-WORKSPACE_M, le=WORKSPACE_M), _IN_METRES]
Length = Annotated[Number, Field(gt=0.0, le=WORKSPACE_M), _IN_METRES]
Name = Annotated[StrictStr, Field(min_length=1, max_length=200)]
Point = tuple[Coordinate, Coordinate, Coordinate]
_MapCoordinate = Annotated[Number, Field(ge=-MAP_M, le=MAP_M)]
MapPoint = tuple[_MapCoordinate, _MapCoordinate, _MapCoordinate]
SECTION = ConfigDict(extra="forbid", frozen=True, defer_build=True)


def at_most(most: int) -> BeforeValidator:
    """Refuse a list or mapping of more than ``most`` entries before any entry is checked."""

    def check(value: object) -> object:
        if isinstance(value, Sized) and not isinstance(value, str) and len(value) > most:
            context = {"field_type": "Tuple", "max_length": most, "actual_length": len(value)}
            raise PydanticKnownError("too_long", context)
        return value

    return BeforeValidator(check)


def _normalize(quaternion: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    norm = math.hypot(*quaternion)
    if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
        w, x, y, z = quaternion
        unit = f"[{w / norm:.6g}, {x / norm:.6g}, {y / norm:.6g}, {z / norm:.6g}]" if norm > 1e-9 else "[1, 0, 0, 0]"
        raise PydanticCustomError(
            "quaternion",
            "a quaternion (w, x, y, z) needs length 1, not {norm}; expected {unit}",
            {"norm": f"{norm:.6g}", "unit": unit},
        )
    if abs(norm - 1.0) <= QUATERNION_ROUNDING:  # once more would change the last digit, and the request's hash
        return quaternion
    w, x, y, z = (component / norm for component in quaternion)
    return (w, x, y, z)


def _check_metres(sizes: float | tuple[float, ...]) -> float | tuple[float, ...]:
    """Refuse a size so large that its unit must be wrong."""
    for size in (sizes,) if isinstance(sizes, float) else sizes:
        if size > LARGEST_M:
            raise PydanticCustomError(
                "unit",
                "{size} m is larger than {most} m; are these millimetres? Use {metres}.",
                {"size": f"{size:g}", "most": f"{LARGEST_M:g}", "metres": f"{size / 1000.0:g}"},
            )
    return sizes


def _check_floor(value: object) -> object:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(value, bool) or (is_number and abs(value) <= WORKSPACE_M):  # type: ignore[arg-type]
        return value
    raise PydanticCustomError("floor", "expected true, false or a height in metres")


def _check_message(value: object) -> object:
    if value == "all" or (isinstance(value, int) and not isinstance(value, bool) and abs(value) < 10**9):
        return value
    raise PydanticCustomError("message", "expected a whole number or 'all'")


def _check_printable(name: str) -> str:
    if not name.isprintable():
        raise PydanticCustomError("name", "a name has no control characters")
    return name


def _check_plain_data(data: dict[str, Any]) -> dict[str, Any]:
    """Refuse plain data with numbers that JSON cannot represent, or with too many levels."""
    level: list[tuple[str, object]] = [("", data)]
    for _ in range(MAX_DEPTH):
        deeper: list[tuple[str, object]] = []
        for path, value in level:
            if isinstance(value, Mapping):
                deeper += [(f"{path}.{key}" if path else str(key), entry) for key, entry in value.items()]
            elif isinstance(value, list | tuple):
                deeper += [(f"{path}[{k}]", entry) for k, entry in enumerate(value)]
            elif _is_beyond_json(value):
                raise PydanticCustomError(
                    "plain_data",
                    "a finite number is needed at {path}, got {value}",
                    {"path": shown(path).strip("'\""), "value": shown(value)},
                )
        if not deeper:
            return data
        level = deeper
    raise PydanticCustomError("plain_data", "nested deeper than {depth} levels", {"depth": MAX_DEPTH})


def _is_beyond_json(value: object) -> bool:
    """Return whether a number is infinite, NaN, or an integer beyond doubles."""
    if isinstance(value, float):
        return not math.isfinite(value)
    return isinstance(value, int) and value.bit_length() > MAX_BITS


_Size = Annotated[Number, Field(gt=0.0)]
Size = Annotated[_Size, AfterValidator(_check_metres)]
Sizes = Annotated[tuple[_Size, _Size, _Size], AfterValidator(_check_metres)]
PlainData = Annotated[dict[str, JsonValue], AfterValidator(_check_plain_data)]
Joints = Annotated[dict[Name, Number], at_most(MAX_JOINTS)]
Quaternion = Annotated[tuple[Number, Number, Number, Number], AfterValidator(_normalize)]
Floor = Annotated[bool | float, BeforeValidator(_check_floor)]
Message = Annotated[int | Literal["all"], BeforeValidator(_check_message)]
Label = Annotated[Name, AfterValidator(_check_printable)]
FilePath = Annotated[StrictStr, Field(min_length=1, max_length=4096), AfterValidator(_check_printable)]


class Section:
    """Section of a request; refuses unknown keys."""

    @model_validator(mode="wrap")
    @classmethod
    def _check_keys(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        if isinstance(data, dict):
            known = _keys_of(cls)  # type: ignore[arg-type]  # a class can be hashed
            for key in data:
                if key not in known:
                    raise PydanticCustomError(
                        "unknown_key",
                        "unknown key {key}; expected {known}",
                        {"key": shown(key), "known": would_do(key, known)},
                    )
        section = handler(data)
        if isinstance(data, dict):
            given = frozenset(data)
        elif isinstance(data, ArgsKwargs):
            positional = _keys_of(cls)[: len(data.args)]  # type: ignore[arg-type]
            given = frozenset((*positional, *(data.kwargs or ())))
        else:  # a section that was checked before
            return section
        section.__dict__["_given"] = given  # no field: neither data nor hash have it
        return section

    def is_given(self, name: str) -> bool:
        """Return whether a field was given; false where it was left to its default."""
        return name in self.__dict__["_given"]


class _Later:
    """Mark of a section with a validator of its own, which is built with the first request that has the section."""

    def __get_pydantic_core_schema__(self, section: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            lambda value: section.__pydantic_validator__.validate_python(value),
            metadata={"section": section},
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda value, info: section.__pydantic_serializer__.to_python(value, mode=info.mode), info_arg=True
            ),
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        section = schema["metadata"]["section"]
        rebuild_dataclass(section)
        return handler(section.__pydantic_core_schema__)


LATER = _Later()


@cache
def _keys_of(section: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(section) if field.name != "folder")


def find_repeated(names: Iterable[str]) -> list[str]:
    """Return the names that occur more than once, sorted."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


def require_exactly_one(section: object, names: tuple[str, ...]) -> None:
    present = [name for name in names if getattr(section, name)]
    if len(present) != 1:
        raise PydanticCustomError(
            "exactly_one",
            "exactly one of {names} is needed, {given}",
            {"names": ", ".join(names), "given": f"not {' and '.join(present)}" if present else "none is given"},
        )
