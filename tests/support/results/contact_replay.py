"""Contacts of a result folder measured again with pinocchio and scipy alone: how far they move, where they touch, and
which forces the motion lacks.

Nothing of the product is imported: the motion is read from ``trajectory.csv`` and ``result.json``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

EDGES = 32  # of the pyramid inside each friction cone
STEP_S = 1e-4  # of the differences
N_BASE = 6


@dataclass(frozen=True)
class ContactReplay:
    """A result folder as an outsider reads it.

    Attributes:
        folder: as ``scopt plan`` writes it.
        data: its ``result.json``; a test may edit it.
        table: (M, 1 + k) rows of ``trajectory.csv``: time, base position and quaternion (w, x, y, z), joints.
    """

    folder: Path
    data: dict[str, Any]
    table: Float[np.ndarray, "M k"]

    @staticmethod
    def of(folder: Path) -> ContactReplay:
        """Read a folder."""
        data = json.loads((folder / "result.json").read_text())
        width = 1 + len(data["trajectory"]["joint_names"])  # velocities and accelerations follow
        return ContactReplay(folder, data, np.loadtxt(folder / "trajectory.csv", delimiter=",", skiprows=1)[:, :width])

    @cached_property
    def model(self) -> pin.Model:
        """The robot with a free base, from the folder's URDF."""
        return pin.buildModelFromUrdf(str(self.folder / self.data["robot"]["urdf"]), pin.JointModelFreeFlyer())

    def place(self, row: Float[np.ndarray, "k"]) -> Float[np.ndarray, "nq"]:
        """Return pinocchio's configuration of a row of the table without its time."""
        q = pin.neutral(self.model)
        q[:3], q[3:7] = row[:3], np.roll(row[3:7], -1)
        for name, value in zip(self.data["trajectory"]["joint_names"][7:], row[7:], strict=True):
            q[self.model.joints[self.model.getJointId(name)].idx_q] = value
        return np.asarray(q)

    @cached_property
    def poses(self) -> list[dict[str, pin.SE3]]:
        """Poses of the links that any contact is of in the world, by row of the table."""
        links = {contact["link"] for phase in self.data["phases"] for contact in phase["contacts"]}
        data, frames = self.model.createData(), {link: self.model.getFrameId(link) for link in links}
        found = []
        for row in self.table[:, 1:]:
            pin.framesForwardKinematics(self.model, data, self.place(row))
            found.append({link: data.oMf[frame].copy() for link, frame in frames.items()})
        return found

    @cached_property
    def _planes(self) -> list[Float[np.ndarray, "F 4"]]:
        return [ConvexHull(np.array(piece["vertices"])).equations for piece in self.data["pieces"]]

    def measure_slip(self, phase: dict[str, Any], contact: dict[str, Any]) -> float:
        """Return how far any contact point is from its place at the samples of a phase [m]."""
        points = np.array(contact["sole"])
        own = _pose(contact).inverse()
        local = np.array([own.act(point) for point in points])
        worst = 0.0
        for poses in self.poses[phase["first"] : phase["last"] + 1]:
            pose = poses[contact["link"]]
            worst = max(worst, float(np.abs(local @ pose.rotation.T + pose.translation - points).max()))
        return worst

    def measure_gap(self, contact: dict[str, Any]) -> float:
        """Return the largest distance of a contact point from the surface of the scene, and of its link [m]."""
        points = np.array(contact["sole"])
        pieces = self._planes
        own = _pose(contact).inverse()
        bodies = [body for body in self.data["bodies"] if body["link"] == contact["link"]]
        hulls = [ConvexHull(np.array(body["vertices"])).equations for body in bodies]
        worst = 0.0
        for point in points:
            scene = min(abs(float((plane[:, :3] @ point + plane[:, 3]).max())) for plane in pieces)
            link = min(abs(float((plane[:, :3] @ own.act(point) + plane[:, 3]).max())) for plane in hulls)
            worst = max(worst, scene, link)
        return worst

    def find_missing_force(self, phase: dict[str, Any], time: float) -> float:
        """Return the force that contacts lack at a time, as a share of the weight, with torques within their limits.

        The inverse dynamics come from differences of the curve; forces are edges of pyramids inside the friction cones.
        """
        q, v, a = self._differentiate(time)
        model, data = self.model, self.model.createData()
        wanted = pin.rnea(model, data, q, v, a)
        pin.computeJointJacobians(model, data, q)
        pin.framesForwardKinematics(model, data, q)
        columns, caps = [], []
        for contact in phase["contacts"]:
            friction = np.tan(max(np.arctan(contact["friction"]) - contact["tilt_rad"], 0.0))
            frame = model.getFrameId(contact["link"])
            jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            origin = data.oMf[frame].translation
            for point in np.array(contact["sole"]):
                x, y, z = point - origin
                lever = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
                rows = jacobian[:3] + lever @ jacobian[3:]
                columns.append(rows.T @ _list_edges(np.array(contact["normal"]), friction))
                caps.append(contact["force_cap_n"])
        edges = np.hstack(columns)
        n_edges, weight = edges.shape[1], 9.81 * sum(inertia.mass for inertia in model.inertias[1:])
        # Unknowns: edges, then what is missing of each base row, upwards and downwards.
        slack = np.hstack([np.eye(N_BASE), -np.eye(N_BASE)])
        equal = np.hstack([edges[:N_BASE] * weight, slack * weight])
        limited = np.flatnonzero((model.effortLimit > 0.0) & (model.effortLimit < 1e6))
        limited = limited[limited >= N_BASE]
        lever = edges[limited] * weight
        rows = np.hstack([np.vstack([-lever, lever]), np.zeros((2 * len(limited), 2 * N_BASE))])
        limit = model.effortLimit[limited]
        bounds = np.concatenate([limit - wanted[limited], limit + wanted[limited]])
        cap_rows = np.kron(np.eye(len(caps)), np.ones(EDGES)) * weight
        rows = np.vstack([rows, np.hstack([cap_rows, np.zeros((len(caps), 2 * N_BASE))])])
        bounds = np.append(bounds, caps)
        cost = np.append(np.zeros(n_edges), np.ones(2 * N_BASE))
        found = linprog(cost, rows, bounds, equal, wanted[:N_BASE], (0.0, None), method="highs")
        return float("inf") if found.x is None else float(cost @ found.x)

    def pick_times(self, phase: dict[str, Any], rng: np.random.Generator, count: int) -> Float[np.ndarray, "K"]:
        """Return random times of a phase, not nearer to its ends than the differences reach [s]."""
        first, last = self.table[phase["first"], 0], self.table[phase["last"], 0]
        return np.asarray(rng.uniform(first + 3.0 * STEP_S, last - 3.0 * STEP_S, count))

    def _differentiate(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return configuration, velocity and acceleration by central differences."""
        before, here, after = (self._at(time + offset) for offset in (-STEP_S, 0.0, STEP_S))
        back, ahead = pin.difference(self.model, before, here), pin.difference(self.model, here, after)
        return here, (back + ahead) / (2.0 * STEP_S), (ahead - back) / STEP_S**2

    def _at(self, time: float) -> Float[np.ndarray, "nq"]:
        curve, law = self.data["curve"], self.data["curve"]["law"]
        times, path, speed = (np.array(law[key]) for key in ("times", "path", "speed"))
        i = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
        later = time - times[i]
        gain = (speed[i + 1] - speed[i]) / (times[i + 1] - times[i])
        s = path[i] + speed[i] * later + 0.5 * gain * later**2
        x = CubicHermiteSpline(curve["knots"], np.array(curve["positions"]), np.array(curve["tangents"]))(s)
        turn = Rotation.from_euler("ZYX", x[3:N_BASE]).as_quat(scalar_first=True)
        return self.place(np.concatenate([x[:3], turn, x[N_BASE:]]))


def _pose(contact: dict[str, Any]) -> pin.SE3:
    return pin.XYZQUATToSE3(np.array([*contact["position"], *np.roll(contact["quaternion_wxyz"], -1)]))


def _list_edges(normal: Float[np.ndarray, "3"], friction: float) -> Float[np.ndarray, "3 E"]:
    """Return the edges of a pyramid inside a friction cone, each of unit normal force."""
    u = np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])
    u /= np.linalg.norm(u)
    angles = 2.0 * np.pi * np.arange(EDGES) / EDGES
    sideways = np.outer(u, np.cos(angles)) + np.outer(np.cross(normal, u), np.sin(angles))
    return np.asarray(normal[:, None] + friction * sideways)
