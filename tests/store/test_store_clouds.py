"""Uploaded clouds are kept once, within bounds, and stay while they are used."""

from __future__ import annotations

import hashlib
import os
import threading
from pathlib import Path

import pytest

from perception.files.formats import SUFFIXES
from perception.solids import read as meshes
from service.request.scene import MESH_SUFFIXES
from service.store import (
    UPLOAD_SUFFIXES,
    CloudLimits,
    CloudStore,
    NotStoredError,
    StoreError,
    StoreFullError,
    TooLargeError,
    UploadRefusedError,
)


def _uploaded(store: CloudStore, data: bytes, client: str = "ann", suffix: str = ".pcd") -> str:
    with store.upload(client, suffix) as upload:
        for start in range(0, len(data), 7):
            upload.write(data[start : start + 7])
        return upload.finish()


def _path(store: CloudStore, cloud_id: str) -> Path:
    with store.open_files([cloud_id]) as files:
        return files[cloud_id]


def test_every_kind_of_cloud_file_that_is_read_can_be_uploaded() -> None:
    assert (*SUFFIXES, ".json", ".stl", ".obj") == UPLOAD_SUFFIXES  # a scene and meshes besides
    assert set(MESH_SUFFIXES) == set(meshes.SUFFIXES) <= set(UPLOAD_SUFFIXES)


def test_a_cloud_is_found_under_the_hash_of_what_was_sent_and_its_suffix(tmp_path: Path) -> None:
    with CloudStore(tmp_path) as store:
        cloud_id = _uploaded(store, b"a cloud in several chunks", suffix=".PCD")
        assert cloud_id == f"sha256:{hashlib.sha256(b'a cloud in several chunks').hexdigest()}.pcd"
        assert _path(store, cloud_id) == tmp_path / cloud_id
        assert _path(store, cloud_id).read_bytes() == b"a cloud in several chunks"


def test_the_same_cloud_is_kept_once_and_outlives_a_restart(tmp_path: Path) -> None:
    with CloudStore(tmp_path) as store:
        ids = {_uploaded(store, b"cloud", client) for client in ("ann", "bob")}
        assert len(ids) == 1
        assert (store.stats().n_clouds, store.stats().n_bytes) == (1, 5)
    with CloudStore(tmp_path) as store:
        assert _path(store, ids.pop()).read_bytes() == b"cloud"


@pytest.mark.parametrize("cloud_id", ["", "sha256:" + "0" * 64 + ".pcd", "../../etc/passwd", ".partial-x", "lock"])
def test_what_was_not_uploaded_is_not_there(tmp_path: Path, cloud_id: str) -> None:
    with CloudStore(tmp_path / "clouds") as store:
        (tmp_path / "clouds" / ".partial-x").write_text("")
        assert not store.has(cloud_id)
        with pytest.raises(NotStoredError, match="upload it first"), store.open_files([cloud_id]):
            pass


def test_an_upload_that_ends_early_leaves_nothing(tmp_path: Path) -> None:
    with CloudStore(tmp_path) as store:
        with store.upload("ann", ".ply") as upload:
            upload.write(b"half")
        assert (store.stats().n_bytes, store.stats().n_uploads) == (0, 0)
        assert [path.name for path in tmp_path.iterdir()] == ["lock"]


def test_an_upload_that_is_closed_while_it_is_written_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with CloudStore(tmp_path) as store:
        is_writing, may_go_on = threading.Event(), threading.Event()
        arrive = store._reserve

        def slowly(n_bytes: int) -> None:
            arrive(n_bytes)
            is_writing.set()
            may_go_on.wait(60)

        monkeypatch.setattr(store, "_reserve", slowly)
        upload = store.upload("ann", ".ply")
        thread = threading.Thread(target=upload.write, args=(b"half",))
        thread.start()
        assert is_writing.wait(60)
        upload.close()
        assert store.stats().n_uploads == 1
        may_go_on.set()
        thread.join()
        assert (store.stats().n_bytes, store.stats().n_uploads) == (0, 0)
        assert [path.name for path in tmp_path.iterdir()] == ["lock"]
        with pytest.raises(StoreError, match="is closed"):
            upload.write(b"more")
        with pytest.raises(StoreError, match="is closed"):
            upload.finish()


