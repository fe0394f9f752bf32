"""What the process that parses a file runs: ``child.py`` as a script, which imports nothing but the readers.

It gets its task as JSON on standard input and leaves its answer in the file that is standard output: one line of JSON,
then the arrays that the line announces.
"""

from __future__ import annotations

import ctypes
import json
import resource
import signal
import sys
from pathlib import Path
from types import ModuleType
from typing import IO, Any

ARRAYS = ("points", "misses", "starts", "miss_starts")


def main() -> None:
    """Do the task on standard input."""
    task = json.load(sys.stdin.buffer)
    with open(sys.stdout.fileno(), "wb", closefd=False) as answer:
        _limit(task["max_bytes"], task["max_cpu_s"], task["max_wall_s"])
        sys.path[:] = task["path"]
        try:
            _write(answer, _parsed(task))
        except MemoryError:
            _write(answer, {"failed": "memory"})


def _limit(max_bytes: int, max_cpu_s: int, max_wall_s: float) -> None:
    """Bound this process, which nobody else may be there to end."""
    limits = {
        resource.RLIMIT_AS: max_bytes,
        resource.RLIMIT_FSIZE: max_bytes,
        resource.RLIMIT_CPU: max_cpu_s,
        resource.RLIMIT_CORE: 0,
    }
    for kind, limit in limits.items():
        _, hardest = resource.getrlimit(kind)  # whoever started us may have set a lower one, which is not ours to raise
        resource.setrlimit(kind, (limit if hardest == resource.RLIM_INFINITY else min(limit, hardest), hardest))
    signal.setitimer(signal.ITIMER_REAL, max_wall_s)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: killed as soon as whoever asked is gone


def _parsed(task: dict[str, Any]) -> dict[str, Any]:
    """The scan as a dictionary, or what is wrong with the file."""
    # The package's own __init__ would import all of perception, which takes longer than most files do.
    package = ModuleType("perception")
    package.__path__ = [str(Path(__file__).parents[1])]
    sys.modules["perception"] = package
    from perception.errors import CloudError
    from perception.files.parse import parse_file

    try:
        scan = parse_file(Path(task["file"]), task["topic"], task["message"])
    except CloudError as error:
        return {"error": str(error)}
    return vars(scan)


def _write(answer: IO[bytes], content: dict[str, Any]) -> None:
    arrays = {key: content.pop(key) for key in ARRAYS if content.get(key) is not None}
    content["arrays"] = {key: array.shape for key, array in arrays.items()}
    answer.write(json.dumps(content).encode() + b"\n")
    for array in arrays.values():
        answer.write(array.astype("<f8", order="C", copy=False).tobytes())


if __name__ == "__main__":
    main()
