"""What the process that splits meshes runs: a script that imports numpy and CoACD, and may crash alone.

Its one argument is a folder.  ``question.npz`` there holds ``vertices_i`` and ``triangles_i`` of each mesh, and
``task``, JSON of limits and options.  It leaves ``answer.npz``: for each mesh ``parts_i``, the vertices of all parts,
and ``counts_i``, how many each part has.
"""

from __future__ import annotations

import ctypes
import json
import resource
import signal
import sys
from pathlib import Path

import numpy as np

QUESTION = "question.npz"
ANSWER = "answer.npz"


def main(folder: Path) -> None:
    """Answer the question in the folder."""
    with np.load(folder / QUESTION, allow_pickle=False) as content:
        task = json.loads(str(content["task"]))
        meshes = [(content[f"vertices_{i}"], content[f"triangles_{i}"]) for i in range(task["n_meshes"])]
    resource.setrlimit(resource.RLIMIT_AS, (task["max_bytes"], task["max_bytes"]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # The one who started this process may be gone before it ends.
    signal.setitimer(signal.ITIMER_REAL, task["max_s"])
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: or even sooner
    import coacd

    coacd.set_log_level("off")
    answer = {}
    for i, (vertices, triangles) in enumerate(meshes):
        parts = coacd.run_coacd(coacd.Mesh(vertices, triangles), **task["options"])
        answer[f"parts_{i}"] = np.concatenate([np.asarray(part[0], dtype=np.float64) for part in parts])
        answer[f"counts_{i}"] = np.array([len(part[0]) for part in parts])
    np.savez(folder / ANSWER, allow_pickle=False, **answer)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
