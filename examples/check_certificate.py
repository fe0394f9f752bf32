"""Check a certificate with independent code: `python examples/check_certificate.py out/valve`.

Prints one line per claim, `ok` or `FAIL`, and exits with 1 if any claim fails.  It imports only numpy and pinocchio.
Parts are placements and motion bounds (`replayed_motion.py`), facts that the folder states twice
(`replayed_record.py`), targets (`replayed_targets.py`), the latches of a mechanism (`replayed_mechanism.py`) and the
contacts of hands that push it (`replayed_pushes.py`).
Distances come from Wolfe's minimum-norm-point algorithm (Math. Programming 11, 1976), which returns a separating
direction as its proof.
"""

from __future__ import annotations

import itertools
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from replayed_loads import forces, region_margin, touches
from replayed_mechanism import release
from replayed_motion import Array, Replay, covers, read_model
from replayed_objects import held, split
from replayed_pushes import leaving, pushes
from replayed_record import hashes, rates, samples, speeds
from replayed_targets import target


def closest(a: Array, b: Array, wanted: float) -> tuple[float, Array]:
    """Return a lower bound of the distance of two hulls and its direction (Wolfe); stop once it reaches ``wanted``."""
    best, top, corral, weight = -np.inf, np.eye(3)[2], b[:1] - a[:1], np.ones(1)
    for _ in range(80):
        norm = np.linalg.norm(weight @ corral)
        if best >= wanted or norm < 1e-12:
            break
        n = weight @ corral / norm
        w = b[(b @ n).argmin()] - a[(a @ n).argmax()]
        best, top = (float(w @ n), n) if w @ n > best else (best, top)
        if norm - w @ n < 1e-11:
            break
        corral, weight = np.vstack([corral, w]), np.append(weight, 0.0)
        for _ in range(8):  # towards the affine minimum, dropping the points that leave the simplex
            k = len(corral)
            system = np.block([[np.zeros((1, 1)), np.ones((1, k))], [np.ones((k, 1)), corral @ corral.T]])
            y = np.linalg.lstsq(system, np.eye(k + 1)[0], rcond=None)[0][1:]
            out = y <= 1e-12
            part = np.min(weight[out] / np.maximum(weight[out] - y[out], 1e-300), initial=1.0)
            weight = weight + part * (y - weight)
            keep = weight > 1e-12
            corral, weight = corral[keep], weight[keep] / weight[keep].sum()
            if not out.any():
                break
    return best, top


def separation(a: Array, b: Array, wanted: float) -> float:
    """Return a proven lower bound of the signed distance of two hulls; stop once it reaches ``wanted``."""
    best, n = closest(a, b, wanted)
    if best >= min(wanted, 0.0):
        return best
    # The hulls overlap: the least depth has many local optima, so start from the best of many directions.
    starts = np.array([n, *(x for x in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(x))])
    starts /= np.linalg.norm(starts, axis=1)[:, None]
    values = (b @ starts.T).min(axis=0) - (a @ starts.T).max(axis=0)
    for k in np.argsort(-values)[:8]:
        value, n = float(values[k]), starts[k]
        for _ in range(50):
            best = max(best, value)
            # After moving the hulls apart along n, their closest direction is at least as good as n.
            n = closest(a, b + (1e-3 - 1.2 * value) * n, np.inf)[1]
            before, value = value, float((b @ n).min() - (a @ n).max())
            if best >= wanted or value < before + 1e-9:
                break
        if best >= wanted:
            break
    return best


