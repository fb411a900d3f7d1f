"""The process of an adapter's evaluation loop: it runs deploy.py, and sees observations and actions, nothing else.

Standard library and numpy only, besides what deploy.py needs. A message has a head, in JSON, and one packed value
(`xpl.process.link`, `xpl.wire.packed`). The process that judges sends

    {"load": PATH}                          -> {"functions": [NAME, ...]}, or {"raised": {"type", "message"}}
    {"play": FUNCTION, "running": [0]}      -> {"returned": null}, or {"raised": {"type", "message", "told"}}

and until the loop has returned it answers what the loop asks (`xpl.loop.stand_ins`):

    {"ask": "task_env" or "client", "operation": NAME, "ahead": false}, [arguments, options]
                                            -> {"ok": true, "running": [...]}, what it returns
                                            -> {"ok": false, "running": [...]}, {"type", "message", ...}

A question that goes ahead is not answered; where it is refused, the next one is answered by that, and not run. `told`
says that what the loop raised is what it was answered.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from xpl.loop.stand_ins import Client, Judge, TaskEnv
from xpl.process import child, link
from xpl.process.modules import load_module
from xpl.wire import telling

_LONGEST = 2000
"""Characters of a message."""


class LoopWorker:
    """Runs the loops of one adapter.

    Args:
        judge: the link to the process that judges.
    """

    def __init__(self, judge: Judge) -> None:
        self._judge = judge
        self._module: ModuleType | None = None

    def answer(self, head: link.Head) -> link.Head:
        """Do what a message asks for, and return the head of the answer."""
        try:
            if "load" in head:
                self._module = load_module(Path(head["load"]))
                return {"functions": [name for name, value in vars(self._module).items() if callable(value)]}
            self._judge.begin(head["running"])
            getattr(self._module, head["play"])(TaskEnv(self._judge), Client(self._judge))
        except BaseException as error:  # noqa: BLE001 - whatever the adapter's code raises, SystemExit too
            is_told = error is self._judge.told
            about = telling.describe(error)
            if not is_told:
                with contextlib.suppress(Exception):  # where the adapter closed it
                    sys.stderr.write(about["traceback"])
            message = about["message"][:_LONGEST] if about["message"] != about["type"] else ""
            return {"raised": {"type": about["type"], "message": message, "told": is_told}}
        return {"returned": None}


def main(descriptor: int) -> NoReturn:
    """Run loops, as messages on a descriptor ask for, until it is closed."""
    channel = child.joined(descriptor)
    worker = LoopWorker(Judge(channel))
    while True:
        message = channel.receive()
        if message is None:
            child.end()
        channel.send(worker.answer(link.decode(message)[0]))
