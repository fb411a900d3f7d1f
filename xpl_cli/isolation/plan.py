"""Command prefixes that isolate an adapter.

An isolated adapter sees a read-only file system, with private /tmp, /run, /dev, shared memory and /proc. With a PID
namespace only, it sees everything but the other processes.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from xpl_cli.isolation import seccomp

MASKED = ("/tmp", "/var/tmp", "/run", "/var/run")  # noqa: S108 - hidden, not used
"""Folders that programs of a machine share: temporary files and sockets."""
_GPU_DEVICES = ("nvidia*", "nvidia-caps", "nvidia-caps/*", "dri", "kfd", "dxg", "davinci*", "accel")
_SHARED_BYTES = 1 << 32
_LINKS = frozenset(("self", "thread-self", "mounts", "net"))


def isolated(program: str, *, checkout: Path, folder: Path) -> list[str]:
    """Return the command prefix for isolation by bubblewrap.

    Args:
        program: path of bubblewrap.
        checkout: folder of the adapter.
        folder: the writable folder.
    """
    devices = _devices()
    masked = [path for path in MASKED if Path(path).is_dir() and not Path(path).is_symlink()]
    options = ["--unshare-all", "--unshare-user", "--die-with-parent", "--new-session", "--cap-drop", "ALL"]
    options += ["--ro-bind", "/", "/", "--dev", "/dev"]
    options += ["--perms", "1777", "--size", str(_SHARED_BYTES), "--tmpfs", "/dev/shm"]  # noqa: S108
    for device in devices:
        options += ["--dev-bind", device, device]
    options += ["--proc", "/proc"]
    for path in _covered():
        options += ["--ro-bind", path, path]
    for path in masked:
        options += ["--tmpfs", path]
    last = ["--ro-bind", str(checkout), str(checkout), "--bind", str(folder), str(folder)]
    for path in (*masked, "/dev"):
        last += ["--remount-ro", path]
    refused = seccomp.program(cuda=any(Path(device).name.startswith("nvidia") for device in devices))
    return _launch(
        {
            "isolate": [program, *options],
            "last": last,
            "given": [str(checkout), str(folder)],
            "masked": masked,
            "writable": [str(folder), "/dev", "/proc"],
            "filter": None if refused is None else refused.hex(),
            "keyctl": seccomp.number("keyctl"),
        }
    )


def apart_by_namespaces() -> list[str]:
    """Return the command prefix for a PID namespace without capabilities, by `launch.py`."""
    return _launch({"covered": _covered()})


def apart_by_bubblewrap(program: str) -> list[str]:
    """Return the command prefix for a PID namespace by bubblewrap, which may be set-uid."""
    options = ["--unshare-pid", "--die-with-parent", "--new-session", "--cap-drop", "ALL"]
    options += [] if os.geteuid() == 0 else ["--unshare-user"]
    system = ["--ro-bind", "/sys", "/sys"] if Path("/sys").is_dir() else []
    covered = [word for path in _covered() for word in ("--ro-bind", path, path)]
    return [program, *options, "--dev-bind", "/", "/", *system, "--proc", "/proc", *covered, "--"]


def _launch(plan: dict[str, object]) -> list[str]:
    script = Path(__file__).with_name("launch.py")
    return [sys.executable, "-I", "-S", str(script), json.dumps(plan), "--"]


def _devices() -> list[str]:
    """Return the compute devices; bubblewrap provides the standard ones."""
    devices = [path for pattern in _GPU_DEVICES for path in sorted(Path("/dev").glob(pattern))]
    whole = {path for path in devices if path.is_dir()}
    return sorted({str(path) for path in devices if path.exists() and path.parent not in whole})


def _covered() -> list[str]:
    """Return the paths below /proc that are writable and concern the machine, not a process."""
    paths = []
    for path in sorted(Path("/proc").iterdir()):
        if path.name.isdecimal() or path.name in _LINKS:
            continue
        if path.is_dir() or (path.is_file() and path.stat().st_mode & 0o222):
            paths.append(str(path))
    return paths
