"""The ZMP in ``result.json``, from the certificate's samples on both sides of every jump of the acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.curve import TimeLaw
from service.verify import (
    Motion,
    Phase,
    SupportPolygon,
    VerifySettings,
    compute_forces,
    find_times,
    list_sample_times,
    split_motion,
)

_SAME_S = 1e-9  # times that differ by less are equal


@dataclass(frozen=True)
class PhaseZmp:
    """ZMP of a phase at the certificate's samples.

    Attributes:
        times: (K,) [s].
        points: (K, 2) [m]; NaN where no foot is loaded.
        outside: (K,) distance outside the support polygon [m]; infinite where no foot is loaded.
    """

    times: Float[np.ndarray, "K"]
    points: Float[np.ndarray, "K 2"]
    outside: Float[np.ndarray, "K"]

    @staticmethod
    def of(motion: Motion, law: TimeLaw, phase: Phase, support: SupportPolygon) -> PhaseZmp:
        """Compute inverse dynamics at the samples of ``service.verify.forces.dynamics``."""
        times = list_sample_times(motion, law, phase.first, phase.last, VerifySettings().time_step_s)
        return PhaseZmp(times, *compute_forces(motion, law, phase, times, torques=False).find_worst_zmp(support))

    def select_worst(self, times: Float[np.ndarray, "S"]) -> dict[str, Any]:
        """Select the first and last samples and, between two neighbours of ``times``, the one least inside."""
        slots = np.searchsorted(times, self.times)
        ranked = np.lexsort([self.outside, slots])
        worst = ranked[np.append(np.diff(slots[ranked]) > 0, True)]
        kept = np.unique(np.concatenate([[0, len(self.times) - 1], worst]))
        return {"times": self.times[kept].tolist(), "points": [self._get_point(k) for k in kept.tolist()]}

    def find_worst(self, before: float, at: float, after: float) -> tuple[float, list[float] | None]:
        """Return distance outside the polygon and position of the sample between two times that is least inside.

        Without a sample between them, the one nearest to ``at`` counts; minus infinity if ``at`` is in another phase.
        """
        if not self.times[0] - _SAME_S <= at <= self.times[-1] + _SAME_S:
            return -np.inf, None
        low, high = np.searchsorted(self.times, [before, after]).tolist()
        if low >= high:
            low = int(np.abs(self.times - at).argmin())
            high = low + 1
        worst = low + int(self.outside[low:high].argmax())
        return float(self.outside[worst]), self._get_point(worst)

    def _get_point(self, k: int) -> list[float] | None:
        point = self.points[k]
        return point.tolist() if np.isfinite(point).all() else None


def zmp_json(motion: Motion, s: Float[np.ndarray, "S"]) -> tuple[list[list[float] | None], list[dict[str, Any]]]:
    """Return the ZMP at each sample, and that of each phase with a support polygon.

    At sample i it is the certificate's ZMP between samples i-1 and i+1 that is least inside the polygon of its phase,
    since phases share samples and forces jump.  None without a polygon, load or time law.

    Args:
        motion: the motion.
        s: path parameters of the exported samples.
    """
    parts = zip(motion.phases, split_motion(motion), strict=False)  # with what hands carry; one part without phases
    standing = [(part, phase, phase.support) for phase, part in parts if phase.support is not None]
    law = motion.law
    if law is None:
        return [None] * len(s), [{"times": [], "points": []} for _ in standing]
    times = find_times(law, s)
    tracks = [PhaseZmp.of(part, law, phase, support) for part, phase, support in standing]
    ends = np.concatenate([times[:1], times, times[-1:]])
    ends[-2:] = np.nextafter(times[-1], np.inf)  # include the last sample in its interval
    rows = []
    for at, before, after in zip(times.tolist(), ends[:-2].tolist(), ends[2:].tolist(), strict=True):
        worst = [track.find_worst(before, at, after) for track in tracks]
        rows.append(max(worst, key=lambda entry: entry[0])[1] if worst else None)
    return rows, [track.select_worst(times) for track in tracks]
