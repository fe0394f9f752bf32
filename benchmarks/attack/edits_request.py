"""Edits of the request in a folder, with its hash computed again."""

from __future__ import annotations

from benchmarks.attack.forgery import Folder, Level, Registry

REQUEST = Registry()
ARMS = ("arm", "untimed", "program")
STANDING = ("reach", "carry", "valve")
HASHED = Level.HASHED


@REQUEST.lie("arm", level=HASHED)
def joint_goal_moved_by_03_rad(folder: Folder) -> None:
    folder.request["goal"]["joints"]["yaw"] -= 0.3


@REQUEST.lie("arm", "untimed", level=HASHED)
def joint_goal_moved_by_3_mrad(folder: Folder) -> None:
    folder.request["goal"]["joints"]["elbow"] += 0.003


@REQUEST.lie("arm", level=HASHED)
def a_joint_goal_changed_and_its_target_dropped(folder: Folder) -> None:
    folder.data["phases"][-1]["targets"] = [t for t in folder.targets("joint") if t["joint"] != "roll"]
    folder.request["goal"]["joints"]["roll"] = -0.8


@REQUEST.lie("reach", "carry", level=HASHED)
def pose_goal_moved_by_30_cm(folder: Folder) -> None:
    folder.request["goal"]["poses"][0]["position"][2] += 0.3


@REQUEST.lie("reach", "carry", level=HASHED)
def pose_goal_moved_by_12_mm(folder: Folder) -> None:
    folder.request["goal"]["poses"][0]["position"][1] += 0.012


@REQUEST.lie("reach", level=HASHED)
def orientation_added_to_the_goal(folder: Folder) -> None:
    folder.request["goal"]["poses"][0]["quaternion_wxyz"] = [0.0, 1.0, 0.0, 0.0]


@REQUEST.lie("reach", level=HASHED)
def goal_of_the_other_hand(folder: Folder) -> None:
    folder.request["goal"]["poses"][0]["link"] = "r_tool"


@REQUEST.lie("reach", level=HASHED)
def a_second_goal_pose(folder: Folder) -> None:
    second = {**folder.request["goal"]["poses"][0], "link": "r_tool", "position": [0.5, -0.25, 1.1]}
    folder.request["goal"]["poses"].append(second)


@REQUEST.lie("reach", level=HASHED)
def goal_becomes_a_posture(folder: Folder) -> None:
    folder.request["goal"] = {"joints": {}, "poses": [], "posture": "reach_ready"}


@REQUEST.lie("arm", "reach", level=HASHED)
def wall_added_in_the_way(folder: Folder) -> None:
    place = [0.55, 0.25, 0.95] if folder.data["robot"]["name"] != "arm" else [0.0, 0.0, 0.9]
    folder.request["scene"]["obstacles"].append(
        {"name": "new_wall", "type": "box", "size": [0.3, 0.3, 0.5], "position": place, "quaternion_wxyz": [1, 0, 0, 0]}
    )


@REQUEST.lie("arm", level=HASHED)
def post_raised_into_the_motion(folder: Folder) -> None:
    folder.request["scene"]["obstacles"][0]["size"][2] = 2.4


@REQUEST.lie("reach", level=HASHED)
def box_moved_into_the_hand(folder: Folder) -> None:
    folder.request["scene"]["obstacles"][1]["position"] = [0.60, 0.25, 1.05]


@REQUEST.lie("reach", level=HASHED)
def floor_of_the_request_raised_by_10_cm(folder: Folder) -> None:
    folder.request["scene"]["floor"] = 0.1


@REQUEST.lie("reach", level=HASHED)
def floor_of_the_request_removed(folder: Folder) -> None:
    folder.request["scene"]["floor"] = False


@REQUEST.lie("arm", "program", level=HASHED)
def start_of_the_request_moved(folder: Folder) -> None:
    folder.request["start"]["joints"]["shoulder"] += 0.2


@REQUEST.lie("reach", level=HASHED)
def start_posture_of_the_request_changed(folder: Folder) -> None:
    folder.request["start"]["posture"] = "reach_ready"


@REQUEST.lie("reach", level=HASHED)
def start_base_of_the_request_moved(folder: Folder) -> None:
    folder.request["start"]["base"] = {"position": [1.0, 0.0, 0.93], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}


@REQUEST.lie("reach", level=HASHED)
def a_kept_pose_demanded_afterwards(folder: Folder) -> None:
    folder.request["keep"].append(
        {
            "link": "l_hand",
            "relative_to": None,
            "position": None,
            "quaternion_wxyz": None,
            "position_tolerance_m": 0.005,
            "rotation_tolerance_deg": 1.0,
            "free_axis": "none",
        }
    )


@REQUEST.lie("carry", level=HASHED)
def kept_pose_demanded_to_a_tenth_of_a_millimetre(folder: Folder) -> None:
    folder.request["keep"][0]["position_tolerance_m"] = 1e-4


@REQUEST.lie("carry", level=HASHED)
def kept_pose_demanded_elsewhere(folder: Folder) -> None:
    kept = folder.targets("relative_pose")[0]
    folder.request["keep"][0]["position"] = [kept["position"][0] + 0.05, *kept["position"][1:]]


@REQUEST.lie("carry", level=HASHED)
def carried_beam_longer_than_checked(folder: Folder) -> None:
    folder.request["attached"][0]["size"][1] = 2.5


