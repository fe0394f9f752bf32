"""``scopt detect``: objects of a kind in cloud files, best first."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from perception import KINDS, Detection, PerceptionError, View, detect_kinds, make_view
from service.cloud_asked import CloudAsked, OnStep, read_asked
from service.errors import RequestError, would_do
from service.result_json import plain

FORMAT = "scopt-detections/1"
EVERY_KIND = "all"


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
    read = read_asked(asked, on_step)
    try:
        on_step("clean")
        view = make_view(read.cloud, reach=asked.reach, robot_hulls=read.hulls, soles=read.soles, seed=asked.seed)
    except PerceptionError as error:
        raise RequestError(str(error)) from None
    hits = found(view, (kind,), hint, on_step)
    return {
        "format": FORMAT,
        "kind": kind,
        "hits": [hit_json(hit) for hit in hits],
        "figures": {"points": len(read.cloud.points), "time_s": round(time.perf_counter() - started, 3)},
        "notes": list(view.notes),
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
