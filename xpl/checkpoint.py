"""Checkpoint resolution that never substitutes silently.

Order (source: adapter contract): an explicit path key; `ckpt_name` as a path;
`checkpoints/<bench_name>-<ckpt_name>-<env_cfg_type>-<action_type>-<seed>`; `checkpoints/<ckpt_name>`. Relative paths
start at the policy folder. A configured path that does not exist is an error; the next candidate is not tried.
`ckpt_name` counts as a path if it has a path's form (`./x`, `a/b`, `~`); a bare name may also be an entry of the
policy folder.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import _spec as spec

if TYPE_CHECKING:
    from xpl.contract import Config


TINY: Final = "tiny.json"
"""Record in a tiny random checkpoint that xpl made."""
CUDA_ON_CPU: Final = "cuda_on_cpu"
"""In that record: whether the adapter names the GPU in its code and is run on the CPU."""
VARIABLES: Final = "variables"
"""In that record: environment variables of the adapter's process; `{folder}` stands for the checkpoint's folder."""
_DEPTH: Final = 3
"""Folders between a file that a key names and its checkpoint."""


class CheckpointError(FileNotFoundError):
    """The configured checkpoint, or its step, does not exist."""


def resolve(config: Config, policy_dir: str | Path) -> Path:
    """Return the checkpoint's file or folder.

    Args:
        config: values of deploy.yml after overrides; null or empty means not set.
        policy_dir: folder that relative paths start at.

    Raises:
        CheckpointError: nothing is configured, or it does not exist; lists the paths tried.
    """
    base = Path(policy_dir)
    for key in spec.CHECKPOINT_KEYS:
        if _is_set(config.get(key)):
            return _require_existing(base / Path(str(config[key])).expanduser(), f"{key} is {config[key]!r}")
    name = config.get(spec.Deploy.CKPT_NAME)
    if not _is_set(name):
        keys = ", ".join((*spec.CHECKPOINT_KEYS, spec.Deploy.CKPT_NAME))
        raise CheckpointError(f"no checkpoint is configured: set one of {keys} in deploy.yml or with --set")
    text = str(name)
    if _is_path(text):
        return _require_existing(base / Path(text).expanduser(), f"ckpt_name is the path {text!r}")
    folder = base / spec.CHECKPOINT_DIRECTORY
    candidates = [base / text, *(folder / run for run in (run_name(config), text) if run)]
    for candidate in candidates:
        if candidate.exists():
            return candidate
    looked = ", ".join(str(candidate) for candidate in candidates)
    raise CheckpointError(
        f"ckpt_name {text!r} names no checkpoint: tried {looked}; "
        "`xpl checkpoint fetch` downloads what policy.yml specifies"
    )


def folders(config: Config, policy_dir: str | Path) -> list[Path]:
    """Return the folders of a model's files, such as statistics: the policy's folder, and its checkpoint's.

    Args:
        config: values of deploy.yml after overrides.
        policy_dir: the policy's folder; the only one if there is no checkpoint.
    """
    base = Path(policy_dir)
    try:
        path = resolve(config, base)
    except CheckpointError:
        tiny = tiny_folder(config, base)
        return [base] if tiny is None else [base, tiny]
    return [base, path if path.is_dir() else path.parent]


def tiny_folder(config: Config, policy_dir: str | Path) -> Path | None:
    """Return the folder of the tiny random checkpoint that a configuration names, by whichever key.

    Args:
        config: values of deploy.yml after overrides.
        policy_dir: the policy's folder; relative paths start there.
    """
    named = [Path(policy_dir, value) for value in config.values() if isinstance(value, str) and "/" in value]
    with contextlib.suppress(CheckpointError):
        named.append(resolve(config, policy_dir))
    above = (folder for path in named for folder in (path, *path.parents[:_DEPTH]))
    return next((folder for folder in above if (folder / TINY).is_file()), None)


def run_name(config: Config) -> str | None:
    """Return the conventional run name, or None if a part of it is not configured."""
    parts = []
    for key in spec.CHECKPOINT_RUN_NAME:
        names = (key, *spec.CONFIG_ALIASES.get(key, ()))
        values = [config[name] for name in names if _is_set(config.get(name))]
        if not values:
            return None
        parts.append(str(values[0]))
    return "-".join(parts)


def resolve_step(root: str | Path, step: int | None, pattern: str = r"(?:step_|checkpoint-|epoch_)?(\d+)") -> Path:
    """Return the entry of a checkpoint folder for one training step.

    Args:
        root: folder with one entry per saved step.
        step: the training step, at least 0; None for the newest.
        pattern: regular expression of a whole entry name (without its suffix); group 1 is the step.

    Raises:
        CheckpointError: the step, or any step, does not exist (lists those that do); or several entries have it.
    """
    steps: dict[int, list[Path]] = {}
    for entry in sorted(Path(root).iterdir()) if Path(root).is_dir() else []:
        match = re.fullmatch(pattern, entry.name if entry.is_dir() else entry.stem)
        if match:
            steps.setdefault(int(match.group(1)), []).append(entry)
    selected = max(steps, default=None) if step is None else step
    if selected is None or selected not in steps:
        available = ", ".join(map(str, sorted(steps))) or "none"
        raise CheckpointError(
            f"{root} has no checkpoint of step {'(any)' if step is None else step}; there are: {available}"
        )
    entries = steps[selected]
    if len(entries) > 1:
        names = ", ".join(entry.name for entry in entries)
        raise CheckpointError(f"{root} has several entries of step {selected}: {names}; keep one, or name its path")
    return entries[0]


def _is_set(value: object) -> bool:
    return value is not None and value != ""


def _is_path(name: str) -> bool:
    return "/" in name or "\\" in name or name.startswith(("~", "."))


def _require_existing(path: Path, why: str) -> Path:
    if not path.exists():
        raise CheckpointError(f"{why}, but {path} does not exist")
    return path
