"""Vehicles and disturbances drawn around the shipped egress request, as request data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from costs.robot import BASE_NAMES
from costs.rotation import make_quaternions
from service.demands import compose_scene
from service.demands.egress.demand import SHIPPED_PHASES
from service.request.file import parse_request
from service.setup.world import build_obstacles
from service.start.configuration import make_start_configuration
from service.start.robot import load_requested_robot
from service.tasks.egress.plan import make_all_stages
from service.tasks.egress.poses import PoseSolver

REQUESTS = Path(__file__).resolve().parents[2] / "examples" / "requests"
MODEL = REQUESTS / "egress_model.yaml"
# Of drawn vehicles, from the shipped one: half-widths of what is drawn evenly [m].
BAR_M, PLATFORM_M, SEAT_M, PILLAR_M = 0.015, 0.03, 0.01, 0.03
# Of a study of robustness (after the failures that Liu et al. report).
CHEST_M, BAR_OFF_M, BAR_TURN_DEG, FRICTION, PLATFORM_OFF_M = 0.01, 0.015, 2.0, (0.4, 0.8), 0.03


def load_model() -> dict[str, Any]:
    """Return the shipped request with its phases in it."""
    data = yaml.safe_load(MODEL.read_text())
    data["task"]["egress"]["phases"] = yaml.safe_load(SHIPPED_PHASES.read_text())["phases"]
    return dict(data)


def move_object(
    data: dict[str, Any], name: str, offset: Float[np.ndarray, "3"], turn: Float[np.ndarray, "3"] | None = None
) -> None:
    """Displace an obstacle of request data, and what is placed on it, in place.

    Args:
        data: of a request with ``task.egress`` or ``task.contacts``.
        name: of the obstacle.
        offset: in world axes [m].
        turn: about the obstacle's own place, in world axes [rad].
    """
    own = next(obstacle for obstacle in data["scene"]["obstacles"] if obstacle["name"] == name)
    middle, rotation = np.array(own["position"]), Rotation.from_rotvec(np.zeros(3) if turn is None else turn)

    def move(place: list[float]) -> list[float]:
        moved: list[float] = (rotation.apply(np.array(place) - middle) + middle + offset).tolist()
        return moved

    w, x, y, z = own.get("quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))
    x, y, z, w = (rotation * Rotation.from_quat([x, y, z, w])).as_quat().tolist()
    own["position"], own["quaternion_wxyz"] = move(own["position"]), [w, x, y, z]
    task = data["task"].get("egress") or data["task"]["contacts"]
    surfaces = [k for k, s in task["surfaces"].items() if name == s.get("piece") or name in (s.get("pieces") or ())]
    for surface in surfaces:
        entry = task["surfaces"][surface]
        entry["normal"] = rotation.apply(entry.get("normal") or (0.0, 0.0, 1.0)).tolist()
        if entry.get("corners"):
            entry["corners"] = [move(corner) for corner in entry["corners"]]
    places = [contact for phase in task.get("phases", ()) for contact in phase["contacts"].values()]
    places += [contact for stance in task.get("stances", ()) for contact in stance["make"].values()]
    for contact in places:
        for key in ("at", "toe"):
            if contact["surface"] in surfaces and contact.get(key) is not None:
                contact[key] = move(contact[key])


def draw_car(rng: np.random.Generator) -> dict[str, Any]:
    """Return the shipped request with bar, platform, seat and pillars elsewhere, the robot seated on that seat."""
    data = load_model()
    bar, platform = rng.uniform(-BAR_M, BAR_M, 2), rng.uniform(-PLATFORM_M, PLATFORM_M, 3)
    move_object(data, "wooden_bar", np.array([bar[0], 0.0, bar[1]]))
    move_object(data, "platform", platform * [1.0, 0.5, 1.0])
    move_object(data, "hip_jig", np.array([0.0, 0.0, rng.uniform(-SEAT_M, SEAT_M)]))
    for side in ("right", "left"):
        move_object(data, f"a_pillar_{side}", np.array([rng.uniform(-PILLAR_M, PILLAR_M), 0.0, 0.0]))
    return sit_down(data)


def sit_down(data: dict[str, Any]) -> dict[str, Any]:
    """Return request data whose start is a pose in equilibrium on the contacts of the first phase.

    Raises:
        ValueError: there is no such pose.
    """
    request = parse_request(data, MODEL.parent)
    assert request.task is not None
    assert request.task.egress is not None
    robot = load_requested_robot(request)
    guess = make_start_configuration(robot, request.start)[0]
    scene, _ = compose_scene(request, robot, guess, (), build_obstacles(request)[0])
    stages = make_all_stages(robot, scene, request.task.egress, request.task.egress.phases)[0]
    pose = PoseSolver.of(robot, scene).solve(stages[0].aims, stages[0].shapes[0], guess)
    if not pose.is_feasible:
        raise ValueError(f"no seat: {'; '.join(pose.violations)}")
    n = len(BASE_NAMES)
    data["start"]["joints"] = dict(zip(robot.joint_names[n:], pose.q[n:].tolist(), strict=True))
    data["start"]["base"] = {
        "position": pose.q[:3].tolist(),
        "quaternion_wxyz": make_quaternions(pose.q[None, 3:n])[0].tolist(),
    }
    return data


def disturb(data: dict[str, Any], rng: np.random.Generator) -> dict[str, float]:
    """Displace chest plate, bar and platform of request data and change the friction, in place; return what was drawn.

    The chest plate moves up or down on the torso.  Lengths are in metres, the bar's turn in degrees.
    """
    drawn = {
        "chest_m": rng.uniform(-CHEST_M, CHEST_M),
        "bar_x_m": rng.uniform(-BAR_OFF_M, BAR_OFF_M),
        "bar_z_m": rng.uniform(-BAR_OFF_M, BAR_OFF_M),
        "bar_yaw_deg": rng.uniform(-BAR_TURN_DEG, BAR_TURN_DEG),
        "bar_roll_deg": rng.uniform(-BAR_TURN_DEG, BAR_TURN_DEG),
        "friction": rng.uniform(*FRICTION),
        "platform_z_m": rng.uniform(-PLATFORM_OFF_M, PLATFORM_OFF_M),
    }
    chest = data["robot"]["contacts"]["chest"]
    chest["points"] = [slide_up(data, point, drawn["chest_m"]) for point in chest["points"]]
    turn = np.deg2rad([drawn["bar_roll_deg"], 0.0, drawn["bar_yaw_deg"]])
    move_object(data, "wooden_bar", np.array([drawn["bar_x_m"], 0.0, drawn["bar_z_m"]]), turn)
    move_object(data, "platform", np.array([0.0, 0.0, drawn["platform_z_m"]]))
    for surface in (*data["task"]["contacts"]["surfaces"].values(), *data["robot"]["contacts"].values()):
        surface["friction"] = drawn["friction"]
    return {name: float(value) for name, value in drawn.items()}


def slide_up(data: dict[str, Any], point: list[float], by_m: float) -> list[float]:
    """Return a point on the torso's front moved along its z axis, on its front again."""
    robot = load_requested_robot(parse_request(data, MODEL.parent))
    moved = np.array([0.0, point[1], point[2] + by_m])
    fronts = []
    for body in robot.bodies:
        if body.link == robot.contacts["chest"].link:
            normals, offsets = np.split(ConvexHull(body.vertices).equations, [3], axis=1)
            room, ahead = -(normals @ moved) - offsets[:, 0], normals[:, 0]
            least = (room[ahead < 0.0] / ahead[ahead < 0.0]).max()
            most = (room[ahead > 0.0] / ahead[ahead > 0.0]).min()
            is_beside = bool((room[ahead == 0.0] < 0.0).any())
            fronts += [most] if most >= least and not is_beside else []
    return [float(max(fronts)), float(moved[1]), float(moved[2])]
