"""How far a plan's centre of mass is inside what its contacts hold, over time and with some contacts missing."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

from service.execution.reference import PlannedReference
from service.verify import Phase, SupportPolygon, outside_polygon

STEP_S = 0.02


@dataclass(frozen=True)
class PlannedBalance:
    """Balance of a plan at ``S`` times.

    Attributes:
        times: (S,) on the plan's clock [s].
        com: (S, 2) centre of mass, world x and y [m].
        margin: (S,) how far it is inside the support of its phase with all contacts [m]; inf for a fixed base.
        phase: (S,) index of the phase.
        phases: of the plan's motion.
        feet: links that may be put down again on the way back.
    """

    times: Float[np.ndarray, "S"]
    com: Float[np.ndarray, "S 2"]
    margin: Float[np.ndarray, "S"]
    phase: Int[np.ndarray, "S"]
    phases: tuple[Phase, ...]
    feet: tuple[str, ...] = ()

    @staticmethod
    def of(reference: PlannedReference) -> PlannedBalance:
        """Return the balance of a plan every 20 ms, and at both ends of every phase."""
        robot, phases = reference.robot, reference.motion.phases
        ends = [time for phase in reference.phases for time in (phase.begin_s, phase.end_s)]
        times = np.unique([*np.arange(0.0, reference.duration_s, STEP_S), *ends, reference.duration_s])
        data = robot.model.createData()
        states = [reference.at(time).configuration for time in times]
        com = np.array([pin.centerOfMass(robot.model, data, q)[:2] for q in states])
        begins = np.array([phase.begin_s for phase in reference.phases])
        index = np.maximum(np.searchsorted(begins, times, side="right") - 1, 0)
        margin = np.full(len(times), np.inf)
        for k, phase in enumerate(phases):
            here = index == k
            if phase.contacts and robot.is_floating:
                margin[here] = -outside_polygon(_find_support(phase), com[here])
        return PlannedBalance(times, com, margin, index, phases, robot.link_groups.get("feet", ()))

    def list_margins(self) -> list[float]:
        """Return the least margin of each phase [m]."""
        return [float(self.margin[self.phase == k].min(initial=np.inf)) for k in range(len(self.phases))]

    def find_last(self, time_s: float, lost: Collection[str], margin_m: float) -> float:
        """Return the latest time up to ``time_s`` at which the plan is in balance without contacts that are lost.

        Args:
            time_s: on the plan's clock [s].
            lost: links that should be planted and are not.
            margin_m: required margin; where no earlier time has it, the time with the largest one counts.
        """
        before = np.flatnonzero(self.times <= time_s + 1e-9)
        before = before[self.phase[before] >= self._find_first(int(self.phase[before[-1]]))]
        margins = np.array([self._find_margin(int(k), lost) for k in before])
        enough = np.flatnonzero(margins >= margin_m)
        if len(enough) and (enough[-1] == len(before) - 1):
            return time_s
        best = enough[-1] if len(enough) else int(margins.argmax())
        return float(self.times[before[best]])

    def _find_first(self, k: int) -> int:
        """Return the first of the phases up to one that have the same hold of the world and of objects.

        Feet are put down again where they stood; hands and trunk would have to take hold again of what they let go, and
        would let go of what they took.
        """

        def others(phase: Phase) -> tuple[set[str], set[tuple[str, str]]]:
            held = {(carrier.item, carrier.link) for carrier in phase.carriers if carrier.link is not None}
            return {contact.link for contact in phase.contacts} - set(self.feet), held

        while k > 0 and others(self.phases[k - 1]) == others(self.phases[k]):
            k -= 1
        return k

    def _find_margin(self, k: int, lost: Collection[str]) -> float:
        phase = self.phases[self.phase[k]]
        if not any(contact.link in lost for contact in phase.contacts):
            return float(self.margin[k])
        held = [contact for contact in phase.contacts if contact.link not in lost]
        if phase.region_margin_m is not None or not held:
            return -np.inf
        polygon = _hull(np.vstack([contact.points for contact in held])[:, :2])
        return -np.inf if polygon is None else float(-outside_polygon(polygon, self.com[k : k + 1])[0])


def _find_support(phase: Phase) -> Float[np.ndarray, "E 2"]:
    """Return the polygon in which the centre of mass is in balance: of the phase, its region, or its soles' hull."""
    if isinstance(phase.support, SupportPolygon):
        return np.asarray(phase.support.polygon)
    if phase.regions:
        return np.asarray(phase.regions[0].vertices)
    polygon = _hull(np.vstack([contact.points for contact in phase.contacts])[:, :2])
    return np.zeros((0, 2)) if polygon is None else polygon


def _hull(points: Float[np.ndarray, "C 2"]) -> Float[np.ndarray, "E 2"] | None:
    """Return the corners of the hull of points, counter-clockwise; None if they are on a line."""
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        return None
