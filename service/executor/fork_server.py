"""The process that workers are forked from: it has one thread and the modules that workers need.

It adopts the processes that workers leave behind and kills them. When the pool's process ends, however it ends, the
control socket closes, and this process kills all workers.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import selectors
import signal
import socket
import traceback
from contextlib import suppress
from typing import Any

from service.executor import linux
from service.executor.worker import Worker, open_cancel_flag

MAX_REQUEST = 2**17
_N_FDS = 3  # of a new worker: its socket, its cancel flag, its standard output and error

# Not multiprocessing's way of starting a process: the server's main script must not be imported again.
START_COMMAND = f"""
import json, socket, sys
control = socket.socket(fileno=int(sys.argv[1]))
request = json.loads(control.recv({MAX_REQUEST}))
sys.path[:] = request["path"]
from service.executor.fork_server import run
run(control, request["parent"], request["preload"])
"""


def run(control: socket.socket, parent: int, preload: list[str]) -> None:
    """Import modules, then fork, kill and reap workers as the control socket requests; end with ``parent`` [pid]."""
    linux.ignore_interrupts()
    linux.die_with_parent(parent)  # the control socket is not read while modules are imported
    linux.name_process("scopt-forksrv")
    linux.adopt_orphans()
    try:
        for name in preload:
            importlib.import_module(name)
    except BaseException:
        _send(control, failed=traceback.format_exc()[-10_000:])
    else:
        gc.collect()
        gc.freeze()  # what is loaded now stays shared: no worker's collector touches it
        linux.outlive_parent()
        _send(control, ready=linux.count_threads())
        _ForkLoop(control).run()
    os._exit(0)


class _ForkLoop:
    """Serves the requests of the control socket and reaps children."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._workers: dict[int, int] = {}  # pid to the pool's number of the worker
        self._child_ended, self._child_ended_writer = socket.socketpair()
        for end in (self._child_ended, self._child_ended_writer):
            end.setblocking(False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self._child_ended_writer.fileno(), warn_on_full_buffer=False)

    def run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._control, selectors.EVENT_READ)
            selector.register(self._child_ended, selectors.EVENT_READ)
            while True:
                ready = {key.fileobj for key, _ in selector.select()}
                if self._child_ended in ready:
                    with suppress(BlockingIOError):
                        self._child_ended.recv(4096)
                    self._reap()
                if self._control in ready and not self._serve_request(selector):
                    break
        self._end_all()

    def _serve_request(self, selector: selectors.BaseSelector) -> bool:
        """Serve the next request; return False when the pool has closed the socket."""
        try:
            message, fds, _, _ = socket.recv_fds(self._control, MAX_REQUEST, _N_FDS)
        except OSError:
            return False
        if not message:
            return False
        request = json.loads(message)
        if "start" in request:
            self._start(request["start"], fds, selector)
        for pid in [pid for pid, worker in self._workers.items() if worker == request.get("kill")]:
            os.kill(pid, signal.SIGKILL)
        return True

    def _start(self, worker: int, fds: list[int], selector: selectors.BaseSelector) -> None:
        parent = os.getpid()
        try:
            pid = os.fork()
        except OSError as error:
            _send(self._control, ended=worker, cause=f"not started: {error}")
            pid = -1
        if pid == 0:
            try:
                selector.close()
                self._become_worker(parent, fds)
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(1)
        if pid > 0:
            self._workers[pid] = worker
        for fd in fds:
            os.close(fd)

    def _become_worker(self, parent: int, fds: list[int]) -> None:
        linux.die_with_parent(parent)
        linux.name_process("scopt-worker")
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for sock in (self._control, self._child_ended, self._child_ended_writer):
            sock.close()
        socket_fd, cancel_fd, output_fd = fds
        os.dup2(output_fd, 1)
        os.dup2(output_fd, 2)
        os.close(output_fd)
        with suppress(BrokenPipeError, ConnectionResetError):
            Worker(socket.socket(fileno=socket_fd), open_cancel_flag(cancel_fd)).run()

    def _reap(self) -> None:
        """Report which workers ended, and kill the processes they left behind."""
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if pid == 0:
                break
            worker = self._workers.pop(pid, None)
            if worker is not None:
                _send(self._control, ended=worker, cause=_describe_exit(os.waitstatus_to_exitcode(status)))
        self._kill_orphans()

    def _kill_orphans(self) -> None:
        for orphan in linux.children() - set(self._workers):
            os.kill(orphan, signal.SIGKILL)

    def _end_all(self) -> None:
        signal.set_wakeup_fd(-1)
        for pid in self._workers:
            os.kill(pid, signal.SIGKILL)
        with suppress(ChildProcessError):
            while True:
                pid, _ = os.waitpid(-1, 0)
                self._workers.pop(pid, None)
                self._kill_orphans()


def _describe_exit(code: int) -> str:
    if code >= 0:
        return f"exit {code}"
    return signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"


def _send(control: socket.socket, **content: Any) -> None:
    with suppress(OSError):  # the pool has closed the socket, which ends the loop
        control.send(json.dumps(content).encode())
