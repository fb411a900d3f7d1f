"""Attempts to break out of `--isolate`, as root and as a plain user."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import shutil
import socket
import stat
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.outside import breakout
from tests.support.peer import DEADLINE_S
from xpl import Client
from xpl_cli.basics.errors import UserError
from xpl_cli.isolation import plan, sandbox, seccomp

if TYPE_CHECKING:
    from xpl_cli.serving.launch import RunningServer

_NOBODY = 65534
_LANDLOCK_CREATE, _ITS_VERSION = 444, 1  # landlock_create_ruleset(2): asked like this, it tells its version
_SHARED = Path("/dev/shm")  # noqa: S108 - what is tried


def _python_of(user: str) -> list[str]:
    """Return a Python that a user can run, with what makes it this user's; skips where there is none."""
    if user == "root":
        if os.geteuid() != 0:
            pytest.skip("only root can be root")
        return [sys.executable]
    if os.geteuid() != 0:
        return [sys.executable]
    if shutil.which("setpriv") is None:
        pytest.skip("no setpriv to become a plain user")
    become = ["setpriv", f"--reuid={_NOBODY}", f"--regid={_NOBODY}", "--clear-groups"]
    readable = [*become, "test", "-r", str(Path(plan.__file__).with_name("launch.py"))]
    if subprocess.run(readable, check=False).returncode:
        pytest.skip("a plain user cannot read this checkout")
    for python in (sys.executable, "/usr/bin/python3"):
        asks = [
            *become,
            "sh",
            "-c",
            f"exec {python} -I -S -c 'import ctypes, multiprocessing'",
        ]  # as this user finds it
        if not subprocess.run(asks, check=False, capture_output=True).returncode:
            return [*become, python]
    pytest.skip("a plain user can run no Python of this machine")


@contextlib.contextmanager
def _left_outside(mark: str) -> Iterator[dict[str, Any]]:
    """Put what a machine has outside: files, sockets, a process."""
    with contextlib.ExitStack() as stack:
        places = [place for place in ("/tmp", "/dev/shm", "/var/tmp", "/run") if os.access(place, os.W_OK)]  # noqa: S108
        hidden = [stack.enter_context(tempfile.NamedTemporaryFile(dir=place, prefix=mark)).name for place in places]
        elsewhere = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=Path.home(), prefix=f".{mark}")))
        elsewhere.chmod(0o755)
        listeners = []
        for address in (f"\0{mark}", str(elsewhere / "socket"), f"/tmp/{mark}.socket"):  # noqa: S108
            listener = stack.enter_context(socket.socket(socket.AF_UNIX))
            listener.bind(address)
            listener.listen()
            listeners.append(address.replace("\0", "@"))
        stack.callback(lambda: Path(f"/tmp/{mark}.socket").unlink())  # noqa: S108
        mailboxes = []
        for address in (f"\0{mark}.mail", str(elsewhere / "mail")):
            mailbox = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            mailbox.bind(address)
            mailboxes.append(address.replace("\0", "@"))
        pipe = elsewhere / "pipe"
        os.mkfifo(pipe)
        stack.callback(os.close, os.open(pipe, os.O_RDONLY | os.O_NONBLOCK))
        device = elsewhere / "zero"
        with contextlib.suppress(OSError):
            os.mknod(device, 0o666 | stat.S_IFCHR, os.makedev(1, 5))
        for path in elsewhere.iterdir():
            path.chmod(0o777)
        port = stack.enter_context(socket.create_server(("::", 0), family=socket.AF_INET6, dualstack_ipv6=True))
        victim = stack.enter_context(subprocess.Popen([sys.executable, "-c", "input()", mark], stdin=subprocess.PIPE))
        stack.callback(victim.kill)
        yield {
            "hidden": hidden,
            "sockets": listeners,
            "mailboxes": mailboxes,
            "pipe": str(pipe),
            "device": str(device) if device.exists() else None,
            "landlock": ctypes.CDLL(None).syscall(_LANDLOCK_CREATE, None, 0, _ITS_VERSION) > 0,
            "port": port.getsockname()[1],
            "victim": mark,
            "pid": victim.pid,
            "alive": victim,
        }


@pytest.fixture(scope="module")
def bubblewrap() -> str:
    """Return the program; skips where it is not installed."""
    found = shutil.which("bwrap")
    if found is None:
        pytest.skip(f"isolation needs bubblewrap; {sandbox.INSTALL}")
    return found


