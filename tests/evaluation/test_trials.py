"""What a policy learns about trials: the case before each, and the outcome after it."""

from __future__ import annotations

import json
import textwrap
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.adapters import drill
from tests.support.peer import xpl
from xpl_cli.basics.errors import ExitCode

if TYPE_CHECKING:
    from pathlib import Path

HOOKS = """
    import json

    def _note(self, what, told):
        if self.config.get("fails") == what:
            raise RuntimeError(f"{what} cannot be")
        with (Path(self.config["marks"]) / "told").open("a") as stream:
            stream.write(json.dumps([what, told]) + chr(10))

    def _reset(self, _reset=Model.reset):
        _note(self, "reset", None)
        _reset(self)

    Model.reset = _reset
    Model.prepare_case = lambda self, case: _note(self, "prepare_case", case)
    Model.on_trial_end = lambda self, result: _note(self, "on_trial_end", result)
"""


def _evaluated(folder: Path, *options: str, **config: Any) -> tuple[Any, list[Any]]:
    """Evaluate an adapter with hooks; return the finished command and the arguments of the hooks."""
    env = drill.environment(folder)
    policy = drill.adapter(folder, **config)
    model = policy / "model.py"
    model.write_text(model.read_text() + textwrap.dedent(HOOKS))
    done = xpl("eval", str(policy), "--env", str(env), "--seed", "0", *options, "--json", cwd=folder)
    marks = folder / "told"
    return done, [json.loads(line) for line in marks.read_text().splitlines()] if marks.exists() else []


def test_a_policy_hears_of_every_trial_and_nothing_by_which_it_could_look_it_up(tmp_path: Path) -> None:
    done, events = _evaluated(tmp_path, "--episodes", "3", "--horizon", "2")
    assert done.returncode == 0, done.stderr
    assert [what for what, _ in events] == ["prepare_case", "reset", "on_trial_end"] * 3
    cases, results = (
        [content for what, content in events if what == hook] for hook in ("prepare_case", "on_trial_end")
    )
    case = {"task_name": "hold", "setting": "clean", "env_cfg_type": "franka_single", "action_type": "joint"}
    assert all(one == {"action_case_id": "hold/clean", "num_envs": 1, **case} for one in cases)
    assert [one["success"] for one in results] == [True, True, False]
    assert {tuple(sorted(one)) for one in results} == {("end_reason", "score", "steps", "success", "trial_id")}
    assert len({one["trial_id"] for one in results}) == 3


@pytest.mark.slow
def test_a_case_that_the_policy_refuses_is_its_failure(tmp_path: Path) -> None:
    done, events = _evaluated(tmp_path, fails="prepare_case")
    assert done.returncode == ExitCode.FINDINGS
    assert "prepare_case cannot be" in done.stderr
    assert [what for what, _ in events if what != "reset"] == ["on_trial_end"]


@pytest.mark.slow
def test_what_a_hook_does_after_the_trial_changes_no_verdict(tmp_path: Path) -> None:
    done, _ = _evaluated(tmp_path, "--episodes", "2", fails="on_trial_end")
    assert done.returncode == 0
    assert json.loads(done.stdout)["successes"] == 2
    assert done.stderr.count("on_trial_end failed") == 2
