"""The certificate as data: checks, clearance proof, gaps, coverage, and its JSON."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Any

import orjson

from service.request.formats import FORMAT as VERSION
from service.verify.motion import VerifyError

FORMAT = f"scopt-certificate/{VERSION}"
READABLE = ("scopt-certificate/1", FORMAT)


class Status(Enum):
    """Outcome of a verification."""

    CERTIFIED = "CERTIFIED"
    FEASIBLE_AT_SAMPLES = "FEASIBLE_AT_SAMPLES"
    VIOLATED = "VIOLATED"


class Basis(Enum):
    """Basis of a check's answer."""

    PROOF = "proof"
    SAMPLES = "samples"
    UNPROVEN = "unproven"


@dataclass(frozen=True)
class Where:
    """Place of a check's value: path parameter, time [s] (None: untimed), point in the world [m], names."""

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
        where: place of the value, or None.
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
    """Pair that is allowed to touch: allowed depth, deepest sample, and proven bound of the depth [m]."""

    pair: tuple[str, str]
    phase: str
    allowed_m: float
    deepest_m: float
    proven_m: float


@dataclass(frozen=True)
class Stretches:
    """Columns of the clearance proof; a row is a stretch, an interval of the curve.

    From path parameter ``first`` to ``last`` the hull of the mover's two end poses (in the frame of the holder's joint)
    is at least ``distance`` away from the holder, and no point of the mover leaves that hull by more than ``bound``.

    Attributes:
        pairs: (mover, holder) names.
        edges: path parameters of the intervals of the broad phase.
        floors: per such interval, a lower bound of the clearance of all pairs without a row on it [m].
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
    """Intervals without a proof, as columns.

    From path parameter ``first`` to ``last`` it is not shown that the pair keeps clear, or within its allowed depth:
    no bound sufficed, or a pose refuted the pair and the rest of that phase was not examined.

    Attributes:
        pairs: (mover, holder) names.
        pair, first, last: one entry per row: index of the pair, path parameters.
        lower: proven lower bound of the clearance there [m]; NaN where there is none.
    """

    pairs: tuple[tuple[str, str], ...] = ()
    pair: tuple[int, ...] = ()
    first: tuple[float, ...] = ()
    last: tuple[float, ...] = ()
    lower: tuple[float, ...] = ()


# A link without a shape may reach this far out of the shapes next to it: a camera, a coupling [m].
SMALL_LINK_M = 0.05


@dataclass(frozen=True)
class LeftOut:
    """Pair of links with shapes that is not checked.

    Attributes:
        pair: their names, sorted.
        reason: ``same joint``, ``adjacent`` (joint neighbours), ``srdf (what it says)``, ``derived``, ``kept`` (their
            relative pose is held all along), ``around a joint`` (one link apart, and overlapping in nearly all poses of
            the joints between), or ``given``.
        is_neighbour: whether its links are joint neighbours, or around a joint, so that an overlap is no finding.
        deepest_m: deepest sampled overlap; 0 where they were proven to keep apart on the whole curve (``s`` is None),
            or every sample was apart without a proof; NaN for joint neighbours and links of one joint.
        s, time_s: where it is deepest, or not proven; None elsewhere.
    """

    pair: tuple[str, str]
    reason: str
    is_neighbour: bool
    deepest_m: float
    s: float | None = None
    time_s: float | None = None

    @property
    def is_counted_as_neighbour(self) -> bool:
        """Whether the sentences count it among the neighbours."""
        return self.is_neighbour or self.reason == "same joint"


@dataclass(frozen=True)
class Shapeless:
    """Link without a collision shape, or with one far smaller than the link.

    Attributes:
        link: its name.
        place: ``between`` links with shapes, at an ``end``, or at the ``root``.
        reach_m: size of the link, from the lines to its joints, its drawn shapes and a box of its mass; or how far
            these reach out of the shapes of adjacent links at the motion's first pose, if that is less; 0 for a
            frame without extent, NaN where its size is unknown.
    """

    link: str
    place: str
    reach_m: float

    @property
    def is_small(self) -> bool:
        """Whether the part that no shape covers is no larger than a camera or a coupling."""
        return self.reach_m <= SMALL_LINK_M


@dataclass(frozen=True)
class Coverage:
    """Links, pairs and joints that were checked, and those that were not.

    Attributes:
        links_with_shape, links_without_shape: names of the robot's links.
        shapeless: links without a shape, with place and reach.
        n_link_pairs: pairs of links checked against each other.
        n_piece_pairs: pairs of a link and a piece of the scene that were checked.
        left_out: pairs of links with shapes that were not checked.
        joints_without_torque_limit: joints whose torque is not checked.
        not_checked: checks that the request waives or that the robot's file lacks data for.
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
        """Yield sentences about what was not checked."""
        if self.not_checked:
            yield f"not checked: {', '.join(self.not_checked)}"
        if self.left_out:
            kinds = Counter("neighbours" if pair.is_counted_as_neighbour else pair.reason for pair in self.left_out)
            counts = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
            yield f"{len(self.left_out)} pairs of links are not checked against each other: {counts}"
        if self.links_without_shape:
            yield f"{len(self.links_without_shape)} links have no shape: {', '.join(self.links_without_shape)}"

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Coverage:
        """Read what the certificate's JSON holds."""
        return Coverage(
            tuple(data["links_with_shape"]),
            tuple(data["links_without_shape"]),
            tuple(Shapeless(item["link"], item["place"], _number(item["reach_m"])) for item in data["shapeless"]),
            data["n_link_pairs"],
            data["n_piece_pairs"],
            tuple(
                LeftOut(
                    (item["pair"][0], item["pair"][1]),
                    item["reason"],
                    item["is_neighbour"],
                    _number(item["deepest_m"]),
                    item["s"],
                    item["time_s"],
                )
                for item in data["left_out"]
            ),
            tuple(data["joints_without_torque_limit"]),
            tuple(data["not_checked"]),
        )


