"""CoACD in a process of its own: bounded in memory and time, killed on request, its crashes told in one line."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from costs.stopping import poll
from perception.errors import MeshError
from perception.solids import child
from perception.solids.cache import Parts
from perception.solids.mesh import Mesh

_OUT_OF_MEMORY = (b"MemoryError", b"bad_alloc", b"failed to map segment", b"Cannot allocate memory")
_LOOK_S = 0.02  # how often a running process is looked after


@dataclass(frozen=True)
class Limits:
    """What the process may use.

    Attributes:
        max_bytes: of address space, libraries included.
        max_s: from start to end [s].
    """

    max_bytes: int = 4 * 2**30
    max_s: float = 120.0


def run_coacd(
    meshes: Sequence[Mesh],
    options: Mapping[str, object],
    limits: Limits,
    name: str = "mesh",
) -> list[Parts]:
    """Convex parts of each mesh as CoACD gives them.

    Args:
        meshes: closed, wound outwards, finite.
        options: keyword arguments of ``coacd.run_coacd``.
        limits: of the process.
        name: what to call the meshes in errors.

    Raises:
        MeshError: it crashed, or needs more memory or time than it may.
        Stopped: it was asked to stop; the process is killed. Asked fifty times a second.
    """
    with tempfile.TemporaryDirectory(prefix="scopt-coacd-") as scratch:
        folder = Path(scratch)
        _ask(folder, meshes, options, limits)
        code, said = _run(folder, limits)
        if code == 0:
            with np.load(folder / child.ANSWER, allow_pickle=False) as answer:
                return [_parts(answer[f"parts_{i}"], answer[f"counts_{i}"]) for i in range(len(meshes))]
    raise MeshError(f"{name}: {_how_it_ended(code, said, limits)}")


def _ask(folder: Path, meshes: Sequence[Mesh], options: Mapping[str, object], limits: Limits) -> None:
    task = {"n_meshes": len(meshes), "options": dict(options), "max_bytes": limits.max_bytes, "max_s": limits.max_s}
    arrays = {f"vertices_{i}": np.ascontiguousarray(mesh.vertices) for i, mesh in enumerate(meshes)}
    arrays |= {f"triangles_{i}": np.ascontiguousarray(mesh.triangles) for i, mesh in enumerate(meshes)}
    np.savez(folder / child.QUESTION, allow_pickle=False, task=np.array(json.dumps(task)), **arrays)


def _run(folder: Path, limits: Limits) -> tuple[int, bytes]:
    """Its exit code, and the end of what it said."""
    complaints = folder / "stderr"
    with complaints.open("wb") as said:
        process = subprocess.Popen(
            [sys.executable, "-P", child.__file__, str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,
        )
        end = time.monotonic() + limits.max_s
        try:
            while process.poll() is None:
                poll()
                if time.monotonic() > end:
                    return -signal.SIGALRM, b""
                try:
                    process.wait(_LOOK_S)
                except subprocess.TimeoutExpired:
                    continue
            return process.returncode, complaints.read_bytes()[-2000:]
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _how_it_ended(code: int, said: bytes, limits: Limits) -> str:
    if code == -signal.SIGALRM:
        return f"splitting into convex parts takes longer than {limits.max_s:g} s; simplify it"
    if any(sign in said for sign in _OUT_OF_MEMORY):
        return f"splitting into convex parts needs more than {limits.max_bytes // 2**20} MB; simplify it"
    how = signal.Signals(-code).name if -code in set(signal.Signals) else f"exit {code}"
    return f"cannot be split into convex parts (CoACD ended with {how}); simplify or repair it"


def _parts(vertices: np.ndarray, counts: np.ndarray) -> Parts:
    return tuple(np.split(vertices, np.cumsum(counts)[:-1]))
