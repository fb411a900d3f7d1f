"""Loops across the border: ours in the ecosystem's debug client, the field's in our environments."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.checkout import ROOT
from tests.support.outside.debug_client import LIMIT, DebugEnv, NeverEndsError, checkout
from tests.support.peer import DEADLINE_S
from xpl import rollout
from xpl_cli.basics.content import content_folder, load_module
from xpl_cli.packages import environments
from xpl_cli.serving.launch import running_server
from xpl_cli.standard import spec

CHUNK = 4
FUNCTIONS = tuple(spec.data("package")["loop"]["functions"])
OURS = ROOT / "policy" / "demo_policy" / "deploy.py"
THEIRS = content_folder("templates") / "loop" / "deploy.py"
PUBLIC = checkout()


class Still:
    def __init__(self) -> None:
        self.asked: list[str] = []
        self._seen: dict[int, Any] = {}
        self._order: list[int] = []

    def call(self, func_name: str, obs: Any = None) -> Any:
        self.asked.append(func_name)
        if func_name.startswith("update_obs"):
            batch = obs if isinstance(obs, list) else [obs]
            self._order = [one.get("env_idx", 0) for one in batch]
            self._seen.update(zip(self._order, batch, strict=True))
            return None
        if func_name.startswith("get_action"):
            chunks = [[self._pose(env)] * CHUNK for env in (self._order if obs is None else obs)]
            return chunks if func_name.endswith("batch") else chunks[0]
        assert func_name == "reset", func_name
        return None

    def _pose(self, env: int) -> dict[str, Any]:
        state = self._seen[env]["state"]
        return {name: value for name, value in state.items() if name.endswith(("arm_joint_state", "ee_joint_state"))}


# -- in the debug client -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file", [OURS, THEIRS], ids=["scaffold", "contract"])
@pytest.mark.parametrize("function", FUNCTIONS)
def test_a_loop_ends_where_only_is_episode_end_tells(file: Path, function: str) -> None:
    env = DebugEnv()
    getattr(load_module(file), function)(env, Still())
    assert env.steps == LIMIT


@pytest.mark.parametrize("run", [rollout.run_episode, rollout.run_batch])
def test_the_sdks_own_loop_ends_there_too(run: Any) -> None:
    for horizon in (None, 3):
        env = DebugEnv()
        run(env, Still(), horizon=horizon)
        assert env.steps == LIMIT


def test_a_loop_that_asks_the_list_alone_does_not_end_there() -> None:
    """The list of running environments stays whole in the debug client; only `is_episode_end` tells the end."""
    with pytest.raises(NeverEndsError):
        _run_by_the_list(DebugEnv(), Still())


def _run_by_the_list(env: DebugEnv, policy: Still) -> None:
    while running := env.get_running_env_idx_list():
        policy.call("update_obs_batch", env.get_obs_batch(running))
        for step in zip(*policy.call("get_action_batch", running), strict=True):
            env.take_action_batch(list(step), running)


@pytest.mark.slow
@pytest.mark.parametrize("batch", [False, True])
def test_the_scaffolds_loop_ends_in_the_public_debug_client(tmp_path: Path, *, batch: bool) -> None:
    """Its own process, its own WebSocket client, our server: two episodes of five steps each."""
    if PUBLIC is None:
        pytest.skip("no checkout of XPolicyLab: name one in XPL_PUBLIC_CHECKOUT")
    python = os.environ.get("XPL_PUBLIC_PYTHON", sys.executable)
    needs = [python, "-c", "import cv2, msgpack, msgpack_numpy, websockets, yaml"]
    if subprocess.run(needs, capture_output=True, check=False).returncode:
        pytest.skip("the debug client's own packages are not here: name a Python that has them in XPL_PUBLIC_PYTHON")
    tree = tmp_path / "XPolicyLab"
    # A copy, for it looks for the benchmark in the folder above the one where its files really are.
    shutil.copytree(PUBLIC, tree, ignore=shutil.ignore_patterns("policy", ".git", "assets"))
    robots = tmp_path / "env_cfg" / "robot"
    robots.mkdir(parents=True)
    (robots.parent / "arx_x5.yml").write_text("config: {robot: dual_x5}")
    (robots / "_robot_info.json").write_text('{"dual_x5": {"arm_dim": [6, 6], "ee_dim": [1, 1]}}')
    (tree / "policy").mkdir()
    (tree / "policy" / "__init__.py").touch()
    (tree / "policy" / "demo_policy").symlink_to(OURS.parent)
    (tmp_path / "h5py.py").touch()  # a module that its tools import, and the client does not use
    with running_server(OURS.parent, {}) as server:
        port = server.url.rsplit(":", 1)[1].strip("/")
        words = ["debug_env_client.py", "--bench_name", "RoboDojo", "--task_name", "stack_bowls"]
        words += ["--env_cfg_type", "arx_x5", "--policy_name", "demo_policy", "--port", port, "--host", "127.0.0.1"]
        words += ["--eval_episode_num", "2", "--eval_batch", str(batch)]
        path = os.pathsep.join([str(tmp_path), str(tree), str(ROOT)])
        done = subprocess.run(
            [python, *words],
            cwd=tree,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            timeout=DEADLINE_S,
            check=False,
        )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("Action Step:") == 2 * LIMIT
    assert done.stdout.count("Episode finished") == 2


# -- in our environments -----------------------------------------------------------------------------------------------


def _theirs() -> list[Any]:
    """Return the loops of the field: the contract's, and those of the public adapters A to O and of demo_policy."""
    found = [pytest.param(THEIRS, id="contract")]
    for folder in sorted(PUBLIC.glob("policy/*")) if PUBLIC else ():
        is_open = folder.name == "demo_policy" or "A" <= folder.name[0] <= "O"
        if is_open and (folder / "deploy.py").is_file() and _uses_the_wire_only(folder / "deploy.py"):
            found.append(pytest.param(folder / "deploy.py", id=folder.name))
    return found


def _uses_the_wire_only(file: Path) -> bool:
    """Tell whether a loop needs no operation, argument or library of its own; it is only parsed for that."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.keywords]
    asked = [{one.arg: one.value for one in call.keywords} for call in calls]
    asked = [given for given in asked if "func_name" in given]
    named = {name.value for given in asked if isinstance(name := given["func_name"], ast.Constant)}
    given_too = {name for given in asked for name in given} - {"func_name", "obs"}
    imported = {
        alias.name.partition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for alias in node.names
    }
    known = {"reset", "update_obs", "update_obs_batch", "get_action", "get_action_batch"}
    return not given_too and named <= known and imported <= set(sys.stdlib_module_names)


@pytest.mark.parametrize("file", _theirs())
@pytest.mark.parametrize("count", [1, 3])
def test_a_loop_of_the_field_plays_our_environments_to_their_end(file: Path, count: int) -> None:
    config = {"embodiment": "arx_x5", "action_type": "joint", "num_envs": count, "max_steps": 7, "cameras": (48, 64)}
    env = environments.make("offline", {**config, "task": "echo"})
    env.reset(list(range(count)))
    policy = Still()
    module = load_module(file)
    getattr(module, FUNCTIONS[count > 1])(env, policy)
    assert env.is_episode_end()
    assert [result["steps"] for result in env.results()] == [7] * count
    assert policy.asked[0] == "reset"
