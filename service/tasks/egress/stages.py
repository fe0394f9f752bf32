"""Phases of an egress, resolved against the robot and its surfaces for one drawn place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from costs.robot import RobotModel
from service.demands.contacts.stances import Surface
from service.demands.contacts.surfaces import find_unknown
from service.demands.egress.demand import BEYOND_M, find_toe
from service.errors import RequestError
from service.request.tasks.egress import ContactRequest, PhaseRequest
from service.start.configuration import make_posture
from service.tasks.egress.aims import ContactAim
from service.tasks.egress.poses import Shape


@dataclass(frozen=True)
class EgressStage:
    """A phase with its contacts in the world.

    Attributes:
        name: of the phase.
        aims: its contacts.
        shapes: what its pose should look like, one per nominal pose.
        kept: patches that stay where the stage before has them.
        is_sampled: whether a pose is solved for every drawn place.
    """

    name: str
    aims: tuple[ContactAim, ...]
    shapes: tuple[Shape, ...]
    kept: frozenset[str]
    is_sampled: bool

    @property
    def patches(self) -> tuple[str, ...]:
        """Names of its patches."""
        return tuple(aim.patch for aim in self.aims)


def make_stages(
    robot: RobotModel,
    surfaces: Mapping[str, Surface],
    phases: Sequence[PhaseRequest],
    drawn: Sequence[float] = (0.0, 0.0),
    path: str = "phases",
) -> tuple[EgressStage, ...]:
    """Return the stages for one drawn place.

    Args:
        robot: with contact patches.
        surfaces: by name.
        phases: in their order.
        drawn: place in every region relative to its middle, in units of its lengths.
        path: of the phases in the request, for messages.

    Raises:
        RequestError: an unknown patch, surface, link, joint or posture, two patches of one link in a phase, or two
            phases that share no contact.
    """
    stages: list[EgressStage] = []
    before: dict[str, ContactAim] = {}
    shapes: tuple[Shape, ...] = ()
    for k, phase in enumerate(phases):
        here = f"{path}[{k}]"
        aims, kept = [], set()
        for patch, contact in phase.contacts.items():
            there = f"{here}.contacts.{patch}"
            unknown = find_unknown(robot, surfaces, patch, contact.surface, f"{here}.contacts")
            if unknown is not None:
                raise RequestError(unknown)
            stays = contact.at is None and contact.toe is None and contact.yaw_deg is None
            if stays and patch in before and before[patch].surface.name == contact.surface:
                aims.append(before[patch])
                kept.add(patch)
            else:
                aims.append(_make_aim(robot, patch, contact, surfaces[contact.surface], drawn, there))
        _refuse_shared_links(robot, aims, here)
        if k and not kept:
            raise RequestError(
                f"{here}: '{phase.name}' shares no contact that stays where it is with '{phases[k - 1].name}'"
            )
        shapes = _make_shapes(robot, phase, here) or shapes
        if not shapes:
            raise RequestError(f"{here}.postures: the first phase needs a nominal pose")
        own = tuple(Shape(shape.nominal, phase.weights, phase.sides) for shape in shapes)
        stages.append(EgressStage(phase.name, tuple(aims), own, frozenset(kept), phase.sampled))
        before = {aim.patch: aim for aim in aims}
    return tuple(stages)


def list_lasting(stages: Sequence[EgressStage], k: int, patch: str) -> tuple[int, ...]:
    """Return the stages from ``k`` on in which a patch stays where stage ``k`` has it."""
    last = k
    while last + 1 < len(stages) and patch in stages[last + 1].kept:
        last += 1
    return tuple(range(k, last + 1))


def find_changes(stages: Sequence[EgressStage]) -> tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]:
    """Return the patches that leave and that arrive between each stage and the next."""
    return tuple(
        (
            tuple(patch for patch in before.patches if patch not in after.kept),
            tuple(patch for patch in after.patches if patch not in after.kept),
        )
        for before, after in pairwise(stages)
    )


def _make_aim(
    robot: RobotModel, patch: str, contact: ContactRequest, surface: Surface, drawn: Sequence[float], path: str
) -> ContactAim:
    mark = find_toe(robot.contacts[patch].points) if contact.toe is not None else None
    given = contact.at if contact.toe is None else contact.toe
    yaw = None if contact.yaw_deg is None else float(np.deg2rad(contact.yaw_deg))
    if given is None:
        return ContactAim(patch, surface, yaw_rad=yaw)
    place = np.array(given)
    if contact.region is not None:
        place[:2] += np.array(drawn) * np.array(contact.region)
    beyond = float(surface.measure_outside(place[None])[0])
    if beyond > BEYOND_M and contact.region is None:
        raise RequestError(f"{path}: the place is {beyond:.3f} m beyond the edges of surface '{surface.name}'")
    aim = ContactAim(patch, surface, surface.bring_onto(place), mark, yaw, slack_m=contact.slack_m)
    return aim if contact.region is None else aim.turn_inside(robot)


def _refuse_shared_links(robot: RobotModel, aims: Sequence[ContactAim], path: str) -> None:
    by_link: dict[str, str] = {}
    for aim in aims:
        link = robot.contacts[aim.patch].link
        if link in by_link:
            raise RequestError(f"{path}.contacts: {by_link[link]} and {aim.patch} are both patches of {link}; give one")
        by_link[link] = aim.patch


def _make_shapes(robot: RobotModel, phase: PhaseRequest, path: str) -> tuple[Shape, ...]:
    for i, side in enumerate(phase.sides):
        if not robot.model.existFrame(side.link):
            raise RequestError(f"{path}.sides[{i}].link: unknown link '{side.link}'")
    return tuple(
        Shape(make_posture(robot, posture, f"{path}.postures[{i}]"), phase.weights, phase.sides)
        for i, posture in enumerate(phase.postures)
    )
