"""Messages nobody should send: valid ones with bytes changed or fields bent, and ones that hypothesis makes up."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from random import Random
from typing import Any, cast

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from benchmarks.service import asks
from service.proto.planner.v1 import planner_pb2 as wire
from service.store import UPLOAD_SUFFIXES

DEEPEST = 5  # of messages in messages that are made up
NUMBERS = (float("nan"), float("inf"), -float("inf"), -1.0, 0.0, 1e308, -1e-8, 5e-324, 1e9)
WHOLE = (-1, 0, 1, 2**31 - 1, -(2**31), 10_000_000)
TEXTS = (
    "",
    " ",
    "../../etc/passwd",
    "/etc/passwd",
    "sha256:",
    "\0",
    "a" * 10_000,
    "%s%n",
    "'; DROP TABLE plans; --",
    "🦾",
)
_FLOATS = (FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT)
_WIDTHS = {
    FieldDescriptor.CPPTYPE_INT32: (-(2**31), 2**31 - 1),
    FieldDescriptor.CPPTYPE_INT64: (-(2**63), 2**63 - 1),
    FieldDescriptor.CPPTYPE_UINT32: (0, 2**32 - 1),
    FieldDescriptor.CPPTYPE_UINT64: (0, 2**64 - 1),
    FieldDescriptor.CPPTYPE_ENUM: (-(2**31), 2**31 - 1),
}
_RICH: Mapping[str, Any] = {
    **asks.ARM_TURNS,
    "scene": {
        "floor": False,
        "obstacles": [
            {"type": "box", "name": "a", "size": [0.2, 0.2, 0.4], "position": [1.0, 0.9, 0.2]},
            {"type": "sphere", "name": "b", "radius": 0.1, "position": [-1.0, -0.9, 0.2]},
            {"type": "capsule", "name": "c", "radius": 0.1, "height": 0.3, "position": [-1.0, 0.9, 0.2]},
            {"type": "convex", "name": "d", "points": [[2, 2, 0], [2.1, 2, 0], [2, 2.1, 0], [2, 2, 0.1]]},
        ],
    },
    "attached": [{"type": "box", "name": "cup", "link": "link7", "size": [0.05, 0.05, 0.05], "position": [0.3, 0, 0]}],
    "options": {"waypoints": 12, "time_limit_s": 0.5, "seed": 3, "margin_m": 0.01, "starts": 1},
}
_POSES: Mapping[str, Any] = {
    "robot": {"name": asks.ARM},
    "start": {"joints": {"joint2": 0.3}},
    "goal": {"poses": [{"link": "tip", "position": [1.0, 0.3, 0.5], "position_tolerance_m": 0.01}]},
    "options": {"time_limit_s": 0.2},
}
_VALVE: Mapping[str, Any] = {
    "robot": {"name": "atlas"},
    "scene": {"cloud": f"sha256:{'0' * 64}.pcd"},
    "task": {"valve": {"mode": "hook", "hand": "left", "turn_deg": 30.0, "hint": [0.7, 0.2, 1.1]}},
}


def seeds(cloud_id: str) -> dict[str, list[tuple[Message, ...]]]:
    """Valid messages by method, several where a method takes a stream; none makes much work."""
    plans = [wire.PlanRequest(request=asks.motion(it)) for it in (_RICH, asks.ARM_TURNS, _POSES, _VALVE)]
    nowhere = wire.CloudsSpec(clouds=[{"file": f"sha256:{'0' * 64}.xyz"}], sensor=[0, 0, 1], reach_m=3.0)  # type: ignore[list-item]
    here = wire.CloudsSpec(clouds=[{"file": cloud_id}], sensor=[0, 0, 1], reach_m=3.0)  # type: ignore[list-item]
    header = wire.UploadCloudRequest(header={"format": UPLOAD_SUFFIXES[0], "size_bytes": 12})  # type: ignore[arg-type]
    chunk = wire.UploadCloudRequest(chunk=b"1 2 3\n4 5 6\n")
    return {
        "Plan": [(plan,) for plan in plans],
        "UploadCloud": [(header, chunk)],
        "BuildScene": [*[(wire.BuildSceneRequest(clouds=nowhere, detect=["valve"]),)] * 7,
                       (wire.BuildSceneRequest(clouds=here),)],
        "Detect": [*[(wire.DetectRequest(clouds=nowhere, kind="valve", hint=[1.0, 0.0, 1.0]),)] * 7,
                   (wire.DetectRequest(clouds=here, kind="valve"),)],
        "Verify": [(wire.VerifyRequest(plan_id="0" * 32),),
                   (wire.VerifyRequest(files=[{"path": "result.json", "data": b"{}", "is_last": True}]),)],  # type: ignore[list-item]
        "ListRobots": [(wire.ListRobotsRequest(),)],
        "GetPlan": [(wire.GetPlanRequest(plan_id="0" * 32, with_files=True),)],
        "ReviewPlan": [(wire.ReviewPlanRequest(plan_id="0" * 32, decision=wire.DECISION_ACCEPTED, comment="good"),)],
        "GetStatus": [(wire.GetStatusRequest(),)],
    }  # fmt: skip


SHARES = {"Plan": 60, "UploadCloud": 8, "BuildScene": 6, "Detect": 6, "Verify": 6, "ListRobots": 2, "GetPlan": 5,
          "ReviewPlan": 5, "GetStatus": 2}  # fmt: skip


def hostile(count: int, number: int, cloud_id: str) -> Iterator[tuple[str, list[bytes]]]:
    """Methods and the messages of one call: a third bytes changed, a third fields bent, a third made up.

    Args:
        number: the seed.
        cloud_id: of a small cloud that the server has.
    """
    random, valid = Random(number), seeds(cloud_id)
    made = {name: made_up(wire_type(name), max(count * SHARES[name] // 300, 4), number) for name in SHARES}
    ways: list[Callable[[str], list[bytes]]] = [
        lambda name: _with_one(random, random.choice(valid[name]), lambda it: changed(it.SerializeToString(), random)),
        lambda name: _with_one(random, random.choice(valid[name]), lambda it: bent(it, random).SerializeToString()),
        lambda name: [random.choice(made[name]) for _ in range(2 if name == "UploadCloud" else 1)],
    ]
    for k in range(count):
        (method,) = random.choices(list(SHARES), list(SHARES.values()))
        yield method, ways[k % len(ways)](method)


def wire_type(method: str) -> Descriptor:
    """Of a method's requests."""
    service = wire.DESCRIPTOR.services_by_name["PlannerService"]
    return cast(Descriptor, service.methods_by_name[method].input_type)