@dataclass(frozen=True)
class Certificate:
    """Outcome of a verification, as data.

    Attributes:
        status: CERTIFIED only if every check holds and none is unproven.
        checks: all claims.
        min_clearance_m: proven lower bound for pairs that may not touch, up to the horizon; NaN without pairs.
        min_clearance_pair: the pair that has it, or None when all are beyond the horizon.
        min_balance_margin_m: proven lower bound of the centre of mass's distance inside its polygon; NaN if unchecked.
        exempt: pairs allowed to touch that came near enough to matter.
        stretches: the clearance proof.
        scene_sha256, bodies_sha256, robot_sha256: of the pieces, the bodies with the ignored pairs, and the URDF text.
        promises_sha256: of what the phases promise: borders, allowances, planted links, support polygons, targets.
        notes: what the verdict rests on besides proof.
        gaps: intervals on which the clearance proof leaves a pair open; empty in a certified motion.
        coverage: links, pairs and joints that were checked, and those that were not.
        continues_sha256: hash of the certificate of the plan that the motion continues, or None.
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
    continues_sha256: str | None = None

    def failed(self) -> tuple[Check, ...]:
        """Return the checks that do not hold."""
        return tuple(check for check in self.checks if not check.ok)

    def fails_by_description(self) -> bool:
        """Return whether only the robot's file or the request rules out a certificate, not the motion.

        Links that are left out and overlap most at the start do so in every motion from there.
        """
        open_checks = [check for check in self.checks if not check.ok or check.basis is Basis.UNPROVEN]
        kinds = ("coverage.shape.", "coverage.pairs", "coverage.missing.", "coverage.pressed.assumed.")

        def is_described(check: Check) -> bool:
            starts_inside = check.where is not None and check.where.s == 0.0
            return check.name.startswith(kinds) or (check.name.startswith("coverage.overlap.") and starts_inside)

        return bool(open_checks) and all(is_described(check) for check in open_checks)

    def list_uncovered(self) -> frozenset[str]:
        """Return the names of the open checks if all are about what the certificate covers; else nothing."""
        names = {check.name for check in self.checks if not check.ok or check.basis is Basis.UNPROVEN}
        return frozenset(names if all(name.startswith("coverage.") for name in names) else ())

    def list_meeting(self) -> frozenset[tuple[str, str]]:
        """Return the pairs of links that were left out, are no neighbours, and do not keep apart."""
        left_out = () if self.coverage is None else self.coverage.left_out
        return frozenset(
            item.pair for item in left_out if item.s is not None and not item.is_neighbour and item.reason != "kept"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; NaN and infinity become None."""
        return dict(json.loads(self.to_json()))

    def to_json(self) -> str:
        """Return compact JSON; NaN and infinity become null."""
        data = {"format": FORMAT, **{item.name: getattr(self, item.name) for item in fields(self)}}
        return orjson.dumps(data, option=orjson.OPT_SERIALIZE_NUMPY).decode()

    @staticmethod
    def from_json(text: str) -> Certificate:
        """Read what :meth:`to_json` wrote.

        Raises:
            VerifyError: for another format.
        """
        data = json.loads(text)
        if data.get("format") not in READABLE:
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
            continues_sha256=data.get("continues_sha256"),
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
