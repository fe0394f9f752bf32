"""Contacts that carry the force of a hold in physics: which faces press, how hard, and how far off their normals.

``python -m benchmarks.physics.contacts RESULT [--hand-friction MU] [--feed-forward K]``

Per phase and pair of a shape of the robot and a shape of the mechanism: the share of the phase in which they touch, the
mean force on the mechanism and the mean normal into it in the frame of the mechanism's link, the angle between the two,
and where the pair touches in that frame.  A closed gripper holds by an equality and has no contacts.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from benchmarks.tables import print_table
from service.demands.kind import read_mechanism_physics
from service.execution.reference import PlannedReference
from service.replay.replay import read_motion
from service.result.folder import read_result, result_path
from service.simulation.model import build_physics
from service.simulation.options import SimulationOptions
from service.simulation.robot import SimulatedRobot
from service.simulation.run import execute
from service.simulation.stand import read_recorded_request
from service.start.robot import resolve_stiffness

LEAST_N = 0.1  # of a force that counts [N]
HEADER = ("pair", "touches", "mean force [N]", "size", "normal", "off", "place [mm]")


@dataclass
class PairSamples:
    """Samples of one pair of shapes in one phase, in the frame of the mechanism's link.

    Attributes:
        forces, normals, places: force on the mechanism [N], normal into it, and point [m], force-weighted sums by time.
    """

    forces: dict[float, np.ndarray] = field(default_factory=dict)
    normals: dict[float, np.ndarray] = field(default_factory=dict)
    places: dict[float, np.ndarray] = field(default_factory=dict)

    def add(self, time_s: float, force: np.ndarray, normal: np.ndarray, place: np.ndarray) -> None:
        """Add one contact point."""
        size = float(np.linalg.norm(force))
        for table, value in ((self.forces, force), (self.normals, size * normal), (self.places, size * place)):
            table[time_s] = table.get(time_s, np.zeros(3)) + value

    def summarize(self, n_samples: int) -> tuple[str, ...]:
        """Return the cells after the pair's name; means are over the whole phase."""
        force = np.sum(list(self.forces.values()), axis=0) / n_samples
        normal = np.sum(list(self.normals.values()), axis=0)
        weight = max(float(np.linalg.norm(normal)), 1e-12)
        size = max(float(np.linalg.norm(force)), 1e-12)
        off = np.rad2deg(np.arccos(np.clip(force @ normal / (size * weight), -1.0, 1.0)))
        total = sum(float(np.linalg.norm(f)) for f in self.forces.values())
        place = 1e3 * np.sum(list(self.places.values()), axis=0) / max(total, 1e-12)
        return (
            f"{100.0 * len(self.forces) / n_samples:.0f} %",
            _format(force, 1), f"{size:.1f}", _format(normal / weight, 2), f"{off:.0f} deg", _format(place, 0),
        )  # fmt: skip


def _format(vector: Float[np.ndarray, "3"], digits: int) -> str:
    return " ".join(f"{value + 0.0:.{digits}f}" for value in vector)


def log_contacts(folder: str, options: SimulationOptions) -> dict[str, dict[tuple[str, str], tuple[str, ...]]]:
    """Carry out the plan of a result folder; return the cells of the table by phase and pair."""
    motion, request = read_motion(read_result(folder), result_path(folder).parent), read_recorded_request(folder)
    reference = PlannedReference(motion)
    model = build_physics(motion, read_mechanism_physics(request), options, resolve_stiffness(motion.robot, request))
    robot = SimulatedRobot(model, reference.at(0.0).configuration, options)
    frames: pin.Model = motion.robot.model
    data = frames.createData()
    counts: dict[str, int] = defaultdict(int)
    pairs: dict[str, dict[tuple[str, str], PairSamples]] = defaultdict(lambda: defaultdict(PairSamples))

    def look(time_s: float, seen: SimulatedRobot) -> None:
        if not 0.0 <= time_s <= reference.duration_s:
            return
        phase = reference.find_phase(time_s).name
        counts[phase] += 1
        pin.framesForwardKinematics(frames, data, seen.configuration())
        for contact in seen.list_contact_forces():
            links = (contact.first, contact.second)
            moved = [k for k in (0, 1) if links[k] in motion.mechanism_links]
            if len(moved) != 1 or np.linalg.norm(contact.force) < LEAST_N:
                continue
            sign = 1.0 if moved[0] == 1 else -1.0
            pose = data.oMf[frames.getFrameId(links[moved[0]])]
            turn = pose.rotation.T
            pair = (contact.shapes[1 - moved[0]], contact.shapes[moved[0]])
            pairs[phase][pair].add(
                time_s, sign * turn @ contact.force, sign * turn @ contact.normal,
                turn @ (contact.point - pose.translation),
            )  # fmt: skip

    execute(reference, robot, look=look)
    return {
        phase: {pair: samples.summarize(counts[phase]) for pair, samples in table.items()}
        for phase, table in pairs.items()
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one table per phase in which hand and mechanism touch."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.physics.contacts", description=__doc__.splitlines()[0])
    parser.add_argument("result")
    parser.add_argument("--hand-friction", type=float, default=0.3)
    parser.add_argument("--feed-forward", type=float, default=1.0)
    chosen = parser.parse_args(arguments)
    options = SimulationOptions(hand_friction=chosen.hand_friction, feed_forward=chosen.feed_forward)
    for phase, table in log_contacts(chosen.result, options).items():
        print_table(phase, HEADER, [(" on ".join(pair), *cells) for pair, cells in table.items()])


if __name__ == "__main__":
    main()
