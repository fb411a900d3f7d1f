"""What the lanes of a run are told: what they play, what they keep of it, and how they get at policy servers."""

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
"""Which episodes are kept: those that succeeded, or all that were played to their end."""


@dataclass(frozen=True)
class RecordingConfig:
    """Where episodes are kept as trajectories, and how.

    Attributes:
        folder: of the set, absolute.
        keep: one of `KEEP`.
        images: one of `xpl.trajectory.FORMS`.
        quality: of JPEGs.
        depth: whether depth is kept, too.
        privileged: whether what the simulator tells privileged policies is kept, too; who plays is not told of it more.
    """

    folder: str
    keep: str = ALL
    images: str = trajectory.FORMS[0]
    quality: int = 95
    depth: bool = True
    privileged: bool = False


@dataclass(frozen=True)
class Runtime:
    """In which Python, and how apart, an adapter and an environment run.

    Attributes:
        python, env, gpu: interpreter and device of the adapter, as for `xpl serve`.
        eval_env: Python of the environment, as `interpreter.resolve` takes it; None is env.yml's, or ours.
        isolate: keep the adapter from the network and from writing. Other processes it never sees, if that can be had.
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
        task: of the environment; None where the offline one plays whatever there is.
        embodiment, action_type: its robot, and how that is driven.
        num_envs: environments that are played at once.
        cameras: False for no images, True for images of its own size, or (height, width).
        privileged: whether it tells what a robot does not see.
        setting: of the environment; None leaves it to that.
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
    """What all lanes of a run play; everything in it may travel to another machine.

    Attributes:
        policy: folder of the adapter, whose loop is run where there is no horizon.
        policy_digest: of its own files.
        environment: folder of the environment package.
        environment_digest: of its own files.
        config: the adapter's configuration.
        settings: of the environment; task and setting are those of each job.
        horizon: actions of a chunk that are executed, at most; None leaves the loop to the adapter.
        eval_env: Python of the environment, as `interpreter.resolve` takes it; None is env.yml's, or ours.
        num_envs: environments that a lane plays at once, in one batch.
        env_workers: processes that share them; 0 plays them in the lane's own.
        bounds: what the adapter's loop is kept from.
        demos: where episodes are kept as trajectories, and how; None for not at all.
        instruction: what the policy is told instead of the instruction, one of `run_mode.INSTRUCTIONS`.
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
    demos: RecordingConfig | None = None
    instruction: str | None = None


@dataclass(frozen=True)
class ServerAccess:
    """How a lane gets at policy servers.

    Attributes:
        token: bearer token, where they ask for one.
        is_patient: whether it waits for a server as long as the configuration says, and not only until whoever looks
            after servers must have noticed.
        on_loading: is told while a model loads.
        ca_file: certificate authority for `wss://`, where the system's are not enough.
    """

    token: str | None = None
    is_patient: bool = False
    on_loading: Callable[[Mapping[str, Any]], None] | None = None
    ca_file: Path | None = None
