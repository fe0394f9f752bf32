"""Objects that hands carry in a result: where they are in each phase, and whether what carries them can hold them.

A part of `check_certificate.py`; imports only numpy and pinocchio.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin
from replayed_motion import Array, Replay

GRAVITY, PAD_GAP_M, REST_GAP_M, STILL_M = 9.81, 2.5e-3, 3.5e-3, 2e-3
Part = tuple[Replay, dict[str, Any], list[dict[str, Any]]]
"""A replay whose model has the objects, the data with their bodies, and the phases in which both hold."""


def split(replay: Replay, data: dict[str, Any]) -> Iterator[Part]:
    """Yield the motion between changes of carriers; an object stays where it is in the world at each of them."""
    objects = data.get("objects") or []
    if not objects:
        yield replay, data, data["phases"]
        return
    poses = {item["name"]: _pose(item["start"]) for item in objects}
    before: dict[str, str | None] = dict.fromkeys(poses)
    for links, group in itertools.groupby(
        data["phases"], key=lambda p: [(c["object"], c["link"]) for c in p["carriers"]]
    ):
        phases, wanted = list(group), dict(links)
        if wanted.keys() != poses.keys():
            raise SystemExit(f"{phases[0]['name']}: not every object is carried")
        s = replay.samples[phases[0]["first"]]
        for name, link in wanted.items():
            poses[name] = _frame(replay, link, s).actInv(_frame(replay, before[name], s) * poses[name])
        before, own = wanted, copy.copy(replay)
        own.model = replay.model.copy()
        for item in objects:
            link, pose = wanted[item["name"]], poses[item["name"]]
            frame = pin.Frame("", 0, pin.SE3.Identity(), pin.FrameType.BODY)
            frame = replay.model.frames[replay.model.getFrameId(link)] if link else frame
            place = frame.placement * pose
            own.model.addBodyFrame(item["name"], int(frame.parentJoint), place, -1)
            if link:
                inertia = pin.Inertia(item["mass_kg"], np.array(item["centre"]), np.array(item["moments"]))
                own.model.appendBodyToJoint(int(frame.parentJoint), inertia, place)
        bodies = [{"name": i["name"], "link": i["name"], "vertices": i["vertices"]} for i in objects]
        yield own, {**data, "bodies": [*data["bodies"], *bodies]}, phases


def held(
    replay: Replay,
    data: dict[str, Any],
    phase: dict[str, Any],
    closest: Callable[[Array, Array, float], tuple[float, Array]],
) -> Iterator[tuple[str, bool, str]]:
    """Check that pads lie on what hands carry and could hold its weight, and that all else rests on something."""
    first, last = (replay.samples[phase[end]] for end in ("first", "last"))
    for carrier in phase.get("carriers", ()):
        item = next(item for item in data["objects"] if item["name"] == carrier["object"])
        name, weight = f"{phase['name']}: {item['name']}", _weigh(item, phase)
        if carrier["link"] is None:
            yield (name, *_rests(replay, data, item, first))
            continue
        gaps, moved = [], []
        for finger in itertools.chain.from_iterable(grip["fingers"] for grip in carrier["grips"]):
            bodies = [np.array(body["vertices"]) for body in data["bodies"] if body["link"] == finger]
            seen = [
                [_see(replay, item["name"], finger, body, s) for body in bodies] for s in np.linspace(first, last, 9)
            ]
            gaps.append(min(closest(body, np.array(item["vertices"]), PAD_GAP_M)[0] for body in seen[0]))
            moved += [np.linalg.norm(b - a, axis=1).max() for row in seen for a, b in zip(seen[0], row, strict=True)]
        most = sum(2.0 * grip["force_n"] * grip["friction"] for grip in carrier["grips"])
        text = (
            f"pads within {1e3 * max(gaps):.1f} mm, moving {1e3 * max(moved):.2f} mm, {weight / most:.0%} of the grip"
        )
        yield name, max(gaps) <= PAD_GAP_M and max(moved) <= STILL_M and weight <= most, text


def _weigh(item: dict[str, Any], phase: dict[str, Any]) -> float:
    """Return the largest force that an object puts on what holds it: its weight, and what it presses against [N]."""
    pressed = [np.array(load["force_n"]) for load in phase.get("loads", ()) if load["tool"] == item["name"]]
    up = np.array([0.0, 0.0, GRAVITY * item["mass_kg"]])
    shares = itertools.product((0.0, 1.0), repeat=len(pressed))
    return max(float(np.linalg.norm(up + sum(k * f for k, f in zip(share, pressed, strict=True)))) for share in shares)


def _rests(replay: Replay, data: dict[str, Any], item: dict[str, Any], s: float) -> tuple[bool, str]:
    pose = _frame(replay, item["name"], s)
    points = np.array([pose.act(np.array(v)) for v in item["vertices"]])
    centre, low = pose.act(np.array(item["centre"])), points[:, 2].min()
    foot = points[points[:, 2] < low + 1e-3]
    tops = [np.array(piece["vertices"]) for piece in data["pieces"]]
    below = [t for t in tops if abs(t[:, 2].max() - low) <= REST_GAP_M]
    ends = [(np.maximum(foot.min(axis=0), t.min(axis=0)), np.minimum(foot.max(axis=0), t.max(axis=0))) for t in below]
    ends = [(a, b) for a, b in ends if np.all(a[:2] <= b[:2] + 1e-9)]
    if not ends:
        return False, "nothing is below it"
    a, b = np.min([a for a, _ in ends], axis=0), np.max([b for _, b in ends], axis=0)
    inside = float(np.minimum(centre[:2] - a[:2], b[:2] - centre[:2]).min())
    return inside > 0.0, f"rests, its centre {1e3 * inside:.0f} mm inside what is below it"


def _see(replay: Replay, name: str, finger: str, points: Array, s: float) -> Array:
    """Return points of a finger as seen from an object."""
    pose = _frame(replay, name, s).actInv(_frame(replay, finger, s))
    return points @ pose.rotation.T + pose.translation


def _frame(replay: Replay, name: str | None, s: float) -> pin.SE3:
    if name is None:
        return pin.SE3.Identity()
    frame = replay.model.frames[replay.model.getFrameId(name)]
    return pin.SE3(*replay.place(s, int(frame.parentJoint))) * frame.placement


def _pose(data: dict[str, Any]) -> pin.SE3:
    w, x, y, z = data["quaternion_wxyz"]
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(data["position"]))
