"""Makes training windows of recorded episodes, with the conversions of serving.

`xpl prepare policy/Tiny_VLA --set 'demonstrations=[FOLDER, ...]'` runs it. Folders are prepared side by side.
"""

from __future__ import annotations

import json
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from xpl import training
from xpl.trajectory import open_folder

CHUNK = 16
"""Action horizon of the network; model_io.action.steps is how many actions are executed."""


def prepare(config: dict[str, Any], folder: str, target: Path) -> str:
    """Write the windows of a folder's episodes to a file, and return a summary."""
    windows = training.windows(".", config, open_folder(folder), horizon=CHUNK)
    head, wrist, state, said = (np.asarray(windows.inputs[name]) for name in ("head", "wrist", "state", "instruction"))
    part = target.with_suffix(".part")
    with part.open("wb") as file:
        np.savez(
            file, head=head, wrist=wrist, state=state, instruction=said, targets=windows.targets, starts=windows.starts
        )
    part.replace(target)
    return f"{folder}: {len(windows.starts) - 1} episodes, {len(windows)} steps"


def run_of(config: dict[str, Any]) -> str:
    """Return the name of a run's data and checkpoints."""
    name = str(config["run_name"] or config["ckpt_name"])
    if "/" in name:
        raise SystemExit(f"{name} is a checkpoint that is there already: name your run, with --set ckpt_name=NAME")
    return name


def main() -> None:
    """Prepare every folder of `demonstrations`."""
    config = json.loads(os.environ["XPL_CONFIG"])
    data, folders = Path("data") / run_of(config), config["demonstrations"]
    if not folders:
        raise SystemExit("demonstrations names no folder: --set 'demonstrations=[FOLDER, ...]'")
    data.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(max_workers=min(len(folders), os.cpu_count() or 1)) as pool:
        jobs = [pool.submit(prepare, config, folder, data / f"{place:03d}.npz") for place, folder in enumerate(folders)]
        for job in jobs:
            print(job.result(), flush=True)


if __name__ == "__main__":
    main()
