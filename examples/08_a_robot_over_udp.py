"""A robot at the other end of a network: it follows commands in datagrams, and says where it is.

With a port it plays a fixed Atlas for a server, until Ctrl-C:

    python examples/08_a_robot_over_udp.py 7007
    scopt serve --robot udp,port=7007

Without one, a plan is carried out on it through the driver that the server uses. Prints where the elbow is twice per
second, and the verdict. A real robot's controller has the same few lines in its own language.
"""

import json
import socket
import sys
import threading
import time
from pathlib import Path

from service import Execution, PlannedReference, load_request, plan, prepare, track
from service.work.robot.udp import UdpDriver

PERIOD_S = 0.01  # between two commands
LAG_S = 0.02  # in which a servo comes to 63 % of what it is told
REQUEST = load_request(Path(__file__).parent / "requests" / "pose_goal.yaml")


class PlayedRobot:
    """A robot that answers every datagram with a reading, in the protocol of ``service.work.robot.udp``."""

    def __init__(self, joint_names, start, port=0):
        self.joint_names, self.q, self.qd = list(joint_names), [float(value) for value in start], [0.0] * len(start)
        self.tau, self.begin = [0.0] * len(start), time.monotonic()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))

    def describe(self):
        """Return what the sensors say."""
        return {"time_s": time.monotonic() - self.begin, "q": self.q, "qd": self.qd, "torque": self.tau}

    def answer(self, message):
        """Follow a command, and return the reading after it."""
        if "hello" in message:
            return {"joint_names": self.joint_names, "period_s": PERIOD_S, **self.describe()}
        share = PERIOD_S / (PERIOD_S + LAG_S)
        moved = [
            q + share * (wanted + LAG_S * speed - q)
            for q, wanted, speed in zip(self.q, message["q"], message["qd"], strict=True)
        ]
        self.qd = [(new - old) / PERIOD_S for new, old in zip(moved, self.q, strict=True)]
        self.q, self.tau = moved, message["tau"]
        return {"n": message["n"], **self.describe()}

    def run(self):
        """Answer until the program ends."""
        while True:
            data, sender = self.socket.recvfrom(65507)
            self.socket.sendto(json.dumps(self.answer(json.loads(data))).encode(), sender)


if len(sys.argv) > 1:
    setup = prepare(REQUEST)
    names = [name for name in setup.robot.joint_names if not name.startswith("base_")]
    start = [setup.start[setup.robot.joint_names.index(name)] for name in names]
    print(f"{len(names)} joints at 127.0.0.1:{sys.argv[1]}")
    PlayedRobot(names, start, int(sys.argv[1])).run()

result = plan(REQUEST)
print(result.verdict.value)
reference = PlannedReference(result.motion)
robot = PlayedRobot(reference.joint_names, reference.at(0.0).q)
threading.Thread(target=robot.run, daemon=True).start()
driver = UdpDriver(*robot.socket.getsockname())
elbow, told = driver.joint_names.index("l_arm_elx"), []


def look(cycle):
    """Print where the elbow is, twice per second of the plan."""
    if cycle.state.time_s >= 0.5 * len(told):
        told.append(cycle.state.time_s)
        print(f"  {cycle.state.time_s:4.1f} s  l_arm_elx {cycle.reading.q[elbow]:+.3f} rad")


report = track(Execution(reference, driver), on_cycle=look)
print(f"{report.verdict} {report.reason}".strip())
