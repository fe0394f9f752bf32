"""``scopt detect``: objects of a kind in cloud files, best first."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from perception import KINDS, Detection, PerceptionError, View, detect_kinds, make_view
from service.cloud_asked import CloudAsked, OnStep, read_asked, view_figures
from service.errors import RequestError, would_do
from service.result_json import plain

FORMAT = "scopt-detections/1"
EVERY_KIND = "all"
_NEAR_HINT_M = 0.5


def detect_file(
    asked: CloudAsked, kind: str, hint: tuple[float, float, float] | None, on_step: OnStep
) -> dict[str, Any]:
    """Hits of a kind and figures, JSON-ready.

    Args:
        asked: the clouds.
        kind: one of ``perception.KINDS``.
        hint: a point near the object, as an operator would click it [m].
        on_step: told the name of each step before it begins.

    Raises:
        RequestError: one line for a file, name or value that cannot be used.
    """
    started = time.perf_counter()
    (kind,) = checked_kinds((kind,), "KIND")
    check_hint(hint)
    read = read_asked(asked, on_step)
    try:
        on_step("clean")
        view = make_view(read.cloud, reach=asked.reach, robot_hulls=read.hulls, soles=read.soles, seed=asked.seed)
    except PerceptionError as error:
        raise RequestError(f"{asked.named}: {error}") from None
    hits = found(view, (kind,), hint, on_step)
    return {
        "format": FORMAT,
        "kind": kind,
        "hits": [hit_json(hit) for hit in hits],
        "figures": {**view_figures(read, view), "time_s": round(time.perf_counter() - started, 3)},
        "notes": [*view.notes, *hint_notes(view, hint)],
    }


def checked_kinds(kinds: Sequence[str], option: str) -> tuple[str, ...]:
    """The kinds, ``all`` spelled out, each once.

    Raises:
        RequestError: a kind is unknown.
    """
    known = (*KINDS, EVERY_KIND) if option != "KIND" else KINDS
    for kind in kinds:
        if kind not in known:
            raise RequestError(f"{option}: unknown kind '{kind}'; {would_do(kind, known)} would do")
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


def found(
    view: View, kinds: Sequence[str], hint: tuple[float, float, float] | None, on_step: OnStep
) -> list[Detection]:
    """Hits of all kinds, best first within each."""
    place = None if hint is None else np.array(hint)
    return detect_kinds(kinds, view, place, on_kind=lambda kind: on_step(f"look for {kind}"))


def hit_json(hit: Detection) -> dict[str, Any]:
    """A detection; lengths in metres, angles in radians, confidence from 0 to 1."""
    return {
        "kind": hit.kind,
        "confidence": round(float(hit.confidence), 4),
        "pose_world_object": plain(np.asarray(hit.pose_world_object, dtype=float)),
        "sizes": plain(dict(hit.sizes)),
        "residuals": plain(dict(hit.residuals)),
    }
