"""Sandbox of an adapter: memory limit, network and write access.

The memory limit is enforced by polling, because RLIMIT_AS counts address space, which GPU libraries reserve in
terabytes. Isolation uses bubblewrap, with a system call filter (`seccomp.py`) and a last step inside (`launch.py`).
Every promise is tested from inside first (`proof.py`).
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

from xpl import user_cache
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.sizes import format_size, size_of
from xpl_cli.isolation import plan, processes, seccomp

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterator, Mapping, Sequence

_EVERY_S = 0.1
_POLLS_PER_SEARCH = 5
_SHARE = re.compile(r"(\d{1,18}(?:\.\d+)?)\s*%")
_CONTAINER_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
_NO_LIMIT = "none"

_HOME_FOLDERS = {"HF_HOME": ".cache/huggingface", "TORCH_HOME": ".cache/torch", "PYTHONUSERBASE": ".local"}
"""Caches in the user's home folder that stay readable, although isolated adapters have another home folder."""
_PROOF_S = 20.0
_PROOF = Path(__file__).with_name("proof.py")
BUBBLEWRAP, _NAMESPACES_OF_OURS = "bubblewrap", "namespaces"
"""Methods of PID isolation; the first one can also isolate fully."""
INSTALL = "install bubblewrap: apt-get install bubblewrap, dnf install bubblewrap, or pacman -S bubblewrap"
_NAMESPACES = ("user", "pid", "ipc", "net", "mnt", "uts")
_REFUSED = ("keyctl", "ptrace", "mount", "setns", "unshare", "bpf", "perf_event_open", "userfaultfd", "io_uring_setup")


class WatchedProcess(Protocol):
    """A process whose memory is watched.

    Attributes:
        pid: the process; its descendants count too.
        died: resolves when it has ended.
    """

    pid: int
    died: asyncio.Future[str]

    def kill(self, reason: str) -> None:
        """Kill it, for a reason that is reported to the user."""


@dataclass(frozen=True)
class MemoryLimit:
    """Limit on the resident memory of a worker and its descendants.

    Attributes:
        size: bytes.
        text: the option's value.
    """

    size: int
    text: str

    @classmethod
    def parse(cls, text: str) -> Self | None:
        """Parse `8GB`, `512MiB`, `80%` (of this machine's memory) or `none`.

        Raises:
            UserError: if it is none of these.
        """
        size_text = text.strip()
        if size_text.lower() == _NO_LIMIT:
            return None
        share = _SHARE.fullmatch(size_text)
        size = size_of(size_text) if share is None else int(float(share[1]) / 100.0 * machine_memory())
        if not size:
            shortened = f"{text[:80]!r}{'...' if len(text) > 80 else ''}"
            raise UserError(f"--memory-limit takes a size such as 8GB, a share such as 80%, or none; got {shortened}")
        return cls(size, size_text)

    async def enforce(self, process: WatchedProcess) -> None:
        """Watch a worker until it ends, and kill it when it exceeds the limit."""
        import asyncio  # slow to import, and not needed for parsing

        for poll in itertools.count():
            if process.died.done():
                return
            if poll % _POLLS_PER_SEARCH == 0:  # a search is slow on machines with thousands of processes
                pids = await asyncio.to_thread(processes.tree_pids, process.pid)
                files = await asyncio.to_thread(processes.memory_file_bytes, pids)
            # Shared pages count twice in this sum; the exact sum is slower and only needed above the limit.
            if files + sum(map(processes.resident_bytes, pids)) > self.size:
                used = await asyncio.to_thread(processes.proportional_bytes, process.pid)
                if used > self.size:
                    process.kill(self._exceeded(used))
                    return
            await asyncio.wait([process.died], timeout=_EVERY_S)

    def _exceeded(self, used: int) -> str:
        limit = format_size(self.size)
        return f"the adapter used {format_size(used)}, more than the limit of {limit} (--memory-limit {self.text})"


def machine_memory() -> int:
    """Return the memory of this machine or of its container, bytes."""
    sizes = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for path in _CONTAINER_LIMITS:
        with contextlib.suppress(OSError, ValueError):
            sizes.append(int(Path(path).read_text(encoding="ascii")))
    return min(sizes)


@dataclass(frozen=True)
class Isolation:
    """An isolation of commands; the started process is a launcher (`processes.launcher_chain`).

    Attributes:
        method: name of the method.
        prefix: prefix of the command.
        folder: the writable folder of full isolation; None with a PID namespace only.
    """

    method: str
    prefix: tuple[str, ...]
    folder: Path | None

    def environment(self, outside: Mapping[str, str]) -> dict[str, str]:
        """Return the command's environment variables; full isolation has private home, temporary and cache folders."""
        if self.folder is None:
            return dict(outside)
        outside = {name: value for name, value in outside.items() if name != user_cache.VARIABLE}
        home = Path(outside.get("HOME", "/"))
        caches = {name: str(home / path) for name, path in _HOME_FOLDERS.items() if (home / path).is_dir()}
        inside = {"HOME": self.folder / "home", "TMPDIR": self.folder / "tmp", "XDG_CACHE_HOME": self.folder / "cache"}
        for path in inside.values():
            path.mkdir(exist_ok=True)
        return {**caches, **outside, **{name: str(path) for name, path in inside.items()}}