def test_what_a_killed_server_left_of_an_upload_is_removed_at_start(tmp_path: Path) -> None:
    (tmp_path / ".partial-0123").write_bytes(b"half")
    (tmp_path / "notes.md").write_text("not ours")
    with CloudStore(tmp_path) as store:
        assert {path.name for path in tmp_path.iterdir()} == {"lock", "notes.md"}
        assert store.stats().n_clouds == 0


def test_a_cloud_that_is_too_large_empty_or_of_no_known_kind_is_refused(tmp_path: Path) -> None:
    with CloudStore(tmp_path, CloudLimits(max_cloud_bytes=10)) as store:
        with pytest.raises(TooLargeError, match="more than 10 bytes"):
            _uploaded(store, b"eleven byte")
        with pytest.raises(UploadRefusedError, match="is empty"):
            _uploaded(store, b"")
        for suffix in (".exe", "", "pcd", "/../x.pcd"):
            with pytest.raises(UploadRefusedError, match=r"unknown suffix .*; expected \.pcd"):
                store.upload("ann", suffix)
        assert (store.stats().n_clouds, store.stats().n_uploads) == (0, 0)


def test_uploads_on_their_way_are_limited_by_client_and_in_all(tmp_path: Path) -> None:
    with CloudStore(tmp_path, CloudLimits(max_uploads=3, max_uploads_per_client=2)) as store:
        first, second = store.upload("ann", ".pcd"), store.upload("ann", ".pcd")
        with pytest.raises(StoreFullError, match="this client has 2 open uploads"):
            store.upload("ann", ".pcd")
        third = store.upload("bob", ".pcd")
        with pytest.raises(StoreFullError, match="the server has 3 open uploads"):
            store.upload("cid", ".pcd")
        for upload in (first, third):
            upload.close()
            upload.close()
        assert store.stats().n_uploads == 1
        store.upload("ann", ".pcd").close()
        second.close()


def test_clouds_used_least_recently_go_first_and_those_in_use_never(tmp_path: Path) -> None:
    with CloudStore(tmp_path, CloudLimits(max_bytes=30)) as store:
        first, second, third = (_uploaded(store, bytes([65 + n]) * 10) for n in range(3))
        with store.open_files([second]):
            _path(store, first)
            fourth = _uploaded(store, b"D" * 10)
            assert [store.has(one) for one in (first, second, third, fourth)] == [True, True, False, True]
            fifth = _uploaded(store, b"E" * 20)
            assert [store.has(one) for one in (first, second, fourth, fifth)] == [False, True, False, True]
            with store.open_files([fifth]), pytest.raises(StoreFullError, match="in use leave no space"):
                _uploaded(store, b"F")
        assert store.stats().n_bytes == 30
        _uploaded(store, b"G" * 10)
        assert not store.has(second)


def test_bytes_on_their_way_count(tmp_path: Path) -> None:
    with CloudStore(tmp_path, CloudLimits(max_bytes=30)) as store, store.upload("ann", ".pcd") as upload:
        upload.write(b"x" * 25)
        with pytest.raises(StoreFullError):
            _uploaded(store, b"y" * 6)
        assert store.stats().n_bytes == 25


def test_a_restart_remembers_which_cloud_was_used_last(tmp_path: Path) -> None:
    with CloudStore(tmp_path) as store:
        first, second = _uploaded(store, b"A" * 10), _uploaded(store, b"B" * 10)
        for age, cloud_id in ((0, first), (100, second)):
            os.utime(tmp_path / cloud_id, (1e9 - age, 1e9 - age))
    with CloudStore(tmp_path, CloudLimits(max_bytes=20)) as store:
        _uploaded(store, b"C" * 10)
        assert (store.has(first), store.has(second)) == (True, False)


def test_a_cloud_that_somebody_removed_is_asked_for_again(tmp_path: Path) -> None:
    with CloudStore(tmp_path) as store:
        cloud_id = _uploaded(store, b"cloud")
        (tmp_path / cloud_id).unlink()
        with pytest.raises(NotStoredError), store.open_files([cloud_id]):
            pass
        assert _uploaded(store, b"cloud") == cloud_id
        assert _path(store, cloud_id).read_bytes() == b"cloud"


def test_a_second_server_on_the_same_clouds_is_refused(tmp_path: Path) -> None:
    with CloudStore(tmp_path), pytest.raises(StoreError, match="in use by another server"):
        CloudStore(tmp_path)
