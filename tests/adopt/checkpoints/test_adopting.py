"""`xpl adopt --from`: what an adapter's files do not state is said by the checkpoint that it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.adapters import trained
from tests.support.adapters.adopted import written
from xpl import _spec as sdk
from xpl_cli.adopt.checkpoints.block import UserChoices
from xpl_cli.adopt.package import Adoption, CheckpointSource, adoption


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """An adapter of the ecosystem."""
    return written(tmp_path / "Grasp")


def adopted(folder: Path, *sources: Path, merge: bool = False, **given: Any) -> tuple[Adoption, dict[str, Any]]:
    """Return an adoption with a checkpoint, and the manifest that it would write."""
    chosen = adoption(folder, given, merge=merge, scripts=False, trained=CheckpointSource(sources, UserChoices()))
    return chosen, yaml.safe_load(chosen.files[sdk.File.POLICY_YML])


def test_the_model_io_block_and_what_is_unknown_come_from_the_checkpoint(adapter: Path, tmp_path: Path) -> None:
    """What the user says stays: an adapter may hand on fewer steps than the model answers."""
    checkpoint = trained.lerobot(tmp_path / "run", n_action_steps=100)
    adoption, manifest = adopted(adapter, checkpoint, embodiments=["aloha_agilex"], **{"temporal.chunk": 16})
    assert manifest["spec"] == "v1"
    assert manifest["temporal"]["chunk"] == 16
    assert manifest["temporal"]["kind"] == "chunk"
    assert manifest["inputs"]["required"]
    assert manifest["model_io"]["state"][0]["input"] == "observation.state"
    assert len(adoption.findings.unknown) >= 8
    assert "model_io.state.0.parts.1.gripper.closed" in adoption.findings.unknown


def test_a_manifest_that_is_there_gets_the_block_and_keeps_the_rest(adapter: Path, tmp_path: Path) -> None:
    """--merge appends; the version of the standard is the author's to raise."""
    before = "spec: v1\nname: Grasp\nembodiments: [aloha_agilex]\n"
    (adapter / sdk.File.POLICY_YML).write_text(before, encoding="utf-8")
    adoption, manifest = adopted(adapter, trained.lerobot(tmp_path / "run", n_action_steps=8), merge=True)
    assert adoption.files[sdk.File.POLICY_YML].decode().startswith(before)
    assert manifest["model_io"]["action"]["normalize"]["key"] == "action"
