"""A real server and whatever is sent to it: it names what is wrong, and goes on."""

from __future__ import annotations

import os
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import pytest
from executor_waiting import until
from google.protobuf.message_factory import GetMessageClass
from planner_calls import QUICK, finished, plan_request, refusal, uploaded
from planner_server import ServerProcess, planner_server

from benchmarks.service.messages import is_invalid
from benchmarks.service.mutations import hostile, wire_type
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.proto.planner.v1.request_pb2 import CloudFile
from service.proto.planner.v1.result_pb2 import VERDICT_CERTIFIED, FileChunk

pytestmark = pytest.mark.filterwarnings("error")

N_MESSAGES, SEED = 240, 5
CRASHES = {"UNKNOWN", "INTERNAL", "UNAVAILABLE", "DATA_LOSS"}
POINTS = b"".join(b"%d %d 0.5\n" % (x, y) for x in range(10) for y in range(10))
NOBODYS = f"sha256:{'0' * 64}.pcd"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that requests may name files in; next to it is one that they may not."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "secret.xyz").write_bytes(POINTS)
    allowed = folder / "allowed"
    allowed.mkdir()
    (allowed / "link.xyz").symlink_to(folder / "secret.xyz")
    os.mkfifo(allowed / "pipe.xyz")
    return allowed


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, files: Path) -> Iterator[ServerProcess]:
    data = tmp_path_factory.mktemp("server") / "data"
    with planner_server(data, "--allow", str(files), "--requests-per-s", "10000") as started:
        yield started


@pytest.fixture(scope="module")
def channel(server: ServerProcess) -> Iterator[grpc.Channel]:
    with grpc.insecure_channel(server.address) as opened:
        yield opened


@pytest.fixture(scope="module")
def stub(channel: grpc.Channel) -> PlannerServiceStub:
    return PlannerServiceStub(channel)


@pytest.fixture(scope="module")
def cloud_id(stub: PlannerServiceStub) -> str:
    """Of a cloud that is there."""
    return stub.UploadCloud(uploaded(POINTS), timeout=120).cloud_id


@pytest.fixture(scope="module", autouse=True)
def _goes_on(server: ServerProcess, stub: PlannerServiceStub) -> Iterator[None]:
    """After everything the server plans with the workers it began with, and nothing surprised it."""
    yield
    result = finished(stub.Plan(plan_request(), timeout=240)).result
    assert result.verdict == VERDICT_CERTIFIED
    assert stub.GetStatus(wire.GetStatusRequest(), timeout=120).worker_restarts == 0
    assert "incident" not in server.log.read_text()


def _call(channel: grpc.Channel, name: str, messages: list[bytes]) -> Callable[[], Any]:
    method = wire.DESCRIPTOR.services_by_name["PlannerService"].methods_by_name[name]
    path = f"/planner.v1.PlannerService/{name}"
    if method.client_streaming:
        return lambda: channel.stream_unary(path)(iter(messages), timeout=120)
    if method.server_streaming:
        return lambda: list(channel.unary_stream(path)(messages[0], timeout=120))
    return lambda: channel.unary_unary(path)(messages[0], timeout=120)


def test_no_message_surprises_the_server_and_invalid_ones_are_told_their_fields(
    channel: grpc.Channel, cloud_id: str
) -> None:
    for name, messages in hostile(N_MESSAGES, SEED, cloud_id):
        code, text, found = refusal(_call(channel, name, messages))
        assert code not in CRASHES, (name, messages, text)
        if is_invalid(name, messages):
            assert code == "INVALID_ARGUMENT", (name, messages, text)
        if code == "INVALID_ARGUMENT":
            assert found, (name, messages, text)
            assert all(field or words.startswith("the bytes are no ") for field, words in found.items())


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("Plan", {"request"}),
        ("UploadCloud", {"header"}),
        ("BuildScene", {"clouds.clouds"}),
        ("Detect", {"clouds.clouds"}),
        ("Verify", {"plan_id"}),
        ("GetPlan", {"plan_id"}),
        ("ReviewPlan", {"decision"}),
    ],
)
def test_empty_message_is_told_what_is_missing(channel: grpc.Channel, name: str, fields: set[str]) -> None:
    code, _, found = refusal(_call(channel, name, [GetMessageClass(wire_type(name))().SerializeToString()]))
    assert (code, set(found)) == ("INVALID_ARGUMENT", fields)


def _nan(message: wire.PlanRequest) -> None:
    message.request.start.joints["l_arm_elx"] = float("nan")


