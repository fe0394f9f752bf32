"""What an export needs of a plan: samples with their derivatives, the scene, and the robot's description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES, RobotModel
from service.errors import ResultError
from service.replay.replay import read_record
from service.result.folder import read_result, result_path
from service.result.motion_json import file_positions, sample_rates, sample_times, samples_of
from service.result.result import PlanResult
from service.verify import Motion


@dataclass(frozen=True)
class RecordedPlan:
    """Samples of a plan for other programs.

    Attributes:
        verdict: of the plan.
        robot_name, urdf: of the robot; ``files`` are the meshes that its description names, by their paths in it.
        root_link: link that a floating base moves.
        joint_names: columns of the arrays: joints of the robot, then those of a mechanism that the task moves.
        times: (S,) [s]; path parameters where the motion is untimed.
        positions, velocities, accelerations: (S, j) [rad, m; per s; per s^2]; derivatives are 0 where untimed.
        base: (S, 7) position and quaternion (w, x, y, z) of a floating base; None for a fixed one.
        base_velocities: (S, 6) of base_x, base_y, base_z, base_yaw, base_pitch, base_roll; None for a fixed base.
        pieces: kind and (V, 3) vertices of each piece of the scene [m].
    """

    verdict: str
    robot_name: str
    urdf: str
    files: Mapping[str, Path]
    root_link: str
    joint_names: tuple[str, ...]
    times: Float[np.ndarray, "S"]
    positions: Float[np.ndarray, "S j"]
    velocities: Float[np.ndarray, "S j"]
    accelerations: Float[np.ndarray, "S j"]
    base: Float[np.ndarray, "S 7"] | None
    base_velocities: Float[np.ndarray, "S 6"] | None
    pieces: Mapping[str, tuple[str, Float[np.ndarray, "V 3"]]]
    is_timed: bool

    @staticmethod
    def of(source: PlanResult | str | Path) -> RecordedPlan:
        """Take a result, or read its folder.

        Raises:
            ResultError: the folder cannot be read, or there is no motion.
        """
        if isinstance(source, PlanResult):
            if source.motion is None:
                raise ResultError(f"the result has no motion to export; its verdict is {source.verdict.value}")
            return _record(source.motion, source.robot, source.verdict.value)
        data = read_result(source)
        robot, motion = read_record(data, result_path(source).parent)
        return _record(motion, robot, str(data["verdict"]))


def _record(motion: Motion, robot: RobotModel, verdict: str) -> RecordedPlan:
    q, first = motion.curve(samples_of(motion)), len(BASE_NAMES) if robot.is_floating else 0
    rates = sample_rates(motion)
    v, a = (np.zeros_like(q), np.zeros_like(q)) if rates is None else rates
    is_floating = robot.is_floating
    return RecordedPlan(
        verdict=verdict,
        robot_name=robot.name,
        urdf=robot.source.urdf,
        files=dict(robot.source.files),
        root_link=_find_root_link(robot),
        joint_names=motion.robot.joint_names[first:],
        times=sample_times(motion),
        positions=q[:, first:],
        velocities=v[:, first:],
        accelerations=a[:, first:],
        base=file_positions(robot, q[:, : robot.n])[:, :7] if is_floating else None,
        base_velocities=v[:, :first] if is_floating else None,
        pieces={piece.name: (piece.kind, piece.vertices) for piece in motion.scene.pieces},
        is_timed=motion.law is not None,
    )


def _find_root_link(robot: RobotModel) -> str:
    """Return the link that no joint of the description holds."""
    from lxml import etree

    root = etree.fromstring(robot.source.urdf.encode(), etree.XMLParser(resolve_entities=False, no_network=True))
    children = {child.get("link") for child in root.iterfind("joint/child")}
    links = [str(link.get("name")) for link in root.iterfind("link")]
    return next((link for link in links if link not in children), links[0] if links else "base_link")
