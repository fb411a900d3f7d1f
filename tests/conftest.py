"""Fixtures of the tests that serve adapters: real processes, real sockets, ports that the system chooses."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import shutil
import subprocess
import sys
import textwrap
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from tests.support import examples, forked, once, peer, schedule
from tests.support.peer import MARK, processes, wait_until
from xpl_cli.serving import fork_server
from xpl_cli.serving.launch import RunningServer, running_server

# No test multiplies matrices, and threads for that cost every process that imports numpy half of its start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A thousand processes import the same modules; none shall compile them again because bytecode is not kept here.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
forked.remember()
once.remember()
# What is imported and collected stays: searching it for garbage again and again took a tenth of the time.
gc.disable()

# How long an example takes, or its making, depends on what else the machine does.
_ANY_MACHINE: dict[str, Any] = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("whole", **_ANY_MACHINE)
settings.load_profile("whole")

WHOLE_RUN_S = 600.0
"""What a test of the whole run waits for one thing: servers, simulators and clusters start beside each other there."""


def _is_whole(config: pytest.Config) -> bool:
    return bool(config.option.markexpr != "not slow")


def pytest_configure(config: pytest.Config) -> None:
    """Try properties with fewer examples where slow tests are left out, and wait longer where they are not."""
    examples.are_few(not _is_whole(config))
    if _is_whole(config):
        peer.DEADLINE_S = WHOLE_RUN_S
    settings.register_profile("this run", max_examples=examples.examples(100), **_ANY_MACHINE)
    settings.load_profile("this run")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave of a test with `sampled(n)` n cases, evenly spread, to the quick run; the others are slow.

    A test's own limit is raised to the command's: that says how busy the machine may be.
    """
    least = config.getoption("timeout") or 0.0
    for item in items:
        own = item.get_closest_marker("timeout")
        if own is not None and own.args[0] < least:
            item.add_marker(pytest.mark.timeout(least), append=False)
    groups: dict[tuple[str, Any], list[tuple[pytest.Item, int]]] = {}
    for item in items:
        marker = item.get_closest_marker("sampled")
        if marker is not None:
            name = item.nodeid.partition("[")[0]
            groups.setdefault((name, marker.args), []).append((item, *marker.args))
    for group in groups.values():
        count = group[0][1]
        kept = {index * len(group) // count for index in range(count)}
        for index, (item, _) in enumerate(group):
            if index not in kept:
                item.add_marker(pytest.mark.slow)
    schedule.order(items, is_whole=_is_whole(config))


def pytest_collection_finish() -> None:
    """Go on searching for garbage, among what tests leave."""
    gc.freeze()
    gc.enable()


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep the tests of a file in one process, where several run them."""
    return schedule.ByFile(config, log, is_whole=_is_whole(config))


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what audits remember out of the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("XPL_CACHE", raising=False)
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def write_adapter(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return a function that writes an adapter package."""

    def write(model: str, **manifest: Any) -> Path:
        folder = tmp_path_factory.mktemp("policy") / "Subject"
        folder.mkdir()
        (folder / "model.py").write_text(textwrap.dedent(model), encoding="utf-8")
        # JSON is YAML.
        (folder / "deploy.yml").write_text(json.dumps({"env_cfg_type": "franka_single"}), encoding="utf-8")
        (folder / "policy.yml").write_text(json.dumps(manifest), encoding="utf-8")
        return folder

    return write


@pytest.fixture
def serve() -> Iterator[Callable[..., RunningServer]]:
    """Return a function that serves an adapter until the test ends, and check that nothing is left then."""
    fork_server.warm()  # it outlives this test, and must not bear its mark
    mark = uuid.uuid4().hex
    os.environ[MARK] = mark
    served: list[RunningServer] = []
    try:
        with contextlib.ExitStack() as stack:

            def start(folder: Path, **options: Any) -> RunningServer:
                served.append(stack.enter_context(running_server(folder, **options)))
                return served[-1]

            yield start
        # A front end is forked and shows no mark; what it starts does.
        assert all(server.exit_code is not None for server in served)
        wait_until(lambda: not processes(mark), "all processes of the server are gone")
    finally:
        del os.environ[MARK]


@pytest.fixture
def fifo(tmp_path: Path) -> Path:
    """Return a named pipe: what reads it waits until the test has opened it and closed it again."""
    path = tmp_path / "fifo"
    os.mkfifo(path)
    return path


@pytest.fixture(scope="session")
def old_python() -> str:
    """Return a Python 3.9 with numpy that PATH has; the test is skipped if there is none."""
    found = shutil.which("python3.9")
    if not found or subprocess.run([found, "-c", "import numpy"], capture_output=True, check=False).returncode:
        pytest.skip("no python3.9 with numpy on PATH")
    return found
