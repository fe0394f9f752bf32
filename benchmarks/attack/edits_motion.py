"""Edits of the executed motion: samples, table, curve and time law."""

from __future__ import annotations

import numpy as np

from benchmarks.attack.forgery import Folder, Level, Registry

MOTION = Registry()
RAW = Level.RAW


@MOTION.lie("arm", "reach", "valve", level=RAW, stranger=True)
def one_sample_edited(folder: Folder) -> None:
    rows = folder.data["trajectory"]["positions"]
    rows[len(rows) // 2][-1] += 0.3


@MOTION.lie("arm", level=RAW)
def one_sample_edited_by_a_hundredth_of_a_millimetre(folder: Folder) -> None:
    folder.data["trajectory"]["positions"][7][0] += 1e-5


@MOTION.lie("arm", "reach", level=RAW, stranger=True)
def all_samples_edited(folder: Folder) -> None:
    folder.data["trajectory"]["positions"] = [[0.9 * x for x in row] for row in folder.data["trajectory"]["positions"]]


@MOTION.lie("arm", "reach", level=RAW)
def samples_in_another_order_of_joints(folder: Folder) -> None:
    names = folder.data["trajectory"]["joint_names"]
    names[-1], names[-2] = names[-2], names[-1]


@MOTION.lie("arm", "reach", level=RAW, stranger=True)
def times_halved(folder: Folder) -> None:
    folder.data["trajectory"]["times"] = [0.5 * t for t in folder.data["trajectory"]["times"]]


@MOTION.lie("arm", level=RAW)
def a_time_duplicated(folder: Folder) -> None:
    times = folder.data["trajectory"]["times"]
    times[3] = times[4]


@MOTION.lie("arm", level=RAW)
def a_sample_left_out(folder: Folder) -> None:
    for name in ("positions", "times"):
        folder.data["trajectory"][name].pop(5)


@MOTION.lie("arm", level=RAW)
def a_sample_with_null(folder: Folder) -> None:
    folder.data["trajectory"]["positions"][5][0] = None


@MOTION.lie("arm", level=RAW)
def a_sample_that_is_text(folder: Folder) -> None:
    folder.data["trajectory"]["positions"][5][0] = "0.1"


@MOTION.lie("arm", "reach", level=RAW, stranger=True)
def one_row_of_the_table_edited(folder: Folder) -> None:
    def change(rows: np.ndarray) -> np.ndarray:
        rows[len(rows) // 2, -1] += 0.3
        return rows

    folder.edit_table(change)


@MOTION.lie("arm", level=RAW, stranger=True)
def all_rows_of_the_table_edited(folder: Folder) -> None:
    folder.edit_table(lambda rows: np.column_stack([rows[:, 0], 0.9 * rows[:, 1:]]))


@MOTION.lie("arm", level=RAW, stranger=True)
def times_of_the_table_halved(folder: Folder) -> None:
    folder.edit_table(lambda rows: np.column_stack([0.5 * rows[:, 0], rows[:, 1:]]))


@MOTION.lie("arm", "reach", level=RAW, stranger=True)
def columns_of_the_table_renamed(folder: Folder) -> None:
    def change(text: str) -> str:
        header, _, rest = text.partition("\n")
        names = header.split(",")
        names[-1], names[-2] = names[-2], names[-1]
        return ",".join(names) + "\n" + rest

    folder.edit_text("trajectory.csv", change)


@MOTION.lie("arm", level=RAW)
def a_column_added_to_the_table(folder: Folder) -> None:
    folder.edit_table(lambda rows: np.column_stack([rows, np.ones(len(rows))]))


@MOTION.lie("arm", level=RAW)
def half_of_the_table_deleted(folder: Folder) -> None:
    folder.edit_table(lambda rows: rows[: len(rows) // 2])


@MOTION.lie("arm", level=RAW)
def a_row_of_the_table_repeated(folder: Folder) -> None:
    folder.edit_table(lambda rows: np.insert(rows, 5, rows[5], axis=0))


@MOTION.lie("arm", level=RAW)
def a_nan_in_the_table(folder: Folder) -> None:
    def change(rows: np.ndarray) -> np.ndarray:
        rows[5, 1] = np.nan
        return rows

    folder.edit_table(change)


@MOTION.lie("arm", level=RAW)
def a_comment_in_the_table(folder: Folder) -> None:
    # Readers of tables skip different rows: some read this one as part of the motion.
    folder.edit_text("trajectory.csv", lambda text: text.replace("\n", "\n#9,9,9,9,9,9\n", 3))


@MOTION.lie("arm", level=RAW)
def an_empty_table(folder: Folder) -> None:
    (folder.path / "trajectory.csv").write_text("", encoding="utf-8")


@MOTION.lie("arm", "reach", level=RAW)
def tangents_edited(folder: Folder) -> None:
    folder.curve["tangents"][3] = [v + 0.5 for v in folder.curve["tangents"][3]]


@MOTION.lie("arm", "untimed")
def hand_led_through_the_post_between_knots(folder: Folder) -> None:
    """Lead the hand straight to the goal, through the post between two knots."""
    positions = np.array(folder.curve["positions"])
    straight = np.linspace(positions[0], positions[-1], len(positions))
    folder.curve.update(positions=straight.tolist(), tangents=np.gradient(straight, axis=0).tolist())
    folder.curve["tangents"][0] = folder.curve["tangents"][-1] = [0.0] * positions.shape[1]


@MOTION.lie("arm", "reach")
def another_end(folder: Folder) -> None:
    folder.curve["positions"][-1][-1] += 0.4


@MOTION.lie("arm", "reach")
def another_start(folder: Folder) -> None:
    folder.curve["positions"][0][-1] += 0.1


@MOTION.lie("reach")
def feet_that_slide_by_5_mm(folder: Folder) -> None:
    rows = folder.curve["positions"]
    for row in rows[3:]:
        row[0] += 0.005


@MOTION.lie("arm", "untimed")
def a_joint_beyond_its_limit(folder: Folder) -> None:
    folder.curve["positions"][4][0] = 3.5


@MOTION.lie("arm", "reach", "valve", level=Level.HASHED, stranger=True)
def law_sped_up_tenfold(folder: Folder) -> None:
    law = folder.curve["law"]
    law.update(times=[0.1 * t for t in law["times"]], speed=[10.0 * v for v in law["speed"]])


@MOTION.lie("arm", "reach")
def law_sped_up_tenfold_and_remade(folder: Folder) -> None:
    law_sped_up_tenfold(folder)


@MOTION.lie("arm")
def law_sped_up_beyond_what_was_asked(folder: Folder) -> None:
    """Exceed the share of the robot's limits that the request allows, but not the limits."""
    law = folder.curve["law"]
    law.update(times=[t / 1.7 for t in law["times"]], speed=[1.7 * v for v in law["speed"]])


@MOTION.lie("arm", "reach")
def samples_so_few_that_corners_are_cut(folder: Folder) -> None:
    last = len(folder.curve["samples"]) - 1
    folder.curve["samples"] = [folder.curve["samples"][0], folder.curve["samples"][-1]]
    for phase in folder.phases:
        phase.update(first=0, last=1)
        for target in phase["targets"]:
            target["at"] = 1 if target.get("at") == last else target.get("at")


@MOTION.lie("arm", level=RAW)
def samples_run_backwards(folder: Folder) -> None:
    folder.curve["samples"].reverse()


@MOTION.lie("arm", level=RAW)
def knots_that_stand_still(folder: Folder) -> None:
    folder.curve["knots"][2] = folder.curve["knots"][1]


@MOTION.lie("arm", level=RAW)
def a_curve_with_another_joint(folder: Folder) -> None:
    folder.curve["joint_names"][0] = "neck"


@MOTION.lie("arm", level=RAW)
def a_curve_removed(folder: Folder) -> None:
    folder.data["curve"] = None


@MOTION.lie("arm", level=RAW)
def a_result_without_trajectory(folder: Folder) -> None:
    del folder.data["trajectory"]
