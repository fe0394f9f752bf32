"""Starts the nursery: run as a script, so that the server's main script is not imported again."""

from __future__ import annotations

import json
import os
import socket
import sys


def main() -> None:
    """Take over the control socket whose descriptor is the argument, and serve it."""
    control = socket.socket(fileno=int(sys.argv[1]))
    task = json.loads(control.recv(2**17))
    sys.path[:] = task["path"]
    from service.executor import linux, nursery

    linux.leave_interrupts_to_the_server()
    linux.die_with_parent(task["parent"])  # imports take a while, and nobody listens to the socket meanwhile
    nursery.serve(control, task["preload"])
    os._exit(0)


if __name__ == "__main__":
    main()
