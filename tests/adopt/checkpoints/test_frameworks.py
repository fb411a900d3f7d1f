"""Checkpoints of other makers than LeRobot: what they say, where, and what stays open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.support.adapters import trained
from xpl.convert import compile_interface
from xpl.embodiment import get_embodiment
from xpl_cli.adopt.checkpoints import block, registry
from xpl_cli.adopt.facts import Fact, leaves, plain
from xpl_cli.basics.errors import UserError

TWO, ONE = "aloha_agilex", "franka_single"


def read(*folders: Path, robot: str = TWO, key: str | None = None, **choices: Any) -> tuple[Any, dict[str, Any]]:
    """Return what folders say, and the block made of it, as a tree."""
    found, _ = registry.read(folders, key)
    return found, block.model_io(found, get_embodiment(robot), block.UserChoices(**choices))


def source(tree: Any, key: str) -> str:
    """Return where a value of a block was read."""
    leaf = dict(leaves(tree, ""))[key]
    assert isinstance(leaf, Fact)
    return str(leaf.evidence[0])


def opened(tree: Any) -> list[str]:
    """Return the keys of a block that are open."""
    return [key for key, leaf in leaves(tree, "") if not isinstance(leaf, Fact)]


# -- openpi ------------------------------------------------------------------------------------------------------------


def test_openpi_says_its_numbers_and_the_name_its_rule(tmp_path: Path) -> None:
    """checkpoints/<config>/<experiment>/<step>: pi05 normalises by quantiles; padding is not counted as numbers."""
    folder = trained.openpi(tmp_path / "pi05_shirts" / "run1" / "20000")
    found, tree = read(folder, gripper=(0.0, 1.0))
    state = plain(tree["state"][0])
    assert [next(iter(part)) for part in state["parts"]] == ["joints", "gripper", "joints", "gripper"]
    assert state["normalize"] == {
        "rule": "quantiles",
        "file": "assets/trossen/norm_stats.json",
        "key": "norm_stats/state",
        "names": {"low": "q01", "high": "q99"},
        "epsilon": 1e-6,
    }
    assert state["pad"] == 32
    assert source(tree, "state.0.normalize.file") == "assets/trossen/norm_stats.json:3 norm_stats/state"
    assert plain(tree["images"][0]["steps"]) == [
        {"letterbox": {"to": [224, 224], "filter": "bilinear", "antialias": True}}
    ]
    assert opened(tree) == ["action.reference"]
    assert "action_horizon" in plain(found.chunk)["unknown"]


def test_openpi_says_the_rest_in_its_training_config(tmp_path: Path) -> None:
    """config.py is read as a syntax tree: horizon, deltas and the data's cameras."""
    folder = trained.openpi(tmp_path / "pi05_shirts" / "run1" / "20000")
    trained.put(tmp_path / "code", "src/openpi/training/config.py", trained.OPENPI_CONFIG)
    found, tree = read(folder, tmp_path / "code", gripper=(0.0, 1.0))
    assert plain(found.chunk) == 25
    assert source(tree, "action.reference").startswith("src/openpi/training/config.py:8 ")
    assert plain(tree["action"]["reference"]) == "delta_state"
    cameras = {plain(view["input"]): plain(view["cameras"]) for view in tree["images"]}
    assert cameras["base_0_rgb"] == ["cam_head"]
    assert cameras["left_wrist_0_rgb"] == ["cam_left_wrist"]
    assert opened(tree) == []
    interface = compile_interface(plain(tree), get_embodiment(TWO), "joint", [folder], 25)
    assert interface.action.vector.width == 14


def test_openpi_without_quantiles_centres_and_scales(tmp_path: Path) -> None:
    """A pi0 of before has mean and std only; a name that says nothing leaves the choice open where both are there."""
    assert (
        plain(read(trained.openpi(tmp_path / "a", quantiles=False))[1]["state"][0]["normalize"])["rule"] == "mean_std"
    )
    assert "unknown" in plain(read(trained.openpi(tmp_path / "b"))[1]["state"][0]["normalize"])


