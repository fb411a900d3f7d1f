"""What `launch.py` is told to do: what an adapter sees of the machine, and how that is arranged.

Isolated, it sees the file system read-only, and empty places of its own where programs of a machine meet: /tmp, /run,
/dev, shared memory, /proc. Only kept apart, it sees everything as it is but the other processes.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

from xpl_cli.isolation import seccomp

MASKED = ("/tmp", "/var/tmp", "/run", "/var/run")  # noqa: S108 - hidden, not used
"""Where programs of a machine meet: temporary files and sockets."""
_PLAIN_DEVICES = ("null", "zero", "full", "random", "urandom")
_GPU_DEVICES = ("nvidia*", "nvidia-caps", "nvidia-caps/*", "dri", "kfd", "dxg", "davinci*", "accel")
_SHARED_BYTES = 1 << 32
_LINKS = frozenset(("self", "thread-self", "mounts", "net"))


def by_namespaces(*, checkout: Path, folder: Path | None) -> list[str]:
    """Return what is put before a command so that our own code keeps it apart.

    Args:
        checkout: folder of the adapter.
        folder: what stays writable where it is isolated; None to keep only processes apart.
    """
    return _launch(_plan(checkout, folder))


def by_bubblewrap(*, checkout: Path, folder: Path | None) -> list[str] | None:
    """Return the same by bubblewrap, None where it is not installed."""
    program = shutil.which("bwrap")
    if program is None:
        return None
    plan = _plan(checkout, folder)
    options = [program, "--unshare-pid", "--die-with-parent", "--new-session"]
    if folder is None:
        options += [*([] if os.geteuid() == 0 else ["--unshare-user"]), "--dev-bind", "/", "/", "--proc", "/proc"]
        return _launch({**plan, "bubblewrap": options, "last": []})
    options += ["--unshare-user", "--unshare-ipc", "--unshare-net", "--unshare-uts", "--unshare-cgroup-try"]
    options += ["--cap-drop", "ALL", "--ro-bind", "/", "/", "--dev", "/dev"]
    options += ["--perms", "1777", "--size", str(plan["shared_bytes"]), "--tmpfs", "/dev/shm"]  # noqa: S108
    for device in plan["devices"]:
        if Path(device).name not in _PLAIN_DEVICES:
            options += ["--dev-bind", device, device]
    options += ["--proc", "/proc"]
    for path in plan["covered"]:
        options += ["--ro-bind", path, path]
    for path in plan["masked"]:
        options += ["--tmpfs", path]
    last = ["--ro-bind", str(checkout), str(checkout), "--bind", str(folder), str(folder)]
    for path in (*plan["masked"], "/dev"):
        last += ["--remount-ro", path]
    return _launch({**plan, "bubblewrap": options, "last": last})


def _plan(checkout: Path, folder: Path | None) -> dict[str, Any]:
    devices = _devices()
    cuda = any(Path(device).name.startswith("nvidia") for device in devices)
    program = None if folder is None else seccomp.program(cuda=cuda)
    return {
        "isolate": folder is not None,
        "bubblewrap": None,
        "checkout": str(checkout),
        "folder": str(folder),
        "masked": [path for path in MASKED if Path(path).is_dir() and not Path(path).is_symlink()],
        "devices": devices,
        "covered": _covered(),
        "shared_bytes": _SHARED_BYTES,
        "filter": None if program is None else program.hex(),
        "keyctl": seccomp.number("keyctl"),
    }


def _launch(plan: dict[str, Any]) -> list[str]:
    script = Path(__file__).with_name("launch.py")
    return [sys.executable, "-I", "-S", str(script), json.dumps(plan), "--"]


def _devices() -> list[str]:
    """Return the devices that are shown: what every program needs, and those that compute."""
    found = [Path("/dev") / name for name in _PLAIN_DEVICES]
    found += [path for pattern in _GPU_DEVICES for path in sorted(Path("/dev").glob(pattern))]
    whole = {path for path in found if path.is_dir()}
    return sorted({str(path) for path in found if path.exists() and path.parent not in whole})


def _covered() -> list[str]:
    """Return what of /proc somebody may write to and concerns the machine, not a process."""
    found = []
    for path in sorted(Path("/proc").iterdir()):
        if path.name.isdecimal() or path.name in _LINKS:
            continue
        if path.is_dir() or (path.is_file() and path.stat().st_mode & 0o222):
            found.append(str(path))
    return found
