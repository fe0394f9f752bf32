"""Grid of the nearest surface places of a mesh, and a coarse fit of many poses at once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.stopping import poll
from perception.convex.cells import number_cells
from perception.solids.fit import DAMPING, FACING, LEAST_SIZE, MOST_TURN, Surface

_CELLS_ACROSS = 40
_BEYOND = 0.6  # of the object's radius: how far the grid goes beyond the mesh
_BLOCK = 192  # poses at a time


@dataclass(frozen=True)
class NearestField:
    """Nearest place on a mesh, and the normal there, for every cell of a grid around it.

    Attributes:
        places, normals: (X * Y * Z, 3) in the mesh's frame [m].
        shape: number of cells along each axis.
    """

    places: Float[np.ndarray, "C 3"]
    normals: Float[np.ndarray, "C 3"]
    lower: Float[np.ndarray, "3"]
    size: float
    shape: tuple[int, int, int]

    @staticmethod
    def of(
        surface: Surface, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"], radius: float
    ) -> NearestField:
        """Fill the grid about a mesh whose box and radius are given [m]."""
        low, high = lower - _BEYOND * radius, upper + _BEYOND * radius
        size = float((high - low).max()) / _CELLS_ACROSS
        x, y, z = (int(n) for n in np.maximum(np.ceil((high - low) / size), 1))
        centres = (np.stack(np.meshgrid(np.arange(x), np.arange(y), np.arange(z), indexing="ij"), -1) + 0.5) * size
        places, normals = surface.nearest(centres.reshape(-1, 3) + low)
        return NearestField(places, normals, low, size, (x, y, z))

    def fit(
        self,
        rotations: Float[np.ndarray, "B 3 3"],
        shifts: Float[np.ndarray, "B 3"],
        points: Float[np.ndarray, "K 3"],
        start: Float[np.ndarray, "3"],
        gates: Iterable[float],
    ) -> tuple[Float[np.ndarray, "B 3 3"], Float[np.ndarray, "B 3"], Float[np.ndarray, "B"]]:
        """Return the poses after one step of point-to-plane ICP per gate, as ``fit_pose`` takes them one by one.

        The last value is the mean weight of the points before the last step, 0 to 1: how many lie how near.

        Args:
            rotations, shifts: from the mesh's frame to the world.
            start: (3,) mean start of the points' rays [m].
            gates: inlier distance of each step [m].
        """
        rotations, shifts, near = rotations.copy(), shifts.copy(), np.zeros(len(rotations))
        for gate in gates:
            for first in range(0, len(rotations), _BLOCK):
                poll()
                some = slice(first, first + _BLOCK)
                rotations[some], shifts[some], near[some] = self._step(
                    rotations[some], shifts[some], points, start, gate
                )
        return rotations, shifts, near

    def _step(
        self,
        rotations: Float[np.ndarray, "B 3 3"],
        shifts: Float[np.ndarray, "B 3"],
        points: Float[np.ndarray, "K 3"],
        start: Float[np.ndarray, "3"],
        gate: float,
    ) -> tuple[Float[np.ndarray, "B 3 3"], Float[np.ndarray, "B 3"], Float[np.ndarray, "B"]]:
        local = points @ rotations - (shifts[:, None] @ rotations)
        cell, inside = number_cells(local, self.lower, self.size, self.shape)
        place, normal = self.places[cell], self.normals[cell]
        offset = local - place
        square = (offset**2).sum(axis=2)
        sight = ((start - shifts)[:, None] @ rotations) - place
        facing = (normal * sight).sum(axis=2) > FACING * np.sqrt((sight**2).sum(axis=2))
        weight = np.where(inside & facing & (square < gate**2), (1.0 - square / gate**2) ** 2, 0.0)
        total = np.maximum(weight.sum(axis=1), 1e-9)[:, None]
        middle = (weight[:, :, None] * place).sum(axis=1) / total
        arm = place - middle[:, None]
        J = np.concatenate([np.cross(arm, normal), normal], axis=2)
        size = np.maximum((weight * np.sqrt((arm**2).sum(axis=2))).sum(axis=1) / total[:, 0], LEAST_SIZE)
        damping = DAMPING * total * np.column_stack([size**2] * 3 + [np.ones(len(size))] * 3)
        weighted = weight[:, :, None] * J
        A = J.transpose(0, 2, 1) @ weighted
        A[:, np.arange(6), np.arange(6)] += damping + 1e-12
        b = (weighted * (normal * offset).sum(axis=2)[:, :, None]).sum(axis=1)
        step = np.linalg.solve(A, b[:, :, None])[:, :, 0]
        angle = np.linalg.norm(step[:, :3], axis=1)
        turn = step[:, :3] * np.minimum(1.0, MOST_TURN / np.maximum(angle, 1e-12))[:, None]
        turned = Rotation.from_rotvec(turn).as_matrix()
        moved = middle + step[:, 3:] - (turned @ middle[:, :, None])[:, :, 0]
        return rotations @ turned, shifts + (rotations @ moved[:, :, None])[:, :, 0], weight.mean(axis=1)
