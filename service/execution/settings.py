"""Settings of an execution."""

from __future__ import annotations

from dataclasses import dataclass, field

from service.execution.gains import PRESETS, PoseGains
from service.execution.guards import GuardSettings
from service.execution.hands.relief import ReliefSettings
from service.execution.machine import MachineSettings
from service.execution.sensing.estimator import SensorNoise
from service.execution.sensing.filters import PidGains
from service.execution.shift import ShiftLimits
from service.execution.stance.capture_point import BalanceSettings
from service.execution.stance.touchdown import TouchdownSettings
from service.execution.watch.watch import WatchSettings
from service.execution.yielding import YieldSettings


@dataclass(frozen=True)
class ExecutionSettings:
    """Settings of an execution.

    Attributes:
        gains: of the pose control.
        machine: of the plan's clock.
        guards: limits of the forces.
        watch: limits of sensors and servos, and the servos' law.
        touchdown: of feet that land; None lands them stiff, and their ankles follow the plan.
        balance: of ankles while feet alone carry the robot; None for ankles that follow the plan.
        shifts: how fast operator's displacements of targets come.
        hand_gains: PID control that corrects where the hands are measured to be [m per m]; None for none.  It rests
            while hands press on a mechanism, and in plans that plant arms.
        relief: of hands that press on a mechanism; None to hold them as stiff as the servos are.
        load_gain: speed at which both feet, while they alone are planted, move up and down against each other per
            newton by which they share the weight otherwise than planned; 0 for none [m/(N s)].
        yielding: of arms in contact; None to hold them as stiff as the servos are.
        noise: of the sensors, for the pelvis estimator.
    """

    gains: PoseGains = PRESETS["follow"]
    machine: MachineSettings = field(default_factory=MachineSettings)
    guards: GuardSettings = field(default_factory=GuardSettings)
    watch: WatchSettings = field(default_factory=WatchSettings)
    touchdown: TouchdownSettings | None = field(default_factory=TouchdownSettings)
    balance: BalanceSettings | None = field(default_factory=BalanceSettings)
    shifts: ShiftLimits = field(default_factory=ShiftLimits)
    hand_gains: PidGains | None = field(default_factory=lambda: PidGains(kp=0.0, ki=2.0, limit=0.05))
    relief: ReliefSettings | None = field(default_factory=ReliefSettings)
    load_gain: float = 4e-5
    yielding: YieldSettings | None = field(default_factory=YieldSettings)
    noise: SensorNoise = field(default_factory=SensorNoise)