def test_one_arm_has_no_second_wrist(tmp_path: Path) -> None:
    _, tree = read(trained.openpi(tmp_path / "pi0_droid", width=8), robot=ONE)
    assert [plain(view["cameras"]) for view in tree["images"]] == [["cam_head"], ["cam_wrist"]]


# -- Isaac-GR00T -------------------------------------------------------------------------------------------------------


def test_groot_says_groups_horizon_and_tags(tmp_path: Path) -> None:
    """The processor of N1.6: one input for each group, in their order; the policy's class normalises itself."""
    found, tree = read(trained.groot(tmp_path / "p"), gripper=(0.0, 1.0))
    assert [plain(state["input"]) for state in tree["state"]][:2] == ["state.left_arm", "state.left_gripper"]
    assert [next(iter(part)) for part in plain(tree["action"]["parts"])] == ["joints", "gripper", "joints", "gripper"]
    assert plain(tree["action"]["normalize"]) is None
    assert plain(found.chunk) == 16
    assert [plain(view["cameras"]) for view in tree["images"]] == [["cam_head"], ["cam_left_wrist"]]
    assert plain(tree["instruction"])["input"] == "annotation.human.task_description"
    assert "lower-cases" in plain(tree["code"])[0]
    assert opened(tree) == []
    assert source(tree, "images.0.input").startswith("processor_config.json:")


def test_groot_of_before_says_resolution_and_leaves_its_data_config_open(tmp_path: Path) -> None:
    """Metadata of N1.5: sizes and ranges; keys of texts are in the code that loads it."""
    found, tree = read(trained.groot_older(tmp_path / "p"), robot="arx_x5_single", gripper=(0.0, 1.0))
    assert found.views[0].size == (480, 640)
    assert plain(found.chunk) == 16
    assert plain(tree["action"]["reference"]) == "absolute"
    assert opened(tree) == []


def test_several_embodiments_need_a_word_of_the_user(tmp_path: Path) -> None:
    folder = trained.groot_older(tmp_path / "p", "gr1")
    meta = (folder / "experiment_cfg" / "metadata.json").read_text(encoding="utf-8")
    one = trained.json.loads(meta)
    trained.put(folder, "experiment_cfg/metadata.json", {**one, "oxe_droid": one["gr1"]})
    with pytest.raises(UserError, match="there are gr1, oxe_droid"):
        read(folder)
    assert plain(read(folder, key="oxe_droid")[0].robot) == "oxe_droid"


# -- OpenVLA -----------------------------------------------------------------------------------------------------------


def test_openvla_says_bounds_mask_and_prompt(tmp_path: Path) -> None:
    """One action of seven numbers; the rotation's form and the pose's frame are nowhere said."""
    found, tree = read(trained.openvla(tmp_path / "p"), robot=ONE)
    rule = plain(tree["action"]["normalize"])
    assert rule["rule"] == "quantiles"
    assert rule["key"] == "norm_stats/libero_spatial_no_noops/action"
    assert rule["only"] == [True] * 6 + [False]
    assert plain(found.chunk) == 1
    assert plain(tree["instruction"])["template"].startswith("In: What action should the robot take to {instruction}?")
    assert plain(tree["instruction"])["case"] == "lower"
    kinds = [next(iter(part)) for part in tree["action"]["parts"]]
    assert kinds == ["position", "rotation", "gripper"]
    assert "action.parts.1.rotation.euler" in opened(tree)


def test_openvla_oft_says_its_heads(tmp_path: Path) -> None:
    found, tree = read(trained.openvla(tmp_path / "p", oft=True), robot=ONE)
    assert plain(found.chunk) == 8
    assert plain(tree["state"][0]["normalize"])["clip"] == [-1, 1]
    assert plain(tree["action"]["normalize"])["file"] == "dataset_statistics.json"
    assert plain(tree["action"]["normalize"])["epsilon"] == 1e-8


