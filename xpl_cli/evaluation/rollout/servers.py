"""The policy servers of a run: started when they are needed, again when they have ended, shared by some lanes."""

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
    """How the policy of a run is served; everything in it may travel to another machine.

    Attributes:
        policy: folder of the adapter.
        policy_digest: of its own files.
        checkpoint_digest: of what its configuration leads to; None: to nothing.
        overrides: keys of deploy.yml.
        python, env, gpu: interpreter and device of the adapter, as for `xpl serve`.
        bounds: what the adapter is kept from.
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
            token: what it asks clients for.
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
    """A policy server of this machine, for one lane or several. Its methods may be called from their threads.

    Args:
        orders: how the policy is served.
        clients: lanes that use it; each has its own model, or session of one that may be shared.
        options: further ones of `xpl serve`.
        token: what it asks its lanes for, so that no other process drives what they drive; a new one by default.
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
    """Tell whether somebody accepts connections; a process that was killed does not at once look ended."""
    address = urlsplit(url)
    try:
        with socket.create_connection((address.hostname or "", address.port or 0), _ANSWER_S):
            return True
    except OSError:
        return False
