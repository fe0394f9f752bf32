"""Pinocchio's work space, one per thread and model: making it takes longer than a hundred evaluations."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

MOST_KEPT = 4  # models per thread


@dataclass(frozen=True)
class WorkSpace:
    """Work space of a model.

    Attributes:
        model: keeps the identity by which the work space is found.
        data: of pinocchio.
        placements: (J, 12) live view of all joint placements: rotation (column by column) and translation of each.
    """

    model: pin.Model
    data: pin.Data
    placements: Float[np.ndarray, "J 12"]


class _Kept(threading.local):
    def __init__(self) -> None:
        self.of_model: dict[int, WorkSpace] = {}


_KEPT = _Kept()


def borrow_work_space(model: pin.Model) -> WorkSpace:
    """Return the work space of a model that is not changed any more.

    Whoever borrows it next overwrites it: read the results before another function that may borrow it is called.
    """
    kept = _KEPT.of_model
    known = kept.pop(id(model), None)
    if known is None:
        known = make_work_space(model)
        if len(kept) == MOST_KEPT:
            kept.pop(next(iter(kept)))
    kept[id(model)] = known  # the last one used is the last one dropped
    return known


def make_work_space(model: pin.Model) -> WorkSpace:
    """Make a work space that nobody else overwrites."""
    data = model.createData()
    return WorkSpace(model, data, _view_placements(data, model.njoints))


def borrow_data(model: pin.Model) -> pin.Data:
    """Return pinocchio's data of ``borrow_work_space``."""
    return borrow_work_space(model).data


def _view_placements(data: pin.Data, n_joints: int) -> Float[np.ndarray, "J 12"]:
    """Return a live view of all joint placements.

    ``data.oMi`` is contiguous; reading it element by element costs ten times the kinematics themselves.
    """
    first = data.oMi[0].rotation
    if n_joints > 1:
        second = data.oMi[1].rotation
        stride = second.__array_interface__["data"][0] - first.__array_interface__["data"][0]
    else:
        stride = 96
    if stride % 8 or stride < 96:
        raise RuntimeError(f"pinocchio's placements are not laid out as expected (stride {stride} bytes)")
    address = first.__array_interface__["data"][0]
    return np.ndarray((n_joints, 12), buffer=_Memory(address, stride * n_joints).view, strides=(stride, 8))


class _Memory:
    """A read-only buffer over memory owned by pinocchio's data, which the work space keeps alive."""

    def __init__(self, address: int, size: int) -> None:
        interface = {"shape": (size // 8,), "typestr": "<f8", "data": (address, True), "version": 3}
        self.__array_interface__ = interface

    @property
    def view(self) -> np.ndarray:
        return np.asarray(self)
