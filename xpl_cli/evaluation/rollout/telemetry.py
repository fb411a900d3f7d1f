"""What a rollout records besides its result: curves, the latency of the policy, a video.

`TelemetryWrapper` stands between an evaluation loop and its environment and client, changes nothing, and works with an
adapter's own loop and with ours. A trace holds no wall-clock time: equal episodes give equal bytes.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl_cli.evaluation.records.model import Inference
from xpl_cli.evaluation.rollout.env_wrapper import TaskEnvWrapper

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Action, ObservationDict, State
    from xpl.embodiment import Embodiment
    from xpl.environment import TaskEnv
    from xpl_cli.environments.film import FilmRecorder

_CURVES = (sdk.State.ARM_JOINT_STATE, sdk.State.EE_JOINT_STATE, sdk.State.EE_POSE)
_BINS = 32


class TelemetryWrapper(TaskEnvWrapper):
    """A task environment, with a single environment, whose telemetry is recorded.

    Args:
        task_env: the environment.
        embodiment: its robot.
        frequency: control rate, Hz.
        traced: whether to record curves.
        reel: takes the video, or None.
    """

    def __init__(
        self,
        task_env: TaskEnv,
        embodiment: Embodiment,
        frequency: float,
        *,
        traced: bool = True,
        reel: FilmRecorder | None = None,
    ) -> None:
        super().__init__(task_env)
        self._names = [prefix + name for prefix in embodiment.prefixes for name in _CURVES] if traced else []
        self._frequency = frequency
        self._reel = reel
        self._steps = 0
        self._states: list[tuple[int, list[Any]]] = []
        self._actions: list[list[Any]] = []
        self._chunks: list[int] = []
        self._latencies: list[float] = []

    @property
    def inference(self) -> Inference:
        """Count, total and histogram of the policy's answers."""
        counts = [0] * _BINS
        for seconds in self._latencies:
            counts[_bin(seconds)] += 1
        return Inference(len(self._latencies), round(sum(self._latencies), 6), counts)

    def trace(self) -> bytes | None:
        """Return the curves as an .npz; None if none were recorded.

        Arrays: `frequency` () Hz; `chunk_starts` (C,) int32, the control steps before an inference; `state_steps` (N,)
            int32,
        the control steps before which `state.<name>` (N, D) was observed; `action.<name>` (T, D) as commanded. States
        and actions are float32 and have the names of observations and actions.
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
        return None if self._reel is None else self._reel.encode()

    def _on_observation(self, _env: int, obs: ObservationDict) -> ObservationDict:
        if not self._steps and self._reel is not None and not self._reel.steps:
            self._add_film_frame()
        state = obs.get(sdk.Obs.STATE) if self._names and isinstance(obs, Mapping) else None
        if isinstance(state, Mapping) and (not self._states or self._states[-1][0] < self._steps):
            self._states.append((self._steps, self._values(state)))
        return obs

    def _after_step(self, actions: Sequence[Action]) -> None:
        for action in actions:
            if self._names and isinstance(action, Mapping):
                self._actions.append(self._values(action))
            self._steps += 1
            self._add_film_frame()

    def _values(self, values: State) -> list[Any]:
        # Copies: a view would keep the whole observation with its images in memory during the episode.
        return [np.array(values[name], np.float32) if name in values else None for name in self._names]

    def _columns(self, kind: str, rows: list[list[Any]]) -> dict[str, Any]:
        """Return one array for each curve that every row has."""
        columns = zip(self._names, zip(*rows, strict=True), strict=False)
        return {f"{kind}.{name}": np.stack(column) for name, column in columns if all(e is not None for e in column)}

    def _on_inference(self, seconds: float) -> None:
        self._chunks.append(self._steps)
        self._latencies.append(seconds)

    def _add_film_frame(self) -> None:
        """Add a video frame; an environment that cannot be rendered runs without a video."""
        from xpl_cli.basics.errors import UserError

        if self._reel is None:
            return
        try:
            self._reel.add_frame(self._env)
        except (UserError, RuntimeError):
            self._reel = None


def _bin(seconds: float) -> int:
    """Return the bin of a latency: 1 ms * 2^(k/2) for k = 0 .. 31; the first and the last are open."""
    halves = 2 * math.log2(max(seconds, 1e-9) / 1e-3)
    return min(_BINS - 1, max(0, math.floor(halves)))
