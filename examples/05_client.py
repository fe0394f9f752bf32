"""A planning server plans a motion for this client.

Prints the progress, the verdict, the first and last angle of one joint, and the path of a viewer page.  First run
`scopt serve` in another terminal, then `python examples/05_client.py localhost:50051`.
"""

import sys

import numpy as np

from service import parse_request
from service.client import PlannerClient, PlannerError

TARGET = sys.argv[1] if len(sys.argv) > 1 else "localhost:50051"
request = parse_request(
    {
        "robot": {"name": "atlas"},
        "start": {"posture": "stand"},
        # A local cloud file is uploaded: "scene": {"cloud": "scan.pcd"}.
        "scene": {
            "obstacles": [{"name": "table", "type": "box", "size": [0.5, 1.2, 0.05], "position": [0.75, 0.0, 0.9]}]
        },
        "goal": {"poses": [{"link": "l_tool", "position": [0.6, 0.2, 1.15], "position_tolerance_m": 0.005}]},
        "options": {"time_limit_s": 30.0},
    }
)


def show(event):
    """Print one line for the place in the queue, each step and each reported iteration."""
    if event.HasField("queued"):
        print(f"behind {event.queued.place}, about {event.queued.expected_wait_s:.1f} s")
    elif event.HasField("progress") and event.progress.HasField("iteration"):
        iteration = event.progress.iteration
        print(f"     iteration {iteration.index}: merit {iteration.merit:.4g}, mu {iteration.mu:g}")
    elif event.HasField("progress"):
        print(f"{100 * event.progress.fraction:3.0f} % {event.progress.step}")


with PlannerClient(TARGET) as client:
    try:
        plan = client.plan(request, out="out/client", on_progress=show, deadline_s=60.0)
    except PlannerError as error:
        sys.exit("\n".join([error.code.name, *error.problems]))

print(plan.verdict, *plan.result.explanation)
motion = plan.result.trajectory
positions = np.reshape(motion.positions, (len(motion.times), len(motion.joint_names)))  # [m, rad], one row per sample
elbow = positions[:, list(motion.joint_names).index("l_arm_elx")]
print(f"l_arm_elx {elbow[0]:.2f} -> {elbow[-1]:.2f} rad in {motion.times[-1]:.1f} s")
print(f"{plan.folder}/viewer.html shows it; `scopt review {plan.plan_id} --target {TARGET} --accept` approves it")
