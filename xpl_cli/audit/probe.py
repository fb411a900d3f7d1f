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

import numpy as np

from xpl import Client
from xpl import _spec as sdk
from xpl.action import ActionError, check_chunk
from xpl.client import ClientError, PolicyServerError
from xpl.embodiment import Embodiment, UnknownEmbodimentError, get_embodiment
from xpl_cli import environments, package
from xpl_cli.audit.finish import Recorder
from xpl_cli.audit.model import Finding, NotApplicable, NotRun
from xpl_cli.serving.launch import RunningServer, ServerStartError, serving

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from xpl_cli.audit.engine import Options

_POSES = (sdk.State.EE_POSE, sdk.State.TCP_POSE)
_TOLERANCE = 1e-6
"""Actions of equal inputs may differ by this much: batched kernels sum in another order than single ones."""


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


def error_code(answer: Any) -> str | None:
    """Return the wire's error code if an answer is an error, else None."""
    return answer.code if isinstance(answer, PolicyServerError) else None


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
        try:
            with (
                self._serving({**self.options.overrides, **overrides}) as server,
                self._connected(server.url) as session,
            ):
                yield session
        except ServerStartError as error:
            values = ", ".join(f"{key}={value}" for key, value in overrides.items())
            raise NotRun(f"the server did not start with {values or 'the same configuration'}: {error}") from None

    @property
    def required(self) -> tuple[str, ...]:
        """Inputs that the manifest requires, as dotted names; empty for an adapter without a manifest."""
        return tuple((self.package.manifest.get("inputs") or {}).get("required") or ())

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


def same(first: Any, second: Any) -> bool:
    """Tell whether two answers hold the same values, up to rounding."""
    return difference(first, second) is None


def difference(first: Any, second: Any) -> str | None:
    """Return where two answers first differ, in words, or None if they do not. Two errors of one code are alike."""
    if isinstance(first, PolicyServerError) or isinstance(second, PolicyServerError):
        return None if error_code(first) == error_code(second) else f"{brief(first)} against {brief(second)}"
    if isinstance(first, dict) and isinstance(second, dict) and first.keys() == second.keys():
        return _first_difference((key, first[key], second[key]) for key in first)
    if isinstance(first, (list, tuple)) and isinstance(second, (list, tuple)) and len(first) == len(second):
        return _first_difference((f"[{index}]", a, b) for index, (a, b) in enumerate(zip(first, second, strict=True)))
    if any(isinstance(value, (dict, list, tuple)) for value in (first, second)):
        return f"{brief(first)} against {brief(second)}"
    return _array_difference(first, second)


def _first_difference(entries: Iterable[tuple[str, Any, Any]]) -> str | None:
    return next((f"{label} {found}" for label, a, b in entries if (found := difference(a, b))), None)


def _array_difference(first: Any, second: Any) -> str | None:
    a, b = np.asarray(first), np.asarray(second)
    if a.shape != b.shape:
        return f"shape {a.shape} against {b.shape}"
    if a.dtype.kind in "biuf" and b.dtype.kind in "biuf":
        if np.allclose(a, b, rtol=_TOLERANCE, atol=_TOLERANCE, equal_nan=True):
            return None
        worst = float(np.nanmax(np.abs(a.astype(float) - b.astype(float))))
        return f"{brief(first)} against {brief(second)} (largest difference {worst:.3g})"
    return None if np.array_equal(a, b) else f"{brief(first)} against {brief(second)}"


def answers(value: Any, count: int | None = None) -> bool:
    """Tell whether an answer is a non-empty list (of `count` entries) and not an error."""
    return isinstance(value, (list, tuple)) and len(value) > 0 and (count is None or len(value) == count)


def mistaken(answer: Any, alone: dict[int, Any], wanted: Sequence[int]) -> str:
    """Say for which environments a wrong batch answers, given what each of them answers."""
    if not isinstance(answer, (list, tuple)):
        return f"gives {brief(answer)}"
    if len(answer) != len(wanted):
        return f"gives {len(answer)} chunks"
    actual = [next((env for env, chunk in alone.items() if same(chunk, item)), None) for item in answer]
    if None in actual:
        return "answers with actions of no environment that was observed"
    plural = "environment" if len(actual) == 1 else "environments"
    return f"answers for {plural} {', '.join(map(str, actual))}"


def structure_problem(chunk: Any, embodiment: Embodiment, action_type: str) -> str | None:
    """Return what is wrong with a chunk's keys, dimensions or values, or None."""
    if isinstance(chunk, PolicyServerError):
        return str(chunk)
    try:
        check_chunk(chunk, embodiment, action_type)
    except ActionError as error:
        return str(error)
    return None


def shapes(chunk: Any) -> str:
    """Return keys and shapes of a chunk's first step, in words."""
    if not answers(chunk) or not isinstance(chunk[0], dict):
        return brief(chunk)
    return ", ".join(f"{key} {np.shape(value)}" for key, value in chunk[0].items())


def varied(obs: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the observation with one input changed, `name` as in the manifest (`instruction`, `vision.cam_head`)."""
    group, _, leaf = name.partition(".")
    if group == sdk.Obs.INSTRUCTION:
        return {**obs, group: "do something else entirely, quickly"}
    if group == sdk.Obs.VISION:
        camera = obs[group][leaf]
        image = camera[sdk.Camera.COLOR]
        other = np.ascontiguousarray(255 - image[::-1, :, ::-1])
        return {**obs, group: {**obs[group], leaf: {**camera, sdk.Camera.COLOR: other}}}
    state = {key: _nudged(key, value) if key.endswith(leaf) else value for key, value in obs[group].items()}
    return {**obs, group: state}


def without(obs: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the observation without one input, `name` as in the manifest."""
    group, _, leaf = name.partition(".")
    if not leaf:
        return {key: value for key, value in obs.items() if key != group}
    return {**obs, group: {key: value for key, value in obs[group].items() if not key.endswith(leaf)}}


def _nudged(key: str, value: Any) -> Any:
    if not key.endswith(_POSES):
        return value * 0.9 + 0.02
    moved = np.array(value)
    moved[: sdk.POSITION_DIM] += 0.02
    return moved


def first_step(chunk: Any) -> dict[str, list[float]]:
    """Return the first action of a chunk as short lists, for evidence."""
    if not isinstance(chunk, (list, tuple)) or not chunk or not isinstance(chunk[0], dict):
        return {}
    return {key: [round(float(item), 4) for item in np.ravel(value)] for key, value in chunk[0].items()}


def blame(message: str, **details: Any) -> Finding:
    """Return a finding about behaviour: it lies in model.py, on no particular line."""
    return Finding(message=message, path=sdk.File.MODEL_PY, **details)


def brief(value: Any) -> str:
    """Return an answer in at most 80 characters."""
    if isinstance(value, PolicyServerError):
        return f"an error ({value.code})"
    text = (
        np.array2string(np.asarray(value), precision=4, threshold=6) if isinstance(value, np.ndarray) else repr(value)
    )
    return text if len(text) <= 80 else text[:77] + "..."
