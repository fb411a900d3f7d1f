"""What the zoo adds to an adoption: only where the adapter's files are silent, and only of the policy that it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.adapters import trained
from xpl import _spec as sdk
from xpl_cli.adopt import field
from xpl_cli.adopt.checkpoints import block, start
from xpl_cli.adopt.facts import Evidence, Fact, likely
from xpl_cli.adopt.package import adoption
from xpl_cli.standard.zoo import policies

MODEL = "class Model:\n    def get_action(self):\n        return []\n"
LEROBOT = "https://github.com/huggingface/lerobot"


def _adopted(folder: Path, readme: str = "") -> dict[str, Fact]:
    folder.mkdir()
    (folder / "model.py").write_text(MODEL, encoding="utf-8")
    (folder / "README.md").write_text(readme, encoding="utf-8")
    chosen = adoption(folder, {}, merge=False, scripts=False)
    chosen.write()
    return chosen.draft.facts


def test_what_the_files_leave_open_comes_from_the_zoo(tmp_path: Path) -> None:
    """With the source of each fact; what nobody knows stays open."""
    found = _adopted(tmp_path / "Being_H05")
    assert found["family"].value == "vla"
    assert found["upstream"].value["license"] == "Apache-2.0"
    assert found["paper"].value["arxiv"] == "2601.12993"
    assert "xpl zoo show Being_H05 (license: policy/Being_H05/Being-H/LICENSE)" in found["upstream"].comment
    assert "temporal.chunk" not in found
    text = (tmp_path / "Being_H05" / "policy.yml").read_text(encoding="utf-8")
    assert "xpl zoo show Being_H05" in text


def test_what_the_files_say_stays(tmp_path: Path) -> None:
    """A paper of its own is not replaced; what the zoo adds to the same paper is added."""
    mine = _adopted(tmp_path / "Being_H05", "**Paper:** My own paper on hands\n")
    assert mine["paper"].value == {"title": "My own paper on hands"}
    title = policies.find("ACT").facts["paper"].value["title"]
    same = _adopted(tmp_path / "ACT", f"**Paper:** {title}\n")
    assert same["paper"].value["arxiv"] == "2304.13705"
    assert len(same["paper"].evidence) == 2


def test_a_policy_of_the_same_name_that_wraps_other_code_is_another(tmp_path: Path) -> None:
    """And one that is called otherwise gets nothing but the licence of the code that it wraps."""
    assert field.called("ACT", "https://github.com/somebody/act") is None
    assert field.called("act", "https://github.com/tonyzhaozh/ACT.git") == policies.find("ACT")
    other = _adopted(tmp_path / "Mine", "Original code: https://github.com/moojink/openvla-oft\n")
    assert other["upstream"].value["license"] == "MIT"
    assert "paper" not in other


@pytest.mark.parametrize(
    ("repository", "license_"),
    [("https://github.com/Physical-Intelligence/openpi", "Apache-2.0 + Gemma Terms of Use"), (LEROBOT, None)],
)
def test_a_licence_is_taken_where_all_that_wrap_the_code_agree(repository: str, license_: str | None) -> None:
    """Several policies stand on one library."""
    fact = likely("upstream", {"repository": repository, "revision": None}, Evidence("README.md", 1, "says so"))
    assert field.licensed(fact).value.get("license") == license_


def test_a_chunk_is_taken_only_where_all_of_it_is_executed() -> None:
    """Otherwise an adapter may answer the whole chunk, or what is executed of it."""
    told = {fact.key: fact.value for fact in field.facts(policies.find("Mem_0"))}
    assert told["temporal.chunk"] == 30
    assert "temporal.chunk" not in {fact.key for fact in field.facts(policies.find("AHA_WAM"))}


def test_a_package_from_a_checkpoint_gets_paper_and_code(tmp_path: Path) -> None:
    """Where it is called like a policy of the field, and its checkpoint names no other code."""
    folder = trained.openvla(tmp_path / "p", oft=True)
    texts = {}
    for name in ("OpenVLA_OFT", "Shirts"):
        wanted = start.Wanted(name, "franka_single", None, block.Choices())
        texts[name] = start.begin([folder], wanted).files[sdk.File.POLICY_YML].decode()
    assert "2502.19645" in texts["OpenVLA_OFT"]
    assert "xpl zoo show OpenVLA_OFT (paper: " in texts["OpenVLA_OFT"]
    assert "xpl zoo show" not in texts["Shirts"]