def _endless(message: wire.PlanRequest) -> None:
    message.request.scene.sensor.extend([0.0, 0.0, float("inf")])


def _short(message: wire.PlanRequest) -> None:
    message.request.start.base.position.extend([1.0, 2.0])


def _shorter(message: wire.PlanRequest) -> None:
    message.request.scene.obstacles.add(type=1, name="b", size=[1.0])  # type: ignore[arg-type]


def _uneven(message: wire.PlanRequest) -> None:
    message.request.start.joint_names.extend(["l_arm_elx"])
    message.request.start.positions.extend([1.0, 2.0])


def _enum(message: wire.PlanRequest) -> None:
    message.request.options.qp = 99  # type: ignore[assignment]


def _crowd(message: wire.PlanRequest) -> None:
    for _ in range(1_000_000):
        message.request.goal.poses.add()


def _long(message: wire.PlanRequest) -> None:
    message.request.start.posture = "x" * 2_000_000


@pytest.mark.parametrize(
    ("bend", "field", "words"),
    [
        (_nan, "request.start.joints.l_arm_elx", "finite"),
        (_endless, "request.scene.sensor[2]", "finite"),
        (_short, "request.start.base.position", "entry 3 is missing"),
        (_shorter, "request.scene.obstacles[0].size", "entry 3 is missing"),
        (_uneven, "request.start", "as many"),
        (_enum, "request.options.qp", "'clarabel'"),
        (_crowd, "request.goal.poses", "too many entries"),
        (_long, "request.start.posture", "at most 200 characters"),
    ],
)
def test_values_that_nothing_can_be_done_with_are_named(
    stub: PlannerServiceStub, bend: Callable[[wire.PlanRequest], None], field: str, words: str
) -> None:
    message = plan_request()
    bend(message)
    code, _, found = refusal(lambda: stub.Plan(message, timeout=120))
    assert code == "INVALID_ARGUMENT"
    assert words in found[field]


@pytest.mark.parametrize("depth", [5, 30, 3000])
def test_problem_is_refused_however_deep_it_is(channel: grpc.Channel, depth: int) -> None:
    struct = b""
    for _ in range(depth):  # Struct.fields, its key and value, and in that a Struct again
        struct = _field(1, _field(1, b"a") + _field(2, _field(5, struct)))
    robot, task = _field(1, _field(1, b"atlas")), _field(5, _field(4, struct))
    code, _, found = refusal(_call(channel, "Plan", [_field(2, robot + task)]))
    assert code == "INVALID_ARGUMENT"
    within = {f"request.task.trajopt.{name}" for name in ("basic_info", "init_info", "a")}
    too_deep = {"request.task.trajopt": "task.trajopt: nested deeper than 30 levels"}
    assert set(found) == within or found in (too_deep, {"": "the bytes are no planner.v1.PlanRequest"})


def _field(number: int, data: bytes) -> bytes:
    """A field of bytes or a message, as protobuf writes it."""
    size, length = len(data), b""
    while size > 127:
        length += bytes([size & 127 | 128])
        size >>= 7
    return bytes([number << 3 | 2]) + length + bytes([size]) + data


def test_message_beyond_the_limit_is_not_read(stub: PlannerServiceStub) -> None:
    message = plan_request()
    message.request.start.posture = "x" * 5_000_000
    code, text, _ = refusal(lambda: stub.Plan(message, timeout=120))
    assert code == "RESOURCE_EXHAUSTED"
    assert "larger than max" in text


@pytest.mark.parametrize(
    ("messages", "field", "words"),
    [
        ([wire.UploadCloudRequest(chunk=POINTS)], "header", "the first message"),
        ([*uploaded(POINTS), *uploaded(POINTS)], "chunk", "every message after the first"),
        ([*uploaded(POINTS, format="exe")], "header.format", "got 'exe'"),
        ([*uploaded(POINTS, format="../xyz")], "header.format", "got '../xyz'"),
        ([*uploaded(POINTS, sha256="zz")], "header.sha256", "64 hexadecimal digits"),
        ([*uploaded(POINTS, sha256="0" * 64)], "header.sha256", "the received bytes have"),
        ([*uploaded(POINTS, size_bytes=77)], "header.size_bytes", "77 bytes were announced"),
        ([*uploaded(POINTS, size_bytes=2**40)], "header.size_bytes", "at most 67108864"),
        ([*uploaded(b"")], "chunk", "empty"),
    ],
    ids=["no header", "two headers", "format", "path", "no hash", "hash", "size", "huge", "empty"],
)
def test_upload_that_is_none_is_refused_and_leaves_nothing(
    stub: PlannerServiceStub, server: ServerProcess, messages: list[wire.UploadCloudRequest], field: str, words: str
) -> None:
    before = _kept(server)
    code, _, found = refusal(lambda: stub.UploadCloud(iter(messages), timeout=120))
    assert code == "INVALID_ARGUMENT"
    assert words in found[field]
    assert _kept(server) == before


