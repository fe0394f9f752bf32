"""What only the kernel can promise: that processes end with the one they belong to, and whose child an orphan is."""

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
    """Be killed when the thread that started this process ends; at once where ``parent`` [pid] is gone already."""
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def outlive_parent() -> None:
    """No longer be killed when the parent ends."""
    _prctl(_PR_SET_PDEATHSIG, 0)


def adopt_orphans() -> None:
    """Become the parent of every descendant whose own parent ends."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def name_process(name: str) -> None:
    """What ``top`` and ``ps -o comm`` call this process; at most 15 bytes."""
    _prctl(_PR_SET_NAME, ctypes.c_char_p(name.encode()))


def leave_interrupts_to_the_server() -> None:
    """Ctrl-C and a service manager's SIGTERM reach the whole group; only the server decides what ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


def be_first_out_of_memory() -> None:
    """Short of memory, the kernel takes this process before the server."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")


def let_others_go_first() -> None:
    """Where processors are short, the kernel serves the server and its clients before this process."""
    os.nice(_NICENESS)


def limit_memory(max_bytes: int | None) -> None:
    """Bound the address space [bytes], for good; a crash writes no core file, which would take longer than the job."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if max_bytes is not None:
        _, hardest = resource.getrlimit(resource.RLIMIT_AS)
        limit = max_bytes if hardest == resource.RLIM_INFINITY else min(max_bytes, hardest)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def address_space_bytes() -> int:
    """Address space that this process has taken, used or not."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")


def count_threads() -> int:
    """Threads of this process, native ones included."""
    return len(os.listdir("/proc/self/task"))


def children() -> set[int]:
    """Process ids of this process's children; none where the kernel keeps no such list."""
    try:
        return {int(pid) for pid in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()}
    except OSError:
        return set()


def rss_bytes(pid: int) -> int:
    """Resident memory of a process, shared pages included; 0 when it is gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def _prctl(option: int, argument: int | ctypes.c_char_p) -> None:
    if ctypes.CDLL(None, use_errno=True).prctl(option, argument, 0, 0, 0):
        raise OSError(ctypes.get_errno(), f"prctl({option}) failed")
