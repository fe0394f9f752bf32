"""A Ray cluster of this machine, in processes of its own; to be imported before Ray."""

from __future__ import annotations

import os
import secrets
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from executor_waiting import until

# Read when Ray is imported: nobody else on this machine may use the cluster.
os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32), "RAY_USAGE_STATS_ENABLED": "0"}

SOON_S = 120.0  # a cluster takes its time
STARTS, TOO_SLOW = 4, "timed out during startup"
SUPPORT = Path(__file__).parent


@contextmanager
def ray_cluster() -> Iterator[str]:
    """The address of a cluster with two CPUs.

    Ray gives a node 30 s to start, which no setting changes; where a busy machine takes longer, it is started again.
    """
    for left in reversed(range(STARTS)):
        port, client_port = _free_ports()
        with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as folder:
            command = [
                str(Path(sys.executable).with_name("ray")), "start", "--head", "--block", "--num-cpus=2",
                f"--port={port}", f"--ray-client-server-port={client_port}", "--node-ip-address=127.0.0.1",
                "--include-dashboard=false", f"--temp-dir={folder}",
            ]  # fmt: skip
            environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(SUPPORT.parents[2]), str(SUPPORT)])}
            with open(f"{folder}/log", "wb") as log:
                head = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
            try:
                assert _is_decided(head, client_port)
                said = Path(folder, "log").read_text()
                if head.poll() is not None and TOO_SLOW in said and left:
                    continue
                assert head.poll() is None, said
                yield f"ray://127.0.0.1:{client_port}"
            finally:
                head.terminate()
                head.wait(SOON_S)
            return


def _free_ports() -> tuple[int, int]:
    with socket.socket() as one, socket.socket() as other:
        for sock in (one, other):
            sock.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]


def _is_decided(head: subprocess.Popen[bytes], port: int) -> bool:
    """Wait until a node answers or has ended; return whether it did."""
    return until(lambda: _answers(port) or head.poll() is not None, SOON_S)


def _answers(port: int) -> bool:
    with socket.socket() as sock:
        return sock.connect_ex(("127.0.0.1", port)) == 0
