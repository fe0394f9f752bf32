"""The clearance proof of a certificate, told over time: how much clearance is certain when, and where it is least."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from costs.curve import TimeLaw

N_TIMES = 241


@dataclass(frozen=True)
class ClearanceTrack:
    """What the proof says at each of ``N_TIMES`` times.

    Attributes:
        times: (N,) [s].
        clearance: (N,) proven lower bound of the clearance of all pairs that may not touch [m].
        pair, time_s: the pair with the least clearance and the middle of the stretch where that is; None and NaN when
            no pair came near enough to be looked at.
    """

    times: Float[np.ndarray, "N"]
    clearance: Float[np.ndarray, "N"]
    pair: tuple[str, str] | None
    time_s: float


def clearance_track(result: Mapping[str, Any]) -> ClearanceTrack | None:
    """The track of a result, or None when it has no clearance proof or no time law to read it by."""
    certificate, curve = result.get("certificate") or {}, result.get("curve") or {}
    stretches, law = certificate.get("stretches") or {}, curve.get("law") or {}
    if not stretches.get("edges") or len(law.get("times") or []) < 2:
        return None
    time_law = TimeLaw(*(np.asarray(law[key], dtype=float) for key in ("times", "path", "speed")))
    times = np.linspace(time_law.times[0], time_law.times[-1], N_TIMES)
    path = time_law.at(times)[0]

    floors = np.asarray(stretches["floors"], dtype=float)
    broad = np.searchsorted(np.asarray(stretches["edges"], dtype=float), path, side="right") - 1
    clearance = floors[np.clip(broad, 0, len(floors) - 1)]
    first, last, distance, bound = (
        np.asarray(stretches[key], dtype=float) for key in ("first", "last", "distance", "bound")
    )
    if len(first) == 0:
        return ClearanceTrack(times, clearance, None, float("nan"))
    proven = np.where(_may_touch(result, time_law, 0.5 * (first + last)), np.inf, distance - bound)
    covered = (first[:, None] <= path) & (path <= last[:, None])
    clearance = np.minimum(clearance, np.where(covered, proven[:, None], np.inf).min(axis=0))
    least = int(np.argmin(proven))
    if not np.isfinite(proven[least]):
        return ClearanceTrack(times, clearance, None, float("nan"))
    mover, holder = stretches["pairs"][stretches["pair"][least]]
    middle = float(np.interp(0.5 * (first[least] + last[least]), path, times))
    return ClearanceTrack(times, clearance, (mover, holder), middle)


def _may_touch(result: Mapping[str, Any], law: TimeLaw, middle: Float[np.ndarray, "R"]) -> Bool[np.ndarray, "R"]:
    """Which rows of the proof belong to a pair that may touch in the phase in which their middle lies."""
    certificate, samples = result["certificate"], result["trajectory"]["times"]
    stretches = certificate["stretches"]
    pairs = [tuple(sorted(pair)) for pair in stretches["pairs"]]
    row_pairs = [pairs[index] for index in stretches["pair"]]
    exempt = np.zeros(len(middle), dtype=bool)
    for phase in result.get("phases") or []:
        names = {tuple(sorted(e["pair"])) for e in certificate.get("exempt") or [] if e.get("phase") == phase["name"]}
        ends = law.at(np.array([samples[phase["first"]], samples[phase["last"]]], dtype=float))[0]
        inside = (ends[0] <= middle) & (middle <= ends[1])
        exempt |= inside & np.array([pair in names for pair in row_pairs], dtype=bool)
    return exempt