@REQUEST.lie("carry", level=HASHED)
def carried_beam_of_60_kg(folder: Folder) -> None:
    folder.request["attached"][0]["mass_kg"] = 60.0


@REQUEST.lie("reach", level=HASHED)
def something_carried_that_was_never_checked(folder: Folder) -> None:
    folder.request["attached"].append(
        {
            "name": "pole",
            "position": [0.0, 0.0, 0.0],
            "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0],
            "type": "box",
            "size": [0.05, 1.8, 0.05],
            "link": "l_hand",
            "touches": [],
            "mass_kg": 1.0,
        }
    )


@REQUEST.lie("reach", "valve", level=HASHED)
def hook_of_the_request_20_cm_longer(folder: Folder) -> None:
    folder.request["robot"]["tool_distance_m"] = 0.32


@REQUEST.lie("arm", level=HASHED)
def another_robot_in_the_request(folder: Folder) -> None:
    folder.request["robot"].update(name="atlas", urdf=None, srdf=None)


@REQUEST.lie("arm", level=HASHED)
def a_tenth_of_the_speed_demanded(folder: Folder) -> None:
    folder.request["options"].update(velocity_scale=0.02)


@REQUEST.lie("arm", level=HASHED)
def a_tenth_of_the_acceleration_demanded(folder: Folder) -> None:
    folder.request["options"].update(acceleration_scale=0.03)


@REQUEST.lie("reach", level=HASHED)
def balance_margin_demanded_that_was_not_kept(folder: Folder) -> None:
    folder.request["options"]["balance_margin_m"] = 0.125


@REQUEST.lie("reach", level=HASHED)
def standing_on_one_foot_demanded(folder: Folder) -> None:
    folder.request["options"]["feet"] = ["l_foot"]


@REQUEST.lie("untimed", level=HASHED)
def an_untimed_path_for_a_timed_request(folder: Folder) -> None:
    folder.request["options"]["timed"] = True


@REQUEST.lie("arm", "reach")
def time_law_removed_from_a_timed_result(folder: Folder) -> None:
    folder.curve["law"] = None


@REQUEST.lie("valve", level=HASHED)
def turn_backwards(folder: Folder) -> None:
    folder.request["task"]["valve"]["turn_deg"] *= -1.0


@REQUEST.lie("valve", level=HASHED)
def turn_six_times_as_far(folder: Folder) -> None:
    folder.request["task"]["valve"]["turn_deg"] *= 6.0


@REQUEST.lie("valve")
def turn_six_times_as_far_and_say_so(folder: Folder) -> None:
    folder.request["task"]["valve"]["turn_deg"] *= 6.0
    folder.data["figures"]["turned_deg"] *= 6.0
    for phase in folder.phases:
        phase["targets"] = [t for t in phase["targets"] if t["kind"] != "joint"]


@REQUEST.lie("valve", level=HASHED)
def valve_of_the_request_moved_by_4_mm(folder: Folder) -> None:
    folder.request["task"]["valve"]["centre"][2] += 0.004


@REQUEST.lie("valve", level=HASHED)
def valve_of_the_request_4_mm_wider(folder: Folder) -> None:
    folder.request["task"]["valve"]["radius"] += 0.004


@REQUEST.lie("valve", level=HASHED)
def axis_of_the_request_tilted(folder: Folder) -> None:
    folder.request["task"]["valve"]["axis"] = [-0.98, 0.0, 0.199]


@REQUEST.lie("valve", level=HASHED)
def other_hand_demanded(folder: Folder) -> None:
    folder.request["task"]["valve"]["hand"] = "right"


@REQUEST.lie("valve", level=HASHED)
def grasp_demanded_of_a_hook(folder: Folder) -> None:
    folder.request["task"]["valve"]["mode"] = "grasp"


@REQUEST.lie("valve", level=HASHED)
def task_replaced_by_a_goal(folder: Folder) -> None:
    folder.request.update(task=None, goal={"joints": {"l_arm_elx": 1.6}, "poses": [], "posture": None})


@REQUEST.lie("program", level=HASHED)
def goal_of_the_program_moved(folder: Folder) -> None:
    folder.request["task"]["trajopt"]["constraints"][0]["params"]["vals"][0] += 0.3


@REQUEST.lie("program", level=HASHED)
def slow_tool_demanded_of_the_program(folder: Folder) -> None:
    folder.request["task"]["trajopt"]["constraints"].append(
        {"type": "cart_vel", "params": {"link": "hand", "first_step": 0, "last_step": 7, "max_displacement": 0.01}}
    )


@REQUEST.lie("arm", "reach", level=HASHED)
def a_request_without_goal(folder: Folder) -> None:
    folder.request["goal"] = None


@REQUEST.lie("arm", level=HASHED)
def an_empty_request(folder: Folder) -> None:
    folder.data["request"] = {}


@REQUEST.lie("arm", level=HASHED)
def a_request_that_is_no_mapping(folder: Folder) -> None:
    folder.data["request"] = [1, 2, 3]


@REQUEST.lie("arm", level=HASHED)
def an_unknown_demand(folder: Folder) -> None:
    folder.request["forbidden_region"] = {"position": [0.0, 0.0, 0.9], "radius": 0.5}


@REQUEST.lie("arm", "reach", level=Level.RAW, stranger=True)
def request_changed_without_its_hash(folder: Folder) -> None:
    folder.request["options"]["seed"] = 7