def _with_one(random: Random, messages: tuple[Message, ...], change: Callable[[Message], bytes]) -> list[bytes]:
    at = random.randrange(len(messages))
    return [change(it) if k == at else it.SerializeToString() for k, it in enumerate(messages)]


def changed(data: bytes, random: Random) -> bytes:
    """Cut off, or with a few bytes replaced, put in, taken out or repeated."""
    if not data or random.random() < 0.1:
        return random.randbytes(random.randrange(1, 64))
    if random.random() < 0.2:
        return data[: random.randrange(len(data))]
    new = bytearray(data)
    for _ in range(random.randrange(1, 5)):
        at = random.randrange(len(new) or 1)
        way = random.randrange(4)
        if way == 0:
            new[at : at + 1] = bytes([random.choice((0, 1, 127, 128, 255, random.randrange(256)))])
        elif way == 1:
            new[at:at] = random.randbytes(random.randrange(1, 9))
        elif way == 2:
            del new[at : at + random.randrange(1, 9)]
        else:
            new[at:at] = new[max(at - 16, 0) : at] * random.randrange(1, 4)
    return bytes(new)


def bent(message: Message, random: Random) -> Message:
    """A copy in which one to three fields, however deep, have gone or have a value that may not do."""
    copy = type(message)()
    copy.CopyFrom(message)
    for _ in range(random.randrange(1, 4)):
        places = list(_messages(copy))
        _bend(random.choice(places), random)
    return copy


