"""Bytes of a store flipped one after the other: whatever is read is what was written, or is refused."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options
from benchmarks.service.servers import started
from service.client import PlannerClient
from service.store import CloudStore, Store, StoreError, find_damaged_uploads

CLOUD = b"".join(b"%d %d 0\n" % (k % 40, k // 40) for k in range(2000))


def measure(options: Options, folder: Path) -> list[Figure]:
    """Flip bits in copies of a killed server's data with a reviewed plan, a scene and a cloud."""
    plan_id, scene_id, cloud_id = _fill(folder)
    sound = folder / "data"
    # A store that is opened empties its log.
    expected = _read(Path(shutil.copytree(sound, folder / "read")), plan_id, scene_id, cloud_id)
    random, n, served, refused = Random(options.seed), options.count(2000, 60), 0, 0
    files = [path.relative_to(sound) for path in sorted(sound.rglob("*")) if path.is_file() and path.name != "lock"]
    files = [name for name in files if (sound / name).stat().st_size]
    for _ in range(n):
        copy = folder / "copy"
        shutil.copytree(sound, copy)
        name = random.choice(files)
        data = bytearray((copy / name).read_bytes())
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)
        (copy / name).write_bytes(data)
        answers = _read(copy, plan_id, scene_id, cloud_id)
        served += any(value != expected[key] for key, value in answers.items())
        refused += len(answers) < len(expected)
        shutil.rmtree(copy)
    return [
        Figure(
            f"{n} flipped bits in {len(files)} files: damaged data served",
            "0",
            f"{served}; refused {refused}",
            served == 0,
        )
    ]


def _fill(folder: Path) -> tuple[str, str, str]:
    """Have a server store a plan with its review, a scene, a cloud, and a later plan; then kill it."""
    file = folder / "cloud.xyz"
    file.write_bytes(CLOUD)
    with started(folder, workers=1) as server:
        with PlannerClient(server.address) as client:
            cloud_id = client.upload_cloud(file)
            scene_id = client.build_scene([cloud_id]).scene_id
            plan = client.plan(asks.motion(asks.ELBOW), out=folder / "out")
            client.review(client.get_plan(plan.plan_id).record, accept=True)
            plan_id = plan.plan_id
            client.plan(asks.motion(asks.ELBOW), out=folder / "later")
        server.kill()  # what was written last is left in the write-ahead log
    return plan_id, scene_id, cloud_id


def _read(data: Path, plan_id: str, scene_id: str, cloud_id: str) -> dict[str, Any]:
    """Return all that can be read of a server's data."""
    answers: dict[str, Any] = {}
    try:
        with Store(data / "plans") as store:
            reads: dict[str, Callable[[], Any]] = {
                "plan": lambda: store.plans.get(plan_id),
                "reviews": lambda: store.reviews.find(plan_id) or _refuse(),
                "files": lambda: _archive(store, plan_id),
                "scene": lambda: store.scenes.get(scene_id),
            }
            for name, read in reads.items():
                try:
                    answers[name] = read()
                except StoreError:
                    continue
        with CloudStore(data / "clouds") as clouds, clouds.open_files([cloud_id]) as paths:
            if not find_damaged_uploads(map(str, paths.values())):
                answers["cloud"] = paths[cloud_id].read_bytes()
    except StoreError:
        pass
    return answers


def _archive(store: Store, plan_id: str) -> bytes:
    with store.plans.open_archive(plan_id) as file:
        return file.read()


def _refuse() -> Any:
    raise StoreError("there is no review, and a plan without one is not approved")
