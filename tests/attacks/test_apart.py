"""Attempts of an adapter that is only kept apart to reach the processes that judge it, as root and as a plain user."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import uuid
from pathlib import Path

import pytest

from tests.support.peer import DEADLINE_S
from xpl_cli.basics.errors import UserError
from xpl_cli.isolation import plan, sandbox

_NOBODY = 65534
# Prints what the attacks got: a list that is empty where all were held.
_ATTACKS = """
import ctypes, glob, json, os, signal
libc, got = ctypes.CDLL(None, use_errno=True), []
mark, victim = os.environ["MARK"].encode(), int(os.environ["VICTIM"])

def look(when):
    pids = [int(path.split("/")[2]) for path in glob.glob("/proc/[0-9]*")]
    got.extend(f"{when}: sees the judge as {pid}" for pid in pids if mark in open(f"/proc/{pid}/cmdline", "rb").read())
    attempts = {
        "opens the memory of": lambda: open(f"/proc/{victim}/mem", "r+b").close(),
        "signals": lambda: os.kill(victim, signal.SIGKILL),
    }
    for name, attempt in attempts.items():
        try:
            attempt()
            got.append(f"{when}: {name} the judge")
        except OSError:
            pass

def steer(when):
    # What the machine obeys: core_pattern runs programs, control groups freeze and end processes.
    files = ["/proc/sysrq-trigger", *glob.glob("/proc/sys/kernel/*"), *glob.glob("/sys/kernel/*")]
    files += glob.glob("/sys/fs/cgroup/**/cgroup.procs", recursive=True)[:50]
    for path in filter(os.path.isfile, files):
        try:
            open(path, "r+b").close()
            got.append(f"{when}: may write to {path}")
        except OSError:
            pass
    for folder in glob.glob("/sys/fs/cgroup/*/"):
        try:
            os.mkdir(folder + "xpl-attack")
            os.rmdir(folder + "xpl-attack")
            got.append(f"{when}: may make control groups in {folder}")
        except OSError:
            pass

def take_away(when):
    for flags in (0, 2):
        if libc.umount2(b"/proc", flags) == 0:
            got.append(f"{when}: takes /proc away")

first = [line for line in open("/proc/1/status") if line.startswith("CapEff") and int(line.split()[1], 16)]
got.extend(f"the first process keeps {line.strip()}" for line in first)
look("at once")
steer("at once")
take_away("at once")
look("without /proc")
if libc.unshare(1 << 28 | 1 << 17) == 0:
    take_away("in a namespace of its own")
    look("in a namespace of its own")
    steer("in a namespace of its own")
print(json.dumps(got))
"""


def _ways() -> list[tuple[str, list[str]]]:
    program = shutil.which("bwrap")
    found = [("namespaces", plan.apart_by_namespaces())]
    return found if program is None else [*found, ("bubblewrap", plan.apart_by_bubblewrap(program))]


@pytest.mark.parametrize("user", ["root", "user"])
@pytest.mark.parametrize(("way", "prefix"), _ways(), ids=lambda value: value if isinstance(value, str) else "")
def test_what_is_kept_apart_reaches_no_judge(tmp_path: Path, way: str, prefix: list[str], user: str) -> None:
    """Neither its memory nor its signals, also when the view of processes is taken away or a namespace is entered."""
    if os.geteuid() != 0 and user == "root":
        pytest.skip("only root can be root")
    become = ["setpriv", f"--reuid={_NOBODY}", f"--regid={_NOBODY}", "--clear-groups"]
    become = become if os.geteuid() == 0 and user == "user" else []
    python = sys.executable
    if become:
        python = "/usr/bin/python3"
        probe = subprocess.run([*become, python, "-c", ""], check=False, capture_output=True)
        if shutil.which("setpriv") is None or probe.returncode:
            pytest.skip("a plain user can run no Python of this machine")
    mark = uuid.uuid4().hex
    judge = subprocess.Popen([*become, python, "-c", "input()", mark], stdin=subprocess.PIPE)
    try:
        launch = [python, *prefix[1:]] if prefix[0] == sys.executable else prefix
        command = [*become, *launch, python, "-I", "-S", "-c", _ATTACKS]
        known = {"MARK": mark, "VICTIM": str(judge.pid), "PATH": os.environ["PATH"]}
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, cwd="/", timeout=DEADLINE_S, env=known
        )
        if done.returncode == 125 or "bwrap:" in done.stderr:
            pytest.skip(f"this kernel forbids it to this user: {done.stderr.strip()}")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout) == []
        assert judge.poll() is None
    finally:
        judge.communicate(b"\n")


def test_a_way_that_keeps_capabilities_is_not_relied_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As root they would undo what keeps processes apart; the reason is told."""
    if os.geteuid() != 0:
        pytest.skip("only root has capabilities")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(plan, "apart_by_namespaces", lambda: ["/usr/bin/unshare", "--pid", "--fork", "--mount-proc"])
    with pytest.raises(UserError, match="keeps capabilities"):
        sandbox.pid_isolation(tmp_path)
