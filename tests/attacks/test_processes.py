"""What is left of an adapter's processes when its server ends, however that ends; and whose processes are spared."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support import peer
from tests.support.outside.raw import page
from tests.support.peer import DEADLINE_S, MARK, wait_until
from xpl_cli.isolation import processes

pytestmark = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds processes through /proc")

WAITING = "-c import signal; signal.pause()"
"""How the command of what an adapter starts ends."""
AWAY = f"""
import os, subprocess, sys
pid = os.fork()
if pid == 0:
    os.setsid()
    if os.fork() == 0:
        os.execv({sys.executable!r}, [{sys.executable!r}, "-c", "import signal; signal.pause()"])
    os._exit(0)
os.waitpid(pid, 0)
"""
"""Starts a process that leaves group and session, and whose parent is gone."""
MODEL = """
class Model:
    def __init__(self, config): pass
    def infer(self, observation):
        return [1]
"""
HANGS = "import ctypes; ctypes.PyDLL(None).pause()"
"""Never gives another thread a turn."""
STOPS = "import os, signal; os.kill(os.getpid(), signal.SIGSTOP)"
STOPS_ALL = "import os, signal; os.killpg(0, signal.SIGSTOP)"


@contextlib.contextmanager
def started(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Serve an adapter in a session of its own; kill what a failed test leaves."""
    mark = uuid.uuid4().hex
    process = subprocess.Popen(
        [sys.executable, "-m", "xpl_cli", "serve", str(folder), "--port", "0", *options],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, MARK: mark}, start_new_session=True,
    )  # fmt: skip
    try:
        yield process, mark
    finally:
        for pid in peer.processes(mark):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.communicate()


def strays(mark: str) -> list[int]:
    """Return the processes that an adapter has started."""
    return [pid for pid, command in peer.processes(mark).items() if command.strip().endswith(WAITING)]


def states(mark: str) -> list[str]:
    found = []
    for pid in peer.processes(mark):
        with contextlib.suppress(OSError):
            found.append(Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0])
    return found


@pytest.mark.sampled(1)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM], ids=lambda number: number.name)
@pytest.mark.parametrize(
    ("at_import", "awaited"),
    [
        (AWAY, None),
        (AWAY + HANGS, None),
        (AWAY + STOPS, "T"),
        (AWAY + STOPS_ALL, "T"),
    ],
    ids=["away", "hangs", "stops itself", "stops its group"],
)
def test_nothing_is_left_of_an_adapter_that_loads(
    write_adapter: Callable[..., Path], number: signal.Signals, at_import: str, awaited: str | None
) -> None:
    """Neither itself nor what has left its group, though it hangs or is stopped, and though its server was killed."""
    folder = write_adapter(at_import + MODEL)
    with started(folder, "--set", "close_timeout_s=0.2") as (process, mark):
        wait_until(lambda: strays(mark), "the adapter has started a process")
        if awaited is not None:
            wait_until(lambda: awaited in states(mark), "the adapter is stopped")
        process.send_signal(number)
        process.wait(DEADLINE_S)
        wait_until(lambda: not peer.processes(mark), "nothing is left")


def test_a_worker_that_is_killed_takes_all_of_its_own_along(write_adapter: Callable[..., Path]) -> None:
    """The server of two goes on with the other one."""
    folder = write_adapter(AWAY + MODEL)
    with started(folder, "--workers", "2") as (process, mark):
        assert process.stdout is not None
        url = json.loads(process.stdout.readline())["url"]
        assert len(strays(mark)) == 2
        workers = json.loads(page(url, "/healthz")[1])["workers"]
        os.kill(workers[0]["process"], signal.SIGKILL)
        wait_until(lambda: len(strays(mark)) == 1, "its process has ended with it")
        wait_until(lambda: len(json.loads(page(url, "/healthz")[1])["workers"]) == 1, "the other one goes on")


