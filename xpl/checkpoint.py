"""Checkpoint resolution that never substitutes silently.

Order (source: adapter contract): an explicit path key; `ckpt_name` as a path;
`checkpoints/<bench_name>-<ckpt_name>-<env_cfg_type>-<action_type>-<seed>`; `checkpoints/<ckpt_name>`. Relative paths start
at the policy folder. A path that was given and does not exist is an error, never the next candidate.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Optional, Union

from xpl import _spec as spec


class CheckpointError(FileNotFoundError):
    """A checkpoint, or a step of it, that was asked for is not there."""


def resolve(config: Mapping[str, Any], policy_dir: Union[str, Path]) -> Path:
    """Return the checkpoint's file or folder.

    Args:
        config: values of deploy.yml after overrides; null means not given.
        policy_dir: folder that relative paths start at.

    Raises:
        CheckpointError: if nothing was given, or what was given does not exist; lists what was looked for.
    """
    base = Path(policy_dir)
    for key in spec.CHECKPOINT_KEYS:
        if config.get(key) is not None:
            return _existing(base / Path(str(config[key])).expanduser(), f"{key} is {config[key]!r}")
    name = config.get(spec.Deploy.CKPT_NAME)
    if name is None or str(name) == "":
        keys = ", ".join((*spec.CHECKPOINT_KEYS, spec.Deploy.CKPT_NAME))
        raise CheckpointError(f"no checkpoint is configured: set one of {keys} in deploy.yml or with --set")
    text = str(name)
    if _is_path(text):
        return _existing(base / Path(text).expanduser(), f"ckpt_name is the path {text!r}")
    folder = base / spec.CHECKPOINT_DIRECTORY
    candidates = [folder / run for run in (run_name(config), text) if run]
    for candidate in candidates:
        if candidate.exists():
            return candidate
    looked = ", ".join(str(candidate) for candidate in candidates)
    raise CheckpointError(f"ckpt_name {text!r} names no checkpoint: looked for {looked}")


def run_name(config: Mapping[str, Any]) -> Optional[str]:
    """Return the conventional run name, or None where a part of it is not configured."""
    parts = []
    for key in spec.CHECKPOINT_RUN_NAME:
        names = (key, *spec.CONFIG_ALIASES.get(key, ()))
        values = [config[name] for name in names if config.get(name) is not None]
        if not values:
            return None
        parts.append(str(values[0]))
    return "-".join(parts)


def resolve_step(root: Union[str, Path], step: Optional[int], pattern: str = r"(?:step_|checkpoint-|epoch_)?(\d+)") -> Path:
    """Return the entry of a checkpoint folder for one training step.

    Args:
        root: folder with one entry per saved step.
        step: the step, 0 included; None asks for the newest.
        pattern: regular expression that a whole entry name (without its suffix) matches; group 1 is the step.

    Raises:
        CheckpointError: if that step, or any step, is not there; lists the steps that are.
    """
    steps: dict[int, Path] = {}
    for entry in sorted(Path(root).iterdir()) if Path(root).is_dir() else []:
        found = re.fullmatch(pattern, entry.name if entry.is_dir() else entry.stem)
        if found:
            steps[int(found.group(1))] = entry
    if step is None and steps:
        return steps[max(steps)]
    if step is not None and step in steps:
        return steps[step]
    there = ", ".join(map(str, sorted(steps))) or "none"
    raise CheckpointError(f"{root} has no checkpoint of step {'(any)' if step is None else step}; there are: {there}")


def _is_path(name: str) -> bool:
    return "/" in name or "\\" in name or name.startswith(("~", "."))


def _existing(path: Path, why: str) -> Path:
    if not path.exists():
        raise CheckpointError(f"{why}, but {path} does not exist")
    return path