def test_cloud_beyond_the_limit_is_refused_on_its_way(stub: PlannerServiceStub, server: ServerProcess) -> None:
    before = _kept(server)
    code, _, found = refusal(lambda: stub.UploadCloud(uploaded(bytes(65 * 2**20), chunk_bytes=2**21), timeout=240))
    assert code == "INVALID_ARGUMENT"
    assert "downsample" in found["chunk"]
    assert _kept(server) == before


def test_upload_that_breaks_off_leaves_nothing(stub: PlannerServiceStub, server: ServerProcess) -> None:
    before = _kept(server)
    messages = list(uploaded(b"7 7 7\n" * 1000, chunk_bytes=100))
    is_over = threading.Event()

    def endless() -> Iterator[wire.UploadCloudRequest]:
        yield from messages
        is_over.wait(120.0)

    call = stub.UploadCloud.future(endless(), timeout=120)
    assert until(lambda: len(_kept(server)) > len(before))
    call.cancel()
    assert until(lambda: _kept(server) == before)
    is_over.set()


def test_cloud_that_is_there_is_known_by_its_bytes_and_by_its_hash(stub: PlannerServiceStub) -> None:
    data = POINTS + b"3 3 3\n"
    first, again = (stub.UploadCloud(uploaded(data), timeout=120) for _ in range(2))
    sha256 = first.cloud_id.removeprefix("sha256:").removesuffix(".xyz")
    unsent = stub.UploadCloud(uploaded(b"", sha256=sha256), timeout=120)
    assert (first.was_known, again.was_known, unsent.was_known) == (False, True, True)
    assert {(one.cloud_id, one.size_bytes) for one in (first, again, unsent)} == {(first.cloud_id, len(data))}


def _kept(server: ServerProcess) -> set[str]:
    """Files of clouds, on their way or there."""
    return {path.name for path in (server.log.parent / "data" / "clouds").iterdir()}


def _asks_for_cloud(stub: PlannerServiceStub, path: str) -> dict[str, Callable[[], Any]]:
    """Every request that names a cloud, by the field that does."""
    message, clouds = plan_request(), wire.CloudsSpec(clouds=[{"file": path}])  # type: ignore[list-item]
    message.request.scene.cloud.file = path
    return {
        "request.scene.cloud": lambda: stub.Plan(message, timeout=120),
        "clouds.clouds[0].file": lambda: stub.Detect(wire.DetectRequest(clouds=clouds, kind="valve"), timeout=120),
        "clouds.clouds[0].file ": lambda: stub.BuildScene(wire.BuildSceneRequest(clouds=clouds), timeout=120),
    }


@pytest.mark.parametrize(
    "path",
    [
        "{allowed}/../secret.xyz",
        "{allowed}/link.xyz",
        "file://{allowed}/x.xyz",
        "../secret.xyz",
        "/etc/passwd",
        "/proc/self/environ",
        "~/x.xyz",
        NOBODYS,
        "sha256:../../x.pcd",
        "{allowed}/pipe.xyz",
        "{allowed}/gone.xyz",
    ],
)
def test_file_that_may_not_be_named_is_refused_by_every_request(
    stub: PlannerServiceStub, files: Path, path: str
) -> None:
    for field, ask in _asks_for_cloud(stub, path.format(allowed=files)).items():
        code, text, found = refusal(ask)
        assert (code, set(found)) == ("INVALID_ARGUMENT", {field.strip()}), text
        assert "\n" not in text


def _pcd(width: int, size: int = 4, data: bytes = b"") -> bytes:
    head = f"VERSION .7\nFIELDS x y z\nSIZE {size} {size} {size}\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {width}\nHEIGHT 1\n"
    return f"{head}POINTS {width}\nDATA binary\n".encode() + data


def _npy(descr: str, shape: str, data: bytes) -> bytes:
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


