"""`xpl new-policy --from`: what is written, and how it says where each value is from."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.adapters import trained
from tests.support.peer import xpl
from xpl import _spec as sdk
from xpl.convert.gaps import gaps
from xpl.manifest import Manifest
from xpl_cli.adopt.checkpoints import block, package_start
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.model_io import reference_file
from xpl_cli.packages.conventions import applicable_conventions
from xpl_cli.standard.validate import validate_yaml

TWO, ONE = "aloha_agilex", "franka_single"
MADE = {
    "lerobot": (trained.lerobot, TWO, {"n_action_steps": 8}),
    "openpi": (trained.openpi, TWO, {}),
    "groot": (trained.groot, TWO, {}),
    "groot_older": (trained.groot_older, "arx_x5_single", {}),
    "openvla": (trained.openvla, ONE, {}),
    "openvla_oft": (trained.openvla, ONE, {"oft": True}),
    "starvla": (trained.starvla, TWO, {}),
    "rdt": (trained.rdt, TWO, {}),
    "diffusion_policy": (trained.diffusion_policy, ONE, {}),
    "robomimic": (trained.robomimic, ONE, {}),
}


def begin(*folders: Path, robot: str | None = TWO, **choices: Any) -> package_start.NewPackage:
    """Return the package that some folders make."""
    return package_start.new_package(
        folders, package_start.StartOptions("Shirts", robot, None, block.UserChoices(**choices))
    )


@pytest.mark.sampled(3)
@pytest.mark.parametrize("maker", MADE)
def test_every_maker_s_checkpoint_makes_a_package_with_a_valid_manifest(tmp_path: Path, maker: str) -> None:
    """Facts and open values are counted as the manifest has them, and each fact has a place."""
    make, robot, options = MADE[maker]
    begun = begin(make(tmp_path / "p", **options), robot=robot, gripper=(0.0, 1.0))
    text = begun.files[sdk.File.POLICY_YML]
    manifest, problems = validate_yaml(text, sdk.File.POLICY_YML, "policy")
    assert not problems, [problem.text for problem in problems]
    assert manifest["spec"] == "v1"
    assert len([key for key in begun.findings.unknown if key.startswith("model_io.")]) == len(
        gaps(manifest["model_io"])
    )
    assert all(leaf.evidence for leaf in begun.findings.facts.values())
    ast.parse(begun.files[sdk.File.MODEL_PY])


def test_comments_say_the_source_beside_each_value(tmp_path: Path) -> None:
    text = begin(trained.lerobot(tmp_path / "p", n_action_steps=8)).files[sdk.File.POLICY_YML].decode()
    assert "  chunk: 8 # certain: config.json:" in text
    assert "    - input: observation.images.cam_high # certain: config.json:" in text
    assert "closed: { unknown: " in text
    assert "# see policy_preprocessor_step_2_normalizer_processor.safetensors observation.state min..max" in text


def test_reference_py_of_a_whole_checkpoint_names_every_convention(tmp_path: Path) -> None:
    """What applies has a source; what nobody says is assumed; nothing of ours is imported."""
    begun = begin(trained.lerobot(tmp_path / "p", "diffusion", n_obs_steps=2, n_action_steps=8), gripper=(0.0, 1.0))
    conventions = reference_file.parse(begun.files["reference.py"].decode())
    manifest = yaml.safe_load(begun.files[sdk.File.POLICY_YML])
    assert set(applicable_conventions(Manifest.parse(manifest))) <= set(conventions.conventions)
    assert not conventions.problems
    assert conventions.defines_answers
    assert not any(item.takes_sdk or item.takes_adapter("Shirts") for item in conventions.imports)
    assert {"gripper", "joint_order"} <= set(conventions.assumed)
    assert not any(
        conventions.conventions[name].is_assumed for name in conventions.conventions if name.startswith("history_")
    )


def test_reference_py_converts_as_the_parts_say(tmp_path: Path) -> None:
    """Order by names, degrees and grippers between two values, both ways."""
    import numpy as np

    names = [f"left_joint{n}" for n in (2, 1, 3, 4, 5, 6)] + ["left_gripper"]
    names += [f"right_joint{n}" for n in range(1, 7)] + ["right_gripper"]
    folder = trained.lerobot(tmp_path / "p", n_action_steps=8)
    wide = {
        f"{key}.{word}": [200.0 * v for v in values]
        for key in ("observation.state", "action")
        for word, values in trained.statistics(14).items()
    }
    for path in folder.glob("*.safetensors"):
        trained.safetensors(path, wide)
    begun = begin(folder, trained.lerobot_dataset(tmp_path / "shirts", names), robot=None, gripper=(0.08, 0.0))
    text = begun.files["reference.py"].decode()
    space: dict[str, Any] = {"__file__": "reference.py"}
    exec(text, space)  # noqa: S102 - our own, without the imports of its functions
    observed = {
        "left_arm_joint_state": np.arange(6.0),
        "left_ee_joint_state": np.array([1.0]),
        "right_arm_joint_state": np.arange(6.0) / 10,
        "right_ee_joint_state": np.array([0.25]),
    }
    row = space["state"](observed)
    assert row[:2] == pytest.approx(np.degrees([1.0, 0.0]))
    assert row[[6, 13]] == pytest.approx([0.0, 0.06])
    back = space["command"](row)
    for key, values in observed.items():
        assert back[key] == pytest.approx(values, abs=1e-5)


def test_no_reference_py_while_something_is_open(tmp_path: Path) -> None:
    begun = begin(trained.lerobot(tmp_path / "p", n_action_steps=8))
    assert "reference.py" not in begun.files
    assert "model_io.state.0.parts.1.gripper.closed" in begun.notes[-1]


def test_the_robot_is_the_data_s_or_the_user_s_word(tmp_path: Path) -> None:
    checkpoint = trained.lerobot(tmp_path / "p", n_action_steps=8)
    with pytest.raises(UserError, match="which robot is it") as failed:
        begin(checkpoint, robot=None)
    assert TWO in str(failed.value.hint)
    data = trained.lerobot_dataset(tmp_path / "shirts")
    manifest = yaml.safe_load(begin(checkpoint, data, robot=None).files[sdk.File.POLICY_YML])
    assert manifest["embodiments"] == [TWO]
    assert manifest["control_frequency"] == 30


def test_a_snapshot_of_the_hub_says_where_it_can_be_had(tmp_path: Path) -> None:
    """Owner, name and commit are the folder's own."""
    folder = tmp_path / "models--somebody--shirts" / "snapshots" / ("0" * 40)
    begun = begin(trained.lerobot(folder, n_action_steps=8))
    manifest = yaml.safe_load(begun.files[sdk.File.POLICY_YML])
    assert manifest["checkpoints"] == [{"name": "shirts", "source": "hf://somebody/shirts", "revision": "0" * 40}]
    assert yaml.safe_load(begun.files[sdk.File.DEPLOY_YML])["ckpt_name"] == "shirts"


