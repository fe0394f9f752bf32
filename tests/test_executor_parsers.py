"""The child processes that parse files of unknown origin end with their parent, however it ends."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from executor_waiting import is_running, until

LIBRARY = """
import os, pathlib, time
pathlib.Path(__file__).with_suffix('.pid').write_text(str(os.getpid()))
time.sleep(60)
"""
PARENT = """
import sys, threading
from pathlib import Path
import numpy as np
from perception.files.read import parse_in_sandbox
from perception.mesh import Mesh
from perception.solids.process import run_coacd
sys.path.insert(0, sys.argv[1])
threading.Thread(target=parse_in_sandbox, args=[Path(sys.argv[1]) / "scan.las"]).start()
run_coacd([Mesh(np.eye(3), np.array([[0, 1, 2]]))], {})
"""


def test_children_that_read_a_scan_or_split_a_mesh_end_with_their_parent(tmp_path: Path) -> None:
    for library in ("laspy", "coacd"):
        (tmp_path / f"{library}.py").write_text(LIBRARY)  # in place of the library that does the work
    (tmp_path / "scan.las").write_bytes(b"LASF" + bytes(400))
    notes = [tmp_path / "laspy.pid", tmp_path / "coacd.pid"]
    with subprocess.Popen([sys.executable, "-c", PARENT, str(tmp_path)]) as parent:
        assert until(lambda: all(note.exists() and note.read_text() for note in notes), timeout_s=30.0)
        children = [int(note.read_text()) for note in notes]
        assert all(is_running(child) for child in children)
        parent.kill()
        assert until(lambda: not any(is_running(child) for child in children))
