"""Clearance proof of a certificate over time: the proven clearance at each time, and the gaps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from costs.curve import TimeLaw
from service.verify import find_times

N_TIMES = 241
TimeOf = Callable[[Float[np.ndarray, "S"]], Float[np.ndarray, "S"]]


@dataclass(frozen=True)
class Gap:
    """Time span [s] without proven clearance of a pair."""

    pair: tuple[str, str]
    start: float
    end: float


@dataclass(frozen=True)
class ClearanceTrack:
    """Proven clearance at ``N_TIMES`` times; at path parameters if the motion is untimed.

    Attributes:
        times: (N,) [s].
        clearance: (N,) proven lower bound, from the previous to the next time, of the clearance of all pairs that may
            not touch [m]; NaN without a bound.
        gaps: spans without proven clearance of a pair; the bound there excludes that pair.
        pair, time_s: the pair with the least proven clearance and the middle of its stretch; None and NaN if no pair
            came near enough to be examined.
    """

    times: Float[np.ndarray, "N"]
    clearance: Float[np.ndarray, "N"]
    gaps: tuple[Gap, ...]
    pair: tuple[str, str] | None
    time_s: float


def trace_clearance(result: Mapping[str, Any]) -> ClearanceTrack | None:
    """Return the track of a result, or None without a clearance proof or a curve."""
    certificate, curve = result.get("certificate") or {}, result.get("curve") or {}
    stretches = certificate.get("stretches") or {}
    if not stretches.get("edges") or not curve:
        return None
    law, time_of = _read_law(curve)
    if law is None:
        times = path = np.linspace(stretches["edges"][0], stretches["edges"][-1], N_TIMES)
    else:
        times = np.linspace(law.times[0], law.times[-1], N_TIMES)
        path = law.at(times)[0]
    edges = np.asarray(stretches["edges"], dtype=float)
    # Bounds of the pairs that were not examined.
    floors = np.array([np.inf if floor is None else float(floor) for floor in stretches["floors"]])
    first, last, distance, bound = (
        np.asarray(stretches[key], dtype=float) for key in ("first", "last", "distance", "bound")
    )
    proven = np.where(_find_exempt(result, time_of, 0.5 * (first + last)), np.inf, distance - bound)
    clearance = _find_least(
        path,
        np.concatenate([edges[:-1], first]),
        np.concatenate([edges[1:], last]),
        np.concatenate([floors, proven]),
    )
    claimed = certificate.get("min_clearance_m")
    if claimed is not None and clearance.min() > claimed:
        # No pair is within the distance that the verifier examines, and it claims nothing beyond.
        clearance = np.minimum(clearance, float(claimed))
    clearance[~np.isfinite(clearance)] = np.nan
    gaps = _read_gaps(certificate.get("gaps") or {}, time_of)
    is_by_floors = "min_clearance_pair" in certificate and certificate["min_clearance_pair"] is None
    if is_by_floors or not np.isfinite(proven.min(initial=np.inf)):
        return ClearanceTrack(times, clearance, gaps, None, float("nan"))
    least = int(np.argmin(proven))
    mover, holder = stretches["pairs"][stretches["pair"][least]]
    middle = float(time_of(np.array([0.5 * (first[least] + last[least])]))[0])
    return ClearanceTrack(times, clearance, gaps, (mover, holder), middle)


def _read_law(curve: Mapping[str, Any]) -> tuple[TimeLaw | None, TimeOf]:
    """Return the curve's time law and a function from path parameter to time: the identity if untimed."""
    law = curve.get("law") or {}
    if len(law.get("times") or []) < 2:
        return None, lambda s: s
    time_law = TimeLaw(*(np.asarray(law[key], dtype=float) for key in ("times", "path", "speed")))
    return time_law, lambda s: find_times(time_law, s)


def _find_least(
    path: Float[np.ndarray, "N"],
    first: Float[np.ndarray, "R"],
    last: Float[np.ndarray, "R"],
    value: Float[np.ndarray, "R"],
) -> Float[np.ndarray, "N"]:
    """Return, at each path parameter, the least value of the stretches that reach between its neighbours."""
    between = np.array(
        [value[(first <= after) & (last >= before)].min(initial=np.inf) for before, after in pairwise(path.tolist())]
    )
    return np.asarray(np.minimum(np.append(between, np.inf), np.insert(between, 0, np.inf)))


def _read_gaps(columns: Mapping[str, Any], time_of: TimeOf) -> tuple[Gap, ...]:
    if not columns.get("pair"):
        return ()
    starts, ends = (time_of(np.asarray(columns[key], dtype=float)).tolist() for key in ("first", "last"))
    pairs = [(mover, holder) for mover, holder in columns["pairs"]]
    return tuple(Gap(pairs[k], start, end) for k, start, end in zip(columns["pair"], starts, ends, strict=True))


def _find_exempt(result: Mapping[str, Any], time_of: TimeOf, middle: Float[np.ndarray, "R"]) -> Bool[np.ndarray, "R"]:
    """Return which rows of the proof belong to a pair that may touch in the phase of their middle."""
    certificate, samples = result["certificate"], result["trajectory"]["times"]
    stretches = certificate["stretches"]
    pairs = [tuple(sorted(pair)) for pair in stretches["pairs"]]
    row_pairs = [pairs[index] for index in stretches["pair"]]
    at = time_of(middle)
    exempt = np.zeros(len(middle), dtype=bool)
    entries = certificate.get("exempt") or []
    for phase in result.get("phases") or []:
        names = {tuple(sorted(entry["pair"])) for entry in entries if entry.get("phase") == phase["name"]}
        inside = (samples[phase["first"]] <= at) & (at <= samples[phase["last"]])
        exempt |= inside & np.array([pair in names for pair in row_pairs], dtype=bool)
    return exempt