def test_openvla_of_several_data_sets_asks_for_the_key(tmp_path: Path) -> None:
    folder = trained.openvla(tmp_path / "p", ("bridge_orig", "fractal20220817_data"))
    with pytest.raises(UserError, match="there are bridge_orig, fractal20220817_data"):
        read(folder, robot=ONE)
    assert "bridge_orig" in read(folder, robot=ONE, key="bridge_orig")[0].about


# -- StarVLA, RDT, Diffusion Policy, robomimic -------------------------------------------------------------------------


def test_starvla_says_horizon_and_size_and_opens_no_weights(tmp_path: Path) -> None:
    """The rule of normalisation is in code; its weights are a pickle."""
    found, tree = read(trained.starvla(tmp_path / "p"))
    assert plain(found.chunk) == 16
    assert plain(tree["images"][0]["steps"])[0]["resize"]["to"] == [224, 224]
    assert plain(tree["action"]["reference"]) == "absolute"
    assert "state.0.normalize" in opened(tree)
    assert "not opened" in found.notes[0]


@pytest.mark.parametrize(("robot", "widths"), [(TWO, [6, 4, 1, 39, 6, 4, 1, 67]), (ONE, [7, 3, 1, 117])])
def test_rdt_puts_each_quantity_in_its_place(tmp_path: Path, robot: str, widths: list[int]) -> None:
    """The right arm's places come first; a single arm has them."""
    found, tree = read(trained.rdt(tmp_path / "p"), robot=robot)
    parts = plain(tree["action"]["parts"])
    assert [part["fill"]["width"] if "fill" in part else w for part, w in zip(parts, widths, strict=True)] == widths
    assert next(iter(parts[0].values()))["arm"] == ("right" if robot == TWO else "single")
    assert plain(found.chunk) == 64
    assert plain(tree["history"]) == {"length": 2, "of": ["images"]}
    interface = compile_interface({**plain(tree), "images": []}, get_embodiment(robot), "joint", [], 64)
    assert interface.action.vector.width == 128


def test_diffusion_policy_is_read_from_hydra_and_its_payload_is_not_unpickled(tmp_path: Path) -> None:
    """Shapes with interpolations; the checkpoint's members are listed, and the pickle in it does nothing."""
    marker = tmp_path / "p" / "unpickled"
    found, tree = read(trained.diffusion_policy(tmp_path / "p"), robot=ONE, gripper=(0.0, 1.0))
    assert not marker.exists()
    assert [plain(state["input"]) for state in tree["state"]] == [
        "robot0_eef_pos",
        "robot0_eef_quat",
        "robot0_gripper_qpos",
    ]
    assert plain(tree["state"][1]["parts"][0]["rotation"]["form"]) == "quaternion_xyzw"
    assert plain(tree["action"]["reference"]) == "absolute"
    assert plain(tree["history"]) == {"length": 2, "pad": "repeat"}
    assert plain(found.chunk) == 8
    assert [plain(view["cameras"]) for view in tree["images"]] == [["cam_head"], ["cam_wrist"]]
    assert "latest/data.pkl" in found.notes[0]
    assert "action.parts.1.rotation.form" in opened(tree)


def test_robomimic_says_its_observations_and_what_only_the_pickle_knows(tmp_path: Path) -> None:
    """Widths and statistics are in the .pth: open, with that reason."""
    found, tree = read(trained.robomimic(tmp_path / "p", hdf5_normalize_obs=True), robot=ONE, gripper=(0.0, 1.0))
    assert plain(tree["recurrent"]) is True
    assert plain(tree["sampling"]) == "seeded"
    assert plain(found.chunk) == 1
    assert "pickled" in plain(tree["action"]["parts"])["unknown"]
    assert "obs_normalization_stats" in plain(tree["state"][0]["normalize"])["unknown"]
    assert "object" in plain(tree["state"][3]["parts"])["unknown"]
    assert block.temporal(found)["kind"] == "memory"
