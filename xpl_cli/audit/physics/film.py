"""Films of the episodes of the physics gate, one file for each."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.environments.film import FORMATS, Reel

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from xpl_cli.audit.physics.loop import Playing, Watch
    from xpl_cli.audit.rules.figures import Course


@contextlib.contextmanager
def films(folder: Path, policy: str, course: Course, seeds: Sequence[int], frequency: float) -> Iterator[Watch]:
    """Film every environment of a loop for the length of a `with` block, and write the films at its end.

    Args:
        folder: where to; made if it is not there.
        policy: the adapter's name.
        course: what is driven.
        seeds: one per environment.
        frequency: control rate, Hz.

    Yields:
        what the environment is shown to before every control step.
    """
    folder.mkdir(parents=True, exist_ok=True)
    reels = [Reel(frequency) for _ in seeds]

    def watch(env: Playing) -> None:
        running = env.get_running_env_idx_list()
        for place, reel in enumerate(reels):
            if place in running or not running:
                reel.look(env, place)

    try:
        yield watch
    finally:
        for reel, seed in zip(reels, seeds, strict=True):
            names = (
                policy,
                course.task,
                course.embodiment,
                course.action_type,
                course.setting,
                f"{sdk.Deploy.SEED}{seed}",
            )
            reel.save(folder / f"{'-'.join(filter(None, names))}{FORMATS[0]}")