def clearance(replay: Replay, data: dict[str, Any], phases: list[dict[str, Any]]) -> tuple[bool, str]:
    """Check every pair during some phases: by the certificate's rows if there are any, else by bounding boxes."""
    solids, named = {}, {}
    for body in data["bodies"]:
        frame = replay.model.frames[replay.model.getFrameId(body["link"])]
        points = np.array(body["vertices"]) @ frame.placement.rotation.T + frame.placement.translation
        solids[body["name"]] = (body["link"], int(frame.parentJoint), points)
        named[body["name"]] = ("robot", body["link"], body["name"])
    for movable in data["movables"]:
        joint = int(replay.model.getJointId(movable["joint"]))
        for body in movable["bodies"]:
            solids[body["name"]] = (movable["name"], joint, np.array(body["vertices"]) - movable["origin"])
            named[body["name"]] = ("mechanism", movable["name"], body["name"])
    pieces = {p["name"]: ("", 0, np.array(p["vertices"])) for p in data["pieces"]}
    pairs = [(n, p) for n, (_, j, _) in solids.items() if j for p in pieces]
    for (n, (la, ja, _)), (m, (lb, jb, _)) in itertools.combinations(solids.items(), 2):
        if ja != jb and la != lb and sorted((la, lb)) not in data["ignored_pairs"]:
            pairs.append((n, m))
    solids |= pieces
    named |= {name: ("scene", None, name) for name in pieces}
    listed = [data["bodies"], data["pieces"], *(m["bodies"] for m in data["movables"])]
    if len(solids) < sum(map(len, listed)):
        raise SystemExit("two bodies or pieces have one name, so that the certificate's pairs cannot be told apart")
    proof, rows, sweeps, failed, smallest, n_rows = data["certificate"]["stretches"], {}, {}, [], np.inf, 0
    begin, end = replay.samples[phases[0]["first"]], replay.samples[phases[-1]["last"]]
    edges = np.union1d(replay.edges, np.clip(proof["edges"], replay.edges[0], replay.edges[-1]))
    edges = edges[(edges >= begin) & (edges <= end)].tolist()
    for p, *row in zip(*(proof[key] for key in ("pair", "first", "last", "distance")), strict=True):
        rows.setdefault(tuple(proof["pairs"][p]), []).append(row)
    for pair in pairs:
        pair = pair[::-1] if pair[::-1] in rows else pair
        (_, jm, mover), (_, jh, holder) = solids[pair[0]], solids[pair[1]]
        chain, own = replay.chain(jh, jm, mover), sorted(rows.get(pair, []))
        seen = sweeps.setdefault((pair[0], jh), {})  # shared by all pairs of one mover and one frame
        for a, b in itertools.pairwise(edges):
            phase = next(p for p in phases if replay.samples[p["last"]] >= 0.5 * (a + b))
            depths = [w["depth"] for w in phase["allowances"] if covers(w, named[pair[0]], named[pair[1]])]
            is_own = {named[name][0] for name in pair} == {"robot", "scene"}
            least = max(data["certificate"]["min_clearance_m"] or 0.0, is_own * data.get("clearance_m", 0.0))
            pads = data.get("padding", {})
            names = [named[name][1] if named[name][0] == "robot" else name for name in pair]
            least = max(least, is_own * sum(pads.get(name, 0.0) for name in names))
            need, at = -max(depths) if depths else least - 1e-6, a
            todo = [row for row in own if a <= row[0] and row[1] <= b] or [(a, b, None)]
            while todo:
                first, last, claimed = todo.pop(0)
                if (first, last) not in seen:
                    swept = np.vstack([replay.points(s, jm, mover, jh) for s in (first, last)])
                    seen[first, last] = swept, replay.bound(first, last, chain, jm, mover)
                swept, bound = seen[first, last]
                gap = np.maximum(swept.min(axis=0) - holder.max(axis=0), holder.min(axis=0) - swept.max(axis=0))
                low = float(np.linalg.norm(np.maximum(gap, 0.0)))
                wanted = max(need + bound, -1.0 if claimed is None or depths else claimed - 1e-6)
                if low < wanted or low == 0.0:
                    low, n_rows = separation(swept, holder, wanted), n_rows + 1
                if claimed is None and low < wanted and last - first > (b - a) / 100 and pair not in failed:
                    middle = 0.5 * (first + last)
                    todo[:0] = [(first, middle, None), (middle, last, None)]
                    continue
                is_whole, at = first <= at, last
                failed += [] if is_whole and low >= wanted - 1e-9 else [pair]
                smallest = smallest if depths else min(smallest, low - bound)
            failed += [] if at >= b else [pair]
    shown = f"not shown for {failed[0]}" if failed else f"at least {1e3 * smallest:.1f} mm"
    return not failed, f"{shown} ({len(pairs)} pairs, {n_rows} separating directions)"


def feet(replay: Replay, phase: dict[str, Any], contact: dict[str, Any]) -> tuple[bool, str]:
    """Check that the corners of a sole stay at their planted places."""
    frame, sole = replay.model.frames[replay.model.getFrameId(contact["link"])], np.array(contact["sole"])
    pose = pin.XYZQUATToSE3(np.array([*contact["position"], *np.roll(contact["quaternion_wxyz"], -1)]))
    points = np.array([frame.placement.act(pose.actInv(corner)) for corner in sole])
    joint = int(frame.parentJoint)
    chain = replay.chain(0, joint, points)
    drift = replay.highest(
        phase,
        lambda s: np.linalg.norm(replay.points(s, joint, points) - sole, axis=1).max(),
        lambda a, b: replay.bound(a, b, chain, joint, points),
        contact["tolerance_m"],
    )
    return drift <= contact["tolerance_m"], f"drifts at most {1e3 * drift:.3f} mm"


