"""The client of an evaluation, and the server it talks to where that is ours; both are made anew after a failure."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

from xpl import Client, observation
from xpl.client import ClientError, EnvironmentMismatchError
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.serving.launch import serving

if TYPE_CHECKING:
    from collections.abc import Mapping
    from contextlib import AbstractContextManager

    from xpl_cli.basics.progress import Progress
    from xpl_cli.evaluation.play import Request
    from xpl_cli.serving.launch import RunningServer


class Session:
    """Connects to a policy server when that is first needed, and again after it was dropped.

    Args:
        request: which policy, and where.
        config: the policy's configuration.
        offer: what the environment announces to the policy, but for what its observations show: inputs and cameras.
        progress: where to say what is being done.
    """

    def __init__(
        self, request: Request, config: Mapping[str, Any], offer: Mapping[str, Any], progress: Progress
    ) -> None:
        self._request = request
        self._config = config
        self._offer = offer
        self._progress = progress
        self._stack = contextlib.ExitStack()
        self._client: Client | None = None

    def client(self, task_env: Any) -> Client:
        """Return the client; connects, and starts a server, if there is none.

        Args:
            task_env: environment whose observations show which inputs it offers.

        Raises:
            UserError: there is no server, or policy and environment do not fit.
        """
        if self._client is None:
            request = self._request
            obs = task_env.get_obs_batch([0])[0]
            seen = {"inputs": observation.offered_inputs(obs), "cameras": observation.offered_cameras(obs)}
            try:
                url = request.connect or self._stack.enter_context(self._serving()).url
                client = Client(
                    url,
                    config=self._config,
                    token=request.token,
                    ssl_context=request.ssl_context,
                    environment={**self._offer, **seen},
                    on_loading=lambda told: self._progress.step(
                        f"the model is loading: {told.get('seconds', 0):.0f} s"
                    ),
                )
            except EnvironmentMismatchError as error:
                raise UserError(str(error), code=ExitCode.USAGE) from None
            except ClientError as error:
                raise UserError(str(error), code=ExitCode.NOT_RUN) from None
            self._client = self._stack.enter_context(client)
        return self._client

    def drop(self, reason: str) -> None:
        """Let go of a client that cannot go on, and of its server."""
        self._progress.step(f"{reason}; the trial does not count")
        self.close()

    def close(self) -> None:
        """Close the connection, and end the server where it is ours."""
        self._client = None
        self._stack.close()

    def _serving(self) -> AbstractContextManager[RunningServer]:
        request = self._request
        return serving(
            request.package.path,
            request.overrides,
            python=request.python,
            env=request.env,
            gpu=request.gpu,
            echo=True,
        )
