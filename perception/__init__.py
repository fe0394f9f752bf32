"""Clouds in, a world out: floor, convex pieces, detected valves, and a simulator of the sensor."""

from perception.clean import Reach, inliers, inside_hulls, voxel_downsample
from perception.cloud import MAX_FILE_BYTES, MAX_POINTS, Cloud, make_cloud
from perception.errors import CloudError, PerceptionError
from perception.floor import FloorPlane, find_floor, floor_piece, on_floor
from perception.pcd import write_pcd
from perception.perceive import CONFIDENT, Perceived, perceive
from perception.pieces import Pieces, make_pieces
from perception.read import SUFFIXES, read_cloud
from perception.valve import ValveDetection, detect_valves
from perception.valve_bodies import has_clear_spokes, stem_of, valve_bodies, wheel_points
from perception.wheel import wheel_basis

__all__ = [
    "CONFIDENT",
    "MAX_FILE_BYTES",
    "MAX_POINTS",
    "SUFFIXES",
    "Cloud",
    "CloudError",
    "FloorPlane",
    "Perceived",
    "PerceptionError",
    "Pieces",
    "Reach",
    "ValveDetection",
    "detect_valves",
    "find_floor",
    "floor_piece",
    "has_clear_spokes",
    "inliers",
    "inside_hulls",
    "make_cloud",
    "make_pieces",
    "on_floor",
    "perceive",
    "read_cloud",
    "stem_of",
    "valve_bodies",
    "voxel_downsample",
    "wheel_basis",
    "wheel_points",
    "write_pcd",
]
