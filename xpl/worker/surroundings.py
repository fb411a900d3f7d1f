"""What a process needs before it imports an adapter: variables, copies of hub repositories, a device that is there."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import checkpoint, hub, json_text, variables

if TYPE_CHECKING:
    from xpl.contract import Config


def prepare(policy_dir: Path, config: Config, environment: object) -> None:
    """Prepare this process for an adapter, before anything imports the authors' code.

    Args:
        policy_dir: folder of the adapter.
        config: its configuration, which names the checkpoint.
        environment: `environment` of policy.yml.
    """
    variables.set_declared(policy_dir, config, environment)
    hub.offer(policy_dir, config)
    tiny = checkpoint.tiny_folder(config, policy_dir)
    if tiny is None:
        return
    record = json_text.parse((tiny / checkpoint.TINY).read_text(encoding="utf-8"))
    set_of_recipe(record.get(checkpoint.VARIABLES, {}), tiny)
    if record.get(checkpoint.CUDA_ON_CPU):
        use_cpu_for_cuda()


def set_of_recipe(values: Mapping[str, str], folder: Path) -> None:
    """Set the environment variables of a recipe for a tiny checkpoint in this folder."""
    for name, value in values.items():
        os.environ[name] = value.replace("{folder}", str(folder))


def use_cpu_for_cuda() -> None:
    """Let the device `cuda` mean the CPU in this process."""
    from xpl.worker import cuda_on_cpu  # which imports torch

    cuda_on_cpu.enable()
