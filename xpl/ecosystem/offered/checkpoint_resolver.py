"""Candidate paths of a checkpoint, by the function names that adapters call; `xpl.checkpoint` defines the order."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl import checkpoint
from xpl.checkpoint import CheckpointError

if TYPE_CHECKING:
    from xpl.contract import Config

DEFAULT_EXPLICIT_KEYS = tuple(spec.CHECKPOINT_KEYS)


def ckpt_name_is_path(ckpt_name: Any) -> bool:
    """Tell whether `ckpt_name` has the form of a path: absolute, or with a separator."""
    text = _text(ckpt_name)
    return "/" in text or os.sep in text or text.startswith("~")


def build_run_dir_name(model_cfg: Config, *, include_seed: bool = True) -> str | None:
    """Return the conventional name of a run, None where a part of it is not configured."""
    if include_seed:
        return checkpoint.run_name(model_cfg)
    whole = checkpoint.run_name({**model_cfg, spec.Deploy.SEED: 0})
    return None if whole is None else whole.rpartition("-")[0]


def candidate_checkpoint_roots(  # noqa: PLR0913 - as adapters call it
    model_cfg: Config,
    checkpoints_dir: Any,
    *,
    policy_dir: Any = None,
    explicit_keys: Sequence[str] = DEFAULT_EXPLICIT_KEYS,
    include_seed: bool = True,
    resolve: bool = True,
) -> list[Path]:
    """Return the candidate paths of a checkpoint, first choice first, each once, whether they exist or not.

    Args:
        model_cfg: configuration of the model.
        checkpoints_dir: folder of checkpoints, which the run name and `ckpt_name` are relative to.
        policy_dir: folder that other relative paths start from; the parent of `checkpoints_dir` by default.
        explicit_keys: keys of the configuration that hold a path; they come first.
        include_seed: whether the run name ends with the seed.
        resolve: whether paths are made absolute, with symbolic links resolved.
    """
    folder = Path(checkpoints_dir)
    base = folder.parent if policy_dir is None else Path(policy_dir)
    found = [base / Path(_text(model_cfg[key])).expanduser() for key in explicit_keys if _text(model_cfg.get(key))]
    name = _text(model_cfg.get(spec.Deploy.CKPT_NAME))
    if ckpt_name_is_path(name):
        found.append(base / Path(name).expanduser())
    else:
        run = build_run_dir_name(model_cfg, include_seed=include_seed)
        found += [folder / part for part in (run, name) if part]
    return list(dict.fromkeys(path.resolve() if resolve else path for path in found))


def resolve_checkpoint_root(  # noqa: PLR0913 - as adapters call it
    model_cfg: Config,
    checkpoints_dir: Any,
    *,
    policy_dir: Any = None,
    explicit_keys: Sequence[str] = DEFAULT_EXPLICIT_KEYS,
    include_seed: bool = True,
    must_exist: bool = True,
) -> Path:
    """Return the first candidate path that exists.

    Args:
        model_cfg: configuration of the model.
        checkpoints_dir: folder of checkpoints, which the run name and `ckpt_name` are relative to.
        policy_dir: folder that other relative paths start from; the parent of `checkpoints_dir` by default.
        explicit_keys: keys of the configuration that hold a path; they come first.
        include_seed: whether the run name ends with the seed.
        must_exist: whether a missing checkpoint is an error; if not, the first candidate is returned.

    Raises:
        CheckpointError: no candidate exists and `must_exist` is set, or the configuration names no checkpoint.
    """
    places = candidate_checkpoint_roots(
        model_cfg, checkpoints_dir, policy_dir=policy_dir, explicit_keys=explicit_keys, include_seed=include_seed
    )
    for place in places:
        if place.exists():
            return place
    if places and not must_exist:
        return places[0]
    looked = ", ".join(map(str, places)) or f"nowhere: none of {', '.join(explicit_keys)} and ckpt_name is set"
    raise CheckpointError(f"there is no checkpoint; looked for {looked}")


def _text(value: Any) -> str:
    return "" if value is None else str(value).strip()
