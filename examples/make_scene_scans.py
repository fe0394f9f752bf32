"""Simulate the scans of a door and of the vehicle of `examples/requests/{door,egress}.yaml`.

Writes ``examples/data/{door,vehicle}_scan.{pcd,json}`` and prints their sizes.  Points are in world coordinates;
VIEWPOINT is the sensor pose, the JSON file holds the true objects. The robot is at the origin and faces +x; in the
vehicle it sits, and the sensor is at its head.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from make_valve_scan import SENSOR, link_hulls

from perception import inside_hulls, write_pcd
from perception.simulate import Pose, Room, Scanner, scan
from perception.simulate.scenes.doors import Door
from perception.simulate.scenes.scene import Truth
from perception.solids.primitives import box, hull
from service.request.file import load_request
from service.setup.world import build_obstacles
from service.start.configuration import make_start_configuration
from service.start.robot import load_requested_robot
from service.start.standing import place_bodies

FOLDER = Path(__file__).parent / "data"
# The free edge is to the right of the robot, which stands at arm's length from the lever.
DOOR = Door(hinge=(0.7, 0.47), side="push", lever_length=0.13)
ROOM = Room(wall_x=None, boxes=(((-0.2, 0.9, 0.0), (0.25, 1.3, 0.45)), ((-0.6, -1.5, 0.0), (-0.1, -1.1, 0.7))))
REACH_M = 4.0
SEATED = Pose((0.13, 0.0, 1.85), pitch=0.4)  # the sensor of the seated robot


def main() -> None:
    """Scan both scenes, keep the points in reach, and write two files for each."""
    placed = DOOR.build()
    cloud = scan([*ROOM.meshes(link_hulls("reach_ready")), *placed.meshes], SENSOR, Scanner(n_lines=84), seed=7)
    write("door", cloud.points, SENSOR.viewpoint, placed.truth)
    scan_vehicle()


def scan_vehicle() -> None:
    """Scan the obstacles of the egress request from the head of the seated robot, which sees itself."""
    request = load_request(FOLDER.parent / "requests" / "egress_model.yaml")
    robot = load_requested_robot(request)
    start = make_start_configuration(robot, request.start)[0]
    pieces, _ = build_obstacles(request)
    around = [hull(piece.vertices) for piece in pieces]
    sensor = np.array([SEATED.position])
    bodies = [vertices for _, vertices in place_bodies(robot, start)]
    body = [hull(vertices) for vertices in bodies if not inside_hulls(sensor, [vertices], margin=0.1).any()]
    ground = box((-4.0, -4.0, -0.1), (4.0, 4.0, 0.0))
    cloud = scan([ground, *around, *body], SEATED, Scanner(n_lines=84), seed=7)
    near = np.round(cloud.points[np.linalg.norm(cloud.points, axis=1) < REACH_M], 4)
    path = FOLDER / "vehicle_scan.pcd"
    write_pcd(path, near, SEATED.viewpoint)
    boxes = {piece.name: [piece.lower.tolist(), piece.upper.tolist()] for piece in pieces}
    (FOLDER / "vehicle_scan.json").write_text(json.dumps({"boxes_around_pieces": boxes}, indent=1) + "\n")
    print(f"{path}: {len(near)} points, {path.stat().st_size} bytes")


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
