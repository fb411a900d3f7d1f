"""End a worker that hangs while it loads or answers, after printing its stacks."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

from xpl_cli.isolation.hang_detector import HangDetector
from xpl_cli.isolation.stacks import STACKS_S

if TYPE_CHECKING:
    from xpl_cli.serving.workers.worker import ModelWorker


async def watch_worker(worker: ModelWorker, patience: float) -> None:
    """Watch a worker until it ends; whenever it is busy it has to show activity.

    Args:
        worker: one copy of the model.
        patience: longest time without activity, s (`xpl_cli.isolation.hang_detector`).
    """
    process, began = worker.process, 0.0
    detector: HangDetector | None = None
    while not process.died.done():
        now = time.monotonic()
        busy = worker.busy_for()
        if not busy:
            detector = None
        elif detector is None or abs(now - busy - began) > 0.5 * detector.every_s:  # another request
            detector, began = await asyncio.to_thread(HangDetector, process.pid, patience, now), now - busy
        reason = None if detector is None else await asyncio.to_thread(detector.check, time.monotonic())
        if reason is not None and worker.busy_for() > busy:
            process.show_stacks()
            await asyncio.sleep(STACKS_S)
            process.kill(reason)
            return
        await asyncio.wait([process.died], timeout=min(1.0, patience / 8) if detector is None else detector.every_s)