HARMFUL = {
    "pcd of 2e9 points": ("pcd", _pcd(2_000_000_000, data=bytes(120)), "2000000000 points"),
    "pcd of negative width": ("pcd", _pcd(-5), "WIDTH '-5'"),
    "pcd of numbers without bytes": ("pcd", _pcd(10, size=0), "SIZE 0"),
    "ply of 2e9 points": (
        "ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\nproperty float x\n"
        b"property float y\nproperty float z\nend_header\n",
        "2000000000 vertices",
    ),
    "npy of 5.6 GiB": ("npy", _npy("<f4", "(500000000, 3)", b""), "6000000000 bytes"),
    "npy that is a pickle": ("npy", _npy("|O", "(1, 3)", b"cos\nabort\n(tR."), "pickled"),
    "nothing but NaN": ("xyz", b"nan inf -inf\n" * 100, "100 of 100 points"),
    "line without end": ("csv", b"9" * 200_000, "longer than 65536 bytes"),
    "noise": ("mcap", bytes(range(256)) * 10, "is damaged, or no mcap file"),
}  # fmt: skip


@pytest.mark.parametrize("number", range(len(HARMFUL)), ids=list(HARMFUL))
def test_cloud_that_lies_is_one_clear_line(stub: PlannerServiceStub, server: ServerProcess, number: int) -> None:
    suffix, data, words = list(HARMFUL.values())[number]
    cloud_id = stub.UploadCloud(uploaded(data, format=suffix), timeout=120).cloud_id
    # Reading costs a process: the requests that can name a cloud take turns.
    field, ask = list(_asks_for_cloud(stub, cloud_id).items())[number % 3]
    code, text, found = refusal(ask)
    assert (code, set(found)) == ("INVALID_ARGUMENT", {field.strip()}), text
    assert words in text
    assert cloud_id in text
    assert str(server.log.parent) not in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("field", "asked"),
    [
        ("hint", {"hint": [1.0]}),
        ("unknown", {"unknown": 77}),
        ("method", {"method": 77}),
        ("clouds.unit", {"clouds": {"clouds": [{"file": NOBODYS}], "unit": 77}}),
        ("clouds.clouds[1].file", {"clouds": {"clouds": [{"file": NOBODYS}, {"file": ""}]}}),
        ("clouds.clouds", {"clouds": {"clouds": [{"file": NOBODYS}] * 20_000}}),
    ],
)
def test_what_is_wrong_with_a_scan_is_told_with_its_field(
    stub: PlannerServiceStub, field: str, asked: dict[str, Any]
) -> None:
    request = wire.BuildSceneRequest(**{"clouds": wire.CloudsSpec(clouds=[CloudFile(file=NOBODYS)]), **asked})
    code, text, found = refusal(lambda: list(stub.BuildScene(request, timeout=120)))
    assert (code, set(found)) == ("INVALID_ARGUMENT", {field}), text


def test_unknown_kinds_and_robots_of_a_scan_are_named(stub: PlannerServiceStub, cloud_id: str) -> None:
    clouds = wire.CloudsSpec(clouds=[{"file": cloud_id}])  # type: ignore[list-item]
    odd = wire.CloudsSpec(clouds=clouds.clouds, robot="r2d2")
    flat = wire.CloudsSpec(clouds=clouds.clouds, top_m=-0.5)
    no_bag = wire.CloudsSpec(clouds=clouds.clouds, topic="/points")
    asks = {
        "kind": lambda: stub.Detect(wire.DetectRequest(clouds=clouds, kind="cow"), timeout=120),
        "detect": lambda: stub.BuildScene(wire.BuildSceneRequest(clouds=clouds, detect=["cow"]), timeout=120),
        "clouds.robot": lambda: stub.Detect(wire.DetectRequest(clouds=odd, kind="valve"), timeout=120),
        "clouds.top_m": lambda: stub.Detect(wire.DetectRequest(clouds=flat, kind="valve"), timeout=120),
        "clouds.clouds[0].file": lambda: stub.Detect(wire.DetectRequest(clouds=no_bag, kind="valve"), timeout=120),
    }
    for field, ask in asks.items():
        code, text, found = refusal(ask)
        assert (code, set(found)) == ("INVALID_ARGUMENT", {field}), text


