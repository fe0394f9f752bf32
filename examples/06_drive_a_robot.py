"""A robot's driver carries out a certified plan: the driver logs what it is told.

Plans a reach, then runs it through `LoggedDriver`, pauses on the way, moves the hand's target 2 cm up and goes on.
Prints what the driver was told twice per second, the phases and the verdict.  A real driver replaces `LoggedDriver`:
the same four members, with the robot's own joints behind them.
"""

from pathlib import Path

import numpy as np

from service import Action, Execution, JointCommand, Order, PlannedReference, RobotReading, load_request, plan, track


class LoggedDriver:
    """A driver of no robot: its joints are where they are told to be; implements `RobotDriver`."""

    period_s = 0.001  # [s]

    def __init__(self, joint_names, start):
        self.joint_names = joint_names
        self.time_s = 0.0
        self.told = JointCommand(start, np.zeros_like(start), np.zeros_like(start))

    def read(self):
        """Return what the sensors say: here the last command, upright, without force sensors on the feet."""
        upright, gravity = np.eye(3), np.array([0.0, 0.0, 9.81])  # [m/s^2]
        return RobotReading(
            self.time_s,
            self.told.q,
            self.told.qd,
            upright,
            np.zeros(3),
            gravity,
            foot_wrenches={},
            torque=self.told.tau,
        )

    def command(self, command):
        """Hand a command to the servos and wait for the next cycle: here log it and return at once."""
        self.told = command
        self.time_s += self.period_s
        if round(self.time_s / self.period_s) % 500 == 0:
            elbow = self.joint_names.index("l_arm_elx")
            print(
                f"  {self.time_s:4.1f} s  l_arm_elx {command.q[elbow]:+.3f} rad, {command.qd[elbow]:+.3f} rad/s, "
                f"{command.tau[elbow]:+.1f} N m"
            )


result = plan(load_request(Path(__file__).parent / "requests" / "pose_goal.yaml"))
print(result.verdict.value)
reference = PlannedReference(result.motion)
driver = LoggedDriver(reference.joint_names, reference.at(0.0).q)
actions = [
    Action(0.4, Order.PAUSE),  # [s]
    Action(0.9, link="l_hand", offset=np.array([0.0, 0.0, 0.02])),  # [m]
    Action(1.5, Order.RESUME),
]
report = track(Execution(reference, driver), actions)
for change in report.changes:
    print(f"{change.at_s:.2f} s  {change.mode:8} {change.phase}  {change.reason}")
print(f"{report.verdict} in {report.run_s:.1f} s, a median cycle takes {report.control_ms[0]:.2f} ms")
