"""The environment of a rollout worker for a task and setting, and its connection to a policy server."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from xpl import Client
from xpl import _spec as sdk
from xpl.client import ClientError
from xpl.simulator.process import EnvLostError, EnvRaisedError
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Config
    from xpl.environment import TaskEnv
    from xpl_cli.evaluation.rollout.backend import RolloutJob

_CONNECT_S, _AGAIN_S = 5.0, 0.2


@dataclass
class RolloutScene:
    """Environment and policy connection of the current task and setting.

    Attributes:
        key: task and setting.
        env: the environment.
        frequency: control rate, Hz.
        camera: records the video; None if there is no camera.
        client: address of a policy server and the connection to it; None if there is none yet.
    """

    key: tuple[str, str]
    env: TaskEnv
    frequency: float
    camera: str | None
    client: tuple[str, Client] | None = field(default=None)


class InfrastructureError(Exception):
    """The infrastructure broke an attempt off."""


def with_short_connect_timeout(config: Config) -> Config:
    """Return a configuration for a client that soon gives up on a server that is lost.

    The process that leads the run starts servers before workers need them, and again when they have ended. A worker
    waits as long as the server may keep the slot of a disconnected client, and a little more.
    """
    timeout = config.get(sdk.Deploy.CLOSE_TIMEOUT_S)
    timeout = sdk.DEPLOY_DEFAULTS[sdk.Deploy.CLOSE_TIMEOUT_S] if timeout is None else timeout
    return {**config, sdk.Deploy.MAX_CONNECT_SECONDS: timeout + _CONNECT_S, sdk.Deploy.CONNECT_RETRY_DELAY_S: _AGAIN_S}


def reset_envs(env: TaskEnv, jobs: Sequence[RolloutJob], num_envs: int) -> None:
    """Reset all environments of a batch; environments without a job get further seeds.

    Raises:
        UserError: the environment refuses a seed.
        InfrastructureError: it raised another error, or is lost.
    """
    seeds = [job.seed for job in jobs]
    beyond = max(seeds) + 1
    try:
        env.reset(seed=[*seeds, *range(beyond, beyond + num_envs - len(seeds))])
    except ValueError as error:
        raise UserError(f"{jobs[0].task}, {jobs[0].setting}, seeds {seeds}: {error}") from None
    except EnvRaisedError as error:
        raise InfrastructureError(f"the environment raised {error}") from None
    except EnvLostError as error:
        raise InfrastructureError(str(error)) from None


def disconnect(scene: RolloutScene) -> None:
    """End the connection of a scene, if it has one."""
    if scene.client is not None:
        with contextlib.suppress(ClientError, OSError):
            scene.client[1].close()
        scene.client = None
