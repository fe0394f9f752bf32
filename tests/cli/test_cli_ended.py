"""A cancelled command ends at once, in whichever step Ctrl-C arrives."""

from __future__ import annotations

import subprocess
import sys

WHILE_IMPORTED = """
import sys
class Interrupted:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupted())
sys.argv = ["scopt", "robots"]
from service.cli import main
main()
"""
CANCELLED = """
import atexit, sys
import service.cli.app
atexit.register(print, "destructors")
def end():
    print("best so far")
    raise SystemExit({code})
service.cli.app.app = end
service.cli.app.main()
"""


def _run(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=240)


def test_ctrl_c_while_modules_are_imported_is_one_line() -> None:
    for module in ("service.cli.app", "service.cli.robots"):
        done = _run(WHILE_IMPORTED.format(module=module))
        assert (done.returncode, done.stdout, done.stderr) == (130, "", "cancelled\n")


def test_only_a_cancelled_command_leaves_out_the_destructors() -> None:
    ended = _run(CANCELLED.format(code=130))
    assert (ended.returncode, ended.stdout) == (130, "best so far\n")
    usual = _run(CANCELLED.format(code=4))
    assert (usual.returncode, usual.stdout) == (4, "best so far\ndestructors\n")
