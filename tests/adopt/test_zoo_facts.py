"""What the zoo adds to an adoption: only where files and checkpoint are silent, and only of the policy that it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from tests.support.adapters import trained
from xpl import _spec as sdk
from xpl_cli.adopt import zoo_facts
from xpl_cli.adopt.checkpoints import block, package_start
from xpl_cli.adopt.package import adoption
from xpl_cli.standard.zoo import policies

MODEL = "class Model:\n    def get_action(self):\n        return []\n"


def _adopted(folder: Path, **given: Any) -> tuple[dict[str, Any], str]:
    folder.mkdir()
    (folder / "model.py").write_text(MODEL, encoding="utf-8")
    text = adoption(folder, given, merge=False, scripts=False).files[sdk.File.POLICY_YML].decode()
    return yaml.safe_load(text), text


def test_what_the_files_leave_open_comes_from_the_zoo(tmp_path: Path) -> None:
    """With the source of each fact; what nobody knows stays unknown."""
    found, text = _adopted(tmp_path / "Being_H05")
    assert found["family"] == "vla"
    assert found["upstream"]["license"] == "Apache-2.0"
    assert found["paper"]["arxiv"] == "2601.12993"
    assert set(found["temporal"]["chunk"]) == {"unknown"}
    assert "xpl zoo show Being_H05 (license: policy/Being_H05/Being-H/LICENSE)" in text


def test_what_the_user_says_stays(tmp_path: Path) -> None:
    """A paper of the author's own is not replaced, and a policy of another name gets nothing."""
    mine, _ = _adopted(tmp_path / "Being_H05", paper={"title": "My own paper on hands"})
    assert mine["paper"] == {"title": "My own paper on hands"}
    other, text = _adopted(tmp_path / "Mine")
    assert set(other["family"]) == {"unknown"}
    assert "xpl zoo" not in text


def test_a_policy_of_the_same_name_that_wraps_other_code_is_another() -> None:
    assert zoo_facts.find_policy("ACT", "https://github.com/somebody/act") is None
    assert zoo_facts.find_policy("act", "https://github.com/tonyzhaozh/ACT.git") == policies.find("ACT")


def test_a_chunk_is_taken_only_where_all_of_it_is_executed() -> None:
    """Otherwise an adapter may answer the whole chunk, or what is executed of it."""
    told = {key: told.value for key, told in zoo_facts.facts(policies.find("Mem_0"))}
    assert told["temporal.chunk"] == 30
    assert "temporal.chunk" not in dict(zoo_facts.facts(policies.find("AHA_WAM")))


def test_a_package_from_a_checkpoint_gets_paper_and_code(tmp_path: Path) -> None:
    """Where it is called like a policy of the field, and its checkpoint names no other code."""
    folder = trained.openvla(tmp_path / "p", oft=True)
    texts = {}
    for name in ("OpenVLA_OFT", "Shirts"):
        wanted = package_start.StartOptions(name, "franka_single", None, block.UserChoices())
        texts[name] = package_start.new_package([folder], wanted).files[sdk.File.POLICY_YML].decode()
    assert "2502.19645" in texts["OpenVLA_OFT"]
    assert "xpl zoo show OpenVLA_OFT (paper: " in texts["OpenVLA_OFT"]
    assert "xpl zoo show" not in texts["Shirts"]
