"""Pictures of a simulated robot's cameras, with where the plan has hands, feet and the moved object in them."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float, UInt8

from service.execution.reference import PlannedReference
from service.simulation.robot import SimulatedRobot

LIGHT = 0.6  # of the head's own lamp
SIZE = (240, 320)  # height and width [px]
# Eye and what it looks at, from the base and turned with it about the vertical [m]: before the head, and at the knees.
VIEWS: Mapping[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "head": ((0.25, 0.0, 0.75), (0.85, 0.0, 0.15)),
    "feet": ((0.45, 0.0, -0.1), (0.2, 0.0, -0.9)),
}


@dataclass(frozen=True)
class CameraPicture:
    """A picture, and the pixels of what the plan leads.

    Attributes:
        png: the picture.
        marks: (u, v) from the upper left corner by name, as shares of width and height; what is outside is left out.
    """

    png: bytes
    marks: Mapping[str, tuple[float, float]]


class CameraRenderer:
    """Renderer of one thread; it keeps what it made for the robot that it rendered last."""

    def __init__(self) -> None:
        self._model: Any = None
        self._renderer: Any = None
        self._data: Any = None

    def render(self, view: str, robot: SimulatedRobot, reference: PlannedReference, phase: int) -> CameraPicture:
        """Return the picture of a camera of ``VIEWS``, with the places that the plan has at the end of a phase."""
        mujoco, model = robot.mujoco, robot.model
        if self._model is not model:
            self.close()
            self._renderer = mujoco.Renderer(model.mj, *SIZE)
            self._data, self._model = mujoco.MjData(model.mj), model
        self._data.qpos[:] = robot.data.qpos
        mujoco.mj_forward(model.mj, self._data)
        base = robot.pose_world_base
        eye, aim = (_place(base, np.array(point)) for point in VIEWS[view])
        camera = _look(mujoco, eye, aim)
        self._renderer.update_scene(self._data, camera)
        self._renderer.scene.lights[0].ambient[:] = self._renderer.scene.lights[0].diffuse[:] = LIGHT  # the head's own
        pixels = self._renderer.render()
        places = list_planned(reference, phase)
        moved = np.flatnonzero(model.is_mechanism)
        if len(moved):
            places["object"] = self._data.geom_xpos[moved].mean(axis=0)
        marks = project(eye, aim, float(model.mj.vis.global_.fovy), places)
        return CameraPicture(write_png(pixels), marks)

    def close(self) -> None:
        """Give the renderer back."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = self._model = None


def list_planned(reference: PlannedReference, phase: int) -> dict[str, Float[np.ndarray, "3"]]:
    """Return where the plan has feet and hands at the end of a phase [m]."""
    robot = reference.robot
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, reference.at(reference.phases[phase].end_s).configuration)
    links = (link for group in ("feet", "hands") for link in robot.link_groups.get(group, ()))
    return {link: np.array(data.oMf[robot.model.getFrameId(link)].translation) for link in links}


def project(
    eye: Float[np.ndarray, "3"],
    aim: Float[np.ndarray, "3"],
    fovy_deg: float,
    places: Mapping[str, Float[np.ndarray, "3"]],
) -> dict[str, tuple[float, float]]:
    """Return the pixels of places in the picture of an upright camera, as shares of width and height.

    Args:
        eye, aim: of the camera, and what it looks at [m].
        fovy_deg: angle from the lower to the upper edge.
        places: by name [m].
    """
    forward = (aim - eye) / np.linalg.norm(aim - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    half = np.tan(np.deg2rad(0.5 * fovy_deg))
    pixels = {}
    for name, place in places.items():
        x, y, depth = (float(axis @ (place - eye)) for axis in (right, up, forward))
        if depth <= 0.0:
            continue
        u, v = 0.5 + 0.5 * x / depth / half * SIZE[0] / SIZE[1], 0.5 - 0.5 * y / depth / half
        if 0.0 <= u <= 1.0 and 0.0 <= v <= 1.0:
            pixels[name] = (u, v)
    return pixels


def write_png(pixels: UInt8[np.ndarray, "H W 3"]) -> bytes:
    """Return a picture as a PNG file (RFC 2083)."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, _ = pixels.shape
    rows = np.concatenate([np.zeros((height, 1), np.uint8), pixels.reshape(height, -1)], axis=1)  # filter 0: none
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(rows.tobytes(), 6)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def _place(base: Float[np.ndarray, "4 4"], point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return a point that goes with a base and turns with it about the vertical, in the world [m]."""
    yaw = np.arctan2(base[1, 0], base[0, 0])
    turned = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(base[:3, 3] + turned @ point)


def _look(mujoco: Any, eye: Float[np.ndarray, "3"], aim: Float[np.ndarray, "3"]) -> Any:
    camera, along = mujoco.MjvCamera(), aim - eye
    camera.lookat[:] = aim
    camera.distance = float(np.linalg.norm(along))
    camera.azimuth = float(np.rad2deg(np.arctan2(along[1], along[0])))
    camera.elevation = float(np.rad2deg(np.arcsin(along[2] / camera.distance)))
    return camera
