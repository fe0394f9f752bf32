"""``scopt detect``: objects of a kind in cloud files, best first."""

from __future__ import annotations

import logging
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from perception import Detection, PerceptionError, View, detect_each, make_view
from service.errors import RequestError, would_do
from service.json_data import plain
from service.request.choices import EVERY_KIND, KINDS
from service.scan.cloud import CloudInput, OnStep, read_input, view_figures
from service.scan.time_limit import OutOfTimeError, TimeOver, limit_time

_LOG = logging.getLogger(__name__)

FORMAT = "scopt-detections/1"
_NEAR_HINT_M = 0.5
_SHOWN_KINDS = 12


def detect_file(
    asked: CloudInput,
    kind: str,
    hint: tuple[float, float, float] | None,
    on_step: OnStep,
    time_limit_s: float | None = None,
) -> dict[str, Any]:
    """Hits and figures, JSON-ready.

    Args:
        asked: the clouds.
        kind: one of ``perception.KINDS``, or ``all``.
        hint: a point near the object, as an operator would click it [m].
        on_step: told the name of each step before it begins.
        time_limit_s: of all together; what was found until then is given, and what was not looked for is named.

    Raises:
        RequestError: one line for a file, name or value that cannot be used.
        OutOfTimeError: the time was over before the first kind was looked for.
    """
    started = time.perf_counter()
    kinds = check_kinds((kind,), "KIND")
    check_hint(hint)
    looked = None
    try:
        with limit_time(time_limit_s):
            read = read_input(asked, on_step)
            on_step("clean")
            view = make_view(read.cloud, reach=asked.reach, robot_hulls=read.hulls, soles=read.soles, seed=asked.seed)
            looked = Search()
            search_objects(kinds, view, hint, on_step, looked)
    except PerceptionError as error:
        raise RequestError(f"{asked.named}: {error}") from None
    except TimeOver:
        if looked is None:
            raise OutOfTimeError(
                f"--time-limit: {time_limit_s:g} s were over before anything could be looked for; more would do"
            ) from None
    hits = sorted(looked.hits, key=lambda hit: -hit.confidence)
    return {
        "format": FORMAT,
        "kind": kind,
        "searched": list(looked.kinds),
        "unfinished": looked.unfinished(kinds),
        "hits": [hit_json(hit) for hit in hits],
        "figures": {**view_figures(read, view), "time_s": round(time.perf_counter() - started, 3)},
        "notes": [*view.notes, *hint_notes(view, hint), *looked.notes],
    }


@dataclass(frozen=True)
class Search:
    """What was found so far.

    Attributes:
        hits: of all kinds.
        kinds: those that were looked for to the end.
        failed: by kind, what went wrong where a detector failed.
    """

    hits: list[Detection] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)

    def unfinished(self, asked: Sequence[str]) -> list[str]:
        """The kinds that there was no time for."""
        return [kind for kind in asked if kind not in self.kinds and kind not in self.failed]

    @property
    def notes(self) -> list[str]:
        """A sentence for each detector that failed."""
        return [f"the detector of {kind} failed, please report it: {why}" for kind, why in self.failed.items()]

    def fail(self, kind: str, error: Exception) -> None:
        """Note and log that a detector failed."""
        frames = traceback.extract_tb(error.__traceback__)
        place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
        self.failed[kind] = " ".join(f"{type(error).__name__}: {error}{place}".split())
        _LOG.error("the detector of %s failed: %s", kind, self.failed[kind])
        _LOG.debug("the detector of %s failed", kind, exc_info=error)


def search_objects(
    kinds: Sequence[str],
    view: View,
    hint: tuple[float, float, float] | None,
    on_step: OnStep,
    search: Search,
) -> None:
    """Add the hits of each kind, best first within it, and the kind itself to the search; a detector may fail alone."""
    place = None if hint is None else np.array(hint)

    def tell(kind: str) -> None:
        on_step(f"look for {kind}")

    for kind, hits in detect_each(kinds, view, place, on_kind=tell, on_failure=search.fail):
        search.hits.extend(hits)
        search.kinds.append(kind)


def check_kinds(kinds: Sequence[str], option: str) -> tuple[str, ...]:
    """The kinds, ``all`` spelled out, each once.

    Raises:
        RequestError: a kind is unknown.
    """
    known = (*KINDS, EVERY_KIND)
    for kind in kinds:
        if kind not in known:
            raise RequestError(f"{option}: unknown kind '{kind}'; {would_do(kind, known, _SHOWN_KINDS)} would do")
    return KINDS if EVERY_KIND in kinds else tuple(dict.fromkeys(kinds))


def check_hint(hint: tuple[float, float, float] | None) -> None:
    """
    Raises:
        RequestError: the hint is no place.
    """
    if hint is not None and not np.isfinite(hint).all():
        given = " ".join(f"{value:g}" for value in hint)
        raise RequestError(f"--hint: {given} is no place; three finite numbers X Y Z would do")


def hint_notes(view: View, hint: tuple[float, float, float] | None) -> tuple[str, ...]:
    """What to tell about a hint near which nothing was seen."""
    if hint is None or not len(view.near.points):
        return ()
    nearest = float(np.linalg.norm(view.near.points - np.array(hint), axis=1).min())
    if nearest <= _NEAR_HINT_M:
        return ()
    where = ", ".join(f"{value:g}" for value in hint)
    return (
        f"no points within {_NEAR_HINT_M:g} m of the hint ({where}); the nearest in reach lies {nearest:.1f} m away",
    )


def hit_json(hit: Detection) -> dict[str, Any]:
    """A detection; lengths in metres, angles in radians, confidence from 0 to 1."""
    return {
        "kind": hit.kind,
        "confidence": round(float(hit.confidence), 4),
        "pose_world_object": plain(np.asarray(hit.pose_world_object, dtype=float)),
        "sizes": plain(dict(hit.sizes)),
        "residuals": plain(dict(hit.residuals)),
    }
