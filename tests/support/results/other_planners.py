"""An arm with masses, and motions for it as other planners write them."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

JOINTS = ("base", "shoulder", "elbow", "wrist")
START = np.array([-0.8, -0.3, 1.2, 0.2])
GOAL = np.array([0.8, -0.3, 1.2, -0.4])
POST = {"name": "post", "type": "box", "size": [0.1, 0.1, 0.5], "position": [0.75, 0.0, 0.25]}


def write_arm(folder: Path) -> Path:
    """Path of the URDF of an arm of 0.25, 0.4, 0.35 and 0.15 m: a yaw joint, then three pitch joints."""
    sizes = [(0.25, "0 0 1"), (0.4, "1 0 0"), (0.35, "1 0 0"), (0.15, "1 0 0")]
    links = ['<link name="stand"><collision><origin xyz="0 0 -0.06"/><geometry><box size="0.3 0.3 0.08"/></geometry>'
             "</collision></link>"]  # fmt: skip
    joints = []
    for k, (length, along) in enumerate(sizes):
        axis = np.array([float(value) for value in along.split()])
        centre, size = 0.5 * length * axis, np.where(axis > 0.0, length - 0.02, 0.06)
        mass, inertia = 3.0 - 0.7 * k, 0.02
        links.append(
            f'<link name="part{k}"><inertial><origin xyz="{centre[0]} 0 {centre[2]}"/><mass value="{mass}"/>'
            f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>'
            f'<collision><origin xyz="{centre[0]} 0 {centre[2]}"/><geometry>'
            f'<box size="{size[0]} {size[1]} {size[2]}"/></geometry></collision></link>'
        )
        before = 0.0 if k == 0 else sizes[k - 1][0]
        place = f"0 0 {before}" if k == 1 else f"{before} 0 0"
        joints.append(
            f'<joint name="{JOINTS[k]}" type="revolute"><parent link="{"stand" if k == 0 else f"part{k - 1}"}"/>'
            f'<child link="part{k}"/><origin xyz="{place}"/><axis xyz="{"0 0 1" if k == 0 else "0 1 0"}"/>'
            f'<limit lower="-2.5" upper="2.5" velocity="2.0" effort="{(120, 120, 60, 20)[k]}"/></joint>'
        )
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(links)}{"".join(joints)}</robot>')
    return path


def make_request(folder: Path, **sections: Any) -> dict[str, Any]:
    """A request of the arm: swing from START to GOAL, over or past a post in the middle."""
    return {
        "robot": {"urdf": str(write_arm(folder))},
        "start": {"joints": dict(zip(JOINTS, START.tolist(), strict=True))},
        "goal": {"joints": dict(zip(JOINTS, GOAL.tolist(), strict=True))},
        "scene": {"obstacles": [POST]},
        **sections,
    }


def via_points(lift: float = 0.75) -> np.ndarray:
    """START, a point with the arm folded back above the post, GOAL."""
    middle = np.array([0.0, -0.3 - lift, 1.2 + 0.4 * lift, -0.1])
    return np.stack([START, middle, GOAL])


def ramp_up_and_down(points: np.ndarray, speed: float, gain: float, step: float) -> dict[str, np.ndarray]:
    """Straight lines from rest to rest with trapezoidal speed, as a time-optimal parameterisation of MoveIt gives."""
    times, rows, offset = [0.0], [(points[0], np.zeros(4), np.zeros(4))], 0.0
    for first, last in pairwise(points):
        longest = float(np.abs(last - first).max())
        rise = min(speed / gain, np.sqrt(longest / gain))
        hold = max(longest / (gain * rise) - rise, 0.0)
        total = 2.0 * rise + hold
        for t in np.append(np.arange(step, total - 0.3 * step, step), total):
            left = total - t
            if t < rise:
                s, v, a = 0.5 * gain * t**2, gain * t, gain
            elif left < rise:
                s, v, a = longest - 0.5 * gain * left**2, gain * left, -gain
            else:
                s, v, a = gain * rise * (t - 0.5 * rise), gain * rise, 0.0
            a = 0.0 if left == 0.0 else a
            times.append(offset + t)
            share = (last - first) / longest
            rows.append((first + share * s, share * v, share * a))
        offset += total
    return _stack(np.array(times), rows)


def least_jerk(points: np.ndarray, duration: float, step: float) -> dict[str, np.ndarray]:
    """Quintics from rest to rest through the points, in single precision, as cuRobo gives."""
    times, rows = [0.0], [(points[0], np.zeros(4), np.zeros(4))]
    for k, (first, last) in enumerate(pairwise(points)):
        for t in np.arange(step, duration + 0.5 * step, step) / duration:
            s = t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
            v = 30.0 * t**2 * (1.0 - t) ** 2 / duration
            a = 60.0 * t * (1.0 - 3.0 * t + 2.0 * t**2) / duration**2
            times.append((k + t) * duration)
            rows.append((first + s * (last - first), v * (last - first), a * (last - first)))
    columns = _stack(np.array(times), rows)
    return {name: np.asarray(values, dtype=np.float32).astype(float) for name, values in columns.items()}


def _stack(times: np.ndarray, rows: list[tuple[np.ndarray, ...]]) -> dict[str, np.ndarray]:
    positions, velocities, accelerations = (np.stack(part) for part in zip(*rows, strict=True))
    return {"times": times, "positions": positions, "velocities": velocities, "accelerations": accelerations}


def to_message(columns: dict[str, np.ndarray], names: tuple[str, ...] = JOINTS) -> dict[str, Any]:
    """The JointTrajectory message of columns, as ``ros2 topic echo`` prints it."""
    points = []
    for row, time in enumerate(columns["times"]):
        whole = int(time)
        stamp = {"sec": whole, "nanosec": round(1e9 * (time - whole))}
        kinds = ("positions", "velocities", "accelerations")
        point = {kind: columns[kind][row].tolist() for kind in kinds if kind in columns}
        points.append({**point, "effort": [], "time_from_start": stamp})
    return {"header": {"frame_id": "world"}, "joint_names": list(names), "points": points}
