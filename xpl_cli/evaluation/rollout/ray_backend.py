"""The Ray backend: each rollout worker is an actor, and so are policy servers that workers share or that need GPUs.

Ray places the actors by their resources, and restarts them, possibly on another machine, when their process or machine
is lost. An attempt is sent to an actor at most once: if the actor is lost, so is the attempt, and the process that
leads the run decides about a retry. Idempotent calls (is this worker ready, what is the address of that server) are
repeated by Ray until they return.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import socket
import threading
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import xpl_cli
from xpl_cli.basics import console
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.extras import how_to_install
from xpl_cli.evaluation.rollout.backend import RolloutJob, RolloutResult, lost_rollout
from xpl_cli.evaluation.rollout.ray_actors import ActorInfo, ActorUnavailable, PolicyServerActor, Refusal, RolloutActor

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from xpl_cli.evaluation.rollout.backend import BackendConfig
    from xpl_cli.evaluation.rollout.config import RolloutConfig
    from xpl_cli.evaluation.rollout.servers import ServerConfig

PATIENCE_S = 1200.0
"""How long there may be no worker at all; a model may take half of that to load."""
_NOTE_S = 20.0
_CALL_S = 10.0
_UNLIMITED = -1
"""Ray's number for as often as it takes."""


@dataclass(eq=False)
class _RayServer:
    """A policy server of the cluster.

    Attributes:
        actor: handle of its actor.
        url: where it answers; None where that is not known (any more).
    """

    actor: Any
    url: str | None = None


@dataclass(eq=False)
class _RayWorker:
    """A rollout worker of the cluster.

    Attributes:
        actor: handle of its actor.
        server: its policy server; None if it has its own.
        post: where it runs; None until it is ready.
        job: the running job.
    """

    actor: Any
    server: _RayServer | None
    post: ActorInfo | None = None
    job: RolloutJob | None = None

    @property
    def is_free(self) -> bool:
        """Whether it can start a job now."""
        return self.post is not None and self.job is None and (self.server is None or self.server.url is not None)


