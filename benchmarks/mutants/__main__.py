"""Put small errors into the code, one at a time, and list those that no near test notices.

``python -m benchmarks.mutants [GROUP ...] [--count N] [--seed N | --fresh] [--minutes M]``. Mutants are made in a copy
of the project; each is given to the nearest test files (fewest imports away) without the slow tests. Tools of this
kind (mutmut, cosmic-ray) run all tests, or one command for all files, and draw no sample.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.mutants.mutations import Mutant, list_mutants
from benchmarks.mutants.nearest import ImportGraph
from benchmarks.tables import print_table

ROOT = Path(__file__).resolve().parents[2]
# Folders or files of each group, and the tests that are preferred among those equally near.
GROUPS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "scopt": (("scopt",), ("scopt/",)),
    "costs": (("costs",), ("costs/", "robots/")),
    "verify": (("service/verify",), ("verify/",)),
    "planner": (("service/tasks", "service/body", "service/demands"), ("planning/", "contacts/")),
    "timing": (("service/motion",), ("planning/",)),
    "trust": (("service/trust",), ("store/", "server/")),
    "store": (("service/store",), ("store/",)),
}
MOST_TESTS = 12  # files per mutant
MOST_SECONDS = 120.0  # per mutant, which may never end
CRASH = "crash"
OPTIONS = ("-x", "-q", "-rfE", "-p", "no:cacheprovider", "-m", "not slow")
NOT_COPIED = (".*", "__pycache__", "node_modules", "*.egg-info", "out", "site")


@dataclass
class Tally:
    """What became of a group's mutants; ``untried`` ones are those for which the time was too short."""

    killed: int = 0
    timed_out: int = 0
    untried: int = 0
    survivors: list[str] = field(default_factory=list)

    @property
    def tried(self) -> int:
        """Number of mutants that were given to tests."""
        return self.killed + self.timed_out + len(self.survivors)

    @property
    def share(self) -> str:
        """Share of mutants that tests noticed."""
        return f"{100 * (self.killed + self.timed_out) / self.tried:.0f} %" if self.tried else "-"


class Copy:
    """Copy of a project in which one file at a time is wrong.

    Attributes:
        broken: tests that fail without any mutant, and are left out.
    """

    def __init__(self, project: Path, root: Path) -> None:
        self.project, self.root = project, root
        self.broken: set[str] = set()
        self._sound: set[str] = set()  # tests that have passed without any mutant
        self._changes = 0
        shutil.copytree(project, root, ignore=shutil.ignore_patterns(*NOT_COPIED), dirs_exist_ok=True)

    def judge(self, mutant: Mutant, tests: Sequence[str], seconds: float = MOST_SECONDS) -> str | None:
        """Return what notices a mutant, as in :meth:`_find_failure`; tests that fail anyway notice nothing."""
        source = (self.project / mutant.path).read_bytes()
        while True:
            self._write(mutant.path, mutant.apply(source))
            failure = self._find_failure(tests, seconds)
            self._write(mutant.path, source)
            if not failure or failure == CRASH or failure in self._sound:
                return failure
            is_sound = self._find_failure([failure], MOST_SECONDS) == ""
            (self._sound if is_sound else self.broken).add(failure)

    def _write(self, path: str, text: bytes) -> None:
        """Write a file as if at another time than before, or its bytecode would be taken for that of the new text."""
        file = self.root / path
        file.write_bytes(text)
        self._changes += 1
        os.utime(file, (self._changes, self._changes))

    def _find_failure(self, tests: Sequence[str], seconds: float) -> str | None:
        """Return the first test that fails, an empty text where all pass, or None where the time is over."""
        tests = [test for test in tests if test not in self.broken]
        if not tests:
            return ""
        left_out = [f"--deselect={test}" for test in self.broken]
        command = [sys.executable, "-m", "pytest", *OPTIONS]
        environment = {**os.environ, "PYTHONPATH": str(self.root), "OMP_NUM_THREADS": "1"}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        with subprocess.Popen(
            [*command, *left_out, *tests],
            cwd=self.root,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        ) as process:
            try:
                output, _ = process.communicate(timeout=seconds)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)  # with the servers that it may have started
                return None
        if process.returncode in (0, 5):  # 5: all tests of these files are slow
            return ""
        failures = re.findall(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", output, flags=re.MULTILINE)
        return failures[0] if failures else CRASH


def draw_mutants(paths: tuple[str, ...], count: int, seed: int, root: Path = ROOT) -> list[Mutant]:
    """Return a sample of the mutants of all files in some folders, the same for the same seed."""
    files = sorted(file for path in paths for file in (root / path).rglob("*.py"))
    mutants = [each for file in files for each in list_mutants(str(file.relative_to(root)), file.read_bytes())]
    return random.Random(seed).sample(mutants, min(count, len(mutants)))


def try_group(copy: Copy, graph: ImportGraph, name: str, count: int, seed: int, end: float) -> Tally:
    """Give a sample of a group's mutants to their nearest tests, until ``end`` of the monotonic clock."""
    paths, among = GROUPS[name]
    tally = Tally()
    for mutant in draw_mutants(paths, count, seed):
        if time.monotonic() > end:
            tally.untried += 1
            continue
        failure = copy.judge(mutant, graph.find_nearest_tests(mutant.path, MOST_TESTS, among))
        if failure is None:
            tally.timed_out += 1
        elif failure:
            tally.killed += 1
        else:
            tally.survivors.append(str(mutant))
        outcome = "timed out" if failure is None else failure or "SURVIVED"
        print(f"{mutant}: {outcome}", flush=True)
    return tally


def main() -> None:
    """Try the groups one after another and print the share that is noticed, and all survivors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"of {', '.join(GROUPS)}; default all")
    parser.add_argument("--count", type=int, default=300, help="mutants of each group")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--fresh", action="store_true", help="a sample that nobody has seen")
    parser.add_argument("--minutes", type=float, default=60.0, help="for all groups together")
    options = parser.parse_args()
    if unknown := set(options.groups) - set(GROUPS):
        parser.error(f"unknown group {sorted(unknown)[0]!r}; expected {', '.join(GROUPS)}")
    seed = random.SystemRandom().randrange(10**6) if options.fresh else options.seed
    names, began = options.groups or list(GROUPS), time.monotonic()
    tallies = {}
    with TemporaryDirectory(prefix="mutants-") as folder:
        copy, graph = Copy(ROOT, Path(folder)), ImportGraph(ROOT)
        for number, name in enumerate(names, start=1):
            end = began + 60.0 * options.minutes * number / len(names)
            tallies[name] = try_group(copy, graph, name, options.count, seed, end)
    header = ["group", "tried", "noticed", "of them timed out", "survived", "not tried"]
    columns = [(t.tried, t.share, t.timed_out, len(t.survivors), t.untried) for t in tallies.values()]
    rows = [[name, *map(str, column)] for name, column in zip(tallies, columns, strict=True)]
    print_table(f"Mutants (seed {seed})", header, rows)
    for tally in tallies.values():
        print(*tally.survivors, sep="\n")
    if copy.broken:
        print(f"left out, since they fail without any mutant: {', '.join(sorted(copy.broken))}")


if __name__ == "__main__":
    main()
