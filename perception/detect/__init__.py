"""Objects a task needs, found in a scan with an honest confidence."""

from collections.abc import Callable, Iterator, Mapping, Sequence

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
from perception.detect.vehicle.opening import detect_opening
from perception.detect.vehicle.seat import detect_seat
from perception.errors import PerceptionError
from perception.view import View

Detector = Callable[[View, Float[np.ndarray, "3"] | None], list[Detection]]


_DETECTORS: Mapping[str, Detector] = {
    "valve": detect_valve,
    "door": detect_door,
    "drill": detect_drill,
    "beam": detect_beam,
    "hose": detect_hose,
    "lever": detect_lever,
    "panel": detect_panel,
    "seat": detect_seat,
    "opening": detect_opening,
}
KINDS = tuple(_DETECTORS)
_ON_FACES = {"lever": detect_lever, "panel": detect_panel}


def detect(kind: str, view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Objects of a kind, best first.

    Args:
        kind: one of :data:`KINDS`.
        view: the scan, made ready.
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
    """Objects of several kinds, in the order of the kinds, best first within each; what some share is made once.

    Args:
        kinds: of :data:`KINDS`.
        view: the scan, made ready.
        hint: (3,) a point near the object, as an operator would click it [m].
        on_kind: told each kind before it is looked for.

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
    """As ``detect_kinds``, each kind with its objects as soon as they are found.

    Args:
        kinds, view, hint, on_kind: as there.
        on_failure: gets the kind and the error of a detector that fails; the other kinds are looked for all the same.
            None: the error is raised.
    """
    for kind in kinds:
        if kind not in _DETECTORS:
            raise PerceptionError(f"unknown kind '{kind}'; one of {', '.join(KINDS)} is needed")
    seen: FacesInSight | None = None
    for kind in kinds:
        on_kind(kind)
        poll()
        try:
            if kind in _ON_FACES:
                seen = seen or FacesInSight.of(view, hint)
                hits = _ON_FACES[kind](view, hint, seen)
            else:
                hits = _DETECTORS[kind](view, hint)
        except Stopped:
            raise
        except Exception as error:
            if on_failure is None:
                raise
            on_failure(kind, error)
            continue
        yield kind, sorted(hits, key=lambda one: -one.confidence)
