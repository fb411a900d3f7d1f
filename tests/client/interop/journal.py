"""An adapter that notes what it gets and gives, so that a test can hold it against what the peer sent and got."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

CHUNK = 3

ADAPTER = '''
    """Random actions from the observation and its number in the episode; notes what came and what went."""
    import hashlib
    import json

    import numpy as np

    from xpl import Policy

    class Model(Policy):
        def load(self, config):
            self._journal = open(self.setting("journal", ""), "a", buffering=1, encoding="utf-8")
            self._asked = 0

        def _note(self, **entry):
            self._journal.write(json.dumps(entry) + "\\n")

        def reset(self):
            super().reset()
            self._asked = 0
            self._note(event="reset")

        def encode(self, obs, env):
            total = hashlib.sha256()
            arrays = [obs["state"][key] for key in ("arm_joint_state", "ee_joint_state", "ee_pose")]
            for array in [*arrays, obs["vision"]["cam_head"]["color"]]:
                total.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())
            return total.hexdigest(), obs["instruction"]

        def predict(self, inputs, envs):
            (digest, instruction), = inputs
            if instruction == "break":
                raise RuntimeError("the gripper is jammed")
            rng = np.random.default_rng([int(digest, 16), self._asked])
            raw = rng.uniform(0, 1, (1, self.chunk, 8)).astype(np.float32)
            self._note(event="infer", asked=self._asked, observed=digest, instruction=instruction,
                       actions=raw[0].tolist())
            self._asked += 1
            return raw

        def on_trial_end(self, result):
            self._note(event="trial_end", trial=result["trial_id"])
'''


class Journal:
    def __init__(self, folder: Path, notes: Path) -> None:
        self.folder, self.notes = folder, notes
        self.overrides = {"journal": str(notes)}

    def read(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.notes.read_text(encoding="utf-8").splitlines()]

    def events(self) -> list[str]:
        return [entry["event"] for entry in self.read()]
