"""What an adapter is kept from: memory, network, writing, and leaving processes behind."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.support.peer import wait_until
from xpl import Client
from xpl.client import PolicyServerError
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.isolation import plan, processes, sandbox, seccomp
from xpl_cli.isolation.sandbox import MemoryLimit
from xpl_cli.main import app
from xpl_cli.serving.launch import RunningServer, ServerStartError, running_server

Write = Callable[..., Path]
Serve = Callable[..., RunningServer]

# Tries on request what an adapter should not do, and answers with what came of it.
SUBJECT = """
    import os, socket, subprocess, sys, tempfile, time


    class Model:
        def __init__(self, config):
            if config.get("hang"):
                time.sleep(600)
            if config.get("hog"):
                self.hog = b"x" * config["hog"]

        def update_obs(self, obs):
            self.obs = obs

        def update_obs_batch(self, obs_list):
            self.obs = obs_list[0]

        def get_action(self):
            return getattr(self, self.obs["do"])(self.obs.get("with"))

        def get_action_batch(self, envs=None):
            return [self.get_action()]

        def reset(self):
            pass

        def connect(self, port):
            with socket.socket() as client:
                return client.connect_ex(("127.0.0.1", port))

        def write(self, path):
            try:
                with open(path, "w") as stream:
                    stream.write("written")
            except OSError as error:
                return error.strerror

        def write_home(self, _):
            self.write(os.path.expanduser("~/state"))
            self.write(tempfile.gettempdir() + "/state")
            return [os.path.expanduser("~"), tempfile.gettempdir(), open(os.path.expanduser("~/state")).read()]

        def undo(self, path):
            return subprocess.run(["mount", "-o", "remount,bind,rw", path], capture_output=True).returncode

        def picture(self, picture):
            return int(picture.sum())

        def eat(self, size):
            self.hog = bytearray(os.urandom(1 << 20)) * (size >> 20)
            time.sleep(600)

        def fork(self, arguments):
            child = subprocess.Popen([sys.executable, "-c", arguments[0]], start_new_session=arguments[1])
            return child.pid
