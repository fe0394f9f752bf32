"""The process that workers are forked from: one thread, libraries loaded, nothing else at work in it.

It adopts what workers leave behind, so that whatever a worker started ends with it, and everything ends with the
server: the control socket closes when that is gone, however it went.
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
from service.executor.worker import Worker, open_cell

MAX_MESSAGE = 2**17
N_FDS = 3  # of a new worker: its socket, its cancel cell, its standard error


def serve(control: socket.socket, preload: list[str]) -> None:
    """Import modules, then fork, end and reap workers as the control socket says."""
    linux.name_process("scopt-nursery")
    linux.adopt_orphans()
    try:
        for name in preload:
            importlib.import_module(name)
    except BaseException:
        _say(control, failed=traceback.format_exc()[-10_000:])
        return
    gc.collect()
    gc.freeze()  # what is loaded by now stays shared: no worker's collector touches it
    linux.outlive_parent()
    _say(control, ready=linux.count_threads())
    _Nursery(control).run()


class _Nursery:
    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._workers: dict[int, int] = {}  # pid to the pool's number for it
        self._heard, self._rung = socket.socketpair()
        for end in (self._heard, self._rung):
            end.setblocking(False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self._rung.fileno(), warn_on_full_buffer=False)

    def run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._control, selectors.EVENT_READ)
            selector.register(self._heard, selectors.EVENT_READ)
            while True:
                ready = {key.fileobj for key, _ in selector.select()}
                if self._heard in ready:
                    with suppress(BlockingIOError):
                        self._heard.recv(4096)
                    self._reap()
                if self._control in ready and not self._obey(selector):
                    break
        self._end_all()

    def _obey(self, selector: selectors.BaseSelector) -> bool:
        """Do the next thing asked for; False when nobody asks any more."""
        try:
            message, fds, _, _ = socket.recv_fds(self._control, MAX_MESSAGE, N_FDS)
        except OSError:
            return False
        if not message:
            return False
        wish = json.loads(message)
        if "start" in wish:
            self._start(wish["start"], fds, selector)
        for pid in [pid for pid, worker in self._workers.items() if worker == wish.get("kill")]:
            os.kill(pid, signal.SIGKILL)
        return True

    def _start(self, worker: int, fds: list[int], selector: selectors.BaseSelector) -> None:
        nursery = os.getpid()
        try:
            pid = os.fork()
        except OSError as error:
            _say(self._control, ended=worker, how=f"not started: {error}")
            pid = -1
        if pid == 0:
            try:
                selector.close()
                self._become_worker(nursery, fds)
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(1)
        if pid > 0:
            self._workers[pid] = worker
        for fd in fds:
            os.close(fd)

    def _become_worker(self, nursery: int, fds: list[int]) -> None:
        linux.die_with_parent(nursery)
        linux.name_process("scopt-worker")
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for own in (self._control, self._heard, self._rung):
            own.close()
        sock, cell, stderr = fds
        os.dup2(stderr, 1)
        os.dup2(stderr, 2)
        os.close(stderr)
        with suppress(BrokenPipeError, ConnectionResetError):
            Worker(socket.socket(fileno=sock), open_cell(cell)).work()

    def _reap(self) -> None:
        """Tell which workers ended, and end what they left behind."""
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if pid == 0:
                break
            worker = self._workers.pop(pid, None)
            if worker is not None:
                _say(self._control, ended=worker, how=_how(os.waitstatus_to_exitcode(status)))
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
                for orphan in linux.children() - set(self._workers):
                    os.kill(orphan, signal.SIGKILL)


def _how(code: int) -> str:
    if code >= 0:
        return f"exit {code}"
    return signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"


def _say(control: socket.socket, **content: Any) -> None:
    with suppress(OSError):  # nobody listens any more, which ends the loop
        control.send(json.dumps(content).encode())
