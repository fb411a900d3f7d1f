"""envs/gymnasium with the libraries that it maps, in a Python of their own: audited, and run over the wire."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.client.interop import build
from tests.support.peer import xpl
from xpl_cli.basics.errors import ExitCode
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers

FOLDER = Path(__file__).resolve().parent
ENV = build.ROOT / "envs" / "gymnasium"
PYTHON = build.interpreter("gymnasium", locks=FOLDER)
MANIFEST = yaml.safe_load((ENV / "env.yml").read_text(encoding="utf-8"))

pytestmark = pytest.mark.skipif(
    PYTHON is None, reason="not run: there is no environment made from gymnasium.lock.txt; `./dev peers` makes it"
)


@pytest.fixture(scope="module")
def player(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the adapter that knows the tasks."""
    folder = tmp_path_factory.mktemp("policy") / "Player"
    chosen = {"name": "Player", "embodiment": "fetch", "action_type": "ee", "chunk": 1, "eval_only": True}
    adapter.write(adapter.render(AdapterAnswers(**{**adapter.defaults(), **chosen})), folder)
    shutil.copy(FOLDER / "player.py", folder / "model.py")
    manifest = yaml.safe_load((folder / "policy.yml").read_text(encoding="utf-8"))
    manifest["inputs"] = {"required": ["privileged", "state.ee_pose"], "optional": ["state.tcp_pose"], "unused": []}
    (folder / "policy.yml").write_text(json.dumps(manifest), encoding="utf-8")  # JSON is YAML
    return folder


def _played(player: Path, task: str, *options: str) -> dict[str, Any]:
    assert PYTHON is not None
    simulator = ("--env", "gymnasium", "--eval-env", f"venv:{PYTHON.parents[1]}", "--task", task)
    done = xpl("eval", str(player), *simulator, *options, "--json", cwd=player)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    report: dict[str, Any] = json.loads(done.stdout)
    return report


@pytest.mark.slow
@pytest.mark.parametrize("task", ["fetch_reach", pytest.param("fetch_pick_and_place", marks=pytest.mark.slow)])
def test_a_policy_solves_a_task_of_gymnasium_robotics_over_the_wire(player: Path, task: str) -> None:
    report = _played(player, task, "--episodes", "2", "--num-envs", "2")
    assert report["success_rate"] == 1.0, report
    assert all(episode["end_reason"] == "success" for episode in report["episodes"])


@pytest.mark.slow
def test_a_policy_pushes_the_t_of_gym_pusht_over_the_wire(player: Path) -> None:
    """Nearly half of the outline is covered at the end, where standing still covers nothing."""
    (episode,) = _played(player, "pusht", "--set", "seed=6")["episodes"]
    assert episode["score"] > 0.4, episode
    assert (episode["success"], episode["end_reason"]) == (False, "max_steps")


@pytest.mark.slow
@pytest.mark.parametrize("task", ["pusht", pytest.param("fetch_reach", marks=pytest.mark.slow)])
def test_the_environment_passes_its_audit(task: str, tmp_path: Path) -> None:
    """Without pictures where they need OpenGL, which a machine may not have."""
    pictures = () if task == "pusht" else ("--set", "cameras=false")
    options = ("--python", str(PYTHON), "--set", f"task={task}", *pictures, "--no-cache", "--json")
    done = xpl("audit", str(ENV), *options, cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stdout


def test_the_lock_has_the_versions_that_the_environment_declares() -> None:
    """What is tested is what `xpl install` makes."""
    locked = (FOLDER / "gymnasium.lock.txt").read_text(encoding="utf-8").lower().splitlines()
    for requirement in MANIFEST["environment"]["requirements"]:
        assert requirement.lower() in locked
