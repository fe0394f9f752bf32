"""What is wrong with where the robot stands among clouds is told under the field that holds it."""

from __future__ import annotations

import pytest

from service.server.cloud_requests import check_start
from service.wire.violations import make_violation


@pytest.mark.parametrize(
    ("start", "field"),
    [
        ({"joint_names": [], "positions": [1.0]}, "clouds.start"),
        ({"joints": {"elbow": float("nan")}}, "clouds.start.joints.elbow"),
        ({"base": {"position": [0.0, 0.0]}}, "clouds.start.base.position"),
    ],
)
def test_a_wrong_start_is_told_with_its_field(start: object, field: str) -> None:
    (problem,) = check_start(start)
    assert make_violation(problem, "clouds").field == field


def test_a_start_that_can_be_used_has_no_problems() -> None:
    assert check_start({"joints": {"elbow": 1.0}}) == ()
