"""A lidar simulator: meshes, a spinning line scanner, and valve scenes with their truth."""

from perception.simulate.mesh import Mesh, box, cylinder, hull, joined, torus
from perception.simulate.scanner import Pose, Scanner, cast, scan
from perception.simulate.valve_scene import Room, Valve

__all__ = [
    "Mesh",
    "Pose",
    "Room",
    "Scanner",
    "Valve",
    "box",
    "cast",
    "cylinder",
    "hull",
    "joined",
    "scan",
    "torus",
]
