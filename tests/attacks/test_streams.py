"""Standard streams that are closed, full, or speak another alphabet; and an interrupt that was ignored before."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.support.killable import listens
from tests.support.outside.raw import page
from tests.support.peer import DEADLINE_S, wait_until
from xpl_cli.basics.errors import ExitCode
from xpl_cli.serving.launch import LINE_BYTES, running_server

MODEL = """
    class Model:
        def __init__(self, config): pass
        def infer(self, observation): return [1]
"""
XPL = shlex.join([sys.executable, "-m", "xpl_cli"])


@pytest.fixture(scope="module")
def subject(write_adapter: Callable[..., Path]) -> Path:
    return write_adapter(MODEL)


def shell(line: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["/bin/sh", "-c", line], capture_output=True, text=True, check=False, timeout=DEADLINE_S, **options
    )


@pytest.mark.sampled(1)
@pytest.mark.parametrize("stdin", ["</dev/null", "<&-"])
def test_a_standard_input_that_ends_with_nobody_is_refused(subject: Path, stdin: str) -> None:
    """A file and a device are no sign of life of whoever started the server."""
    done = shell(f"{XPL} serve {subject} --port 0 --until-stdin-ends {stdin}")
    assert done.returncode == ExitCode.USAGE, done.stderr
    assert "--until-stdin-ends: standard input is a file or a device" in done.stderr


def test_a_pipe_that_ends_at_once_ends_the_server(subject: Path) -> None:
    done = shell(f": | {XPL} serve {subject} --port 0 --until-stdin-ends")
    assert done.returncode == ExitCode.CLEAN, done.stderr


def test_an_answer_that_cannot_be_written_is_said(subject: Path) -> None:
    """A full disk: one sentence, no internal error, and nothing more at the end of the interpreter."""
    done = shell(f"{XPL} serve {subject} --port 0 >/dev/full")
    assert done.returncode == ExitCode.NOT_RUN, done.stderr
    assert "cannot be written to standard output: No space left on device" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_server_whose_output_is_closed_serves(subject: Path) -> None:
    """Nobody wanted to read where it listens; connections do not take the place of the output."""
    process = subprocess.Popen(["/bin/sh", "-c", f"exec {XPL} serve {subject} --port 0 --host 127.0.0.1 >&- 2>&- <&-"])
    try:
        port = wait_until(lambda: listens(process.pid), "it listens")
        wait_until(lambda: page(f"ws://127.0.0.1:{port}", "/healthz")[0] == 200, "it is ready")
        assert Path(f"/proc/{process.pid}/fd/1").readlink() == Path(os.devnull)
    finally:
        process.terminate()
        assert process.wait(DEADLINE_S) == ExitCode.CLEAN


def test_other_alphabets_end_no_command(tmp_path: Path) -> None:
    """What the locale has no letters for is written out, and JSON stays what it says."""
    environment = {**os.environ, "PYTHONIOENCODING": "ascii:strict", "LC_ALL": "C.UTF-8"}
    name = "policy/Rübe-\N{ROBOT FACE}"
    done = shell(f"{XPL} audit '{name}' --json", cwd=tmp_path, env=environment)
    assert done.returncode == ExitCode.NOT_FOUND, done.stderr
    assert done.stdout.isascii()
    assert name in json.loads(done.stdout)["message"]


def test_a_command_that_was_started_in_the_background_can_be_interrupted(subject: Path) -> None:
    """Shells have such commands ignore the interrupt, and so has whatever they start."""
    process = subprocess.Popen(
        ["/bin/sh", "-c", f"trap '' INT; exec {XPL} serve {subject} --port 0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert b"ready" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=DEADLINE_S)
    assert process.returncode == ExitCode.CLEAN
    script = "trap '' INT; exec " + shlex.join([sys.executable, "-c", _INTERRUPTED])
    assert shell(script).returncode == ExitCode.INTERRUPTED


_INTERRUPTED = """
import os, signal, sys
from xpl_cli import main
from xpl_cli.standard import answers
answers.of_command = lambda *_: os.kill(os.getpid(), signal.SIGINT)
sys.argv = ["xpl", "rules", "--help"]
main.run()
"""


def test_a_line_without_an_end_is_cut(write_adapter: Callable[..., Path]) -> None:
    """What an adapter prints takes no more memory than the log has lines."""
    flood = "print('x' * 4_000_000, end='', flush=True)"
    with running_server(write_adapter(f"{flood}\n{textwrap.dedent(MODEL)}")) as server:
        wait_until(lambda: sum(map(len, list(server.log))) >= 3_900_000, "it is all there")
        assert max(map(len, list(server.log))) <= LINE_BYTES
