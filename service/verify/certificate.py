"""The certificate: what was checked, how it came out, and the data with which a stranger can replay the proof."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Any

import numpy as np
import orjson
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.robot.model import RobotModel
from costs.scene import Scene
from service.verify.coverage import Coverage
from service.verify.errors import VerifyError
from service.verify.gaps import Gaps
from service.verify.motion import Phase, PlantedContact, SupportPolygon, Target

FORMAT = "scopt-certificate/1"
HASH_OFFSET = 0.381966  # of a micrometre


class Status(Enum):
    """What a verification can say."""

    CERTIFIED = "CERTIFIED"
    FEASIBLE_AT_SAMPLES = "FEASIBLE_AT_SAMPLES"
    VIOLATED = "VIOLATED"


class Basis(Enum):
    """What a check's answer rests on."""

    PROOF = "proof"
    SAMPLES = "samples"
    UNPROVEN = "unproven"


@dataclass(frozen=True)
class Where:
    """Where a check found its value: path parameter, time [s] (None: untimed), point in the world [m], names."""

    s: float
    time_s: float | None
    position: tuple[float, float, float] | None
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Check:
    """One claim about the motion.

    Attributes:
        name: machine-readable, dotted (``balance.reach``).
        ok: whether it holds as far as is known.
        value, limit: measured or proven value and what it is held against, in ``unit``.
        text: one sentence for people.
        where: where the value was found, if it has a place.
        basis: proof, samples, or unproven (samples hold, the proof is missing).
    """

    name: str
    ok: bool
    value: float
    limit: float
    unit: str
    text: str
    where: Where | None
    basis: Basis


@dataclass(frozen=True)
class Exempt:
    """A pair that is allowed to touch: how deep it may, was seen to, and provably does not exceed [m]."""

    pair: tuple[str, str]
    phase: str
    allowed_m: float
    deepest_m: float
    proven_m: float


@dataclass(frozen=True)
class Stretches:
    """Columns of the clearance proof.

    On the path from ``first`` to ``last`` the hull of the mover's two end poses (in the frame of the holder's joint)
    is at least ``distance`` away from the holder, and no point of the mover leaves that hull by more than ``bound``.

    Attributes:
        pairs: (mover, holder) names.
        edges: path parameters of the stretches that the broad phase looks at.
        floors: per broad stretch, a lower bound of the clearance of all pairs without a row on it [m].
        pair, first, last, distance, bound: one entry per row.
    """

    pairs: tuple[tuple[str, str], ...]
    edges: tuple[float, ...]
    floors: tuple[float, ...]
    pair: tuple[int, ...]
    first: tuple[float, ...]
    last: tuple[float, ...]
    distance: tuple[float, ...]
    bound: tuple[float, ...]


@dataclass(frozen=True)
class Certificate:
    """The outcome of a verification, as data.

    Attributes:
        status: certified only if every check holds and every check that can be proven is.
        checks: all claims.
        min_clearance_m: proven lower bound for pairs that may not touch, up to the horizon looked at; NaN if none.
        min_clearance_pair: the pair that has it, or None when all are beyond the horizon.
        min_balance_margin_m: proven lower bound of the centre of mass's distance inside its polygon; NaN if unchecked.
        exempt: pairs allowed to touch that came near enough to matter.
        stretches: the clearance proof.
        scene_sha256, bodies_sha256, robot_sha256: of the pieces, the bodies with the ignored pairs, and the URDF text.
        promises_sha256: of what the phases promise: borders, allowances, planted links, support polygons, targets.
        notes: what the verdict rests on besides proof.
        gaps: where the clearance proof leaves a pair open; empty in a certified motion.
        coverage: what was checked, and what was not.
    """

    status: Status
    checks: tuple[Check, ...]
    min_clearance_m: float
    min_clearance_pair: tuple[str, str] | None
    min_balance_margin_m: float
    exempt: tuple[Exempt, ...]
    stretches: Stretches
    scene_sha256: str
    bodies_sha256: str
    robot_sha256: str
    promises_sha256: str
    notes: tuple[str, ...] = field(default=())
    gaps: Gaps = field(default_factory=Gaps)
    coverage: Coverage = field(default_factory=Coverage)

    def failed(self) -> tuple[Check, ...]:
        """Checks that do not hold."""
        return tuple(check for check in self.checks if not check.ok)

    def fails_by_description(self) -> bool:
        """Whether all that is missing is due to the robot's description or the request, and to no motion."""
        open_checks = [check for check in self.checks if not check.ok or check.basis is Basis.UNPROVEN]
        kinds = ("coverage.shape.", "coverage.pairs", "coverage.missing.")
        return bool(open_checks) and all(check.name.startswith(kinds) for check in open_checks)

    def to_dict(self) -> dict[str, Any]:
        """Plain data; NaN and infinity become None."""
        return dict(json.loads(self.to_json()))

    def to_json(self) -> str:
        """Compact JSON; NaN and infinity become null."""
        data = {"format": FORMAT, **{item.name: getattr(self, item.name) for item in fields(self)}}
        return orjson.dumps(data, option=orjson.OPT_SERIALIZE_NUMPY).decode()

    @staticmethod
    def from_json(text: str) -> Certificate:
        """Read what :meth:`to_json` wrote.

        Raises:
            VerifyError: when the format is another one.
        """
        data = json.loads(text)
        if data.get("format") != FORMAT:
            raise VerifyError(f"certificate format must be '{FORMAT}', got {data.get('format')!r}")
        return Certificate(
            Status(data["status"]),
            tuple(_check(check) for check in data["checks"]),
            _number(data["min_clearance_m"]),
            _pair(data["min_clearance_pair"]),
            _number(data["min_balance_margin_m"]),
            tuple(
                Exempt((e["pair"][0], e["pair"][1]), e["phase"], e["allowed_m"], e["deepest_m"], e["proven_m"])
                for e in data["exempt"]
            ),
            _stretches(data["stretches"]),
            data["scene_sha256"],
            data["bodies_sha256"],
            data["robot_sha256"],
            data["promises_sha256"],
            tuple(data["notes"]),
            gaps=_gaps(data.get("gaps") or {}),
            coverage=Coverage.from_dict(data["coverage"]) if "coverage" in data else Coverage(),
        )


