"""Adapters that were written without the SDK, loaded with stand-ins in a process of their own."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

from tests.support.peer import DEADLINE_S

REPO = Path(__file__).parents[3]

ADAPTER = """
    import json, os, sys
    from pathlib import Path
    sys.path.insert(0, str(Path(__file__).parent))
    import torch
    from absentlib import AutoProcessor
    from network.policy import Policy, HORIZON

    HERE = Path(__file__).parent

    class Model:
        def __init__(self, config):
            folder = HERE / "checkpoints" / config["ckpt_name"]
            steps = sorted(name for name in os.listdir(folder) if name.startswith("checkpoint-"))
            if not steps or not (folder / steps[-1] / "model.safetensors").is_file():
                raise FileNotFoundError(folder)
            with open(folder / "dataset_statistics.json") as file:
                self.mean = torch.tensor(json.load(file)["state"]["mean"])
            self.policy = Policy.from_pretrained(str(folder / steps[-1])).to(torch.bfloat16).cuda().eval()
            self.processor = AutoProcessor.from_pretrained("absent/model")
            self.horizon = HORIZON

        def update_obs(self, obs):
            state = (torch.from_numpy(obs["state"]) - self.mean).unsqueeze(0)
            self.inputs = {**self.processor(text=obs["instruction"], return_tensors="pt"), "state": state.cuda()}

        @torch.inference_mode()
        def get_action(self):
            chunk = self.policy.predict_action(**self.inputs)[0, : self.horizon]
            return chunk.float().cpu().numpy()

        def reset(self):
            self.inputs = None
"""
NETWORK = """
    import torch
    HORIZON = 5
    class Policy(torch.nn.Module):
        def __init__(self):
            raise RuntimeError("a network is not built here")
"""
RUN = """
    import json, os, sys
    import numpy as np
    from pathlib import Path
    from xpl.worker.standins.kit import Kit
    config = {"env_cfg_type": "arx_x5", "action_type": "joint", "ckpt_name": "run", "chunk_size": 8}
    kit = Kit(Path(sys.argv[1]), config)
    model = kit.built()
    def act(state, text):
        model.update_obs({"state": np.full(14, state, np.float32), "instruction": text})
        return np.asarray(model.get_action(), float).tolist()
    answers = [act(0.1, "pick it up"), act(0.1, "pick it up"), act(0.2, "pick it up"), act(0.1, "put it down")]
    print(json.dumps({"names": kit.names, "answers": answers, "left": sorted(os.listdir(sys.argv[1]))}))
"""


def _ran(code: str, folder: Path, *path: Path) -> Any:
    command = [sys.executable, "-c", textwrap.dedent(code), str(folder)]
    environment = {"PYTHONPATH": ":".join(map(str, (REPO, *path))), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=DEADLINE_S)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_an_adapter_answers_without_its_weights_and_libraries(tmp_path: Path) -> None:
    """It reads what is not there, nothing is written beside it, and all that it is shown counts."""
    folder = tmp_path / "Subject"
    (folder / "network").mkdir(parents=True)
    (folder / "model.py").write_text(textwrap.dedent(ADAPTER))
    (folder / "network" / "policy.py").write_text(textwrap.dedent(NETWORK))
    told = _ran(RUN, folder)
    first, again, *others = told["answers"]
    assert (len(first), len(first[0])) == (5, 14)
    assert first == again
    assert first not in others
    assert others[0] != others[1]
    assert {"torch", "network", "absentlib"} <= set(told["names"])
    assert told["left"] == ["model.py", "network"]


def test_a_package_says_more_of_a_library(tmp_path: Path) -> None:
    """The example of the documentation, installed."""
    blocks = re.findall(r"```\w+ title=\"(.+?)\"\n(.*?)```", (REPO / "docs" / "shadow.md").read_text(), re.DOTALL)
    files = dict(blocks)
    site, folder = tmp_path / "site", tmp_path / "Subject"
    (site / "my_standins-1.dist-info").mkdir(parents=True)
    folder.mkdir()
    (site / "my_standins.py").write_text(files["my_standins.py"])
    group, entry = files["pyproject.toml"].split("\n", 1)
    name, value = entry.strip().split(" = ")
    (site / "my_standins-1.dist-info" / "entry_points.txt").write_text(
        f"[{group.strip('[]').rpartition('.')[2]}]\n{name} = {json.loads(value)}\n"
    )
    (site / "my_standins-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: my-standins\nVersion: 1\n")
    (folder / "model.py").write_text(
        "from followlib import HORIZON, Tracker\n"
        "class Model:\n"
        "    def __init__(self, config): self.tracker, self.reset = Tracker(config), lambda: self.tracker.reset()\n"
        "    def update_obs(self, obs): self.step = self.tracker.step(obs['state'][:1])\n"
        "    def get_action(self): return [float(self.step[0]), HORIZON]\n"
    )
    told = _ran(RUN, folder, site)
    assert [round(step, 3) for step, _ in told["answers"]] == [0.1, 0.1, 0.133, 0.133]
    assert {horizon for _, horizon in told["answers"]} == {8}
    assert told["names"] == ["followlib"]
