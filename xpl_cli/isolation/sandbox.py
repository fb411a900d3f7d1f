"""What an adapter may do to the machine: how much memory it may hold, whether it sees a network, where it may write.

A limit on memory is held by looking, because what the system offers (RLIMIT_AS) counts address space, which GPU
libraries reserve in terabytes. Isolation is bubblewrap's, with a filter of system calls (`seccomp.py`) and a last step
inside (`launch.py`) of ours. What is promised is tried from inside first (`proof.py`).
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

from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.sizes import format_size, size_of
from xpl_cli.isolation import plan, processes, seccomp

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterator, Mapping, Sequence

_EVERY_S = 0.1
_LOOKS_PER_SEARCH = 5
_SHARE = re.compile(r"(\d{1,18}(?:\.\d+)?)\s*%")
_CONTAINER_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
_NO_LIMIT = "none"

_HOME_FOLDERS = {"HF_HOME": ".cache/huggingface", "TORCH_HOME": ".cache/torch", "PYTHONUSERBASE": ".local"}
"""What is found below the home folder, readable as before, although isolated adapters have another home folder."""
_PROOF_S = 20.0
_PROOF = Path(__file__).with_name("proof.py")
BUBBLEWRAP, _NAMESPACES_OF_OURS = "bubblewrap", "namespaces"
"""Ways to keep a command apart; the first one also isolates it."""
INSTALL = "install bubblewrap: apt-get install bubblewrap, dnf install bubblewrap, or pacman -S bubblewrap"
_NAMESPACES = ("user", "pid", "ipc", "net", "mnt", "uts")
_REFUSED = ("keyctl", "ptrace", "mount", "setns", "unshare", "bpf", "perf_event_open", "userfaultfd", "io_uring_setup")


class WatchedProcess(Protocol):
    """A process whose memory is watched.

    Attributes:
        pid: the process; those below it count too.
        died: resolves when it has ended.
    """

    pid: int
    died: asyncio.Future[str]

    def kill(self, reason: str) -> None:
        """End it at once, for a reason that its user is told."""


@dataclass(frozen=True)
class MemoryLimit:
    """Most resident memory of a worker and of the processes below it.

    Attributes:
        size: bytes.
        asked: what the user wrote.
    """

    size: int
    text: str

    @classmethod
    def parse(cls, text: str) -> Self | None:
        """Return the limit that `8GB`, `512MiB`, `80%` (of this machine's memory) or `none` stands for.

        Raises:
            UserError: if it is none of these.
        """
        asked = text.strip()
        if asked.lower() == _NO_LIMIT:
            return None
        share = _SHARE.fullmatch(asked)
        size = size_of(asked) if share is None else int(float(share[1]) / 100.0 * machine_memory())
        if not size:
            told = f"{text[:80]!r}{'...' if len(text) > 80 else ''}"
            raise UserError(f"--memory-limit takes a size such as 8GB, a share such as 80%, or none; got {told}")
        return cls(size, asked)

    async def enforce(self, process: WatchedProcess) -> None:
        """Watch a worker until it ends, and end it with a clear reason when it holds more."""
        import asyncio  # slow to import, and whoever only reads a limit needs none of it

        for look in itertools.count():
            if process.died.done():
                return
            if look % _LOOKS_PER_SEARCH == 0:  # on a machine with thousands of processes a search takes its time
                pids = await asyncio.to_thread(processes.tree_pids, process.pid)
                files = await asyncio.to_thread(processes.memory_file_bytes, pids)
            # A page that processes share counts twice at first sight, and is worth a closer look only if that matters.
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
    """Return the memory that this machine has, or that its container may use, bytes."""
    sizes = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for path in _CONTAINER_LIMITS:
        with contextlib.suppress(OSError, ValueError):
            sizes.append(int(Path(path).read_text(encoding="ascii")))
    return min(sizes)


@dataclass(frozen=True)
class Isolation:
    """A way to keep a command apart; the process that is started waits for it (`family.kept_apart`).

    Attributes:
        way: its name.
        prefix: what is put before the command.
        folder: what it may write to, where it is isolated; None where only processes are kept apart.
    """

    method: str
    prefix: tuple[str, ...]
    folder: Path | None

    def environment(self, outside: Mapping[str, str]) -> dict[str, str]:
        """Return the environment of the command: isolated, it has home, temporary files and caches of its own."""
        if self.folder is None:
            return dict(outside)
        home = Path(outside.get("HOME", "/"))
        kept = {name: str(home / place) for name, place in _HOME_FOLDERS.items() if (home / place).is_dir()}
        inside = {"HOME": self.folder / "home", "TMPDIR": self.folder / "tmp", "XDG_CACHE_HOME": self.folder / "cache"}
        for path in inside.values():
            path.mkdir(exist_ok=True)
        return {**kept, **outside, **{name: str(path) for name, path in inside.items()}}


@contextlib.contextmanager
def isolated(checkout: Path, proven: str | None = None) -> Iterator[Isolation]:
    """Isolate an adapter by bubblewrap, for the length of a `with` block; every promise of it has been tried.

    Args:
        checkout: folder of the adapter.
        proven: the way that was found a moment ago, which need not be tried again.

    Raises:
        UserError: if there is no bubblewrap, with how to get it, or a promise does not hold; exit code 4.
    """
    program = shutil.which("bwrap")
    if program is None:
        raise UserError(
            "isolation was asked for, and bubblewrap, which arranges it, is not installed: there is no bwrap on PATH",
            hint=INSTALL,
            code=ExitCode.NOT_RUN,
        )
    with tempfile.TemporaryDirectory(prefix="xpl-isolated-") as name:
        # One deeper than what only this user may enter: what the adapter makes of its folder's rights, and a set-uid
        # program in it, is then nothing that another user of the machine could get at.
        folder = Path(name).resolve() / "own"
        folder.mkdir()
        prefix = plan.isolated(program, checkout=checkout.resolve(), folder=folder)
        reason = None if proven == BUBBLEWRAP else _broken_promise(prefix, checkout.resolve(), folder)
        if reason is not None:
            raise UserError(
                f"isolation was asked for and bubblewrap cannot arrange it here: {reason}",
                hint="allow unprivileged user namespaces, or leave --isolate away",
                code=ExitCode.NOT_RUN,
            )
        yield Isolation(BUBBLEWRAP, tuple(prefix), folder)


def pid_isolation(checkout: Path, proven: str | None = None) -> Isolation:
    """Find a way to run an adapter where it sees and signals no process but its own.

    Args:
        checkout: folder of the adapter.
        proven: the way that was found a moment ago, which need not be tried again.

    Raises:
        UserError: if none works here, with the reason of each; exit code 4.
    """
    proof = [sys.executable, "-I", "-S", "-c", _IS_APART, str(Path("/proc/self/ns/pid").readlink())]
    bubblewrap = shutil.which("bwrap")
    ways = {_NAMESPACES_OF_OURS: plan.apart_by_namespaces()}
    ways |= {} if bubblewrap is None else {BUBBLEWRAP: plan.apart_by_bubblewrap(bubblewrap)}
    refused = []
    for way, prefix in ways.items():
        reason = None if way == proven else _failure_reason(_run_probe([*prefix, *proof], checkout))
        if reason is None:
            return Isolation(way, tuple(prefix), None)
        refused.append(f"{way}: {reason}")
    raise UserError(f"no PID namespace can be had here ({'; '.join(refused)})", code=ExitCode.NOT_RUN)


def check(checkouts: Sequence[Path], *, memory_limit: str, isolate: bool) -> None:
    """Check that adapters can be kept within bounds on this machine.

    Args:
        checkouts: their folders.
        memory_limit: as for `MemoryLimit.parse`.
        isolate: whether they shall be isolated.

    Raises:
        UserError: if not; with exit code 4 if they cannot be isolated.
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
    """Try to break out behind a prefix; return which promise does not hold, or None if all do."""
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
        # The text and not the file: what is hidden inside may hide the file too.
        program = [sys.executable, "-I", "-S", "-c", _PROOF.read_text(encoding="utf-8"), json.dumps(expected)]
        return _failure_reason(_run_probe([*prefix, *program], checkout))


def _shared_folder() -> str | None:
    """Return a folder where programs of this machine meet, if it may be written to."""
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