"""


def _ask(server: RunningServer, do: str, argument: object = None) -> object:
    with Client(server.url) as client:
        client.reset()
        return client.infer({"do": do, "with": argument})


@pytest.fixture
def isolation(tmp_path: Path) -> None:
    """Skip a test where the system does not isolate."""
    try:
        sandbox.check([tmp_path], memory_limit="none", isolate=True)
    except UserError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize(
    ("text", "size"), [("512MiB", 512 << 20), (" 2g", 2 * 10**9), ("50%", sandbox.machine_memory() // 2)]
)
def test_a_limit_is_a_size_or_a_share_of_what_the_machine_has(text: str, size: int) -> None:
    assert MemoryLimit.parse(text) == MemoryLimit(size, text.strip())
    assert MemoryLimit.parse("none") is None


@pytest.mark.parametrize("text", ["", "much", "-1GB", "0", "8XB", "GB"])
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(UserError, match=r"8GB.*80%.*none"):
        MemoryLimit.parse(text)


def test_an_adapter_that_eats_memory_is_ended_with_the_reason(write_adapter: Write, serve: Serve) -> None:
    """Whoever waits for its answer is told, and so is the log."""
    server = serve(write_adapter(SUBJECT), options=("--memory-limit", "300MB"))
    with pytest.raises(PolicyServerError, match=r"the adapter used \d+ MB, more than the limit of 300 MB"):
        _ask(server, "eat", 600 << 20)
    wait_until(lambda: server.exit_code is not None, "the server has ended")
    assert server.exit_code == ExitCode.NOT_RUN
    wait_until(lambda: server.last_error is not None, "the log is complete")
    assert "--memory-limit 300MB" in str(server.last_error)


def test_memory_is_limited_while_the_model_loads(write_adapter: Write) -> None:
    """It is the first thing that needs much of it."""
    with (
        pytest.raises(
            ServerStartError, match=r"could not be loaded: the adapter used .* more than the limit of 300 MB"
        ),
        running_server(write_adapter(SUBJECT), {"hog": 10**9}, options=("--memory-limit", "300MB")),
    ):
        pass


@pytest.mark.slow
def test_memory_of_children_counts(write_adapter: Write, serve: Serve) -> None:
    """Also of those that left the process group: what counts is that the adapter started them."""
    server = serve(write_adapter(SUBJECT), options=("--memory-limit", "300MB"))
    _ask(server, "fork", ["import os, time; hog = os.urandom(600 << 20); time.sleep(600)", True])
    wait_until(lambda: server.exit_code is not None, "the server has ended")
    assert server.exit_code == ExitCode.NOT_RUN


def test_shared_pages_count_once() -> None:
    """Workers that were forked share most of their memory."""
    script = (
        "import os, signal\nhog = os.urandom(200 << 20)\n"
        "for _ in range(3):\n    if not os.fork():\n        signal.pause()\nprint(flush=True)\nsignal.pause()"
    )
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, start_new_session=True)
    assert process.stdout is not None
    try:
        process.stdout.readline()
        assert sum(map(processes.resident_bytes, processes.tree_pids(process.pid))) > 800 * 10**6
        assert processes.proportional_bytes(process.pid) < 300 * 10**6
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        process.stdout.close()


IN_FILES = {
    "memfd": "file = os.memfd_create('x'); os.write(file, bytes(200 << 20))",
    "unlinked": "file = os.open('/dev/shm', os.O_RDWR | os.O_TMPFILE); os.write(file, bytes(200 << 20))",
    "mapped": (
        "file = os.memfd_create('x'); os.truncate(file, 200 << 20); "
        "hog = mmap.mmap(file, 0); hog.write(bytes(200 << 20))"
    ),
    "handed on": "file = os.memfd_create('x'); os.write(file, bytes(200 << 20)); os.fork()",
}


@pytest.mark.parametrize("way", IN_FILES)
def test_files_in_memory_count_once(way: str) -> None:
    """Nobody has to map them to fill a machine with them."""
    script = f"import mmap, os, signal\n{IN_FILES[way]}\nprint(flush=True)\nsignal.pause()"
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, start_new_session=True)
    assert process.stdout is not None
    try:
        process.stdout.readline()
        assert 200 << 20 <= processes.proportional_bytes(process.pid) < 300 << 20
        assert 200 << 20 <= processes.memory_file_bytes(processes.tree_pids(process.pid)) < 300 << 20
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        process.stdout.close()


@pytest.mark.usefixtures("isolation")
def test_an_isolated_adapter_has_no_network_and_writes_nothing(write_adapter: Write) -> None:
    """Home and temporary files are its own and go with it; shared memory works; not even root undoes it inside."""
    folder = write_adapter(SUBJECT)
    with running_server(folder, options=("--isolate",)) as server:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            assert _ask(server, "connect", listener.getsockname()[1]) != 0
        assert _ask(server, "undo", str(folder)) != 0
        for place in (folder, folder.parent):
            assert "Read-only" in str(_ask(server, "write", str(place / "left.txt")))
        assert not list(folder.parent.rglob("left.txt"))
        assert _ask(server, "picture", np.ones((480, 640, 3), np.uint8)) == 480 * 640 * 3
        home, temporary, text = _ask(server, "write_home")  # type: ignore[misc]
        assert text == "written"
        assert Path(home).parent == Path(temporary).parent
        assert Path(home).is_dir()
    assert not Path(home).parent.exists()


@pytest.mark.usefixtures("isolation")
def test_an_isolated_adapter_that_hangs_shows_where(write_adapter: Write) -> None:
    """The signal for that reaches it, and its end is the end of all; a busy machine gets more time."""
    adapter = write_adapter(SUBJECT)
    for seconds in (1, 10, 60):
        overrides = {"hang": True, "max_connect_seconds": seconds}
        with (
            pytest.raises(ServerStartError, match=f"within {seconds} s") as raised,
            running_server(adapter, overrides, options=("--isolate",)),
        ):
            pass
        if any("__init__" in line for line in raised.value.log):
            return
    pytest.fail("the log does not show where it hangs")


def _bwrap(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a program of ours in the place of bubblewrap."""
    program = folder / "bin" / "bwrap"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent), prepend=os.pathsep)


