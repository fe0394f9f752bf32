"""Objects that go into holes: the force that keeps one from jamming, by hand and against Whitney's conditions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.verify import HoleTarget
from service.verify.targets.holes import HoleForces

Z = np.array([0.0, 0.0, 1.0])
HOLE = HoleTarget("peg", np.zeros(3), -Z, -Z, 0.06, 0.02, 0.1, 1e-3, 0.5, 10.0, 1e4, 1e3)


def test_the_force_along_a_hole_by_hand() -> None:
    # 1 mm beside, straight: 10 N across and 10 N * 0.1 m about its end; turned by sqrt(10) mrad, both ends would touch
    # 316 mm deep, so that friction at one of them, 0.5 * 10 N, is all.
    straight = HoleForces.of(HOLE, 1e-3, 0.0)
    np.testing.assert_allclose([straight.across_n, straight.moment_n_m, straight.needed_n], [10.0, 1.0, 5.0])
    assert straight.begins_m == np.inf
    # 10 mrad turned: 2 mm beside at its end, 20 N and 10 + 2 N m; the hole turns it by another sqrt(1 + 0.4) times as
    # much, so that both ends touch at 1 mm / 21.83 mrad = 45.8 mm, where lambda = 45.8 / (2 * 20 * 0.5) = 2.290, and
    # (12 / 0.02 + 0.5 * 3.290 * 20) / 2.290 = 276.4 N.
    turned = HoleForces.of(HOLE, 1e-3, 1e-2)
    np.testing.assert_allclose([turned.across_n, turned.moment_n_m], [20.0, 12.0])
    np.testing.assert_allclose([turned.begins_m, turned.needed_n], [0.0458, 276.4], rtol=1e-3)


@given(
    beside=st.floats(0.0, 5e-3),
    lean=st.floats(0.0, 0.05),
    friction=st.floats(0.05, 1.5),
    play=st.floats(1e-4, 5e-3),
    more=st.floats(1.0, 3.0),
)
def test_the_least_force_fulfils_whitneys_conditions_and_less_does_not(
    beside: float, lean: float, friction: float, play: float, more: float
) -> None:
    hole = replace(HOLE, friction=friction, play_m=play)
    forces = HoleForces.of(hole, beside, lean)

    def slides(along: float) -> bool:
        depths = np.linspace(forces.begins_m, hole.depth_m, 50) if forces.begins_m < np.inf else np.zeros(0)
        share = depths / (2.0 * hole.radius_m * friction)
        for across, moment in ((x, m) for x in (-1.0, 1.0) for m in (-1.0, 1.0)):
            f, m = across * forces.across_n, moment * forces.moment_n_m
            if abs(f) > along / friction:
                return False
            if np.any(np.abs(m / hole.radius_m + friction * (1.0 + share) * f) > share * along):
                return False
        return True

    assert slides(more * forces.needed_n * (1.0 + 1e-9) + 1e-9)
    if forces.needed_n > 1e-6:
        assert not slides(0.999 * forces.needed_n)


@pytest.mark.parametrize("field_name", ["beside", "lean", "friction", "stiffness_n_m", "turn_stiffness_n_m_rad"])
def test_more_of_anything_bad_needs_more_force(field_name: str) -> None:
    given_errors = {"beside": 1e-3, "lean": 1e-2}
    hole = HOLE
    if field_name in given_errors:
        given_errors[field_name] *= 1.5
    else:
        hole = replace(HOLE, **{field_name: 1.5 * getattr(HOLE, field_name)})
    more = HoleForces.of(hole, given_errors["beside"], given_errors["lean"])
    assert more.needed_n > HoleForces.of(HOLE, 1e-3, 1e-2).needed_n
