"""Arms that may be too weak for their own weight: a bound over all poses, and which arms it is about."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from costs.robot import load_robot
from service.tasks.steps.weights import TORQUE_SHARE, bound_own_share, list_weak_arms


@pytest.mark.parametrize("tool", ["l_tool", "r_tool"])
def test_no_pose_needs_more_torque_than_the_bound(tool: str) -> None:
    robot, rng = load_robot("atlas"), np.random.default_rng(3)
    model, data = robot.model, robot.model.createData()
    joint = int(model.frames[model.getFrameId(tool)].parentJoint)
    columns = []
    while joint > 0:
        if model.joints[joint].nv == 1:
            columns.append(int(model.joints[joint].idx_v))
        joint = int(model.parents[joint])
    bound, most = bound_own_share(robot, tool), 0.0
    low, high = np.clip(robot.lower, -3.0, 3.0), np.clip(robot.upper, -3.0, 3.0)
    for _ in range(300):
        q = rng.uniform(low, high)
        torque = pin.computeGeneralizedGravity(model, data, q)
        most = max(most, float((np.abs(torque) / robot.effort)[columns].max()))
    assert 0.05 * bound < most <= bound


def test_only_arms_that_may_be_too_weak_are_limited() -> None:
    robot = load_robot("atlas")
    share = max(bound_own_share(robot, tool) for tool in ("l_tool", "r_tool"))
    for limit, tools in ((0.9, ()), (1.1, ("l_tool", "r_tool"))):
        own = replace(robot, effort=robot.effort * share / (limit * TORQUE_SHARE))
        assert list_weak_arms(own) == tools
