"""Parts of a session are asked as the whole session was."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np

from xpl.catalogue import Mistake
from xpl_cli.audit.offline.search.perturbed_adapter import PerturbedAdapter
from xpl_cli.audit.offline.search.session_replay import SessionReplay
from xpl_cli.model_io.pairs import PairSession
from xpl_cli.model_io.script import full_script, with_episode_numbers

CALLS = full_script(1)
ANSWERS: Any = tuple(tuple({} for _ in call.ask) for call in CALLS if call.ask)
SESSION = PairSession("piper_single", "joint", 0, {"cam_head": (24, 32)}, 1, CALLS, ANSWERS)
UNCHANGED = Mistake(0, "", "camera", change_observations=lambda seen: [{**obs, "told": len(seen)} for obs in seen])


def test_episodes_that_are_passed_are_begun() -> None:
    """What is drawn depends on the number of the episode, so that each shows something."""
    replay = SessionReplay(SESSION)
    last = SESSION.questions[-1]
    calls = replay.calls_for([last.number])
    numbers = [(call, episode) for call, episode in with_episode_numbers(calls) if call.ask]
    assert {episode for _, episode in numbers} == {last.episode} == {2}
    shown = [episode for call, episode in with_episode_numbers(calls) if call.show]
    assert shown.count(0) == shown.count(1) == 1
    assert len(replay.calls_for([0])) < len(calls)


class Client:
    """Says what was done."""

    def __init__(self) -> None:
        self.done: list[Any] = []

    def reset(self) -> None:
        """Begin."""
        self.done.append("reset")

    def update_obs(self, obs: Any) -> None:
        """Take one."""
        self.update_obs_batch([obs])

    def update_obs_batch(self, observations: Any) -> None:
        """Take several."""
        self.done.append([obs["env_idx"] for obs in observations])
        self.done.append(all("told" in obs for obs in observations))

    def get_action(self) -> Any:
        """Answer one."""
        return self.get_action_batch([0])[0]

    def get_action_batch(self, envs: Any) -> Any:
        """Answer several."""
        self.done.append(tuple(envs))
        step = {"arm_joint_state": np.zeros(6, np.float32), "ee_joint_state": np.full(1, 0.5, np.float32)}
        return [[step] for _ in envs]


def test_all_environments_are_played_together() -> None:
    """With what is shown instead, in the session's own calls, by a client that was just connected."""
    replay, clients = SessionReplay(SESSION), list[Client]()

    def connect() -> Any:
        clients.append(Client())
        return contextlib.nullcontext(clients[-1])

    with PerturbedAdapter(replay, {}, connect, once=False, together=True) as around:
        for _ in range(2):
            answers = around.answers(UNCHANGED, replay.all_questions)
        assert answers is not None
        assert list(answers) == replay.all_questions
        assert around.answers(UNCHANGED, [0]) is not None
    assert len(clients) == 2  # equal plays are one
    numbers = [one for one in clients[0].done if isinstance(one, tuple)]
    assert [len(one) for one in numbers] == [len(call.ask) for call in SESSION.calls if call.ask]
    assert clients[0].done.count("reset") == 3
    assert False not in clients[1].done