def test_isolation_without_bubblewrap_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one error, with exit code 4; to keep processes apart takes none."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match="bubblewrap") as raised:
        sandbox.check([tmp_path], memory_limit="none", isolate=True)
    assert raised.value.code == ExitCode.NOT_RUN
    assert "apt-get install bubblewrap" in str(raised.value.hint)


def test_a_bubblewrap_that_fails_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _bwrap(tmp_path, "echo 'bwrap: no permission' >&2; exit 1", monkeypatch)
    with pytest.raises(UserError, match="bwrap: no permission") as raised:
        sandbox.check([tmp_path], memory_limit="none", isolate=True)
    assert raised.value.code == ExitCode.NOT_RUN


_DOES_NOTHING = 'while [ "$1" != -- ]; do shift; done; shift; exec "$@"'


def test_a_bubblewrap_that_does_not_isolate_is_not_relied_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Isolation is proven by trying, not by asking."""
    _bwrap(tmp_path, _DOES_NOTHING, monkeypatch)
    with pytest.raises(UserError, match="stays"):
        sandbox.check([tmp_path], memory_limit="none", isolate=True)


def test_an_audit_asks_for_isolation_before_it_begins(
    write_adapter: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 4 and the reason; nothing was served."""
    _bwrap(tmp_path, _DOES_NOTHING, monkeypatch)
    asked = ["audit", str(write_adapter(SUBJECT)), "--isolate", "--gate", "static"]
    result = CliRunner().invoke(app, asked)
    assert isinstance(result.exception, UserError)
    assert result.exception.code == ExitCode.NOT_RUN
    assert "bubblewrap cannot provide it" in str(result.exception)
    assert not result.stdout


@pytest.mark.slow
@pytest.mark.usefixtures("isolation")
def test_an_isolated_audit_finds_what_writes_into_its_checkout(write_adapter: Write) -> None:
    """What works by chance on the author's machine fails there."""
    folder = write_adapter(
        SUBJECT.replace("self.obs = obs\n", "self.obs = obs\n            open('left.txt', 'w').close()\n")
    )
    options = AuditOptions(gates=(Gate.OFFLINE,), names=("serves", "repeated-inference"), isolate=True)
    report = engine.audit(folder, "policy", options)
    reasons = [str(result.reason) for result in report.results]
    assert any("Read-only" in reason for reason in reasons), reasons
    assert not (folder / "left.txt").exists()


def test_a_key_can_be_left_out_and_the_folder_changed(write_adapter: Write, serve: Serve, tmp_path: Path) -> None:
    """`--unset` and `--chdir` change what the adapter meets, and nothing else."""
    model = """
        import os


        class Model:
            def __init__(self, config):
                self.config = config

            def infer(self, obs):
                return ["extra" in self.config, os.getcwd()]
    """
    folder = write_adapter(model)
    deploy = folder / "deploy.yml"
    deploy.write_text(deploy.read_text(encoding="utf-8").replace("{", '{"extra": 1, ', 1), encoding="utf-8")
    with Client(serve(folder).url) as client:
        assert client.infer({}) == [True, str(folder)]
    with Client(serve(folder, options=("--unset", "extra", "--chdir", str(tmp_path))).url) as client:
        assert client.infer({}) == [False, str(tmp_path)]


_KINDS = """
import json, socket, sys
made = []
for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM, socket.SOCK_SEQPACKET, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC):
    try:
        socket.socket(socket.AF_UNIX, kind)
        made.append(True)
    except OSError:
        made.append(False)
print(json.dumps(made))
"""


@pytest.mark.usefixtures("isolation")
@pytest.mark.parametrize(("devices", "sequenced"), [([], False), (["/dev/nvidia0"], True)])
def test_named_sockets_are_refused_but_for_the_kind_that_cuda_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, devices: list[str], *, sequenced: bool
) -> None:
    """Only where there is a device of that kind."""
    known = [path for path in plan._devices() if "nvidia" not in path]
    program = seccomp.program(cuda=bool(devices))
    assert program is not None
    monkeypatch.setattr(plan, "_devices", lambda: known)
    monkeypatch.setattr(seccomp, "program", lambda **_: program)
    with sandbox.isolated(tmp_path) as way:
        done = subprocess.run([*way.prefix, sys.executable, "-c", _KINDS], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [False, False, sequenced, sequenced]
