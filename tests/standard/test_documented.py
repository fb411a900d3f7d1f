"""What deploy.yml leaves open comes from the documents, where there is no manifest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.packages import package

if TYPE_CHECKING:
    from pathlib import Path

DEPLOY = "policy_name: Plain\nprotocol: ws\nhost: localhost\nport: null\nckpt_name: null\ntask_name: mine\n"


def _package(folder: Path, readme: str) -> package.Package:
    folder.mkdir()
    (folder / "model.py").write_text("class Model: pass\n")
    (folder / "deploy.yml").write_text(DEPLOY + "env_cfg_type: null\naction_type: null\nseed: null\n")
    (folder / "README.md").write_text(readme)
    return package.load(folder)


def test_the_documented_call_fills_what_is_null(tmp_path: Path) -> None:
    """And nothing else; a call with placeholders in place of the robot does not count."""
    readme = "bash eval.sh <bench> <task> <ckpt> <env>\n\nbash eval.sh Dojo stack cotrain arx_x5 ee 0 0 0 <env> <env>"
    config = _package(tmp_path / "Plain", readme).config({"seed": 3})
    assert [config[key] for key in ("bench_name", "task_name", "ckpt_name")] == ["Dojo", "mine", "cotrain"]
    assert [config[key] for key in ("env_cfg_type", "action_type", "seed")] == ["arx_x5", "ee", 3]


def test_without_a_documented_robot_nothing_is_made_up(tmp_path: Path) -> None:
    config = _package(tmp_path / "Plain", "bash eval.sh Dojo stack cotrain toaster joint 0").config()
    assert config["env_cfg_type"] is None
    assert config["ckpt_name"] is None
