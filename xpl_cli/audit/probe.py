"""The offline fact: a real server in its own process, a real client, scripted observations.

Rules describe what they do in terms of this class, so that each reads as the experiment it is:

    with probe.session() as policy:
        policy.reset()
        policy.update_obs_batch(probe.observations([3, 7, 9]))
        answer = policy.get_action_batch([9])
"""

from __future__ import annotations

import contextlib
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

from xpl import Client
from xpl import _spec as sdk
from xpl.client import ClientError, PolicyServerError
from xpl.embodiment import Embodiment, UnknownEmbodimentError, get_embodiment
from xpl_cli import environments, package
from xpl_cli.audit.compare import error_code, same
from xpl_cli.audit.finish import Recorder
from xpl_cli.audit.model import Finding, NotApplicable, NotRun
from xpl_cli.serving.launch import RunningServer, ServerStartError, serving

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from xpl_cli.audit.options import Options


class Session:
    """A client whose answers are recorded for the digest. Errors of the policy are returned, not raised."""

    def __init__(self, client: Client, recorder: Recorder) -> None:
        self._client = client
        self._recorder = recorder

    def reset(self) -> Any:
        """Start an episode."""
        return self._call(sdk.Method.RESET)

    def update_obs(self, obs: Any) -> Any:
        """Show one observation."""
        return self._call(sdk.Method.UPDATE_OBS, obs)

    def update_obs_batch(self, obs_list: Sequence[Any]) -> Any:
        """Show observations of several environments."""
        return self._call(sdk.Method.UPDATE_OBS_BATCH, list(obs_list))

    def get_action(self) -> Any:
        """Ask for a chunk."""
        return self._call(sdk.Method.GET_ACTION)

    def get_action_batch(self, env_idx_list: Sequence[int] | None = None) -> Any:
        """Ask for the chunks of some environments."""
        return self._call(sdk.Method.GET_ACTION_BATCH, None if env_idx_list is None else list(env_idx_list))

    def infer(self, obs: Any) -> Any:
        """Show an observation and ask, as one unit."""
        return self._recorded(sdk.Method.INFER, lambda: self._client.infer(obs))

    def act(self, obs: Any) -> Any:
        """Start an episode, show one observation and return the chunk."""
        self.reset()
        self.update_obs(obs)
        return self.get_action()

    def _call(self, name: str, obs: Any = None) -> Any:
        return self._recorded(name, lambda: self._client.call(name, obs))

    def _recorded(self, name: str, ask: Any) -> Any:
        try:
            answer = ask()
        except PolicyServerError as error:
            answer = error
        # Texts of errors may hold addresses and paths; that there was one is what counts.
        self._recorder.add(name, error_code(answer) if isinstance(answer, PolicyServerError) else answer)
        return answer


