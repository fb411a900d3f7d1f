"""Environments of peers, and the tests' end of a conversation with a driver (`lines.py`)."""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest

from tests.client.interop import build

FOLDER = Path(__file__).resolve().parent
END_S = 10.0


def environment(name: str) -> Any:
    missing = f"not run: there is no environment made from {name}{build.SUFFIX}; `./dev peers` makes it"
    return pytest.param(name, marks=[] if build.interpreter(name) else [pytest.mark.skip(reason=missing)])


class PeerError(Exception):
    """An operation failed in the peer.

    Attributes:
        kind: name of the exception's class there.
        details: what the exception carries under that name, if anything.
    """

    def __init__(self, kind: str, message: str, details: Mapping[str, Any]) -> None:
        super().__init__(f"{kind}: {message}")
        self.kind = kind
        self.details = details


class Driver:
    def __init__(self, python: Path, script: str, environment: Mapping[str, str]) -> None:
        # `-s`: packages of the user would mix with the locked ones.
        self.process = subprocess.Popen(
            [str(python), "-s", str(FOLDER / script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=dict(environment),
            text=True,
        )

    def send(self, message: Mapping[str, Any]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(message) + "\n")
        self.process.stdin.flush()

    def receive(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, f"the driver ended with exit code {self.process.wait()}; its standard error tells why"
        return dict(json.loads(line))

    def start(self, operation: str, **arguments: Any) -> None:
        self.send({"do": operation, **arguments})

    def result(self) -> Any:
        """Return what an operation gave.

        Raises:
            PeerError: if it failed.
        """
        answer = self.receive()
        if "error" in answer:
            raise PeerError(answer["error"], answer["message"], answer["details"])
        return answer["result"]

    def ask(self, operation: str, **arguments: Any) -> Any:
        self.start(operation, **arguments)
        return self.result()

    def end(self) -> int:
        assert self.process.stdin is not None
        self.process.stdin.close()
        return self.process.wait(END_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            assert stream is not None
            with contextlib.suppress(BrokenPipeError):
                stream.close()
