"""How a scan becomes a world: the choices that a request's scene and ``scopt scene`` offer alike."""

from __future__ import annotations

from typing import Literal

Method = Literal["planes", "coacd"]
"""How pieces are made: slabs and hulls, or cells split by CoACD (docs/piece-methods.md)."""

Unknown = Literal["free", "occupied"]
"""What space is taken for that no ray has seen."""

KINDS = ("valve", "door", "drill", "beam", "hose", "lever", "panel", "seat", "opening")
"""Objects that can be looked for, as ``perception.KINDS``, told without its libraries."""

EVERY_KIND = "all"
"""All of them."""
