"""The process of a rollout worker: runs the jobs of a channel, and ends with the process at its other end.

Messages are pickled, as between processes of one program: configuration, name and access first, then pairs of a job and
the address of a policy server, each answered by a result or by an error that ends the run; None ends the process.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from multiprocessing.connection import Connection
from typing import Any, NoReturn

from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.rollout.worker import RolloutWorker


def main(descriptor: int) -> None:
    """Run jobs until None arrives."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGTERM, _end_in_order)
    channel: Connection[Any, Any] = Connection(descriptor)
    worker = None
    try:
        arguments = channel.recv()
        while (job_and_url := channel.recv()) is not None:
            try:
                worker = worker or RolloutWorker(*arguments)
                channel.send(worker.run_job(*job_and_url))
            except UserError as error:
                channel.send(error)
    except EOFError:
        pass
    finally:
        if worker is not None:
            worker.close()


def _end_in_order(_number: int, _frame: object) -> NoReturn:
    """Stop the running job, so that the environment is closed."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(128 + signal.SIGTERM)


def _end_with_parent() -> None:
    """Wait for the end of standard input, which the parent process holds open and never writes to."""
    os.read(sys.stdin.fileno(), 1)
    os._exit(1)  # also during an episode, whose result has no reader any more


if __name__ == "__main__":
    main(int(sys.argv[1]))
