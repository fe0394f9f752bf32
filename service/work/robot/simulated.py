"""The robot ``sim``: one in physics, which stays where the plan before has left it."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from service.errors import ExecutionError, RequestError
from service.execution.driver import JointCommand, RobotDriver, RobotReading
from service.execution.reference import PlannedReference
from service.simulation.model import import_mujoco
from service.simulation.options import SimulationOptions
from service.simulation.pictures import VIEWS, CameraPicture, CameraRenderer
from service.simulation.robot import SimulatedRobot
from service.simulation.stand import read_recorded_request, stand_in_physics
from service.work.robot.pictures import PictureServer, Take
from service.work.robot.robot import read_options

# Share of real time (0: as fast as it goes), time between two commands, port of camera pictures (0: none), and the
# options of ``scopt simulate``.
DEFAULTS = {"pace": 1.0, "period_ms": 4.0, "pictures": 0.0, "noise": 0.0, "perturb": 0.0, "seed": 0.0}
_LATE_S = 0.1  # by which a slow machine falls behind before the clock is set anew


class PacedRobot:
    """A simulated robot whose commands take as long as they last; implements ``RobotDriver``."""

    def __init__(self, robot: SimulatedRobot, pace: float) -> None:
        self.robot = robot
        self.joint_names, self.period_s = robot.joint_names, robot.period_s
        self._wait_s = robot.period_s / pace if pace > 0.0 else 0.0
        self._due = time.monotonic()

    def read(self) -> RobotReading:
        """Return what the simulated sensors say."""
        return self.robot.read()

    def command(self, command: JointCommand) -> None:
        """Move the simulation on, and wait for the next command's time."""
        self.robot.command(command)
        now = time.monotonic()
        self._due = max(self._due + self._wait_s, now - _LATE_S)
        if self._due > now:
            time.sleep(self._due - now)


class SimulatedStation:
    """The robot ``sim``. Its world is that of the plan it carries out; only the robot itself lasts.

    Args:
        pace: share of real time; 0 for as fast as it goes.
        steps: of the physics, 1 ms each, per command.
        options: of the physics.
    """

    is_simulated = True

    def __init__(self, pace: float, steps: int, options: SimulationOptions) -> None:
        self._pace, self._steps, self._options = pace, steps, options
        self._robot: SimulatedRobot | None = None
        self._seen: tuple[SimulatedRobot, PlannedReference] | None = None
        self._phase = 0
        self._pictures: PictureServer | None = None

    def drive(self, reference: PlannedReference, folder: Path, is_placed: bool, tolerance: float) -> RobotDriver:
        """Return the robot in the world of a plan: where it stood, or at the plan's start the first time."""
        start = reference.at(0.0).configuration
        if self._robot is not None and not is_placed:
            start = self._stand(self._robot, reference, tolerance)
        request = read_recorded_request(folder)
        self._robot = stand_in_physics(reference, request, self._options, self._steps, start)
        self._seen, self._phase = (self._robot, reference), 0
        return PacedRobot(self._robot, self._pace)

    def serve_pictures(self, port: int) -> None:
        """Serve pictures of the robot's cameras at a port of this machine (RequestError: it is in use)."""
        self._pictures = PictureServer(port, self._make_camera)

    def _make_camera(self) -> Take:
        renderer = CameraRenderer()

        def take(name: str) -> CameraPicture:
            if name not in VIEWS:
                raise KeyError(name)
            if self._seen is None:
                raise ExecutionError("the robot has carried out no plan yet; there is nothing to see")
            robot, reference = self._seen
            return renderer.render(name, robot, reference, min(self._phase, len(reference.phases) - 1))

        return take

    def _stand(self, robot: SimulatedRobot, reference: PlannedReference, tolerance: float) -> np.ndarray:
        """Return the plan's first configuration with the joints and the base of a robot that stands.

        Raises:
            ExecutionError: it has other joints, or its base or a joint is not at the plan's start.
        """
        wanted = reference.at(0.0)
        if set(robot.joint_names) != set(reference.joint_names):
            other = sorted(set(robot.joint_names) ^ set(reference.joint_names))
            raise ExecutionError(f"the robot's joints are not those of the plan: {', '.join(other[:3])}")
        q = dict(zip(robot.joint_names, robot.read().q, strict=True))
        off = {name: abs(q[name] - value) for name, value in zip(reference.joint_names, wanted.q, strict=True)}
        worst = max(off, key=lambda name: off[name])
        if off[worst] > tolerance:
            raise ExecutionError(
                f"the robot is not at the plan's start: {worst} is {q[worst]:.3f}, the plan starts "
                f"{off[worst]:.3f} from there; expected at most {tolerance:g}"
            )
        start = wanted.configuration.copy()
        start[reference.joint_columns] = [q[name] for name in reference.joint_names]
        if wanted.is_floating:
            away = robot.pose_world_base[:3, 3] - wanted.pose_world_base[:3, 3]
            turn = np.arccos(
                np.clip((np.trace(robot.pose_world_base[:3, :3].T @ wanted.pose_world_base[:3, :3]) - 1) / 2, -1.0, 1.0)
            )
            if max(float(np.linalg.norm(away)), float(turn)) > tolerance:
                raise ExecutionError(
                    f"the robot is not at the plan's start: its base is {np.linalg.norm(away):.3f} m and {turn:.3f} "
                    f"rad from there; expected at most {tolerance:g}"
                )
            start[:6] = robot.configuration()[:6]
        return start

    def follow(self, phase: int) -> None:
        """Close and open grippers as the phase has them."""
        self._phase = phase
        if self._robot is not None:
            self._robot.hold_grips(phase)

    def pose_world_base(self) -> Float[np.ndarray, "4 4"] | None:
        """Return the true pose of the base; None before the first plan."""
        return None if self._robot is None else self._robot.pose_world_base

    def close(self) -> None:
        """Forget the robot."""
        self._robot = self._seen = None
        if self._pictures is not None:
            self._pictures.close()


def open_simulated(options: Mapping[str, str]) -> SimulatedStation:
    """Open the robot ``sim`` (RequestError: a wrong option; ResultError: MuJoCo is not installed)."""
    values = read_options("sim", options, DEFAULTS)
    if values["pictures"]:
        os.environ.setdefault("MUJOCO_GL", "egl")  # read as mujoco is imported; there may be no display
    import_mujoco()
    if not 1.0 <= values["period_ms"] <= 20.0 or values["pace"] < 0.0:
        raise RequestError(
            f"--robot sim: period_ms {values['period_ms']:g}, pace {values['pace']:g}; expected 1 to 20, and 0 or more"
        )
    physics = replace(SimulationOptions(), noise=values["noise"], perturb=values["perturb"], seed=int(values["seed"]))
    station = SimulatedStation(values["pace"], round(values["period_ms"]), physics)
    if values["pictures"]:
        if not 1.0 <= values["pictures"] <= 65535.0:
            raise RequestError(f"--robot sim: pictures {values['pictures']:g}; expected a port, 1 to 65535")
        station.serve_pictures(int(values["pictures"]))
    return station
