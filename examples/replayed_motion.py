"""Motion of a result, rebuilt from its URDF and curve: placements, and bounds of how far points leave their chords.

A part of `check_certificate.py`; imports only numpy and pinocchio.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

ROUNDING = 1e-8  # of a coordinate as written [rad, m]
Array = np.ndarray
Named = tuple[str, str | None, str]  # owner of a body (robot, mechanism, scene), its link, its name


def read_model(folder: Path, data: dict[str, Any]) -> pin.Model:
    """Build the model of the URDF (continuous joints as revolute ones), its root and the joints the task moves."""
    tree = ElementTree.parse(folder / data["robot"]["urdf"]).getroot()
    for joint in (j for j in tree.iter("joint") if j.get("type") == "continuous"):
        joint.set("type", "revolute")
        joint.append(ElementTree.Element("limit", lower="-1e3", upper="1e3", effort="0", velocity="0"))
    text, root = ElementTree.tostring(tree, encoding="unicode"), pin.JointModelComposite()
    root.addJoint(pin.JointModelTranslation())
    root.addJoint(pin.JointModelSphericalZYX())
    is_floating = data["robot"]["root"] == "floating"
    model = pin.buildModelFromXML(text, root) if is_floating else pin.buildModelFromXML(text)
    origins = {m["name"]: np.array(m["origin"], float) for m in data["movables"]}
    for m in data["movables"]:  # parents come before children; at 0 every link has the axes of the world
        kinds = {"revolute": pin.JointModelRevoluteUnaligned, "prismatic": pin.JointModelPrismaticUnaligned}
        axis = np.array(m["axis"], float)
        above, place = 0, origins[m["name"]]
        if m["parent"] is not None:
            above = int(model.frames[model.getFrameId(m["parent"])].parentJoint)
            place = place - origins[m["parent"]]
        kind = kinds[m["type"]](axis / np.linalg.norm(axis))
        joint = model.addJoint(above, kind, pin.SE3(np.eye(3), place), m["joint"])
        model.addFrame(pin.Frame(m["name"], joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    data["followers"] = read_followers(tree)
    own = [name for name in list(model.names)[1 + is_floating :] if name not in data["followers"]]
    if sorted(own) != sorted(data["curve"]["joint_names"][6 * is_floating :]):
        raise SystemExit("the URDF's joints are not the curve's")
    return model


def read_followers(tree: ElementTree.Element) -> dict[str, tuple[str, float, float]]:
    """Return leader, ratio and offset of the joints that follow others (mimic), leaders that move by themselves."""
    moving = {j.get("name", ""): j.find("mimic") for j in tree.iter("joint") if j.get("type") not in (None, "fixed")}
    found = {}
    for name, mimic in moving.items():
        leader, ratio, offset = name, 1.0, 0.0
        while mimic is not None and mimic.get("joint", "") in moving:
            offset += ratio * float(mimic.get("offset", "0"))
            ratio *= float(mimic.get("multiplier", "1"))
            leader = mimic.get("joint", "")
            mimic = moving[leader]
        if leader != name:
            found[name] = (leader, ratio, offset)
    return found


def covers(allowance: dict[str, Any], one: Named, other: Named) -> bool:
    def fits(ref: dict[str, Any], named: Named) -> bool:
        is_whole_link = ref["body"] is None and ref["owner"] != "scene"
        return (ref["owner"], ref["link"]) == named[:2] and (is_whole_link or ref["body"] == named[2])

    first, second = allowance["first"], allowance["second"]
    return any(fits(first, x) and fits(second, y) for x, y in ((one, other), (other, one)))


class Replay:
    """Placements along the curve, and bounds of how far a point leaves the chord between two of them.

    A joint that follows another one has a coordinate of its own; ``own`` are the coordinates of the curve.
    """

    def __init__(self, model: pin.Model, data: dict[str, Any]) -> None:
        self.model, curve, phases = model, data["curve"], data["phases"]
        given = list(curve["joint_names"])
        base = given[:6] if data["robot"]["root"] == "floating" else []
        self.names = base + list(model.names)[2 if base else 1 :]
        self.own = [self.names.index(name) for name in given]
        leads = [data["followers"].get(name, (name, 1.0, 0.0)) for name in self.names]
        column, ratio, offset = [given.index(x[0]) for x in leads], *np.array([x[1:] for x in leads]).T
        self.knots, q, v = (np.array(curve[key], float) for key in ("knots", "positions", "tangents"))
        q, v = q[:, column] * ratio + offset, v[:, column] * ratio
        self.samples = np.array(curve["samples"], float)
        self.edges = np.unique([*self.knots, *(self.samples[p[end]] for p in phases for end in ("first", "last"))])
        h = np.diff(self.knots)[:, None]
        d = np.diff(q, axis=0) / h
        self.c = np.stack([q[:-1], v[:-1], (3 * d - 2 * v[:-1] - v[1:]) / h, (v[:-1] + v[1:] - 2 * d) / h**2])
        self.travel = np.abs(np.vstack([q, q[:-1] + h * v[:-1] / 3, q[1:] - h * v[1:] / 3])).max(axis=0)  # Bezier hull
        self.coordinates = [list(range(j.idx_v, j.idx_v + j.nv)) if i else [] for i, j in enumerate(model.joints)]
        slides = [j.shortname().startswith("JointModelP") for j in model.joints]
        self.turns = np.array([not slides[j] for j, ids in enumerate(self.coordinates) for _ in ids])
        self.base = np.zeros(model.nv, bool)
        if data["robot"]["root"] == "floating":
            self.turns[:3], self.base[3:6] = False, True
        self.known: dict[float, Any] = {}
        self.fastest: dict[tuple[float, float, int], tuple[Array, Array]] = {}

    def q(self, s: float, order: int = 0, piece: int | None = None) -> Array:
        if piece is None:
            piece = int(np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.knots) - 2))
        u, (c0, c1, c2, c3) = s - self.knots[piece], self.c[:, piece]
        return (c0 + u * (c1 + u * (c2 + u * c3)), c1 + u * (2 * c2 + 3 * u * c3), 2 * c2 + 6 * u * c3)[order]

    def place(self, s: float, joint: int) -> tuple[Array, Array]:
        if s not in self.known:
            data = self.model.createData()
            pin.forwardKinematics(self.model, data, self.q(s))
            self.known[s] = [(p.rotation.copy(), p.translation.copy()) for p in data.oMi]
        return self.known[s][joint]

    def points(self, s: float, joint: int, points: Array, frame: int = 0) -> Array:
        (r, t), (rf, tf) = self.place(s, joint), self.place(s, frame)
        return (points @ r.T + t - tf) @ rf

    def chain(self, holder: int, mover: int, points: Array) -> list[tuple[int, int, float]]:
        """Return (coordinate, joint, reach) from the holder outwards; reach bounds |dp/dq| in any configuration."""
        up, down, parents = [], [], self.model.parents
        for path, joint in ((up, holder), (down, mover)):
            while joint:
                path.append(int(joint))
                joint = parents[joint]
        while up and down and up[-1] == down[-1]:
            up.pop(), down.pop()
        offset, rows = [p.translation for p in self.model.jointPlacements], []
        far = np.linalg.norm(points if down or not up else points - offset[up[-1]], axis=1).max()
        for joint in down + up[::-1]:
            is_up = joint in up
            if is_up and joint == up[-1]:
                far += np.linalg.norm(offset[joint] - offset[down[-1]]) if down else 0.0
            elif is_up:
                far += np.linalg.norm(offset[joint])
            for i in self.coordinates[joint] if is_up else self.coordinates[joint][::-1]:
                rows.append((i, joint, far if self.turns[i] else 1.0))
                far += 0.0 if self.turns[i] else self.travel[i]
            far += np.linalg.norm(offset[joint]) if not is_up and joint != down[-1] else 0.0
        return rows[::-1]

    def rates(self, a: float, b: float, piece: int) -> tuple[Array, Array]:
        """Return the largest speeds and bends of all coordinates from a to b; kept, as all bodies use them."""
        if (a, b, piece) not in self.fastest:
            self.fastest[a, b, piece] = self._rates(a, b, piece)
        return self.fastest[a, b, piece]

    def _rates(self, a: float, b: float, piece: int) -> tuple[Array, Array]:
        _, c1, c2, c3 = self.c[:, piece]
        u = np.clip(-c2 / np.where(c3 == 0.0, np.inf, 3 * c3), a - self.knots[piece], b - self.knots[piece])
        slopes = [self.q(a, 1, piece), self.q(b, 1, piece), c1 + u * (2 * c2 + 3 * u * c3)]
        return np.abs(slopes).max(axis=0), np.abs([self.q(a, 2, piece), self.q(b, 2, piece)]).max(axis=0)

    def bound(self, a: float, b: float, chain: list[tuple[int, int, float]], mover: int, points: Array) -> float:
        """Bound how far any point leaves its chord between a and b, on the curve and on the line through samples."""
        ids, joints, reach = (np.array(column) for column in zip(*chain, strict=True))
        piece = int(np.searchsorted(self.knots, 0.5 * (a + b)) - 1)
        speed, bend = (rate[ids] for rate in self.rates(a, b, piece))
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        middle, turns = 0.5 * (a + b), self.turns[ids]
        gap = [self.place(middle, j)[1] for j in joints] - self.points(middle, mover, centre[None])
        now = np.linalg.norm(gap, axis=1) + np.linalg.norm(points - centre, axis=1).max()
        distal = np.append(np.cumsum((speed * reach)[::-1])[::-1], 0.0)[1:]
        near = np.where(turns, np.minimum(reach, now + 0.5 * (b - a) * distal), reach)
        inner = speed * turns  # of two coordinates the inner one turns the outer one's lever
        pairs = 2.0 * np.cumsum(inner) - inner
        low, high = np.searchsorted(self.samples, a, side="right") - 1, np.searchsorted(self.samples, b)
        step = np.diff(self.samples)[low:high].max()
        fast, sharp = (rate[ids] for rate in self.rates(self.knots[piece], self.knots[piece + 1], piece))
        line, base = (reach * (step**2 / 8 * sharp + ROUNDING)).sum(), self.base[ids]
        slerp = (step * fast[base].sum()) ** 2 / 4 * reach[base].max(initial=0.0)
        return float((b - a) ** 2 / 8 * (near @ (speed * pairs + bend)) + line + slerp) + 1e-9

    def highest(
        self,
        phase: dict,
        value: Callable[[float], float],
        leaving: Callable[[float, float], float],
        allowed: float,
        span: tuple[float, float] | None = None,
    ) -> float:
        """Bound a convex value on a phase: the largest at the ends of chords, plus how far the path leaves them.

        Chords are halved as long as the value at the ends is allowed and the sum is not, on the phase or on ``span``.
        """
        first, last = (self.samples[phase["first"]], self.samples[phase["last"]]) if span is None else span
        edges = self.edges[(self.edges >= first) & (self.edges <= last)]
        edges = edges if span is None else np.union1d(edges, span)
        parts = np.concatenate([np.linspace(a, b, 9)[:-1] for a, b in itertools.pairwise(edges)] + [edges[-1:]])
        chords, most, least = list(itertools.pairwise(parts.tolist())), -np.inf, 1e-4 * (last - first)
        while chords:
            a, b = chords.pop()
            at_ends, middle = max(value(a), value(b)), 0.5 * (a + b)
            top = at_ends + leaving(a, b)
            if at_ends > allowed:
                return top  # refuted: its value elsewhere does not matter
            if at_ends <= allowed < top and b - a > least:
                chords += [(a, middle), (middle, b)]
            else:
                most = max(most, top)
        return most
