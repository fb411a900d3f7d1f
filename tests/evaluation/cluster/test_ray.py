"""Runs on a real Ray cluster of two nodes: a node or the leading process is lost on the way, and nothing else.

The nodes are processes of this machine. Their children are identified by a mark in their environment.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import pytest

from tests.client.interop import build
from tests.support import checkout
from tests.support.peer import MARK, processes, wait_until
from xpl.vector import INFRASTRUCTURE
from xpl_cli.basics.errors import ExitCode
from xpl_cli.evaluation.records import records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

FOLDER = Path(__file__).resolve().parent
PYTHON = build.interpreter("ray", locks=FOLDER)
TWO = {"num_cpus": 2}
PLAYED = ("--env", "mujoco", "--task", "lift_cube", "--film", "0", "--horizon", "1")
SAME = ("success", "score", "steps", "digest", "end_reason", "failure", "stages", "trace")
"""The parts of an episode's line that depend on its plan alone, on one machine."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(PYTHON is None, reason="not run: there is no environment made from ray.lock.txt; `./dev peers`"),
]


class Cluster:
    """Two nodes; use it as a context.

    Attributes:
        mark: what its processes, and what these start, have in their environment.
    """

    def __init__(self, first: dict[str, Any], second: dict[str, Any]) -> None:
        self.mark = uuid.uuid4().hex
        clean = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "RAY_"))}
        self._environment = {**clean, "PYTHONPATH": str(build.ROOT), "RAY_USAGE_STATS_ENABLED": "0"}
        self._process = subprocess.Popen(
            [str(PYTHON), str(FOLDER / "nodes.py"), json.dumps(first), json.dumps(second)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**self._environment, MARK: self.mark},
        )
        self._environment["RAY_ADDRESS"] = self._answer()

    def tell(self, what: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(what + "\n")
        self._process.stdin.flush()
        assert self._answer() == what

    def left(self) -> dict[int, str]:
        """Return what runs of a suite on the nodes, as far as it does not call itself something of Ray's."""
        root = str(build.ROOT)  # which may have our name in it
        return {pid: command for pid, command in processes(self.mark).items() if "xpl" in command.replace(root, "")}

    def servers(self) -> int:
        count = 0
        for pid in self.left():
            with contextlib.suppress(OSError):
                count += Path(f"/proc/{pid}/comm").read_text(encoding="utf-8").strip() == "xpl serve"
        return count

    @contextlib.contextmanager
    def playing(self, *args: str, policy: Path | str = "scripted_expert") -> Iterator[subprocess.Popen[str]]:
        """Start `xpl eval`; it is ended at the end of the block."""
        process = subprocess.Popen(
            [str(PYTHON), "-m", "xpl_cli", "eval", str(policy), *args],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self._environment,
            cwd=build.ROOT,
        )
        try:
            yield process
        finally:
            process.kill()
            process.communicate()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()


def ended(process: subprocess.Popen[str]) -> str:
    out, err = process.communicate()
    assert process.returncode == ExitCode.CLEAN, err
    return out


def lines(folder: Path) -> int:
    with contextlib.suppress(FileNotFoundError):
        return sum(b'"kind":"episode"' in line for line in (folder / records.FILE).read_bytes().splitlines())
    return 0


def same(one: records.Run, other: records.Run) -> bool:
    """Return whether two runs have the same final episodes."""
    finals = [{i: [getattr(line, key) for key in SAME] for i, line in run.finals.items()} for run in (one, other)]
    return one.plan.run == other.plan.run and finals[0] == finals[1]


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], records.Run]:
    """Return a function that runs episodes on this machine, without Ray."""

    def play(episodes: int) -> records.Run:
        out = tmp_path_factory.mktemp("reference") / "run"
        command = [str(PYTHON), "-m", "xpl_cli", "eval", "scripted_expert", *PLAYED, "--episodes", str(episodes)]
        environment = {**os.environ, "PYTHONPATH": str(build.ROOT)}
        command += ["--workers", "2", "--out", str(out)]
        subprocess.run(command, check=True, capture_output=True, env=environment, cwd=build.ROOT)
        return records.read(out)

    return play