@contextlib.contextmanager
def isolated(checkout: Path, proven: str | None = None) -> Iterator[Isolation]:
    """Isolate an adapter by bubblewrap for a `with` block; every promise is tested first.

    Args:
        checkout: folder of the adapter.
        proven: a method that was tested before and is not tested again.

    Raises:
        UserError: if bubblewrap is missing, or a promise does not hold; exit code 4.
    """
    program = shutil.which("bwrap")
    if program is None:
        raise UserError(
            "isolation was requested, but bubblewrap is not installed: there is no bwrap on PATH",
            hint=INSTALL,
            code=ExitCode.NOT_RUN,
        )
    with tempfile.TemporaryDirectory(prefix="xpl-isolated-") as name:
        # Below a folder that only this user can enter: whatever permissions the adapter sets, and whatever set-uid
        # program it writes, other users cannot reach it.
        folder = Path(name).resolve() / "own"
        folder.mkdir()
        prefix = plan.isolated(program, checkout=checkout.resolve(), folder=folder)
        reason = None if proven == BUBBLEWRAP else _broken_promise(prefix, checkout.resolve(), folder)
        if reason is not None:
            raise UserError(
                f"isolation was requested, but bubblewrap cannot provide it here: {reason}",
                hint="allow unprivileged user namespaces, or omit --isolate",
                code=ExitCode.NOT_RUN,
            )
        yield Isolation(BUBBLEWRAP, tuple(prefix), folder)


def pid_isolation(checkout: Path, proven: str | None = None) -> Isolation:
    """Return a method that hides other processes from an adapter.

    Args:
        checkout: folder of the adapter.
        proven: a method that was tested before and is not tested again.

    Raises:
        UserError: if no method works here; exit code 4.
    """
    proof = [sys.executable, "-I", "-S", "-c", _IS_APART, str(Path("/proc/self/ns/pid").readlink())]
    bubblewrap = shutil.which("bwrap")
    methods = {_NAMESPACES_OF_OURS: plan.apart_by_namespaces()}
    methods |= {} if bubblewrap is None else {BUBBLEWRAP: plan.apart_by_bubblewrap(bubblewrap)}
    reasons = []
    for method, prefix in methods.items():
        reason = None if method == proven else _failure_reason(_run_probe([*prefix, *proof], checkout))
        if reason is None:
            return Isolation(method, tuple(prefix), None)
        reasons.append(f"{method}: {reason}")
    raise UserError(f"no PID namespace is available here ({'; '.join(reasons)})", code=ExitCode.NOT_RUN)


def check(checkouts: Sequence[Path], *, memory_limit: str, isolate: bool) -> None:
    """Check that this machine can enforce the limits of adapters.

    Args:
        checkouts: their folders.
        memory_limit: as for `MemoryLimit.parse`.
        isolate: whether isolation is requested.

    Raises:
        UserError: if not; exit code 4 if isolation is impossible.
    """
    MemoryLimit.parse(memory_limit)
    for checkout in checkouts if isolate else ():
        with isolated(checkout):
            pass


_IS_APART = """
import ctypes, os, sys
if os.readlink("/proc/self/ns/pid") == sys.argv[1]:
    sys.exit("it sees the processes of the machine")
if any(int(line.split()[1], 16) for line in open("/proc/self/status") if line.startswith("Cap")):
    sys.exit("it keeps capabilities")
if ctypes.CDLL(None).umount2(b"/proc", 2) == 0:
    sys.exit("it can take /proc away, and see the processes of the machine below")
for path in ("/sys", "/proc/sys"):
    if os.path.isdir(path) and not os.statvfs(path).f_flag & os.ST_RDONLY:
        sys.exit(f"it may write below {path}, which steers the machine")
"""


def _broken_promise(prefix: Sequence[str], checkout: Path, folder: Path) -> str | None:
    """Test an isolation from inside; return a broken promise, or None."""
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        tempfile.NamedTemporaryFile(prefix="xpl-hidden-", dir=_shared_folder()) as hidden,
    ):
        expected = {
            "checkout": str(checkout),
            "folder": str(folder),
            "hidden": hidden.name,
            "port": server.getsockname()[1],
            "namespaces": {name: Path(f"/proc/self/ns/{name}").readlink().name for name in _NAMESPACES},
            "calls": {name: number for name in _REFUSED if (number := seccomp.number(name)) is not None},
        }
        # The text and not the file: the file may be hidden inside.
        program = [sys.executable, "-I", "-S", "-c", _PROOF.read_text(encoding="utf-8"), json.dumps(expected)]
        return _failure_reason(_run_probe([*prefix, *program], checkout))


def _shared_folder() -> str | None:
    """Return a writable folder that programs of this machine share, or None."""
    return next((path for path in plan.MASKED if os.access(path, os.W_OK)), None)


def _run_probe(command: Sequence[str], checkout: Path) -> subprocess.CompletedProcess[str] | str:
    run = partial(subprocess.run, capture_output=True, text=True, check=False, timeout=_PROOF_S, cwd=checkout)
    try:
        return run(command, stdin=subprocess.DEVNULL, start_new_session=True)
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)


def _failure_reason(done: subprocess.CompletedProcess[str] | str) -> str | None:
    if isinstance(done, str):
        return done
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines()
    return lines[-1].removeprefix("error: ") if lines else f"exit code {done.returncode}"
