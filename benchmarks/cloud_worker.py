"""One cloud to pieces in a process of its own, so that its peak memory is its own: ``cloud.npz`` to ``pieces.npz``.

Of this package and of the simulator nothing is imported here: what they need would count as memory of perception.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from perception import Cloud, Reach, perceive


@dataclass(frozen=True)
class Made:
    """What came of a cloud.

    Attributes:
        pieces: (V, 3) vertices of each, the floor's included [m].
        wall: from cloud to pieces [s].
        cpu: of all threads [s].
        memory: peak of the whole process, the interpreter and the cloud included [MB].
    """

    pieces: tuple[Float[np.ndarray, "V 3"], ...]
    wall: float
    cpu: float
    memory: float


def made_of(cloud: Cloud, reach: Reach, folder: Path) -> Made:
    """Run the worker on a cloud; files go to ``folder``."""
    source, target = folder / "cloud.npz", folder / "pieces.npz"
    miss_origin = {} if cloud.miss_origin is None else {"miss_origin": cloud.miss_origin}
    np.savez(source, points=cloud.points, origin=cloud.origin, misses=cloud.misses, **asdict(reach), **miss_origin)
    subprocess.run([sys.executable, "-m", "benchmarks.cloud_worker", str(source), str(target)], check=True)
    with np.load(target) as stored:
        pieces = np.split(stored["vertices"], np.cumsum(stored["counts"])[:-1])
        return Made(tuple(pieces), *(float(x) for x in stored["figures"]))


def _peak() -> float:
    """Of this process since it began its own program; getrusage would tell the size of who started it [MB]."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(one for one in status.read_text().splitlines() if one.startswith("VmHWM"))
        return float(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main(source: str, target: str) -> None:
    """Perceive once and store pieces and figures."""
    with np.load(source) as stored:
        given = {key: stored[key] for key in ("points", "origin", "misses", "miss_origin") if key in stored}
        reach = Reach(**{key: float(stored[key]) for key in ("x", "y", "radius", "top", "bottom")})
    cloud = Cloud(**given)
    wall, cpu = time.perf_counter(), time.process_time()
    perceived = perceive(cloud, reach=reach, valve=False)
    figures = [time.perf_counter() - wall, time.process_time() - cpu, _peak()]
    vertices = [piece.vertices for piece in perceived.scene.pieces]
    counts = [len(one) for one in vertices]
    np.savez(target, vertices=np.concatenate([np.zeros((0, 3)), *vertices]), counts=counts, figures=figures)


if __name__ == "__main__":
    main(*sys.argv[1:])
