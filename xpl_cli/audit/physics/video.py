"""Videos of the episodes of the MuJoCo gate, one file for each."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.environments.film import FORMATS, FilmRecorder

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from xpl_cli.audit.physics.rollout import LoopEnv, StepCallback
    from xpl_cli.audit.rules.measurements import RolloutSetup


@contextlib.contextmanager
def record_videos(
    folder: Path, policy: str, setup: RolloutSetup, seeds: Sequence[int], frequency: float
) -> Iterator[StepCallback]:
    """Record every environment of a rollout during a `with` block, and write the videos at its end.

    Args:
        folder: the target folder; created if missing.
        policy: the adapter's name.
        setup: task, robot and setting.
        seeds: one per environment.
        frequency: control rate, Hz.

    Yields:
        a callback that gets the environment before every control step.
    """
    folder.mkdir(parents=True, exist_ok=True)
    reels = [FilmRecorder(frequency) for _ in seeds]

    def record_frame(env: LoopEnv) -> None:
        running = env.get_running_env_idx_list()
        for env_index, reel in enumerate(reels):
            if env_index in running or not running:
                reel.add_frame(env, env_index)

    try:
        yield record_frame
    finally:
        for reel, seed in zip(reels, seeds, strict=True):
            names = (
                policy,
                setup.task,
                setup.embodiment,
                setup.action_type,
                setup.setting,
                f"{sdk.Deploy.SEED}{seed}",
            )
            reel.save(folder / f"{'-'.join(filter(None, names))}{FORMATS[0]}")
