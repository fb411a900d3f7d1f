"""Hand-over: a launcher is called with what the standard names, and its result becomes a record like any other."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from tests.support.checkout import ROOT
from tests.support.commands import problem, xpl
from xpl.manifest import EnvManifest
from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.hand_over import results
from xpl_cli.evaluation.hand_over.launcher import Launcher, LauncherError, fill_placeholders
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.records.model import PlannedCell
from xpl_cli.packages import environments
from xpl_cli.standard.validate import validate

POLICY = ROOT / "policy" / "demo_policy"
NOWHERE = ["--connect", "ws://localhost:9"]
DETAILS = {
    "0": {"layout_id": 0, "success": True, "score": 1.0},
    "1": {"layout_id": 3, "success": False, "score": 0.15},
}
SCRIPT = """#!/usr/bin/env bash
set -eu
printf '%s\\n' "$ROBODOJO_RUN_ID" "$EVAL_NUM" "$@" > {told}
if [[ -f {fails} ]]; then exit 99; fi
while (($#)); do declare "${{1#--}}=$2"; shift 2; done
cd "$root_dir"
folder="eval_result/RoboDojo/$task_name/$policy_name/$env_cfg_type/${{seed}}_$additional_info/$ROBODOJO_RUN_ID"
mkdir -p "$folder"
cp {result} "$folder/_result.json"
"""


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A folder with the files that the hand-over needs; its launcher logs its arguments and copies a result."""
    folder = tmp_path / "RoboDojo"
    files = ["src/eval_client/main.py", "env_cfg/arx_x5.yml", "XPolicyLab/policy/demo_policy/deploy.py"]
    files += ["task/RoboDojo/config/stack_bowls.yml", "task/RoboDojo/config/stack_bowls_random.yml"]
    for name in files:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    (folder / "scripts").mkdir()
    names = {"told": folder / "told", "fails": folder / "fails", "result": folder / "result.json"}
    (folder / "scripts" / "eval_policy.sh").write_text(SCRIPT.format(**names))
    result = {"success_rate": 0.5, "eval_time": 2, "score": 57.5, "details": DETAILS}
    (folder / "result.json").write_text(json.dumps(result))
    return folder


def _call(*words: str | Path) -> Any:
    return xpl("env", "hand-over", "robodojo", POLICY, "--task", "stack_bowls", *NOWHERE, *words)


def test_the_launcher_is_called_as_the_ecosystem_calls_it(workspace: Path) -> None:
    """Word for word, in pairs, with the number of episodes and the run's name in its environment."""
    ended = _call("--workspace", workspace, "--episodes", "2", "--seed", "1", "--env-gpu", "3", "--json")
    assert ended.code == 0, ended.stderr
    run_id, count, *words = (workspace / "told").read_text().splitlines()
    answer = json.loads(ended.stdout)
    assert (run_id, count) == (answer["run_id"], "2")
    pairs = dict(zip(words[::2], words[1::2], strict=True))
    assert pairs == {
        "--bench_name": "RoboDojo",
        "--task_name": "stack_bowls",
        "--env_cfg_type": "arx_x5",
        "--policy_name": "demo_policy",
        "--host": "localhost",
        "--port": "9",
        "--protocol": "ws",
        "--eval_batch": "false",
        "--root_dir": str(workspace),
        "--device_id": "3",
        "--additional_info": "ckpt_name=default,action_type=joint",
        "--seed": "1",
    }
    assert (answer["episodes"], answer["successes"], answer["success_rate"]) == (2, 1, 0.5)
    assert answer["mean_score"] == pytest.approx(0.575)
    assert answer["rehearsal"] is False


@pytest.mark.parametrize(("task", "setting"), [("stack_bowls", "clean"), ("stack_bowls_random", "randomized")])
def test_what_it_found_is_recorded(workspace: Path, tmp_path: Path, task: str, setting: str) -> None:
    """Layouts are seeds, scores are scores; reports and rankings read it as they read any record."""
    out = tmp_path / "run"
    ended = _call("--workspace", workspace, "--out", out, "--task", task)
    assert ended.code == 0, ended.stderr
    run = records.read(out)
    assert run.plan.cells == [PlannedCell("stack_bowls", setting, "generalisation", [0, 3], frozen=True)]
    lines = run.finals.values()
    assert [(line.seed, line.success, line.score, line.failure) for line in lines] == [
        (0, True, 1.0, None),
        (3, False, 0.15, "task"),
    ]
    assert next(iter(run.machines.values()))["launcher"].endswith("scripts/eval_policy.sh")
    ranked = xpl("leaderboard", out, "--json")
    assert ranked.code == 0, ranked.stderr
    ranking = json.loads(ranked.stdout)
    assert ranking["rows"][0]["success_rate"] == 0.5
    assert any("a benchmark's own launcher ran and judged it" in note for note in ranking["notes"])
    assert "holds a recorded run" in _call("--workspace", workspace, "--out", out).stderr


def test_a_run_that_broke_off_goes_on_under_its_name(workspace: Path, tmp_path: Path) -> None:
    """RoboDojo finds its earlier episodes by that name."""
    out = tmp_path / "run"
    (workspace / "fails").touch()
    ended = _call("--workspace", workspace, "--out", out)
    assert ended.code == 4
    assert "exit code 99" in ended.stderr
    before = (workspace / "told").read_text().splitlines()[0]
    assert "--resume" in _call("--workspace", workspace, "--out", out).stderr
    (workspace / "fails").unlink()
    assert _call("--workspace", workspace, "--out", out, "--resume").code == 0
    assert (workspace / "told").read_text().splitlines()[0] == before
    assert len(records.read(out).finals) == 2


def test_the_environment_names_a_workspace_too_and_a_dry_run_starts_nothing(
    workspace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROBODOJO_ROOT", raising=False)
    assert _call("--dry-run").code == 3
    monkeypatch.setenv("ROBODOJO_ROOT", str(workspace))
    ended = _call("--dry-run")
    assert ended.code == 0, ended.stderr
    assert f"bash {workspace}/scripts/eval_policy.sh --bench_name RoboDojo" in ended.stdout
    assert not (workspace / "told").exists()


@pytest.mark.parametrize("missing", ["scripts/eval_policy.sh", "XPolicyLab/policy/demo_policy/deploy.py"])
def test_a_folder_that_is_no_workspace_is_reported(workspace: Path, missing: str) -> None:
    (workspace / missing).unlink()
    ended = _call("--workspace", workspace)
    assert ended.code == 3
    assert problem(ended) is None
    assert missing in ended.stderr
    assert ("link" in ended.stderr) == ("demo_policy" in missing)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("name", "task", "robot"),
    [("robodojo", "stack_bowls", "arx_x5"), ("robotwin", "stack_blocks_two", "aloha_agilex")],
)
def test_a_rehearsal_runs_the_mock_and_gives_no_numbers(name: str, task: str, robot: str) -> None:
    """Server, client and the benchmark's own loop, in processes of their own."""
    words = ["--task", task, "--set", f"env_cfg_type={robot}", "--rehearse", "--episodes", "2", "--json"]
    ended = xpl("env", "hand-over", name, POLICY, *words)
    assert ended.code == 0, ended.stderr
    answer = json.loads(ended.stdout)
    assert answer["rehearsal"] is True
    assert answer["success_rate"] is answer["mean_score"] is answer["result"] is None


WRONG = {
    "no details": "{}",
    "a layout twice": {"0": DETAILS["0"], "1": DETAILS["0"]},
    "a layout that is a text": {"0": {"layout_id": "0", "success": True, "score": 1.0}},
    "success with nothing": {"0": {"layout_id": 0, "success": True, "score": 0}},
    "no score": {"0": {"layout_id": 0, "success": True}},
    "a rate that contradicts its layouts": json.dumps({"success_rate": 0.9, "details": DETAILS}),
}


@pytest.mark.parametrize("content", WRONG.values(), ids=WRONG)
def test_a_result_that_cannot_be_relied_on_is_refused(tmp_path: Path, content: Any) -> None:
    file = tmp_path / "_result.json"
    file.write_text(content if isinstance(content, str) else json.dumps({"details": content}))
    with pytest.raises(UserError, match="_result"):
        results.layouts(file)


@pytest.mark.parametrize(("text", "value"), [("Timestamp: x\n\nInstruction Type: seen\n\n0.37", 0.37), ("1.0\n", 1.0)])
def test_the_plain_number_of_robotwin_is_read(tmp_path: Path, text: str, value: float) -> None:
    """It is the last line, whatever the other lines are."""
    (tmp_path / "_result.txt").write_text(text)
    assert results.rate(tmp_path / "_result.txt") == value


@pytest.mark.parametrize("text", ["", "success", "nan", "1.5", "-0.1"])
def test_what_is_no_rate_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "_result.txt").write_text(text)
    with pytest.raises(UserError):
        results.rate(tmp_path / "_result.txt")


def test_a_launcher_is_data_and_held_to_its_names() -> None:
    """Unknown names, forms and keys are reported; a value is never substituted again, and no shell reads it."""
    facts = environments.manifest(ROOT / "envs" / "robodojo")
    Launcher.read(facts)
    changes: list[tuple[dict[str, Any], bool]] = [
        ({"command": ["bash", "{nothing}"]}, True),
        ({"command": "bash eval.sh"}, False),
        ({"result": {"form": "guess", "file": "x"}}, False),
        ({"result": {"form": "layouts", "file": "../x"}}, True),
        ({"shell": True}, False),
        ({"workspace": {"variable": "X"}}, False),
    ]
    for change, is_valid in changes:
        data = {**facts.data, "hand_over": {**facts.data["hand_over"], **change}}
        assert (not validate(data, "env")) == is_valid
        if is_valid or "workspace" in change:  # what is missing may be so in a manifest that is read
            with pytest.raises(LauncherError):
                Launcher.read(EnvManifest.parse(data))
    assert fill_placeholders("{a} {b}", {"a": "{b}", "b": "$(x)"}) == "{b} $(x)"
    with pytest.raises(LauncherError, match="hands nothing over"):
        Launcher.read(environments.manifest(ROOT / "envs" / "mujoco"))


def test_the_launcher_runs_in_the_python_that_is_named(workspace: Path, tmp_path: Path) -> None:
    home = tmp_path / "sim" / "bin"
    home.mkdir(parents=True)
    (home / "python").symlink_to(os.sys.executable)  # type: ignore[attr-defined]
    script = workspace / "scripts" / "eval_policy.sh"
    script.write_text(script.read_text().replace("set -eu", f'set -eu\ncommand -v python > "{workspace}/which"', 1))
    ended = _call("--workspace", workspace, "--eval-env", f"venv:{tmp_path / 'sim'}")
    assert ended.code == 0, ended.stderr
    assert Path((workspace / "which").read_text().strip()) == home / "python"


@pytest.mark.parametrize("name", ["checkpoints/x5", "a[1]*"])
def test_the_result_is_found_whatever_the_checkpoint_is_called(workspace: Path, name: str) -> None:
    """Slashes are folders, as RoboDojo has it, and nothing in a name is a pattern."""
    ended = _call("--workspace", workspace, "--set", f"ckpt_name={name}", "--json")
    assert ended.code == 0, ended.stderr
    assert f"0_ckpt_name={name},action_type=joint" in json.loads(ended.stdout)["result"]


def test_a_name_does_not_lead_out_of_the_workspace(workspace: Path) -> None:
    ended = _call("--workspace", workspace, "--set", "ckpt_name=" + "/.." * 8 + str(workspace.parent / "out"))
    assert ended.code == 4
    assert "no result" in ended.stderr


def test_robotwins_rate_is_read_where_only_robotwin_knows_the_folder(tmp_path: Path) -> None:
    """The new one is read; a rate does not say which episodes succeeded, so that --out is refused."""
    folder = tmp_path / "RoboTwin"
    facts = environments.manifest(ROOT / "envs" / "robotwin")
    assert facts.hand_over is not None
    for name in facts.hand_over.workspace.files:
        path = folder / name.replace("{task_name}", "click_bell")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    results_of = folder / "eval_result" / "click_bell" / "demo_policy" / "demo_clean" / "default"
    (results_of / "before").mkdir(parents=True)
    (results_of / "before" / "_result.txt").write_text("1.0")
    script = f'mkdir "{results_of}/now"; printf "Timestamp: x\\n\\n%s" 0.37 > "{results_of}/now/_result.txt"'
    (folder / "scripts" / "eval_policy.sh").write_text(f'echo "$@" > "{folder}/told"; {script}\n')
    words = ["--task", "click_bell", "--workspace", folder, "--episodes", "100", "--set", "env_cfg_type=aloha-agilex"]
    ended = xpl("env", "hand-over", "robotwin", POLICY, *words, *NOWHERE, "--json")
    assert ended.code == 0, ended.stderr
    answer = json.loads(ended.stdout)
    assert (answer["success_rate"], answer["episodes"], answer["embodiment"]) == (0.37, None, "aloha_agilex")
    assert "--test_num 100" in (folder / "told").read_text()
    refused = xpl("env", "hand-over", "robotwin", POLICY, *words, *NOWHERE, "--out", tmp_path / "run")
    assert refused.code == 2
    assert "cannot be recorded" in refused.stderr
    assert not (tmp_path / "run").exists()


# -- from the ecosystem's own scripts ----------------------------------------------------------------------------------

LAUNCHED = ["--set", "bench_name=RoboDojo", "--set", "task_name=stack_bowls", "--env-gpu", "0", "--eval-env", "-"]


def test_eval_hands_over_where_the_workspace_is_known(
    workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As an adapter's setup_eval_env_client.sh calls it, with the benchmark's name."""
    monkeypatch.setenv("ROBODOJO_ROOT", str(workspace))
    monkeypatch.delenv("EVAL_ENV_TYPE", raising=False)
    ended = xpl("eval", POLICY, *LAUNCHED, *NOWHERE, "--out", tmp_path / "run")
    assert ended.code == 0, ended.stderr
    assert "1 of 2 succeeded" in ended.stdout
    assert ended.stdout.endswith("[MAIN] eval finished\n")
    assert len(records.read(tmp_path / "run").finals) == 2
    refused = xpl("eval", POLICY, *LAUNCHED, *NOWHERE, "--horizon", "4")
    assert refused.code == 2
    assert "--horizon" in refused.stderr


@pytest.mark.slow
def test_eval_reports_that_it_runs_a_mock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no workspace; and nothing is called a success."""
    monkeypatch.delenv("ROBODOJO_ROOT", raising=False)
    monkeypatch.delenv("EVAL_ENV_TYPE", raising=False)
    short = ["--workers", "0", "--set", "task_name=align_blocks", "--json"]
    ended = xpl("eval", POLICY, *LAUNCHED, *short)
    assert ended.code == 0, ended.stderr
    assert "stand-in" in ended.stderr
    report = json.loads(ended.stdout)
    assert (report["environment"], report["success_rate"]) == ("robodojo", None)


def test_the_name_of_a_benchmark_counts_for_its_own_tasks_only(monkeypatch: pytest.MonkeyPatch) -> None:
    from xpl_cli.evaluation.runs.settings import benchmark_for

    monkeypatch.delenv("EVAL_ENV_TYPE", raising=False)
    assert benchmark_for({"bench_name": "robodojo", "task_name": "push_T"}) == "robodojo"
    assert benchmark_for({"bench_name": "RoboDojo", "task_name": "lift_cube"}) is None
    assert benchmark_for({"bench_name": None, "task_name": "push_T"}) is None
    monkeypatch.setenv("EVAL_ENV_TYPE", "debug")
    assert benchmark_for({"bench_name": "RoboDojo", "task_name": "push_T"}) is None
