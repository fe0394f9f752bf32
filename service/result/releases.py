"""Objects that a plan lets go: nothing that is held may fall because an operator overlooked it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def list_releases(result: Mapping[str, Any]) -> dict[str, str]:
    """Return the first phase in which no hand holds an object any more, by object.

    Args:
        result: a parsed ``result.json``; one without phases lets nothing go.
    """
    released: dict[str, str] = {}
    held: set[str] = set()
    for phase in result.get("phases") or ():
        holding = {str(carrier["object"]) for carrier in phase.get("carriers") or () if carrier["link"] is not None}
        for name in sorted(held - holding):
            released.setdefault(name, str(phase["name"]))
        held = holding
    return released


def list_held(result: Mapping[str, Any]) -> list[str]:
    """Return the objects that hands hold when a plan begins, from its parsed ``result.json``."""
    first: Mapping[str, Any] = next(iter(result.get("phases") or ()), {})
    return [str(carrier["object"]) for carrier in first.get("carriers") or () if carrier["link"] is not None]


def describe_releases(released: Mapping[str, str]) -> str:
    """Return what a plan lets go, as a phrase."""
    return " and ".join(f"'{name}' in phase '{phase}'" for name, phase in released.items())
