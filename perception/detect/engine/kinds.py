"""The template of each hit: by its kind, and for valves by whether it is a wheel or a lever."""

from __future__ import annotations

from perception.detect.engine.template import Template
from perception.detect.engine.templates.beam import BEAM
from perception.detect.engine.templates.drill import DRILL
from perception.detect.engine.templates.hose import HOSE
from perception.detect.engine.templates.lever import LEVER
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


def name_of(hit: Detection) -> str:
    """Return the name of a hit's template: its kind, or which kind of valve it is."""
    if hit.kind != "valve":
        return hit.kind
    return "lever valve" if "lever_length" in hit.sizes else "wheel"


def template_of(hit: Detection) -> Template:
    """Return a hit's template."""
    return _TEMPLATES[name_of(hit)]