def scene_hash(scene: Scene) -> str:
    """``sha256:`` of the pieces in order of name: name, then the vertices in whole micrometres."""
    return _hash((piece.name, piece.vertices) for piece in sorted(scene.pieces, key=lambda piece: piece.name))


def bodies_hash(robot: RobotModel) -> str:
    """``sha256:`` of the bodies (vertices in the link frame, in whole micrometres) and of the ignored link pairs."""
    bodies = [(body.name, link_vertices(robot, body.link, body.vertices)) for body in robot.bodies]
    pairs = [(f"{a}|{b}", np.empty((0, 3))) for a, b in sorted(robot.ignored_pairs)]
    return _hash(sorted(bodies, key=lambda body: body[0]) + pairs)


def robot_hash(robot: RobotModel) -> str:
    """``sha256:`` of the URDF text."""
    return "sha256:" + hashlib.sha256(robot.source.urdf.encode()).hexdigest()


def promises_hash(phases: Iterable[Phase]) -> str:
    """``sha256:`` of everything the phases promise (docs/result-format.md says how it is made)."""
    digest = hashlib.sha256()
    for phase in phases:
        _add(digest, "phase", phase.name, np.array([phase.first, phase.last]))
        for allowance in phase.allowances:
            _add(digest, "allowance", *_parts(allowance))
        for contact in phase.contacts:
            _add(digest, "contact", *_parts(contact))
        if phase.support is not None:
            _add(digest, "support", *_parts(phase.support))
        for target in phase.targets:
            _add(digest, type(target).__name__, *_parts(target))
    return "sha256:" + digest.hexdigest()


def link_vertices(robot: RobotModel, link: str, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """A body's vertices, given in the frame of its joint, in the frame of its link [m]."""
    if not robot.model.existFrame(link):
        return vertices
    placement = robot.model.frames[robot.model.getFrameId(link)].placement
    return np.asarray((vertices - placement.translation) @ placement.rotation)


def _hash(named: Iterable[tuple[str, np.ndarray]]) -> str:
    digest = hashlib.sha256()
    for name, vertices in named:
        digest.update(name.encode() + b"\0" + len(vertices).to_bytes(8, "little"))
        digest.update(np.rint(vertices * 1e6).astype("<i8").tobytes())
    return "sha256:" + digest.hexdigest()


def _parts(promise: Allowance | BodyRef | PlantedContact | SupportPolygon | Target) -> Iterator[str | np.ndarray]:
    """The fields of a promise in their order: texts, references to bodies, numbers; none where it is None."""
    for item in fields(promise):
        value = getattr(promise, item.name)
        if isinstance(value, BodyRef):
            yield from _parts(value)
        else:
            yield value if isinstance(value, str) else np.empty(0) if value is None else np.asarray(value, dtype=float)


def _add(digest: hashlib._Hash, *parts: str | np.ndarray) -> None:
    for part in parts:
        if isinstance(part, str):
            digest.update(b"t" + part.encode() + b"\0")
            continue
        # Steps of a micrometre whose borders lie where written decimals do not; what is infinite counts as -1.
        steps = np.floor(np.where(np.isinf(part), -1.0, part).ravel() * 1e6 + HASH_OFFSET)
        digest.update(b"n" + steps.size.to_bytes(8, "little") + steps.astype("<i8").tobytes())


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _pair(value: list[str] | None) -> tuple[str, str] | None:
    return None if value is None else (value[0], value[1])


def _check(data: dict[str, Any]) -> Check:
    where = data["where"]
    place = None
    if where is not None:
        position = where["position"]
        point = None if position is None else (position[0], position[1], position[2])
        place = Where(where["s"], where["time_s"], point, tuple(where["names"]))
    value, limit = _number(data["value"]), _number(data["limit"])
    return Check(data["name"], data["ok"], value, limit, data["unit"], data["text"], place, Basis(data["basis"]))


def _stretches(data: dict[str, Any]) -> Stretches:
    columns = {key: tuple(data[key]) for key in ("edges", "floors", "pair", "first", "last", "distance", "bound")}
    return Stretches(tuple((a, b) for a, b in data["pairs"]), **columns)


def _gaps(data: dict[str, Any]) -> Gaps:
    pairs = tuple((a, b) for a, b in data.get("pairs", ()))
    columns = {key: tuple(data.get(key, ())) for key in ("pair", "first", "last")}
    return Gaps(pairs, **columns, lower=tuple(_number(value) for value in data.get("lower", ())))
