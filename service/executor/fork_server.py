"""The process that workers are forked from, and the pool's view of it.

It has one thread and the modules that workers need. It adopts the processes that workers leave behind and kills them.
When the pool's process ends, however it ends, the control socket closes, and this process kills all workers. It also
forks standbys, which have all modules too and do nothing until the pool has them fork workers.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import time
import traceback
from contextlib import ExitStack, suppress
from typing import Any

from service.executor import linux
from service.executor.worker import SharedFlags, Worker

_MAX_REQUEST = 2**17
_STANDBY = 0  # number under which a fork server keeps its standbys among its workers
_N_FDS = 3  # of a new worker: its socket, its flags, its standard output and error
_EXIT_TIMEOUT_S = 5.0
_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
}

# Not multiprocessing's way of starting a process: the server's main script must not be imported again.
_START_COMMAND = f"""
import json, socket, sys
control = socket.socket(fileno=int(sys.argv[1]))
request = json.loads(control.recv({_MAX_REQUEST}))
sys.path[:] = request["path"]
from service.executor.fork_server import run
run(control, request["parent"], request["preload"])
"""


class ForkServer:
    """The process that workers are forked from, or a standby, as the pool sees it.

    Attributes:
        pid: its process id; 0 for a standby whose id has not arrived.
        is_ready: it has imported its modules and has one thread.
        control: the socket on which it answers.
    """

    def __init__(self, control: socket.socket, process: subprocess.Popen[bytes] | None) -> None:
        self.pid = 0 if process is None else process.pid
        self.is_ready = process is None
        self.control = control
        self._process = process  # None for a standby, which is no child of this process

    @classmethod
    def start(cls, preload: tuple[str, ...], output_fd: int) -> ForkServer:
        """Start a new process that imports modules and writes to a file descriptor.

        Raises:
            OSError: out of resources.
        """
        control, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            process = subprocess.Popen(
                [sys.executable, "-P", "-c", _START_COMMAND, str(other.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=output_fd,
                stderr=output_fd,
                env={**os.environ, **_ONE_THREAD},
                pass_fds=[other.fileno()],
            )
        _send(control, path=sys.path, parent=os.getpid(), preload=preload)
        return cls(control, process)

    def fork_standby(self) -> ForkServer:
        """Have it fork a process that can take its place.

        Raises:
            OSError: out of resources, or the process has ended.
        """
        control, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other, ExitStack() as undo:
            undo.callback(control.close)
            self.fork_worker(_STANDBY, [other.fileno()])
            undo.pop_all()
        return ForkServer(control, None)

    def fork_worker(self, number: int, fds: list[int]) -> None:
        """Have it fork a worker with these file descriptors: socket, flags, output (a standby: control socket).

        Raises:
            OSError: out of resources, or the process has ended.
        """
        socket.send_fds(self.control, [json.dumps({"fork": number}).encode()], fds)

    def kill_worker(self, number: int) -> None:
        """Kill a worker, unless it has ended."""
        _send(self.control, kill=number)

    def resume(self) -> None:
        """Continue it after a signal has stopped it."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGCONT)

    def receive(self) -> dict[str, Any] | None:
        """Return the next message, which must have arrived; None when the process has ended."""
        try:
            data = self.control.recv(_MAX_REQUEST)
        except OSError:
            return None
        message: dict[str, Any] | None = json.loads(data) if data else None
        return message

    def close(self) -> None:
        """End it and all its workers, and wait for that."""
        self.control.close()
        end = time.monotonic() + (_EXIT_TIMEOUT_S if self.is_ready else 0.0)  # while it imports it reads no requests
        while self._is_running() and time.monotonic() < end:
            time.sleep(0.002)
        if self._is_running():
            os.kill(self.pid, signal.SIGKILL)
        if self._process is not None:
            self._process.wait()

    def _is_running(self) -> bool:
        return linux.is_running(self.pid) if self._process is None else self._process.poll() is None


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
            message, fds, _, _ = socket.recv_fds(self._control, _MAX_REQUEST, _N_FDS)
        except OSError:
            return False
        if not message:
            return False
        request = json.loads(message)
        if "fork" in request:
            self._fork(request["fork"], fds, selector)
        for pid in [pid for pid, worker in self._workers.items() if worker == request.get("kill")]:
            os.kill(pid, signal.SIGKILL)
        return True

    def _fork(self, number: int, fds: list[int], selector: selectors.BaseSelector) -> None:
        """Fork a worker or a standby, which never returns from here."""
        parent = os.getpid()
        try:
            pid = os.fork()
        except OSError as error:
            _send(self._control, ended=number, cause=f"not started: {error}")
            pid = -1
        if pid == 0:
            try:
                selector.close()
                self._run_child(number, parent, fds)
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(1)
        if pid > 0:
            self._workers[pid] = number
        for fd in fds:
            os.close(fd)

    def _run_child(self, number: int, parent: int, fds: list[int]) -> None:
        if number != _STANDBY:
            linux.die_with_parent(parent)
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for sock in (self._control, self._child_ended, self._child_ended_writer):
            sock.close()
        sock = socket.socket(fileno=fds[0])
        if number == _STANDBY:
            linux.name_process("scopt-standby")
            linux.adopt_orphans()
            _send(sock, pid=os.getpid())
            _ForkLoop(sock).run()
            os._exit(0)
        linux.name_process("scopt-worker")
        _, flags_fd, output_fd = fds
        os.dup2(output_fd, 1)
        os.dup2(output_fd, 2)
        os.close(output_fd)
        with suppress(BrokenPipeError, ConnectionResetError):
            Worker(sock, SharedFlags.open(flags_fd)).run()

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
            if worker:
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
