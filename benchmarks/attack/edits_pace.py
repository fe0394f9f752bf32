"""Edits of what a record says about pace, jerk, tool speed, sway and end rates; the certificate is made again."""

from __future__ import annotations

from benchmarks.attack.forgery import Folder, Level, Registry

PACE = Registry()


@PACE.lie("paced")
def pace_left_out_of_the_record(folder: Folder) -> None:
    folder.data["pace"] = None


@PACE.lie("paced")
def pace_of_the_record_is_fast(folder: Folder) -> None:
    folder.data["pace"] = "fast"


@PACE.lie("paced")
def pace_of_nobody(folder: Folder) -> None:
    folder.data["pace"] = "leisurely"


@PACE.lie("paced")
def hands_that_react_at_once(folder: Folder) -> None:
    folder.data["approach"]["reaction_s"] = 0.01


@PACE.lie("paced")
def tool_speed_left_out_of_the_record(folder: Folder) -> None:
    folder.data["tool_speed_m_s"] = None


@PACE.lie("paced")
def tool_speed_of_the_record_raised(folder: Folder) -> None:
    folder.data["tool_speed_m_s"] *= 3.0


@PACE.lie("paced")
def jerk_limit_left_out_of_the_record(folder: Folder) -> None:
    folder.data["jerk_scale"] = None


@PACE.lie("paced")
def sway_left_out_of_the_record(folder: Folder) -> None:
    folder.data.update(sway_m=0.0, sway_deg=0.0)


@PACE.lie("paced", level=Level.HASHED)
def sway_of_the_request_doubled(folder: Folder) -> None:
    folder.request["options"].update(sway_m=0.02, sway_deg=2.0)


@PACE.lie("paced")
def law_that_moves_the_tool_a_twentieth_faster(folder: Folder) -> None:
    """Exceed the speed of tools, but no share of the joints' limits."""
    _speed_up(folder, 1.05)


@PACE.lie("paced")
def law_and_tool_speed_half_as_fast_again(folder: Folder) -> None:
    _speed_up(folder, 1.5)
    folder.data["tool_speed_m_s"] *= 1.5


@PACE.lie("paced", level=Level.HASHED)
def pace_of_the_request_is_careful(folder: Folder) -> None:
    folder.request["options"]["pace"] = "careful"


@PACE.lie("paced", level=Level.HASHED)
def tool_speed_of_the_request_lowered(folder: Folder) -> None:
    folder.request["options"]["tool_speed_m_s"] = 0.1


@PACE.lie("paced", level=Level.HASHED)
def careful_in_request_and_record(folder: Folder) -> None:
    folder.request["options"]["pace"] = folder.data["pace"] = "careful"


@PACE.lie("moving")
def rates_left_out_of_the_record(folder: Folder) -> None:
    folder.data.update(start_rates={}, end_rates={})


@PACE.lie("moving")
def rate_of_another_joint(folder: Folder) -> None:
    folder.data["start_rates"] = {"j2": 0.4}


@PACE.lie("moving")
def law_and_rates_a_tenth_faster(folder: Folder) -> None:
    _speed_up(folder, 1.1)
    for key in ("start_rates", "end_rates"):
        folder.data[key] = {name: 1.1 * rate for name, rate in folder.data[key].items()}


@PACE.lie("moving", level=Level.HASHED)
def law_a_hundredth_faster_than_the_rates(folder: Folder) -> None:
    _speed_up(folder, 1.01)


@PACE.lie("moving", level=Level.HASHED)
def request_that_begins_at_rest(folder: Folder) -> None:
    folder.request["start"]["rates"] = {}


def _speed_up(folder: Folder, factor: float) -> None:
    law = folder.curve["law"]
    law.update(times=[t / factor for t in law["times"]], speed=[factor * v for v in law["speed"]])