def off_line(offsets: Array, slide: Array) -> Array:
    """Return the distances of offsets from the line between -slide and slide, which are convex."""
    share = np.clip(offsets @ slide / max(float(slide @ slide), 1e-300), -1.0, 1.0)
    return np.linalg.norm(offsets - share[:, None] * slide, axis=1)


def kept(replay: Replay, phase: dict[str, Any], target: dict[str, Any]) -> tuple[bool, str]:
    """Check that a frame's origin stays in place, and how far the frame (or its free axis) turns."""
    model, reference = replay.model, target["reference"]
    frame = model.frames[model.getFrameId(target["frame"])]
    holder, there = 0, pin.SE3.Identity()
    if reference is not None:
        other = model.frames[model.getFrameId(reference)]
        holder, there = int(other.parentJoint), other.placement
    pose = pin.XYZQUATToSE3(np.array([*target["position"], *np.roll(target["quaternion_wxyz"], -1)]))
    slide = np.zeros(3) if target["slide"] is None else there.rotation @ np.array(target["slide"])
    tips = 0.1 * (np.eye(3) if target["free_axis"] is None else np.array([target["free_axis"]]))
    # A turn by theta moves the tip of a unit axis by at most 2 sin(theta / 2), three tips together by sqrt(2) more.
    size = np.sqrt(2.0) if len(tips) == 3 else 1.0
    joint, turn = int(frame.parentJoint), target["rotation_tolerance_deg"]
    corners = np.vstack([np.zeros((1, 3)), tips])
    points = np.array([frame.placement.act(corner) for corner in corners])
    places = np.array([there.act(pose.act(corner)) for corner in corners])

    def away(s: float) -> float:
        return float(off_line(replay.points(s, joint, points[:1], holder) - places[:1], slide).max())

    def turned(s: float) -> float:
        offsets = replay.points(s, joint, points, holder) - places
        return float(np.linalg.norm(offsets[1:] - offsets[0]))

    chain = replay.chain(holder, joint, points[:1])
    turning = [(column, j, 0.1 if replay.turns[column] else 0.0) for column, j, _ in chain]
    most, most_turn = target["position_tolerance_m"], 0.2 * size * np.sin(0.5 * np.deg2rad(turn))
    off = replay.highest(phase, away, lambda a, b: replay.bound(a, b, chain, joint, points[:1]), most)
    lean = 0.0
    if turn < 180.0:
        leaves = lambda a, b: size * replay.bound(a, b, turning, joint, points)  # noqa: E731
        lean = replay.highest(phase, turned, leaves, most_turn)
    angle = float(np.rad2deg(2.0 * np.arcsin(min(lean / (0.2 * size), 1.0))))
    text = f"off by at most {1e3 * off:.2f} mm, turned by at most {angle:.2f} deg"
    return bool(off <= most and lean <= most_turn), text


def has_regions(phase: dict[str, Any]) -> bool:
    """Return whether regions with witnesses prove the balance of a phase."""
    return bool(phase["loads"]) or phase["region_margin_m"] is not None


def balance(replay: Replay, phase: dict[str, Any]) -> tuple[bool, str]:
    """Check that the centre of mass stays inside the support polygon by the promised margin.

    Under loads, and where contacts change, it stays inside each of the regions that recorded forces hold.
    """
    if not has_regions(phase):
        level = np.ptp(np.concatenate([np.array(contact["sole"])[:, 2] for contact in phase["contacts"]] or [[0.0]]))
        if level > 0.02:
            return False, f"the soles are on levels {1e3 * level:.0f} mm apart"
        margin = phase["support"]["margin_m"]
        inside = measure_inside(replay, phase, np.array(phase["support"]["polygon"]), margin)
        return inside >= margin, f"centre of mass {1e3 * inside:.1f} mm inside the feet"
    spare = []
    for region in phase["regions"]:
        margin, ends = region_margin(replay, phase, region), {end: region[end] for end in ("first", "last")}
        spare.append(measure_inside(replay, {**phase, **ends}, np.array(region["polygon"]), margin) - margin)
    text = f"centre of mass {1e3 * min(spare):.1f} mm more inside its regions than it has to be"
    return min(spare) >= 0.0, text


