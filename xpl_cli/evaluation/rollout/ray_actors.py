"""Actors of a Ray cluster: rollout workers and policy servers, as plain classes that `ray_backend` turns into actors.

They refuse by a return value instead of an exception: Ray wraps exceptions of actors in its own.
"""

from __future__ import annotations

import platform
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import xpl_cli
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records.fingerprints import checkpoint_of, machine_facts, package_digest
from xpl_cli.evaluation.rollout.config import RolloutConfig, ServerAccess
from xpl_cli.evaluation.rollout.servers import ManagedServer, ServerConfig, ServerLostError
from xpl_cli.evaluation.rollout.worker import RolloutWorker
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.packages import package

if TYPE_CHECKING:
    from xpl_cli.evaluation.records.fingerprints import Facts
    from xpl_cli.evaluation.rollout.backend import RolloutJob, RolloutResult

_SAME_PLACE = "the same files must lie at the same place on every machine: a shared folder, or the same image"


@dataclass(frozen=True)
class Refusal:
    """Why nothing can run: a UserError that can be pickled."""

    message: str
    hint: str | None
    code: int

    @classmethod
    def of(cls, error: UserError) -> Refusal:
        """Return the refusal of an error."""
        return cls(str(error), error.hint, error.code)

    def error(self) -> UserError:
        """Return the error of this refusal."""
        return UserError(self.message, hint=self.hint, code=ExitCode(self.code))


@dataclass(frozen=True)
class ActorUnavailable:
    """Why an actor can run no more jobs; the requested job has not begun."""

    reason: str


@dataclass(frozen=True)
class ActorInfo:
    """Where a worker runs.

    Attributes:
        worker: its name in records.
        facts: of its machine.
    """

    worker: str
    facts: Facts


class PolicyServerActor:
    """A policy server: for workers on other machines, or for one in the same process.

    Args:
        version: of xpl on the machine that leads the run.
        config: how it is started.
        clients: number of workers that use it.
        token: required of workers on other machines; None restricts it to this machine, with a token of its own.

    Attributes:
        token: the required token.
    """

    def __init__(self, version: str, config: ServerConfig, clients: int, token: str | None) -> None:
        self._version = version
        self._config = config = replace(config, bounds=_isolation_here(config))
        self._server = ManagedServer(config, clients, () if token is None else ("--host", _address()), token)
        self.token = self._server.token
        self._is_checked = False

    def url(self) -> str | Refusal | ActorUnavailable:
        """Return where it answers; starts it where it does not run (any more)."""
        try:
            self._check()
            return self._server.url()
        except UserError as error:
            return Refusal.of(error)
        except ServerLostError as error:
            return ActorUnavailable(f"the policy server does not start any more: {error}")

    def url_after_failure(self) -> str | Refusal | ActorUnavailable:
        """Return its address, after an attempt in which it may have failed."""
        self.suspect()
        return self.url()

    def suspect(self) -> None:
        """End it after an attempt in which it may have failed, unless others use it and it responds."""
        self._server.drop()

    def _check(self) -> None:
        """Raise a UserError unless this machine has adapter and checkpoint of the run; checks once."""
        if not self._is_checked:
            _check_version(self._version)
            _check_files("adapter", self._config.policy, self._config.policy_digest)
            _check_checkpoint(self._config)
            self._is_checked = True


class RolloutActor:
    """A rollout worker and its own policy server, if it has one.

    Args:
        version: of xpl on the machine that leads the run.
        config: what is run.
        own_server: how its own server is started; None if servers are separate actors.
        number: of the worker.
        token: required by separate servers.
    """

    def __init__(
        self, version: str, config: RolloutConfig, own_server: ServerConfig | None, number: int, token: str | None
    ) -> None:
        self._version = version
        self._config = config = replace(config, bounds=_isolation_here(config))
        self._worker = f"{platform.node()}/{number}"
        self._server = None if own_server is None else PolicyServerActor(version, own_server, 1, None)
        self._token = token if self._server is None else self._server.token
        self._rollout_worker: RolloutWorker | None = None

    def ready(self) -> ActorInfo | Refusal | ActorUnavailable:
        """Prepare and return where the worker runs; idempotent."""
        try:
            _check_version(self._version)
            _check_files("adapter", self._config.policy, self._config.policy_digest)
            _check_files("environment", self._config.environment, self._config.environment_digest)
            if self._rollout_worker is None:
                self._rollout_worker = RolloutWorker(self._config, self._worker, ServerAccess(self._token))
        except UserError as error:
            return Refusal.of(error)
        url = None if self._server is None else self._server.url()
        return url if isinstance(url, (Refusal, ActorUnavailable)) else ActorInfo(self._worker, machine_facts())

    def run_job(self, job: RolloutJob, url: str | None) -> RolloutResult | Refusal | ActorUnavailable:
        """Run an attempt at an episode, with the policy server at `url` or its own."""
        assert self._rollout_worker is not None  # noqa: S101 - for the type checker: `ready` was called
        address = url if self._server is None else self._server.url()
        if not isinstance(address, str):
            return address or ActorUnavailable("the rollout worker has no policy server")
        try:
            result = self._rollout_worker.run_job(job, address)
        except UserError as error:
            return Refusal.of(error)
        if self._server is not None and result.is_server_suspect:
            self._server.suspect()
        return result


def _check_version(expected: str) -> None:
    if xpl_cli.__version__ != expected:
        raise UserError(
            f"{platform.node()} has xpl {xpl_cli.__version__}, this machine {expected}: all need the same",
            code=ExitCode.NOT_RUN,
        )


def _check_files(what: str, folder: str, digest: str) -> None:
    if package_digest(Path(folder)) != digest:
        raise UserError(
            f"{platform.node()}: {folder} is not the {what} of this run: it has other files, or is not there",
            hint=_SAME_PLACE,
            code=ExitCode.NOT_RUN,
        )


def _isolation_here(config: RolloutConfig | ServerConfig) -> IsolationSettings:
    """Return the adapter's isolation on this machine."""
    settings = config.bounds
    return settings if settings.isolate else IsolationSettings.strictest(Path(config.policy).parent, isolate=False)


def _check_checkpoint(config: ServerConfig) -> None:
    checkpoint = checkpoint_of(package.load(config.policy, config.overrides), config.overrides)
    if (None if checkpoint is None else checkpoint.digest) != config.checkpoint_digest:
        raise UserError(
            f"{platform.node()}: the checkpoint of {config.policy} is not the run's: "
            f"{'there is none' if checkpoint is None else checkpoint.path}",
            hint=_SAME_PLACE,
            code=ExitCode.NOT_RUN,
        )


def _address() -> str:
    """Return the address of this machine in the cluster."""
    import ray

    address: str = ray.util.get_node_ip_address()
    return address
