"""The cheapest sequence of poses through a graph of layers (Liu et al., Humanoids 2015, eq. 3 to 5)."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

POINT_WEIGHT = 1e4  # w1 of eq. 3 [1/m^2]
JOINT_WEIGHT = 1e1  # w2 of eq. 3 [1/rad^2]


@dataclass(frozen=True)
class PoseGraph:
    """Poses as nodes, in layers; edges lead from each layer to the next.

    Attributes:
        layer: (M,) of each node.
        pose_cost: (M,) ``C_p``.
        edge_cost: (M, M) ``C_c``; ``inf`` where there is no edge.
    """

    layer: Int[np.ndarray, "M"]
    pose_cost: Float[np.ndarray, "M"]
    edge_cost: Float[np.ndarray, "M M"]

    @property
    def is_last(self) -> Bool[np.ndarray, "M"]:
        """(M,) whether a node is in the last layer."""
        return np.asarray(self.layer == self.layer.max())

    def find_values(self) -> Float[np.ndarray, "M"]:
        """Return the cost from each node to the end, its own included (eq. 4): all nodes at once, until none changes.

        ``inf`` where no path leads to the last layer.
        """
        end = np.where(self.is_last, 0.0, np.inf)
        values = self.pose_cost + end
        for _ in range(int(self.layer.max()) + 1):
            onwards = (self.edge_cost + values).min(axis=1)
            following = self.pose_cost + np.minimum(end, onwards)
            if np.array_equal(following, values):
                break
            values = following
        return values

    def find_sequence(self, without: AbstractSet[tuple[int, int]] = frozenset()) -> tuple[int, ...] | None:
        """Return the cheapest nodes from the first layer to the last (eq. 5); None where no path is left.

        Args:
            without: edges that are not used.
        """
        graph = self
        if without:
            costs = self.edge_cost.copy()
            costs[tuple(np.array(sorted(without)).T)] = np.inf
            graph = PoseGraph(self.layer, self.pose_cost, costs)
        values = graph.find_values()
        first = np.flatnonzero(self.layer == 0)
        if not len(first) or not np.isfinite(values[first]).any():
            return None
        nodes = [int(first[values[first].argmin()])]
        while not self.is_last[nodes[-1]]:
            nodes.append(int((graph.edge_cost[nodes[-1]] + values).argmin()))
        return tuple(nodes)

    def measure_cost(self, nodes: Sequence[int]) -> float:
        """Return the cost of a sequence: its poses and the edges between them."""
        path = np.asarray(nodes)
        return float(self.pose_cost[path].sum() + self.edge_cost[path[:-1], path[1:]].sum())


def measure_connection(
    points: Float[np.ndarray, "A C 3"],
    joints: Float[np.ndarray, "A J"],
    other_points: Float[np.ndarray, "B C 3"],
    other_joints: Float[np.ndarray, "B J"],
) -> Float[np.ndarray, "A B"]:
    """Return the connectivity costs of poses with others (eq. 3).

    Args:
        points, other_points: the same contact points of each pose in the world [m].
        joints, other_joints: joint positions [rad].
    """
    moved = ((points[:, None] - other_points[None]) ** 2).sum(axis=(2, 3))
    turned = ((joints[:, None] - other_joints[None]) ** 2).sum(axis=2)
    return np.asarray(POINT_WEIGHT * moved + JOINT_WEIGHT * turned)
