"""Simulate the bundled scan: a wheel valve in front of a wall, a pipe, a box, and the arms of Atlas in view.

Writes ``examples/data/valve_scan.{pcd,json}`` and prints the size.  Points are in world coordinates, VIEWPOINT is the
sensor pose, the JSON file holds the true valve. Atlas stands at the origin (posture ``reach_ready``) facing +x.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin

from costs import load_robot
from perception import inside_hulls, write_pcd
from perception.simulate import Pose, Room, Scanner, Valve, scan

FOLDER = Path(__file__).parent / "data"
VALVE = Valve(centre=(0.68, 0.12, 1.1), spin=0.4, stem_length=0.2)
ROOM = Room(
    wall_x=0.88,
    pipes=((0.8, 0.55, 0.045),),
    boxes=(((0.55, -0.95, 0.0), (0.85, -0.55, 0.4)),),
)
SENSOR = Pose((0.12, 0.0, 1.6), pitch=0.3)
LARGEST = 1_000_000


def link_hulls(posture: str) -> list[np.ndarray]:
    """Return the vertices of the bodies of Atlas in the world, without the head around the sensor."""
    robot = load_robot("atlas")
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.postures[posture])
    hulls = []
    for body in robot.bodies:
        placement = data.oMi[body.joint]
        hulls.append(body.vertices @ placement.rotation.T + placement.translation)
    sensor = np.array([SENSOR.position])
    return [hull for hull in hulls if not inside_hulls(sensor, [hull], margin=0.1).any()]


def main() -> None:
    """Scan, keep the points within 5 m, and write both files."""
    hulls = link_hulls("reach_ready")
    cloud = scan(ROOM.meshes(hulls) + VALVE.meshes(), SENSOR, Scanner(n_lines=84), seed=7)
    near = cloud.points[np.linalg.norm(cloud.points, axis=1) < 5.0]
    FOLDER.mkdir(exist_ok=True)
    path = FOLDER / "valve_scan.pcd"
    # A tenth of a millimetre is far below the noise and packs better than full floats.
    write_pcd(path, np.round(near, 4), SENSOR.viewpoint)
    size = path.stat().st_size
    if size > LARGEST:
        raise SystemExit(f"{path}: {size} bytes; at most {LARGEST} may ship")
    truth = {"valve": VALVE.truth(), "wall_x": ROOM.wall_x, "pipes": ROOM.pipes, "boxes": ROOM.boxes}
    truth["sensor"] = {"viewpoint": SENSOR.viewpoint, "sigma": Scanner().sigma}
    (FOLDER / "valve_scan.json").write_text(json.dumps(truth, indent=1) + "\n")
    print(f"{path}: {len(near)} points, {size} bytes")


if __name__ == "__main__":
    main()
