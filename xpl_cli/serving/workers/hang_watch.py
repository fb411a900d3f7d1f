"""Ends a worker that hangs while it loads or answers, and shows where it stands."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

from xpl_cli.isolation.hang_detector import HangDetector
from xpl_cli.isolation.stacks import STACKS_S

if TYPE_CHECKING:
    from xpl_cli.serving.workers.worker import ModelWorker


async def watch_worker(worker: ModelWorker, patience: float) -> None:
    """Look after a worker until it has ended: whenever it is at work it has to show life.

    Args:
        worker: one copy of the model.
        patience: how long it may be silent, s (`xpl_cli.isolation.hang_detector`).
    """
    process, began = worker.process, 0.0
    life: HangDetector | None = None
    while not process.died.done():
        now = time.monotonic()
        busy = worker.busy_for()
        if not busy:
            life = None
        elif life is None or abs(now - busy - began) > 0.5 * life.every_s:  # another piece of work
            life, began = await asyncio.to_thread(HangDetector, process.pid, patience, now), now - busy
        reason = None if life is None else await asyncio.to_thread(life.check, time.monotonic())
        if reason is not None and worker.busy_for() > busy:
            process.show_stacks()
            await asyncio.sleep(STACKS_S)
            process.kill(reason)
            return
        await asyncio.wait([process.died], timeout=min(1.0, patience / 8) if life is None else life.every_s)
