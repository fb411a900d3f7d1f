"""Servers are forked from a process that has imported everything; nothing else may differ from starting them anew."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import uuid
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.support.checkout import ROOT
from tests.support.peer import DEADLINE_S, MARK, processes, wait_until
from xpl_cli import __version__
from xpl_cli.basics.errors import ExitCode
from xpl_cli.serving import fork_server

if TYPE_CHECKING:
    from xpl_cli.serving.fork_server import ForkedServer

WAITS = ("review", "--base", "HEAD", "--description", "-")
"""A command that goes on until its standard input ends."""
TOOL = f"""
import sys
from xpl_cli.serving import fork_server
hosted = fork_server.start({WAITS})
print(hosted.pid, flush=True)
sys.stdin.read()
"""


def _told(hosted: ForkedServer) -> tuple[int, str, str]:
    """Return exit code and both outputs of a command that needs no input."""
    hosted.stdin.close()
    out, err = hosted.stdout.read().decode(), hosted.stderr.read().decode()
    code = hosted.wait(DEADLINE_S)
    _close(hosted)
    return code, out, err


def _close(hosted: ForkedServer) -> None:
    for stream in (hosted.stdin, hosted.stdout, hosted.stderr):
        stream.close()


def test_exit_code_and_outputs_are_those_of_the_command() -> None:
    """A command that goes well, and one that is refused."""
    assert _told(fork_server.start(["--version"])) == (ExitCode.CLEAN, f"xpl {__version__}\n", "")
    code, out, err = _told(fork_server.start(["serve", "no-such-policy"]))
    assert (code, out) == (ExitCode.NOT_FOUND, "")
    assert "no-such-policy" in err


def test_folder_and_environment_are_those_of_the_moment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And not those in which the fork server was started."""
    fork_server.warm()
    (tmp_path / "here.yml").write_text("{}\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert _told(fork_server.start(["spec", "validate", "--schema", "policy", "here.yml"]))[0] == ExitCode.FINDINGS
    monkeypatch.setenv("XPL_DEBUG", "1")
    monkeypatch.chdir(ROOT)
    assert _told(fork_server.start(["spec", "validate", "--schema", "policy", "here.yml"]))[0] == ExitCode.NOT_FOUND


def test_a_signal_ends_it_and_is_told() -> None:
    hosted = fork_server.start(WAITS)
    assert hosted.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        hosted.wait(0.0)
    hosted.send_signal(signal.SIGKILL)
    assert hosted.wait(DEADLINE_S) == -signal.SIGKILL
    assert hosted.poll() == -signal.SIGKILL
    _close(hosted)


@pytest.mark.slow
def test_lists_of_processes_show_which_command_it_is() -> None:
    """Although its command line is that of the process it was forked from."""
    hosted = fork_server.start(WAITS)
    name = Path(f"/proc/{hosted.pid}/comm")
    wait_until(lambda: name.read_text(encoding="utf-8") == f"xpl {WAITS[0]}\n", "it has its name")
    _told(hosted)


def test_a_fork_server_that_was_killed_is_replaced() -> None:
    """The next server starts, and the end of an older one is noticed although nobody knows its exit code."""
    old = fork_server.start(WAITS)
    process = fork_server._fork_server(os.getpid())._process
    process.kill()
    process.wait()
    assert _told(fork_server.start(["--version"]))[0] == ExitCode.CLEAN
    assert old.poll() is None
    old.send_signal(signal.SIGKILL)
    assert old.wait(DEADLINE_S) != 0
    _close(old)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("end", [None, signal.SIGTERM, signal.SIGKILL], ids=["ends", "SIGTERM", "SIGKILL"])
def test_nothing_is_left_of_it_however_the_tool_ends(end: signal.Signals | None) -> None:
    """Neither the fork server nor a command that waits for its input."""
    mark = uuid.uuid4().hex
    environment = {**os.environ, MARK: mark, "PYTHONPATH": str(ROOT)}
    tool = subprocess.Popen(
        [sys.executable, "-c", TOOL], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert tool.stdin is not None
    assert tool.stdout is not None
    with tool:
        assert int(tool.stdout.readline()) in processes(mark)
        if end is None:
            tool.stdin.close()
        else:
            tool.send_signal(end)
    wait_until(lambda: not processes(mark), "all of its processes are gone")
