"""Mesh files made from a robot's files, kept in the user's cache folder under the hash of their content."""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

import numpy as np
import platformdirs
from jaxtyping import Float

from costs.robot.errors import RobotError

_HEADER = 80  # bytes before the number of triangles


def find_kept_folder() -> Path:
    """Return the folder of kept meshes (``XDG_CACHE_HOME``)."""
    return platformdirs.user_cache_path("scopt") / "meshes"


def keep_triangles(triangles: Float[np.ndarray, "F 3 3"]) -> str:
    """Write triangles as a binary STL, unless it is there; return its name in ``find_kept_folder``.

    Raises:
        RobotError: the folder cannot be written.
    """
    rows = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    rows["corners"] = triangles
    data = b"\0" * _HEADER + np.uint32(len(triangles)).tobytes() + rows.tobytes()
    folder, name = find_kept_folder(), f"{hashlib.sha256(data).hexdigest()[:24]}.stl"
    try:
        if (folder / name).is_file() and (folder / name).read_bytes() == data:
            return name
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        handle, made = tempfile.mkstemp(dir=folder)
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
        Path(made).replace(folder / name)
    except OSError as error:
        raise RobotError(
            f"{folder} cannot be written ({error.strerror or error}); set XDG_CACHE_HOME to a folder that can"
        ) from None
    return name
