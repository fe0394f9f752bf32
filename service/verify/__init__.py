"""The independent verifier: a motion goes in, a certificate comes out.

Read in this order:

- ``motion``: the input, a motion with what its phases promise; ``validation`` rejects a malformed one
- ``verifier``: the sequence of checks, and how to add one
- ``limits``, ``stance_checks``, ``ground``, ``mechanism_checks``: the checks
- ``targets``: errors of poses, and the checks of targets
- ``carrying``: what carries movable objects, and whether it holds them
- ``forces``: equilibrium under the loads of hands, and inverse dynamics
- ``clearance``: the checks of all pairs that may meet
- ``resting``: the same of single poses at rest, for poses that are led by hand
- ``coverage``: what was checked, what was left out, and which checks a motion requires
- ``certificate``: the output as data; ``hashes`` ties it to its robot, scene and promises
- ``prepared_motion``, ``curve_bounds``, ``joint_chain``, ``frame_paths``, ``phase_proof``, ``solids``, ``timeline``:
  shared by the proofs; ``rounding``: numbers in the texts of checks

What other folders need is imported from here; nobody else imports its modules.
"""

from service.verify.carrying.carriers import (
    Carrier,
    Grip,
)
from service.verify.carrying.checks import (
    REST_MARGIN_M,
    find_grip_slowdown,
    place_resting,
)
from service.verify.carrying.grasp import (
    GRAVITY,
    Held,
)
from service.verify.carrying.placing import (
    place_frames,
    split_motion,
)
from service.verify.carrying.sharing import (
    share_weight,
)
from service.verify.carrying.stacks import (
    measure_rests,
)
from service.verify.certificate import (
    Basis,
    Certificate,
    Check,
    Exempt,
    Status,
    Stretches,
    Where,
)
from service.verify.clearance.pairs import (
    collect_pairs,
)
from service.verify.clearance.swaying import bound_largest_sway
from service.verify.coverage.pressed import (
    is_shown,
)
from service.verify.coverage.required import (
    list_waived_checks,
)
from service.verify.forces.contact_forces import (
    ContactShare,
    Joints,
    is_held,
)
from service.verify.forces.dynamics import (
    compute_forces,
    compute_inverse_dynamics,
    find_limited_joints,
    list_levers,
    list_sample_times,
    make_contact_share,
    make_joints,
    map_axes,
)
from service.verify.forces.frame_speeds import (
    FrameSpeed,
    list_frame_speeds,
    list_press_speeds,
    list_tools,
    measure_rates,
)
from service.verify.forces.hand_balance import (
    LEAST_APART_M,
    LEAST_SHARE,
    Meeting,
    find_jamming_angle,
    measure_excess,
    meet,
)
from service.verify.forces.hand_contacts import (
    PushPath,
    describe_failure,
    find_pushed_body,
)
from service.verify.forces.hand_loads import (
    LoadCase,
    bound_coordinate,
    list_load_cases,
    list_world_wrenches,
    measure_retreat,
)
from service.verify.forces.linear_program import LinearProgram
from service.verify.forces.load_limits import (
    LoadLimits,
    find_loaded_hand,
    limit_loads,
)
from service.verify.forces.loaded_balance import (
    Ground,
    find_normals,
    find_tilts,
)
from service.verify.forces.rounded import (
    measure_beyond_hull,
    shrink_hull,
)
from service.verify.frame_paths import (
    find_mechanism_joints,
    trace_frame,
)
from service.verify.ground import (
    GROUND_TOLERANCE_M,
    MOST_LEAN_RAD,
    STANDING_DEPTH_M,
    TURNING_DEPTH_M,
    UNSEEN_KIND,
    describe_gap,
    find_ground_gaps,
    find_surface_gaps,
)
from service.verify.hashes import (
    bodies_hash,
    link_vertices,
    promises_hash,
    robot_hash,
    scene_hash,
)
from service.verify.limits import (
    RISE_S,
    measure_jerks,
    measure_timed_peaks,
    place_rates,
)
from service.verify.motion import (
    DEFAULT_APPROACH,
    HAND_CAP_N,
    HAND_DRIFT_M,
    NO_SWAY,
    WORLD,
    Approach,
    AxisTarget,
    CircleTarget,
    HandContact,
    HandLoad,
    HandPush,
    HeldJoint,
    HoleTarget,
    JointTarget,
    JointWayTarget,
    LoadedRegion,
    Motion,
    Phase,
    PlantedContact,
    PoseTarget,
    PressedPart,
    Profile,
    RelativePoseTarget,
    SupportPolygon,
    Sway,
    Target,
    VerifyError,
    VerifySettings,
    WayTarget,
)
from service.verify.polygons import (
    describe_inside,
    outside_polygon,
)
from service.verify.prepared_motion import (
    ForwardKinematics,
    Placements,
    PreparedMotion,
)
from service.verify.regions.region import RegionTarget
from service.verify.resting import (
    PairDistance,
    RestingPose,
    RestingPoses,
)
from service.verify.rounding import (
    round_down,
)
from service.verify.solids import (
    CoalSolid,
    DistanceQuery,
    make_coal_convex,
)
from service.verify.targets.pose_errors import (
    limits_rotation,
    list_position_demands,
    measure_angle,
    measure_lean,
    offset_from_target,
)
from service.verify.targets.ways import (
    evaluate_profile,
)
from service.verify.timeline import (
    find_time,
    find_times,
    list_phases,
)
from service.verify.verifier import (
    verify,
)

