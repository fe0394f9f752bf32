"""Places about the start, ranked by geometry alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.scene import ConvexPiece, Scene
from service.demands.hands import Hand
from service.setup.prepare import PlanSetup
from service.start.standing import FLOOR_KIND
from service.tasks.stances.poses import StanceTask, find_shoulder, measure_arm

GRID_M, GRID_YAW = 0.12, np.deg2rad(20.0)  # of the coarse grid
MOST_TURN = np.deg2rad(80.0)  # from facing what is held
IDEAL_REACH = 0.78  # share of the arm's length between shoulder and what is held
MOST_REACH = 1.12  # the same at most: the trunk leans
LEAST_REACH_M = 0.25
TURN_COST = 0.03  # per squared angle between facing and what is held [1/rad^2]
BODY_RADIUS_M = 0.25  # about the base, clear of pieces and leaf before anything else is checked


@dataclass(frozen=True)
class Grid:
    """Places about the start, ranked by geometry.

    Attributes:
        setup: the prepared request.
        task: what is to be done.
        radius_m: of the places about the start.
    """

    setup: PlanSetup
    task: StanceTask
    radius_m: float

    def rank(self, seed: int) -> Float[np.ndarray, "N 3"]:
        """Return the places of a grid, its origin drawn by the seed, the most promising first (x, y, yaw)."""
        rng = np.random.default_rng(seed)
        steps = np.arange(-self.radius_m, self.radius_m + 1e-9, GRID_M)
        shift = rng.uniform(-0.5, 0.5, 2) * GRID_M
        x, y = np.meshgrid(steps + shift[0], steps + shift[1], indexing="ij")
        near = np.hypot(x, y) <= self.radius_m
        places = np.stack([x[near], y[near]], axis=1) + self.setup.start[:2]
        yaws = np.arange(-MOST_TURN, MOST_TURN + 1e-9, GRID_YAW)
        held = np.concatenate([points for way in self.task.list_ways() for _, points in way])
        facing = np.arctan2(*(held.mean(axis=0)[:2] - places).T[::-1])
        poses = np.column_stack(
            [np.repeat(places, len(yaws), axis=0), (facing[:, None] + yaws[None]).ravel()],
        )
        poses = np.concatenate([[self.setup.start[[0, 1, 3]]], poses])
        cost = self.cost(poses)
        order = np.argsort(cost, kind="stable")
        return np.asarray(poses[order[: int(np.isfinite(cost).sum())]])

    def refine(self, parents: Sequence[Float[np.ndarray, "3"]], share: float) -> Float[np.ndarray, "N 3"]:
        """Return the neighbours of places at a share of the grid's steps."""
        offsets = np.array([[dx, dy, 0.0] for dx in (-1, 0, 1) for dy in (-1, 0, 1) if dx or dy])
        offsets = np.concatenate([offsets, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]]) * [GRID_M, GRID_M, GRID_YAW] * share
        poses = np.concatenate([parent + offsets for parent in parents])
        cost = self.cost(poses)
        order = np.argsort(cost, kind="stable")
        return np.asarray(poses[order[: int(np.isfinite(cost).sum())]])

    def cost(self, poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N"]:
        """Return how far the hands' places are from a comfortable distance; infinite where that cannot do."""
        cost = np.full(len(poses), np.inf)
        for way in self.task.list_ways():
            cost = np.minimum(cost, sum(self._cost_of_hand(poses, hand, points) for hand, points in way))
        cost = cost + self.task.rate_places(poses)
        cost[self._is_in_the_way(poses)] = np.inf
        return np.asarray(cost)

    def _cost_of_hand(
        self, poses: Float[np.ndarray, "N 3"], hand: Hand, points: Float[np.ndarray, "P 3"]
    ) -> Float[np.ndarray, "N"]:
        """Return the cost of reaching for points with one hand."""
        start = self.setup.start
        robot = self.setup.robot
        arm = measure_arm(robot, hand, hand.tool)
        shoulder = _turn(find_shoulder(robot, start, hand) - start[:3] * [1.0, 1.0, 0.0], -start[3])
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        at = np.stack(
            [
                poses[:, 0] + cos * shoulder[0] - sin * shoulder[1],
                poses[:, 1] + sin * shoulder[0] + cos * shoulder[1],
                np.full(len(poses), shoulder[2]),
            ],
            axis=1,
        )
        offset = points[None] - at[:, None]
        distance = np.linalg.norm(offset, axis=2)
        ahead = offset[:, :, 0] * cos[:, None] + offset[:, :, 1] * sin[:, None]
        cost = ((distance / arm - IDEAL_REACH) ** 2).mean(axis=1)
        cost += 0.05 * np.clip(0.2 - ahead, 0.0, None).mean(axis=1) + TURN_COST * self._turn_from(poses, points) ** 2
        cost[(distance > MOST_REACH * arm).any(axis=1) | (distance < LEAST_REACH_M).any(axis=1)] = np.inf
        return np.asarray(cost)

    def _turn_from(self, poses: Float[np.ndarray, "N 3"], points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "N"]:
        """Return the angle between where the robot faces and the middle of points [rad]."""
        towards = np.arctan2(*(points.mean(axis=0)[:2] - poses[:, :2]).T[::-1])
        return np.asarray((poses[:, 2] - towards + np.pi) % (2.0 * np.pi) - np.pi)

    def _is_in_the_way(self, poses: Float[np.ndarray, "N 3"]) -> np.ndarray:
        """Return (N,) whether the robot stands in a piece, or where the mechanism moves."""
        start = self.setup.start
        blocked = np.zeros(len(poses), dtype=bool)
        for low, high in _list_boxes(self.setup.scene):
            gap = np.maximum(np.maximum(low - poses[:, :2], poses[:, :2] - high), 0.0)
            blocked |= np.hypot(*gap.T) < BODY_RADIUS_M - 0.1
        soles = np.concatenate(list(self.setup.soles.values()))[:, :2] - start[:2]
        soles = soles @ make_rotation(-start[3]).T
        cos, sin = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
        corners = np.stack(
            [
                poses[:, :1] + cos * soles[None, :, 0] - sin * soles[None, :, 1],
                poses[:, 1:2] + sin * soles[None, :, 0] + cos * soles[None, :, 1],
            ],
            axis=2,
        )
        return np.asarray(blocked | self.task.is_in_the_way(poses, corners, BODY_RADIUS_M))


def is_near(pose: Float[np.ndarray, "3"], other: Float[np.ndarray, "3"], share: float) -> bool:
    """Return whether two places are less than a share of the grid's steps apart."""
    turn = (pose[2] - other[2] + np.pi) % (2.0 * np.pi) - np.pi
    return bool(np.hypot(*(pose - other)[:2]) < share * GRID_M and abs(turn) < share * GRID_YAW)


def _list_boxes(scene: Scene) -> list[tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]]:
    """Return the outlines of the pieces at the height of a body, as boxes seen from above."""

    def is_high(piece: ConvexPiece) -> bool:
        heights = piece.vertices[:, 2]
        return piece.kind != FLOOR_KIND and heights.max() > 0.2 and heights.min() < 1.6

    return [
        (piece.vertices[:, :2].min(axis=0), piece.vertices[:, :2].max(axis=0))
        for piece in scene.pieces
        if is_high(piece)
    ]


def make_rotation(angle: float) -> Float[np.ndarray, "2 2"]:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _turn(point: Float[np.ndarray, "3"], angle: float) -> Float[np.ndarray, "3"]:
    return np.array([*(make_rotation(angle) @ point[:2]), point[2]])
