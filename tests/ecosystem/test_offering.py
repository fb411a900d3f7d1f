"""Adapters of the ecosystem load as they stand: in a real checkout, and copied out of it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.checkout import ROOT
from xpl.ecosystem import scripts
from xpl.ecosystem.offered import checkpoint_resolver, process_data
from xpl.embodiment import embodiment_names, get_embodiment

ADAPTER = """
    from XPolicyLab.model_template import ModelTemplate
    from XPolicyLab.utils.process_data import get_robot_action_dim_info
    import vendored
    import XPolicyLab

    class Model(ModelTemplate):
        def __init__(self, config):
            self.told = [ModelTemplate.__module__, get_robot_action_dim_info(config["env_cfg_type"]), vendored.NAME]
            self.told += [str(list(XPolicyLab.__path__))]
"""
SERVER = """#!/bin/bash
HERE="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
UPSTREAM="${UPSTREAM:-${HERE}/upstream}"
export PYTHONPATH="${UPSTREAM}/src:${HERE}/../../..:/usr/lib:${PYTHONPATH:-}"
"""
REAL = """
    import json, os
    def get_robot_action_dim_info(env_cfg_type):
        folder = os.path.join(os.path.dirname(__file__), "../../env_cfg")
        robot = open(os.path.join(folder, f"{env_cfg_type}.yml")).read().split("robot: ")[1].split()[0]
        with open(os.path.join(folder, "robot", "_robot_info.json")) as file:
            return {"real": json.load(file)[robot]}
"""


def _write(path: Path, text: str) -> None:
    import textwrap

    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(textwrap.dedent(text), encoding="utf-8")


def _adapter(folder: Path) -> Path:
    _write(folder / "model.py", ADAPTER)
    _write(folder / "setup_eval_policy_server.sh", SERVER)
    _write(folder / "upstream/src/vendored.py", "NAME = 'as the script says'")
    return folder


def _told(adapter: Path) -> Any:
    code = (
        "import json, sys; from pathlib import Path; from xpl.worker.loading import load_model_class\n"
        "model = load_model_class(Path(sys.argv[1]))({'env_cfg_type': 'dual_x5'})\n"
        "import xpl, xpl.client; print(json.dumps([*model.told, xpl.client.__file__]))"
    )
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{code}", str(adapter)]
    done = subprocess.run(command, capture_output=True, check=False, cwd=adapter.parent)
    assert not done.returncode, done.stderr.decode()
    return json.loads(done.stdout)


def test_a_copied_adapter_gets_the_ecosystem_from_us(tmp_path: Path) -> None:
    """Its robot comes from the standard, and its upstream code from where its script says."""
    module, robot, vendored, _, _ = _told(_adapter(tmp_path / "policy/Copied"))
    assert module == "XPolicyLab.model_template"
    assert robot == {"arm_dim": [6, 6], "ee_dim": [1, 1]}
    assert vendored == "as the script says"


def test_a_real_checkout_is_used_and_hides_nothing(tmp_path: Path) -> None:
    """Also in a folder that is called as the SDK is; where the benchmark's `env_cfg` lacks, the standard answers."""
    root = tmp_path / "xpl"
    _write(root / "__init__.py", "raise RuntimeError('this is not the SDK')")
    _write(root / "model_template.py", "class ModelTemplate: pass")
    _write(root / "utils/process_data.py", REAL)
    _, robot, _, places, sdk = _told(_adapter(root / "policy/There"))
    assert robot == {"real": {"arm_dim": [6, 6], "ee_dim": [1, 1]}}
    assert str(root) in places
    assert sdk.startswith(str(ROOT))


def test_an_env_cfg_that_exists_is_not_hidden(tmp_path: Path) -> None:
    root = tmp_path / "XPolicyLab"
    _write(root / "model_template.py", "class ModelTemplate: pass")
    _write(root / "utils/process_data.py", REAL)
    _write(tmp_path / "env_cfg/dual_x5.yml", "config:\n  robot: mine")
    _write(tmp_path / "env_cfg/robot/_robot_info.json", '{"mine": 7}')
    assert _told(_adapter(root / "policy/There"))[1] == {"real": 7}


@pytest.mark.parametrize("name", embodiment_names())
@pytest.mark.parametrize("action_type", ["joint", "ee"])
def test_states_are_packed_and_unpacked_by_the_names_of_the_standard(name: str, action_type: str) -> None:
    robot = process_data.get_robot_action_dim_info(name)
    dims = get_embodiment(name).dims(action_type)
    flat = np.arange(float(sum(dims.values())))
    state = process_data.unpack_robot_state(flat, action_type, robot)
    assert {key: len(value) for key, value in state.items()} == dims
    assert np.array_equal(process_data.pack_robot_state({"state": state}, action_type, robot), flat)
    chunk = process_data.unpack_robot_state(np.stack([flat, flat]), action_type, robot)
    assert [list(step) for step in chunk] == [list(dims)] * 2
    with pytest.raises(ValueError, match="must have"):
        process_data.unpack_robot_state(flat[1:], action_type, robot)


def test_a_checkpoint_that_is_nowhere_is_never_another(tmp_path: Path) -> None:
    config = {"bench_name": "b", "ckpt_name": "c", "env_cfg_type": "e", "action_type": "joint", "seed": 0}
    (tmp_path / "checkpoints/c").mkdir(parents=True)
    folder = tmp_path / "checkpoints"
    assert checkpoint_resolver.resolve_checkpoint_root(config, folder) == folder / "c"
    (folder / "b-c-e-joint-0").mkdir()
    assert checkpoint_resolver.resolve_checkpoint_root(config, folder) == folder / "b-c-e-joint-0"
    with pytest.raises(FileNotFoundError, match="b-d-e-joint-0"):
        checkpoint_resolver.resolve_checkpoint_root({**config, "ckpt_name": "d"}, folder)


def test_scripts_are_read_as_far_as_they_are_understood(tmp_path: Path) -> None:
    for name in ("up/src/pkg", "tools", "other"):
        _write(tmp_path / name / "__init__.py", "")
    _write(tmp_path / "up/pyproject.toml", "")
    _write(
        tmp_path / "install.sh", 'cd up && echo\ncd "$(dirname "$0")/up"\npip install -e \'.[all]\'\npip install numpy'
    )
    _write(
        tmp_path / "setup_eval_policy_server.sh",
        """
        SCRIPT_DIR="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
        ROOT="$(cd "${SCRIPT_DIR}/../.." && pwd)"
        # export PYTHONPATH="${SCRIPT_DIR}/other"
        env PYTHONPATH="${SCRIPT_DIR}/tools:${ROOT}:${UNKNOWN}/x:${PYTHONPATH:-}" python server.py
        """,
    )
    assert scripts.python_path(tmp_path) == [tmp_path / "tools", tmp_path / "up/src"]
