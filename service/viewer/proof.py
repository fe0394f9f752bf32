"""The clearance proof of a certificate, told over time: how much clearance is certain when, and where nothing is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from costs.curve import TimeLaw
from service.verify.timeline import find_times

N_TIMES = 241
TimeOf = Callable[[Float[np.ndarray, "S"]], Float[np.ndarray, "S"]]


@dataclass(frozen=True)
class Gap:
    """A time span [s] on which the clearance of a pair is not shown."""

    pair: tuple[str, str]
    start: float
    end: float


@dataclass(frozen=True)
class ClearanceTrack:
    """What the proof says at each of ``N_TIMES`` times; of an untimed motion, at each path parameter.

    Attributes:
        times: (N,) [s].
        clearance: (N,) proven lower bound, from the time before to the time after, of the clearance of all pairs that
            may not touch [m]; NaN where there is none.
        gaps: where the clearance of a pair is not shown; the bound of these times says nothing of that pair.
        pair, time_s: the pair with the least proven clearance and the middle of the stretch where that is; None and NaN
            when no pair came near enough to be looked at.
    """

    times: Float[np.ndarray, "N"]
    clearance: Float[np.ndarray, "N"]
    gaps: tuple[Gap, ...]
    pair: tuple[str, str] | None
    time_s: float


def clearance_track(result: Mapping[str, Any]) -> ClearanceTrack | None:
    """The track of a result, or None when it has no clearance proof or no curve to read it by."""
    certificate, curve = result.get("certificate") or {}, result.get("curve") or {}
    stretches = certificate.get("stretches") or {}
    if not stretches.get("edges") or not curve:
        return None
    law, time_of = _clock(curve)
    if law is None:
        times = path = np.linspace(stretches["edges"][0], stretches["edges"][-1], N_TIMES)
    else:
        times = np.linspace(law.times[0], law.times[-1], N_TIMES)
        path = law.at(times)[0]
    edges = np.asarray(stretches["edges"], dtype=float)
    first, last, distance, bound = (
        np.asarray(stretches[key], dtype=float) for key in ("first", "last", "distance", "bound")
    )
    proven = np.where(_may_touch(result, time_of, 0.5 * (first + last)), np.inf, distance - bound)
    clearance = _least_on(
        path,
        np.concatenate([edges[:-1], first]),
        np.concatenate([edges[1:], last]),
        np.concatenate([_floors(stretches), proven]),
    )
    claimed = certificate.get("min_clearance_m")
    if claimed is not None and clearance.min() > claimed:
        # No pair is as near as the verifier looks: beyond that nothing is claimed.
        clearance = np.minimum(clearance, float(claimed))
    clearance[~np.isfinite(clearance)] = np.nan
    gaps = _gaps(certificate.get("gaps") or {}, time_of)
    is_by_floors = "min_clearance_pair" in certificate and certificate["min_clearance_pair"] is None
    if is_by_floors or not np.isfinite(proven.min(initial=np.inf)):
        return ClearanceTrack(times, clearance, gaps, None, float("nan"))
    least = int(np.argmin(proven))
    mover, holder = stretches["pairs"][stretches["pair"][least]]
    middle = float(time_of(np.array([0.5 * (first[least] + last[least])]))[0])
    return ClearanceTrack(times, clearance, gaps, (mover, holder), middle)


def _clock(curve: Mapping[str, Any]) -> tuple[TimeLaw | None, TimeOf]:
    """The curve's time law and how to tell the time of a path parameter; the parameter itself where it is untimed."""
    law = curve.get("law") or {}
    if len(law.get("times") or []) < 2:
        return None, lambda s: s
    time_law = TimeLaw(*(np.asarray(law[key], dtype=float) for key in ("times", "path", "speed")))
    return time_law, lambda s: find_times(time_law, s)


def _floors(stretches: Mapping[str, Any]) -> Float[np.ndarray, "E-1"]:
    """Bounds of the pairs that nobody had to look at; infinite where all were looked at."""
    return np.array([np.inf if floor is None else float(floor) for floor in stretches["floors"]])


def _least_on(
    path: Float[np.ndarray, "N"],
    first: Float[np.ndarray, "R"],
    last: Float[np.ndarray, "R"],
    value: Float[np.ndarray, "R"],
) -> Float[np.ndarray, "N"]:
    """At each path parameter, the least value of the stretches that reach between its neighbours."""
    between = np.array(
        [value[(first <= after) & (last >= before)].min(initial=np.inf) for before, after in pairwise(path.tolist())]
    )
    return np.asarray(np.minimum(np.append(between, np.inf), np.insert(between, 0, np.inf)))


def _gaps(columns: Mapping[str, Any], time_of: TimeOf) -> tuple[Gap, ...]:
    if not columns.get("pair"):
        return ()
    starts, ends = (time_of(np.asarray(columns[key], dtype=float)).tolist() for key in ("first", "last"))
    pairs = [(mover, holder) for mover, holder in columns["pairs"]]
    return tuple(Gap(pairs[k], start, end) for k, start, end in zip(columns["pair"], starts, ends, strict=True))


def _may_touch(result: Mapping[str, Any], time_of: TimeOf, middle: Float[np.ndarray, "R"]) -> Bool[np.ndarray, "R"]:
    """Which rows of the proof belong to a pair that may touch in the phase in which their middle lies."""
    certificate, samples = result["certificate"], result["trajectory"]["times"]
    stretches = certificate["stretches"]
    pairs = [tuple(sorted(pair)) for pair in stretches["pairs"]]
    row_pairs = [pairs[index] for index in stretches["pair"]]
    at = time_of(middle)
    exempt = np.zeros(len(middle), dtype=bool)
    for phase in result.get("phases") or []:
        names = {tuple(sorted(e["pair"])) for e in certificate.get("exempt") or [] if e.get("phase") == phase["name"]}
        inside = (samples[phase["first"]] <= at) & (at <= samples[phase["last"]])
        exempt |= inside & np.array([pair in names for pair in row_pairs], dtype=bool)
    return exempt
