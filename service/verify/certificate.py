"""The certificate as data: checks, clearance proof, gaps, coverage, and its JSON."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Any

import orjson

from service.verify.motion import VerifyError

FORMAT = "scopt-certificate/1"


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
class Gaps:
    """Stretches without a proof.

    On the path from ``first`` to ``last`` nobody has shown that the pair keeps clear, or within its allowed depth: the
    stretch resisted, or a pose of the pair's phase refuted it and the rest of that phase was left.

    Attributes:
        pairs: (mover, holder) names.
        pair, first, last: one entry per row: index of the pair, path parameters.
        lower: what is proven of the clearance there all the same [m]; NaN where nothing is.
    """

    pairs: tuple[tuple[str, str], ...] = ()
    pair: tuple[int, ...] = ()
    first: tuple[float, ...] = ()
    last: tuple[float, ...] = ()
    lower: tuple[float, ...] = ()


# A link without a shape may reach this far out of the shapes next to it: a camera, a coupling [m].
SMALL_M = 0.05


@dataclass(frozen=True)
class LeftOut:
    """A pair of links with shapes that is not checked.

    Attributes:
        pair: their names, sorted.
        reason: ``same joint``, ``adjacent`` (joint neighbours), ``srdf (what it says)``, ``derived``, ``kept`` (their
            relative pose is held all along), ``around a joint`` (one link apart, and overlapping in nearly all poses of
            the joints between), or ``given``.
        is_neighbour: whether its links are joint neighbours, or around a joint, so that an overlap tells nothing.
        deepest_m: how deep one was seen to be in the other; 0 where they were proven to keep apart on the whole curve
            (``s`` is None), or not proven and seen apart; NaN for joint neighbours and links of one joint.
        s, time_s: where it is deepest, or not proven; None elsewhere.
    """

    pair: tuple[str, str]
    reason: str
    is_neighbour: bool
    deepest_m: float
    s: float | None = None
    time_s: float | None = None

    @property
    def is_told_as_neighbour(self) -> bool:
        """Whether nobody expects such a pair to be checked."""
        return self.is_neighbour or self.reason == "same joint"


@dataclass(frozen=True)
class Shapeless:
    """A link without a collision shape, or with one far smaller than the link.

    Attributes:
        link: its name.
        place: ``between`` links with shapes, at an ``end``, or at the ``root``.
        reach_m: the longest side of what is known of it (the line to its joints, its drawn shapes, its mass as an even
            box), or how far that reaches out of the shapes of the links next to it at the motion's first pose if that
            is less; 0 for a mere frame, NaN where its size is unknown.
    """

    link: str
    place: str
    reach_m: float

    @property
    def is_small(self) -> bool:
        """Whether what no shape covers is no larger than a camera or a coupling."""
        return self.reach_m <= SMALL_M


@dataclass(frozen=True)
class Coverage:
    """What was checked, and what was not.

    Attributes:
        links_with_shape, links_without_shape: names of the robot's links.
        shapeless: where each link without a shape sits, and how far it reaches out of the shapes next to it.
        n_link_pairs: pairs of links checked against each other.
        n_piece_pairs: pairs of a link and a piece of the scene that were checked.
        left_out: pairs of links with shapes that were not checked.
        joints_without_torque_limit: joints whose torque is held against nothing.
        not_checked: what was not checked because the request does not ask for it or the robot's file does not allow it.
    """

    links_with_shape: tuple[str, ...] = ()
    links_without_shape: tuple[str, ...] = ()
    shapeless: tuple[Shapeless, ...] = ()
    n_link_pairs: int = 0
    n_piece_pairs: int = 0
    left_out: tuple[LeftOut, ...] = ()
    joints_without_torque_limit: tuple[str, ...] = ()
    not_checked: tuple[str, ...] = ()

    def sentences(self) -> Iterator[str]:
        """What was not checked, for people."""
        if self.not_checked:
            yield f"not checked: {', '.join(self.not_checked)}"
        if self.left_out:
            kinds = Counter("neighbours" if one.is_told_as_neighbour else one.reason for one in self.left_out)
            told = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
            yield f"{len(self.left_out)} pairs of links are not checked against each other: {told}"
        if self.links_without_shape:
            yield f"{len(self.links_without_shape)} links have no shape: {', '.join(self.links_without_shape)}"

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Coverage:
        """Read what the certificate's JSON holds."""
        return Coverage(
            tuple(data["links_with_shape"]),
            tuple(data["links_without_shape"]),
            tuple(Shapeless(one["link"], one["place"], _number(one["reach_m"])) for one in data["shapeless"]),
            data["n_link_pairs"],
            data["n_piece_pairs"],
            tuple(
                LeftOut(
                    (one["pair"][0], one["pair"][1]),
                    one["reason"],
                    one["is_neighbour"],
                    _number(one["deepest_m"]),
                    one["s"],
                    one["time_s"],
                )
                for one in data["left_out"]
            ),
            tuple(data["joints_without_torque_limit"]),
            tuple(data["not_checked"]),
        )


@dataclass(frozen=True)
class Certificate:
    """The outcome of a verification, as data.

    Attributes:
        status: certified only if every check holds and every check that can be proven is.
        checks: all claims.
        min_clearance_m: proven lower bound for pairs that may not touch, up to the horizon examined; NaN if none.
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
