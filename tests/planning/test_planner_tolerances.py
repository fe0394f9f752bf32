"""Tolerances of goals are distances and angles, up to half a turn, for the planner and for the certificate."""

import numpy as np
import pytest
from planar_arm import write_planar_arm
from scipy.spatial.transform import Rotation

from service.planner import plan
from service.request.file import parse_request
from service.result.result import Verdict

PLACE = (0.3, 0.2, 0.0)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """An arm that turns about z alone, so that its links never tilt."""
    return write_planar_arm(tmp_path_factory.mktemp("arm"), 3, 0.2, 0.02, limit=3.0)


def reach(arm, tilt_deg: float, tolerance_deg: float, tolerance_m: float = 0.005):
    """Plan to a pose whose z axis is tilted, which the arm cannot follow."""
    turn = Rotation.from_rotvec(np.deg2rad(tilt_deg) * np.array([1.0, 0.0, 0.0]))
    pose = {"link": "l2", "position": PLACE, "quaternion_wxyz": turn.as_quat(scalar_first=True).tolist()}
    tolerances = {"position_tolerance_m": tolerance_m, "rotation_tolerance_deg": tolerance_deg}
    return plan(
        parse_request(
            {
                "robot": {"urdf": str(arm)},
                "scene": {"floor": False},
                "start": {"joints": {"j0": 0.3, "j1": 0.6, "j2": -0.4}},
                "goal": {"poses": [{**pose, **tolerances}]},
                "options": {"starts": 1},
            }
        )
    )


@pytest.mark.parametrize(("tilt", "tolerance"), [(20, 25), (80, 95), (100, 110), (140, 150), (175, 179), (180, 180)])
def test_a_tilt_within_a_wide_tolerance_is_certified_with_its_angle(arm, tilt, tolerance):
    result = reach(arm, tilt, tolerance)
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    (check,) = [check for check in result.certificate.checks if check.name == "target.reach.l2.rotation"]
    assert np.deg2rad(tilt) - 1e-6 <= check.value <= np.deg2rad(tolerance)


@pytest.mark.parametrize(("tilt", "tolerance"), [(20, 15), (100, 92), (150, 140)])
def test_a_tilt_beyond_the_tolerance_is_not(arm, tilt, tolerance):
    result = reach(arm, tilt, tolerance)
    assert result.verdict in (Verdict.NOT_FOUND, Verdict.TIME_LIMIT)


@pytest.mark.parametrize("tolerance", [0.0, 1e-3, 0.05])
def test_a_hand_ends_within_the_tolerance_as_a_distance(arm, tolerance):
    result = reach(arm, 0.0, 180.0, tolerance)
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    (check,) = [check for check in result.certificate.checks if check.name == "target.reach.l2"]
    assert check.value <= check.limit == max(tolerance, 1e-4)
