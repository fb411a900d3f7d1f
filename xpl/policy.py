"""The contract base class: everything adapters used to write again, written once.

    a[t : t + H] = g_out(pi(g_in(o_t), s_t))

`Policy` keeps the state of every environment under its index, answers the environments that were asked for, clears
them at reset and seeds them. An adapter fills in g_in (`encode`), pi (`predict`) and g_out (`decode`).
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from xpl import _spec as spec
from xpl import checkpoint
from xpl.action import ActionError, check_chunk, pack
from xpl.decoding import decode_rows, ensemble, quaternion_columns
from xpl.embodiment import get_embodiment, undeclared
from xpl.episodes import EpisodeCounter
from xpl.manifest import Manifest
from xpl.memory import Memory
from xpl.observation import env_index, env_indices
from xpl.wire.arrays import as_array

if TYPE_CHECKING:
    from xpl.contract import ActionStep, Config, Entry, Observation
    from xpl.convert import Interface

_Value = TypeVar("_Value")


class PolicyStateError(RuntimeError):
    """An operation came in an order that has no answer, such as get_action before update_obs."""


class ConfigError(ValueError):
    """A configuration value has the wrong type or is missing."""


@dataclass
class _Frame:
    """One observation and, once it was needed, what `encode` made of it."""

    obs: Observation
    inputs: Any = None
    encoded: bool = False


@dataclass
class _Environment:
    """All that is remembered of one environment in one episode."""

    rng: np.random.Generator
    frames: deque[_Frame]
    step: int = -1
    # Of model_io conversions: the last quaternions that were encoded, and the last command of each answer.
    signs: dict[str, np.ndarray] = field(default_factory=dict)
    commands: Memory = field(default_factory=Memory)
    predictions: dict[int, np.ndarray] = field(default_factory=dict)
    memory: Memory = field(default_factory=Memory)


class Policy:
    """Base class of adapters; a plain class with the same six operations is equally legal.

    Construction calls `load(config)`. What the manifest declares (chunk, history, ensembling) arrives with the
    configuration and is kept to.

    What an adapter may rely on, for each environment by itself: an observation that is shown only joins the history.
    `encode` runs when an answer is needed, once for each observation that is in the history then, the oldest first: one
    that left the history before a question is never encoded. A question runs `predict` and `decode` on the newest
    observation, and once more if it is put again, with the same history and `memory`; the random generator goes on. A
    question that fails leaves memory and generator as they were. A reset forgets all of it. docs/contract.md has more.

    Args:
        config: values of deploy.yml after overrides. Read: `env_cfg_type` (names the embodiment), `action_type`,
            `seed`; and `manifest`, the parsed policy.yml, where the adapter is served.

    Attributes:
        config: the configuration, without the manifest.
        embodiment: the robot.
        action_type: "joint" or "ee".
        seed: the run seed; 0 is a seed like any other.
        chunk: action steps that one call returns, or None where no manifest declares it.
        history: observations that `predict` sees per environment.
        interface: the model's own interface (`xpl.convert`), where the manifest has a block `model_io`; else None.
        policy_dir: folder of model.py; relative paths start there.

    Raises:
        ConfigError: if a value is missing or has the wrong type, or the manifest does not declare the robot or the
            kind of action that is asked for.
        UnknownEmbodimentError: if `env_cfg_type` names no embodiment.
    """

    def __init__(self, config: Config) -> None:
        manifest = Manifest.parse(config.get("manifest"))
        self.config = {key: value for key, value in config.items() if key != "manifest"}
        self.chunk = manifest.temporal.chunk
        self.history = manifest.temporal.history
        self._ensembling = manifest.temporal.ensembling
        self.action_type: str = self.setting(spec.Deploy.ACTION_TYPE, spec.DEPLOY_DEFAULTS[spec.Deploy.ACTION_TYPE])
        if self.action_type not in spec.ACTION_TYPES:
            raise ConfigError(f"action_type must be one of {', '.join(spec.ACTION_TYPES)}, got {self.action_type!r}")
        name = self.config.get(spec.Deploy.ENV_CFG_TYPE)
        if not isinstance(name, str):
            raise ConfigError(f"env_cfg_type must name an embodiment, got {name!r}")
        self.embodiment = get_embodiment(name)
        if refused := undeclared(manifest, name, self.action_type):
            raise ConfigError(f"{refused}; ask for one of them, or declare it if the model drives it")
        self.seed: int = self.setting(spec.Deploy.SEED, spec.DEPLOY_DEFAULTS[spec.Deploy.SEED])
        file = getattr(sys.modules.get(type(self).__module__), "__file__", None)
        self.policy_dir = Path(file).resolve().parent if file else Path.cwd()
        self.interface = self._compiled(None if manifest.model_io is None else manifest.model_io.data)
        self._environments: dict[int, _Environment] = {}
        self._order: list[int] | None = None
        self._episodes = EpisodeCounter()
        self.load(self.config)

    # -- what an adapter fills in --------------------------------------------------------------------------------------

    def load(self, config: Config) -> None:
        """Build the reference. Import heavy libraries here, so that the module itself imports anywhere."""

    def encode(self, obs: Observation, env: int) -> Any:
        """Return the model's inputs for one observation (g_in). Pure: neither changes `obs` nor keeps state.

        The default converts as the manifest's block `model_io` says.
        """
        if self.interface is None:
            raise NotImplementedError(f"{type(self).__name__} must define encode(obs, env), or have a model_io block")
        return self.interface.encode(obs, self._environments[env].signs)

    def predict(self, inputs: Any, envs: list[int]) -> Any:
        """Run the model on a batch (pi), in one forward pass where it can.

        Args:
            inputs: what `encode` returned, one entry per environment. With history > 1 an entry is a list of
                `history` encodings, oldest first; the first observation is repeated until the history is full.
                With a block `model_io` and no `encode` of your own: a map of the model's inputs, each a (B, ...) array
                or a list of B texts.
            envs: environment index of each entry; `self.rng(env)` is its random generator.

        Returns:
            (B, H, D) array, or a list of B arrays (H, D): flat actions in the order of `xpl.action.pack`.
        """
        raise NotImplementedError(f"{type(self).__name__} must define predict(inputs, envs)")

    def decode(self, raw: np.ndarray, obs: Observation, env: int) -> list[ActionStep]:
        """Return the action chunk of one environment (g_out).

        The default converts as the manifest's block `model_io` says; without one it reads each row of `raw`, (H, D), as
        a flat absolute action. Override it where the model predicts something else, for example deltas to the state in
        `obs`, the newest observation.
        """
        if self.interface is None:
            return decode_rows(raw, self.embodiment, self.action_type)
        commands = self._environments[env].commands
        last = dict(commands.value or {})
        steps = self.interface.decode(raw, obs, last)
        commands.keep(last)
        return steps

    def reset_env(self, env: int) -> None:
        """Forget state of a library of one environment that the base class cannot see.

        Called when an environment is first observed and at every reset. A failure is raised, never swallowed.
        """

    # -- help for adapters ---------------------------------------------------------------------------------------------

    def setting(self, name: str, default: _Value) -> _Value:
        """Return a configuration value; null means not given, and the type must be the default's.

        Raises:
            ConfigError: if the value's type differs, for example the string "false" where a flag is expected.
        """
        value = self.config.get(name)
        if value is None:
            return default
        wanted = type(default)
        if wanted is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if default is not None and type(value) is not wanted:
            raise ConfigError(f"{name} must be a {wanted.__name__}, got {value!r} ({type(value).__name__})")
        return cast("_Value", value)

    def rng(self, env: int) -> np.random.Generator:
        """Return the random generator of one environment, seeded by run seed, episode and environment index."""
        return self._known(env).rng

    def memory(self, env: int) -> Memory:
        """Return what is kept of one environment from observation to observation: recurrent state, in `predict`.

        It advances once for each observation that is asked about: not twice if that is asked about again, and not if
        the question fails.
        """
        return self._known(env).memory

    def encodings(self, env: int) -> list[Any]:
        """Return what `encode` makes of the observations that are kept of one environment, oldest first.

        Each is encoded once, when it is first needed; a question does the same.

        Raises:
            PolicyStateError: if the environment is unknown.
        """
        frames = self._known(env).frames
        for frame in frames:
            if not frame.encoded:
                frame.inputs, frame.encoded = self.encode(frame.obs, env), True
        return [frame.inputs for frame in frames]

    # -- the operations of the wire ------------------------------------------------------------------------------------

    def update_obs(self, obs: Observation) -> None:
        """Take in the newest observation of one environment (`env_idx`, 0 if it has none)."""
        index = obs.get(spec.Obs.ENV_IDX)
        self._observe([obs], [0 if index is None else env_index(index)])

    def update_obs_batch(self, obs_list: Sequence[Observation]) -> None:
        """Take in the newest observation of several environments; their order is the batch order."""
        self._observe(obs_list, env_indices(obs_list))

    def get_action(self) -> list[ActionStep]:
        """Return the action chunk of the environment that was observed last.

        Raises:
            PolicyStateError: before an observation, or after a batch of several.
        """
        if self._order is None:
            raise PolicyStateError("get_action needs an observation since the last reset")
        if len(self._order) != 1:
            raise PolicyStateError(f"get_action answers one environment, but the last batch held {self._order}")
        return self.get_action_batch(self._order)[0]

    def get_action_batch(self, env_idx_list: Sequence[int] | None = None) -> list[list[ActionStep]]:
        """Return the action chunks of exactly these environments, in this order.

        Args:
            env_idx_list: environments to answer; None means the last batch, [] is answered by [].

        Raises:
            PolicyStateError: if an environment is unknown or repeated, or nothing was observed.
            ObservationError: if an index is not a non-negative integer.
        """
        if env_idx_list is None:
            if self._order is None:
                raise PolicyStateError("get_action_batch() needs an observation since the last reset")
            env_idx_list = self._order
        envs = [env_index(index) for index in env_idx_list]
        if len(set(envs)) != len(envs):
            raise PolicyStateError(f"an environment is repeated in {envs}")
        states = [self._known(env) for env in envs]
        if not envs:
            return []
        inputs = [self._given(env) for env in envs]
        drawn = [state.rng.bit_generator.state for state in states]
        answered = False
        for state in states:
            state.memory.ask(state.step)
            state.commands.ask(state.step)
        try:
            given: Any = inputs if self.interface is None or self._encodes else self.interface.batch(inputs)
            rows = self._checked(self.predict(given, envs), envs)
            chunks = [self._decoded(raw, state, env) for raw, state, env in zip(rows, states, envs)]
            answered = True
        except BaseException:
            # As if it had not been: a batch that one client spoils is tried again without it.
            for state, before in zip(states, drawn):
                state.rng.bit_generator.state = before
            raise
        finally:
            for state in states:
                state.memory.settle(answered=answered)
                state.commands.settle(answered=answered)
        return chunks

    def reset(self) -> None:
        """Start a new episode in every environment. Calling it again changes nothing."""
        self.reset_envs(list(self._environments))
        self._order = None

    def reset_envs(self, env_idx_list: Sequence[int]) -> None:
        """Start a new episode in these environments only; others go on. What lets several clients share a model."""
        known = [env for env in env_idx_list if self._environments.pop(env, None) is not None]
        if self._order is not None and not self._environments.keys() >= set(self._order):
            self._order = None
        self._episodes.reset(known)
        for env in known:
            self.reset_env(env)

    # -- inside --------------------------------------------------------------------------------------------------------

    @property
    def _encodes(self) -> bool:
        return type(self).encode is not Policy.encode

    def _compiled(self, model_io: Entry | None) -> Interface | None:
        if model_io is None:
            return None
        from xpl.convert import compile_interface

        folders = checkpoint.folders(self.config, self.policy_dir)
        return compile_interface(model_io, self.embodiment, self.action_type, folders, self.chunk)

    def _observe(self, observations: Sequence[Observation], envs: list[int]) -> None:
        for env in envs:
            if env not in self._environments:
                self._environments[env] = self._new_environment(env)
        for env, obs in zip(envs, observations):
            state = self._environments[env]
            state.frames.append(_Frame(obs))
            state.step += 1
        self._order = envs
        self._episodes.observe(envs)

    def _new_environment(self, env: int) -> _Environment:
        self.reset_env(env)
        rng = np.random.default_rng(self._episodes.seeds(self.seed, env))
        kept = self.history if self.interface is None else max(self.history, self.interface.span)
        return _Environment(rng=rng, frames=deque(maxlen=kept))

    def _known(self, env: int) -> _Environment:
        if env not in self._environments:
            known = sorted(self._environments)
            raise PolicyStateError(f"environment {env} has no observation since the last reset; known are {known}")
        return self._environments[env]

    def _given(self, env: int) -> Any:
        encodings = self.encodings(env)
        if self.interface is not None and not self._encodes:
            return encodings  # `Interface.batch` makes a history of them
        if self.history == 1:
            return encodings[-1]
        # A model_io block may keep more of them.
        return [encodings[0]] * (self.history - len(encodings)) + encodings[-self.history :]

    def _checked(self, raw: object, envs: list[int]) -> list[np.ndarray]:
        if isinstance(raw, Mapping) or not hasattr(raw, "__iter__"):
            raise ActionError(f"predict must return (B, H, D) or a list of (H, D), got {type(raw).__name__}")
        rows = [np.asarray(row) if isinstance(row, (list, tuple)) else as_array(row) for row in raw]
        if len(rows) != len(envs):
            raise ActionError(f"predict must return one chunk per environment: expected {len(envs)}, got {len(rows)}")
        for env, row in zip(envs, rows):
            if row.ndim != 2:
                raise ActionError(f"predict must return (H, D) per environment, got shape {row.shape} for {env}")
        return rows

    def _decoded(self, raw: np.ndarray, state: _Environment, env: int) -> list[ActionStep]:
        steps = self.decode(raw, state.frames[-1].obs, env)
        if type(self).decode is not Policy.decode:  # which makes nothing that would not pass
            check_chunk(steps, self.embodiment, self.action_type)
        if self.chunk is not None and len(steps) != self.chunk:
            raise ActionError(f"the manifest declares chunks of {self.chunk} steps, this one has {len(steps)}")
        return steps if self._ensembling is None else self._ensembled(steps, state, self._ensembling)

    def _ensembled(self, steps: list[ActionStep], state: _Environment, decay: float) -> list[ActionStep]:
        """Average a chunk with earlier ones: absolute actions, as `decode` returns, not what the model emits."""
        newest = [pack(step, self.embodiment, self.action_type) for step in steps]
        quaternions = quaternion_columns(self.embodiment, self.action_type)
        averaged = ensemble(state.predictions, newest, state.step, decay, quaternions)
        return decode_rows(averaged, self.embodiment, self.action_type)