class Probe:
    """One adapter being probed.

    Attributes:
        package: the adapter.
        config: its configuration.
        embodiment, action_type: what it is served for.
    """

    def __init__(self, target: package.Package, options: Options) -> None:
        self.package = target
        self.options = options
        self.config = target.config(options.overrides)
        try:
            self.embodiment: Embodiment = get_embodiment(str(self.config[sdk.Deploy.ENV_CFG_TYPE]))
        except UnknownEmbodimentError as error:
            raise NotRun(f"{error}: name one with --set {sdk.Deploy.ENV_CFG_TYPE}=NAME") from None
        self.action_type: str = self.config[sdk.Deploy.ACTION_TYPE]
        self.recorder = Recorder()
        self._open = contextlib.ExitStack()
        self._server: RunningServer | None = None
        self._problem: ServerStartError | None = None
        self._answered: Any = None
        self._scenario = environments.module("offline", "scenario")

    @classmethod
    @contextlib.contextmanager
    def start(cls, path: Path, options: Options) -> Iterator[Self]:
        """Prepare to probe an adapter; its server is started when it is first asked for."""
        started = cls(package.load(path), options)
        with started._open:
            yield started

    def record(self) -> str:
        """Return the hash of everything the adapter answered."""
        return self.recorder.record()

    def server(self) -> RunningServer:
        """Return the server, started on first use.

        Raises:
            NotRun: if it did not start; the rule `serves` reports why.
        """
        if self._server is None:
            try:
                self._server = self.start_server()
            except ServerStartError as error:
                raise NotRun(f"the server did not start: {error}") from None
        return self._server

    def start_server(self) -> RunningServer:
        """Start the server once; the same failure is raised again to whoever asks later.

        Raises:
            ServerStartError: with the adapter's output.
        """
        if self._problem is not None:
            raise self._problem
        try:
            return self._open.enter_context(self._serving(self.options.overrides))
        except ServerStartError as error:
            self._problem = error
            raise

    @contextlib.contextmanager
    def session(self) -> Iterator[Session]:
        """Connect to the server for the length of a `with` block."""
        with self._connected(self.server().url) as session:
            yield session

    @contextlib.contextmanager
    def fresh_session(self, **overrides: Any) -> Iterator[Session]:
        """Connect to a server of its own, in a new process, with other values of deploy.yml.

        Raises:
            NotRun: if it does not start.
        """
        with self._fresh_server(overrides) as server, self._connected(server.url) as session:
            yield session

    @contextlib.contextmanager
    def fresh_sessions(self, count: int) -> Iterator[list[Session]]:
        """Connect several clients to one server of their own, in a new process, where the adapter may be shared.

        Raises:
            NotRun: if it does not start, or refuses one of them.
        """
        with self._fresh_server({}) as server, contextlib.ExitStack() as clients:
            yield [clients.enter_context(self._connected(server.url)) for _ in range(count)]

    @property
    def required(self) -> tuple[str, ...]:
        """Inputs that the manifest requires, as dotted names; empty for an adapter without a manifest."""
        return tuple((self.package.manifest.get("inputs") or {}).get("required") or ())

    def named_inputs(self) -> tuple[str, ...]:
        """Return the inputs that the manifest requires, for rules that try them one by one.

        Raises:
            NotApplicable: if none is declared, so that there is nothing to try.
        """
        if not self.required:
            raise NotApplicable(f"no {sdk.File.POLICY_YML} declares a required input")
        return self.required

    def observation(self, env: int = 0, step: int = 0, embodiment: Embodiment | None = None) -> dict[str, Any]:
        """Return the scripted observation of one environment at one step, with every input the manifest requires."""
        if sdk.Obs.PRIVILEGED in self.required:
            raise NotApplicable("the adapter needs privileged observations, which only a simulator can give")
        cameras = [name.partition(".")[2] for name in self.required if name.startswith(sdk.Obs.VISION)]
        result: dict[str, Any] = self._scenario.observation(embodiment or self.embodiment, env, step, cameras=cameras)
        return result

    def observations(self, envs: Sequence[int], step: int = 0) -> list[dict[str, Any]]:
        """Return the scripted observations of several environments."""
        return [self.observation(env, step) for env in envs]

    def require_deterministic(self) -> None:
        """Stop a rule that compares answers where the manifest says that they differ anyway.

        Raises:
            NotApplicable: if the policy is declared not deterministic.
        """
        if not self.package.manifest.get("deterministic", True):
            raise NotApplicable("the manifest declares the policy not deterministic")

    @contextlib.contextmanager
    def run(self) -> Iterator[Session]:
        """Connect for an experiment whose answers are compared with those of another.

        Where the policy draws other random numbers in every episode, each experiment gets a server of its own, so that
        both see the first episode of a process.
        """
        self.require_deterministic()
        with self.session() if self.repeats_in_place else self.fresh_session() as session:
            yield session

    @cached_property
    def repeats_in_place(self) -> bool:
        """Whether one server answers the same in its second and third episode."""
        with self.session() as policy:
            return same(self.episode(policy), self.episode(policy))

    def answer(self, obs: Any) -> Any:
        """Return the comparable answer to one observation in a new episode."""
        with self.run() as policy:
            return policy.act(obs)

    def batch_answer(self, observations: Sequence[Any], wanted: Sequence[int] | None) -> Any:
        """Return the comparable answer to `get_action_batch(wanted)` after a batch of observations in a new episode."""
        with self.run() as policy:
            policy.reset()
            policy.update_obs_batch(observations)
            return policy.get_action_batch(wanted)

    def batch_episode(self, envs: Sequence[int], steps: int = 3) -> list[Any]:
        """Play a comparable episode of some environments in one batch; return the answer of every step."""
        answered = []
        with self.run() as policy:
            policy.reset()
            for step in range(steps):
                policy.update_obs_batch(self.observations(envs, step))
                answered.append(policy.get_action_batch(envs))
        return answered

    def combinations(self) -> list[tuple[str, str]]:
        """Return every embodiment and action type that the manifest declares, the configured pair first."""
        manifest = self.package.manifest
        configured = (self.embodiment.name, self.action_type)
        declared = [
            (name, kind) for name in manifest.get("embodiments", ()) for kind in manifest.get("action_types", ())
        ]
        return list(dict.fromkeys((configured, *declared)))

    @contextlib.contextmanager
    def served_as(self, embodiment: str, action_type: str) -> Iterator[Session]:
        """Connect to a server of one embodiment and action type: the running one, or one of its own."""
        if (embodiment, action_type) == (self.embodiment.name, self.action_type):
            opened = self.session()
        else:
            opened = self.fresh_session(**{sdk.Deploy.ENV_CFG_TYPE: embodiment, sdk.Deploy.ACTION_TYPE: action_type})
        with opened as session:
            yield session

    def episode(self, policy: Session, env: int = 0, steps: int = 3) -> list[Any]:
        """Play a scripted episode of one environment and return the chunk of every step."""
        policy.reset()
        chunks = []
        for step in range(steps):
            policy.update_obs(self.observation(env, step))
            chunks.append(policy.get_action())
        return chunks

    def start_problem(self) -> ServerStartError:
        """Return why the server did not start."""
        assert self._problem is not None  # noqa: S101 - asked for only after a failed start
        return self._problem

    def ready(self) -> None:
        """Check once that the adapter answers at all; rules about how it answers make no sense otherwise.

        Raises:
            NotRun: if it does not.
        """
        if self._answered is None:
            with self.session() as policy:
                self._answered = policy.act(self.observation())
        if isinstance(self._answered, PolicyServerError):
            raise NotRun(f"the adapter does not answer a plain observation: {self._answered}")

    @contextlib.contextmanager
    def _fresh_server(self, overrides: dict[str, Any]) -> Iterator[RunningServer]:
        try:
            with self._serving({**self.options.overrides, **overrides}) as server:
                yield server
        except ServerStartError as error:
            values = ", ".join(f"{key}={value}" for key, value in overrides.items())
            raise NotRun(f"the server did not start with {values or 'the same configuration'}: {error}") from None

    def _serving(self, overrides: dict[str, Any]) -> contextlib.AbstractContextManager[RunningServer]:
        return serving(self.package.path, overrides, python=self.options.python, env=self.options.env)

    @contextlib.contextmanager
    def _connected(self, url: str) -> Iterator[Session]:
        try:
            client = Client(
                url, config={**self.config, sdk.Deploy.MAX_CONNECT_ATTEMPTS: 3, sdk.Deploy.CONNECT_RETRY_DELAY_S: 1}
            )
        except ClientError as error:
            raise NotRun(str(error)) from None
        with client:
            yield Session(client, self.recorder)


def blame(message: str, **details: Any) -> Finding:
    """Return a finding about behaviour: it lies in model.py, on no particular line."""
    return Finding(message=message, path=sdk.File.MODEL_PY, **details)
