"""State of a training run of Tiny_VLA: network, moving average of its weights, optimizer; saved and resumed."""

from __future__ import annotations

from pathlib import Path

import torch
from network import Network, write
from safetensors import safe_open
from safetensors.torch import save_file
from torch.nn.functional import l1_loss

DECAY, AVERAGE = 0.02, 0.999
GRASP = 0.5  # loss weight of predicting the joints at which the gripper closes
SERVED, TRAINING_STATE = "model.safetensors", "training.safetensors"


class Fit:
    """A network in training, and the moving average of its weights, which is served.

    Args:
        sizes: of the network.
        device: where it is fitted.

    Attributes:
        step: steps that were taken.
        seconds: that they took.
    """

    def __init__(self, sizes: dict[str, int], device: torch.device) -> None:
        self.sizes, self.device = sizes, device
        self.network = Network(**sizes).to(device).train()
        self.average = {name: values.detach().clone() for name, values in self.network.state_dict().items()}
        self.optimizer = torch.optim.AdamW(self.network.parameters(), weight_decay=DECAY, betas=(0.9, 0.99))
        self.step, self.seconds = 0, 0.0

    def learn(self, batch: dict[str, torch.Tensor], rate: float) -> tuple[torch.Tensor, torch.Tensor]:
        """Take an optimizer step on a batch; return its losses: of actions, and of the joints at gripper closing."""
        inputs = {name: values for name, values in batch.items() if name not in ("targets", "grasp")}
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.device.type == "cuda"):
            chunks, closing = self.network(**inputs)
        commands = l1_loss(chunks.float(), batch["targets"])
        grasp = l1_loss(closing.float()[:, :-1], batch["grasp"][:, :-1])
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.optimizer.zero_grad(set_to_none=True)
        (commands + GRASP * grasp).backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimizer.step()
        self.step += 1
        with torch.no_grad():
            new = 1 - min(AVERAGE, self.step / (self.step + 9))
            torch._foreach_lerp_(list(self.average.values()), list(self.network.state_dict().values()), new)
        return commands.detach(), grasp.detach()

    def save(self, folder: Path) -> None:
        """Write the served weights and the state for resuming, each file atomically."""
        write(self.average, self.sizes, folder / SERVED)
        tensors = {f"now/{name}": values for name, values in self.network.state_dict().items()}
        tensors |= {f"average/{name}": values for name, values in self.average.items()}
        for index, state in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer/{index}/{name}": values for name, values in state.items()}
        metadata = {"step": str(self.step), "seconds": str(self.seconds)}
        part = folder / f"{TRAINING_STATE}.part"
        save_file({name: values.contiguous().cpu() for name, values in tensors.items()}, part, metadata)
        part.replace(folder / TRAINING_STATE)

    def resume(self, folder: Path) -> None:
        """Resume from the saved state, if there is one."""
        if not (folder / TRAINING_STATE).is_file():
            return
        with safe_open(folder / TRAINING_STATE, "pt", device=str(self.device)) as file:
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no map
            metadata = file.metadata()
        self.network.load_state_dict({name: state[f"now/{name}"] for name in self.average})
        self.average = {name: state[f"average/{name}"] for name in self.average}
        states: dict[int, dict[str, torch.Tensor]] = {}
        for name, values in state.items():
            if name.startswith("optimizer/"):
                _, index, key = name.split("/")
                states.setdefault(int(index), {})[key] = values.cpu() if key == "step" else values
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": states})
        self.step, self.seconds = int(metadata["step"]), float(metadata["seconds"])