def test_a_node_and_the_leader_are_killed_and_every_episode_counts_once(
    tmp_path: Path, reference: Callable[[int], records.Run]
) -> None:
    """The leader is killed, then the resumed run loses a node; it all ends like a run without Ray or accidents."""
    out = tmp_path / "run"
    options = (*PLAYED, "--episodes", "20", "--workers", "4", "--backend", "ray", "--out", str(out))
    with Cluster(TWO, TWO) as cluster:
        with cluster.playing(*options) as leader:
            wait_until(lambda: lines(out) >= 4, "four episodes are recorded")
            leader.send_signal(signal.SIGKILL)
            leader.communicate()
        wait_until(lambda: not cluster.left(), "servers, lanes and environments of a leader that is gone are gone")
        before = records.read(out)
        assert 4 <= len(before.finals) < 20
        with cluster.playing(*options, "--resume") as leader:
            wait_until(lambda: lines(out) >= len(before.attempts) + 4, "four more episodes are recorded")
            cluster.tell("kill")
            printed = ended(leader)
        wait_until(lambda: not cluster.left(), "nothing of the run is left on the node that lives")
    run = records.read(out)
    assert list(run.finals) == list(range(20))
    assert sorted(line.index for line in run.attempts if line.final) == list(range(20))
    assert run.attempts[: len(before.attempts)] == before.attempts
    lost = [line for line in run.attempts if line.failure == INFRASTRUCTURE]
    assert 1 <= len(lost) <= 2, lost
    assert all("lost" in line.error and not line.final for line in lost)
    assert same(run, reference(20))
    assert "raylet" not in printed, "Ray's own notes are no data"
    for line in run.finals.values():
        assert (out / line.trace.path).is_file()


def test_a_terminated_run_ends_its_processes(tmp_path: Path) -> None:
    """By SIGTERM, as by Ctrl-C: the command's own exit code, nothing on standard output, no process left."""
    out = tmp_path / "run"
    with Cluster(TWO, TWO) as cluster:
        with cluster.playing(*PLAYED, "--episodes", "50", "--backend", "ray", "--out", str(out)) as leader:
            wait_until(lambda: lines(out) >= 2, "two episodes are recorded")
            leader.terminate()
            printed, _ = leader.communicate()
        assert (leader.returncode, printed) == (ExitCode.INTERRUPTED, "")
        wait_until(lambda: not cluster.left(), "nothing of the run is left")
    assert 2 <= len(records.read(out).finals) < 50


def test_policy_servers_with_a_gpu_are_apart_and_move_to_another_node(tmp_path: Path) -> None:
    """The only node with a GPU goes while its server is in use; the server starts again on the one that comes."""
    out = tmp_path / "run"
    options = (*PLAYED, "--episodes", "10", "--workers", "2", "--policy-gpus", "1", "--backend", "ray")
    with Cluster({"num_cpus": 2}, {"num_cpus": 0, "num_gpus": 1}) as cluster:
        with cluster.playing(*options, "--out", str(out)) as leader:
            wait_until(lambda: lines(out) >= 3, "three episodes are recorded")
            assert cluster.servers() == 1
            cluster.tell("kill")
            cluster.tell("add")
            ended(leader)
        wait_until(lambda: not cluster.left(), "nothing of the run is left")
    run = records.read(out)
    assert len(run.finals) == 10
    assert all(line.success for line in run.finals.values())
    servers = {line.server for line in run.finals.values()}
    assert len(servers) >= 2, "each server, and each of its places, has an instance of its own"
    errors = [line for line in run.attempts if line.failure == INFRASTRUCTURE]
    assert 1 <= len(errors) <= 4, errors


def test_a_run_waits_for_room_and_refuses_other_files_there(tmp_path: Path) -> None:
    """The cluster has no processor at first; when one comes, the adapter's files on its machine are not the run's."""
    policy = checkout.copy(tmp_path, "policy/scripted_expert/**") / "policy/scripted_expert"
    with Cluster({"num_cpus": 0}, {"num_cpus": 1}) as cluster:
        cluster.tell("kill")
        options = (*PLAYED, "--backend", "ray", "--out", str(tmp_path / "run"))
        with cluster.playing(*options, policy=policy) as leader:
            assert leader.stderr is not None
            assert any("it needs a worker" in line for line in leader.stderr)
            (policy / "README.md").write_text("Others.", encoding="utf-8")
            cluster.tell("add")
            _, stderr = leader.communicate()
    assert leader.returncode == ExitCode.NOT_RUN
    assert f"{policy} is not the adapter of this run" in stderr
    assert not records.read(tmp_path / "run").attempts
