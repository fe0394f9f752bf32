"""The state that another planner started from: ``trajectory_start`` of MoveIt's messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from service.errors import RequestError, shown
from service.replay.exchange.base_motion import read_base_pose
from service.replay.exchange.fields import TakenFields, note_rest, to_coordinate, to_list

MOVING = 1e-3  # [rad/s, m/s]


@dataclass(frozen=True)
class StartState:
    """State at the start of a trajectory, as its planner took it.

    Attributes:
        positions: by joint [rad, m].
        base: (7,) position and quaternion (w, x, y, z) of the base in the world; None if it is not given.
        attached: names of the objects that the robot carries.
        notes: what was read past.
    """

    positions: Mapping[str, float] = field(default_factory=dict)
    base: Float[np.ndarray, "7"] | None = None
    attached: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def read_start_state(body: object, source: str) -> StartState | None:
    """Read a ``RobotState``; None where it says nothing.

    Raises:
        RequestError: it is malformed.
    """
    if not isinstance(body, Mapping) or not body:
        return None
    fields = TakenFields(body)
    joints = TakenFields(_to_mapping(fields.take("joint_state")))
    names, positions = joints.take("name"), joints.take("position")
    names = to_list(names, "trajectory_start.joint_state.name", source)
    values = to_list(positions, "trajectory_start.joint_state.position", source)
    if len(names) != len(values):
        raise RequestError(f"{source}: trajectory_start names {len(names)} joints and has {len(values)} positions")
    where = "trajectory_start"
    state = {str(name): to_coordinate(value, where, source) for name, value in zip(names, values, strict=True)}
    speeds = to_list(joints.take("velocity"), f"{where}.joint_state.velocity", source)
    moving = [
        f"{where} moves: {shown(str(name))} at {to_coordinate(value, where, source):g} rad/s or m/s"
        for name, value in zip(names, speeds, strict=False)
        if abs(to_coordinate(value, where, source)) > MOVING
    ]
    base = read_base_pose(fields.take("multi_dof_joint_state"), f"{source}: {where}")
    objects = fields.take("attached_collision_objects")
    attached = [_name_object(entry) for entry in objects] if isinstance(objects, list | tuple) else []
    joints.skip("header")
    fields.skip("is_diff")
    rest = [f"{where}.joint_state.{key}" for key in joints.list_rest()] + [
        f"{where}.{key}" for key in fields.list_rest()
    ]
    if not state and base is None and not attached and not rest:
        return None
    return StartState(state, None if base is None else base[1], tuple(attached), (*moving[:1], *note_rest(rest)))


def _to_mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, Mapping) else {}


def _name_object(entry: object) -> str:
    """Return the id of an ``AttachedCollisionObject``."""
    inner = _to_mapping(_to_mapping(entry).get("object"))
    return str(inner.get("id") or "an object without a name")
