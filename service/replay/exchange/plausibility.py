"""Is a trajectory the one that its planner meant: times in seconds, the same robot, the same start?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel, read_followers
from service.errors import shown
from service.replay.exchange.base_motion import compute_angles
from service.replay.exchange.followers import expect_follower
from service.replay.exchange.start_state import StartState

SLOW = 500.0  # times the shortest duration at the joints' speed limits, beyond which times may have another unit
FAST = 1.0 / 30.0
UNITS = ((3e8, "nanoseconds"), (3e5, "microseconds"), (SLOW, "milliseconds"))  # by that multiple
LISTED = 5


def note_times(
    times: Float[np.ndarray, "K"], positions: Float[np.ndarray, "K n"], velocity: Float[np.ndarray, "n"]
) -> Iterator[str]:
    """Yield notes on times that begin late, or that joints at their speed limits make implausible.

    Args:
        times: of the points [s].
        positions: of the points.
        velocity: speed limits; joints without one do not count.
    """
    if times[0] > 0.0:
        yield f"the first point is at {times[0]:.4g} s: the robot waits at its start until then"
    with np.errstate(over="ignore"):
        travel = np.abs(np.diff(positions, axis=0)).sum(axis=0)
    has_limit = np.isfinite(velocity) & (velocity > 0.0)
    least = float((travel[has_limit] / velocity[has_limit]).max(initial=0.0))
    duration = float(times[-1] - times[0])
    if least <= 0.0:
        return
    ratio = duration / least
    unit = next((name for bound, name in UNITS if ratio > bound), "")
    if unit:
        yield (
            f"the motion lasts {duration:.4g} s, and the joints can do it in {least:.2g} s at their speed limits; are "
            f"its times in {unit}?"
        )
    elif ratio < FAST:
        yield (
            f"the motion lasts {duration:.2g} s, and the joints need at least {least:.2g} s at their speed limits; are "
            "its times in another unit than seconds?"
        )


def note_model(model_id: str, robot: RobotModel) -> Iterator[str]:
    """Yield a note on a trajectory of another robot by its name."""
    if model_id and model_id != robot.name:
        yield f"model_id is {shown(model_id)}, the request's robot is {shown(robot.name)}: held to the request's"


def note_start(state: StartState | None, robot: RobotModel, attached: Sequence[str]) -> Iterator[str]:
    """Yield notes on a start state: joints that the robot lacks, and objects that only the other planner attached."""
    if state is None:
        return
    followers = read_followers(robot)
    unknown = [name for name in state.positions if name not in robot.joint_names and name not in followers]
    if unknown:
        more = f" and {len(unknown) - LISTED} more" if len(unknown) > LISTED else ""
        listed = ", ".join(shown(name) for name in unknown[:LISTED])
        yield f"trajectory_start has joints that {robot.name} lacks: {listed}{more}"
    carried = [name for name in state.attached if name not in attached]
    if carried:
        yield (
            f"trajectory_start carries {', '.join(shown(name) for name in carried[:LISTED])}, which the request does "
            "not attach: not checked"
        )
    if state.base is not None and not (robot.is_floating or robot.is_planar):
        place = np.round(state.base[:3], 4).tolist()
        yield f"trajectory_start places the base at {place} m, and that of {robot.name} is fixed: not compared"


def find_other_start(
    state: StartState | None, robot: RobotModel, start: Float[np.ndarray, "n"], tolerance: float
) -> tuple[str, float] | None:
    """Return a sentence and the distance where a planner started from another state than the request's; None if not.

    Args:
        state: of the other planner.
        robot: the request's robot.
        start: the request's start.
        tolerance: of each coordinate [rad, m].
    """
    if state is None:
        return None
    own = dict(zip(robot.joint_names, start.tolist(), strict=True))
    expected: dict[str, float] = dict(own)
    for name, rule in read_followers(robot).items():
        value = expect_follower(rule, own)
        if value is not None:
            expected[name] = value
    given = {**state.positions, **_place_base(state, robot, own)}
    off = {name: abs(value - expected[name]) for name, value in given.items() if name in expected}
    worst = max(off, key=lambda name: off[name], default="")
    if not worst or off[worst] <= tolerance:
        return None
    text = f"trajectory_start has {worst} at {given[worst]:.4f}, the request's start has {expected[worst]:.4f}"
    return text, off[worst]


def _place_base(state: StartState, robot: RobotModel, own: Mapping[str, float]) -> dict[str, float]:
    """Return the base of a start state in the robot's coordinates, with angles within half a turn of the request's."""
    if state.base is None or not (robot.is_floating or robot.is_planar):
        return {}
    angles = compute_angles(state.base[None, 3:])[0]
    values = dict(zip(("base_x", "base_y", "base_z"), state.base[:3].tolist(), strict=True))
    for name, angle in zip(("base_yaw", "base_pitch", "base_roll"), angles.tolist(), strict=True):
        turns = np.round((own.get(name, 0.0) - angle) / (2.0 * np.pi))
        values[name] = float(angle + 2.0 * np.pi * turns)
    return {name: value for name, value in values.items() if name in robot.joint_names}