class RayBackend:
    """Runs jobs on a running Ray cluster (see `xpl_cli.evaluation.rollout.backend.Backend`).

    The cluster is the one that Ray itself finds: at `RAY_ADDRESS`, or started on this machine. As long as this object
    lives, nothing of this process reaches standard output: Ray prints notes there, which cannot be turned off.

    Args:
        config: what workers run.
        server_config: how the policy is served.
        backend_config: number of workers, None for as many as the cluster has free processors; number of policy
            servers, None for one if it needs GPUs, and else one for each worker, in the worker's own actor.
        episodes: upper limit of useful workers.

    Raises:
        UserError: Ray is not installed, or there is no cluster.
    """

    def __init__(
        self, config: RolloutConfig, server_config: ServerConfig, backend_config: BackendConfig, episodes: int
    ) -> None:
        self._resources = contextlib.ExitStack()
        self._ray = _connect(self._resources)
        self._gpus = backend_config.gpus
        self._has_results = False
        self._returned_jobs: list[RolloutJob] = []
        self._callbacks: dict[Any, Callable[[Any], list[RolloutResult]]] = {}
        servers = backend_config.servers or (1 if backend_config.gpus else 0)
        workers = min(backend_config.workers or _processors(self._ray) - servers, episodes)
        token = secrets.token_urlsafe(32) if servers else None
        shared = self._start_servers(server_config, min(servers, workers), workers, token)
        own = None if shared else server_config
        self._workers = [
            _RayWorker(self._actor(RolloutActor).remote(xpl_cli.__version__, config, own, number, token), server)
            for number, server in enumerate(shared or [None] * workers)
        ]
        for server in dict.fromkeys(shared):
            self._locate(server, server.actor.url)
        for worker in self._workers:
            self._prepare(worker)

    def free(self) -> int:
        """Return how many workers can start a job now."""
        return max(0, sum(worker.is_free for worker in self._workers) - len(self._returned_jobs))

    def submit(self, job: RolloutJob) -> None:
        """Give a job to a free worker."""
        worker = next(worker for worker in self._workers if worker.is_free)
        worker.job = job
        url = None if worker.server is None else worker.server.url
        self._callbacks[worker.actor.run_job.remote(job, url)] = partial(self._on_result, worker)

    def wait(self) -> list[RolloutResult]:
        """Wait for results, or until more workers are free.

        Raises:
            UserError: no job can run, or the cluster has had no free resources for too long.
        """
        free, results = self.free(), list[RolloutResult]()
        while not results and self.free() <= free:
            for ref in self._ready_refs():
                results += self._callbacks.pop(ref)(ref)
            while self._returned_jobs and any(worker.is_free for worker in self._workers):
                self.submit(self._returned_jobs.pop())
        return results

    def close(self) -> None:
        """Leave the cluster, which ends all actors of this run and what they have started."""
        self._resources.close()

    def _start_servers(self, config: ServerConfig, servers: int, workers: int, token: str | None) -> list[_RayServer]:
        """Return the server of each worker; empty if workers have their own."""
        actors: list[_RayServer] = []
        for number in range(servers):
            clients = workers * (number + 1) // servers - workers * number // servers
            # No processor of its own: a worker must not take the last one from the server that it waits for.
            actor = self._actor(PolicyServerActor, num_cpus=0, num_gpus=self._gpus)
            actors += [_RayServer(actor.remote(xpl_cli.__version__, config, clients, token))] * clients
        return actors

    def _actor(self, kind: type, **needs: float) -> Any:
        """Return what makes actors of a class, each of which Ray starts again as often as it is lost."""
        options = {"num_cpus": 1, "max_restarts": _UNLIMITED, "scheduling_strategy": "SPREAD", **needs}
        return self._ray.remote(kind).options(**options)

    def _ready_refs(self) -> list[Any]:
        """Return what has been answered, at least one, as references.

        Raises:
            UserError: nothing is, because Ray could not place anything.
        """
        pending = list(self._callbacks)
        if any(worker.job for worker in self._workers):
            self._ray.wait(pending)
        elif not self._ray.wait(pending, timeout=_NOTE_S)[0]:
            console.note(f"waiting for the Ray cluster: {self._missing_resources()}")
            if not self._ray.wait(pending, timeout=PATIENCE_S)[0]:
                raise UserError(
                    f"no worker started on the Ray cluster within {PATIENCE_S:g} s: {self._missing_resources()}",
                    hint="add machines or request less, and continue with --resume",
                    code=ExitCode.NOT_RUN,
                )
        arrived: list[Any] = self._ray.wait(pending, num_returns=len(pending), timeout=0)[0]
        return arrived

    def _missing_resources(self) -> str:
        left = {name: count for name, count in self._ray.available_resources().items() if name in ("CPU", "GPU")}
        server = f" and a policy server (GPU {self._gpus:g})" if self._gpus else ""
        resources = ", ".join(f"{name} {count:g}" for name, count in sorted(left.items())) or "nothing"
        return f"it needs a worker (CPU 1){server}; available: {resources}"

    def _prepare(self, worker: _RayWorker) -> None:
        """Let a worker report that it is ready; a restarting one reports later."""
        worker.post = None
        self._callbacks[worker.actor.ready.options(max_task_retries=_UNLIMITED).remote()] = partial(
            self._on_ready, worker
        )

    def _on_ready(self, worker: _RayWorker, ref: Any) -> list[RolloutResult]:
        answer = self._start_answer(ref)
        if isinstance(answer, ActorUnavailable):
            self._remove_workers([worker], answer)
        else:
            worker.post = answer
        return []

    def _locate(self, server: _RayServer, ask: Any) -> None:
        """Request the address of a server by a method of its actor, which starts the server if it does not run."""
        server.url = None
        self._callbacks[ask.options(max_task_retries=_UNLIMITED).remote()] = partial(self._on_address, server)

    def _on_address(self, server: _RayServer, ref: Any) -> list[RolloutResult]:
        answer = self._start_answer(ref)
        if isinstance(answer, ActorUnavailable):
            self._remove_workers([worker for worker in self._workers if worker.server is server], answer)
        else:
            server.url = answer
        return []

    def _on_result(self, worker: _RayWorker, ref: Any) -> list[RolloutResult]:
        """Return the result of a worker's job, and let the worker prepare for the next one."""
        job, post = worker.job, worker.post
        assert job is not None and post is not None  # noqa: S101, PT018 - for the type checker: it was running a job
        worker.job = None
        try:
            answer = self._answer(ref)
        except self._ray.exceptions.RayTaskError:
            raise  # a fault of ours
        except self._ray.exceptions.RayError as error:
            answer = lost_rollout(
                job, f"the worker or its machine was lost ({type(error).__name__})", post.worker, post.facts
            )
            if worker in self._workers:
                self._prepare(worker)
        if isinstance(answer, ActorUnavailable):
            self._remove_workers([worker], answer)
            self._returned_jobs.append(job)  # it had not begun
            return []
        result: RolloutResult = answer
        self._has_results = True
        # The server may have failed: ask for its address, which may be on another machine now.
        if result.is_server_suspect and worker.server is not None and worker.server.url is not None:
            self._locate(worker.server, worker.server.actor.url_after_failure)
        return [result]

    def _start_answer(self, ref: Any) -> Any:
        """Return the answer of an actor that starts or restarts; a refusal makes it unavailable.

        Raises:
            UserError: it refuses or cannot be started anywhere, before any job ran.
        """
        try:
            return self._answer(ref)
        except self._ray.exceptions.RayActorError as error:
            refusal = UserError(
                f"a worker cannot be started on the Ray cluster: {str(error).strip().splitlines()[-1]}",
                hint="xpl must be installed on every machine, in the Python that Ray runs in",
                code=ExitCode.NOT_RUN,
            )
        except UserError as error:
            refusal = error
        if not self._has_results:
            raise refusal from None
        return ActorUnavailable(str(refusal))

    def _answer(self, ref: Any) -> Any:
        """Return what an actor answered.

        Raises:
            UserError: it refuses.
        """
        answer = self._ray.get(ref)
        if isinstance(answer, Refusal):
            raise answer.error()
        return answer

    def _remove_workers(self, workers: list[_RayWorker], why: ActorUnavailable) -> None:
        """Remove workers that can run no job.

        Raises:
            UserError: no worker is left.
        """
        console.note(f"the run continues without {len(workers)} of {len(self._workers)} workers: {why.reason}")
        for worker in workers:
            self._workers.remove(worker)
            self._ray.kill(worker.actor)
        if not self._workers:
            raise UserError(f"no worker is left: {why.reason}", hint="continue with --resume", code=ExitCode.NOT_RUN)


