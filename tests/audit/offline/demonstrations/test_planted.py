"""Mistakes that are planted into trained policies: the lists, what the search came to know by them, and the page."""

from __future__ import annotations

import json
import os
import shutil
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.audit.offline.mistakes_table import table
from tests.audit.offline.mistakes_table.local import Judged
from tests.audit.offline.mistakes_table.planting import Subject, trained
from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl import get_embodiment
from xpl.catalogue import AdapterCase
from xpl_cli.audit.engine import fixtures
from xpl_cli.audit.rules.registry import find
from xpl_cli.model_io.mistakes import in_block

PYTHONS = (os.environ.get("XPL_TORCH_PYTHON"), str(ROOT / "policy" / "Tiny_VLA" / ".venv" / "bin" / "python"))
NUMBERS = ("mean", "std", "min", "max", "q01", "q99")
FILES = ("preprocessor_step_3_normalizer", "postprocessor_step_0_unnormalizer")


@pytest.fixture(scope="module")
def statistics(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with files of statistics as LeRobot writes them."""
    folder = tmp_path_factory.mktemp("statistics")
    names = [f"{key}.{name}" for key in ("action", "observation.state") for name in NUMBERS]
    values = {name: np.full(10, 1.0 if name.endswith(("std", "max", "q99")) else 0.0, np.float32) for name in names}
    header: dict[str, Any] = {}
    body = b""
    for name, one in values.items():
        header[name] = {"dtype": "F32", "shape": [10], "data_offsets": [len(body), len(body) + one.nbytes]}
        body += one.tobytes()
    text = json.dumps(header).encode()
    for file in FILES:
        (folder / f"policy_{file}_processor.safetensors").write_bytes(struct.pack("<Q", len(text)) + text + body)
    return folder


@pytest.fixture(scope="module")
def every() -> list[Subject]:
    """All mistakes of each package; both tasks of one have its block, and one of them both lists."""
    kept = [policy for policy in trained() if "lists" not in policy.told]
    return [subject for policy in kept for subject in policy.subjects if subject.mistake is not None]


def test_every_mistake_is_another_adapter_that_converts(statistics: Path, every: list[Subject]) -> None:
    """What cannot be compiled is found by anybody, and what changes nothing by nobody."""
    for subject in every:
        mistake = subject.mistake
        assert mistake is not None
        assert subject.fault([statistics]) is None, subject.key
        if mistake.replace is None:
            assert subject.block != subject.policy.manifest.model_io.data, subject.key
        else:
            text = (subject.policy.package / mistake.replace["file"]).read_text(encoding="utf-8")
            assert mistake.replace["old"] in text, subject.key


def test_what_yaml_shares_is_planted_where_it_was_said() -> None:
    """Tiny_VLA's block says the parts of state and action once."""
    (policy,) = trained(["Tiny_VLA pick_by_language"])
    (subject,) = [one for one in policy.subjects if one.name == "gripper reversed in the state"]
    block = subject.block
    assert block["state"][0]["parts"][1]["gripper"]["open"] == 0
    assert block["action"]["parts"][1]["gripper"]["open"] == 1


def test_other_vectors_of_a_file_of_lerobots_are_known(statistics: Path) -> None:
    """Numbers of the state taken for commands, though nothing else in the block names those."""
    (policy,) = trained(["ACT push_block"])
    block = json.loads(json.dumps(policy.manifest.model_io.data))
    block["action"]["normalize"]["key"] = "observation.state"
    mistakes = in_block(AdapterCase(get_embodiment("arx_x5_single"), "ee", block, [statistics]), 16)
    assert "normalize: key: action (action)" in {one.description for one, _ in mistakes}


def test_variances_that_are_taken_for_deviations_are_known() -> None:
    (policy,) = trained(["Tiny_VLA pick_by_language"])
    (subject,) = [one for one in policy.subjects if one.name == "divided by the variance"]
    mistakes = {
        one.description: changed
        for one, changed in in_block(
            AdapterCase(get_embodiment("arx_x5_single"), "joint", subject.block, [policy.package]), 8
        )
    }
    fixed = mistakes["normalize: std: the root of what is said"]
    right = policy.manifest.model_io.data["action"]["normalize"]["values"]["std"]
    assert fixed["action"]["normalize"]["values"]["std"] == pytest.approx(right)


@pytest.mark.slow
def test_a_camera_that_does_not_reach_the_model_is_said(tmp_path: Path) -> None:
    """Where dark pictures change nothing at all; and of the policy as it was trained nothing is said."""
    known = {subject.name: subject for subject in fixtures.fixtures(find("demonstrations-fit"))}
    found = {}
    for name in ("bad/unread", "good/as-trained"):
        package = fixtures.build(known[name], tmp_path / Path(name).name.title().replace("-", ""))
        found[name] = Judged(package, package / "demonstrations").fit
    (finding,) = found["bad/unread"].findings
    assert finding.message.startswith("cam_head does not reach the model")
    assert finding.evidence is not None
    assert dict(finding.evidence)["cause"]["convention"] == "camera"
    assert not found["good/as-trained"].findings


def test_the_page_says_what_was_measured(every: list[Subject]) -> None:
    rows, text = table.results(), table.PAGE.read_text(encoding="utf-8")
    assert table.page(rows, text) == text
    assert table.picture(rows) == table.PICTURE.read_text(encoding="utf-8")
    assert {row["mistake"] for row in rows} <= {subject.name for subject in every} | {"right"}
    for sample in ("in", "out"):
        named, count = table.rates(rows, sample, "first")["told"]
        assert named >= 0.9 * count


@pytest.mark.slow
def test_a_mistake_in_tiny_vla_is_named_once_more(tmp_path: Path) -> None:
    """Recorded anew, judged anew: a mistake is named, and the correct adapter is not flagged."""
    python = next((one for one in PYTHONS if one and Path(one).exists()), None)
    if python is None:
        pytest.skip("no Python with torch: `xpl install policy/Tiny_VLA`, or name one in XPL_TORCH_PYTHON")
    demos = tmp_path / "demos"
    place = ("--task", "pick_by_language", "--embodiment", "arx_x5_single", "--episodes", "6", "--seed", "5000")
    ran = xpl("record", "mujoco", *place, "--images", "96x96", "--no-depth", "--out", str(demos), cwd=ROOT)
    assert ran.returncode == 0, ran.stderr
    (policy,) = trained(["Tiny_VLA pick_by_language"])
    wanted = {"right": None, "blue for red": "image_channels"}
    for subject in policy.subjects:
        if subject.name not in wanted or (subject.mistake is not None and subject.sample == "in"):
            continue
        package = subject.write(tmp_path / subject.key, None, None)
        chosen = ("--gate", "offline", "--select", "XPL270", "--no-cache", "--json")
        ran = xpl("audit", str(package), "--python", python, "--demos", str(demos), *chosen, cwd=ROOT)
        results = [
            one for target in json.loads(ran.stdout)["targets"] for gate in target["gates"] for one in gate["results"]
        ]
        (fit,) = [one for one in results if one["code"] == "XPL270"]
        said = [one["evidence"]["cause"]["convention"] for one in fit["findings"]]
        assert said == ([wanted[subject.name]] if wanted[subject.name] else []), fit
        shutil.rmtree(package)
