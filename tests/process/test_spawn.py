"""How processes of ours are started and ended."""

from __future__ import annotations

import subprocess
import sys

import pytest

from xpl.process import spawn


@pytest.mark.parametrize(
    ("code", "launched", "told"),
    [
        (0, False, "ended with exit code 0"),
        (137, False, "ended with exit code 137"),
        (137, True, "was ended by signal SIGKILL"),
        (-9, False, "was ended by signal SIGKILL"),
        (-40, False, "was ended by signal 40"),
    ],
)
def test_an_exit_code_is_told_in_words(code: int, launched: bool, told: str) -> None:
    """A launcher gives a signal on as 128 and its number; a real-time signal has no name."""
    assert spawn.describe_exit(code, launched=launched) == told


def test_a_group_ends_with_its_leader() -> None:
    waits = "[sys.executable, '-c', 'input()']"
    start = f"import subprocess, sys; subprocess.Popen({waits}); print('there', flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", start], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    ) as leader:
        assert leader.stdout is not None
        assert leader.stdout.readline() == b"there\n"
        spawn.end_group(leader.pid)
        assert leader.stdout.read() == b""
        assert leader.wait() == -9
        spawn.end_group(leader.pid)


def test_our_path_settings_do_not_leak_into_another_interpreter() -> None:
    assert spawn.variables({"PYTHONHOME": "/nowhere", "HOME": "/home"}) == {"HOME": "/home", "PYTHONUNBUFFERED": "1"}
