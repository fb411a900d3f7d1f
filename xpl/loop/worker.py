"""Process of an adapter's evaluation loop: it runs deploy.py, with access to observations and actions only.

Standard library and numpy only, besides what deploy.py needs. A message has a head, in JSON, and one packed value
(`xpl.process.link`, `xpl.wire.packed`). The evaluator sends

    {"load": PATH}                          -> {"functions": [NAME, ...]}, or {"raised": {"type", "message"}}
    {"run": FUNCTION, "running": [0]}       -> {"returned": null}, or {"raised": {"type", "message", "forwarded"}}

and until the loop has returned it answers the loop's operations (`xpl.loop.proxies`):

    {"target": "task_env" or "client", "operation": NAME, "pipelined": false}, [arguments, options]
                                            -> {"ok": true, "running": [...]}, the result
                                            -> {"ok": false, "running": [...]}, {"type", "message", ...}

A pipelined operation is not answered; if it fails, the next operation is answered by its error and not run. `forwarded`
says that the loop raised an error that it had been sent.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from xpl.loop.proxies import ClientProxy, EvaluatorLink, TaskEnvProxy
from xpl.process import child, link
from xpl.process.modules import load_module
from xpl.wire import error_text

_LONGEST = 2000
"""Characters of a message."""


class LoopWorker:
    """Runs the loops of one adapter.

    Args:
        evaluator: the link to the evaluator's process.
    """

    def __init__(self, evaluator: EvaluatorLink) -> None:
        self._evaluator = evaluator
        self._module: ModuleType | None = None

    def handle(self, head: link.Head) -> link.Head:
        """Run the command of a message, and return the head of the answer."""
        try:
            if "load" in head:
                self._module = load_module(Path(head["load"]))
                return {"functions": [name for name, value in vars(self._module).items() if callable(value)]}
            self._evaluator.begin(head["running"])
            getattr(self._module, head["run"])(TaskEnvProxy(self._evaluator), ClientProxy(self._evaluator))
        except BaseException as error:  # noqa: BLE001 - whatever the adapter's code raises, SystemExit too
            is_forwarded = error is self._evaluator.last_error
            description = error_text.describe(error)
            if not is_forwarded:
                with contextlib.suppress(Exception):  # the adapter may have closed it
                    sys.stderr.write(description["traceback"])
            message = description["message"][:_LONGEST] if description["message"] != description["type"] else ""
            return {"raised": {"type": description["type"], "message": message, "forwarded": is_forwarded}}
        return {"returned": None}


def main(descriptor: int) -> NoReturn:
    """Answer the messages on a descriptor until it is closed."""
    channel = child.open_link(descriptor)
    worker = LoopWorker(EvaluatorLink(channel))
    while True:
        message = channel.receive()
        if message is None:
            child.end()
        channel.send(worker.handle(link.decode(message)[0]))
