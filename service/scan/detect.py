"""``scopt detect``: objects of a kind in cloud files, best first, within a time limit."""

from __future__ import annotations

import logging
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from costs.progress import tells_progress
from costs.stopping import Stopped, poll, stops_when
from perception import (
    Detection,
    PerceptionError,
    View,
    detect_at,
    detect_each,
    find_matches,
    make_view,
    settle_overlaps,
)
from perception.solids.match import KnownMesh, locate
from service.errors import RequestError, ServiceError, would_do
from service.request.choices import EVERY_KIND, GIVEN, KINDS
from service.scan.cloud import CloudInput, OnStep, count_points, read_input
from service.scan.json_data import to_json_data
from service.scan.known_meshes import MeshInput, encode_residuals, load_known_meshes

_LOG = logging.getLogger(__name__)

FORMAT = "scopt-detections/1"
_NEAR_HINT_M = 0.5
_SHOWN_KINDS = 12
_REPORTED = 0.05
_EVERY = 5


class TimeOver(Exception):  # noqa: N818 - how a command ends early, not an error
    """Raised by ``limit_time`` when the time limit is reached and its body has stopped."""


class OutOfTimeError(ServiceError):
    """The time limit of a command was reached before its first result."""


@contextmanager
def limit_time(seconds: float | None) -> Iterator[None]:
    """Stop the body at its first poll after the time limit; None for no limit.

    Raises:
        TimeOver: the time limit was reached.
        Stopped: an outer ``stops_when`` requested a stop too.
    """
    if seconds is None:
        yield
        return
    end = time.monotonic() + seconds
    try:
        with stops_when(lambda: time.monotonic() >= end):
            yield
    except Stopped:
        poll()
        raise TimeOver from None


def detect_file(
    clouds: CloudInput,
    kind: str,
    hint: tuple[float, float, float] | None,
    on_step: OnStep,
    time_limit_s: float | None = None,
    objects: Sequence[MeshInput] = (),
) -> dict[str, Any]:
    """Find objects in cloud files; return hits and statistics, JSON-ready.

    Args:
        kind: one of ``perception.KINDS``, ``all``, or ``object`` for those in ``objects``.
        hint: a point near the object, as an operator would click it [m].
        on_step: called with the name of each step before it begins.
        time_limit_s: limit for all together; hits until then are returned, and kinds not searched are listed.
        objects: objects given by a mesh or by parameters; the kind of a hit is the object's name.

    Raises:
        RequestError: a file, name or value cannot be used.
        OutOfTimeError: the time limit was reached before the search for the first kind began.
    """
    started = time.perf_counter()
    if (kind == GIVEN) != bool(objects):
        raise RequestError(f"KIND: '{GIVEN}' and --object need each other; got '{kind}' and {len(objects)} objects")
    known = load_known_meshes(objects, KINDS, "--object")
    kinds = tuple(item.name for item in known) if objects else check_kinds((kind,), "KIND")
    check_hint(hint)
    search = None
    try:
        with limit_time(time_limit_s):
            read = read_input(clouds, on_step)
            on_step("clean")
            with tells_progress(on_step):
                view = make_view(
                    read.cloud, reach=clouds.reach, robot_hulls=read.hulls, soles=read.soles, seed=clouds.seed
                )
            search = Search()
            if known:
                search_given(known, view, hint, on_step, search)
            else:
                search_objects(kinds, view, hint, on_step, search)
    except PerceptionError as error:
        raise RequestError(f"{clouds.files_text}: {error}") from None
    except TimeOver:
        if search is None:
            raise OutOfTimeError(
                f"--time-limit: {time_limit_s:g} s were over before anything could be looked for; expected more"
            ) from None
    hits = sorted(settle_overlaps(search.hits), key=lambda hit: -hit.confidence)
    notes = [note for item in known for note in item.solid.notes]
    return {
        "format": FORMAT,
        "kind": kind,
        "searched": list(search.kinds),
        "unfinished": search.unfinished(kinds),
        "hits": [encode_hit(hit) for hit in hits],
        "figures": {**count_points(read, view), "time_s": round(time.perf_counter() - started, 3)},
        "notes": [*view.notes, *notes, *hint_notes(view, hint), *search.notes],
    }