__all__ = [
    "DEFAULT_APPROACH",
    "GRAVITY",
    "GROUND_TOLERANCE_M",
    "HAND_CAP_N",
    "HAND_DRIFT_M",
    "LEAST_APART_M",
    "LEAST_SHARE",
    "MOST_LEAN_RAD",
    "NO_SWAY",
    "REST_MARGIN_M",
    "RISE_S",
    "STANDING_DEPTH_M",
    "TURNING_DEPTH_M",
    "UNSEEN_KIND",
    "WORLD",
    "Approach",
    "AxisTarget",
    "Basis",
    "Carrier",
    "Certificate",
    "Check",
    "CircleTarget",
    "CoalSolid",
    "ContactShare",
    "DistanceQuery",
    "Exempt",
    "ForwardKinematics",
    "FrameSpeed",
    "Grip",
    "Ground",
    "HandContact",
    "HandLoad",
    "HandPush",
    "Held",
    "HeldJoint",
    "HoleTarget",
    "JointTarget",
    "JointWayTarget",
    "Joints",
    "LinearProgram",
    "LoadCase",
    "LoadLimits",
    "LoadedRegion",
    "Meeting",
    "Motion",
    "PairDistance",
    "Phase",
    "Placements",
    "PlantedContact",
    "PoseTarget",
    "PreparedMotion",
    "PressedPart",
    "Profile",
    "PushPath",
    "RegionTarget",
    "RelativePoseTarget",
    "RestingPose",
    "RestingPoses",
    "Status",
    "Stretches",
    "SupportPolygon",
    "Sway",
    "Target",
    "VerifyError",
    "VerifySettings",
    "WayTarget",
    "Where",
    "bodies_hash",
    "bound_coordinate",
    "bound_largest_sway",
    "collect_pairs",
    "compute_forces",
    "compute_inverse_dynamics",
    "describe_failure",
    "describe_gap",
    "describe_inside",
    "evaluate_profile",
    "find_grip_slowdown",
    "find_ground_gaps",
    "find_jamming_angle",
    "find_limited_joints",
    "find_loaded_hand",
    "find_mechanism_joints",
    "find_normals",
    "find_pushed_body",
    "find_surface_gaps",
    "find_tilts",
    "find_time",
    "find_times",
    "is_held",
    "is_shown",
    "limit_loads",
    "limits_rotation",
    "link_vertices",
    "list_frame_speeds",
    "list_levers",
    "list_load_cases",
    "list_phases",
    "list_position_demands",
    "list_press_speeds",
    "list_sample_times",
    "list_tools",
    "list_waived_checks",
    "list_world_wrenches",
    "make_coal_convex",
    "make_contact_share",
    "make_joints",
    "map_axes",
    "measure_angle",
    "measure_beyond_hull",
    "measure_excess",
    "measure_jerks",
    "measure_lean",
    "measure_rates",
    "measure_rests",
    "measure_retreat",
    "measure_timed_peaks",
    "meet",
    "offset_from_target",
    "outside_polygon",
    "place_frames",
    "place_rates",
    "place_resting",
    "promises_hash",
    "robot_hash",
    "round_down",
    "scene_hash",
    "share_weight",
    "shrink_hull",
    "split_motion",
    "trace_frame",
    "verify",
]
