"""Arrays of a numpy file as rows: a table, a grid of a depth camera, or one with named columns."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from perception.errors import CloudError
from perception.files.columns import COORDINATES, NO_RETURN, STARTS, missing_coordinate, places, shown

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped

# Wider arrays are pictures: of depth, or with the axis of the coordinates in front.
MOST_OF_GRID, _MOST_COLUMNS = 8, 64


def rows_of(array: Shaped[np.ndarray, "..."], key: str, name: str) -> Float[np.ndarray, "N 3"]:
    """The first three columns of an array (N, 3 or more) or (H, W, 3 or more).

    Raises:
        CloudError: it has another shape, or holds no numbers.
    """
    if array.ndim == 2 and array.shape[0] == len(COORDINATES) < array.shape[1]:
        raise CloudError(
            f"{name}: {named(key)} has shape {array.shape}, which looks turned; save its transpose {array.shape[::-1]}"
        )
    most = MOST_OF_GRID if array.ndim == 3 else _MOST_COLUMNS
    if array.ndim not in (2, 3) or not 3 <= array.shape[-1] <= most or array.dtype.kind not in "fiu":
        raise CloudError(
            f"{name}: {named(key)} is {array.dtype} of shape {array.shape}; numbers (N, 3) or (H, W, 3) are needed"
        )
    return array.reshape(-1, array.shape[-1])[:, :3].astype(np.float64)


def columns_of(
    array: Shaped[np.ndarray, "..."], key: str, name: str
) -> tuple[Float[np.ndarray, "N 3"], dict[str, Shaped[np.ndarray, "..."]]]:
    """Coordinates, and by name what a structured array holds beside them that is read: ``origin``, ``no_return``.

    Raises:
        CloudError: coordinates are missing, or no numbers.
    """
    if array.dtype.names is None:
        return rows_of(array, key, name), {}
    found = places(array.dtype.names)
    if missing := missing_coordinate(found):
        held = shown(", ".join(array.dtype.names))
        raise CloudError(f"{name}: {named(key)} has columns {held}, and no '{missing}'; x, y and z are needed")
    columns = {column: array[array.dtype.names[at]] for column, at in found.items()}
    more: dict[str, Shaped[np.ndarray, "..."]] = {}
    if NO_RETURN in columns:
        more[NO_RETURN] = columns[NO_RETURN]
    if all(axis in columns for axis in STARTS):
        more["origin"] = stacked([columns[axis] for axis in STARTS], key, name)
    return stacked([columns[axis] for axis in COORDINATES], key, name), more


def stacked(columns: list[Shaped[np.ndarray, "..."]], key: str, name: str) -> Float[np.ndarray, "N 3"]:
    """Arrays of x, y and z, of one shape, as rows.

    Raises:
        CloudError: their shapes differ, or they hold no numbers.
    """
    shapes = {column.shape for column in columns}
    if len(shapes) > 1 or any(column.dtype.kind not in "fiu" or column.ndim not in (1, 2) for column in columns):
        held = ", ".join(f"{column.dtype} {column.shape}" for column in columns)
        raise CloudError(f"{name}: {key or 'its'} columns are {held}; numbers, (N,) or (H, W) each, are needed")
    return np.stack([column.ravel().astype(np.float64) for column in columns], axis=1)


def named(key: str) -> str:
    """An array as a sentence names it; ``key`` is empty for the only one of a file."""
    return f"array '{key}'" if key else "array"
