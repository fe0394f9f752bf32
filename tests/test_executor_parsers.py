"""The processes that strangers' files are parsed in end with whoever asked for it, however that ended."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from executor_waiting import is_running, until

LIBRARY = (
    "import os, pathlib, time; pathlib.Path(__file__).with_name('pid').write_text(str(os.getpid())); time.sleep(60)"
)
PARSE_A_SCAN = """
import sys
from pathlib import Path
from perception.files.read import parse_in_sandbox
sys.path.insert(0, sys.argv[1])
parse_in_sandbox(Path(sys.argv[1]) / "scan.las")
"""
SPLIT_A_MESH = """
import sys
import numpy as np
from perception.solids.mesh import Mesh
from perception.solids.process import run_coacd
sys.path.insert(0, sys.argv[1])
run_coacd([Mesh(np.eye(3), np.array([[0, 1, 2]]))], {})
"""


@pytest.mark.parametrize(("code", "library"), [(PARSE_A_SCAN, "laspy"), (SPLIT_A_MESH, "coacd")])
def test_a_child_ends_with_its_parent(tmp_path: Path, code: str, library: str) -> None:
    (tmp_path / f"{library}.py").write_text(LIBRARY)  # in the place of the library that does the work
    (tmp_path / "scan.las").write_bytes(b"LASF" + bytes(400))
    pid = tmp_path / "pid"
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)]) as parent:
        assert until(lambda: pid.exists() and pid.read_text(), timeout_s=30.0)
        parent.kill()
        assert until(lambda: not is_running(int(pid.read_text())))
