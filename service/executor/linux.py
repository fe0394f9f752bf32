"""Calls to the Linux kernel that bound, name and watch processes, and tie their lifetimes together."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
from contextlib import suppress
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_PR_SET_NAME = 15
_PR_SET_CHILD_SUBREAPER = 36
_NICENESS = 5  # a third of the share of a process that has none


def die_with_parent(parent: int) -> None:
    """Have this process killed when the thread that started it ends; exit now if ``parent`` [pid] is gone already."""
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def outlive_parent() -> None:
    """Undo ``die_with_parent``."""
    _prctl(_PR_SET_PDEATHSIG, 0)


def adopt_orphans() -> None:
    """Become the parent of every descendant whose own parent ends."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def name_process(name: str) -> None:
    """Set the name that ``top`` and ``ps -o comm`` show for this process; at most 15 bytes."""
    _prctl(_PR_SET_NAME, ctypes.c_char_p(name.encode()))


def ignore_interrupts() -> None:
    """Ignore Ctrl-C and SIGTERM, which reach the whole process group; the server alone decides what ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


def raise_oom_score() -> None:
    """Have the kernel kill this process before the server when memory runs out."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")


def lower_priority() -> None:
    """Have the kernel serve the server and its clients before this process when processors are busy."""
    os.nice(_NICENESS)


def limit_memory(max_bytes: int | None) -> None:
    """Bound the address space [bytes] for good, and disable core files, whose writing takes longer than a job."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if max_bytes is not None:
        _, hardest = resource.getrlimit(resource.RLIMIT_AS)
        limit = max_bytes if hardest == resource.RLIM_INFINITY else min(max_bytes, hardest)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def address_space_bytes() -> int:
    """Return the size of this process's address space, used or not."""
    return _read_statm("self", 0)


def rss_bytes(pid: int) -> int:
    """Return the resident memory of a process, shared pages included; 0 when it has ended."""
    try:
        return _read_statm(pid, 1)
    except (OSError, IndexError):
        return 0


def count_threads() -> int:
    """Count the threads of this process, native ones included."""
    return len(os.listdir("/proc/self/task"))


def children() -> set[int]:
    """Return the process ids of this process's children; empty where the kernel keeps no such list."""
    try:
        return {int(pid) for pid in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()}
    except OSError:
        return set()


def state_of(pid: int) -> str:
    """Return the letter that ``ps`` shows for a process: R, S, D, T, Z; empty when it has ended."""
    return (_read_stat(f"/proc/{pid}/stat") or [""])[0]


def is_running(pid: int) -> bool:
    """Return whether a process has not ended."""
    return state_of(pid) not in ("", "Z", "X")


def read_activity(pid: int) -> tuple[bool, float]:
    """Return whether all threads of a process wait for something, and the processor time it has used [s]."""
    try:
        threads = [_read_stat(f"/proc/{pid}/task/{thread}/stat") for thread in os.listdir(f"/proc/{pid}/task")]
    except OSError:
        return False, 0.0
    ticks = sum(int(fields[11]) + int(fields[12]) for fields in threads if fields)
    return all(fields and fields[0] in "ST" for fields in threads), ticks / os.sysconf("SC_CLK_TCK")


def descendants(pid: int) -> set[int]:
    """Return the processes that a process and its descendants started; empty where the kernel keeps no such list."""
    pids, waiting = set[int](), [pid]
    while waiting:
        with suppress(OSError):
            folder = f"/proc/{waiting.pop()}/task"
            for thread in os.listdir(folder):
                started = {int(child) for child in _read(f"{folder}/{thread}/children").split()} - pids
                pids |= started
                waiting.extend(started)
    return pids


def _read_stat(path: str) -> list[str]:
    """Return the fields of a ``stat`` file from the state on; none when the process has ended."""
    try:
        return _read(path).rpartition(b") ")[2].decode().split()  # the name before may hold anything
    except OSError:
        return []


def _read_statm(pid: int | str, field: int) -> int:
    return int(_read(f"/proc/{pid}/statm").split()[field]) * os.sysconf("SC_PAGE_SIZE")


def _read(path: str) -> bytes:
    """Return the content of a small file, in a third of the time that a ``Path`` needs."""
    fd = os.open(path, os.O_RDONLY)
    try:
        return os.read(fd, 2**16)
    finally:
        os.close(fd)


def _prctl(option: int, argument: int | ctypes.c_char_p) -> None:
    if ctypes.CDLL(None, use_errno=True).prctl(option, argument, 0, 0, 0):
        raise OSError(ctypes.get_errno(), f"prctl({option}) failed")
