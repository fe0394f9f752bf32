"""The ZMP as plain data, as the certificate sees it: just before and just after every jump of the acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.curve import TimeLaw
from service.verify import Motion, Phase, SupportPolygon, VerifySettings
from service.verify.dynamics import compute_forces, list_sample_times
from service.verify.stance_checks import outside_polygon
from service.verify.timeline import find_times

_SAME_S = 1e-9  # times that differ by less are one


@dataclass(frozen=True)
class PhaseZmp:
    """The ZMP of one phase at the certificate's samples.

    Attributes:
        times: (K,) [s].
        points: (K, 2) [m]; NaN where nothing presses on the ground.
        outside: (K,) how far they are outside the support polygon [m], infinite where nothing presses on the ground.
    """

    times: Float[np.ndarray, "K"]
    points: Float[np.ndarray, "K 2"]
    outside: Float[np.ndarray, "K"]

    @staticmethod
    def of(motion: Motion, law: TimeLaw, phase: Phase, support: SupportPolygon) -> PhaseZmp:
        """Inverse dynamics at the samples of ``service.verify.dynamics``."""
        times = list_sample_times(motion, law, phase.first, phase.last, VerifySettings().time_step_s)
        points = compute_forces(motion, law, phase, times, torques=False).zmp(support.height)
        return PhaseZmp(times, points, np.nan_to_num(outside_polygon(support.polygon, points), nan=np.inf))

    def thinned(self, times: Float[np.ndarray, "S"]) -> dict[str, Any]:
        """Times and points: the first, the last and, between two neighbours of ``times``, the one least inside."""
        slots = np.searchsorted(times, self.times)
        ranked = np.lexsort([self.outside, slots])
        worst = ranked[np.append(np.diff(slots[ranked]) > 0, True)]
        kept = np.unique(np.concatenate([[0, len(self.times) - 1], worst]))
        return {"times": self.times[kept].tolist(), "points": [self._point(k) for k in kept.tolist()]}

    def worst_around(self, before: float, at: float, after: float) -> tuple[float, list[float] | None]:
        """How far outside the polygon, and where, the sample between two times is that is least inside.

        Where there is none between them it is the one nearest to ``at``; minus infinity when the phase is elsewhere.
        """
        if not self.times[0] - _SAME_S <= at <= self.times[-1] + _SAME_S:
            return -np.inf, None
        low, high = np.searchsorted(self.times, [before, after]).tolist()
        if low >= high:
            low = int(np.abs(self.times - at).argmin())
            high = low + 1
        worst = low + int(self.outside[low:high].argmax())
        return float(self.outside[worst]), self._point(worst)

    def _point(self, k: int) -> list[float] | None:
        point = self.points[k]
        return point.tolist() if np.isfinite(point).all() else None


def zmp_json(motion: Motion, s: Float[np.ndarray, "S"]) -> tuple[list[list[float] | None], list[dict[str, Any]]]:
    """The ZMP at each sample, and of each phase with a support polygon.

    At a sample it is, of what the certificate looks at between the samples before and after it, the point that is least
    inside its phase's polygon: phases share samples, and forces jump.  Null where no phase stands on a polygon or
    nothing presses on the ground.

    Args:
        motion: timed; an untimed one has no forces.
        s: path parameters of the exported samples.
    """
    standing = [(phase, phase.support) for phase in motion.phases if phase.support is not None]
    law = motion.law
    if law is None:
        return [None] * len(s), [{"times": [], "points": []} for _ in standing]
    times = find_times(law, s)
    found = [PhaseZmp.of(motion, law, phase, support) for phase, support in standing]
    ends = np.concatenate([times[:1], times, times[-1:]])
    ends[-2:] = np.nextafter(times[-1], np.inf)  # the last instant lies between its neighbours, too
    rows = []
    for at, before, after in zip(times.tolist(), ends[:-2].tolist(), ends[2:].tolist(), strict=True):
        worst = [phase.worst_around(before, at, after) for phase in found]
        rows.append(max(worst, key=lambda one: one[0])[1] if worst else None)
    return rows, [phase.thinned(times) for phase in found]
