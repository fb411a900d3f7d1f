"""Runs in another manner than the usual one are recorded too: by a foreign server, and several episodes at once."""

from __future__ import annotations

import json
import textwrap
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.adapters import drill
from tests.support.peer import xpl
from tests.support.recordings.runs import planned
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records import records, run_mode
from xpl_cli.evaluation.records.run_mode import RunMode
from xpl_cli.evaluation.rollout.backend import RolloutJob
from xpl_cli.evaluation.rollout.instruction import with_instruction
from xpl_cli.evaluation.statistics.run_differences import find_differences
from xpl_cli.serving.launch import running_server

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

TOKEN = "drill-sergeant-drill-sergeant-drill"
BATCH = """
    def _seen(self, obs_list):
        self.seen = {**getattr(self, "seen", {}), **{obs["env_idx"]: obs for obs in obs_list}}

    def _chunks(self, env_idx_list=None):
        chunks = []
        for env in env_idx_list:
            self.update_obs(self.seen[env])
            self.calls = 0
            chunks.append(self.get_action())
        return chunks

    Model.update_obs_batch, Model.get_action_batch = _seen, _chunks
"""


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Serve the drill's adapter from a separate folder, with a token; return its address."""
    with running_server(drill.adapter(tmp_path_factory.mktemp("elsewhere")), {}, token=TOKEN) as server:
        yield server.url


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """Return a folder with the drill's environment, and a token."""
    drill.environment(tmp_path)
    (tmp_path / "token").write_text(TOKEN)
    (tmp_path / "token").chmod(0o600)
    return tmp_path


def _eval(room: Path, policy: str, *options: str) -> Any:
    return xpl("eval", policy, "--env", "drill", "--out", "run", *options, cwd=room)


def _outcomes(run: records.Run) -> list[tuple[Any, ...]]:
    return [(line.task, line.seed, line.success, line.digest) for line in run.finals.values()]


def test_a_policy_that_is_not_here_is_recorded(room: Path, elsewhere: str) -> None:
    """The announcement of its server replaces its files, and its address is not recorded."""
    done = _eval(room, "Foreign", "--episodes", "4", "--connect", elsewhere, "--token-file", "token")
    assert done.returncode == 0, done.stderr
    run = records.read(room / "run")
    policy = run.plan.policy
    assert (policy.name, policy.checkpoint) == ("Foreign", None)
    mode = run_mode.run_mode_of(run.plan)
    assert mode.announced is not None
    assert mode.announced["policy"]["embodiment"] == "franka_single"
    assert elsewhere not in (room / "run" / records.FILE).read_text()
    assert [line.success for line in run.finals.values()] == [True, True, False, True]


@pytest.mark.slow
def test_such_a_run_is_resumed_with_another_server(room: Path, elsewhere: str) -> None:
    reach = ("--connect", elsewhere, "--token-file", "token")
    done = _eval(room, "Foreign", "--episodes", "3", *reach)
    assert done.returncode == 0, done.stderr
    file = room / "run" / records.FILE
    whole = _outcomes(records.read(room / "run"))
    file.write_text("".join(file.read_text().splitlines(keepends=True)[:-2]))
    lacking = _eval(room, "Foreign", "--resume")
    assert (lacking.returncode, "--connect" in lacking.stderr) == (ExitCode.NOT_FOUND, False)
    resumed = _eval(room, "Foreign", "--resume", *reach)
    assert resumed.returncode == 0, resumed.stderr
    assert _outcomes(records.read(room / "run")) == whole


@pytest.mark.slow
def test_a_batch_is_recorded_with_its_size(room: Path) -> None:
    """Also where a task ends in the middle of one; each episode has its own line, and the batch its time once."""
    policy = drill.adapter(room)
    model = policy / "model.py"
    model.write_text(model.read_text() + textwrap.dedent(BATCH))
    options = ("--task", "all", "--episodes", "3", "--horizon", "2")
    done = _eval(room, "Drilled", *options, "--num-envs", "2", "--workers", "2")
    assert done.returncode == 0, done.stderr
    run = records.read(room / "run")
    assert run_mode.run_mode_of(run.plan) == RunMode(num_envs=2)
    assert [line.success for line in run.finals.values()] == [True, True, False] * 2
    assert sum(line.inference is not None for line in run.finals.values()) == 4
    assert not any(line.trace or line.film for line in run.finals.values())
    alone = xpl("eval", "Drilled", "--env", "drill", "--out", "alone", *options, cwd=room)
    assert alone.returncode == 0, alone.stderr
    assert [str(one) for one in find_differences(run, records.read(room / "alone"))] == [
        "episodes at once: 2 against 1"
    ]
    refused = xpl("submit", "Drilled", "run", "--check", cwd=room)
    assert refused.returncode != 0
    assert "in batches of 2" in refused.stderr


