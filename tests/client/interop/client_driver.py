"""Drives our own client in an interpreter with other versions of what it needs.

Runs in the peers' interpreter, with the checkout's SDK on its path, started by the tests; `lines` says how they talk.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from importlib import metadata
from typing import Any

import numpy as np
from lines import answer, hear, tell

from xpl.client import AsyncClient, Client

IMAGE = (24, 32, 3)


class Awaited:
    def __init__(self, url: str, config: dict[str, Any]) -> None:
        self.loop = asyncio.new_event_loop()
        self.client = AsyncClient(url, config=config)
        self.connect()

    @property
    def server_instance_id(self) -> str | None:
        return self.client.server_instance_id

    def __getattr__(self, operation: str) -> Callable[..., Any]:
        return lambda *arguments: self.loop.run_until_complete(getattr(self.client, operation)(*arguments))


CLIENTS = {"Client": Client, "AsyncClient": Awaited}


class Session:
    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)

    def versions(self) -> dict[str, str]:
        return {name: metadata.version(name) for name in ("websockets", "msgpack", "numpy")}

    def open(self, kind: str, url: str, **config: Any) -> str | None:
        self.client = CLIENTS[kind](url, config=config)
        return self.client.server_instance_id

    def observation(self, env: int) -> dict[str, Any]:
        return {
            "env_idx": env,
            "vision": {"cam_head": {"color": self.rng.integers(0, 256, IMAGE, dtype=np.uint8)}},
            "state": {
                "arm_joint_state": self.rng.uniform(-1, 1, 7).astype(np.float32),
                "ee_joint_state": self.rng.uniform(0, 1, 1).astype(np.float32),
            },
        }

    def play(self, episodes: int, steps: int, envs: int, pause: list[int] | None = None) -> int:
        """Play episodes of a policy that answers with the state it saw; return how many actions came.

        Args:
            episodes: how many.
            steps: questions in each.
            envs: environments; one is asked by observation, several as a batch.
            pause: episode and step before which the test is told and waited for.
        """
        checked = 0
        for episode, step in itertools.product(range(episodes), range(steps)):
            if pause == [episode, step]:
                tell({"paused": pause})
                hear()
            if step == 0:
                self.client.reset()
            seen = [self.observation(env) for env in range(envs)]
            if envs == 1:
                self.client.update_obs(seen[0])
                chunks = [self.client.get_action()]
            else:
                self.client.update_obs_batch(seen)
                chunks = self.client.get_action_batch(list(range(envs)))
            for obs, chunk in zip(seen, chunks, strict=True):
                for action, key in itertools.product(chunk, ("arm_joint_state", "ee_joint_state")):
                    np.testing.assert_array_equal(action[key], obs["state"][key])
                checked += len(chunk)
        return checked

    def infer(self) -> int:
        return len(self.client.infer(self.observation(0)))

    def call(self, func_name: str) -> Any:
        return self.client.call(func_name)

    def heartbeat(self) -> None:
        self.client.heartbeat()

    def close(self) -> None:
        self.client.close()


if __name__ == "__main__":
    session = Session()
    names = ("versions", "open", "play", "infer", "call", "heartbeat", "close")
    answer({name: getattr(session, name) for name in names})