@pytest.fixture(
    scope="module", params=["root", pytest.param("user", marks=pytest.mark.slow if os.geteuid() == 0 else ())]
)
def outcome(request: pytest.FixtureRequest, bubblewrap: str) -> Iterator[dict[str, Any]]:
    """Return what all attacks came to, tried one after the other by one user."""
    become = _python_of(request.param)
    mark = f"breakout-{uuid.uuid4().hex[:12]}"
    with tempfile.TemporaryDirectory(prefix="xpl-") as top, _left_outside(mark) as outside:
        checkout, folder = Path(top, "checkout"), Path(top, "folder")
        for path in (checkout, folder):
            path.mkdir()
            (path / "tmp").mkdir()
        (checkout / "model.py").write_text("class Model: ...\n", encoding="utf-8")
        if become[-1] != sys.executable or len(become) > 1:
            for path in (Path(top), *Path(top).rglob("*")):
                os.chown(path, _NOBODY, _NOBODY)
        prefix = plan.isolated(bubblewrap, checkout=checkout, folder=folder)
        alive = outside.pop("alive")
        known = {
            **outside,
            "checkout": str(checkout),
            "folder": str(folder),
            "shm_key": int(mark[-6:], 16),
            "gpu": plan._devices(),
            "calls": {name: seccomp.number(name) for name in seccomp.SYSCALLS},
        }
        script = Path(breakout.__file__).read_text(encoding="utf-8")
        inside = [become[-1], "-I", "-S", "-c", script, json.dumps(known)]
        done = subprocess.run(
            [*become, *prefix[1:], *inside],
            capture_output=True,
            text=True,
            check=False,
            cwd=checkout,
            timeout=DEADLINE_S,
        )
        if done.returncode == 125 or "bwrap:" in done.stderr:
            pytest.skip(f"this kernel forbids it to this user: {done.stderr.strip()}")
        assert done.returncode == 0, done.stderr
        told: dict[str, Any] = json.loads(done.stdout)
        told["victim_lives"] = alive.poll() is None
        told["oom_scores"] = [Path(f"/proc/{pid}/oom_score_adj").read_text("ascii") for pid in (alive.pid, os.getpid())]
        told["left"] = [str(path) for path in (_SHARED / "xpl-left", Path("/tmp/xpl-left")) if path.exists()]  # noqa: S108
        told["left"] += [path.name for path in checkout.iterdir() if path.name == "left.txt"]
        segments = Path("/proc/sysvipc/shm").read_text(encoding="ascii").split()
        told["outlived"] = str(known["shm_key"]) in segments
        yield told


@pytest.mark.parametrize("name", list(breakout.ATTACKS))
def test_an_attack_from_inside_is_held(outcome: dict[str, Any], name: str) -> None:
    assert outcome[name] is None


def test_nothing_is_left_outside(outcome: dict[str, Any]) -> None:
    """No file, no shared memory of either kind, and every process of the user lives, with the oom score that it had."""
    assert outcome["left"] == []
    assert not outcome["outlived"]
    assert outcome["victim_lives"]
    assert "777\n" not in outcome["oom_scores"]


def test_an_honest_program_works_inside(outcome: dict[str, Any]) -> None:
    """Children, pipes, its own loopback, shared memory of its own, temporary files."""
    assert outcome["work"] == []


MODEL = """
    import mujoco
    import numpy as np


    class Model:
        def __init__(self, config):
            self.model = mujoco.MjModel.from_xml_string(
                "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
            )

        def infer(self, obs):
            data = mujoco.MjData(self.model)
            for _ in range(100):
                mujoco.mj_step(self.model, data)
            return [float(data.qpos[2]), float(np.linalg.norm(np.ones((64, 64)) @ np.ones(64)))]
"""


@pytest.mark.slow
@pytest.mark.usefixtures("bubblewrap")
def test_numpy_and_mujoco_work_inside(write_adapter: Callable[..., Path], serve: Callable[..., RunningServer]) -> None:
    """With their threads, and arrays that come over the link in place of shared memory."""
    pytest.importorskip("mujoco")
    server = serve(write_adapter(MODEL), options=("--isolate",))
    with Client(server.url) as client:
        height, norm = client.infer({})
    assert height < 0
    assert norm == 64 * 8


def test_what_an_adapter_leaves_in_its_folder_is_out_of_the_reach_of_others(tmp_path: Path) -> None:
    """It may open its own folder to all and put a set-uid program there: nobody else can enter the one above."""
    program = (
        "import os, sys; top = sys.argv[1]; os.chmod(top, 0o777); open(top + '/left', 'w').close();"
        "os.chmod(top + '/left', 0o4777)\n"
        "try: os.chmod(os.path.dirname(top), 0o777)\nexcept OSError: pass"
    )
    with contextlib.ExitStack() as stack:
        try:
            way = stack.enter_context(sandbox.isolated(tmp_path))
        except UserError as error:
            pytest.skip(str(error))
        assert way.folder is not None
        subprocess.run([*way.prefix, sys.executable, "-I", "-S", "-c", program, str(way.folder)], check=True)
        assert (way.folder / "left").exists()
        assert way.folder.parent.stat().st_mode & 0o777 == 0o700
