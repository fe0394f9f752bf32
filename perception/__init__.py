"""Clouds to a scene: floor, convex pieces, detected objects; and a simulator of the sensor.

Names that signatures share; all lengths in metres, in the world (z up) unless a docstring names another frame:
    points, starts: places that rays met, and where these rays started (one place for all, or one for each).
    rays: starts and ends of all rays of a scan, those of floor and robot and those that met nothing included.
    index: the same rays, indexed to find those that pass a place.
    view: the scan after cropping, self-filter, floor and outliers.
    hint: a point near the object, as an operator would click it.
    axis, direction, normal: unit vectors.
    floor: the floor's plane; nothing lies below it.  ``ground``: its height at the object.
    free: space that rays went through.
    robot_hulls, soles: vertices of the robot's links, and corners of its planted soles.
    rng, seed: of the random hypotheses.  ``most_rays``: of more rays, every k-th is used.
    name: name of the file or object in error messages.
"""

from perception.cleaning.clean import Reach, inside_hulls, voxel_downsample
from perception.cleaning.outliers import inliers
from perception.cloud import Cloud, make_cloud
from perception.convex.piece import Evidence, Piece
from perception.convex.pieces import Pieces, make_pieces
from perception.detect import KINDS, detect, detect_each, detect_kinds
from perception.detect.shared.detection import CONFIDENT, Detection
from perception.detect.valve.bodies import (
    ValveDetection,
    has_clear_spokes,
    rim_bodies,
    select_wheels,
    stem_of,
    valve_bodies,
    wheel_points,
)
from perception.detect.valve.ring import wheel_basis
from perception.detect.valve.wheel import detect_valves
from perception.errors import CloudError, PerceptionError
from perception.files.formats import SUFFIXES
from perception.files.npz import write_npz
from perception.files.pcd import write_pcd
from perception.files.placing import METRES_BY_UNIT, rigid_pose
from perception.files.read import read_cloud, read_clouds
from perception.ground.floor import FloorPlane, floor_piece, floor_pieces, on_floor, on_floors
from perception.ground.levels import find_floors
from perception.limits import MAX_FILE_BYTES, MAX_POINTS
from perception.memory import Memory
from perception.perceive import Perceived, perceive
from perception.update import Earlier, update
from perception.view import View, make_view

__all__ = [
    "CONFIDENT",
    "KINDS",
    "MAX_FILE_BYTES",
    "MAX_POINTS",
    "METRES_BY_UNIT",
    "SUFFIXES",
    "Cloud",
    "CloudError",
    "Detection",
    "Earlier",
    "Evidence",
    "FloorPlane",
    "Memory",
    "Perceived",
    "PerceptionError",
    "Piece",
    "Pieces",
    "Reach",
    "ValveDetection",
    "View",
    "detect",
    "detect_each",
    "detect_kinds",
    "detect_valves",
    "find_floors",
    "floor_piece",
    "floor_pieces",
    "has_clear_spokes",
    "inliers",
    "inside_hulls",
    "make_cloud",
    "make_pieces",
    "make_view",
    "on_floor",
    "on_floors",
    "perceive",
    "read_cloud",
    "read_clouds",
    "rigid_pose",
    "rim_bodies",
    "select_wheels",
    "stem_of",
    "update",
    "valve_bodies",
    "voxel_downsample",
    "wheel_basis",
    "wheel_points",
    "write_npz",
    "write_pcd",
]
