"""Pressed parts in a certificate: points and rays of the scan, parts that are given, and parts that are assumed."""

from __future__ import annotations

import pytest

from service.verify import Basis, Phase, PressedPart
from service.verify.coverage.pressed import check_pressed, list_pressed, note_given


def phases(*parts: PressedPart) -> list[Phase]:
    return [Phase("reach", 0.0, 1.0), Phase("turn", 1.0, 2.0, pressed=parts), Phase("back", 2.0, 3.0, pressed=parts)]


@pytest.mark.parametrize(
    ("n_points", "n_through", "basis"),
    [
        (4, 0, Basis.SAMPLES),
        (4, 2, Basis.SAMPLES),
        (4, 3, Basis.UNPROVEN),
        (3, 0, Basis.UNPROVEN),
        (0, 40, Basis.UNPROVEN),
    ],
)
def test_a_part_needs_points_and_few_rays_through_it(n_points: int, n_through: int, basis: Basis) -> None:
    part = PressedPart("spoke/1", "scan", n_points, n_through, 0.05, 0.02)
    (check,) = check_pressed(phases(part))
    assert (check.name, check.ok, check.basis) == ("coverage.pressed.spoke/1", True, basis)
    assert (check.value, check.limit) == (n_points, 4)
    assert (
        f"{n_points} points of the scan lie on spoke/1 within 20 mm of its surface and 50 mm of the hold" in check.text
    )
    assert f"{n_through} rays pass through it" in check.text


def test_a_given_part_is_named_and_an_assumed_one_is_unproven() -> None:
    given, assumed = PressedPart("lever", "given"), PressedPart("spoke", "assumed", remedy="give spokes_deg")
    assert list(check_pressed(phases(given))) == []
    assert list(note_given(phases(given))) == ["given by the request, shown by no scan: lever"]
    (check,) = check_pressed(phases(assumed))
    assert (check.name, check.basis) == ("coverage.pressed.assumed.spoke", Basis.UNPROVEN)
    assert check.text == "the spoke that the hand presses is assumed; give spokes_deg"


def test_records_of_earlier_releases_say_nothing_of_pressed_parts() -> None:
    assert list_pressed([Phase("turn", 0.0, 1.0, pressed=None)]) == ()
