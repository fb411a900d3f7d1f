"""The actors of a Ray cluster, in this process: they run jobs, and refuse what is not of the run."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import xpl_cli
from tests.support.adapters import drill
from tests.support.peer import xpl
from xpl_cli.basics.errors import ExitCode
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.rollout.backend import RolloutJob, RolloutResult
from xpl_cli.evaluation.rollout.config import Runtime
from xpl_cli.evaluation.rollout.ray_actors import ActorInfo, Refusal, RolloutActor
from xpl_cli.evaluation.runs import evaluate, plan
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.packages import package

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.evaluation.rollout.config import RolloutConfig
    from xpl_cli.evaluation.rollout.servers import ServerConfig

JOB = RolloutJob(0, 1, "hold", "clean", 0)


@pytest.fixture
def configs(tmp_path: Path) -> tuple[RolloutConfig, ServerConfig]:
    """Return the configurations of workers and servers of a run."""
    environment, adapter = drill.environment(tmp_path), package.load(drill.adapter(tmp_path))
    line = plan.make_plan(adapter, environment, adapter.config({}), plan.PlanRequest()).plan
    return evaluate.make_configs(adapter, environment, line, Runtime(), IsolationSettings())


@pytest.fixture
def player(configs: tuple[RolloutConfig, ServerConfig]) -> Iterator[RolloutActor]:
    """Return a worker with a server of its own; both are ended, as Ray would by ending its process."""
    player = RolloutActor(xpl_cli.__version__, *configs, number=3, token=None)
    yield player
    if player._rollout_worker is not None:
        player._rollout_worker.close()
    if player._server is not None:
        player._server.suspect()


@pytest.mark.slow
def test_a_lane_with_a_server_of_its_own_plays_and_starts_it_again(player: RolloutActor, tmp_path: Path) -> None:
    """An attempt in which the policy's process ended has a result; the next one gets a new server."""
    post = player.ready()
    assert isinstance(post, ActorInfo)
    assert post.worker.endswith("/3")
    assert player.ready() == post
    drill.mark(tmp_path, "policy-dies-0", 0)
    outcome = _played(player)
    assert outcome.outcome.success
    assert outcome.facts == post.facts
    assert outcome.trace is not None
    drill.mark(tmp_path, "policy-dies-0", 1)
    assert _played(player).outcome.end_reason == "policy_died"
    again = _played(player)
    assert again.outcome.digest == outcome.outcome.digest
    assert again.execution.server != outcome.execution.server


def _played(player: RolloutActor) -> RolloutResult:
    outcome = player.run_job(JOB, None)
    assert isinstance(outcome, RolloutResult)
    return outcome


@pytest.mark.parametrize("what", ["version", "adapter", "environment", "checkpoint"])
def test_a_machine_with_something_else_is_refused(configs: tuple[RolloutConfig, ServerConfig], what: str) -> None:
    """Whatever an episode's outcome follows from must be what the run was planned with."""
    rollout_config, server = configs
    version = xpl_cli.__version__
    if what == "version":
        version = "0.0.0"
    elif what == "adapter":
        (Path(rollout_config.policy) / "model.py").write_text("Model = None", encoding="utf-8")
    elif what == "environment":
        rollout_config = replace(rollout_config, environment=str(Path(rollout_config.environment).parent / "nowhere"))
    else:
        server = replace(server, checkpoint_digest="0" * 64)
    refusal = RolloutActor(version, rollout_config, server, 0, None).ready()
    assert isinstance(refusal, Refusal)
    assert refusal.error().code == ExitCode.NOT_RUN
    assert what in refusal.message or what == "version"


@pytest.mark.skipif(find_spec("ray") is not None, reason="Ray is installed")
def test_without_ray_the_error_has_the_install_command(
    configs: tuple[RolloutConfig, ServerConfig], tmp_path: Path
) -> None:
    done = xpl("eval", "Drilled", "--env", "drill", "--out", "run", "--backend", "ray", cwd=tmp_path)
    assert done.returncode == ExitCode.NOT_RUN
    assert "pip install 'ray" in done.stderr
    assert not records.read(tmp_path / "run").attempts
