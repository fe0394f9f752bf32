"""Unique names: no piece of a scene has the name of a link, a body, or a part of the task's mechanism."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import pinocchio as pin

from costs.robot import RobotModel
from costs.scene import ConvexPiece
from service.errors import RequestError, shown
from service.request.scene import MeshRequest
from service.request.schema import PlanRequest


@dataclass(frozen=True)
class TakenNames:
    """Names of the robot and of the task's mechanism, which pieces and carried bodies may not use.

    Attributes:
        owners: description of the owner of each name (``a link of atlas``).
        mechanism: name of the task's mechanism, whose links and parts are ``NAME/...``; None without one.
        joints: names of its joints.
    """

    owners: Mapping[str, str]
    mechanism: str | None
    joints: tuple[str, ...] = ()

    @staticmethod
    def of(robot: RobotModel, request: PlanRequest) -> TakenNames:
        """Collect the names of a robot and of the request's task."""
        owners = {body.name: f"a body of {robot.name}" for body in robot.bodies}
        links = [frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY]
        owners |= dict.fromkeys([*links, *(body.link for body in robot.bodies)], f"a link of {robot.name}")
        moved = request.section.moved_names
        return TakenNames(owners, None) if moved is None else TakenNames(owners, moved.mechanism, moved.joints)

    def is_of_mechanism(self, name: str) -> bool:
        """Return whether the name belongs to the mechanism or to a part of it."""
        return self.mechanism is not None and (name == self.mechanism or name.startswith(f"{self.mechanism}/"))

    def owner(self, name: str) -> str:
        """Return the description of the name's owner; empty if the name is free."""
        if self.is_of_mechanism(name):
            return f"the {self.mechanism} that the task moves, or a part of it"
        return self.owners.get(name, "")


def check_names(request: PlanRequest, robot: RobotModel, taken: TakenNames) -> None:
    """Refuse obstacles, carried bodies and robots with names that are taken.

    Raises:
        RequestError: one line per repeated name.
    """
    problems = []
    for index, obstacle in enumerate(request.scene.obstacles):
        names = [obstacle.name]
        if isinstance(obstacle, MeshRequest):  # its pieces are numbered
            names += [name for name in taken.owners if _is_numbered(name, obstacle.name)]
        clashes = [name for name in names if taken.owner(name)]
        problems += [f"scene.obstacles[{index}].name: {_describe_owner(name, taken)}" for name in clashes[:1]]
    for index, item in enumerate(request.scene.objects):
        if taken.owner(item.name):
            problems.append(f"scene.objects[{index}].name: {_describe_owner(item.name, taken)}")
    carried = {item.name: index for index, item in enumerate(request.attached)}
    for name in taken.owners:
        if taken.is_of_mechanism(name):
            field = f"attached[{carried[name]}].name" if name in carried else "robot"
            problems.append(f"{field}: {shown(name)} is also {taken.owner(name)}; expected another name")
    for joint in taken.joints:
        if joint in robot.joint_names or joint in taken.owners:
            problems.append(
                f"robot: {shown(joint)} is also a joint of the {taken.mechanism} that the task moves; rename it"
            )
    if problems:
        raise RequestError(problems)


def check_scene_file_names(pieces: Sequence[ConvexPiece], taken: TakenNames) -> None:
    """Refuse pieces of a scene file with names that are taken.

    Raises:
        RequestError: one line per piece.
    """
    problems = [
        f"scene.file: piece {_describe_owner(piece.name, taken)}" for piece in pieces if taken.owner(piece.name)
    ]
    if problems:
        raise RequestError(problems)


def rename_clashing(
    pieces: Sequence[ConvexPiece], taken: TakenNames, others: Collection[str] = ()
) -> tuple[tuple[ConvexPiece, ...], tuple[str, ...]]:
    """Return a scan's pieces with taken names replaced by numbered ones, and a note for each new name.

    Args:
        pieces: pieces with unique names.
        taken: names of the robot and the task.
        others: further taken names.
    """
    used = {*others, *(piece.name for piece in pieces)}
    free, notes = [], []
    for piece in pieces:
        if not taken.owner(piece.name) and piece.name not in others:
            free.append(piece)
            continue
        stem = f"seen/{piece.name}" if taken.is_of_mechanism(piece.name) else piece.name
        numbered = (f"{stem}-{number}" for number in itertools.count(2))
        name = next(new for new in numbered if new not in used and not taken.owner(new))
        used.add(name)
        free.append(replace(piece, name=name))
        owner = taken.owner(piece.name) or "an obstacle of the request"
        notes.append(f"scene: what the scan shows as {shown(piece.name)} is called {shown(name)}: it is {owner}")
    return tuple(free), tuple(notes)


def _describe_owner(name: str, taken: TakenNames) -> str:
    return f"{shown(name)} is {taken.owner(name)}; expected another name"


def _is_numbered(name: str, stem: str) -> bool:
    """Return whether a name is a stem with a number: ``crate/3``."""
    return name.startswith(f"{stem}/") and name.removeprefix(f"{stem}/").isdecimal()
