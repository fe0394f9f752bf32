"""Detectors by kind of object.

To add a kind, write a function ``detect_...(view, hint)`` that returns a list of :class:`Detection`, in a module or
a folder of its own, and add a line to ``SHIPPED``.  A detector may import ``perception.detect.shared`` but no module
of another kind: add its module to the import contract in ``pyproject.toml``.  Another package adds a kind by an entry
point of the group ``scopt_detectors``: ``KIND = module:DETECTOR``, with an offered ``Detector``.
``service.request.choices`` repeats the kinds that a request may name, because it must not import this package.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module

import numpy as np
from jaxtyping import Float

from costs.entry_points import load_entry_points
from costs.stopping import Stopped, poll
from perception.detect.engine.click import fit_at
from perception.detect.engine.kinds import CLICKED
from perception.detect.engine.surroundings import Surroundings
from perception.detect.engine.verdict import rate, rate_fit
from perception.detect.shared.detection import CONFIDENT, Detection
from perception.detect.shared.detector import Detector
from perception.detect.shared.faces import FacesInSight
from perception.detect.shared.overlap import offer_alternatives, settle_overlaps
from perception.errors import PerceptionError
from perception.sightlines import SightIndex, sight_index
from perception.view import View, widen

ENTRY_POINTS = "scopt_detectors"
_MOSTLY = 0.5
_MOST_AT_CLICK = 4
_SEARCHED = frozenset({"drill"})  # kinds whose detectors make the same fits
_ALSO = {"valve": ("wheel",)}  # detectors that find part of a kind about a click within a second


def _find_by(place: str, *seen: object, **options: object) -> list[Detection]:
    """Find objects by a detector ``MODULE:FUNCTION``, which is imported when it is needed."""
    module, name = place.split(":")
    hits: list[Detection] = getattr(import_module(f"perception.detect.{module}"), name)(*seen, **options)
    return hits


_FIND_DOOR = partial(_find_by, "door.detector:detect_door")

SHIPPED: Mapping[str, Detector] = {
    "valve": Detector(partial(_find_by, "valve.detector:detect_valve"), needs_index=True),
    "door": Detector(_FIND_DOOR),
    "drill": Detector(partial(_find_by, "drill.detector:detect_drill"), needs_index=True),
    "beam": Detector(partial(_find_by, "beam.detector:detect_beam"), needs_index=True),
    "hose": Detector(partial(_find_by, "hose.detector:detect_hose"), needs_index=True),
    "lever": Detector(partial(_find_by, "lever:detect_lever"), needs_faces=True),
    "panel": Detector(partial(_find_by, "panel.detector:detect_panel"), needs_faces=True),
    "seat": Detector(partial(_find_by, "vehicle.seat:detect_seat")),
    "opening": Detector(partial(_find_by, "vehicle.opening:detect_opening")),
    # Doors whose hinges are on a side that a person states.
    "door_left": Detector(partial(_FIND_DOOR, hinge_on="left"), offered_as="door"),
    "door_right": Detector(partial(_FIND_DOOR, hinge_on="right"), offered_as="door"),
    # Valves that a plan can turn: wheels and levers; wheels alone.
    "turnable": Detector(partial(_find_by, "valve.detector:detect_turnable"), offered_as="valve"),
    "wheel": Detector(partial(_find_by, "valve.wheel:detect_wheels"), offered_as="valve"),
}
DETECTORS: Mapping[str, Detector] = {
    **SHIPPED,
    **dict(load_entry_points(ENTRY_POINTS, Detector, SHIPPED, PerceptionError)),
}
KINDS = tuple(kind for kind, detector in DETECTORS.items() if detector.offered_as is None)


def find_offered(kind: str) -> str:
    """Return the kind that a request names to find what a task looks for as ``kind``.

    Raises:
        PerceptionError: the kind is unknown.
    """
    if kind not in DETECTORS:
        raise PerceptionError(f"unknown kind '{kind}'; expected one of {', '.join(KINDS)}")
    return DETECTORS[kind].offered_as or kind


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
    return settle_overlaps([hit for _, hits in detect_each(kinds, view, hint, on_kind) for hit in hits])


def detect_each(
    kinds: Sequence[str],
    view: View,
    hint: Float[np.ndarray, "3"] | None = None,
    on_kind: Callable[[str], None] = lambda _: None,
    on_failure: Callable[[str, Exception], None] | None = None,
) -> Iterator[tuple[str, list[Detection]]]:
    """Find objects as ``detect_kinds`` does, and yield each kind with its objects as soon as its search ends.

    The same region is searched whatever the crop (``perception.view.widen``), and nothing depends on the view's seed:
    the crop only decides which hits are reported.

    Args:
        kinds, view, hint, on_kind: see ``detect_kinds``.
        on_failure: called with the kind and the error of a failed detector; the search continues with the next kind.
            None: the error is raised.
    """
    for kind in kinds:
        if kind not in DETECTORS:
            raise PerceptionError(f"unknown kind '{kind}'; expected one of {', '.join(KINDS)}")
    faces: FacesInSight | None = None
    wide: View | None = None
    index: SightIndex | None = None
    for kind in kinds:
        detector = DETECTORS[kind]
        on_kind(kind)
        poll()
        try:
            wide = wide or widen(view)
            index = index or sight_index(wide.cloud)
            if detector.needs_faces:
                faces = faces or FacesInSight.of(wide, hint, index)
                hits = detector.find(wide, hint, faces)
            elif detector.needs_index:
                hits = detector.find(wide, hint, index)
            else:
                hits = detector.find(wide, hint)
        except Stopped:
            raise
        except Exception as error:
            if on_failure is None:
                raise
            on_failure(kind, error)
            continue
        hits = [rate(hit, index) for hit in hits]
        hits = sorted(settle_overlaps(hits), key=lambda hit: -hit.confidence)
        yield kind, [hit for hit in hits if _is_in_reach(hit, view)]


def detect_at(
    kinds: Sequence[str],
    view: View,
    click: Float[np.ndarray, "3"],
    on_kind: Callable[[str], None] = lambda _: None,
    on_failure: Callable[[str, Exception], None] | None = None,
) -> Iterator[tuple[str, list[Detection]]]:
    """Fit objects where a person clicked, and yield each kind with its best few fits, sure or not.

    Kinds that the engine has no fit for are found by their detectors near the click; so is a single kind of which no
    fit is confident.

    Args:
        kinds, view, on_kind, on_failure: see ``detect_each``.
        click: (3,) a point on the object or within about 10 cm of it [m].
    """
    around: Surroundings | None = None
    index: SightIndex | None = None
    for kind in kinds:
        fits: list[Detection] = []
        others: list[Detection] = []
        if kind in CLICKED and len(view.near.points):
            on_kind(kind)
            index = index or sight_index(view.cloud)
            around = around or Surroundings.of(view.near.points, np.median(view.near.starts, axis=0), click)
            for name, template in CLICKED[kind].items():
                fits += [rate_fit(name, fit) for fit in fit_at(template, around, index)]
            for other in _ALSO.get(kind, ()):
                for _, more in detect_each((other,), view, click, on_failure=on_failure):
                    others += more
        is_sure = any(hit.confidence >= CONFIDENT for hit in (*fits, *others))
        if kind not in CLICKED or (len(kinds) == 1 and not is_sure and kind not in _SEARCHED):
            for _, more in detect_each((kind,), view, click, on_kind, on_failure):
                others += more
        yield kind, offer_alternatives(fits, others)[:_MOST_AT_CLICK]


def _is_in_reach(hit: Detection, view: View) -> bool:
    """Return whether a hit's origin or most of its points lie in the view's reach."""
    is_near = view.reach.contains(np.concatenate([hit.pose_world_object[None, :3, 3], hit.points]))
    return bool(is_near[0] or (len(is_near) > 1 and is_near[1:].mean() > _MOSTLY))
