"""The backend of a Ray cluster: each lane is an actor, and so are policy servers that lanes share or that need GPUs.

Ray places the actors by what they ask for, and starts them again, on another machine if need be, when their process or
machine is gone. An attempt is given to an actor at most once: if the actor is lost meanwhile, so is the attempt, and
whoever leads the run decides about the next one. What does no harm twice (is this lane ready, where is that server) is
asked by Ray again until there is an answer.
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
"""How long there may be no lane at all; a model may take half of that to load."""
_NOTE_S = 20.0
_CALL_S = 10.0
_AGAIN = -1
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
    """A lane of the cluster.

    Attributes:
        actor: handle of its actor.
        server: the one that it uses; None where it has its own.
        post: where it is; None as long as it cannot play.
        job: what it plays.
    """

    actor: Any
    server: _RayServer | None
    post: ActorInfo | None = None
    job: RolloutJob | None = None

    @property
    def is_free(self) -> bool:
        """Whether it could play now."""
        return self.post is not None and self.job is None and (self.server is None or self.server.url is not None)


class RayBackend:
    """Plays jobs on a Ray cluster that runs already (see `xpl_cli.evaluation.rollout.backend.Backend`).

    The cluster is the one that Ray itself finds: at `RAY_ADDRESS`, or started on this machine. As long as this object
    lives, nothing of this process reaches standard output: Ray writes its own notes there, which cannot be turned off.

    Args:
        orders: what lanes play.
        server_orders: how the policy is served.
        room: how many lanes, None for as many as the cluster has processors left; how many policy servers, None for one
            where it needs GPUs, and else one for each lane, in the lane's own actor.
        episodes: how many are to be played; more lanes than that are no use.

    Raises:
        UserError: Ray is not installed, or there is no cluster.
    """

    def __init__(self, orders: RolloutConfig, server_orders: ServerConfig, room: BackendConfig, episodes: int) -> None:
        self._resources = contextlib.ExitStack()
        self._ray = _connected(self._resources)
        self._gpus = room.gpus
        self._has_played = False
        self._unplayed: list[RolloutJob] = []
        self._awaited: dict[Any, Callable[[Any], list[RolloutResult]]] = {}
        servers = room.servers or (1 if room.gpus else 0)
        lanes = min(room.lanes or _processors(self._ray) - servers, episodes)
        token = secrets.token_urlsafe(32) if servers else None
        shared = self._serving(server_orders, min(servers, lanes), lanes, token)
        own = None if shared else server_orders
        self._places = [
            _RayWorker(self._actor(RolloutActor).remote(xpl_cli.__version__, orders, own, number, token), server)
            for number, server in enumerate(shared or [None] * lanes)
        ]
        for server in dict.fromkeys(shared):
            self._locate(server, server.actor.url)
        for place in self._places:
            self._prepare(place)

    def free(self) -> int:
        """Return how many lanes could play now."""
        return max(0, sum(place.is_free for place in self._places) - len(self._unplayed))

    def submit(self, job: RolloutJob) -> None:
        """Give a job to a lane that is free."""
        place = next(place for place in self._places if place.is_free)
        place.job = job
        url = None if place.server is None else place.server.url
        self._awaited[place.actor.play.remote(job, url)] = partial(self._played, place)

    def wait(self) -> list[RolloutResult]:
        """Wait for outcomes, or until more lanes are free.

        Raises:
            UserError: no job can be played, or the cluster has had no room for too long.
        """
        free, found = self.free(), list[RolloutResult]()
        while not found and self.free() <= free:
            for ref in self._arrived():
                found += self._awaited.pop(ref)(ref)
            while self._unplayed and any(place.is_free for place in self._places):
                self.submit(self._unplayed.pop())
        return found

    def close(self) -> None:
        """Leave the cluster, which ends all actors of this run and what they have started."""
        self._resources.close()

    def _serving(self, orders: ServerConfig, servers: int, lanes: int, token: str | None) -> list[_RayServer]:
        """Return the server of each lane, or nothing where lanes have their own."""
        found: list[_RayServer] = []
        for number in range(servers):
            clients = lanes * (number + 1) // servers - lanes * number // servers
            # No processor of its own: a lane must not be able to take the last one from the server that it waits for.
            actor = self._actor(PolicyServerActor, num_cpus=0, num_gpus=self._gpus)
            found += [_RayServer(actor.remote(xpl_cli.__version__, orders, clients, token))] * clients
        return found

    def _actor(self, kind: type, **needs: float) -> Any:
        """Return what makes actors of a class, each of which Ray starts again as often as it is lost."""
        options = {"num_cpus": 1, "max_restarts": _AGAIN, "scheduling_strategy": "SPREAD", **needs}
        return self._ray.remote(kind).options(**options)

    def _arrived(self) -> list[Any]:
        """Return what has been answered, at least one, as references.

        Raises:
            UserError: nothing is, because Ray could not place anything.
        """
        asked = list(self._awaited)
        if any(place.job for place in self._places):
            self._ray.wait(asked)
        elif not self._ray.wait(asked, timeout=_NOTE_S)[0]:
            console.note(f"waiting for the Ray cluster: {self._wanted()}")
            if not self._ray.wait(asked, timeout=PATIENCE_S)[0]:
                raise UserError(
                    f"no worker could be started on the Ray cluster within {PATIENCE_S:g} s: {self._wanted()}",
                    hint="add machines, or ask for less, and go on with --resume",
                    code=ExitCode.NOT_RUN,
                )
        arrived: list[Any] = self._ray.wait(asked, num_returns=len(asked), timeout=0)[0]
        return arrived

    def _wanted(self) -> str:
        left = {name: count for name, count in self._ray.available_resources().items() if name in ("CPU", "GPU")}
        server = f" and a policy server (GPU {self._gpus:g})" if self._gpus else ""
        found = ", ".join(f"{name} {count:g}" for name, count in sorted(left.items())) or "nothing"
        return f"it must have room for a lane (CPU 1){server}; left are: {found}"

    def _prepare(self, place: _RayWorker) -> None:
        """Let a lane tell when it can play; one that is being started again answers then."""
        place.post = None
        self._awaited[place.actor.ready.options(max_task_retries=_AGAIN).remote()] = partial(self._prepared, place)

    def _prepared(self, place: _RayWorker, ref: Any) -> list[RolloutResult]:
        told = self._begun(ref)
        if isinstance(told, ActorUnavailable):
            self._give_up([place], told)
        else:
            place.post = told
        return []

    def _locate(self, server: _RayServer, ask: Any) -> None:
        """Ask where a server answers, by one of its actor's methods; each starts it where it does not run."""
        server.url = None
        self._awaited[ask.options(max_task_retries=_AGAIN).remote()] = partial(self._located, server)

    def _located(self, server: _RayServer, ref: Any) -> list[RolloutResult]:
        told = self._begun(ref)
        if isinstance(told, ActorUnavailable):
            self._give_up([place for place in self._places if place.server is server], told)
        else:
            server.url = told
        return []

    def _played(self, place: _RayWorker, ref: Any) -> list[RolloutResult]:
        """Return what became of a lane's job, and see to it that the lane can play again."""
        job, post = place.job, place.post
        assert job is not None and post is not None  # noqa: S101, PT018 - for the type checker: it was playing
        place.job = None
        try:
            told = self._answer(ref)
        except self._ray.exceptions.RayTaskError:
            raise  # a fault of ours
        except self._ray.exceptions.RayError as error:
            told = lost_rollout(
                job, f"the worker or its machine was lost ({type(error).__name__})", post.worker, post.facts
            )
            if place in self._places:
                self._prepare(place)
        if isinstance(told, ActorUnavailable):
            self._give_up([place], told)
            self._unplayed.append(job)  # it had not begun
            return []
        outcome: RolloutResult = told
        self._has_played = True
        # The server may have failed: ask for its address, which may be on another machine now.
        if outcome.is_server_suspect and place.server is not None and place.server.url is not None:
            self._locate(place.server, place.server.actor.url_after_failure)
        return [outcome]

    def _begun(self, ref: Any) -> Any:
        """Return what an actor answered that was to begin, or to begin again; who refuses that is unfit.

        Raises:
            UserError: it refuses, or cannot be started anywhere, before anything was played.
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
        if not self._has_played:
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

    def _give_up(self, places: list[_RayWorker], why: ActorUnavailable) -> None:
        """Remove workers that can run no job.

        Raises:
            UserError: no worker is left.
        """
        console.note(f"the run goes on without {len(places)} of {len(self._places)} workers: {why.reason}")
        for place in places:
            self._places.remove(place)
            self._ray.kill(place.actor)
        if not self._places:
            raise UserError(f"no worker is left: {why.reason}", hint="go on with --resume", code=ExitCode.NOT_RUN)


def _connected(resources: contextlib.ExitStack) -> Any:
    """Return the module `ray`, connected to a cluster until the resources are given back."""
    # By default Ray tries a quarter of an hour where nobody answers any more; it reads this when it is imported.
    os.environ.setdefault("RAY_NUM_REDIS_GET_RETRIES", "1")
    try:
        import ray
    except ImportError:
        raise UserError(
            "--backend ray needs Ray, which is not installed here",
            hint=how_to_install("ray"),
            code=ExitCode.NOT_RUN,
        ) from None
    resources.enter_context(_silence())
    try:
        _call_at(os.environ.get("RAY_ADDRESS", ""))
        with _same_end():
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
def _same_end() -> Iterator[None]:
    """Keep what SIGTERM does to a command; Ray would put an end of its own in its place."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, before)


def _call_at(address: str) -> None:
    """See whether somebody listens at an address; Ray itself would take its time, and say less.

    Raises:
        OSError: nobody does.
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
        raise OSError(f"nobody answers at RAY_ADDRESS={address} ({error.strerror or error})") from None


def _processors(ray: Any) -> int:
    """Return how many processors nobody uses now, at least two."""
    return max(2, int(ray.available_resources().get("CPU", 0)))


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):  # noqa: PTH123
        yield
