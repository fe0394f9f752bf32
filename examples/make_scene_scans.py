"""Simulate the scans of a door and of the inside of a vehicle used by `examples/requests/{door,egress}.yaml`.

Writes ``examples/data/{door,vehicle}_scan.{pcd,json}`` and prints their sizes.  Points are in world coordinates;
VIEWPOINT is the sensor pose, the JSON file holds the true objects. The robot is at the origin and faces +x.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from perception import write_pcd
from perception.simulate.scenes import make_scene

FOLDER = Path(__file__).parent / "data"
SCANS = {"door": "door_left_push_shut", "vehicle": "car_inside"}
REACH_M = 4.0


def main() -> None:
    """Scan both scenes, keep the points in reach, and write two files for each."""
    for name, scene_name in SCANS.items():
        scene = make_scene(scene_name, seed=0)
        points = scene.scan("sparse").points
        near = points[np.linalg.norm(points, axis=1) < REACH_M]
        path = FOLDER / f"{name}_scan.pcd"
        write_pcd(path, np.round(near, 4), scene.poses[0].viewpoint)
        truth = [
            {"kind": one.kind, "pose_world_object": one.pose_world_object.tolist(), "sizes": dict(one.sizes)}
            for one in scene.truth
        ]
        (FOLDER / f"{name}_scan.json").write_text(json.dumps(truth, indent=1) + "\n")
        print(f"{path}: {len(near)} points, {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
