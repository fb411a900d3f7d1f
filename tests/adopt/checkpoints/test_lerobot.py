"""Checkpoints of LeRobot: every fact with its place, and what they leave open."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from tests.support.adapters import trained
from xpl.embodiment import get_embodiment
from xpl_cli.adopt.checkpoints import block, registry
from xpl_cli.adopt.checkpoints.frameworks.lerobot.types import VERSION
from xpl_cli.adopt.facts import Confidence, Fact, leaves, plain
from xpl_cli.basics.errors import UserError


def read(*folders: Path, robot: str = "aloha_agilex", **choices: Any) -> tuple[Any, dict[str, Any]]:
    """Return what folders say, and the block made of it, as a tree."""
    found, _ = registry.read(folders)
    return found, block.model_io(found, get_embodiment(robot), block.UserChoices(**choices))


def places(tree: Any) -> dict[str, str]:
    """Return where each value of a block was read."""
    return {key: str(leaf.evidence[0]) for key, leaf in leaves(tree, "") if isinstance(leaf, Fact) and leaf.evidence}


def line(folder: Path, name: str, text: str) -> int:
    """Return the line of a file that holds a text, from 1."""
    lines = (folder / name).read_text(encoding="utf-8").splitlines()
    return next(number for number, held in enumerate(lines, start=1) if text in held)


def opened(tree: Any) -> list[str]:
    """Return the keys of a block that are open."""
    return [key for key, leaf in leaves(tree, "") if not isinstance(leaf, Fact)]


def test_what_a_checkpoint_says_is_in_the_block_with_its_place(tmp_path: Path) -> None:
    """Inputs, sizes, normalisation and chunk of an ACT policy; nothing is made up about its grippers."""
    folder = trained.lerobot(tmp_path / "act", chunk_size=100, n_action_steps=50, temporal_ensemble_coeff=None)
    found, tree = read(folder)
    (image,), (state,) = plain(tree["images"]), plain(tree["state"])
    assert (image["input"], image["cameras"]) == ("observation.images.cam_high", ["cam_head"])
    assert image["steps"][0]["resize"]["to"] == [480, 640]
    assert (image["channels"], image["layout"], image["dtype"]) == ("rgb", "chw", "float32")
    assert image["mean"] == pytest.approx([0.485, 0.456, 0.406])
    assert image["std"] == pytest.approx([0.229, 0.224, 0.225])
    assert state["normalize"] == {
        "rule": "mean_std",
        "file": "policy_preprocessor_step_2_normalizer_processor.safetensors",
        "key": "observation.state",
        "epsilon": 1e-08,
    }
    assert plain(tree["action"]["reference"]) == "absolute"
    assert plain(tree["sampling"]) == "none"
    assert plain(block.temporal(found)) == {"kind": "chunk", "chunk": 50}
    where = places(tree)
    image_line = line(folder, "config.json", '"observation.images.cam_high"')
    assert where["images.0.input"] == f"config.json:{image_line} observation.images.cam_high"
    assert where["images.0.steps.0.resize.to"] == f"config.json:{image_line + 2} shape: [3, 480, 640]"
    assert where["state.0.normalize.rule"].startswith("policy_preprocessor.json:")
    chunk_line = line(folder, "config.json", '"n_action_steps"')
    assert str(found.chunk.evidence[0]) == f"config.json:{chunk_line} n_action_steps: 50"
    ends = ("closed", "open")
    assert opened(tree) == [
        f"{key}.parts.{part}.gripper.{end}" for key in ("state.0", "action") for part in (1, 3) for end in ends
    ]


def test_a_data_set_names_the_numbers_the_robot_and_the_rate(tmp_path: Path) -> None:
    """Its names decide parts and order; the robot and the rate come from it too."""
    names = [*ALOHA_TURNED]
    data = trained.lerobot_dataset(tmp_path / "shirts", names)
    found, tree = read(trained.lerobot(tmp_path / "act", n_action_steps=50), data)
    parts = plain(tree["action"]["parts"])
    assert [next(iter(part)) for part in parts] == ["gripper", "joints", "gripper", "joints"]
    assert [next(iter(part.values()))["arm"] for part in parts] == ["right", "right", "left", "left"]
    assert parts[1]["joints"]["names"] == ["joint2", "joint1", "joint3", "joint4", "joint5", "joint6"]
    assert (plain(found.rate), plain(found.robot)) == (30, "aloha_agilex")
    assert places(tree)["action.parts.1.joints.arm"].startswith("shirts/meta/info.json:")
    assert found.robot is not None
    assert str(found.robot.evidence[0]) == 'shirts/meta/info.json:3 robot_type: "aloha_agilex"'


ALOHA_TURNED = [
    f"{side}_{joint}.pos"
    for side in ("right", "left")
    for joint in ("gripper", "joint2", "joint1", "joint3", "joint4", "joint5", "joint6")
]


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        ("MIN_MAX", {"rule": "min_max", "constant": "epsilon"}),
        ("QUANTILES", {"rule": "quantiles", "names": {"low": "q01", "high": "q99"}, "constant": "epsilon"}),
        ("IDENTITY", None),
    ],
)
def test_each_rule_of_normalisation_is_the_block_s(tmp_path: Path, mode: str, expected: Any) -> None:
    """LeRobot's modes have the block's words, epsilon and what becomes of numbers that never moved."""
    modes = {"VISUAL": "IDENTITY", "STATE": mode, "ACTION": mode}
    _, tree = read(trained.lerobot(tmp_path / "p", modes=modes, n_action_steps=8))
    found = plain(tree["state"][0]["normalize"])
    assert found is None if expected is None else {**found, **expected} == found
    assert "mean" not in tree["images"][0]


def test_quantiles_that_the_file_lacks_leave_the_rule_open(tmp_path: Path) -> None:
    _, tree = read(
        trained.lerobot(tmp_path / "p", modes={"STATE": "QUANTILE10", "ACTION": "MEAN_STD"}, n_action_steps=8)
    )
    assert "q10" in plain(tree["state"][0]["normalize"])["unknown"]


def test_relative_actions_and_history_are_read(tmp_path: Path) -> None:
    """The processor that forms deltas, the observations that are shown, and a rename of cameras."""
    relative = {
        "registry_name": "relative_actions_processor",
        "config": {"enabled": True, "exclude_joints": ["gripper"], "action_names": trained.ALOHA},
    }
    folder = trained.lerobot(
        tmp_path / "p",
        "diffusion",
        steps=[relative],
        cameras={"observation.images.camera1": (96, 96)},
        rename={"observation.images.left_wrist": "observation.images.camera1"},
        n_obs_steps=2,
        n_action_steps=8,
        horizon=16,
    )
    found, tree = read(folder)
    assert plain(tree["action"]["reference"]) == "delta_state"
    assert plain(tree["history"]) == {"length": 2, "pad": "repeat"}
    assert plain(block.temporal(found)) == {"kind": "history", "chunk": 8, "history": 2}
    assert plain(tree["images"][0]["cameras"]) == ["cam_left_wrist"]
    assert plain(tree["sampling"]) == "seeded"


def test_commands_that_reach_less_far_than_the_state_leave_the_reference_open(tmp_path: Path) -> None:
    folder = trained.lerobot(tmp_path / "p", n_action_steps=8)
    small = {f"action.{name}": [0.01 * v for v in values] for name, values in trained.statistics(14).items()}
    trained.safetensors(folder / "policy_postprocessor_step_0_unnormalizer_processor.safetensors", small)
    assert "deltas" in plain(read(folder)[1]["action"]["reference"])["unknown"]


def test_older_checkpoints_keep_statistics_in_their_weights(tmp_path: Path) -> None:
    """Before processors, buffers of the model held them; the numbers are written into the block."""
    folder = trained.lerobot(tmp_path / "p", n_action_steps=8)
    for path in folder.glob("policy_*"):
        path.unlink()
    state, action = trained.statistics(14), trained.statistics(14, 0.1)
    trained.safetensors(
        folder / "model.safetensors",
        {f"normalize_inputs.buffer_observation_state.{name}": state[name] for name in ("mean", "std")}
        | {f"unnormalize_outputs.buffer_action.{name}": action[name] for name in ("mean", "std")}
        | {
            f"normalize_inputs.buffer_observation_images_cam_high.{name}": trained.COLOURS[name]
            for name in ("mean", "std")
        }
        | {"model.weight": [1.0]},
    )
    found, tree = read(folder)
    assert plain(tree["action"]["normalize"])["values"]["mean"] == pytest.approx(action["mean"])
    assert plain(tree["images"][0]["mean"]) == pytest.approx([0.485, 0.456, 0.406])
    assert "migrate_policy_normalization.py" in " ".join(found.notes)


def test_a_policy_that_resizes_images_itself_gets_them_as_they_are(tmp_path: Path) -> None:
    """pi0 letterboxes in its own class; empty cameras are no camera."""
    cameras = {"observation.images.base_0_rgb": (224, 224), "observation.images.empty_camera_0": (224, 224)}
    tokens = {"registry_name": "tokenizer_processor", "config": {"max_length": 48}}
    folder = trained.lerobot(tmp_path / "p", "pi0", cameras=cameras, steps=[tokens], chunk_size=50, n_action_steps=50)
    found, tree = read(folder)
    assert [plain(image["input"]) for image in tree["images"]] == ["observation.images.base_0_rgb"]
    assert "steps" not in tree["images"][0]
    assert plain(tree["instruction"]) == {"input": "task", "empty": "blank"}
    assert block.camera_sizes(found, tree) == {"cam_head": {"width": None, "height": None}}


def test_the_library_is_pinned_with_its_extra_and_hub_names_are_noted(tmp_path: Path) -> None:
    """What loading takes from the hub is said where the checkpoint names it; its own name is nothing to load."""
    tokens = {"registry_name": "tokenizer_processor", "config": {"tokenizer_name": "org/tokenizer-2.1"}}
    folder = trained.lerobot(
        tmp_path / "p", "smolvla", steps=[tokens], n_action_steps=50, vlm_model_name="org/VLM", repo_id="me/mine"
    )
    found, _ = read(folder)
    assert found.requirements == [f"lerobot[smolvla]=={VERSION}"]
    notes = [note for note in found.notes if "names" in note]
    assert [re.findall(r"([\w.]+):\d+ names (\S+):", note) for note in notes if "Hugging Face" in note] == [
        [("config.json", "org/VLM")],
        [("policy_preprocessor.json", "org/tokenizer-2.1")],
    ]
    assert read(trained.lerobot(tmp_path / "q", "act", n_action_steps=8))[0].requirements == [f"lerobot=={VERSION}"]


def test_a_type_that_is_not_known_leaves_its_sampling_open(tmp_path: Path) -> None:
    found, tree = read(trained.lerobot(tmp_path / "p", "brand_new", n_action_steps=8))
    assert "brand_new" in plain(tree["sampling"])["unknown"]
    assert found.family.confidence is Confidence.ASSUMED


def test_two_names_of_one_camera_leave_the_second_open_until_the_user_says(tmp_path: Path) -> None:
    """`top` and `front` may both be the head camera; --camera decides."""
    cameras = {"observation.images.top": (96, 96), "observation.images.front": (96, 96)}
    folder = trained.lerobot(tmp_path / "p", cameras=cameras, n_action_steps=8)
    assert "is taken by another one" in plain(read(folder)[1]["images"][1]["cameras"])["unknown"]
    _, tree = read(folder, cameras={"front": "cam_third_view"}, gripper=(0.0, 1.0))
    assert [plain(image["cameras"]) for image in tree["images"]] == [["cam_head"], ["cam_third_view"]]
    assert opened(tree) == []


def test_the_run_of_a_training_is_taken_where_it_keeps_its_last_checkpoint(tmp_path: Path) -> None:
    """`lerobot-train` writes checkpoints/last/pretrained_model, a link to the last step."""
    step = trained.lerobot(tmp_path / "run" / "checkpoints" / "000100" / "pretrained_model", n_action_steps=8)
    (tmp_path / "run" / "checkpoints" / "last").symlink_to(step.parent, target_is_directory=True)
    assert read(tmp_path / "run")[0].chunk.value == 8


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"n_action_steps": "fifty"}, "config.json:34: expected a whole number at n_action_steps, got 'fifty'"),
        ({"output_features": {}}, "expected output_features with 'action'"),
        (
            {"input_features": {"observation.state": {"type": "STATE", "shape": []}}},
            "expected a shape of observation.state",
        ),
        (
            {"input_features": {"observation.state": {"shape": [14]}}},
            "expected a text at input_features/observation.state/type",
        ),
    ],
)
def test_a_value_of_the_wrong_kind_is_one_error_with_its_place(
    tmp_path: Path, change: dict[str, Any], told: str
) -> None:
    with pytest.raises(UserError) as failed:
        read(trained.lerobot(tmp_path / "p", **{"chunk_size": 8, **change}))
    assert told in str(failed.value)
