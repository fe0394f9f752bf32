"""Atlas moves its left hook over a table.

Prints the verdict and the checks of the certificate, and writes `out/reach_a_pose/viewer.html` to open in a browser.
The request is a dictionary here; `scopt plan examples/requests/pose_goal.yaml` reads a similar one from a file.
"""

from service import parse_request, plan, write_result

request = parse_request(
    {
        "robot": {"name": "atlas"},
        "start": {"posture": "stand"},
        "scene": {
            "obstacles": [
                {"name": "table", "type": "box", "size": [0.5, 1.2, 0.05], "position": [0.75, 0.0, 0.9]},
                {"name": "post", "type": "cylinder", "radius": 0.04, "height": 2.0, "position": [0.5, 0.45, 1.0]},
            ]
        },
        "goal": {
            "poses": [
                {
                    "link": "l_tool",
                    "position": [0.6, 0.2, 1.15],
                    "quaternion_wxyz": [0.7071068, 0.0, 0.7071068, 0.0],  # the axis of the hand points forward
                    "free_axis": "z",  # the hand may rotate about its own z axis
                }
            ]
        },
        "options": {"margin_m": 0.02, "balance_margin_m": 0.02},
    }
)

result = plan(request)
print(result.verdict.value, *result.explanation, sep="\n  ")
if result.certificate is not None:
    for check in result.certificate.checks:
        print(f"{'ok   ' if check.ok else 'FAILS'} {check.text}")
print(write_result(result, "out/reach_a_pose").viewer)
