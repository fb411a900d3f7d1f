"""Recipes of the zoo for adapters that bring no tiny.py: found by name, their constants read without running them."""

from __future__ import annotations

import ast
import os
from typing import TYPE_CHECKING

import pytest

from xpl.worker import surroundings
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.errors import UserError
from xpl_cli.model_io import recipes, tiny
from xpl_cli.packages import package

if TYPE_CHECKING:
    from pathlib import Path

MODEL = """\
import os

import numpy as np


class Model:
    def __init__(self, config):
        self.weights = np.load(os.environ["RUNS"] + "/weights.npy")

    def update_obs(self, obs):
        self.obs = obs

    def get_action(self):
        {read}
        joints = np.tanh(state[:6] @ self.weights)
        return [{{"arm_joint_state": joints, "ee_joint_state": np.zeros(1)}}]

    def reset(self):
        self.obs = None
"""
READ = 'state = self.obs["state"]["arm_joint_state"]'
RECIPE = """\
import numpy as np

REQUIREMENTS = ("numpy",)
SETTINGS = {"run_dir": "{folder}", "env_cfg_type": "arx_x5_single", "action_type": "joint", "CHUNK": 4,
            "vlm": {"paths": ["{folder}/vlm"], "layers": 2}}
VARIABLES = {"RUNS": "{folder}"}


def write(folder, gain, config):
    assert config["CHUNK"] == 4
    np.save(folder / "weights.npy", np.random.normal(0, 0.001, (6, 6)) * gain("state"))
"""


@pytest.fixture
def adapter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder for an adapter without policy.yml, for whose name the zoo has a recipe."""
    folder = tmp_path / "checkout" / "policy" / "Bare"
    folder.mkdir(parents=True)
    (folder / "deploy.yml").write_text("run_dir: null\n")
    (folder / "model.py").write_text(MODEL.format(read=READ))
    path = tmp_path / "spec" / "zoo" / "tiny" / "Bare.py"
    path.parent.mkdir(parents=True)
    path.write_text(RECIPE)
    monkeypatch.setattr(recipes, "content_folder", lambda name: tmp_path / name)
    return folder


def test_a_recipe_of_the_zoo_makes_the_weights_of_a_bare_adapter(
    adapter: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = package.load(adapter)
    recipe = recipes.find(found)
    assert recipe is not None
    assert recipe.requirements == ("numpy",)
    assert not recipe.is_configured(found.config(), adapter)
    made = tiny.make(found, tmp_path / "made", tiny.TinyOptions())
    assert (made.path / "weights.npy").is_file()
    assert made.effects["state"] >= tiny.SHARE
    assert made.unmoved == {}
    monkeypatch.setenv("RUNS", "")
    surroundings.prepare(adapter, {"run_dir": str(made.path)}, None)
    assert os.environ["RUNS"] == str(made.path)
    own = found.config(recipe.overrides(made.path, {"CHUNK": 8}))
    assert (own["run_dir"], own["CHUNK"]) == (str(made.path), 8)
    assert own["vlm"] == {"paths": [f"{made.path}/vlm"], "layers": 2}
    assert recipe.is_configured(own, adapter)


def test_weights_remain_where_the_adapter_fails_on_them(adapter: Path, tmp_path: Path) -> None:
    """The audit that wants them says how it fails; the command that makes a checkpoint stops."""
    (adapter / "model.py").write_text(MODEL.format(read="state = self.obs['joints']"))
    found = package.load(adapter)
    with pytest.raises(UserError, match="KeyError: 'joints'"):
        tiny.make(found, tmp_path / "made", tiny.TinyOptions())
    made = tiny.make(found, tmp_path / "made", tiny.TinyOptions(may_fail=True))
    assert (made.path / "weights.npy").is_file()
    assert made.effects == {}


def test_a_package_with_a_manifest_needs_its_own_recipe(adapter: Path) -> None:
    (adapter / "policy.yml").write_text("inputs: {required: [state.arm_joint_state]}\n")
    assert recipes.find(package.load(adapter)) is None


def test_a_constant_of_another_type_is_named(adapter: Path, tmp_path: Path) -> None:
    path = tmp_path / "spec" / "zoo" / "tiny" / "Bare.py"
    path.write_text("import os\nSETTINGS = os.environ\n")
    with pytest.raises(UserError, match=r"Bare\.py:2: SETTINGS must be a literal dict"):
        recipes.find(package.load(adapter))


def test_an_input_is_measured_with_the_same_random_numbers(adapter: Path, tmp_path: Path) -> None:
    """An adapter that samples by a global generator would seem to read every input."""
    noise = MODEL.replace("np.tanh(state[:6] @ self.weights)", "np.tanh(0 * state[:6] + np.random.normal(0, 1, 6))")
    (adapter / "model.py").write_text(noise.format(read=READ))
    made = tiny.make(package.load(adapter), tmp_path / "made", tiny.TinyOptions())
    assert set(made.effects.values()) == {0.0}


@pytest.mark.parametrize(
    "path", sorted((content_folder("spec") / "zoo" / "tiny").glob("*.py")), ids=lambda path: path.stem
)
def test_every_recipe_of_the_zoo_can_be_read_without_its_libraries(path: Path) -> None:
    constants = recipes._constants(path)
    assert constants["REQUIREMENTS"]
    assert any("{folder}" in str(value) for value in constants["SETTINGS"].values())
    (write,) = (
        node
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef) and node.name == tiny.FUNCTION
    )
    assert [argument.arg for argument in write.args.args] == ["folder", "gain", "config"]