def _connect(resources: contextlib.ExitStack) -> Any:
    """Return the module `ray`, connected to a cluster until the resources are released."""
    # By default Ray retries a lost cluster for 15 minutes; it reads this when it is imported.
    os.environ.setdefault("RAY_NUM_REDIS_GET_RETRIES", "1")
    try:
        import ray
    except ImportError:
        raise UserError(
            "--backend ray needs Ray, which is not installed here",
            hint=how_to_install("ray"),
            code=ExitCode.NOT_RUN,
        ) from None
    resources.enter_context(_no_stdout())
    try:
        _check_address(os.environ.get("RAY_ADDRESS", ""))
        with _keep_sigterm_handler():
            ray.init(address="auto", log_to_driver=False, logging_level="error")
    except (OSError, RuntimeError, ValueError) as error:
        resources.close()
        raise UserError(
            f"there is no Ray cluster to join: {error}",
            hint="start one with `ray start --head`; RAY_ADDRESS=HOST:PORT is that of one that has this machine",
            code=ExitCode.NOT_RUN,
        ) from None
    resources.callback(ray.shutdown)
    return ray


@contextlib.contextmanager
def _keep_sigterm_handler() -> Iterator[None]:
    """Keep the handler of SIGTERM; Ray would install its own."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, before)


def _check_address(address: str) -> None:
    """Check that an address accepts connections; Ray itself would take longer and report less.

    Raises:
        OSError: it does not.
        ValueError: it is no address of a cluster.
    """
    host, _, port = address.rpartition(":")
    if not address or address == "auto":
        return
    if not host or "/" in host or not port.isdecimal():
        raise ValueError(f"RAY_ADDRESS must be HOST:PORT, got {address!r}")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _CALL_S).close()
    except OSError as error:
        raise OSError(f"no answer at RAY_ADDRESS={address} ({error.strerror or error})") from None


def _processors(ray: Any) -> int:
    """Return the number of free processors, at least two."""
    return max(2, int(ray.available_resources().get("CPU", 0)))


@contextlib.contextmanager
def _no_stdout() -> Iterator[None]:
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):  # noqa: PTH123
        yield
