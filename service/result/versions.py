"""Results of earlier releases: their format, and the keys of ``result.json`` that later formats brought."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from service.request.formats import FORMAT

NAME = "scopt-result"
ADDED: dict[int, dict[str, Any]] = {
    2: {
        "not_planned": [],
        "releases": [],
        "continues": None,
        "phases[].status": None,
        "phases[].checks": None,
        "phases[].loads": [],
        "phases[].regions": [],
        "phases[].region_margin_m": None,
        "phases[].contacts[].friction": 0.6,
        "phases[].contacts[].force_cap_n": 5000.0,
        "phases[].contacts[].normal": None,
        "phases[].contacts[].tilt_rad": 0.0,
        "phases[].targets[].slide": None,
        "movables[].parent": None,
        "movables[].start": 0.0,
    },
    3: {
        "clearance_m": 0.0,
        "sway_m": 0.0,
        "sway_deg": 0.0,
        "jerk_scale": None,
        "pace": None,
        "approach": {},
        "start_rates": {},
        "end_rates": {},
        "padding": {},
        "tool_speed_m_s": None,
        "objects": [],
        "phases[].carriers": [],
        "request_format": None,
        "request_defaults": {},
    },
}
"""Keys that a reader needs, by the format that brought them, each with what a result means that has none.

``[]`` after a name means every entry of that list.
"""

ADDED_FILES: dict[int, tuple[str, ...]] = {3: ("manifest.json",)}
"""Files of a plan that later formats brought; a client that does not know one refuses all files of the plan."""


def list_unknown_files(known_format: int) -> frozenset[str]:
    """Return the files of a plan that a client does not know; 0 stands for the format of 0.3.0."""
    return frozenset(name for brought, names in ADDED_FILES.items() if brought > max(known_format, 2) for name in names)


def find_format(data: Mapping[str, Any]) -> int | None:
    """Return the number of a result's format; None for anything that this version does not read.

    0.3.0 wrote more than 0.2.0 under the same name.
    """
    if data.get("format") == f"{NAME}/1":
        return 2 if "pose_graph" in data else 1
    return FORMAT if data.get("format") == f"{NAME}/{FORMAT}" else None


def add_missing_keys(data: dict[str, Any]) -> None:
    """Give a result of an earlier format the keys of later ones."""
    version = find_format(data)
    for brought, keys in ADDED.items():
        if version is None or brought <= version:
            continue
        for path, value in keys.items():
            *above, key = path.split(".")
            for part in _list_parts(data, above):
                part.setdefault(key, value)


def _list_parts(data: object, path: list[str]) -> Iterator[dict[str, Any]]:
    """Yield the mappings at a path; what has another form is left to the reader."""
    if not isinstance(data, dict):
        return
    if not path:
        yield data
        return
    name, *rest = path
    entries = data.get(name.removesuffix("[]"))
    for entry in entries if isinstance(entries, list) else ():
        yield from _list_parts(entry, rest)
