"""Choices that a request's scene and ``scopt scene`` share."""

from __future__ import annotations

from typing import Literal

Method = Literal["planes", "coacd"]
"""How pieces are made: slabs and hulls, or cells split by CoACD (docs/piece-methods.md)."""

Unknown = Literal["free", "occupied"]
"""How space that no ray has seen is treated."""

KINDS = ("valve", "door", "drill", "beam", "hose", "lever", "panel", "seat", "opening")
"""Kinds of detectable objects: ``perception.KINDS`` without its libraries."""

EVERY_KIND = "all"
"""Name for all kinds."""