def test_a_policy_gets_the_instruction_of_another_episode(room: Path) -> None:
    """The drill's adapter fails at seed 1: with swapped instructions that is the episode before it."""
    drill.adapter(room, raises=[1])
    done = _eval(room, "Drilled", "--episodes", "2", "--instruction", "swap")
    assert done.returncode == 0, done.stderr
    run = records.read(room / "run")
    assert run_mode.run_mode_of(run.plan) == RunMode(instruction=run_mode.SWAP)
    assert [(line.seed, line.failure) for line in run.finals.values()] == [(0, "policy"), (1, None)]
    # Whoever sees the figures sees that they are not the policy's own.
    assert "The policy was given the instruction of another episode" in done.stdout


@pytest.mark.parametrize(
    ("instead", "instructions"),
    [(run_mode.BLANK, ["", ""]), (run_mode.SWAP, ["lift the blue one", "lift the red one"])],
)
def test_other_words_depend_on_the_seed_alone(instead: str, instructions: list[str]) -> None:
    """Each episode gets the instruction of the next one with another instruction; all else stays the same."""
    env = _Told(["lift the red one", "lift the red one", "lift the blue one", "lift the red one"])
    other = with_instruction(
        env, instead, [RolloutJob(0, 1, "pick", "clean", 1), RolloutJob(1, 1, "pick", "clean", 2)], 2
    )
    env.reset([1, 2])
    assert [obs["instruction"] for obs in other.get_obs_batch()] == instructions
    assert [obs["state"] for obs in other.get_obs_batch([1])] == [2]
    assert other.get_obs_batch([1])[0]["instruction"] == instructions[1]
    assert "instructions" not in other.get_obs_batch([1])[0]


def test_equal_instructions_are_not_swapped() -> None:
    with pytest.raises(UserError, match=r"pick, clean: the next 30 seeds have the same instruction"):
        with_instruction(_Told(["lift it"]), run_mode.SWAP, [RolloutJob(0, 1, "pick", "clean", 1)], 1)


class _Told:
    """An environment whose instructions come by the seed."""

    def __init__(self, texts: list[str]) -> None:
        self.texts, self.seeds = texts, [0]

    def reset(self, seed: list[int]) -> None:
        self.seeds = seed

    def get_running_env_idx_list(self) -> list[int]:
        return list(range(len(self.seeds)))

    def get_obs_batch(self, env_idx_list: list[int] | None = None, _last: bool = False) -> list[dict[str, Any]]:
        return [self._seen(self.seeds[env]) for env in env_idx_list or self.get_running_env_idx_list()]

    def _seen(self, seed: int) -> dict[str, Any]:
        text = self.texts[seed % len(self.texts)]
        return {"state": seed, "instruction": text, "instructions": [text]}


def test_a_manner_reads_what_it_wrote() -> None:
    """Invalid values count as the usual mode; adapters receive none of it."""
    foreign = RunMode(announced={"policy": {"name": "x"}})
    for how in (RunMode(), RunMode(3), RunMode(2, {"policy": {}}), foreign, RunMode(instruction=run_mode.BLANK)):
        config = how.add_to({"seed": 1})
        assert run_mode.run_mode_of(planned(json.loads(json.dumps(config)))) == how
        assert run_mode.without_run_mode(config) == {"seed": 1}
    for odd in (1, {"num_envs": True}, {"num_envs": "4"}, {"num_envs": 0}, {"announced": []}, {"instruction": "?"}):
        assert run_mode.run_mode_of(planned({"xpl.run": odd})) == RunMode()