@dataclass(frozen=True)
class Search:
    """Hits of a search so far.

    Attributes:
        hits: hits of all kinds.
        kinds: the kinds whose search is complete.
        failed: the error of each failed detector, by kind.
    """

    hits: list[Detection] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)

    def unfinished(self, requested: Sequence[str]) -> list[str]:
        """Return the requested kinds whose search did not finish in time."""
        return [kind for kind in requested if kind not in self.kinds and kind not in self.failed]

    @property
    def notes(self) -> list[str]:
        """One sentence per failed detector."""
        return [f"the detector of {kind} failed, please report it: {why}" for kind, why in self.failed.items()]

    def fail(self, kind: str, error: Exception) -> None:
        """Record and log that a detector failed."""
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
    """Add each kind and its hits, best first, to ``search``; a failed detector does not stop the others.

    With a hint, the best few fits of each kind there are added, sure or not, each with what speaks against it.
    """
    place = None if hint is None else np.array(hint)

    def announce(kind: str) -> None:
        on_step(f"look for {kind}")

    found = (
        detect_each(kinds, view, on_kind=announce, on_failure=search.fail)
        if place is None
        else detect_at(kinds, view, place, on_kind=announce, on_failure=search.fail)
    )
    for kind, hits in found:
        search.hits.extend(hits)
        search.kinds.append(kind)


def search_given(
    known: Sequence[KnownMesh],
    view: View,
    hint: tuple[float, float, float] | None,
    on_step: OnStep,
    search: Search,
) -> None:
    """Add the places of each given object, best first, to ``search``; ``near`` of an object goes before the hint."""
    place = None if hint is None else np.array(hint)
    for item in known:
        on_step(f"look for {item.name}")
        poll()
        if item.pose_world_mesh is not None:
            matches = [locate(item, view)]
        else:
            matches = find_matches(item.solid, view, place if item.hint is None else item.hint)
        for match in matches:
            if match.confidence >= _REPORTED:
                points = view.obstacles[match.explains(view.obstacles)]
                residuals = encode_residuals(match)
                search.hits.append(
                    Detection(item.name, match.pose_world_mesh, {}, match.confidence, residuals, points[::_EVERY])
                )
        search.kinds.append(item.name)


def check_kinds(kinds: Sequence[str], option: str) -> tuple[str, ...]:
    """Return the kinds, each once, with ``all`` replaced by every kind.

    Raises:
        RequestError: a kind is unknown.
    """
    known = (*KINDS, EVERY_KIND)
    for kind in kinds:
        if kind not in known:
            raise RequestError(f"{option}: unknown kind '{kind}'; expected {would_do(kind, known, _SHOWN_KINDS)}")
    return KINDS if EVERY_KIND in kinds else tuple(dict.fromkeys(kinds))


def check_hint(hint: tuple[float, float, float] | None) -> None:
    """Refuse a hint that is not finite (RequestError)."""
    if hint is not None and not np.isfinite(hint).all():
        text = " ".join(f"{value:g}" for value in hint)
        raise RequestError(f"--hint: {text} is no place; expected three finite numbers X Y Z")


def hint_notes(view: View, hint: tuple[float, float, float] | None) -> tuple[str, ...]:
    """Return a note if no point is near the hint."""
    if hint is None or not len(view.near.points):
        return ()
    nearest = float(np.linalg.norm(view.near.points - np.array(hint), axis=1).min())
    if nearest <= _NEAR_HINT_M:
        return ()
    where = ", ".join(f"{value:g}" for value in hint)
    return (
        f"no points within {_NEAR_HINT_M:g} m of the hint ({where}); the nearest in reach lies {nearest:.1f} m away",
    )


def encode_hit(hit: Detection) -> dict[str, Any]:
    """Return a detection as JSON data; lengths in metres, angles in radians, confidence from 0 to 1."""
    return {
        "kind": hit.kind,
        "confidence": round(float(hit.confidence), 4),
        "pose_world_object": to_json_data(np.asarray(hit.pose_world_object, dtype=float)),
        "sizes": to_json_data(dict(hit.sizes)),
        "residuals": to_json_data(dict(hit.residuals)),
        "doubts": list(hit.doubts),
    }
