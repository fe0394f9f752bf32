"""Configuration of runc for the image: its command and user, without capabilities, with a read-only root file system.

python3 configure.py BUNDLE ROOT SERVER_TOML GROUP      reads BUNDLE/image.json, changes BUNDLE/config.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

USER = 10001  # of the Dockerfile
OWN = [f"uid={USER}", f"gid={USER}"]
ADDED = {
    "/dev/shm": ["size=1g"],
    "/tmp": ["size=1g", "mode=1777"],
    "/run/scopt": ["size=64m", "mode=0700", *OWN],
    "/var/lib/scopt": ["size=2g", *OWN],
}
DROPPED = ("/dev/shm", "/sys/fs/cgroup")
CAPABILITIES = ("bounding", "effective", "inheritable", "permitted", "ambient")


def configure(bundle: Path, root: str, settings: str, group: int) -> None:
    """Complete what ``runc spec`` wrote; ``group`` may read the secrets."""
    image = json.loads((bundle / "image.json").read_text())["Docker"]["config"]
    config: dict[str, Any] = json.loads((bundle / "config.json").read_text())
    config["root"] = {"path": root, "readonly": True}
    config["process"].update(
        terminal=False,
        args=[*image["Entrypoint"], *image["Cmd"]],
        env=image["Env"],
        cwd=image["WorkingDir"],
        user={"uid": USER, "gid": USER, "additionalGids": [group]},
        noNewPrivileges=True,
        capabilities={kind: [] for kind in CAPABILITIES},
    )
    config["mounts"] = [mount for mount in config["mounts"] if mount["destination"] not in DROPPED]
    for folder, options in ADDED.items():
        options = ["nosuid", "nodev", *options]
        config["mounts"].append({"destination": folder, "type": "tmpfs", "source": "tmpfs", "options": options})
    for path, source in (("/etc/scopt/server.toml", settings), ("/etc/scopt/secrets", str(bundle / "secrets"))):
        config["mounts"].append({"destination": path, "type": "bind", "source": source, "options": ["bind", "ro"]})
    config["linux"].pop("resources", None)
    (bundle / "config.json").write_text(json.dumps(config, indent=1))


if __name__ == "__main__":
    configure(Path(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4]))
