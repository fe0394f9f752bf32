"""Perception of a scene from point clouds: floor, convex pieces, detected objects; and a sensor simulator.

Names that signatures share; all lengths in metres, in the world (z up) unless a docstring names another frame:
    points, starts: end points of rays with a return, and origins of these rays (one for all, or one per point).
    rays: starts and ends of all rays of a scan, including rays on floor and robot and rays without a return.
    index: the same rays, indexed to find the rays that pass near a position.
    view: the scan after cropping, self-filter, floor and outlier removal.
    hint: a point near the object, as an operator would click it.
    axis, direction, normal: unit vectors.
    floor: the floor's plane; nothing lies below it.  ``ground``: its height at the object.
    free: space that rays passed through.
    robot_hulls, soles: vertices of the robot's links, and corners of its planted soles.
    rng, seed: source of the random hypotheses.  ``most_rays``: if there are more rays, every k-th is used.
    name: name of the file or object in error messages.

A name is imported when it is first used: a plan needs perception only where its request has a scan.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from perception.detect import detect

if TYPE_CHECKING:
    from perception.cleaning.clean import Reach, inside_hulls, voxel_downsample
    from perception.cleaning.outliers import inliers
    from perception.cloud import Cloud, make_cloud
    from perception.convex.piece import Evidence, Piece
    from perception.convex.unknown import list_unseen
    from perception.detect import KINDS, detect_at, detect_each, detect_kinds, find_offered
    from perception.detect.door.bodies import door_bodies
    from perception.detect.door.geometry import DoorGeometry, HandleGeometry
    from perception.detect.door.model import choose_opening, read_door
    from perception.detect.seen_parts import count_seen_parts
    from perception.detect.shared.detection import CONFIDENT, Detection
    from perception.detect.shared.overlap import settle_overlaps
    from perception.detect.shared.seen_part import SeenPart
    from perception.detect.valve.bodies import (
        ValveDetection,
        has_clear_spokes,
        rim_bodies,
        select_turnable,
        select_wheels,
        valve_bodies,
        wheel_points,
    )
    from perception.detect.valve.lever_valve import LeverDetection, lever_bodies
    from perception.detect.valve.ring import wheel_basis
    from perception.detect.valve.wheel import detect_valves
    from perception.errors import CloudError, PerceptionError
    from perception.files.formats import SUFFIXES
    from perception.files.npz import write_npz
    from perception.files.pcd import write_pcd
    from perception.files.placing import METRES_BY_UNIT, rigid_pose
    from perception.files.read import read_cloud, read_clouds
    from perception.ground.floor import FloorPlane, find_floor_points, floor_piece, floor_pieces, on_floor, on_floors
    from perception.ground.levels import find_floors
    from perception.memory import Memory
    from perception.perceived import Perceived, perceive
    from perception.solids.match import find_matches
    from perception.updated import Earlier, update
    from perception.view import View, make_view

__all__ = [
    "CONFIDENT",
    "KINDS",
    "METRES_BY_UNIT",
    "SUFFIXES",
    "Cloud",
    "CloudError",
    "Detection",
    "DoorGeometry",
    "Earlier",
    "Evidence",
    "FloorPlane",
    "HandleGeometry",
    "LeverDetection",
    "Memory",
    "Perceived",
    "PerceptionError",
    "Piece",
    "Reach",
    "SeenPart",
    "ValveDetection",
    "View",
    "choose_opening",
    "count_seen_parts",
    "detect",
    "detect_at",
    "detect_each",
    "detect_kinds",
    "detect_valves",
    "door_bodies",
    "find_floor_points",
    "find_floors",
    "find_matches",
    "find_offered",
    "floor_piece",
    "floor_pieces",
    "has_clear_spokes",
    "inliers",
    "inside_hulls",
    "lever_bodies",
    "list_unseen",
    "make_cloud",
    "make_view",
    "on_floor",
    "on_floors",
    "perceive",
    "read_cloud",
    "read_clouds",
    "read_door",
    "rigid_pose",
    "rim_bodies",
    "select_turnable",
    "select_wheels",
    "settle_overlaps",
    "update",
    "valve_bodies",
    "voxel_downsample",
    "wheel_basis",
    "wheel_points",
    "write_npz",
    "write_pcd",
]

_MODULES = {
    "cleaning.clean": ("Reach", "inside_hulls", "voxel_downsample"),
    "cleaning.outliers": ("inliers",),
    "cloud": ("Cloud", "make_cloud"),
    "convex.piece": ("Evidence", "Piece"),
    "convex.unknown": ("list_unseen",),
    "detect": ("KINDS", "detect_at", "detect_each", "detect_kinds", "find_offered"),
    "detect.door.bodies": ("door_bodies",),
    "detect.door.geometry": ("DoorGeometry", "HandleGeometry"),
    "detect.door.model": ("choose_opening", "read_door"),
    "detect.seen_parts": ("count_seen_parts",),
    "detect.shared.detection": ("CONFIDENT", "Detection"),
    "detect.shared.overlap": ("settle_overlaps",),
    "detect.shared.seen_part": ("SeenPart",),
    "detect.valve.bodies": (
        "ValveDetection",
        "has_clear_spokes",
        "rim_bodies",
        "select_turnable",
        "select_wheels",
        "valve_bodies",
        "wheel_points",
    ),
    "detect.valve.lever_valve": ("LeverDetection", "lever_bodies"),
    "detect.valve.ring": ("wheel_basis",),
    "detect.valve.wheel": ("detect_valves",),
    "errors": ("CloudError", "PerceptionError"),
    "files.formats": ("SUFFIXES",),
    "files.npz": ("write_npz",),
    "files.pcd": ("write_pcd",),
    "files.placing": ("METRES_BY_UNIT", "rigid_pose"),
    "files.read": ("read_cloud", "read_clouds"),
    "ground.floor": ("FloorPlane", "find_floor_points", "floor_piece", "floor_pieces", "on_floor", "on_floors"),
    "ground.levels": ("find_floors",),
    "memory": ("Memory",),
    "perceived": ("Perceived", "perceive"),
    "solids.match": ("find_matches",),
    "updated": ("Earlier", "update"),
    "view": ("View", "make_view"),
}


def __dir__() -> list[str]:
    return list(__all__)


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(f"perception.{module}"), name)
    raise AttributeError(f"module 'perception' has no attribute {name!r}")
