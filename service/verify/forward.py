"""Forward kinematics of many configurations, straight from pinocchio."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.stopping import poll
from service.verify.errors import VerifyError


@dataclass(frozen=True)
class Placements:
    """Joint frames in the world at ``S`` configurations.

    Attributes:
        rotation: (S, J, 3, 3) rotation_world_joint.
        translation: (S, J, 3) joint origins [m].
    """

    rotation: Float[np.ndarray, "S J 3 3"]
    translation: Float[np.ndarray, "S J 3"]

    def relative(
        self, holder: int, mover: int, rows: np.ndarray | slice | int = slice(None)
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (S, 3, 3) and translation (S, 3) of joint ``mover`` in the frame of joint ``holder``."""
        rotation, translation = self.rotation[rows, mover], self.translation[rows, mover]
        if holder == 0:
            return rotation, translation
        transposed = np.swapaxes(self.rotation[rows, holder], -1, -2)
        offset = translation - self.translation[rows, holder]
        return transposed @ rotation, (transposed @ offset[..., None])[..., 0]


class Forward:
    """Forward kinematics with the memory it reuses."""

    def __init__(self, model: pin.Model) -> None:
        """Prepare for configurations of this model.

        Raises:
            VerifyError: when pinocchio keeps its placements in another way than they are read here.
        """
        self._model = model
        self._data = model.createData()
        # pinocchio keeps the placements side by side (12 doubles each, rotation column by column):
        # one strided view reads them all at once, hundreds of times faster than element by element.
        first = self._data.oMi[0].rotation
        block = first.T.reshape(-1)
        self._view = np.lib.stride_tricks.as_strided(block, shape=(model.njoints, 12), strides=(96, 8))
        if not np.shares_memory(self._view, first):
            raise VerifyError("pinocchio's joint placements cannot be read as one block")

    def at(self, configurations: Float[np.ndarray, "S n"]) -> Placements:
        """Joint placements at every configuration.

        Raises:
            VerifyError: when a configuration is not finite or has the wrong length.
        """
        q, model, data, view = np.ascontiguousarray(configurations, dtype=float), self._model, self._data, self._view
        if q.ndim != 2 or q.shape[1] != model.nq or not np.all(np.isfinite(q)):
            raise VerifyError(f"configurations must be finite and have {model.nq} columns, got shape {q.shape}")
        block = np.empty((len(q), model.njoints, 12))
        for row, configuration in zip(block, q, strict=True):
            poll()
            pin.forwardKinematics(model, data, configuration)
            row[:] = view
        rotation = np.swapaxes(block[..., :9].reshape(len(q), model.njoints, 3, 3), -1, -2)
        return Placements(np.ascontiguousarray(rotation), np.ascontiguousarray(block[..., 9:]))
