"""Trains the network of Tiny_VLA on the data of process_data.py; `xpl train` runs it in the policy's Python.

A run that was cut goes on with the same command. What is drawn depends on seed and step alone, so that a run in parts
is the run in one, where `minutes` does not end it.
"""

from __future__ import annotations

import json
import math
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fit import Fit
from network import CAMERAS, SLOTS, pieces
from process_data import run_of

PEAK, WARM_UP = 6e-4, 300
STATE, GAIN, TINT, OFFSET, WORDS = 0.02, 0.15, 0.05, 12.0, 0.04
"""Augmentation strength: state (normalised), brightness, colour, offset, and filler words."""
LOG_STEPS, SAVE_S = 100, 60.0  # steps, seconds


def demonstrations(folder: Path, device: torch.device) -> dict[str, torch.Tensor]:
    """Return the prepared steps, with the command at which the gripper closes in each episode."""
    parts: dict[str, list[np.ndarray]] = {}
    sentences: dict[str, int] = {}
    for file in sorted(folder.glob("*.npz")):
        with np.load(file) as saved:
            found = {name: saved[name] for name in saved.files}
        starts = found.pop("starts").tolist()
        closed = [_closing(found["targets"][begin:end, 0]) for begin, end in zip(starts[:-1], starts[1:])]
        said = [sentences.setdefault(text, len(sentences)) for text in found.pop("instruction").tolist()]
        for name, values in {**found, "grasp": np.concatenate(closed), "said": np.array(said)}.items():
            parts.setdefault(name, []).append(values)
    if not parts:
        raise SystemExit(f"{folder} holds no windows: run `xpl prepare` with --set 'demonstrations=[FOLDER]' first")
    data = {name: torch.from_numpy(np.concatenate(values)).to(device) for name, values in parts.items()}
    return {**data, "sentences": torch.from_numpy(pieces(list(sentences))).to(device)}


def _closing(commands: np.ndarray) -> np.ndarray:
    """Return for each step (T, D) of an episode the command with which the gripper, the last number, first closes."""
    closes = np.flatnonzero(commands[:, -1] < 0)
    return np.repeat(commands[closes[:1] if len(closes) else [-1]], len(commands), 0)


def batch(data: dict[str, torch.Tensor], size: int, draw: torch.Generator) -> dict[str, torch.Tensor]:
    """Return an augmented batch: varied light, noisy state, and occasional filler words."""

    def drawn(*shape: int) -> torch.Tensor:
        return 2 * torch.rand(shape, generator=draw, device=draw.device) - 1

    rows = torch.randint(len(data["targets"]), (size,), generator=draw, device=draw.device)
    made = {name: data[name][rows] for name in ("state", "targets", "grasp")}
    made["state"] = made["state"] + STATE * drawn(*made["state"].shape)
    for camera in CAMERAS:
        light = 1 + GAIN * drawn(size, 1, 1, 1) + TINT * drawn(size, 1, 1, 3)
        made[camera] = data[camera][rows] * light + OFFSET * drawn(size, 1, 1, 1)
    words = data["sentences"][data["said"][rows]]
    others = torch.randint(1, SLOTS, words.shape, generator=draw, device=draw.device)
    made["instruction"] = torch.where(drawn(*words.shape[:2], 1).abs() < WORDS, others, words)
    return made


def main() -> None:
    """Train the network, and save it under the name of the run or `ckpt_name`."""
    config: dict[str, Any] = json.loads(os.environ["XPL_CONFIG"])
    run, seed, steps = run_of(config), int(config["seed"]), int(config["steps"])
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.manual_seed(seed)
    torch.set_float32_matmul_precision("high")
    data = demonstrations(Path("data") / (config["data"] or run), device)
    folder = Path("checkpoints") / run
    folder.mkdir(parents=True, exist_ok=True)
    fit = Fit({**config["network"], "chunk": data["targets"].shape[1], "dim": data["targets"].shape[2]}, device)
    fit.resume(folder)
    weights = sum(values.numel() for values in fit.network.parameters())
    print(
        f"{len(data['targets'])} steps, {len(data['sentences'])} sentences, {weights / 1e6:.2f} M weights", flush=True
    )
    begun, limit = time.monotonic() - fit.seconds, 60 * float(config["minutes"] or math.inf)
    saved, draw = fit.seconds, torch.Generator(device)
    while (progress := max(fit.step / steps, fit.seconds / limit)) < 1:
        rate = PEAK * min(1.0, (fit.step + 1) / WARM_UP) * (0.5 + 0.5 * math.cos(math.pi * progress))
        torch.manual_seed(seed * 1_000_003 + fit.step)  # of dropout
        drawn = batch(data, int(config["batch"]), draw.manual_seed(seed * 1_000_003 + fit.step))
        commands, grasp = fit.learn(drawn, rate)
        fit.seconds = time.monotonic() - begun
        if fit.step % LOG_STEPS == 1 or fit.step == steps:
            losses = {"step": fit.step, "commands": commands.item(), "grasp": grasp.item(), "rate": rate}
            line = json.dumps({**losses, "seconds": round(fit.seconds, 1)})
            print(line, flush=True)
            with (folder / "log.jsonl").open("a", encoding="utf-8") as log:
                log.write(f"{line}\n")
        if fit.seconds - saved > SAVE_S:
            fit.save(folder)
            saved = fit.seconds
    fit.save(folder)
    print(f"saved {folder}")


if __name__ == "__main__":
    main()
