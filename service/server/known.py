"""What a scene is made with besides clouds, as a server takes it: known meshes, and an earlier scene to update."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from service.errors import RequestError
from service.proto.planner.v1.planner_pb2 import BuildSceneRequest
from service.request.file import parse_known
from service.request.scene import KnownRequest
from service.server.asked import uploaded
from service.server.cloud_problems import OF_BEFORE, Kept
from service.server.refusal import invalid
from service.store import CloudStore
from service.store.scenes import Scenes
from service.trust import AllowedFolders
from service.trust.folders import BUILT
from service.wire.plain import to_plain


@dataclass(frozen=True)
class KnownThings:
    """Reads what is known, and finds its files.

    Attributes:
        folders: that requests may name files in.
        clouds: that were uploaded, meshes among them; scenes: that were built.
    """

    folders: AllowedFolders
    clouds: CloudStore
    scenes: Scenes

    def asked(self, message: BuildSceneRequest) -> KnownRequest:
        """What a message says of them.

        Raises:
            Refusal: INVALID_ARGUMENT, naming every field.
        """
        plain = to_plain(message)
        try:
            known = parse_known({key: plain[key] for key in ("meshes", "update") if key in plain})
        except RequestError as error:
            raise invalid(error.problems) from None
        refused = {f"meshes[{k}].file": self.folders.refused(one.file, "mesh") for k, one in enumerate(known.meshes)}
        refused["update"] = "" if known.update is None else self.folders.refused(known.update, "scene")
        problems = [f"{field}: {words}" for field, words in refused.items() if words]
        if problems:
            raise invalid(problems)
        return known

    @contextmanager
    def found(self, known: KnownRequest) -> Iterator[dict[str, Path]]:
        """Where the files of meshes and of the scene to update are, by their names, while the body runs.

        Raises:
            NotStoredError: one of them has gone meanwhile.
        """
        with ExitStack() as held:
            files = {name: Path(name) for name in known.files}
            files |= held.enter_context(self.clouds.using(uploaded(known.files)))
            if known.update is not None and known.update.startswith(BUILT):
                files[known.update] = held.enter_context(self.scenes.as_file(known.update))
            yield files


def said_settings(message: BuildSceneRequest) -> dict[str, str]:
    """Settings that a message says itself, and what they are called in it."""
    given = message.clouds
    is_said = {name: given.HasField(name) for name in ("reach_m", "top_m", "bottom_m")}
    is_said |= {"seed": bool(given.seed), "unknown": bool(message.unknown), "method": bool(message.method)}
    return {name: OF_BEFORE[name] for name, is_there in is_said.items() if is_there}


def kept_files(known: KnownRequest, found: Mapping[str, Path]) -> list[Kept]:
    """The files, where they are kept here."""
    kept = [Kept(f"meshes[{k}].file", one.file, found[one.file]) for k, one in enumerate(known.meshes)]
    return kept if known.update is None else [*kept, Kept("update", known.update, found[known.update])]
