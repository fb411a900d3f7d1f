"""Trains policies of LeRobot: statistics in its own files, its own loss, and runs that resume after a kill.

A package calls this from two scripts of a line each, which `xpl prepare` and `xpl train` run in the policy's Python:

    lerobot.prepare(Path(__file__).parent, "act")     # process_data.py
    lerobot.train(Path(__file__).parent)              # train.py

Keys of deploy.yml: `demonstrations` (folders of trajectories), `episodes` (at most), `steps` and `minutes` (the first
limit that is reached ends a training), `save_every` (seconds), `batch`, `noise` (standard deviation of noise that is
added to normalised vectors) and `lerobot` (LeRobot's settings of the network).
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from xpl import _spec as spec
from xpl import json_text
from xpl.training.adapters import without_model
from xpl.training.numbers import ACTION, statistics
from xpl.training.reading import windows
from xpl.trajectory import Folder, open_files, open_folder

if TYPE_CHECKING:
    from xpl.contract import Config
    from xpl.training.windows import Windows

STILL = 1e-4
"""A value with a smaller range counts as constant, as in Diffusion Policy: rounding must not become a signal."""

LOG_EVERY, WARM_UP, AVERAGE = 100, 200, 0.999
"""Steps between lines of the loss curve, steps until the full learning rate, and the decay of the averaged weights."""

SCENE = "observation.environment_state"
_STATE_FILE = ".training.pt"
_IMAGES = "observation.images"


def prepare(package: Path, kind: str) -> None:
    """Write config.json and the processors with the numbers that `model_io.normalize` reads.

    Args:
        package: folder of the policy.
        kind: LeRobot's name of the policy, `act` or `diffusion`.
    """
    from lerobot.configs.types import PolicyFeature
    from lerobot.policies.factory import make_policy_config, make_pre_post_processors

    config = _config()
    settings = make_policy_config(kind, **{**config["lerobot"], "device": "cpu", "push_to_hub": False})
    steps = settings.action_delta_indices
    episodes = demonstrations(config)
    numbers = statistics(package, config, episodes, horizon=len(steps), first=steps[0])
    policy = without_model(package, config, normalized=False)
    with episodes[0] as episode:
        policy.update_obs({**episode.observation(0), spec.Obs.ENV_IDX: 0})
    inputs = policy.encodings(0)[-1]
    for image in policy.interface.images if policy.interface else ():
        _, _, mean, std = image.scaling
        numbers[image.name] = {"mean": mean, "std": std}
    settings.input_features = {name: PolicyFeature(_feature(name), np.shape(value)) for name, value in inputs.items()}
    settings.output_features = {ACTION: PolicyFeature(_feature(ACTION), numbers[ACTION]["mean"].shape)}
    tensors = {key: _tensors(_still(value) if "min" in value else value) for key, value in numbers.items()}
    target = checkpoint_folder(package, config)
    target.mkdir(parents=True, exist_ok=True)
    (target / _STATE_FILE).unlink(missing_ok=True)  # of a training with other statistics
    settings._save_pretrained(target)  # noqa: SLF001 - as LeRobot's own training does
    for pipeline in make_pre_post_processors(settings, dataset_stats=tensors):
        pipeline.save_pretrained(target)
    print(f"{len(episodes)} episodes, {int(numbers[ACTION]['count'][0])} steps: {target}")  # noqa: T201


def train(package: Path) -> None:
    """Train until the limit of steps or minutes, and write model.safetensors into the checkpoint.

    The learning rate follows a cosine that ends with the first limit. The saved weights are averaged ones. The same
    command resumes a run that was killed at any moment, and ends in the same weights.
    """
    import torch
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class  # also registers LeRobot's policy types

    config = _config()
    target = checkpoint_folder(package, config)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    settings = PreTrainedConfig.from_pretrained(target)
    settings.device = device.type
    steps = settings.action_delta_indices
    found = windows(
        package,
        {**config, spec.Deploy.CKPT_NAME: str(target.resolve())},
        demonstrations(config),
        horizon=len(steps),
        first=steps[0],
    )
    run = TrainingRun(
        get_policy_class(settings.type),
        settings,
        TrainingData(found, device, config["noise"]),
        config[spec.Deploy.SEED],
    )
    state_path = target / _STATE_FILE
    run.resume(state_path)
    limit, minutes = config["steps"], config.get("minutes") or math.inf
    begun = saved = time.monotonic()
    before = run.spent
    with _curve(target / "log.jsonl", run.step) as log:
        while run.step < limit and run.spent < minutes * 60:
            run.step += 1
            share = max(run.step / limit, run.spent / (minutes * 60))
            run.train_step(config["batch"], share)
            run.spent = before + time.monotonic() - begun
            if run.step % LOG_EVERY == 0:
                record = {"step": run.step, "loss": run.mean_loss(), "seconds": round(run.spent, 1)}
                print(json.dumps(record), file=log, flush=True)
                print(record, flush=True)  # noqa: T201
            if time.monotonic() - saved > config["save_every"]:
                saved = time.monotonic()
                run.save(state_path)
    run.finish(target / "model.safetensors")
    state_path.unlink(missing_ok=True)
    print(f"{run.step} steps in {run.spent:.0f} s on {device.type}: {target / 'model.safetensors'}")  # noqa: T201


def demonstrations(config: Config) -> Folder:
    """Return the data set that `demonstrations` of deploy.yml names; several are concatenated."""
    paths = config.get("demonstrations") or "../../demos"
    folders = [open_folder(Path(one).expanduser()) for one in ([paths] if isinstance(paths, str) else paths)]
    return open_files([one.path for folder in folders for one in folder][: config.get("episodes")])


def checkpoint_folder(package: Path, config: Config) -> Path:
    """Return the folder from which the adapter loads its checkpoint."""
    return package / spec.CHECKPOINT_DIRECTORY / str(config["run_name"] or config[spec.Deploy.CKPT_NAME])


class TrainingData:
    """All windows on the device, images as uint8; noise is added to vectors, because a robot deviates, too."""

    def __init__(self, windows: Windows, device: Any, noise: float) -> None:
        import torch

        self.device, self.noise = device, noise
        self.inputs = {name: torch.as_tensor(value, device=device) for name, value in windows.inputs.items()}
        self.pixels = {
            name: [torch.as_tensor(part, device=device) for part in (look.span, look.low, look.mean, look.std)]
            for name, look in windows.pixels.items()
        }
        self.history_rows = {
            name: torch.as_tensor(value, device=device) for name, value in windows.history_rows.items()
        }
        self.targets, self.padded = (
            torch.as_tensor(value, device=device) for value in (windows.targets, windows.padded)
        )

    def batch(self, rows: Any) -> dict[str, Any]:
        """Return the argument of LeRobot's `forward` for rows, a tensor (B,)."""
        import torch

        result = {ACTION: self.targets[rows], "action_is_pad": self.padded[rows]}
        for name, values in self.inputs.items():
            picked = values[self.history_rows[name][rows]] if name in self.history_rows else values[rows]
            if name in self.pixels:
                span, low, mean, std = self.pixels[name]
                picked = (picked.float() * span / 255 + low - mean) / std
            elif self.noise:
                picked = picked + self.noise * torch.randn_like(picked)
            result[name] = picked
        return result


