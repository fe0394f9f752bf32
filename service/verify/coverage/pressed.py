"""Parts that hands press: a part that no scan shows, and no request gives, rules out a certificate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from service.verify.certificate import Basis, Check
from service.verify.motion import Phase, PressedPart

LEAST_POINTS = 4
"""Least number of points of a scan on a part, near the hold."""
MOST_THROUGH = 0.5
"""Most rays through the part there, as a share of its points: rays at the edge of a thin part may pass it."""
PRESSED = "coverage.pressed."
ASSUMED = f"{PRESSED}assumed."


def list_pressed(phases: Sequence[Phase]) -> tuple[PressedPart, ...]:
    """Return the parts that hands press during phases, each once."""
    return tuple(dict.fromkeys(part for phase in phases for part in phase.pressed or ()))


def check_pressed(phases: Sequence[Phase]) -> Iterator[Check]:
    """Yield a check for each pressed part that a scan has to show, or that is assumed."""
    for part in list_pressed(phases):
        if part.source == "given":
            continue
        is_seen = is_shown(part)
        text = _describe(part) + (f"; {part.remedy}" if part.remedy and not is_seen else "")
        basis = Basis.SAMPLES if is_seen else Basis.UNPROVEN
        prefix = ASSUMED if part.source == "assumed" else PRESSED
        yield Check(f"{prefix}{part.name}", True, part.n_points, LEAST_POINTS, "points", text, None, basis)


def is_shown(part: PressedPart) -> bool:
    """Return whether a part is given, or a scan shows that it is there."""
    has_points = part.n_points >= LEAST_POINTS and part.n_through <= MOST_THROUGH * part.n_points
    return part.source == "given" or (part.source == "scan" and has_points)


def note_given(phases: Sequence[Phase]) -> Iterator[str]:
    """Yield a sentence about the pressed parts that the request gives."""
    given = [part.name for part in list_pressed(phases) if part.source == "given"]
    if given:
        yield f"given by the request, shown by no scan: {', '.join(given)}"


def _describe(part: PressedPart) -> str:
    if part.source == "assumed":
        return f"the {part.name} that the hand presses is assumed"
    where = f"within {1e3 * part.within_m:.0f} mm of its surface and {1e3 * part.near_m:.0f} mm of the hold"
    seen = f"{part.n_points} points of the scan lie on {part.name} {where}, and {part.n_through} rays pass through it"
    if is_shown(part):
        return seen
    return f"{seen}; at least {LEAST_POINTS} points are needed, and at most {MOST_THROUGH:g} rays per point"
