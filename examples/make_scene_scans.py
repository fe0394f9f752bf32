"""Simulate the scans of a door and of the inside of a vehicle used by `examples/requests/{door,egress}.yaml`.

Writes ``examples/data/{door,vehicle}_scan.{pcd,json}`` and prints their sizes.  Points are in world coordinates;
VIEWPOINT is the sensor pose, the JSON file holds the true objects. The robot is at the origin and faces +x.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from make_valve_scan import SENSOR, link_hulls

from perception import write_pcd
from perception.simulate import Room, Scanner, scan
from perception.simulate.scenes import make_scene
from perception.simulate.scenes.doors import Door
from perception.simulate.scenes.scene import Truth

FOLDER = Path(__file__).parent / "data"
# The free edge is to the right of the robot, which stands at arm's length from the lever.
DOOR = Door(hinge=(0.7, 0.47), side="push", lever_length=0.13)
ROOM = Room(wall_x=None, boxes=(((-0.2, 0.9, 0.0), (0.25, 1.3, 0.45)), ((-0.6, -1.5, 0.0), (-0.1, -1.1, 0.7))))
REACH_M = 4.0


def main() -> None:
    """Scan both scenes, keep the points in reach, and write two files for each."""
    placed = DOOR.build()
    cloud = scan([*ROOM.meshes(link_hulls("reach_ready")), *placed.meshes], SENSOR, Scanner(n_lines=84), seed=7)
    write("door", cloud.points, SENSOR.viewpoint, placed.truth)
    scene = make_scene("car_inside", seed=0)
    write("vehicle", scene.scan("sparse").points, scene.poses[0].viewpoint, scene.truth)


def write(name: str, points: np.ndarray, viewpoint: tuple[float, ...], truth: Sequence[Truth]) -> None:
    """Write a scan and its true objects."""
    near = points[np.linalg.norm(points, axis=1) < REACH_M]
    path = FOLDER / f"{name}_scan.pcd"
    write_pcd(path, np.round(near, 4), viewpoint)
    objects = [
        {"kind": one.kind, "pose_world_object": one.pose_world_object.tolist(), "sizes": dict(one.sizes)}
        for one in truth
    ]
    (FOLDER / f"{name}_scan.json").write_text(json.dumps(objects, indent=1) + "\n")
    print(f"{path}: {len(near)} points, {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