class TrainingRun:
    """Network, optimizer, averaged weights and progress of a training."""

    def __init__(self, network: Any, settings: Any, data: TrainingData, seed: int) -> None:
        import torch

        torch.manual_seed(seed)
        torch.set_float32_matmul_precision("high")
        self.data, self.seed, self.device = data, seed, data.device
        self.policy = network(settings).to(self.device).train()
        _calibrate(self.policy, data)
        self.optimizer = settings.get_optimizer_preset().build(self.policy.get_optim_params())
        self.rates = [group["lr"] for group in self.optimizer.param_groups]
        self.average = [value.detach().clone() for value in self.policy.parameters()]
        self.step, self.spent, self.total = 0, 0.0, torch.zeros((), device=self.device)

    def resume(self, path: Path) -> None:
        """Load the state of a saved run, if there is one."""
        import torch

        if not path.exists():
            return
        state = torch.load(path, map_location=self.device, weights_only=True)
        self.policy.load_state_dict(state["policy"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.average, self.step, self.spent, self.total = (
            state[name] for name in ("average", "step", "spent", "total")
        )

    def save(self, path: Path) -> None:
        """Write the state that `resume` loads."""
        import torch

        state = {"policy": self.policy.state_dict(), "optimizer": self.optimizer.state_dict(), "average": self.average}
        state |= {"step": self.step, "spent": self.spent, "total": self.total}
        _write_atomically(path, lambda part: torch.save(state, part))

    def train_step(self, batch: int, share: float) -> None:
        """Do a step.

        Args:
            batch: batch size.
            share: completed share of the training, 0 to 1, which sets the learning rate.
        """
        import torch

        # Each step has its own seed, so that a resumed run draws the same numbers.
        torch.manual_seed(self.seed * 1_000_003 + self.step)
        rows = torch.randint(len(self.data.targets), (batch,)).to(self.device)
        for group, rate in zip(self.optimizer.param_groups, self.rates):
            group["lr"] = rate * min(1.0, self.step / WARM_UP) * (0.01 + 0.99 * (1 + math.cos(math.pi * share)) / 2)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.device.type == "cuda"):
            loss, _ = self.policy.forward(self.data.batch(rows))
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.policy.parameters(), 10.0)
        self.optimizer.step()
        now = [value.detach() for value in self.policy.parameters()]
        share_of_new = 1 - min(AVERAGE, self.step / (self.step + 9))
        torch._foreach_lerp_(self.average, now, share_of_new)
        self.total += loss.detach()

    def mean_loss(self) -> float:
        """Return the mean loss since the last call."""
        loss: float = round(self.total.item() / LOG_EVERY, 6)
        self.total.zero_()
        return loss

    def finish(self, path: Path) -> None:
        """Write the averaged weights."""
        from safetensors.torch import save_file

        for value, mean in zip(self.policy.parameters(), self.average):
            value.data.copy_(mean)
        weights = {name: value.contiguous().cpu() for name, value in self.policy.state_dict().items()}
        _write_atomically(path, lambda part: save_file(weights, part))


