"""Probes of the machine itself: memory, cores, disk, shared memory, ports, isolation."""

from __future__ import annotations

import contextlib
import mmap
import os
import shlex
import shutil
import socket
import tempfile
from importlib import metadata, util
from pathlib import Path

from xpl_cli.basics import user_cache
from xpl_cli.basics.errors import UserError
from xpl_cli.basics.extras import how_to_install
from xpl_cli.basics.sizes import format_size
from xpl_cli.isolation import sandbox
from xpl_cli.lifecycle.doctor.check import MachineCheck, Status

_SHARED = Path("/dev/shm")  # noqa: S108 - tested; nothing stays there
_SHARED_ENOUGH = 1 << 28
_MEMORY_ENOUGH = 2 << 30
_DISK_ENOUGH = 2 << 30
_TRIED = 1 << 20


def tool() -> MachineCheck:
    """Check that this tool's requirements are installed, without importing them."""
    serves = "everything"
    try:
        requirements = metadata.requires("xpl-cli") or []
    except metadata.PackageNotFoundError:
        return MachineCheck("xpl", Status.OK, "run from a folder, not installed", serves)
    missing = {}
    for text in (line for line in requirements if "extra ==" not in line):
        name = text.partition(";")[0].partition("=")[0].rstrip("<>~! ")
        with contextlib.suppress(metadata.PackageNotFoundError):
            metadata.version(name)
            continue
        missing[name] = text.partition(";")[0].strip()
    if missing:
        fix = shlex.join(["pip", "install", *missing.values()])
        return MachineCheck("xpl", Status.BROKEN, f"lacks {', '.join(missing)}", serves, fix)
    return MachineCheck("xpl", Status.OK, f"xpl-cli {metadata.version('xpl-cli')}", serves)


def hub() -> MachineCheck:
    """Check for the client of the Hugging Face hub."""
    serves = "checkpoints whose source is hf://..."
    if util.find_spec("huggingface_hub") is None:
        return MachineCheck("hub", Status.ABSENT, "huggingface_hub is not installed", serves, how_to_install("hub"))
    return MachineCheck("hub", Status.OK, f"huggingface_hub {metadata.version('huggingface_hub')}", serves)


def memory() -> MachineCheck:
    """Read the total and the free memory."""
    serves = "models, and simulators beside them"
    total = sandbox.machine_memory()
    free = min(_available(), total)
    small = free < _MEMORY_ENOUGH
    return MachineCheck(
        "memory", Status.BROKEN if small else Status.OK, f"{format_size(free)} of {format_size(total)} free", serves,
        "end other programs, or raise the container's limit" if small else None,
    )  # fmt: skip


def cores() -> MachineCheck:
    """Count the processors that this process may use."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = _quota()
    result = f"{count}" if quota is None or quota >= count else f"{count}, of which {quota:g} may be used at once"
    return MachineCheck("cores", Status.OK, result, "simulation and cameras")


def disk() -> MachineCheck:
    """Write to the folders of checkpoints and temporary files, and read their free space."""
    serves = "checkpoints and environments"
    folders = {"cache": user_cache.folder(), "temporary files": Path(tempfile.gettempdir()), "here": Path.cwd()}
    results, fix = [], None
    for name, path in folders.items():
        folder = next(one for one in (path, *path.parents) if one.is_dir())
        free = shutil.disk_usage(folder).free
        results.append(f"{name} {format_size(free)} free")
        with contextlib.suppress(OSError):
            with tempfile.TemporaryFile(dir=folder):
                pass
            if free < _DISK_ENOUGH and fix is None:
                fix = f"free space in {folder}"
            continue
        results[-1] = f"{name} cannot be written ({folder})"
        fix = fix or f"make {folder} writable, or choose another folder (XPL_CACHE, TMPDIR, another folder)"
    return MachineCheck("disk", Status.BROKEN if fix else Status.OK, ", ".join(results), serves, fix)


def shared_memory() -> MachineCheck:
    """Map memory of a file that two processes could share, and write to it."""
    serves = "large images between simulator and server on one machine; they travel in messages where it is missing"
    fix = "docker run --shm-size=1g, or mount a tmpfs at /dev/shm"
    if not _SHARED.is_dir():
        return MachineCheck("shared memory", Status.ABSENT, f"no {_SHARED}", serves, fix)
    try:
        with tempfile.TemporaryFile(dir=_SHARED) as file:
            os.posix_fallocate(file.fileno(), 0, _TRIED)
            with mmap.mmap(file.fileno(), _TRIED) as mapped:
                mapped[:4] = b"test"
    except OSError as error:
        return MachineCheck("shared memory", Status.BROKEN, f"{_SHARED}: {error.strerror}", serves, fix)
    free = shutil.disk_usage(_SHARED).free
    small = free < _SHARED_ENOUGH
    result = f"{format_size(free)} free in {_SHARED}"
    return MachineCheck("shared memory", Status.BROKEN if small else Status.OK, result, serves, fix if small else None)


def ports() -> MachineCheck:
    """Listen on loopback on a port that the system chooses, and connect to it."""
    serves = "policy servers"
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            port = server.getsockname()[1]
            with socket.create_connection(("127.0.0.1", port), 2.0):
                accepted, _ = server.accept()
                accepted.close()
    except OSError as error:
        fix = "bring loopback up: ip link set lo up"
        return MachineCheck("ports", Status.BROKEN, f"loopback does not work: {error.strerror or error}", serves, fix)
    return MachineCheck("ports", Status.OK, f"loopback works, tried with port {port}", serves)


def isolation() -> MachineCheck:
    """Run a program without network and write access, as `--isolate` does."""
    serves = "xpl serve --isolate and xpl audit --isolate"
    fix = f"{sandbox.INSTALL}; it needs unprivileged user namespaces"
    try:
        with tempfile.TemporaryDirectory(prefix="xpl-doctor-") as folder, sandbox.isolated(Path(folder)) as isolation_:
            return MachineCheck("isolation", Status.OK, f"{isolation_.method}, tested", serves)
    except UserError as error:
        return MachineCheck("isolation", Status.ABSENT, str(error), serves, fix)


def _available() -> int:
    for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
        name, _, value = line.partition(":")
        if name == "MemAvailable":
            return int(value.split()[0]) * 1024
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_AVPHYS_PAGES")


def _quota() -> float | None:
    """Return how many processors a container may use; None without a limit."""
    with contextlib.suppress(OSError, ValueError):
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="ascii").split()
        return None if quota == "max" else int(quota) / int(period)
    return None
