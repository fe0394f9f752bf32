"""Pieces of one cloud in a separate process, to measure its peak memory: ``cloud.npz`` to ``pieces.npz``.

Imports nothing of this package or the simulator, whose memory would count as perception's.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from perception import Cloud, Reach, perceive


@dataclass(frozen=True)
class Made:
    """Pieces of a cloud with time and memory.

    Attributes:
        pieces: (V, 3) vertices of each, the floor's included [m].
        wall: from cloud to pieces [s].
        cpu: of all threads and of the processes it started [s].
        memory: peak of the whole process, the interpreter and the cloud included [MB].
    """

    pieces: tuple[Float[np.ndarray, "V 3"], ...]
    wall: float
    cpu: float
    memory: float


def made_of(cloud: Cloud, reach: Reach, folder: Path, method: str = "planes") -> Made:
    """Run the worker on a cloud with an empty cache; write its files to ``folder``."""
    source, target = folder / "cloud.npz", folder / "pieces.npz"
    miss_origin = {} if cloud.miss_origin is None else {"miss_origin": cloud.miss_origin}
    np.savez(source, points=cloud.points, origin=cloud.origin, misses=cloud.misses, **asdict(reach), **miss_origin)
    command = [sys.executable, "-m", "benchmarks.clouds.worker", str(source), str(target), method]
    with tempfile.TemporaryDirectory(dir=folder) as fresh:
        subprocess.run(command, check=True, env={**os.environ, "XDG_CACHE_HOME": fresh})
    with np.load(target) as stored:
        pieces = np.split(stored["vertices"], np.cumsum(stored["counts"])[:-1])
        return Made(tuple(pieces), *(float(x) for x in stored["figures"]))


def _peak() -> float:
    """Return the peak memory of this process since its exec [MB]; getrusage includes the parent's size."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(one for one in status.read_text().splitlines() if one.startswith("VmHWM"))
        return float(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _cpu() -> float:
    """Return the processor time of this process and its finished children [s]."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def main(source: str, target: str, method: Literal["planes", "coacd"]) -> None:
    """Perceive once and store pieces and figures."""
    with np.load(source) as stored:
        given = {key: stored[key] for key in ("points", "origin", "misses", "miss_origin") if key in stored}
        reach = Reach(**{key: float(stored[key]) for key in ("x", "y", "radius", "top", "bottom")})
    cloud = Cloud(**given)
    wall, cpu = time.perf_counter(), _cpu()
    perceived = perceive(cloud, reach=reach, method=method)
    figures = [time.perf_counter() - wall, _cpu() - cpu, _peak()]
    vertices = [piece.vertices for piece in perceived.scene.pieces]
    counts = [len(one) for one in vertices]
    np.savez(target, vertices=np.concatenate([np.zeros((0, 3)), *vertices]), counts=counts, figures=figures)


if __name__ == "__main__":
    main(*sys.argv[1:])  # type: ignore[arg-type]