def _calibrate(policy: Any, data: TrainingData) -> None:
    """Set the statistics of LeRobot's frozen batch norms, made for an ImageNet backbone, to those of these images."""
    import torch

    frozen = [one for one in policy.modules() if type(one).__name__ == "FrozenBatchNorm2d"]

    def measure(module: Any, given: tuple[Any, ...]) -> None:
        module.running_var.copy_(given[0].var((0, 2, 3)))
        module.running_mean.copy_(given[0].mean((0, 2, 3)))

    hooks = [one.register_forward_pre_hook(measure) for one in frozen]
    if frozen:
        with torch.no_grad():
            policy.forward(data.batch(torch.randperm(len(data.targets))[:128].to(data.device)))
    for hook in hooks:
        hook.remove()


def _config() -> dict[str, Any]:
    config: dict[str, Any] = json_text.parse(os.environ["XPL_CONFIG"])
    return config


def _feature(name: str) -> Any:
    from lerobot.configs.types import FeatureType

    if name.startswith(_IMAGES):
        return FeatureType.VISUAL
    return {SCENE: FeatureType.ENV, ACTION: FeatureType.ACTION}.get(name, FeatureType.STATE)


def _still(numbers: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    still = numbers["max"] - numbers["min"] < STILL
    changed: dict[str, Any] = {"std": 1.0, "min": numbers["mean"] - 1, "max": numbers["mean"] + 1}
    return {**numbers, **{key: np.where(still, value, numbers[key]) for key, value in changed.items()}}


def _tensors(numbers: Mapping[str, np.ndarray]) -> dict[str, Any]:
    import torch

    return {key: torch.as_tensor(np.asarray(value, np.float32)) for key, value in numbers.items()}


def _curve(path: Path, step: int) -> TextIO:
    """Open the log of the loss curve, without lines that a killed run wrote after its last save."""
    lines = path.read_text().splitlines(keepends=True) if path.exists() else []
    complete = [line for line in lines if line.endswith("\n") and json_text.parse(line)["step"] <= step]
    _write_atomically(path, lambda part: part.write_text("".join(complete)))
    return path.open("a")


def _write_atomically(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file atomically: it exists complete, or not at all."""
    part = path.with_name(f".{path.name}.part")
    write(part)
    part.replace(path)
