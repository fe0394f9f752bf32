"""Joints that follow others (URDF's ``mimic``) in given positions: consistent with their leaders, or refused."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel, read_followers
from service.errors import RequestError

TOLERANCE = 1e-3  # of a follower from what its leader says, as robots report positions [rad, m]


def leave_out_followers(
    robot: RobotModel, positions: Mapping[str, float], around: Float[np.ndarray, "n"] | None, field: str
) -> dict[str, float]:
    """Return positions without the joints that follow others.

    Args:
        robot: the robot.
        positions: by joint name, followers perhaps among them as drivers report them.
        around: (n,) configuration of the leaders that ``positions`` leaves out; None where they are free.
        field: where the positions are in the request.

    Raises:
        RequestError: one line per follower that is elsewhere than its leader says, or whose leader is nowhere.
    """
    named = [name for name in positions if name not in robot.joint_names]
    rules = read_followers(robot) if named else {}
    followers = {name: rules[name] for name in named if name in rules and rules[name][0] in robot.joint_names}
    problems = []
    for name, (leader, multiplier, offset) in followers.items():
        if leader in positions:
            led = positions[leader]
        elif around is not None:
            led = float(around[robot.joint_names.index(leader)])
        else:
            problems.append(f"{field}.{name}: it follows {leader}; give {leader}")
            continue
        expected = multiplier * led + offset
        if abs(positions[name] - expected) > TOLERANCE:
            given = "" if leader in positions else f"; give {leader} too"
            problems.append(
                f"{field}.{name}: {positions[name]:.6g}, but it follows {leader} at {led:.6g}: expected "
                f"{expected:.6g}, or leave it out{given}"
            )
    if problems:
        raise RequestError(problems)
    return {name: value for name, value in positions.items() if name not in followers}