def measure_inside(replay: Replay, phase: dict[str, Any], corners: Array, margin: float) -> float:
    """Return a lower bound of how far the centre of mass is inside a polygon during a phase [m]."""
    edge = np.roll(corners, -1, axis=0) - corners
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1)[:, None]
    masses = [
        (j, inertia.mass, inertia.lever[None])
        for j, inertia in enumerate(replay.model.inertias)
        if inertia.mass > 0 < j
    ]
    total = sum(mass for _, mass, _ in masses)
    chains = [replay.chain(0, j, lever) for j, _, lever in masses]

    def outside(s: float) -> float:
        centre = sum(mass * replay.points(s, j, lever)[0] for j, mass, lever in masses) / total
        return float(((centre[:2] - corners) * normal).sum(axis=1).max())

    def leaving(a: float, b: float) -> float:
        rows = zip(masses, chains, strict=True)
        return float(sum(mass * replay.bound(a, b, chain, j, lever) for (j, mass, lever), chain in rows) / total)

    return float(-replay.highest(phase, outside, leaving, -margin))


def limits(replay: Replay, phase: dict[str, Any]) -> tuple[bool, str]:
    """Check that joint positions stay within the limits of the URDF."""
    own = slice(6 if replay.base.any() else 0, len(replay.model.lowerPositionLimit))
    low, high = replay.model.lowerPositionLimit[own], replay.model.upperPositionLimit[own]

    def leaving(a: float, b: float) -> float:
        piece = int(np.searchsorted(replay.knots, 0.5 * (a + b)) - 1)
        return float((b - a) ** 2 / 8 * replay.rates(a, b, piece)[1][own].max())

    def beyond(s: float) -> float:
        return float(np.maximum(low - replay.q(s)[own], replay.q(s)[own] - high).max())

    excess = replay.highest(phase, beyond, leaving, 1e-6)
    return excess <= 1e-6, f"{-excess:.4f} rad left to the nearest limit"


def main(folder: Path) -> int:
    data = json.loads((folder / "result.json").read_text())
    if data["certificate"] is None:
        raise SystemExit(f"{folder}: the result holds no certificate (verdict {data['verdict']})")
    replay = Replay(read_model(folder, data), data)
    claims = [("hashes", *hashes(folder, data)), ("samples", *samples(folder, replay, data))]
    claims += [("rates", *rates(folder, replay, data))]
    claims += [("speeds", *speeds(replay, data))]
    claims += [(f"release of {rule['joint']}", *release(replay, rule)) for rule in data["releases"]]
    parts = list(split(replay, data))
    claims += [("clearance", *clearance(*part)) for part in parts]
    for replay, data, phase in ((r, d, phase) for r, d, phases in parts for phase in phases):
        claims += held(replay, data, phase, closest)
        index = next(k for k, one in enumerate(data["phases"]) if one is phase)
        claims += [(f"{phase['name']}: {c['link']}", *feet(replay, phase, c)) for c in phase["contacts"]]
        relative = [target for target in phase["targets"] if target["kind"] == "relative_pose"]
        claims += [(f"{phase['name']}: {t['frame']} kept", *kept(replay, phase, t)) for t in relative]
        others = [target for target in phase["targets"] if target["kind"] != "relative_pose"]
        claims += [
            (f"{phase['name']}: {t.get('frame', t.get('joint', 'joints'))}", *target(replay, phase, t)) for t in others
        ]
        stated = [contact for contact in phase["contacts"] if contact["normal"] is not None]
        claims += [(f"{phase['name']}: {c['link']} touches", *touches(data, c)) for c in stated]
        is_assumed = any(part["source"] == "assumed" for part in phase["pressed"])  # such a plan is not certified
        if data["movables"] and not is_assumed:
            claims.append((f"{phase['name']}: pushes", *pushes(replay, data, phase, closest)))
            left = leaving(replay, data, index, closest)
            claims += [] if left is None else [(f"{phase['name']}: leaves", *left)]
        is_balanced = phase["support"] is not None or phase["region_margin_m"] is not None
        if is_balanced and has_regions(phase):
            claims.append((f"{phase['name']}: forces", *forces(replay, phase)))
        claims += [(f"{phase['name']}: balance", *balance(replay, phase))] if is_balanced else []
        claims += [(f"{phase['name']}: limits", *limits(replay, phase))]
    for name, is_ok, text in claims:
        print(f"{'ok  ' if is_ok else 'FAIL'} {name:28} {text}")
    return 0 if all(is_ok for _, is_ok, _ in claims) else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
