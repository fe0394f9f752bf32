"""Names that can be told apart: no piece of a scene is called like a link, a body, or a part of what the task moves."""

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

VALVE_JOINT = "valve_turn"
VALVE_LINK = "valve"


@dataclass(frozen=True)
class TakenNames:
    """Names that pieces and carried bodies leave to the robot and to the task's mechanism.

    Attributes:
        owners: who has a name, in words (``a link of atlas``).
        mechanism: link of what the task moves, whose parts are ``LINK/...``; None where it moves nothing.
    """

    owners: Mapping[str, str]
    mechanism: str | None

    @staticmethod
    def of(robot: RobotModel, request: PlanRequest) -> TakenNames:
        """What a robot and the request's task call their own."""
        owners = {body.name: f"a body of {robot.name}" for body in robot.bodies}
        links = [frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY]
        owners |= dict.fromkeys([*links, *(body.link for body in robot.bodies)], f"a link of {robot.name}")
        moves_valve = request.task is not None and request.task.valve is not None
        return TakenNames(owners, VALVE_LINK if moves_valve else None)

    def is_of_mechanism(self, name: str) -> bool:
        """Whether the mechanism, or a part of it, is or could be called so."""
        return self.mechanism is not None and (name == self.mechanism or name.startswith(f"{self.mechanism}/"))

    def owner(self, name: str) -> str:
        """Who has the name, in words; empty where nobody has."""
        if self.is_of_mechanism(name):
            return f"the {self.mechanism} that the task turns, or a part of it"
        return self.owners.get(name, "")


def check_names(request: PlanRequest, robot: RobotModel, taken: TakenNames) -> None:
    """Refuse obstacles, carried bodies and robots whose names would be another's.

    Args:
        request: the request.
        robot: its robot, with what it carries.
        taken: of that robot and the task.

    Raises:
        RequestError: one line for each name that two would have.
    """
    problems = []
    for index, obstacle in enumerate(request.scene.obstacles):
        names = [obstacle.name]
        if isinstance(obstacle, MeshRequest):  # its pieces are numbered
            names += [name for name in taken.owners if _is_numbered(name, obstacle.name)]
        clashes = [name for name in names if taken.owner(name)]
        problems += [f"scene.obstacles[{index}].name: {_is_taken(name, taken)}" for name in clashes[:1]]
    carried = {one.name: index for index, one in enumerate(request.attached)}
    for name in taken.owners:
        if taken.is_of_mechanism(name):
            field = f"attached[{carried[name]}].name" if name in carried else "robot"
            problems.append(f"{field}: {shown(name)} is also {taken.owner(name)}; another name would do")
    if taken.mechanism is not None and (VALVE_JOINT in robot.joint_names or VALVE_JOINT in taken.owners):
        problems.append(f"robot: {shown(VALVE_JOINT)} is also the joint of the valve that the task turns; rename it")
    if problems:
        raise RequestError(problems)


def check_scene_file_names(pieces: Sequence[ConvexPiece], taken: TakenNames) -> None:
    """Refuse pieces of a scene's file that have another's name.

    Raises:
        RequestError: one line for each.
    """
    problems = [f"scene.file: piece {_is_taken(one.name, taken)}" for one in pieces if taken.owner(one.name)]
    if problems:
        raise RequestError(problems)


def rename_clashing(
    pieces: Sequence[ConvexPiece], taken: TakenNames, others: Collection[str] = ()
) -> tuple[tuple[ConvexPiece, ...], tuple[str, ...]]:
    """Pieces that nobody has named yet, with a number behind each name that is another's, and a note about each.

    Args:
        pieces: with names that are unique among themselves.
        taken: by the robot and the task.
        others: further names that are taken.
    """
    used = {*others, *(piece.name for piece in pieces)}
    free, notes = [], []
    for piece in pieces:
        if not taken.owner(piece.name) and piece.name not in others:
            free.append(piece)
            continue
        stem = f"seen/{piece.name}" if taken.is_of_mechanism(piece.name) else piece.name
        numbered = (f"{stem}-{number}" for number in itertools.count(2))
        name = next(one for one in numbered if one not in used and not taken.owner(one))
        used.add(name)
        free.append(replace(piece, name=name))
        owner = taken.owner(piece.name) or "an obstacle of the request"
        notes.append(f"scene: what the scan shows as {shown(piece.name)} is called {shown(name)}: it is {owner}")
    return tuple(free), tuple(notes)


def _is_taken(name: str, taken: TakenNames) -> str:
    return f"{shown(name)} is {taken.owner(name)}; another name would do"


def _is_numbered(name: str, stem: str) -> bool:
    """Whether a name is a stem with a number: ``crate/3``."""
    return name.startswith(f"{stem}/") and name.removeprefix(f"{stem}/").isdecimal()