def test_an_adapter_that_kills_its_keeper_ends(write_adapter: Callable[..., Path]) -> None:
    """And so does the server, with all that was started, though the adapter still holds the pipes."""
    folder = write_adapter(AWAY + "import os, signal; os.kill(os.getppid(), signal.SIGKILL)\n" + MODEL)
    with started(folder) as (process, mark):
        assert process.wait(DEADLINE_S) == 4
        wait_until(lambda: not peer.processes(mark), "nothing is left")


def test_a_pipeline_keeps_its_other_commands(write_adapter: Callable[..., Path], tmp_path: Path) -> None:
    """A shell puts all of them into one group, which the server may lead; its end ends no command of the user."""
    folder = write_adapter(MODEL)
    done, seen = tmp_path / "done", tmp_path / "seen"
    mark = uuid.uuid4().hex
    # As a shell with job control does it: both in the group that the first one leads.
    read, write = os.pipe()
    server = subprocess.Popen(
        [sys.executable, "-m", "xpl_cli", "serve", str(folder), "--port", "0"],
        stdin=subprocess.DEVNULL, stdout=write, stderr=subprocess.DEVNULL, process_group=0,
        env={**os.environ, MARK: mark},
    )  # fmt: skip
    os.close(write)
    code = (
        "import sys\n"
        f"open({str(seen)!r}, 'w').write(sys.stdin.readline())\n"
        "while sys.stdin.read(1): pass\n"
        f"open({str(done)!r}, 'w').write('done')\n"
    )
    reader = subprocess.Popen([sys.executable, "-c", code], stdin=read, process_group=server.pid)
    os.close(read)
    try:
        assert os.getpgid(reader.pid) == server.pid
        wait_until(lambda: seen.exists() and seen.read_text(encoding="utf-8"), "it is ready")
        server.send_signal(signal.SIGINT)
        assert server.wait(DEADLINE_S) == 0
        assert reader.wait(DEADLINE_S) == 0
        assert done.read_text(encoding="utf-8") == "done"
        assert not peer.processes(mark)
    finally:
        for process in (server, reader):
            if process.poll() is None:
                process.kill()
            process.wait()


def test_what_a_shell_had_started_before_it_became_the_server_is_spared(
    write_adapter: Callable[..., Path], tmp_path: Path
) -> None:
    """As in `exec xpl serve ... > >(tee log)`: the reader is a child of the server, and not of its making."""
    folder = write_adapter(MODEL)
    log = tmp_path / "log"
    code = f"import sys\nlines = sys.stdin.read()\nopen({str(log)!r}, 'w').write(lines)"
    script = (
        "import os, subprocess, sys\n"
        f"reader = subprocess.Popen([sys.executable, '-c', {code!r}], stdin=subprocess.PIPE)\n"
        "os.dup2(reader.stdin.fileno(), 1)\n"
        "reader.stdin.close()\n"
        f"os.execv(sys.executable, [sys.executable, '-m', 'xpl_cli', 'serve', {str(folder)!r}, '--port', '0'])\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.PIPE, start_new_session=True) as server:
        assert server.stderr is not None

        def reader() -> list[processes.ProcessInfo]:
            found = processes.descendants(server.pid)  # their commands are cut, and a checkout's path may be long
            return [one for one in found if b"sys.stdin.read()" in Path(f"/proc/{one.pid}/cmdline").read_bytes()]

        wait_until(lambda: len(processes.descendants(server.pid)) == 3 and reader(), "reader, reaper and worker run")
        (spared,) = reader()
        server.send_signal(signal.SIGTERM)
        server.send_signal(signal.SIGTERM)
        assert server.wait(DEADLINE_S) == 0
        wait_until(lambda: not spared.is_alive, "the reader has read all of it")
        assert log.exists()


@pytest.mark.slow
def test_a_worker_says_how_it_ended(write_adapter: Callable[..., Path]) -> None:
    """Its reaper ends as it did: by the same signal, or with the same exit code."""
    for ending, told in {
        "import os; os._exit(7)": "exit code 7",
        "import os; os.abort()": "signal SIGABRT",
    }.items():
        with started(write_adapter(ending)) as (process, _):
            _, log = process.communicate(timeout=DEADLINE_S)
            assert process.returncode == 4
            assert told in log.decode()
