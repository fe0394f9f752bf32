"""Templates of each kind: of a detector's hit, and those that are fitted about a click."""

from __future__ import annotations

from collections.abc import Mapping

from perception.detect.engine.template import Template
from perception.detect.engine.templates.beam import BEAM
from perception.detect.engine.templates.drill import DRILL
from perception.detect.engine.templates.hose import HOSE
from perception.detect.engine.templates.lever import LEVER
from perception.detect.engine.templates.lever_on_pipe import LEVER_ON_PIPE
from perception.detect.engine.templates.lever_valve import LEVER_VALVE
from perception.detect.engine.templates.slabs import DOOR, OPENING, PANEL, SEAT
from perception.detect.engine.templates.wheel import WHEEL
from perception.detect.shared.detection import Detection

_TEMPLATES = {
    "beam": BEAM,
    "door": DOOR,
    "drill": DRILL,
    "hose": HOSE,
    "lever": LEVER,
    "opening": OPENING,
    "panel": PANEL,
    "seat": SEAT,
    "lever valve": LEVER_VALVE,
    "wheel": WHEEL,
}
KINDS = frozenset(template.kind for template in _TEMPLATES.values())
"""Kinds with a template."""
CLICKED: Mapping[str, Mapping[str, Template]] = {
    "drill": {"drill": DRILL},
    "lever": {"lever at a click": LEVER},
    "valve": {"lever valve at a click": LEVER_ON_PIPE},
}
"""Templates that are fitted about a click, by kind and by the name of their row of weights."""


def name_of(hit: Detection) -> str:
    """Return the name of a hit's template: its kind, or which kind of valve it is."""
    if hit.kind != "valve":
        return hit.kind
    return "lever valve" if "lever_length" in hit.sizes else "wheel"


def template_of(hit: Detection) -> Template:
    """Return a hit's template."""
    return _TEMPLATES[name_of(hit)]