def _messages(message: Message) -> Iterator[Message]:
    """A message and all messages in it; maps of scalars and what they hold are left out."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is None or field.message_type.GetOptions().map_entry:
            continue
        for one in value if field.is_repeated else (value,):
            yield from _messages(one)


def _bend(message: Message, random: Random) -> None:
    fields = list(cast(list[FieldDescriptor], message.DESCRIPTOR.fields))
    if not fields:
        return
    field = random.choice(fields)
    if random.random() < 0.25:
        message.ClearField(field.name)  # type: ignore[arg-type]
    elif field.message_type is not None and field.message_type.GetOptions().map_entry:
        _bend_map(message, field, random)
    elif field.is_repeated:
        _bend_list(getattr(message, field.name), field, random)
    elif field.message_type is not None:
        getattr(message, field.name).SetInParent()
    else:
        setattr(message, field.name, _odd(field, random))


def _bend_map(message: Message, field: FieldDescriptor, random: Random) -> None:
    entry = cast(FieldDescriptor, field.message_type.fields_by_name["value"])  # type: ignore[union-attr]
    mapping, key = getattr(message, field.name), random.choice((*TEXTS, "joint1"))
    if entry.message_type is not None:
        mapping[key].SetInParent()
    else:
        mapping[key] = _odd(entry, random)


def _bend_list(values: Any, field: FieldDescriptor, random: Random) -> None:
    if values and random.random() < 0.5:
        if random.random() < 0.5 or field.message_type is not None:
            del values[random.randrange(len(values))]
        else:
            values[random.randrange(len(values))] = _odd(field, random)
        return
    for _ in range(random.choice((1, 1, 2, 1000))):
        if field.message_type is None:
            values.append(_odd(field, random))
        else:
            values.add()


def _odd(field: FieldDescriptor, random: Random) -> Any:
    kind = field.cpp_type
    if kind in _FLOATS:
        return random.choice(NUMBERS)
    if kind == FieldDescriptor.CPPTYPE_BOOL:
        return random.random() < 0.5
    if kind == FieldDescriptor.CPPTYPE_STRING:
        text = random.choice(TEXTS)
        return text.encode() if field.type == FieldDescriptor.TYPE_BYTES else text
    low, high = _WIDTHS[kind]
    return min(max(random.choice(WHOLE), low), high)


def made_up(kind: Descriptor, count: int, number: int) -> list[bytes]:
    """Messages of a type that hypothesis makes up."""
    found: list[bytes] = []

    @seed(number)
    @settings(max_examples=count, database=None, deadline=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(_any(kind, DEEPEST))
    def collect(message: Message) -> None:
        found.append(message.SerializeToString())

    collect()
    return found


def _any(kind: Descriptor, depth: int) -> st.SearchStrategy[Message]:
    """Messages of a type, with any of its fields set to anything."""
    fields = [field for field in cast(list[FieldDescriptor], kind.fields) if depth or field.message_type is None]

    @st.composite
    def build(draw: st.DrawFn) -> Message:
        message = GetMessageClass(kind)()
        for field in draw(st.lists(st.sampled_from(fields), max_size=4, unique_by=id)) if fields else ():
            _set(message, field, draw, depth)
        return message

    return build()


def _set(message: Message, field: FieldDescriptor, draw: st.DrawFn, depth: int) -> None:
    inner = field.message_type
    if inner is not None and inner.GetOptions().map_entry:
        value = cast(FieldDescriptor, inner.fields_by_name["value"])
        for key in draw(st.lists(st.text(max_size=8), max_size=2)):
            if value.message_type is None:
                getattr(message, field.name)[key] = draw(_scalar(value))
            else:
                getattr(message, field.name)[key].CopyFrom(draw(_any(value.message_type, depth - 1)))
    elif inner is not None and field.is_repeated:
        getattr(message, field.name).extend(draw(st.lists(_any(inner, depth - 1), max_size=2)))
    elif inner is not None:
        getattr(message, field.name).CopyFrom(draw(_any(inner, depth - 1)))
    elif field.is_repeated:
        getattr(message, field.name).extend(draw(st.lists(_scalar(field), max_size=4)))
    else:
        setattr(message, field.name, draw(_scalar(field)))


def _scalar(field: FieldDescriptor) -> st.SearchStrategy[Any]:
    kind = field.cpp_type
    if kind in _FLOATS:
        return st.floats(width=64 if kind == FieldDescriptor.CPPTYPE_DOUBLE else 32)
    if kind == FieldDescriptor.CPPTYPE_BOOL:
        return st.booleans()
    if kind == FieldDescriptor.CPPTYPE_STRING:
        return st.binary(max_size=40) if field.type == FieldDescriptor.TYPE_BYTES else st.text(max_size=20)
    known = [value.number for value in field.enum_type.values] if field.enum_type is not None else [0, 1, 2]
    return st.one_of(st.sampled_from(known), st.integers(*_WIDTHS[kind]))
