"""Sensor simulator: meshes, simulated sensors, and scenes with ground truth."""

from perception.simulate.cast import Caster, cast
from perception.simulate.sensor import DepthCamera, Pose, Scanner, Sensor, SolidState, TimeOfFlight, scan
from perception.simulate.valve_scene import Room, Valve
from perception.solids.primitives import Mesh, bent_bar, box, capsule, cylinder, hull, join_meshes, lathe, pipe, torus

__all__ = [
    "Caster",
    "DepthCamera",
    "Mesh",
    "Pose",
    "Room",
    "Scanner",
    "Sensor",
    "SolidState",
    "TimeOfFlight",
    "Valve",
    "bent_bar",
    "box",
    "capsule",
    "cast",
    "cylinder",
    "hull",
    "join_meshes",
    "lathe",
    "pipe",
    "scan",
    "torus",
]
