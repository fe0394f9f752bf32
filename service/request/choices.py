"""Setting values shared by a request's scene and ``scopt scene``."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Literal

Method = Literal["planes", "coacd"]
"""Method of making pieces: slabs and hulls, or cells split by CoACD (docs/piece-methods.md)."""

Unknown = Literal["free", "occupied"]
"""Treatment of space that no ray has seen."""

SensorModel = Literal["auto", "spinning", "depth", "tof", "solid", "survey"]
"""Kind of sensor: ``auto``, or a name of ``perception.noise.MODELS``."""

KINDS = (
    *("valve", "door", "drill", "beam", "hose", "lever", "panel", "seat", "opening"),
    *sorted(entry.name for entry in entry_points(group="scopt_detectors")),
)
"""Kinds of detectable objects, equal to ``perception.KINDS`` but without importing perception."""

EVERY_KIND = "all"
"""Kind that requests all kinds."""

GIVEN = "object"
"""Kind of objects that a user gives as a mesh or by parameters."""