@pytest.mark.slow
def test_the_command_writes_links_and_counts(tmp_path: Path) -> None:
    """Facts with sources as JSON; the checkpoint is found under its name; options that say the same are refused."""
    folder = trained.lerobot(tmp_path / "run1", n_action_steps=8)
    arguments = ("new-policy", "Shirts", "--from", str(folder), "--embodiment", TWO)
    completed = xpl(*arguments, "--gripper", "0,1", "--json", cwd=tmp_path)
    assert completed.returncode == ExitCode.CLEAN, completed.stderr
    answer = json.loads(completed.stdout)
    assert answer["open"] == []
    chunk = next(fact for fact in answer["facts"] if fact["key"] == "temporal.chunk")
    assert (chunk["value"], chunk["evidence"][0]["file"]) == (8, "config.json")
    assert (tmp_path / "policy" / "Shirts" / "checkpoints" / "run1").resolve() == folder
    assert any("model-io record" in command for command in answer["next"])
    refused = xpl(*arguments, "--chunk", "4", "--cameras", "cam_head", cwd=tmp_path)
    assert refused.returncode == ExitCode.USAGE
    assert "--chunk, --cameras do not go with --from" in refused.stderr


def test_names_of_strangers_stay_text(tmp_path: Path) -> None:
    """Names with quotes, line ends and braces of templates end neither YAML nor Python."""
    name = "observation.images.a\"'\n#{{ 1 }}: [head"
    folder = trained.lerobot(tmp_path / "p", cameras={name: (8, 8)}, n_action_steps=8)
    begun = begin(folder, cameras={name: "cam_head"}, gripper=(0.0, 1.0))
    assert yaml.safe_load(begun.files[sdk.File.POLICY_YML])["model_io"]["images"][0]["input"] == name
    tree = ast.parse(begun.files["reference.py"])
    assert name in {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
