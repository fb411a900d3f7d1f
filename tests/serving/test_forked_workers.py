"""Workers are forked from a process that has imported their libraries; nothing else may differ from starting them."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.peer import wait_until
from xpl import Client
from xpl.client import PolicyServerError
from xpl_cli.isolation import processes
from xpl_cli.isolation.forks import AdapterForkServer
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.isolation.subprocess_task import TaskSettings, run
from xpl_cli.packages.package import load
from xpl_cli.serving.launch import running_server

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    WriteAdapter = Callable[..., Path]

pytestmark = pytest.mark.skipif(not AdapterForkServer.is_possible(), reason="workers are forked on Linux only")

TELLS = """
    {head}
    import os
    import random
    import sys

    import numpy as np

    imported = globals().get("imported", 0) + 1

    class Model:
        def __init__(self, config):
            self.seed = config["seed"]
            print("a line of the model", flush=True)

        def infer(self, observation):
            if observation.get("end"):
                os._exit(7)
            import numpy.polynomial.hermite_e as library
            return {{
                "drawn": [random.random(), float(np.random.random())],
                "imported": imported,
                "hash": hash("a text"),
                "library": library.__file__,
                "pid": os.getpid(),
                "seed": self.seed,
                "more": {more},
            }}

        def reset(self):
            pass
"""


@pytest.fixture(scope="module")
def bounds(tmp_path_factory: pytest.TempPathFactory) -> IsolationSettings:
    return IsolationSettings.strictest(tmp_path_factory.getbasetemp(), isolate=False)


@pytest.fixture
def serve(write_adapter: WriteAdapter, bounds: IsolationSettings) -> Iterator[Callable[..., dict[str, Any]]]:
    """Serve an adapter once more from one fork server, and return its answer, with the server's log."""
    servers: dict[Path, AdapterForkServer] = {}

    def once(adapter: Path, **overrides: object) -> dict[str, Any]:
        if adapter not in servers:
            servers[adapter] = AdapterForkServer(sys.executable, adapter, bounds)
        with running_server(adapter, overrides, options=bounds.flags, forks=servers[adapter]) as server:
            with Client(server.url) as client:
                answer: dict[str, Any] = client.infer({})
            return {**answer, "log": list(server.log)}

    yield once
    for server in servers.values():
        server.close()


def _adapter(write_adapter: WriteAdapter, head: str = "import json", more: str = "None") -> Path:
    return write_adapter(TELLS.format(head=head, more=more))


def test_forked_workers_share_imports_and_nothing_else(
    serve: Callable[..., dict[str, Any]], write_adapter: WriteAdapter
) -> None:
    """The hash seed tells which ones were forked from one process."""
    adapter = _adapter(write_adapter)
    first, second, third = serve(adapter), serve(adapter), serve(adapter, seed=5)
    assert second["hash"] == third["hash"] != first["hash"]
    assert len({number for one in (first, second, third) for number in one["drawn"]}) == 6
    assert [one["imported"] for one in (first, second, third)] == [1, 1, 1]
    assert len({one["pid"] for one in (first, second, third)}) == 3
    assert (second["seed"], third["seed"]) == (first["seed"], 5)
    assert "a line of the model" in third["log"]


@pytest.mark.parametrize(
    "case",
    [("import json", True), ("import colorsys", False), ("import threading; threading.Thread({idle}).start()", False)],
    ids=["as usual", "it imports what the adapter hides", "it starts a thread"],
)
def test_workers_are_started_where_a_fork_would_differ(
    case: tuple[str, bool],
    serve: Callable[..., dict[str, Any]],
    write_adapter: WriteAdapter,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And each gets the module that its adapter puts before that of the standard library."""
    library, is_forked = case
    idle = "target=threading.Event().wait, daemon=True"
    (tmp_path / "a_library.py").write_text(library.format(idle=idle), encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    head = "import sys; sys.path.insert(0, __file__.rpartition('/')[0] + '/vendored'); import a_library, colorsys"
    adapter = _adapter(write_adapter, head, "colorsys.__file__")
    (adapter / "vendored").mkdir()
    (adapter / "vendored" / "colorsys.py").touch()
    serve(adapter)
    first, second = serve(adapter), serve(adapter)
    assert (first["hash"] == second["hash"]) is is_forked
    assert first["more"] == second["more"] == str(adapter / "vendored" / "colorsys.py")


def test_the_end_of_a_forked_worker_is_told(write_adapter: WriteAdapter, bounds: IsolationSettings) -> None:
    adapter = _adapter(write_adapter)
    forks = AdapterForkServer(sys.executable, adapter, bounds)
    with running_server(adapter, options=bounds.flags, forks=forks):
        pass
    with (
        running_server(adapter, options=bounds.flags, forks=forks) as server,
        Client(server.url) as client,
        pytest.raises(PolicyServerError, match="ended with exit code 7"),
    ):
        client.infer({"end": True})
    forks.close()


def test_a_killed_server_leaves_no_forked_worker(write_adapter: WriteAdapter, bounds: IsolationSettings) -> None:
    """Nor does the end of the fork server."""
    adapter = _adapter(write_adapter)
    forks = AdapterForkServer(sys.executable, adapter, bounds)
    with running_server(adapter, options=bounds.flags, forks=forks):
        pass
    with running_server(adapter, options=bounds.flags, forks=forks) as server:
        before = set(processes.tree_pids(forks.pid))
        os.kill(server.pid, signal.SIGKILL)
        wait_until(lambda: len(processes.tree_pids(forks.pid)) < len(before), "the worker has ended")
    left = processes.descendants(forks.pid)
    forks.close()
    wait_until(lambda: not any(one.is_alive for one in left), "all have ended")


def test_a_server_whose_fork_server_is_gone_starts_its_worker(
    write_adapter: WriteAdapter, bounds: IsolationSettings
) -> None:
    adapter = _adapter(write_adapter)
    forks = AdapterForkServer(sys.executable, adapter, bounds)
    forks.close()
    with running_server(adapter, options=bounds.flags, forks=forks) as server, Client(server.url) as client:
        assert client.infer({})["imported"] == 1


def test_tasks_are_forked_too(write_adapter: WriteAdapter, bounds: IsolationSettings) -> None:
    """They answer as one that was started does, and nothing of them is left."""
    adapter = _adapter(write_adapter, "import subprocess; subprocess.Popen(['sleep', '1000'], start_new_session=True)")
    package = load(adapter)
    order = {"policy_dir": str(adapter), "config": package.config({}), "manifest": dict(package.manifest.data)}
    request = {**order, "script": [["infer", [{}]]]}
    settings = TaskSettings(sys.executable, adapter, bounds)
    forks = AdapterForkServer(sys.executable, adapter, bounds)
    with running_server(adapter, options=bounds.flags, forks=forks):
        pass
    settings = replace(settings, forks=forks)
    before = set(processes.tree_pids(forks.pid))
    first, second = (run("xpl.worker.inprocess", request, settings).answers for _ in range(2))
    assert first[1].result["hash"] == second[1].result["hash"]
    assert first[1].result["pid"] != second[1].result["pid"]
    assert set(processes.tree_pids(forks.pid)) == before
    forks.close()
