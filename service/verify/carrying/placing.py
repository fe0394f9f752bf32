"""Where movable objects are: a motion per phase, whose robot has them where the phase's carriers hold them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from costs.robot.carried import PlacedObject, with_objects
from costs.work_space import borrow_data
from service.verify.motion import Motion, Phase, VerifyError

Poses = Mapping[str, Float[np.ndarray, "4 4"]]


def split_motion(motion: Motion) -> tuple[Motion, ...]:
    """Return the motion once per phase, with the objects as links of its robot; the same one without objects.

    Phases in a row with the same carriers share a motion.  One whose robot has the objects already stays as it is.

    Raises:
        VerifyError: a phase does not say who carries an object, or names one that the motion or its robot lacks.
    """
    if not motion.objects or motion.robot.model.existFrame(motion.objects[0].name):
        return (motion,) * max(len(motion.phases), 1)
    if not motion.phases:
        raise VerifyError(f"no phase says what carries {', '.join(item.name for item in motion.objects)}")
    parts: list[Motion] = []
    poses: dict[str, Float[np.ndarray, "4 4"]] = {item.name: item.start for item in motion.objects}
    links: dict[str, str | None] = dict.fromkeys(poses)
    for phase in motion.phases:
        q = motion.curve(np.array([phase.first]))[0]
        wanted = _read_links(motion, phase)
        if parts and wanted == links:
            parts.append(parts[-1])
            continue
        held = place_frames(motion.robot, q, [link for link in (*links.values(), *wanted.values()) if link])
        for name, link in wanted.items():
            if link == links[name]:
                continue
            before, after = links[name], link
            world = poses[name] if before is None else held[before] @ poses[name]
            poses[name] = world if after is None else np.linalg.inv(held[after]) @ world
        links = wanted
        placed = [PlacedObject(item, links[item.name], poses[item.name]) for item in motion.objects]
        parts.append(replace(motion, robot=with_objects(motion.robot, placed)))
    return tuple(parts)


def place_frames(robot: RobotModel, q: Float[np.ndarray, "n"], names: list[str]) -> Poses:
    """Return the poses of frames in the world at a configuration."""
    data = borrow_data(robot.model)
    pin.framesForwardKinematics(robot.model, data, q)
    return {name: data.oMf[robot.model.getFrameId(name)].homogeneous.copy() for name in set(names)}


def _read_links(motion: Motion, phase: Phase) -> dict[str, str | None]:
    """Return the link that carries each object during a phase; None for the world.

    Raises:
        VerifyError: an object has not exactly one carrier, or the robot has no such link.
    """
    names = [item.name for item in motion.objects]
    carried = [carrier.item for carrier in phase.carriers]
    if sorted(names) != sorted(carried):
        raise VerifyError(
            f"phase '{phase.name}' says who carries {', '.join(carried) or 'nothing'}; expected each of "
            f"{', '.join(names)} once"
        )
    for carrier in phase.carriers:
        if carrier.link is not None and not motion.robot.model.existFrame(carrier.link):
            raise VerifyError(f"'{carrier.link}', which carries '{carrier.item}' in phase '{phase.name}', is unknown")
    return {carrier.item: carrier.link for carrier in phase.carriers}
