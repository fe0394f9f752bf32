"""Edits of the promises and borders of phases, with the certificate computed again."""

from __future__ import annotations

from benchmarks.attack.edits_contacts import allowance, hand_of
from benchmarks.attack.forgery import Folder, Level, Registry

PROMISES = Registry()


@PROMISES.lie("arm", "reach", "carry", "valve", "program")
def targets_removed(folder: Folder) -> None:
    for phase in folder.phases:
        phase["targets"] = []


@PROMISES.lie("arm")
def one_target_removed(folder: Folder) -> None:
    folder.phases[-1]["targets"].pop(0)


@PROMISES.lie("reach", "carry", stranger=True)
def target_moved_by_12_mm(folder: Folder) -> None:
    folder.targets("pose")[0]["position"][2] += 0.012


@PROMISES.lie("reach", "carry")
def target_moved_by_4_mm(folder: Folder) -> None:
    target = folder.targets("pose")[0]
    target["position"][0] -= 0.004
    target["position_tolerance_m"] = [0.009, 0.009, 0.009]


@PROMISES.lie("arm", "untimed")
def joint_target_moved_within_a_wider_tolerance(folder: Folder) -> None:
    target = folder.targets("joint")[0]
    target.update(value=target["value"] + 0.2, tolerance=0.5)


@PROMISES.lie("reach", "carry")
def target_tolerance_loosened(folder: Folder) -> None:
    folder.targets("pose")[0]["position_tolerance_m"] = [0.5, 0.5, 0.5]


@PROMISES.lie("reach", "carry")
def target_free_along_one_axis(folder: Folder) -> None:
    folder.targets("pose")[0]["position_tolerance_m"][2] = None


@PROMISES.lie("reach")
def target_of_another_link(folder: Folder) -> None:
    folder.targets("pose")[0].update(frame="pelvis", position_tolerance_m=[9.0, 9.0, 9.0])


@PROMISES.lie("arm")
def target_of_another_joint(folder: Folder) -> None:
    first, second = folder.targets("joint")[:2]
    first.update(joint=second["joint"], value=second["value"])


@PROMISES.lie("arm", "reach")
def target_asked_for_at_the_start(folder: Folder) -> None:
    for target in folder.phases[-1]["targets"]:
        target["at"] = 0
        for name in ("tolerance", "position_tolerance_m"):
            if name in target:
                target[name] = 9.0 if name == "tolerance" else [9.0, 9.0, 9.0]


@PROMISES.lie("carry")
def kept_pose_removed(folder: Folder) -> None:
    folder.phases[0]["targets"] = folder.targets("pose")


@PROMISES.lie("carry")
def kept_pose_loosened(folder: Folder) -> None:
    folder.targets("relative_pose")[0].update(position_tolerance_m=0.2, rotation_tolerance_deg=90.0)


@PROMISES.lie("carry")
def kept_pose_relative_to_itself(folder: Folder) -> None:
    folder.targets("relative_pose")[0].update(
        reference="r_hand", position=[0.0, 0.0, 0.0], quaternion_wxyz=[1.0, 0.0, 0.0, 0.0]
    )


@PROMISES.lie("carry")
def kept_pose_about_a_free_axis(folder: Folder) -> None:
    folder.targets("relative_pose")[0]["free_axis"] = [0.0, 0.0, 1.0]


@PROMISES.lie("valve")
def circle_moved_by_4_mm(folder: Folder) -> None:
    folder.targets("circle")[0]["centre"][2] += 0.004


@PROMISES.lie("valve")
def circle_4_mm_wider(folder: Folder) -> None:
    folder.targets("circle")[0]["radius"] += 0.004


@PROMISES.lie("valve")
def circle_tolerance_loosened(folder: Folder) -> None:
    folder.targets("circle")[0]["tolerance_m"] = 0.1


@PROMISES.lie("valve")
def circle_axis_freed(folder: Folder) -> None:
    folder.targets("circle")[0].update(frame_axis=None, axis_tolerance_deg=None)


@PROMISES.lie("valve")
def circle_of_another_frame(folder: Folder) -> None:
    folder.targets("circle")[0].update(frame="valve", radius=0.0, frame_axis=[0.0, 0.0, 1.0], axis_tolerance_deg=180.0)


@PROMISES.lie("valve")
def circle_removed(folder: Folder) -> None:
    for phase in folder.phases:
        phase["targets"] = [target for target in phase["targets"] if target["kind"] != "circle"]


@PROMISES.lie("valve")
def angle_of_the_wheel_no_longer_asked_for(folder: Folder) -> None:
    for phase in folder.phases:
        phase["targets"] = [target for target in phase["targets"] if target["kind"] != "joint"]


@PROMISES.lie("valve")
def angle_of_the_wheel_turned_round(folder: Folder) -> None:
    target = folder.targets("joint")[0]
    target.update(value=-target["value"], tolerance=9.0)


@PROMISES.lie("valve")
def phases_merged_into_one(folder: Folder) -> None:
    first, last = folder.phases[1], folder.phases[-1]
    targets = [target for phase in folder.phases for target in phase["targets"] if target["kind"] == "joint"]
    folder.data["phases"] = [{**first, "first": 0, "last": last["last"], "targets": targets}]


@PROMISES.lie("valve")
def border_of_the_first_phase_shifted(folder: Folder) -> None:
    reach, insert = folder.phases[:2]
    reach["last"] = insert["first"] = reach["last"] // 2


@PROMISES.lie("valve")
def the_turn_made_shorter(folder: Folder) -> None:
    turn, retract = folder.phases[2:]
    turn["last"] = retract["first"] = turn["first"] + 2
    turn["targets"] = [target for target in turn["targets"] if target["kind"] != "joint"]


@PROMISES.lie("valve")
def retraction_left_out(folder: Folder) -> None:
    folder.data["phases"] = folder.phases[:3]


@PROMISES.lie("valve")
def turn_and_retraction_renamed(folder: Folder) -> None:
    folder.phases[2]["name"], folder.phases[3]["name"] = "retract", "turn"


@PROMISES.lie("reach")
def a_phase_called_escape_put_first(folder: Folder) -> None:
    reach = folder.phases[0]
    touching = allowance(hand_of(folder), ("scene", None, "table"), 0.05)
    escape = {**reach, "name": "escape", "last": 20, "targets": [], "allowances": [*reach["allowances"], touching]}
    reach["first"] = 20
    folder.data["phases"] = [escape, reach]


@PROMISES.lie("arm", level=Level.RAW)
def no_phases(folder: Folder) -> None:
    folder.data["phases"] = []


@PROMISES.lie("reach", level=Level.HASHED)
def support_margin_that_is_no_number(folder: Folder) -> None:
    folder.phases[0]["support"]["margin_m"] = None
