"""Fixtures: peers in their own interpreters, and an adapter that takes notes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.client.interop import build
from tests.client.interop.driver import Driver, environment
from tests.client.interop.journal import ADAPTER, CHUNK, Journal

OPTIONS = {"cameras": "cam_head:base_rgb", "connect_attempts": 1, "request_timeout_s": 30.0}
Start = Callable[..., Driver]


@pytest.fixture(params=[environment(name) for name in build.NAMES])
def peers(request: pytest.FixtureRequest) -> Path:
    python = build.interpreter(request.param)
    assert python is not None
    return python


@pytest.fixture
def start() -> Iterator[Start]:
    with contextlib.ExitStack() as stack:
        clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}

        def started(python: Path, script: str, **extra: str) -> Driver:
            return stack.enter_context(Driver(python, script, clean | extra))

        yield started


@pytest.fixture
def plugin(peers: Path, start: Start) -> Callable[..., Driver]:
    def opened(url: str, **options: Any) -> Driver:
        driver = start(peers, "inspect_robots_driver.py")
        driver.ask("open", url=url, **{**OPTIONS, **options})
        return driver

    return opened


@pytest.fixture
def journal(write_adapter: Callable[..., Path], tmp_path: Path) -> Journal:
    folder = write_adapter(ADAPTER, temporal={"kind": "chunk", "chunk": CHUNK})
    return Journal(folder, tmp_path / "journal.jsonl")


@pytest.fixture(params=["Client", "AsyncClient"])
def client(request: pytest.FixtureRequest, peers: Path, start: Start) -> Callable[..., Driver]:
    def opened(url: str, **config: Any) -> Driver:
        driver = start(peers, "client_driver.py", PYTHONPATH=str(build.ROOT))
        assert driver.ask("open", kind=request.param, url=url, **config)
        return driver

    return opened
