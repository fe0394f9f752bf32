"""Simulations of a server's worker."""

from __future__ import annotations

import pytest
from small_plan import small_plan

from service.executor import Control
from service.result.output import write_result
from service.work.plan import Refused
from service.work.simulate import simulate


class NeverStops(Control):
    """A job that nobody stops."""

    def __init__(self) -> None:
        pass

    def should_stop(self) -> bool:
        return False

    def report(self, *values: object) -> None:
        pass


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = write_result(small_plan(), tmp_path_factory.mktemp("plan") / "out").folder
    kept = [folder / "result.json", *(folder / "robot").rglob("*")]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in kept if path.is_file()}


def test_a_worker_simulates_the_files_of_a_result(files: dict[str, bytes]) -> None:
    answer = simulate(files, {"feed_forward": 1.0, "seed": 3, "settle_s": 0.2, "after_s": 0.2}, NeverStops())
    assert not isinstance(answer, Refused)
    # Nobody touches the wheel that this plan turns.
    assert (answer["verdict"], answer["options"]["seed"]) == ("STOOD", 3)
    assert [run["hand_friction"] for run in answer["runs"]] == [0.3, 0.6]
    assert "track" not in answer


def test_a_worker_refuses_options_and_folders_in_a_line(files: dict[str, bytes]) -> None:
    assert simulate(files, {"friction": -1.0}, NeverStops()) == Refused(("friction: -1; expected 0 to 5",))
    (line,) = simulate({"../a": b""}, {}, NeverStops()).problems  # type: ignore[union-attr]
    assert line == "files: '../a' is outside the result folder"
    (line,) = simulate({"result.json": b"{}"}, {}, NeverStops()).problems  # type: ignore[union-attr]
    assert line.startswith("files: result.json: format is None; expected")
