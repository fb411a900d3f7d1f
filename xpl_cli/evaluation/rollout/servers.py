"""The policy servers of a run: started on demand, restarted when they have ended, shared by workers."""

from __future__ import annotations

import contextlib
import secrets
import socket
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.serving.launch import ServerStartError, running_server

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import AbstractContextManager

    from xpl.contract import Config
    from xpl_cli.serving.launch import RunningServer

_ANSWER_S = 2.0
_STARTS = 3
"""How often the start of a server is tried that had worked before."""


@dataclass(frozen=True)
class ServerConfig:
    """How the policy of a run is served; picklable, for other machines.

    Attributes:
        policy: folder of the adapter.
        policy_digest: of its own files.
        checkpoint_digest: of the configured checkpoint; None without one.
        overrides: keys of deploy.yml.
        python, env, gpu: interpreter and device of the adapter, as for `xpl serve`.
        bounds: isolation of the adapter.
    """

    policy: str
    policy_digest: str
    checkpoint_digest: str | None = None
    overrides: Config = field(default_factory=dict)
    python: str | None = None
    env: str | None = None
    gpu: str | None = None
    bounds: IsolationSettings = field(default_factory=IsolationSettings)

    def start(self, options: Sequence[str] = (), token: str | None = None) -> AbstractContextManager[RunningServer]:
        """Return a server for the length of a `with` block (`xpl_cli.serving.launch.serving`).

        Args:
            options: further ones of `xpl serve`.
            token: that it requires of clients.
        """
        return running_server(
            Path(self.policy),
            self.overrides,
            python=self.python,
            env=self.env,
            gpu=self.gpu,
            options=(*options, *self.bounds.flags),
            echo=True,
            token=token,
        )


class ManagedServer:
    """A policy server of this machine, for one or several workers. Its methods are thread-safe.

    Args:
        config: how the policy is served.
        clients: number of workers that use it; each has its own model, or a session of a shared one.
        options: further ones of `xpl serve`.
        token: that it requires of workers, so that no other process uses it; a new one by default.
    """

    def __init__(
        self, config: ServerConfig, clients: int, options: Sequence[str] = (), token: str | None = None
    ) -> None:
        self._config = config
        self.token = token or secrets.token_urlsafe(32)
        self._options = (*options, *(("--workers", str(clients)) if clients > 1 else ()))
        self._is_shared = clients > 1
        self._turn = threading.Lock()
        self._stack = contextlib.ExitStack()
        self._running: RunningServer | None = None
        self._has_run = False

    def url(self) -> str:
        """Return where it answers; starts it where it does not run.

        Raises:
            ServerStartError: it cannot be started, and never could.
            ServerLostError: it cannot be started any more.
        """
        with self._turn:
            if self._running is None or self._running.exit_code is not None:
                self._running = None
                self._stack.close()
                self._running = self._start_process()
                self._has_run = True
            return self._running.url

    def _start_process(self) -> RunningServer:
        """Start it; if need be several times, where it has worked before."""
        failed: list[ServerStartError] = []
        while len(failed) < _STARTS:
            try:
                return self._stack.enter_context(self._config.start(self._options, self.token))
            except ServerStartError as error:
                if not self._has_run:
                    raise
                failed.append(error)
        raise ServerLostError(failed[-1].reason)

    def drop(self) -> None:
        """End it after an attempt in which it may have failed; a shared server that still responds keeps running."""
        running = self._running
        if not self._is_shared or (running is not None and not _accepts_connections(running.url)):
            self.close()

    def close(self) -> None:
        """End it."""
        with self._turn:
            self._running = None
            self._stack.close()


class ServerLostError(RuntimeError):
    """A server that had worked cannot be started any more."""


def _accepts_connections(url: str) -> bool:
    """Return whether an address accepts connections; a killed process may not look ended at once."""
    address = urlsplit(url)
    try:
        with socket.create_connection((address.hostname or "", address.port or 0), _ANSWER_S):
            return True
    except OSError:
        return False
