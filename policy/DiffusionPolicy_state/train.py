"""Trains with LeRobot's own loss; `xpl train` runs it in the policy's Python. Killed at any moment, it goes on."""

from __future__ import annotations

import json
import math
import os
import time
from pathlib import Path
from typing import Any, TextIO

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy
from process_data import demonstrations, place

from xpl.training import Windows, windows

TOLD_EVERY, WARM_UP, AVERAGE = 100, 200, 0.999


class Data:
    """All windows on the device, images as bytes; vectors are shown with a little noise, as the robot strays, too."""

    def __init__(self, found: Windows, device: torch.device, noise: float) -> None:
        self.noise = noise
        self.inputs = {name: torch.as_tensor(value, device=device) for name, value in found.inputs.items()}
        self.pixels = {
            name: [torch.as_tensor(part, device=device) for part in (look.scale, look.low, look.mean, look.std)]
            for name, look in found.pixels.items()
        }
        self.seen, self.targets, self.padded = (
            torch.as_tensor(value, device=device) for value in (found.seen, found.targets, found.padded)
        )
        self.timed = found.timed

    def batch(self, rows: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return what LeRobot's `forward` takes."""
        result = {"action": self.targets[rows], "action_is_pad": self.padded[rows]}
        for name, values in self.inputs.items():
            picked = values[self.seen[rows]] if name in self.timed else values[rows]
            if name in self.pixels:
                scale, low, mean, std = self.pixels[name]
                picked = (picked.float() * scale + low - mean) / std
            elif self.noise:
                picked = picked + self.noise * torch.randn_like(picked)
            result[name] = picked
        return result


def main() -> None:  # noqa: PLR0915 - one training, from the top to the bottom
    """Train until the steps or the minutes are over, and write model.safetensors into the checkpoint."""
    config = json.loads(os.environ["XPL_CONFIG"])
    target, seed = place(config), config["seed"]
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    settings = PreTrainedConfig.from_pretrained(target)
    settings.device = device.type
    steps = settings.action_delta_indices
    found = windows(
        Path(__file__).parent,
        {**config, "ckpt_name": str(target.resolve())},
        demonstrations(config),
        horizon=len(steps),
        first=steps[0],
    )
    data = Data(found, device, config["noise"])
    torch.manual_seed(seed)
    torch.set_float32_matmul_precision("high")
    policy = DiffusionPolicy(settings).to(device).train()
    optimizer = settings.get_optimizer_preset().build(policy.get_optim_params())
    rates = [group["lr"] for group in optimizer.param_groups]
    average = [value.detach().clone() for value in policy.parameters()]
    kept = target / ".training.pt"
    step, spent, total = 0, 0.0, torch.zeros((), device=device)
    if kept.exists():
        state = torch.load(kept, map_location=device, weights_only=True)
        policy.load_state_dict(state["policy"])
        optimizer.load_state_dict(state["optimizer"])
        average, step, spent, total = state["average"], state["step"], state["spent"], state["total"]
    limit, minutes = config["steps"], config.get("minutes") or math.inf
    begun = saved = time.monotonic()
    before, log = spent, _curve(target / "log.jsonl", step)
    while step < limit and spent < minutes * 60:
        step += 1
        torch.manual_seed(seed * 1_000_003 + step)  # of each step by itself, so that a run that goes on draws the same
        rows = torch.randint(len(found), (config["batch"],)).to(device)
        share = max(step / limit, spent / (minutes * 60))
        for group, rate in zip(optimizer.param_groups, rates):
            group["lr"] = rate * min(1.0, step / WARM_UP) * (0.01 + 0.99 * (1 + math.cos(math.pi * share)) / 2)
        with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
            loss, _ = policy.forward(data.batch(rows))
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
        optimizer.step()
        torch._foreach_lerp_(
            average, [value.detach() for value in policy.parameters()], 1 - min(AVERAGE, step / (step + 9))
        )
        total += loss.detach()
        spent = before + time.monotonic() - begun
        if step % TOLD_EVERY == 0:
            told = {"step": step, "loss": round(total.item() / TOLD_EVERY, 6), "seconds": round(spent, 1)}
            print(json.dumps(told), file=log, flush=True)
            print(told, flush=True)
            total.zero_()
        if time.monotonic() - saved > config["save_every"]:
            saved = time.monotonic()
            state = {"policy": policy.state_dict(), "optimizer": optimizer.state_dict(), "average": average}
            state |= {"step": step, "spent": spent, "total": total}
            _whole(kept, lambda path: torch.save(state, path))  # noqa: B023
    for value, mean in zip(policy.parameters(), average):
        value.data.copy_(mean)
    _whole(target / "model.safetensors", lambda path: _save(policy, path))
    kept.unlink(missing_ok=True)
    print(f"{step} steps in {spent:.0f} s on {device.type}: {target / 'model.safetensors'}")


def _curve(path: Path, step: int) -> TextIO:
    """Open the curve, without what a killed run told after it was saved for the last time."""
    told = path.read_text().splitlines(keepends=True) if path.exists() else []
    kept = [line for line in told if line.endswith("\n") and json.loads(line)["step"] <= step]
    _whole(path, lambda part: part.write_text("".join(kept)))
    return path.open("a")


def _save(policy: Any, path: Path) -> None:
    from safetensors.torch import save_file

    save_file({name: value.contiguous().cpu() for name, value in policy.state_dict().items()}, path)


def _whole(path: Path, write: Any) -> None:
    """Write a file that is there whole or not at all."""
    part = path.with_name(f".{path.name}.part")
    write(part)
    part.replace(path)


if __name__ == "__main__":
    main()