def _with_mesh(path: str) -> str:
    return (
        f'<robot name="r"><link name="a"><collision><geometry><mesh filename="{path}"/></geometry></collision></link>'
        '<link name="b"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )


ROBOTS = {
    "bomb": (
        '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><robot name="&b;"/>',
        "DOCTYPE is refused",
    ),
    "file": ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>', "DOCTYPE is refused"),
    "depth": ('<robot name="r">' + "<a>" * 50_000 + "</a>" * 50_000 + "</robot>", "nested too deeply"),
    "chain": (
        '<robot name="r">' + "".join(f'<link name="l{k}"/>' for k in range(5000)) + "</robot>",
        "at most 512 are read",
    ),
    "mesh by URL": (
        _with_mesh("file:///etc/passwd"),
        "lies outside the package folders",
    ),
    "mesh outside": (
        _with_mesh("package://../secret.xyz"),
        "'..' is refused",
    ),
}


@pytest.mark.parametrize(("text", "words"), ROBOTS.values(), ids=ROBOTS.keys())
def test_robot_that_does_harm_is_one_clear_line(stub: PlannerServiceStub, files: Path, text: str, words: str) -> None:
    (files / "robot.urdf").write_text(text)
    message = plan_request({**QUICK, "robot": {"urdf": str(files / "robot.urdf")}, "start": {}})
    code, told, found = refusal(lambda: stub.Plan(message, timeout=120))
    assert (code, set(found)) == ("INVALID_ARGUMENT", {"request.robot"}), told
    assert words in told
    assert "\n" not in told


@pytest.mark.parametrize(
    ("files_sent", "words"),
    [
        ({"../result.json": b"{}"}, "is outside the result folder"),
        ({"/etc/cron.d/x": b""}, "is outside the result folder"),
        ({"result.json": b"{}", "result.json/x": b""}, "is no path of a file"),
        ({"result.json": b"{"}, "is no JSON"),
        ({"result.json": b"[" * 100_000}, "is no JSON"),
        ({"result.json": b'{"format": "scopt-result/1"}'}, "no motion to verify"),
        ({"else.json": b"{}"}, "result.json cannot be read"),
        ({f"robot/{number}.stl": b"" for number in range(1001)}, "expected at most 1000"),
    ],
)
def test_result_files_that_lie_are_refused(stub: PlannerServiceStub, files_sent: dict[str, bytes], words: str) -> None:
    request = wire.VerifyRequest(files=[FileChunk(path=path, data=data) for path, data in files_sent.items()])
    code, text, found = refusal(lambda: stub.Verify(request, timeout=120))
    assert (code, set(found)) == ("INVALID_ARGUMENT", {"files"}), text
    assert words in text


def test_file_to_verify_may_come_in_many_pieces(stub: PlannerServiceStub) -> None:
    pieces = [FileChunk(path="result.json", data=b"        ")] * 50_000
    pieces += [FileChunk(path="result.json", data=data) for data in (b'{"form', b'at": "scopt-result/1"}')]
    code, text, _ = refusal(lambda: stub.Verify(wire.VerifyRequest(files=pieces), timeout=120))
    assert (code, "no motion to verify" in text) == ("INVALID_ARGUMENT", True), text


def test_review_that_is_too_long_is_named(stub: PlannerServiceStub) -> None:
    request = wire.ReviewPlanRequest(plan_id="a", decision=wire.DECISION_ACCEPTED, comment="x" * 5000)
    code, _, found = refusal(lambda: stub.ReviewPlan(request, timeout=120))
    assert (code, set(found)) == ("INVALID_ARGUMENT", {"comment"})


@pytest.mark.parametrize("plan_id", ["' or 1=1 --", "../../plans", "x" * 10_000, "a\0b"])
def test_plan_that_is_not_there_is_not_found(stub: PlannerServiceStub, plan_id: str) -> None:
    code, text, _ = refusal(lambda: stub.GetPlan(wire.GetPlanRequest(plan_id=plan_id), timeout=120))
    assert code == "NOT_FOUND"
    assert len(text) < 200


def test_half_open_connections_and_garbage_do_not_disturb_others(
    server: ServerProcess, stub: PlannerServiceStub
) -> None:
    host, _, port = server.address.rpartition(":")
    begun = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
    strangers = []
    try:
        for number in range(60):
            stranger = socket.create_connection((host, int(port)), timeout=120)
            stranger.sendall(
                (begun[: 1 + number % len(begun)], begun, b"GET / HTTP/1.1\r\n\r\n", b"\0\xff" * 2048)[number % 4]
            )
            strangers.append(stranger)
        assert stub.GetStatus(wire.GetStatusRequest(), timeout=120).version
        assert finished(stub.Plan(plan_request(), timeout=240)).result.verdict == VERDICT_CERTIFIED
    finally:
        for stranger in strangers:
            stranger.close()
