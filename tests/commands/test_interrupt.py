"""Interrupting a command leaves no process and no half-written folder behind."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import uuid
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.support import forked
from tests.support.peer import DEADLINE_S, MARK, processes, wait_until
from xpl_cli.basics.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Iterator


pytestmark = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds processes through /proc")


@contextlib.contextmanager
def started(args: list[str], cwd: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Start a command whose descendants can be found by a mark; kill what a failed test leaves.

    It is started as a script starts it in the background, with SIGINT ignored and nothing to read.
    """
    mark = uuid.uuid4().hex
    command = ["sh", "-c", 'trap "" INT; exec "$@"', "sh", sys.executable, "-m", "xpl_cli", *args]
    process = subprocess.Popen(
        command, cwd=cwd, env={**os.environ, MARK: mark}, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
    )  # fmt: skip
    try:
        yield process, mark
    finally:
        for pid in processes(mark):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.communicate()


def worker_runs(mark: str) -> bool:
    """Tell whether the adapter's own process is up."""
    return any("from xpl.worker.main import main" in command for command in processes(mark).values())


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scaffold Foo."""
    folder = tmp_path_factory.mktemp("workspace")
    forked.run("new-policy", "Foo", cwd=folder).check_returncode()
    return folder


# What a command prints when it is in the middle of its work, with a server that is in use.
COMMANDS = {
    "serve": (["policy/Foo"], b'"ready"'),
    "audit": (["policy/Foo", "--gate", "mujoco"], b"mujoco gate"),
    "eval": (["policy/Foo", "--env", "mujoco", "--episodes", "500"], b"episode 2 of"),
}


def in_the_middle(process: subprocess.Popen[bytes], mark: str, said: bytes) -> None:
    """Wait until a command works with a server and a worker."""
    assert process.stdout is not None
    for line in process.stdout:
        if said in line:
            break
    wait_until(lambda: worker_runs(mark), "the worker")


@pytest.mark.parametrize(
    ("command", "number"),
    [
        ("serve", signal.SIGINT),
        ("serve", signal.SIGTERM),
        pytest.param("audit", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("eval", signal.SIGTERM, marks=pytest.mark.slow),
    ],
)
def test_a_signal_ends_a_command_and_everything_it_started(
    workspace: Path, command: str, number: signal.Signals
) -> None:
    args, said = COMMANDS[command]
    with started([command, *args], workspace) as (process, mark):
        in_the_middle(process, mark, said)
        if number is signal.SIGINT:
            os.killpg(process.pid, number)
        else:
            process.send_signal(number)
        rest, _ = process.communicate(timeout=DEADLINE_S)
        expected = ExitCode.CLEAN if command == "serve" else ExitCode.INTERRUPTED
        assert process.returncode == expected, rest.decode()
        assert b"Traceback" not in rest
        wait_until(lambda: not processes(mark), "the end of every process")


@pytest.mark.parametrize(
    "command", ["serve", *(pytest.param(name, marks=pytest.mark.slow) for name in ("audit", "eval"))]
)
def test_even_a_killed_command_leaves_no_process(workspace: Path, command: str) -> None:
    args, said = COMMANDS[command]
    with started([command, *args], workspace) as (process, mark):
        in_the_middle(process, mark, said)
        process.kill()
        process.wait(DEADLINE_S)
        wait_until(lambda: not processes(mark), "the end of every process")
