"""Calls of ``bounds.c``, which computes what ``pair_poses`` does with numpy."""

from __future__ import annotations

import ctypes

import numpy as np
from jaxtyping import Float, Int

from costs.native import HullSet, call
from service.verify.clearance.pairs import PairTable
from service.verify.curves.bounds import RateBounds
from service.verify.joint_chain import JointChain
from service.verify.prepared_motion import Placements


def place_pairs(
    library: ctypes.CDLL,
    placed: Placements,
    pose: Int[np.ndarray, "E 3"],
    held: Int[np.ndarray, "E"],
    moved: Int[np.ndarray, "E"],
) -> tuple[Float[np.ndarray, "E 3 3 3"], Float[np.ndarray, "E 3 3"]]:
    """Return rotations and translations of joints ``moved`` in the frames of joints ``held``."""
    n = len(pose)
    rotation, translation = np.empty((n, 3, 3, 3)), np.empty((n, 3, 3))
    call(
        library.scopt_place_pairs,
        n,
        placed.rotation.shape[1],
        np.ascontiguousarray(placed.rotation),
        np.ascontiguousarray(placed.translation),
        np.ascontiguousarray(pose),
        np.ascontiguousarray(held),
        np.ascontiguousarray(moved),
        rotation,
        translation,
    )
    return rotation, translation


def bound_deviation(
    library: ctypes.CDLL,
    table: PairTable,
    mover: Int[np.ndarray, "E"],
    chains: JointChain,
    chain: Int[np.ndarray, "E"],
    over: RateBounds,
    interval: Int[np.ndarray, "E"],
    placed: Placements,
    middle: Int[np.ndarray, "E"],
    rounding: float,
) -> Float[np.ndarray, "E"]:
    """Bound the distance of a mover from its chords [m]."""
    bound = np.empty(len(mover))
    call(
        library.scopt_bound_deviation,
        len(mover),
        placed.rotation.shape[1],
        np.ascontiguousarray(placed.rotation),
        np.ascontiguousarray(placed.translation),
        np.ascontiguousarray(middle),
        np.ascontiguousarray(table.joint[mover]),
        np.ascontiguousarray(table.centre[mover]),
        np.ascontiguousarray(table.radius[mover]),
        *chains.coordinates.shape,
        np.ascontiguousarray(chain),
        chains.coordinates,
        chains.joints,
        chains.is_revolute,
        chains.reach,
        chains.base_rotations,
        chains.ratio,
        np.ascontiguousarray(interval),
        over.speed.shape[1],
        np.ascontiguousarray(over.length),
        np.ascontiguousarray(over.speed),
        np.ascontiguousarray(over.bend),
        np.ascontiguousarray(over.step),
        np.ascontiguousarray(over.step_speed),
        np.ascontiguousarray(over.step_bend),
        rounding,
        np.empty((2, chains.coordinates.shape[1])),
        bound,
    )
    return bound


def separate(
    library: ctypes.CDLL,
    hulls: HullSet,
    mover: Int[np.ndarray, "E"],
    holder: Int[np.ndarray, "E"],
    rotation: Float[np.ndarray, "E 3 3 3"],
    translation: Float[np.ndarray, "E 3 3"],
    rows: Int[np.ndarray, "R"],
    direction: Float[np.ndarray, "R 3"],
) -> Float[np.ndarray, "R"]:
    """Return a lower bound of the distance between a mover's hull at both ends and its holder along a direction [m]."""
    separation = np.empty(len(rows))
    call(
        library.scopt_separate,
        len(rows),
        np.ascontiguousarray(rows),
        hulls.points,
        hulls.first,
        np.ascontiguousarray(mover),
        np.ascontiguousarray(holder),
        rotation,
        translation,
        np.ascontiguousarray(direction),
        separation,
    )
    return separation
