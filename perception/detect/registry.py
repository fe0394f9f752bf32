"""Detectors by kind of object.

To add a kind, write a function ``detect_...(view, hint)`` that returns a list of :class:`Detection`, in a module or
a folder of its own, and add a line to ``DETECTORS``.  A detector imports parts of
``perception.detect.shared`` but none of another kind: name its module in the import contract in ``pyproject.toml``.
``service.request.choices`` repeats the kinds that a request may name, because it does not load this package.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.stopping import Stopped, poll
from perception.detect.beam.detector import detect_beam
from perception.detect.door.detector import detect_door
from perception.detect.drill.detector import detect_drill
from perception.detect.hose.detector import detect_hose
from perception.detect.lever import detect_lever
from perception.detect.panel.detector import detect_panel
from perception.detect.shared.detection import Detection
from perception.detect.shared.faces import FacesInSight
from perception.detect.valve.detector import detect_valve
from perception.detect.valve.wheel import detect_wheels
from perception.detect.vehicle.opening import detect_opening
from perception.detect.vehicle.seat import detect_seat
from perception.errors import PerceptionError
from perception.view import View


@dataclass(frozen=True)
class Detector:
    """A detector and what it needs.

    Attributes:
        find: its function of view and hint, with ``needs_faces`` also of the view's flat faces.
        needs_faces: whether it looks at flat faces, which are found once for all detectors that do.
        is_offered: whether a request may name the kind; the others serve tasks.
    """

    find: Callable[..., list[Detection]]
    needs_faces: bool = False
    is_offered: bool = True


DETECTORS: Mapping[str, Detector] = {
    "valve": Detector(detect_valve),
    "door": Detector(detect_door),
    "drill": Detector(detect_drill),
    "beam": Detector(detect_beam),
    "hose": Detector(detect_hose),
    "lever": Detector(detect_lever, needs_faces=True),
    "panel": Detector(detect_panel, needs_faces=True),
    "seat": Detector(detect_seat),
    "opening": Detector(detect_opening),
    # Of the valves those that a plan can turn.
    "wheel": Detector(detect_wheels, is_offered=False),
}
KINDS = tuple(kind for kind, detector in DETECTORS.items() if detector.is_offered)


def detect(kind: str, view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Find objects of a kind, best first.

    Args:
        hint: (3,) a point near the object, as an operator would click it [m].

    Raises:
        PerceptionError: the kind is unknown.
    """
    return detect_kinds((kind,), view, hint)


def detect_kinds(
    kinds: Sequence[str],
    view: View,
    hint: Float[np.ndarray, "3"] | None = None,
    on_kind: Callable[[str], None] = lambda _: None,
) -> list[Detection]:
    """Find objects of several kinds, in the order of the kinds, best first within each.

    Args:
        on_kind: called with each kind before its search.

    Raises:
        PerceptionError: a kind is unknown.
    """
    return [hit for _, hits in detect_each(kinds, view, hint, on_kind) for hit in hits]


def detect_each(
    kinds: Sequence[str],
    view: View,
    hint: Float[np.ndarray, "3"] | None = None,
    on_kind: Callable[[str], None] = lambda _: None,
    on_failure: Callable[[str, Exception], None] | None = None,
) -> Iterator[tuple[str, list[Detection]]]:
    """Find objects as ``detect_kinds`` does, and yield each kind with its objects as soon as its search ends.

    Args:
        kinds, view, hint, on_kind: as there.
        on_failure: gets the kind and the error of a detector that fails; the search goes on with the other kinds.
            None: the error is raised.
    """
    for kind in kinds:
        if kind not in DETECTORS:
            raise PerceptionError(f"unknown kind '{kind}'; expected one of {', '.join(KINDS)}")
    faces: FacesInSight | None = None
    for kind in kinds:
        detector = DETECTORS[kind]
        on_kind(kind)
        poll()
        try:
            if detector.needs_faces:
                faces = faces or FacesInSight.of(view, hint)
                hits = detector.find(view, hint, faces)
            else:
                hits = detector.find(view, hint)
        except Stopped:
            raise
        except Exception as error:
            if on_failure is None:
                raise
            on_failure(kind, error)
            continue
        yield kind, sorted(hits, key=lambda hit: -hit.confidence)
