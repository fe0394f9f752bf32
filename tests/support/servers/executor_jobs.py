"""Functions that workers run in the tests of executors; some of them kill their worker."""

from __future__ import annotations

import ctypes
import os
import signal
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from service.executor import Control, JobCancelled

WARMED_UP: list[str] = []


class Stubborn(Exception):  # noqa: N818
    """An exception that can be pickled but not unpickled."""

    def __init__(self, left: int, right: int) -> None:
        super().__init__(f"{left} and {right}")


def add(left: Any, right: Any) -> Any:
    return left + right


def size_of(data: bytes) -> int:
    return len(data)


def now(control: Control) -> float:
    return control.now()


def size_after(count: int) -> int:
    return len(bytearray(count))


def many_bytes(count: int) -> bytes:
    return bytes(count)


def pid() -> int:
    return os.getpid()


def nap(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def wait_for_stopped_child(folder: Path) -> int:
    """Wait for a process that has stopped itself, if this is the first attempt; return the number of the attempt."""
    first = folder / "first"
    if first.exists():
        return 2
    first.touch()
    subprocess.run([sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSTOP)"], check=False)
    return 1


def append_mark(folder: Path, name: str) -> str:
    """Append a line to a file, which shows how often and in which order this was run."""
    with (folder / "marks").open("a") as marks:
        marks.write(f"{name}\n")
    return name


def append_mark_late(folder: Path, name: str, seconds: float) -> str:
    time.sleep(seconds)
    return append_mark(folder, name)


def wait_for_file(path: Path) -> bool:
    while not path.exists():
        time.sleep(0.002)
    return True


def count_up(count: int, control: Control) -> str:
    for i in range(count):
        control.report(i)
    return "counted"


def run_until_stopped(control: Control) -> str:
    control.report(os.getpid())
    while not control.should_stop():
        time.sleep(0.001)
    return "the best so far"


def stop_late(seconds: float, control: Control) -> str:
    control.report("running")
    while not control.should_stop():
        time.sleep(0.0005)
    time.sleep(seconds)
    return "stopped"


def never_poll(control: Control) -> None:
    control.report(os.getpid())
    while True:
        time.sleep(0.01)


def raise_when_stopped(control: Control) -> None:
    control.report(os.getpid())
    while not control.should_stop():
        time.sleep(0.001)
    raise JobCancelled("stopped")


def raise_cancelled() -> None:
    raise JobCancelled("by nobody")


def signal_handlers() -> list[str]:
    """Return the signals that have a Python handler."""
    return [number.name for number in signal.valid_signals() if callable(signal.getsignal(number))]


def report_and_never_poll(size: int, control: Control) -> None:
    """Report without pause and never poll."""
    while True:
        control.report(bytes(size))


def stuck_in_native_code(control: Control) -> None:
    """Hold the interpreter's lock in a call that does not return."""
    control.report(os.getpid())
    ctypes.PyDLL(None).sleep(600)


def mark_and_never_poll(folder: Path) -> None:
    append_mark(folder, "run")
    while True:
        time.sleep(0.01)


def mark_and_keep_the_lock(folder: Path) -> None:
    """Hold the interpreter's lock in a call that does not return."""
    append_mark(folder, "run")
    ctypes.PyDLL(None).sleep(600)


def keep_the_lock_once(folder: Path) -> int:
    """Wait without end in native code that keeps the interpreter's lock, if this is the first attempt."""
    append_mark(folder, "run")
    runs = len((folder / "marks").read_text().split())
    if runs == 1:
        ctypes.PyDLL(None).sleep(600)
    return runs


def sum_up(count: int) -> int:
    """Compute without ever leaving the interpreter's lock to another thread."""
    return sum(range(count))


def kill_own_worker(folder: Path, times: int) -> int:
    """Kill the worker at the first ``times`` runs, then return how often this was run."""
    append_mark(folder, "run")
    runs = len((folder / "marks").read_text().split())
    if runs <= times:
        os.kill(os.getpid(), signal.SIGKILL)
    return runs


def crash(depth: int = 20) -> None:
    """Crash below ``depth`` calls: a stack as long as those of installations in long paths."""
    if depth:
        crash(depth - 1)
        return
    print("the last words", file=sys.stderr, flush=True)
    ctypes.string_at(0)


def exit_silently(code: int) -> None:
    os._exit(code)


def raise_value_error(text: str) -> None:
    raise ValueError(text)


def raise_stubborn() -> None:
    raise Stubborn(1, 2)


def raise_exit() -> None:
    raise SystemExit(3)


def return_a_lock() -> object:
    return threading.Lock()


def report_a_lock(control: Control) -> None:
    control.report(threading.Lock())


def allocate(count: int) -> int:
    return len(bytearray(count))


def environment(name: str) -> str | None:
    return os.environ.get(name)


def say(text: str) -> None:
    print(text)


def signal_itself(number: int) -> str:
    """Send this process a signal, as Ctrl-C does to its group."""
    os.kill(os.getpid(), number)
    time.sleep(0.05)
    return "still here"


def start_child(control: Control) -> None:
    """Start a process in a session of its own, as file readers are, and wait for it."""
    child = subprocess.Popen(["sleep", "600"], start_new_session=True)
    control.report((os.getpid(), child.pid))
    child.wait()


def send_nonsense() -> None:
    for fd in _sockets():
        os.write(fd, b"\xff" * 64)
    time.sleep(600)


def send_nonsense_later(payload: bytes) -> None:
    """Return, and write to the pool a little later."""

    def talk() -> None:
        time.sleep(0.02)
        for fd in _sockets():
            os.write(fd, payload)

    threading.Thread(target=talk, daemon=True).start()


def return_and_die(n_events: int, control: Control) -> str:
    """Report events, return, and kill the worker a moment later."""

    def die() -> None:
        time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGKILL)

    for _ in range(n_events):
        control.report(bytes(10_000))
    threading.Thread(target=die, daemon=True).start()
    return "done"


def report_until_stopped(control: Control) -> str:
    while not control.should_stop():
        control.report(bytes(2000))
    return "stopped"


def close_sockets() -> None:
    for fd in _sockets():
        os.close(fd)
    time.sleep(600)


def report_then_return(count: int, control: Control) -> bytes:
    control.report(os.getpid())
    return bytes(count)


def warm_up() -> None:
    WARMED_UP.append("warm")


def was_warmed_up() -> list[str]:
    return WARMED_UP


def fail_to_warm_up() -> None:
    raise OSError("no robot there")


def warm_up_without_end() -> None:
    time.sleep(600)


def thread_names() -> list[str]:
    return [thread.name for thread in threading.enumerate()]


def _sockets() -> list[int]:
    fds = [int(name) for name in os.listdir("/proc/self/fd")]
    return [fd for fd in fds if _is_socket(fd)]


def _is_socket(fd: int) -> bool:
    try:
        return stat.S_ISSOCK(os.fstat(fd).st_mode)
    except OSError:
        return False
