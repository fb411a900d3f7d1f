"""Configuration of rollout workers: what they run and record, and how they reach policy servers."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final

from xpl import trajectory
from xpl_cli.isolation.isolation_settings import IsolationSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from xpl.contract import Config

SUCCESS, ALL = "success", "all"
KEEP: Final = (SUCCESS, ALL)
"""Which episodes are saved: the successful ones, or all that ran to their end."""


@dataclass(frozen=True)
class RecordingConfig:
    """Where and how episodes are saved as trajectories.

    Attributes:
        folder: of the set, absolute.
        keep: one of `KEEP`.
        images: one of `xpl.trajectory.FORMS`.
        quality: of JPEGs.
        depth: whether to save depth.
        privileged: whether to save the simulator's privileged observations; the policy does not receive more for that.
    """

    folder: str
    keep: str = ALL
    images: str = trajectory.FORMS[0]
    quality: int = 95
    depth: bool = True
    privileged: bool = False


@dataclass(frozen=True)
class Runtime:
    """Python environments and isolation of adapter and environment.

    Attributes:
        python, env, gpu: interpreter and device of the adapter, as for `xpl serve`.
        eval_env: Python of the environment, as `interpreter.resolve` takes it; None for that of env.yml, or ours.
        isolate: keep the adapter from the network and from writing. If the system can, it never sees other processes.
    """

    python: str | None = None
    env: str | None = None
    gpu: str | None = None
    eval_env: str | None = None
    isolate: bool = False


@dataclass(frozen=True)
class EnvSettings:
    """How an environment is configured for an adapter.

    Attributes:
        task: of the environment; None in the offline environment, which has a single script.
        embodiment, action_type: its robot, and "joint" or "ee".
        num_envs: environments in one batch.
        cameras: False for no images, True for images of its own size, or (height, width).
        privileged: whether observations hold privileged values.
        setting: of the environment; None for its default.
    """

    task: str | None
    embodiment: str
    action_type: str
    num_envs: int = 1
    cameras: bool | tuple[int, int] = True
    privileged: bool = False
    setting: str | None = None

    def as_config(self) -> Config:
        """Return the configuration that an environment is made with."""
        config = asdict(self)
        if self.setting is None:
            del config["setting"]
        return config


@dataclass(frozen=True)
class RolloutConfig:
    """What all rollout workers of a run execute; picklable, for other machines.

    Attributes:
        policy: folder of the adapter, whose evaluation loop runs if there is no horizon.
        policy_digest: of its own files.
        environment: folder of the environment package.
        environment_digest: of its own files.
        config: the adapter's configuration.
        settings: of the environment; task and setting are those of each job.
        horizon: execution horizon, at most; None leaves it to the adapter's loop.
        eval_env: Python of the environment, as `interpreter.resolve` takes it; None for that of env.yml, or ours.
        num_envs: environments that a worker runs in one batch.
        env_workers: processes that share them; 0 runs them in the worker's own.
        bounds: isolation of the adapter's loop.
        recording: where and how episodes are saved as trajectories; None for not at all.
        instruction: what the policy gets instead of the instruction, one of `run_mode.INSTRUCTIONS`.
    """

    policy: str
    policy_digest: str
    environment: str
    environment_digest: str
    config: Config
    settings: EnvSettings
    horizon: int | None = None
    eval_env: str | None = None
    num_envs: int = 1
    env_workers: int = 1
    bounds: IsolationSettings = field(default_factory=IsolationSettings)
    recording: RecordingConfig | None = None
    instruction: str | None = None


@dataclass(frozen=True)
class ServerAccess:
    """How a rollout worker reaches a policy server.

    Attributes:
        token: bearer token, if the server requires one.
        is_patient: whether it waits for a server as long as the configuration says, instead of only until the process
            that manages the servers must have noticed.
        on_loading: called while a model loads.
        ca_file: certificate authority for `wss://`, in addition to the system's.
    """

    token: str | None = None
    is_patient: bool = False
    on_loading: Callable[[Mapping[str, Any]], None] | None = None
    ca_file: Path | None = None
