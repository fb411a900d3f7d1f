"""What an episode leaves behind besides its result: curves, the latency of the policy, a film.

`Watch` stands between an evaluation loop and its environment and client, changes nothing, and works with an adapter's
own loop as with ours. A trace holds no wall-clock time: equal episodes give equal bytes.
"""

from __future__ import annotations

import io
import math
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl_cli.evaluation.records.model import Inference

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from xpl.embodiment import Embodiment
    from xpl_cli.environments.film import Reel

_ASKS = (sdk.Method.GET_ACTION, sdk.Method.GET_ACTION_BATCH, sdk.Method.INFER)
_CURVES = (sdk.State.ARM_JOINT_STATE, sdk.State.EE_JOINT_STATE, sdk.State.EE_POSE)
_BINS = 32


class Watch:
    """A task environment, of one environment, that is looked at.

    Args:
        task_env: the environment; whatever it offers besides the surface is passed on.
        embodiment: its robot.
        frequency: control rate, Hz.
        traced: whether curves are kept.
        reel: takes the film, or None.
    """

    def __init__(
        self, task_env: Any, embodiment: Embodiment, frequency: float, *, traced: bool = True, reel: Reel | None = None
    ) -> None:
        self._env = task_env
        self._names = [prefix + name for prefix in embodiment.prefixes for name in _CURVES] if traced else []
        self._frequency = frequency
        self._reel = reel
        self._steps = 0
        self._states: list[tuple[int, list[Any]]] = []
        self._actions: list[list[Any]] = []
        self._chunks: list[int] = []
        self._latencies: list[float] = []

    def __getattr__(self, name: str) -> Any:
        """Return what the environment offers besides the surface."""
        return getattr(self._env, name)

    def listen(self, client: Any) -> Any:
        """Return the client, listened to, by whoever guards the environment too."""
        inner = getattr(self._env, "listen", None)
        return Listener(client if inner is None else inner(client), self._asked)

    def get_obs(self) -> Any:
        """Return the observation of the environment."""
        obs = self._env.get_obs()
        self._saw(obs)
        return obs

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks may pass it by position
    ) -> Any:
        """Return the observation of the environment, in a list."""
        observations = self._env.get_obs_batch(env_idx_list, last_frame)
        for obs in observations:
            self._saw(obs)
        return observations

    def take_action(self, action: Any) -> Any:
        """Execute an action step."""
        report = self._env.take_action(action)
        self._did(action)
        return report

    def take_action_batch(self, actions: Sequence[Any], env_idx_list: Sequence[int]) -> Any:
        """Execute an action step of each environment in the list."""
        reports = self._env.take_action_batch(actions, env_idx_list)
        for action in actions:
            self._did(action)
        return reports

    @property
    def inference(self) -> Inference:
        """Count, total and histogram of the policy's answers."""
        counts = [0] * _BINS
        for seconds in self._latencies:
            counts[_bin(seconds)] += 1
        return Inference(len(self._latencies), round(sum(self._latencies), 6), counts)

    def trace(self) -> bytes | None:
        """Return the curves as an .npz; None where none were kept.

        Arrays: `frequency` () Hz; `chunk_starts` (C,) int32, the control steps before which the policy was asked;
        `state_steps` (N,) int32, the control steps before which `state.<name>` (N, D) was seen; `action.<name>` (T, D)
        as commanded. States and actions are float32 under the observation's and action's own names.
        """
        if not self._states:
            return None
        curves = {
            sdk.Obs.FREQUENCY: np.float64(self._frequency),
            "chunk_starts": np.unique(np.array(self._chunks, np.int32)),
            "state_steps": np.array([step for step, _ in self._states], np.int32),
            **self._columns("state", [values for _, values in self._states]),
            **self._columns("action", self._actions),
        }
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **curves)
        return buffer.getvalue()

    def film(self) -> bytes | None:
        """Return the film as an animated WebP; None where there is none."""
        return None if self._reel is None else self._reel.encoded()

    def _saw(self, obs: Any) -> None:
        if not self._steps and self._reel is not None and not self._reel.steps:
            self._look()
        state = obs.get(sdk.Obs.STATE) if self._names and isinstance(obs, Mapping) else None
        if isinstance(state, Mapping) and (not self._states or self._states[-1][0] < self._steps):
            self._states.append((self._steps, self._chosen(state)))

    def _did(self, action: Any) -> None:
        if self._names and isinstance(action, Mapping):
            self._actions.append(self._chosen(action))
        self._steps += 1
        self._look()

    def _chosen(self, values: Mapping[str, Any]) -> list[Any]:
        # Copies: a view would keep a whole observation, pictures and all, for as long as the episode lasts.
        return [np.array(values[name], np.float32) if name in values else None for name in self._names]

    def _columns(self, kind: str, rows: list[list[Any]]) -> dict[str, Any]:
        """Return one array for each curve that every row has."""
        columns = zip(self._names, zip(*rows, strict=True), strict=False)
        return {f"{kind}.{name}": np.stack(column) for name, column in columns if all(e is not None for e in column)}

    def _asked(self, seconds: float) -> None:
        self._chunks.append(self._steps)
        self._latencies.append(seconds)

    def _look(self) -> None:
        """Film the moment; an environment that cannot be filmed is played without."""
        from xpl_cli.basics.errors import UserError

        if self._reel is None:
            return
        try:
            self._reel.look(self._env)
        except (UserError, RuntimeError):
            self._reel = None


class Listener:
    """A client whose answers with actions are timed; everything else passes."""

    def __init__(self, client: Any, asked: Callable[[float], None]) -> None:
        self._client = client
        self._asked = asked

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._client, name)
        return self._timed(found) if name in _ASKS else found

    def call(self, func_name: str, *args: Any, **kwargs: Any) -> Any:
        """Call an operation by name."""
        call = self._timed(self._client.call) if func_name in _ASKS else self._client.call
        return call(func_name, *args, **kwargs)

    def _timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def ask(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            answer = function(*args, **kwargs)
            self._asked(time.perf_counter() - began)
            return answer

        return ask


def _bin(seconds: float) -> int:
    """Return the bin of a latency: 1 ms * 2^(k/2) for k = 0 .. 31; the first and the last are open."""
    halves = 2 * math.log2(max(seconds, 1e-9) / 1e-3)
    return min(_BINS - 1, max(0, math.floor(halves)))
